//! Random numbers of a situation, all from its seed.

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Attempts to find places that are far enough apart before they are looked for in a larger area.
const ATTEMPTS: usize = 200;

/// By how much that area is wider.
const WIDER: f64 = 1.1;

/// The random numbers of one situation.
#[derive(Debug)]
pub(super) struct Draw(pub(super) ChaCha8Rng);

impl Draw {
    pub(super) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    /// From `least` to below `most`, all equally likely.
    pub(super) fn within(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * self.0.random::<f64>()
    }

    /// From the standard normal distribution (Box and Muller 1958).
    pub(super) fn normal(&mut self) -> f64 {
        // Within (0, 1], so that the logarithm is finite.
        let radius = (-2.0 * (1.0 - self.0.random::<f64>()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.0.random::<f64>()).cos()
    }

    /// One of 0 to below `count`.
    pub(super) fn index(&mut self, count: usize) -> usize {
        self.0.random_range(0..count.max(1))
    }

    /// From `least` to `most`.
    pub(super) fn count(&mut self, least: usize, most: usize) -> usize {
        self.0.random_range(least..=most.max(least))
    }

    /// So many counts from `least` to `most`.
    pub(super) fn counts(&mut self, how_many: usize, least: usize, most: usize) -> Vec<usize> {
        (0..how_many).map(|_| self.count(least, most)).collect()
    }

    /// True with this probability.
    pub(super) fn chance(&mut self, probability: f64) -> bool {
        self.0.random::<f64>() < probability
    }

    /// An angle.
    pub(super) fn angle(&mut self) -> f64 {
        self.within(0.0, std::f64::consts::TAU)
    }

    /// The numbers from 0 to below `count` in random order.
    pub(super) fn order(&mut self, count: usize) -> Vec<usize> {
        let mut order: Vec<usize> = (0..count).collect();
        order.shuffle(&mut self.0);
        order
    }

    /// So many middles of teams, no two of which are nearer to each other than `least_m`, and as dense as random
    /// places then are.
    #[expect(clippy::cast_precision_loss, reason = "there are a few teams")]
    pub(super) fn middles(&mut self, teams: usize, least_m: f64) -> Vec<[f64; 2]> {
        let mut side = least_m * (teams as f64).sqrt();
        loop {
            let mut found: Vec<[f64; 2]> = Vec::with_capacity(teams);
            for _ in 0..ATTEMPTS {
                let at = [self.within(0.0, side), self.within(0.0, side)];
                let far = |other: &[f64; 2]| (at[0] - other[0]).hypot(at[1] - other[1]) >= least_m;
                if found.len() < teams && found.iter().all(far) {
                    found.push(at);
                }
            }
            if found.len() == teams {
                return found;
            }
            side *= WIDER;
        }
    }
}
