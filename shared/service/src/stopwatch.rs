//! How jobs measure the time that they take without reading a clock themselves.

/// Measures how long the parts of a job took. The shell gives one that reads its clock, a simulation one
/// that stands still, a replay one that repeats what was measured then: so what a job leads to is a
/// function of the job and of these times.
pub struct Stopwatch {
    source: Source,
    laps: Vec<u64>,
}

enum Source {
    Still,
    /// Microseconds since any fixed moment, and those at the last lap.
    Clock(Box<dyn FnMut() -> u64 + Send>, u64),
    Repeated(std::vec::IntoIter<u64>),
}

impl Stopwatch {
    /// Everything takes no time at all.
    #[must_use]
    pub fn still() -> Self {
        Self { source: Source::Still, laps: Vec::new() }
    }

    /// Reads a clock that counts microseconds and never runs backwards; the first lap begins now.
    pub fn reading(mut clock: impl FnMut() -> u64 + Send + 'static) -> Self {
        let now = clock();
        Self { source: Source::Clock(Box::new(clock), now), laps: Vec::new() }
    }

    /// Repeats laps that were measured before, and zeros after them.
    #[must_use]
    pub fn repeating(laps: Vec<u64>) -> Self {
        Self { source: Source::Repeated(laps.into_iter()), laps: Vec::new() }
    }

    /// Microseconds since the last lap, or since the start.
    pub fn lap(&mut self) -> u64 {
        let lap = match &mut self.source {
            Source::Still => 0,
            Source::Clock(clock, last) => {
                let now = clock();
                now.saturating_sub(std::mem::replace(last, now))
            }
            Source::Repeated(laps) => laps.next().unwrap_or_default(),
        };
        self.laps.push(lap);
        lap
    }

    /// The laps so far.
    #[must_use]
    pub fn laps(&self) -> &[u64] {
        &self.laps
    }
}

impl std::fmt::Debug for Stopwatch {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Stopwatch").field("laps", &self.laps).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_measured_is_repeated() {
        let mut times = [100, 107, 107, 120].into_iter();
        let mut measured = Stopwatch::reading(move || times.next().unwrap());
        let laps = [measured.lap(), measured.lap(), measured.lap()];
        assert_eq!(laps, [7, 0, 13]);
        let mut repeated = Stopwatch::repeating(measured.laps().to_vec());
        assert_eq!([repeated.lap(), repeated.lap(), repeated.lap(), repeated.lap()], [7, 0, 13, 0]);
        assert_eq!(Stopwatch::still().lap(), 0);
    }
}
