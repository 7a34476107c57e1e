//! One start of k-means: seeding, Lloyd's iteration, exchanges.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::options::{Init, KMeansOptions};
use super::partition::Partition;
use super::points::Points;
use super::seeding;

/// A finished start.
pub(super) struct Solution {
    pub(super) partition: Partition,
    pub(super) inertia: f64,
    /// Lloyd iterations and exchange passes.
    pub(super) iterations: usize,
    pub(super) converged: bool,
}

/// Cold start `number` of `clusters` clusters.
pub(super) fn restart(
    points: &Points<'_>,
    clusters: usize,
    number: u64,
    options: &KMeansOptions<'_>,
) -> Solution {
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    rng.set_stream(number);
    let centroids = match options.init {
        Init::PlusPlus => seeding::plus_plus(points, clusters, &mut rng),
        Init::Random => seeding::random(points.x, clusters, &mut rng),
    };
    polish(points, Partition::from_centroids(points, centroids), options.max_iterations)
}

/// Lloyd iterations and then exchanges, from a given partition.
pub(super) fn polish(points: &Points<'_>, mut partition: Partition, limit: usize) -> Solution {
    let (iterations, _) = partition.lloyd(points, limit);
    let (passes, converged) = partition.exchange(points, limit, 0.0);
    partition.refresh(points);
    Solution {
        inertia: partition.inertia(points),
        partition,
        iterations: iterations + passes,
        converged,
    }
}
