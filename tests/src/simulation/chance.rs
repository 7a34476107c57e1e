//! Seeded chance: one stream of numbers for each purpose and thing, so that what is left out of one
//! of them changes nothing in the others. That is what makes a failing run shrink.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What chance is needed for.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Purpose {
    /// Which faults there are, and when.
    Plan = 1,
    /// What a link does to what it carries.
    Link = 2,
    /// In which order a service takes what waits, and how long its work takes.
    Node = 3,
    /// What a robot is like and when it reports.
    Robot = 4,
    /// What the fleet is like as a whole, and the settings that it starts with.
    Fleet = 5,
    /// What a single fault puts on the bus.
    Fault = 6,
    /// Which faults happen to real processes, and when.
    Soak = 7,
    /// Which browsers are open, how fast they draw, and what they send.
    Console = 8,
    /// Whether there are robots of ROS, what they are like, and what their bus does.
    Ros = 9,
    /// Which viewers there are, how fast they read, and what they ask for.
    Viewers = 10,
}

/// A stream of numbers.
#[derive(Debug, Clone)]
pub(crate) struct Chance(ChaCha8Rng);

impl Chance {
    /// The stream of the `number`th thing of a purpose.
    pub(crate) fn new(seed: u64, purpose: Purpose, number: usize) -> Self {
        let mut key = [0; 32];
        for (bytes, part) in key.chunks_exact_mut(8).zip([seed, purpose as u64, number as u64]) {
            bytes.copy_from_slice(&part.to_le_bytes());
        }
        Self(ChaCha8Rng::from_seed(key))
    }

    /// A number from `low` to `high`, both possible.
    pub(crate) fn between(&mut self, low: u64, high: u64) -> u64 {
        self.0.random_range(low..=high.max(low))
    }

    /// An index below `count`; 0 if there is none.
    pub(crate) fn below(&mut self, count: usize) -> usize {
        self.0.random_range(0..count.max(1))
    }

    /// A number from `low` up to `high`.
    pub(crate) fn real(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// True so many times in a hundred.
    pub(crate) fn percent(&mut self, percent: u64) -> bool {
        self.0.random_range(0..100) < percent
    }

    /// One of several.
    pub(crate) fn pick<'a, T>(&mut self, from: &'a [T]) -> Option<&'a T> {
        from.get(self.below(from.len()))
    }

    /// Bytes without meaning.
    pub(crate) fn bytes(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| self.0.random()).collect()
    }
}
