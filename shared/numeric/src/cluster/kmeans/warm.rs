//! A start from the previous division.

use std::collections::BTreeMap;

use super::assign::nearest;
use super::options::KMeansOptions;
use super::partition::Partition;
use super::points::Points;
use super::start::{Solution, polish};
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::vector::squared_distance;

/// The previous division, adapted to `clusters` clusters and refined; `None` when no point had a
/// cluster.
///
/// With as many clusters as before, points move only for a gain above the hysteresis. With fewer,
/// the largest old clusters survive; with more, the points farthest from all centroids open new
/// ones; both without hysteresis, as the number of clusters has changed.
pub(super) fn refine(
    points: &Points<'_>,
    labels: &[Option<usize>],
    clusters: usize,
    options: &KMeansOptions<'_>,
) -> Option<Solution> {
    let limit = options.max_iterations;
    let x = points.x;
    let old = old_clusters(labels);
    if old.is_empty() {
        return None;
    }
    if old.len() != clusters {
        let centroids = adapted_means(x, old, clusters);
        return Some(polish(points, Partition::from_centroids(points, centroids), limit));
    }
    let centroids = means(x, &old);
    let mut numbered = vec![None; labels.len()];
    for (c, members) in old.iter().enumerate() {
        for &i in members {
            numbered[i] = Some(c);
        }
    }
    let place = |(i, c): (usize, Option<usize>)| {
        c.unwrap_or_else(|| nearest(x.row(i), &centroids, 0)) as u32
    };
    let numbered = numbered.into_iter().enumerate().map(place).collect();
    let mut partition = Partition::from_labels(points, numbered, clusters);
    let (iterations, converged) = partition.exchange(points, limit, options.hysteresis);
    partition.refresh(points);
    Some(Solution { inertia: partition.inertia(points), partition, iterations, converged })
}

/// Members of every old cluster, clusters in order of first appearance.
fn old_clusters(labels: &[Option<usize>]) -> Vec<Vec<usize>> {
    let mut number: BTreeMap<usize, usize> = BTreeMap::new();
    let mut members: Vec<Vec<usize>> = Vec::new();
    for (i, label) in labels.iter().enumerate() {
        if let Some(label) = label {
            let c = *number.entry(*label).or_insert(members.len());
            if c == members.len() {
                members.push(Vec::new());
            }
            members[c].push(i);
        }
    }
    members
}

/// Exactly `clusters` centroids made from old clusters.
fn adapted_means(x: &DenseMatrix, mut old: Vec<Vec<usize>>, clusters: usize) -> DenseMatrix {
    old.sort_by_key(|members| std::cmp::Reverse(members.len()));
    old.truncate(clusters);
    let mut rows: Vec<f64> = means(x, &old).into_data();
    let mut gaps = vec![f64::INFINITY; x.rows()];
    let shrink = |gaps: &mut [f64], centroid: &[f64]| {
        for (gap, row) in gaps.iter_mut().zip(x.iter_rows()) {
            *gap = gap.min(squared_distance(row, centroid));
        }
    };
    for centroid in rows.chunks_exact(x.cols().max(1)) {
        shrink(&mut gaps, centroid);
    }
    for _ in old.len()..clusters {
        let farther = |best: usize, i: usize| if gaps[i] > gaps[best] { i } else { best };
        let next = (0..x.rows()).fold(0, farther);
        rows.extend_from_slice(x.row(next));
        shrink(&mut gaps, x.row(next));
    }
    let cols = x.cols();
    DenseMatrix::from_fn(clusters, cols, |c, j| rows[c * cols + j])
}

/// Mean of every group of points.
fn means(x: &DenseMatrix, groups: &[Vec<usize>]) -> DenseMatrix {
    DenseMatrix::from_fn(groups.len(), x.cols(), |c, j| {
        let sum: f64 = groups[c].iter().map(|&i| x.at(i, j)).sum();
        sum / groups[c].len() as f64
    })
}
