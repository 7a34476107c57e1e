//! Random numbers.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Two independent numbers of the standard normal distribution (Box and Muller 1958).
pub(crate) fn normal_pair(chance: &mut ChaCha8Rng) -> [f64; 2] {
    // Within (0, 1], so that the logarithm is finite.
    let radius = (-2.0 * (1.0 - chance.random::<f64>()).ln()).sqrt();
    let (sin, cos) = (std::f64::consts::TAU * chance.random::<f64>()).sin_cos();
    [radius * cos, radius * sin]
}
