//! Seeded chance.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What chance is needed for. Each purpose has numbers of its own, so that one more number for one of
/// them does not change the others.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Purpose {
    /// Where and how robots are placed.
    Layout = 1,
    /// What their antennas are like.
    Radio = 2,
    /// What their positions are measured as at some moment.
    Position = 3,
}

/// The numbers for a purpose at a moment; chance that does not change with time is that of moment 0.
pub(crate) fn chance(seed: u64, purpose: Purpose, t_seconds: f64) -> ChaCha8Rng {
    let mut key = [0; 32];
    // Adding 0 turns −0 into 0: it is the same moment.
    let moment = (t_seconds + 0.0).to_bits();
    let parts = [seed, purpose as u64, moment];
    for (bytes, part) in key.chunks_exact_mut(8).zip(parts) {
        bytes.copy_from_slice(&part.to_le_bytes());
    }
    ChaCha8Rng::from_seed(key)
}

/// A number from `low` up to `high`.
pub(crate) fn between(chance: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * chance.random::<f64>()
}

/// Two independent numbers of the standard normal distribution, by the method of Box and Muller.
pub(crate) fn normal_pair(chance: &mut ChaCha8Rng) -> [f64; 2] {
    // Within (0, 1], so that the logarithm is finite.
    let radius = (-2.0 * (1.0 - chance.random::<f64>()).ln()).sqrt();
    let (sin, cos) = (std::f64::consts::TAU * chance.random::<f64>()).sin_cos();
    [radius * cos, radius * sin]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_normal_numbers_are_normal() {
        let mut chance = chance(7, Purpose::Position, 0.5);
        let numbers: Vec<f64> = (0..20_000).flat_map(|_| normal_pair(&mut chance)).collect();
        let mean = numbers.iter().sum::<f64>() / 40_000.0;
        let variance = numbers.iter().map(|x| x * x).sum::<f64>() / 40_000.0;
        assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.03, "{mean} {variance}");
        let beyond_two = numbers.iter().filter(|x| x.abs() > 2.0).count() as f64 / 40_000.0;
        assert!((beyond_two - 0.0455).abs() < 0.005, "{beyond_two}");
    }

    #[test]
    fn seed_purpose_and_moment_each_matter() {
        let first = |seed, purpose, t| chance(seed, purpose, t).random::<u64>();
        let base = first(1, Purpose::Position, 0.0);
        assert_eq!(base, first(1, Purpose::Position, -0.0));
        assert_ne!(base, first(2, Purpose::Position, 0.0));
        assert_ne!(base, first(1, Purpose::Radio, 0.0));
        assert_ne!(base, first(1, Purpose::Position, 0.1));
    }
}
