//! A service manager that receives the notifications of programs, as systemd does (`sd_notify`).

use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::ensure;

/// Longest note that is read in bytes.
const MAX_NOTE: usize = 4096;

/// How often a waiting test looks again.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Listens at a socket of its own.
#[derive(Debug)]
pub struct Manager {
    path: PathBuf,
    socket: UnixDatagram,
    /// Every line that was received, in order.
    pub received: Vec<String>,
}

impl Manager {
    /// Listens at a socket in a folder.
    ///
    /// # Errors
    /// If it cannot be made.
    pub fn listen(folder: &Path) -> anyhow::Result<Self> {
        let path = folder.join("notify.socket");
        let socket = UnixDatagram::bind(&path)?;
        socket.set_nonblocking(true)?;
        Ok(Self { path, socket, received: Vec::new() })
    }

    /// The environment of a program that notifies this manager, with a watchdog.
    #[must_use]
    pub fn environment(&self, watchdog: Duration) -> Vec<(String, String)> {
        vec![
            ("NOTIFY_SOCKET".to_owned(), self.path.to_string_lossy().into_owned()),
            ("WATCHDOG_USEC".to_owned(), watchdog.as_micros().to_string()),
        ]
    }

    /// Takes in what waits.
    pub fn take(&mut self) {
        let mut note = [0; MAX_NOTE];
        while let Ok(length) = self.socket.recv(&mut note) {
            let text = String::from_utf8_lossy(&note[..length]).into_owned();
            self.received.extend(text.lines().map(str::to_owned));
        }
    }

    /// Waits for a line that contains a text.
    ///
    /// # Errors
    /// If none arrives in time; the error lists all lines.
    pub fn until(&mut self, text: &str, within: Duration) -> anyhow::Result<()> {
        let start = Instant::now();
        loop {
            self.take();
            if self.received.iter().any(|line| line.contains(text)) {
                return Ok(());
            }
            ensure!(start.elapsed() < within, "{text} was not received, only {:?}", self.received);
            std::thread::sleep(LOOK_EVERY);
        }
    }

    /// How often the watchdog is fed in some time from now on.
    pub fn fed_in(&mut self, time: Duration) -> usize {
        self.take();
        let before = self.fed();
        let until = Instant::now() + time;
        while Instant::now() < until {
            std::thread::sleep(LOOK_EVERY);
            self.take();
        }
        self.fed() - before
    }

    fn fed(&self) -> usize {
        self.received.iter().filter(|line| *line == "WATCHDOG=1").count()
    }
}
