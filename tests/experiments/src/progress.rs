//! How far a run is, for people at a terminal.

use std::cell::Cell;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

/// How often the clock of the bar moves while a step takes long.
const TICK: Duration = Duration::from_secs(1);

/// A bar on a terminal; nothing where standard error is none.
#[derive(Debug)]
pub struct Bar {
    bar: ProgressBar,
    started: Cell<u64>,
}

impl Bar {
    /// The bar of a run of so many steps, as far as is known.
    #[must_use]
    pub fn of(steps: usize) -> Self {
        let bar = ProgressBar::new(steps as u64);
        // A template that is wrong leaves the bar with its own.
        if let Ok(style) = ProgressStyle::with_template("{bar:24} {pos}/{len} {elapsed} {msg}") {
            bar.set_style(style);
        }
        bar.enable_steady_tick(TICK);
        Self { bar, started: Cell::new(0) }
    }

    /// So many more steps are to be done.
    pub fn count(&self, steps: usize) {
        self.bar.inc_length(steps as u64);
    }

    /// A step begins, and the one before it is done.
    pub fn step(&self, what: &str) {
        let done = self.started.get();
        self.started.set(done + 1);
        // Uncounted steps make the run longer, and never more than whole.
        if done >= self.bar.length().unwrap_or_default() {
            self.bar.set_length(done + 1);
        }
        self.bar.set_position(done);
        self.bar.set_message(what.to_owned());
    }

    /// How many steps are done, and of how many.
    #[must_use]
    pub fn done(&self) -> (u64, u64) {
        (self.bar.position(), self.bar.length().unwrap_or_default())
    }

    /// The run is over; the bar goes.
    pub fn end(&self) {
        self.bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_done_when_the_next_begins_and_there_may_be_more_than_were_counted() {
        let bar = Bar::of(2);
        assert_eq!(bar.done(), (0, 2));
        bar.step("first");
        assert_eq!(bar.done(), (0, 2));
        bar.step("second");
        assert_eq!(bar.done(), (1, 2));
        bar.step("third");
        assert_eq!(bar.done(), (2, 3));
        bar.count(4);
        assert_eq!(bar.done(), (2, 7));
    }
}
