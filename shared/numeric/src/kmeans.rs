//! k-means division of the rows of a matrix (equation 6 and algorithm 1 of the paper).
//!
//! The paper assigns every robot to the nearest of C centroids drawn at random and repeats until
//! the labels stay (Lloyd 1982). One such run often ends in a poor local optimum, so that this
//! module adds restarts, greedy k-means++ seeding (Arthur and Vassilvitskii, SODA 2007) and, after
//! Lloyd, single-point exchanges (Hartigan and Wong, 1979), whose optima are a subset of Lloyd's.
//!
//! Restart r draws from stream r of one generator, and sums are made over chunks of points whose
//! bounds are fixed, so that results depend on the seed alone and neither on the order in which
//! restarts run nor on the number of threads.

mod assign;
mod exchange;
mod partition;
mod points;
mod seeding;
mod sums;
mod warm;

pub use muster_model::settings::CentroidStart as Init;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use thiserror::Error;

use crate::matrix::DenseMatrix;
use partition::Partition;
use points::Points;

pub(crate) use assign::squared_distance;
pub use seeding::DISTINCT;

/// Relative improvement of the inertia below which an earlier restart is kept.
const TIE: f64 = 1e-12;

/// Restarts that run between two looks at their results, for each thread: enough that no thread
/// waits long for the slowest one, and few enough that their labels take little memory.
const RESTARTS_PER_THREAD: usize = 4;

/// Most threads that are started. More than any machine has cores help nobody, and each has a
/// stack.
const MAX_THREADS: usize = 1024;

/// What to compute.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KMeansOptions<'a> {
    /// Number of clusters k, from 1 to the number of points.
    pub clusters: usize,
    /// Choice of the first centroids.
    pub init: Init,
    /// Independent starts, at least 1 (0 counts as 1).
    pub restarts: usize,
    /// Bound on the Lloyd iterations of one start, and on its exchange passes; at least 1.
    pub max_iterations: usize,
    /// Seed of all random choices.
    pub seed: u64,
    /// Cluster of every point in the previous division, if there was one: any numbers, `None`
    /// for a point that is new.
    pub warm_labels: Option<&'a [Option<usize>]>,
    /// Relative advantage, from 0 to below 1, that a change must have over the previous
    /// division, for one point to move and for a restart to replace it altogether.
    pub hysteresis: f64,
    /// Threads that restarts are shared out over, and the points of each restart if they are many;
    /// 0 counts as 1. The result does not depend on it. More than one are started for the call and
    /// end with it, which takes about a tenth of a millisecond.
    pub threads: usize,
}

impl KMeansOptions<'_> {
    /// Defaults for `clusters` clusters: 50 greedy k-means++ starts, no previous division, all on
    /// the calling thread.
    #[must_use]
    pub fn new(clusters: usize) -> Self {
        Self {
            clusters,
            init: Init::PlusPlus,
            restarts: 50,
            max_iterations: 300,
            seed: 0,
            warm_labels: None,
            hysteresis: 0.0,
            threads: 1,
        }
    }
}

/// A division of N points.
#[derive(Debug, Clone, PartialEq)]
pub struct KMeans {
    /// Cluster of every point, numbered in order of first appearance; every number below the
    /// number of rows of `centroids` occurs.
    pub labels: Vec<usize>,
    /// Mean of every cluster, one row each; fewer than asked for when there are not enough
    /// distinct points.
    pub centroids: DenseMatrix,
    /// Sum of squared distances of the points to their centroids.
    pub inertia: f64,
    /// Lloyd iterations and exchange passes of the start that won.
    pub iterations: usize,
    /// Whether that start reached a fixed point within its iterations.
    pub converged: bool,
    /// Number of points that differ by more than [`DISTINCT`], counted up to the number of
    /// clusters asked for. Smaller than that number: there are fewer clusters.
    pub distinct_points: usize,
    /// Whether the previous division, refined, was kept.
    pub warm: bool,
}

/// Why points could not be divided.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum KMeansError {
    /// There are no points.
    #[error("no points to divide")]
    NoPoints,
    /// The number of clusters is 0 or above the number of points.
    #[error("{clusters} clusters cannot be made of {points} points")]
    Clusters {
        /// Clusters asked for.
        clusters: usize,
        /// Points given.
        points: usize,
    },
    /// The previous division has another number of points.
    #[error("{labels} previous labels for {points} points")]
    WarmLabels {
        /// Labels given.
        labels: usize,
        /// Points given.
        points: usize,
    },
    /// First centroids have another number of coordinates than the points.
    #[error("centroids of {centroids} dimensions for points of {points}")]
    Dimensions {
        /// Columns of the points.
        points: usize,
        /// Columns of the centroids.
        centroids: usize,
    },
    /// The hysteresis is not a number from 0 to below 1.
    #[error("hysteresis {0} is not a number from 0 to below 1")]
    Hysteresis(f64),
}

/// Divides the rows of `x`, N × D, so that the sum of squared distances to the cluster means is
/// small.
///
/// The best of all restarts is taken. With `warm_labels` the previous division is refined by
/// moving single points whose advantage exceeds the hysteresis h, and is kept unless a restart is
/// better by more than the factor 1 + h: unchanged points keep their labels, and noise on a
/// border moves nobody. Clusters never end up empty, and there are never more of them than distinct
/// points.
///
/// # Errors
/// [`KMeansError`] for an impossible number of clusters or unusable options.
pub fn kmeans(x: &DenseMatrix, options: &KMeansOptions<'_>) -> Result<KMeans, KMeansError> {
    kmeans_watched(x, options, &mut |_| {})
}

/// [`kmeans`], and how many of the restarts are done whenever one more is, for whoever waits.
///
/// # Errors
/// As of [`kmeans`].
pub fn kmeans_watched(
    x: &DenseMatrix,
    options: &KMeansOptions<'_>,
    done: &mut dyn FnMut(usize),
) -> Result<KMeans, KMeansError> {
    check(x, options)?;
    let (pool, threads) = pool(options.threads);
    divide(x, options, pool.as_ref(), threads, done)
}

/// Lloyd's iteration alone, from given first centroids, k × D: no seeding, no restarts, no
/// exchanges.
///
/// Points go to the nearest centroid, and centroids to the means of their points, until no label
/// changes, at most `max_iterations` times after the first assignment. Clusters without a point get
/// the one farthest from its centroid. For callers with first centroids of their own, and for
/// comparisons with other implementations. `threads` is as in [`KMeansOptions`]; only many points
/// are shared out.
///
/// # Errors
/// [`KMeansError`] for no points, an impossible number of centroids, or centroids with another
/// number of columns than the points.
pub fn lloyd(
    x: &DenseMatrix,
    first: &DenseMatrix,
    max_iterations: usize,
    threads: usize,
) -> Result<KMeans, KMeansError> {
    check(x, &KMeansOptions::new(first.rows()))?;
    if x.cols() != first.cols() {
        return Err(KMeansError::Dimensions { points: x.cols(), centroids: first.cols() });
    }
    let (pool, threads) = pool(threads);
    let run = || {
        let points = Points::new(x, threads);
        let mut partition = Partition::from_centroids(&points, first.clone());
        let (iterations, converged) = partition.lloyd(&points, max_iterations);
        let inertia = partition.inertia(&points);
        Solution { partition, inertia, iterations, converged }
    };
    let found = within(pool.as_ref(), run);
    Ok(found.finish(seeding::count_distinct(x, first.rows()), false))
}

/// Threads for one call, and how many there are; none if one is enough or no more can be had.
fn pool(threads: usize) -> (Option<ThreadPool>, usize) {
    let threads = threads.clamp(1, MAX_THREADS);
    if threads == 1 {
        return (None, 1);
    }
    match ThreadPoolBuilder::new().num_threads(threads).build() {
        Ok(pool) => (Some(pool), threads),
        Err(_) => (None, 1),
    }
}

/// Runs in a pool if there is one.
fn within<T: Send>(pool: Option<&ThreadPool>, run: impl FnOnce() -> T + Send) -> T {
    match pool {
        Some(pool) => pool.install(run),
        None => run(),
    }
}

/// The division itself, with the pool that it may use.
fn divide(
    x: &DenseMatrix,
    options: &KMeansOptions<'_>,
    pool: Option<&ThreadPool>,
    threads: usize,
    done: &mut dyn FnMut(usize),
) -> Result<KMeans, KMeansError> {
    let distinct_points = seeding::count_distinct(x, options.clusters);
    let clusters = options.clusters.min(distinct_points);
    let limit = options.max_iterations.max(1);
    let points = within(pool, || Points::new(x, threads));

    let mut best = within(pool, || restart(&points, clusters, 0, options, limit));
    done(1);
    let restarts = options.restarts.max(1);
    let together = if threads > 1 { threads * RESTARTS_PER_THREAD } else { 1 };
    for first in (1..restarts).step_by(together) {
        let numbers = first..restarts.min(first + together);
        let finished = numbers.end;
        let run = |number| restart(&points, clusters, number as u64, options, limit);
        let found: Vec<Solution> = within(pool, || {
            if threads > 1 {
                numbers.into_par_iter().map(run).collect()
            } else {
                numbers.map(run).collect()
            }
        });
        for next in found {
            if next.inertia < best.inertia * (1.0 - TIE) {
                best = next;
            }
        }
        done(finished);
    }
    let mut warm = false;
    if let Some(labels) = options.warm_labels {
        let refine = || warm::refine(&points, labels, clusters, options.hysteresis, limit);
        let kept = within(pool, refine);
        // Inertia that is rounding noise beside the spread of the points counts as none.
        let all = Partition::from_labels(&points, vec![0; x.rows()], 1);
        let noise = TIE * all.inertia(&points);
        if let Some(kept) = kept
            && kept.inertia <= (1.0 + options.hysteresis) * best.inertia + noise
        {
            best = kept;
            warm = true;
        }
    }
    Ok(best.finish(distinct_points, warm))
}

fn check(x: &DenseMatrix, options: &KMeansOptions<'_>) -> Result<(), KMeansError> {
    let (points, clusters) = (x.rows(), options.clusters);
    if points == 0 {
        return Err(KMeansError::NoPoints);
    }
    if clusters == 0 || clusters > points {
        return Err(KMeansError::Clusters { clusters, points });
    }
    if let Some(labels) = options.warm_labels.map(<[_]>::len)
        && labels != points
    {
        return Err(KMeansError::WarmLabels { labels, points });
    }
    if !(0.0..1.0).contains(&options.hysteresis) {
        return Err(KMeansError::Hysteresis(options.hysteresis));
    }
    Ok(())
}

/// A finished start.
struct Solution {
    partition: Partition,
    inertia: f64,
    iterations: usize,
    converged: bool,
}

impl Solution {
    /// The result as callers see it.
    fn finish(self, distinct_points: usize, warm: bool) -> KMeans {
        let (labels, centroids) = self.partition.renumbered();
        KMeans {
            labels,
            centroids,
            inertia: self.inertia,
            iterations: self.iterations,
            converged: self.converged,
            distinct_points,
            warm,
        }
    }
}

/// One cold start: seeding, Lloyd, exchanges.
fn restart(
    points: &Points<'_>,
    clusters: usize,
    number: u64,
    options: &KMeansOptions<'_>,
    limit: usize,
) -> Solution {
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    rng.set_stream(number);
    let centroids = match options.init {
        Init::PlusPlus => seeding::plus_plus(points, clusters, &mut rng),
        Init::Random => seeding::random(points.x, clusters, &mut rng),
    };
    polish(points, Partition::from_centroids(points, centroids), limit)
}

/// Lloyd iterations and then exchanges, from a given partition.
fn polish(points: &Points<'_>, mut partition: Partition, limit: usize) -> Solution {
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
