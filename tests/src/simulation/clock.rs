//! Virtual time: microseconds of the whole run, and the clock of each host, which is off.

use muster_model::time::Tick;

/// A moment or a span of the run in microseconds, by a clock that nothing in it can read.
pub(crate) type Micros = u64;

/// A thousandth of a second.
pub(crate) const MS: Micros = 1000;

/// A second.
pub(crate) const SECOND: Micros = 1_000_000;

/// A year.
const YEAR: Micros = 31_557_600 * SECOND;

/// What the clocks of the hosts show when a run begins, if they are right: November 2026.
pub(crate) const BEGINNING: u64 = 1_795_000_000 * SECOND;

/// The wall clock of a host.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct HostClock {
    /// By how much it is ahead, in microseconds.
    pub(crate) ahead: i64,
    /// By how many microseconds per second it runs too fast.
    pub(crate) drift: i64,
}

impl HostClock {
    /// Clocks that are off by years: never set, so that they begin with 1970; set to 2019 by a file; ten
    /// years ahead; and three centuries.
    pub(crate) const WRONG: [i64; 4] = [
        -(BEGINNING.cast_signed()),
        -8 * YEAR.cast_signed(),
        10 * YEAR.cast_signed(),
        300 * YEAR.cast_signed(),
    ];

    /// What it shows.
    pub(crate) fn wall(&self, now: Micros) -> Tick {
        let gained = scaled(now, self.drift);
        Tick((BEGINNING + now).saturating_add_signed(self.ahead).saturating_add_signed(gained))
    }

    /// The clock of a process that starts now: it reads the wall clock once and counts on from there.
    pub(crate) fn start(&self, now: Micros) -> ProcessClock {
        ProcessClock { started: now, wall: self.wall(now), drift: self.drift }
    }
}

/// The clock of a process.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ProcessClock {
    started: Micros,
    wall: Tick,
    drift: i64,
}

impl ProcessClock {
    /// What it shows.
    pub(crate) fn tick(&self, now: Micros) -> Tick {
        let passed = now.saturating_sub(self.started);
        Tick(self.wall.0.saturating_add(passed.saturating_add_signed(scaled(passed, self.drift))))
    }

    /// The first moment at which it shows a tick; the start of the process if that was before.
    pub(crate) fn when(&self, tick: Tick) -> Micros {
        let wanted = tick.0.saturating_sub(self.wall.0);
        let pace = i128::from(SECOND) + i128::from(self.drift);
        let span = i128::from(wanted) * i128::from(SECOND) / pace.max(1);
        let mut moment = self.started.saturating_add(u64::try_from(span).unwrap_or_default());
        // Rounding is off by a microsecond or two. A moment that never comes is as good as any late one.
        for _ in 0..4 {
            moment = moment.saturating_add(u64::from(self.tick(moment) < tick));
        }
        moment
    }
}

fn scaled(span: Micros, per_second: i64) -> i64 {
    let gained = i128::from(span) * i128::from(per_second) / i128::from(SECOND);
    i64::try_from(gained).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_deadline_is_the_first_moment_that_shows_it() {
        for drift in [-300, 0, 7, 300] {
            let clock = HostClock { ahead: -2_000_000, drift }.start(123_457);
            for wait in [0, 1, 999, 100_000, 10_000_000] {
                let tick = Tick(clock.wall.0 + wait);
                let when = clock.when(tick);
                assert!(clock.tick(when) >= tick, "{drift} {wait}");
                assert!(wait == 0 || clock.tick(when - 3) < tick, "{drift} {wait}");
            }
        }
    }
}
