//! A partition of points into clusters, and Lloyd's iteration.

use super::assign::{Centroids, assign_chunk};
use super::points::{CHUNK_POINTS, Points, spread};
use super::sums::{Move, Sums};
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::vector::squared_distance;

/// One point in this many may change its cluster before all sums are recomputed: moving a point
/// costs two additions at places that are in no cache, adding it in order costs one.
const MOVED_POINT_SHARE: usize = 3;

/// Points per cluster in each part of a sum, so that the partial sums take at most half of the
/// memory of the points.
const POINTS_PER_SUM: usize = 4;

/// Labels together with the sizes and means of the clusters they describe.
pub(super) struct Partition {
    pub(super) labels: Vec<u32>,
    pub(super) sizes: Vec<usize>,
    pub(super) centroids: DenseMatrix,
    sums: Sums,
    /// True when the sums were recomputed since the last move of a point.
    fresh: bool,
}

impl Partition {
    /// Partition given by `labels`, all below `clusters`. Clusters without a point get one.
    pub(super) fn from_labels(points: &Points<'_>, labels: Vec<u32>, clusters: usize) -> Self {
        let dims = points.x.cols();
        let mut partition = Self {
            labels,
            sizes: vec![0; clusters],
            centroids: DenseMatrix::from_fn(clusters, dims, |_, _| 0.0),
            sums: Sums::zeros(clusters, dims),
            fresh: false,
        };
        partition.update(points);
        partition
    }

    /// Partition of the points by the nearest of the given centroids.
    pub(super) fn from_centroids(points: &Points<'_>, centroids: DenseMatrix) -> Self {
        let (clusters, dims) = (centroids.rows(), centroids.cols());
        let mut partition = Self {
            labels: vec![0; points.len()],
            sizes: vec![0; clusters],
            centroids,
            sums: Sums::zeros(clusters, dims),
            fresh: false,
        };
        partition.assign(points);
        partition.update(points);
        partition
    }

    /// Recomputes sizes and means. An empty cluster gets the point that is farthest from its
    /// centroid among clusters of at least two points.
    fn update(&mut self, points: &Points<'_>) {
        self.sizes.fill(0);
        for &label in &self.labels {
            self.sizes[label as usize] += 1;
        }
        self.set_means(points);
        for empty in 0..self.sizes.len() {
            if self.sizes[empty] > 0 {
                continue;
            }
            let Some(point) = self.farthest(points) else { break };
            self.transfer(points, point, empty);
        }
    }

    /// Means of all clusters; those of empty clusters are zero.
    fn set_means(&mut self, points: &Points<'_>) {
        let (clusters, dims) = (self.sizes.len(), self.centroids.cols());
        let part = (POINTS_PER_SUM * clusters).next_multiple_of(CHUNK_POINTS);
        let sums = points.over_chunks(&self.labels, part, |number, labels| {
            let mut sums = Sums::zeros(clusters, dims);
            sums.add_rows(points.x, number * part, labels);
            sums
        });
        let mut sums = sums.into_iter();
        if let Some(first) = sums.next() {
            self.sums = first;
        }
        for other in sums {
            self.sums.merge(&other);
        }
        for c in 0..clusters {
            self.set_mean(c);
        }
        self.fresh = true;
    }

    fn set_mean(&mut self, c: usize) {
        self.sums.mean(c, self.sizes[c], self.centroids.row_mut(c));
    }

    /// Recomputes all sums if they were changed point by point. True when the means stayed the same
    /// to the last digit.
    pub(super) fn refresh(&mut self, points: &Points<'_>) -> bool {
        if self.fresh {
            return true;
        }
        let before = self.centroids.clone();
        self.set_means(points);
        before == self.centroids
    }

    /// The point farthest from its centroid, in a cluster of more than one point.
    fn farthest(&self, points: &Points<'_>) -> Option<usize> {
        let mut best = None;
        for (i, &label) in self.labels.iter().enumerate() {
            let label = label as usize;
            let far = squared_distance(points.x.row(i), self.centroids.row(label));
            if self.sizes[label] > 1 && best.is_none_or(|(top, _)| far > top) {
                best = Some((far, i));
            }
        }
        best.map(|(_, i)| i)
    }

    /// Moves a point to cluster `to`.
    pub(super) fn transfer(&mut self, points: &Points<'_>, point: usize, to: usize) {
        let from = std::mem::replace(&mut self.labels[point], to as u32) as usize;
        self.sums
            .transfer(points.x, &[Move { point: point as u32, from: from as u32, to: to as u32 }]);
        self.sizes[from] -= 1;
        self.sizes[to] += 1;
        self.set_mean(from);
        self.set_mean(to);
        self.fresh = false;
    }

    /// Labels every point by its nearest centroid. Returns the number of changes, and the changes
    /// themselves if they are few.
    fn assign(&mut self, points: &Points<'_>) -> (usize, Option<Vec<Move>>) {
        let centroids = Centroids::new(points, &self.centroids);
        let changes = points.for_chunks(&mut self.labels, CHUNK_POINTS, |chunk, labels| {
            assign_chunk(points, &centroids, chunk, labels)
        });
        let count = changes.iter().map(|part| part.count).sum();
        let complete = changes.iter().all(|part| part.list.len() == part.count);
        let few = complete && count <= points.len() / MOVED_POINT_SHARE;
        (count, few.then(|| changes.into_iter().flat_map(|part| part.list).collect()))
    }

    /// Lloyd's iteration until no label changes. Returns the iterations, and true when it
    /// converged. A point equally near to its own and another centroid stays.
    pub(super) fn lloyd(&mut self, points: &Points<'_>, limit: usize) -> (usize, bool) {
        for iteration in 1..=limit {
            let (count, moves) = self.assign(points);
            match moves {
                Some(_) if count == 0 => {
                    if self.refresh(points) {
                        return (iteration, true);
                    }
                }
                Some(moves) => self.follow(points, &moves),
                None => self.update(points),
            }
        }
        self.refresh(points);
        (limit, false)
    }

    /// Updates sizes and means after `moves` that the labels already contain.
    fn follow(&mut self, points: &Points<'_>, moves: &[Move]) {
        for &Move { from, to, .. } in moves {
            self.sizes[from as usize] -= 1;
            self.sizes[to as usize] += 1;
        }
        if self.sizes.contains(&0) {
            self.update(points);
            return;
        }
        self.sums.transfer(points.x, moves);
        for c in 0..self.sizes.len() {
            self.set_mean(c);
        }
        self.fresh = false;
    }

    /// Sum of squared distances to the centroids.
    pub(super) fn inertia(&self, points: &Points<'_>) -> f64 {
        let parts = points.over_chunks(&self.labels, CHUNK_POINTS, |number, labels| {
            spread(points.x, number * CHUNK_POINTS, labels, &self.centroids)
        });
        parts.into_iter().sum()
    }

    /// Labels numbered by first appearance, and the centroids in that order.
    pub(super) fn renumbered(self) -> (Vec<usize>, DenseMatrix) {
        let mut order = Vec::new();
        let mut number = vec![usize::MAX; self.sizes.len()];
        for &label in &self.labels {
            let label = label as usize;
            if number[label] == usize::MAX {
                number[label] = order.len();
                order.push(label);
            }
        }
        let labels = self.labels.iter().map(|&l| number[l as usize]).collect();
        (labels, self.centroids.select_rows(&order))
    }
}
