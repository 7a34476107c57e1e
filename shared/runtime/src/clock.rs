//! The clock of a process.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use muster_model::time::Tick;

/// Reads the wall clock once and adds the steady clock, so that ticks never run backwards.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    wall: Duration,
    steady: Instant,
}

impl Default for Clock {
    fn default() -> Self {
        Self::start()
    }
}

impl Clock {
    /// Starts the clock of this process. A wall clock before 1970 counts as 1970.
    #[must_use]
    pub fn start() -> Self {
        Self {
            wall: SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default(),
            steady: Instant::now(),
        }
    }

    /// Now.
    #[must_use]
    pub fn now(&self) -> Tick {
        Tick(0).after(self.wall + self.steady.elapsed())
    }

    /// When a tick is, as tokio's timers have it; now, if it has passed.
    #[must_use]
    pub fn instant(&self, tick: Tick) -> tokio::time::Instant {
        tokio::time::Instant::now() + tick.since(self.now())
    }
}
