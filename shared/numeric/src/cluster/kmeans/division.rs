//! The division itself: the best of all starts, and the previous division where it is kept.

use rayon::prelude::*;
use thiserror::Error;

use super::options::{KMeansOptions, KMeansOptionsError, ValidKMeansOptions};
use super::partition::Partition;
use super::points::Points;
use super::seeding::count_distinct;
use super::start::{Solution, restart};
use super::warm;
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::parallel::Threads;

/// Relative improvement of the inertia below which the earlier restart is kept.
pub(super) const INERTIA_TIE: f64 = 1e-12;

/// Restarts per thread between two comparisons of results: enough that no thread waits long for
/// the slowest one, and few enough that their labels take little memory.
pub(super) const RESTARTS_PER_THREAD: usize = 4;

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
    /// True when that start reached a fixed point within its iterations.
    pub converged: bool,
    /// Number of points that differ by more than [`DISTINCT_ROW_RATIO`](super::DISTINCT_ROW_RATIO), counted up to the
    /// number of clusters asked for. There are no more clusters than that.
    pub distinct_points: usize,
    /// True when the previous division, refined, was kept.
    pub warm: bool,
}

/// Why points could not be divided.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum KMeansError {
    /// A parameter is out of its range.
    #[error(transparent)]
    Options(#[from] KMeansOptionsError),
    /// There are no points.
    #[error("no points to divide")]
    NoPoints,
    /// There are more clusters than points.
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
}

/// Divides the rows of `x`, N × D, into at most k clusters so that the sum of squared distances
/// to the cluster means is small: [`ValidKMeansOptions::divide`] of checked `options`.
///
/// # Errors
/// [`KMeansError::Options`] for a parameter out of its range, otherwise as
/// [`ValidKMeansOptions::divide`].
pub fn kmeans(x: &DenseMatrix, options: &KMeansOptions<'_>) -> Result<KMeans, KMeansError> {
    options.check()?.divide(x)
}

/// [`kmeans`] that reports the number of finished restarts after each batch of them.
///
/// # Errors
/// As [`kmeans`].
pub fn kmeans_with_progress(
    x: &DenseMatrix,
    options: &KMeansOptions<'_>,
    progress: &mut dyn FnMut(usize),
) -> Result<KMeans, KMeansError> {
    options.check()?.divide_with_progress(x, progress)
}

/// Lloyd's iteration alone, from first centroids `first`, k × D: no seeding, no restarts, no
/// exchanges.
///
/// Points go to the nearest centroid, and centroids to the means of their points, until no label
/// changes, at most `max_iterations` times after the first assignment. A cluster without a point
/// gets the one farthest from its centroid. For callers with first centroids of their own, and for
/// comparisons with other implementations. `threads` is as in [`KMeansOptions`]; only many points
/// are shared between threads.
///
/// # Errors
/// [`KMeansError`] for no points, no threads, an impossible number of centroids, or centroids with
/// another number of columns than the points.
pub fn lloyd(
    x: &DenseMatrix,
    first: &DenseMatrix,
    max_iterations: usize,
    threads: usize,
) -> Result<KMeans, KMeansError> {
    let options = KMeansOptions { threads, ..KMeansOptions::new(first.rows()) };
    check_points(x, &options)?;
    options.check()?;
    if x.cols() != first.cols() {
        return Err(KMeansError::Dimensions { points: x.cols(), centroids: first.cols() });
    }
    let threads = Threads::new(threads);
    let found = threads.run(|| {
        let points = Points::new(x, threads.count());
        let mut partition = Partition::from_centroids(&points, first.clone());
        let (iterations, converged) = partition.lloyd(&points, max_iterations);
        let inertia = partition.inertia(&points);
        Solution { partition, inertia, iterations, converged }
    });
    Ok(finish(found, count_distinct(x, first.rows()), false))
}

impl ValidKMeansOptions<'_> {
    /// Divides the rows of `x`, N × D, into at most k clusters so that the sum of squared
    /// distances to the cluster means is small.
    ///
    /// Takes the best of all restarts. With `warm_labels` the previous division is refined by
    /// moving single points whose advantage exceeds the hysteresis h, and is kept unless a restart
    /// is better by more than the factor 1 + h: unchanged points keep their labels, and noise on a
    /// border moves no point. No cluster is empty, and there are at most as many as distinct
    /// points.
    ///
    /// # Errors
    /// [`KMeansError`] for no points, more clusters than points, or warm labels that do not fit.
    pub fn divide(&self, x: &DenseMatrix) -> Result<KMeans, KMeansError> {
        self.divide_with_progress(x, &mut |_| {})
    }

    /// [`ValidKMeansOptions::divide`] that reports the number of finished restarts after each
    /// batch of them.
    ///
    /// # Errors
    /// As [`ValidKMeansOptions::divide`].
    pub fn divide_with_progress(
        &self,
        x: &DenseMatrix,
        progress: &mut dyn FnMut(usize),
    ) -> Result<KMeans, KMeansError> {
        let options = self.get();
        check_points(x, options)?;
        let threads = Threads::new(options.threads);
        let distinct_points = count_distinct(x, options.clusters);
        let clusters = options.clusters.min(distinct_points);
        let points = threads.run(|| Points::new(x, threads.count()));
        let best = best_restart(&points, clusters, options, &threads, progress);
        let warm = options.warm_labels.and_then(|labels| {
            threads.run(|| keep_previous(&points, labels, clusters, options, best.inertia))
        });
        let kept = warm.is_some();
        Ok(finish(warm.unwrap_or(best), distinct_points, kept))
    }
}

/// Refuses parameters that do not fit the points.
fn check_points(x: &DenseMatrix, options: &KMeansOptions<'_>) -> Result<(), KMeansError> {
    let (points, clusters) = (x.rows(), options.clusters);
    if points == 0 {
        return Err(KMeansError::NoPoints);
    }
    if clusters > points {
        return Err(KMeansError::Clusters { clusters, points });
    }
    if let Some(labels) = options.warm_labels.map(<[_]>::len)
        && labels != points
    {
        return Err(KMeansError::WarmLabels { labels, points });
    }
    Ok(())
}

/// The cold start of the least inertia; the first of those within [`INERTIA_TIE`].
fn best_restart(
    points: &Points<'_>,
    clusters: usize,
    options: &KMeansOptions<'_>,
    threads: &Threads,
    progress: &mut dyn FnMut(usize),
) -> Solution {
    let mut best = threads.run(|| restart(points, clusters, 0, options));
    progress(1);
    let parallel = threads.count() > 1;
    let batch = if parallel { threads.count() * RESTARTS_PER_THREAD } else { 1 };
    for first in (1..options.restarts).step_by(batch) {
        let numbers = first..options.restarts.min(first + batch);
        let finished = numbers.end;
        let run = |number| restart(points, clusters, number as u64, options);
        let found: Vec<Solution> = threads.run(|| match parallel {
            true => numbers.into_par_iter().map(run).collect(),
            false => numbers.map(run).collect(),
        });
        for next in found {
            if next.inertia < best.inertia * (1.0 - INERTIA_TIE) {
                best = next;
            }
        }
        progress(finished);
    }
    best
}

/// The previous division, refined, unless the inertia `best` of a cold start is better by more
/// than the hysteresis.
fn keep_previous(
    points: &Points<'_>,
    labels: &[Option<usize>],
    clusters: usize,
    options: &KMeansOptions<'_>,
    best: f64,
) -> Option<Solution> {
    let kept = warm::refine(points, labels, clusters, options)?;
    // Inertia at the rounding noise of the spread of the points counts as none.
    let all = Partition::from_labels(points, vec![0; points.len()], 1);
    let noise = INERTIA_TIE * all.inertia(points);
    (kept.inertia <= (1.0 + options.hysteresis) * best + noise).then_some(kept)
}

/// The result as callers see it.
fn finish(found: Solution, distinct_points: usize, warm: bool) -> KMeans {
    let Solution { partition, inertia, iterations, converged } = found;
    let (labels, centroids) = partition.renumbered();
    KMeans { labels, centroids, inertia, iterations, converged, distinct_points, warm }
}
