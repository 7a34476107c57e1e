//! Processes that keep the processors busy, as other work on the host of a base station does.

use std::process::{Child, Command, Stdio};

/// Processes that do nothing but compute. They end when this is dropped.
#[derive(Debug)]
pub struct Neighbours(Vec<Child>);

impl Neighbours {
    /// Starts so many for each processor.
    ///
    /// # Errors
    /// If a process cannot be started.
    pub fn start(per_processor: usize) -> std::io::Result<Self> {
        let processors = std::thread::available_parallelism().map_or(2, usize::from);
        let mut all = Self(Vec::new());
        for _ in 0..per_processor * processors {
            let mut shell = Command::new("sh");
            shell.args(["-c", "while :; do :; done"]).stdin(Stdio::null());
            all.0.push(shell.spawn()?);
        }
        Ok(all)
    }
}

impl Drop for Neighbours {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}
