//! How long messages travel and services compute, as measured on a live system.
//!
//! The numbers are those of `tests/peers/LATENCY.md`: a router, the services and all robots as processes of one
//! host of two cores. Between the sizes that were measured, the logarithm of a time is interpolated in the
//! logarithm of the number of robots; beyond them, the nearest one counts. Single times are drawn from the
//! log-normal distribution with the median and the 99th percentile of the measurement.

use std::time::Duration;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::chance::normal_pair;

/// The 99th percentile of the standard normal distribution.
const NORMAL_P99: f64 = 2.326;

/// The sizes of the fleets that were measured.
const MEASURED_ROBOTS: [f64; 3] = [50.0, 500.0, 5000.0];

/// How much of the time from the frame to a reader is spent in `ingest`, which receives nothing meanwhile: at 5,000
/// robots it made 4.2 frames a second, and it makes no frame in three quarters of the time.
const FRAME_SHARE: f64 = 0.76;

/// What takes time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Leg {
    /// A message from a robot to `ingest`.
    Report,
    /// A frame in `ingest`, until it is published.
    Frame,
    /// A message of `ingest` to another service.
    Graphs,
    /// A job of `embedder`.
    Embedding,
    /// A message of `embedder` to another service.
    Vectors,
    /// A job of `clusterer`.
    Division,
    /// A message of `clusterer` to a reader, or of `auditor`, which sends as many numbers.
    Teams,
    /// A job of `auditor`.
    Audit,
}

impl Leg {
    /// The median and the 99th percentile in milliseconds, by [`MEASURED_ROBOTS`].
    fn measured_ms(self) -> [(f64, f64); 3] {
        let part = |share: f64| {
            [(1.3, 3.0), (5.6, 9.3), (77.7, 122.2)].map(|(p50, p99)| (share * p50, share * p99))
        };
        match self {
            Self::Report => [(0.2, 0.8), (0.2, 3.0), (3.3, 30.4)],
            Self::Frame => part(FRAME_SHARE),
            Self::Graphs => part(1.0 - FRAME_SHARE),
            Self::Embedding => [(1.1, 1.6), (7.0, 12.2), (133.5, 255.4)],
            Self::Vectors => [(0.5, 1.2), (0.9, 2.0), (4.6, 12.5)],
            Self::Division => [(0.5, 0.8), (1.6, 3.2), (19.8, 44.2)],
            Self::Teams => [(0.4, 0.7), (0.8, 2.3), (7.3, 19.8)],
            Self::Audit => [(0.1, 0.4), (0.7, 2.5), (25.5, 55.2)],
        }
    }
}

/// Draws the times of a fleet of one size.
#[derive(Debug, Clone)]
pub struct Times {
    robots: f64,
    chance: ChaCha8Rng,
}

impl Times {
    /// The times of so many robots; the same seed draws the same ones.
    #[must_use]
    pub fn new(robots: usize, seed: u64) -> Self {
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        chance.set_stream(2);
        Self { robots: robots as f64, chance }
    }

    /// One time.
    pub fn draw(&mut self, leg: Leg) -> Duration {
        let (p50, p99) = self.quantiles_ms(leg);
        let deviation = (p99 / p50).ln() / NORMAL_P99;
        let [normal, _] = normal_pair(&mut self.chance);
        Duration::from_secs_f64(1e-3 * p50 * (deviation * normal).exp())
    }

    /// The median and the 99th percentile, in milliseconds.
    fn quantiles_ms(&self, leg: Leg) -> (f64, f64) {
        let measured = leg.measured_ms();
        let last = MEASURED_ROBOTS.len() - 1;
        let robots = self.robots.clamp(MEASURED_ROBOTS[0], MEASURED_ROBOTS[last]);
        let upper = MEASURED_ROBOTS.partition_point(|size| *size < robots).clamp(1, last);
        let [from, to] = [upper - 1, upper].map(|at| MEASURED_ROBOTS[at].ln());
        let share = (robots.ln() - from) / (to - from);
        let between = |low: f64, high: f64| (low.ln() + share * (high / low).ln()).exp();
        let (low, high) = (measured[upper - 1], measured[upper]);
        (between(low.0, high.0), between(low.1, high.1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measured_sizes_have_the_measured_times_and_others_lie_between() {
        let p50 = |robots| Times::new(robots, 1).quantiles_ms(Leg::Embedding).0;
        for (robots, ms) in [(10, 1.1), (50, 1.1), (500, 7.0), (5000, 133.5), (9000, 133.5)] {
            assert!((p50(robots) - ms).abs() < 1e-9, "{robots}");
        }
        assert!(p50(200) > 1.1 && p50(200) < 7.0 && p50(1000) > 7.0 && p50(1000) < 133.5);
    }

    #[test]
    fn drawn_times_have_the_measured_quantiles() {
        let mut times = Times::new(500, 7);
        let draw = |_| times.draw(Leg::Embedding).as_secs_f64() * 1e3;
        let mut all: Vec<f64> = (0..10_000).map(draw).collect();
        all.sort_by(f64::total_cmp);
        assert!((all[5000] - 7.0).abs() < 0.2 && (all[9900] - 12.2).abs() < 0.8);
    }
}
