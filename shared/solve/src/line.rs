//! One line on the terminal that shows an operator what is being done.

use std::fmt::Display;
use std::io::Write as _;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Time before the line appears: a shorter solve needs no explanation.
const QUIET: Duration = Duration::from_secs(1);

/// Time between two redraws: every second that passes must show.
const REDRAW_EVERY: Duration = Duration::from_millis(250);

/// Back to the first column, and everything to the right erased.
const ERASE: &str = "\r\x1b[K";

/// The line. A thread of its own writes it, because a step may take minutes without a report.
#[derive(Debug)]
pub(super) struct Line<S> {
    steps: Option<Sender<S>>,
    writer: Option<JoinHandle<()>>,
}

impl<S: Display + Send + 'static> Line<S> {
    /// A line on standard error, or none at all.
    pub(super) fn start(is_shown: bool) -> Self {
        if !is_shown {
            return Self { steps: None, writer: None };
        }
        let (steps, received) = channel();
        // Without a thread there is no line, and all else goes on.
        let writer = std::thread::Builder::new().spawn(move || write(&received)).ok();
        Self { steps: Some(steps), writer }
    }

    /// The step has begun.
    pub(super) fn show(&self, step: S) {
        if let Some(steps) = &self.steps {
            // It fails only without a writer.
            let _ = steps.send(step);
        }
    }
}

impl<S> Drop for Line<S> {
    /// Erases the line before anything else is written.
    fn drop(&mut self) {
        self.steps = None;
        if let Some(writer) = self.writer.take() {
            let _ = writer.join();
        }
    }
}

/// Writes the line until its sender is dropped.
fn write<S: Display>(received: &Receiver<S>) {
    let begin = Instant::now();
    let mut step: Option<S> = None;
    let mut written: Option<Instant> = None;
    loop {
        match received.recv_timeout(REDRAW_EVERY) {
            Ok(next) => step = Some(next),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
        let is_due = written.is_none_or(|written| written.elapsed() >= REDRAW_EVERY);
        if begin.elapsed() >= QUIET && is_due {
            let text = match &step {
                Some(step) => text(step, begin.elapsed()),
                None => text(&"read the file", begin.elapsed()),
            };
            print(&format!("{ERASE}{text}"));
            written = Some(Instant::now());
        }
    }
    if written.is_some() {
        print(ERASE);
    }
}

/// Writes to standard error; a failure does not matter to the solve.
fn print(text: &str) {
    let mut out = std::io::stderr().lock();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}

/// What is being done, and since when everything began.
fn text(doing: &dyn Display, since: Duration) -> String {
    format!("{doing} ({} s)", since.as_secs())
}

#[cfg(test)]
mod tests {
    use muster_method::step::Step;

    use super::*;

    #[test]
    fn the_line_names_the_step_and_fits_a_terminal() {
        let steps = [
            (Step::Fuse, "fuse the graphs (61 s)"),
            (Step::Svd, "singular value decomposition (61 s)"),
            (Step::SEARCH, "leading singular triplets (61 s)"),
            (
                Step::Search { round: 12, open: 7, rank: 17 },
                "leading singular triplets, round 12, 10 of 17 found (61 s)",
            ),
            (Step::KMeans { done: 0, restarts: 50 }, "k-means (61 s)"),
            (Step::KMeans { done: 12, restarts: 50 }, "k-means, 12 of 50 restarts (61 s)"),
        ];
        for (step, expected) in steps {
            let text = text(&step, Duration::from_millis(61_400));
            assert_eq!(text, expected);
            assert!(text.len() < 80);
        }
    }

    #[test]
    fn it_ends_with_its_sender() {
        let line = Line::start(true);
        line.show(Step::Katz);
        drop(line);
        Line::start(false).show(Step::Katz);
    }
}
