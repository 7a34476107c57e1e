//! A clean end: signals and other reasons stop every task of the process.

use std::time::Duration;

use tokio::sync::watch;

use crate::exit::Exit;

/// When a process that should stop, and has not, is ended whatever it does: service managers and
/// operators expect a few seconds, and everything that must be kept is stored as it happens.
const STOP_TIMEOUT: Duration = Duration::from_secs(4);

/// The environment variable by which a process ends with its standard input. What `muster up` starts has a pipe from it
/// there, which the kernel closes however `muster up` ends.
pub const ENDS_WITH_INPUT: &str = "MUSTER_ENDS_WITH_INPUT";

/// Stops tasks.
#[derive(Debug, Clone)]
pub struct Stopper(watch::Sender<bool>);

/// What a task waits on for its end.
#[derive(Debug, Clone)]
pub struct Stop(watch::Receiver<bool>);

/// A stopper, and what tasks wait on.
#[must_use]
pub fn channel() -> (Stopper, Stop) {
    let (sender, receiver) = watch::channel(false);
    (Stopper(sender), Stop(receiver))
}

impl Stopper {
    /// Stops every task.
    pub fn stop(&self) {
        self.0.send_replace(true);
    }
}

impl Stop {
    /// Returns once it is time to stop, or every [`Stopper`] is gone.
    pub async fn stopped(&mut self) {
        // An error means that the stopper is gone, which is an end as well.
        let _ = self.0.wait_for(|stop| *stop).await;
    }

    /// Whether it is time to stop.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        *self.0.borrow()
    }
}

/// Stops on SIGINT and SIGTERM; ends the process at once on a second signal.
///
/// # Errors
/// If the signals cannot be listened to.
pub fn on_signals(stopper: Stopper) -> std::io::Result<()> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    tokio::spawn(async move {
        let mut asked = false;
        loop {
            let code = tokio::select! {
                _ = interrupt.recv() => 130,
                _ = terminate.recv() => 143,
            };
            if asked {
                std::process::exit(code);
            }
            asked = true;
            stopper.stop();
            std::thread::spawn(end_late);
        }
    });
    Ok(())
}

/// Stops at the end of standard input, where [`ENDS_WITH_INPUT`] is set; else does nothing.
pub fn at_end_of_input(stopper: Stopper) {
    if std::env::var_os(ENDS_WITH_INPUT).is_none() {
        return;
    }
    // Reading blocks, and nothing waits for this thread.
    std::thread::spawn(move || {
        // An input that cannot be read has ended as well.
        let _ = std::io::copy(&mut std::io::stdin().lock(), &mut std::io::sink());
        stopper.stop();
        end_late();
    });
}

/// Ends the process if it has not stopped in time. On a thread of its own nothing that blocks the runtime keeps it from that.
fn end_late() {
    std::thread::sleep(STOP_TIMEOUT);
    eprintln!("error: it did not stop in time and was ended");
    std::process::exit(Exit::Failure as i32);
}
