//! A partition of points into clusters, and the two ways to improve it.

use crate::matrix::DenseMatrix;

/// Relative gain below which a single point is not moved; rounding could make it move for ever.
const MIN_GAIN: f64 = 1e-10;

/// Labels together with the sizes and means of the clusters they describe.
#[derive(Clone)]
pub(super) struct Partition {
    pub(super) labels: Vec<usize>,
    sizes: Vec<usize>,
    centroids: DenseMatrix,
}

impl Partition {
    /// Partition given by `labels`, all below `clusters`. Clusters without a point get one.
    pub(super) fn from_labels(x: &DenseMatrix, labels: Vec<usize>, clusters: usize) -> Self {
        let mut partition = Self {
            labels,
            sizes: vec![0; clusters],
            centroids: DenseMatrix::from_fn(clusters, x.cols(), |_, _| 0.0),
        };
        partition.update(x);
        partition
    }

    /// Partition of the points by the nearest of the given centroids.
    pub(super) fn from_centroids(x: &DenseMatrix, centroids: DenseMatrix) -> Self {
        let nearest = |row| nearest(row, &centroids, 0);
        let labels = x.iter_rows().map(nearest).collect();
        let mut partition = Self { labels, sizes: vec![0; centroids.rows()], centroids };
        partition.update(x);
        partition
    }

    /// Recomputes sizes and means. An empty cluster takes the point that lies farthest from its
    /// centroid among clusters that can spare one.
    fn update(&mut self, x: &DenseMatrix) {
        self.count();
        if let Some(first) = self.sizes.iter().position(|&n| n == 0) {
            self.set_means(x);
            for empty in first..self.sizes.len() {
                if self.sizes[empty] > 0 {
                    continue;
                }
                let Some(point) = self.farthest(x) else { break };
                self.sizes[self.labels[point]] -= 1;
                self.labels[point] = empty;
                self.sizes[empty] = 1;
                self.set_means(x);
            }
        }
        self.set_means(x);
    }

    fn count(&mut self) {
        self.sizes.fill(0);
        for &label in &self.labels {
            self.sizes[label] += 1;
        }
    }

    /// Means of all clusters; those of empty clusters are zero.
    fn set_means(&mut self, x: &DenseMatrix) {
        self.centroids.data_mut().fill(0.0);
        for (row, &label) in x.iter_rows().zip(&self.labels) {
            for (sum, value) in self.centroids.row_mut(label).iter_mut().zip(row) {
                *sum += value;
            }
        }
        for (c, &size) in self.sizes.iter().enumerate() {
            let size = size.max(1) as f64;
            for sum in self.centroids.row_mut(c) {
                *sum /= size;
            }
        }
    }

    /// The point farthest from its centroid, in a cluster of more than one point.
    fn farthest(&self, x: &DenseMatrix) -> Option<usize> {
        let mut best = None;
        for (i, &label) in self.labels.iter().enumerate() {
            let far = squared_distance(x.row(i), self.centroids.row(label));
            if self.sizes[label] > 1 && best.is_none_or(|(top, _)| far > top) {
                best = Some((far, i));
            }
        }
        best.map(|(_, i)| i)
    }

    /// Lloyd's iteration until no label changes; returns the iterations and whether it got there.
    /// A point equally near to its own and another centroid stays.
    pub(super) fn lloyd(&mut self, x: &DenseMatrix, limit: usize) -> (usize, bool) {
        for iteration in 1..=limit {
            let mut changed = false;
            for (row, label) in x.iter_rows().zip(&mut self.labels) {
                let next = nearest(row, &self.centroids, *label);
                changed |= next != *label;
                *label = next;
            }
            if !changed {
                return (iteration, true);
            }
            self.update(x);
        }
        (limit, false)
    }

    /// Moves single points to other clusters while that lowers the inertia; returns the passes
    /// and whether a pass without moves was reached.
    ///
    /// Taking point x out of a cluster of n points with mean φ lowers the inertia by
    /// n/(n−1)·‖x−φ‖², adding it to one raises it by n/(n+1)·‖x−φ‖² (Hartigan and Wong 1979).
    /// The gain must exceed the share `hysteresis` of the former.
    pub(super) fn exchange(
        &mut self,
        x: &DenseMatrix,
        limit: usize,
        hysteresis: f64,
    ) -> (usize, bool) {
        let keep = 1.0 - hysteresis.max(MIN_GAIN);
        for pass in 1..=limit {
            let mut moved = false;
            for i in 0..x.rows() {
                let own = self.labels[i];
                if self.sizes[own] < 2 {
                    continue;
                }
                let (to, cost) = self.cheapest_insertion(x.row(i), own);
                let n = self.sizes[own] as f64;
                let saved = n / (n - 1.0) * squared_distance(x.row(i), self.centroids.row(own));
                if cost < saved * keep {
                    self.transfer(x.row(i), i, to);
                    moved = true;
                }
            }
            if !moved {
                return (pass, true);
            }
            // Incremental means drift by rounding.
            self.set_means(x);
        }
        (limit, false)
    }

    /// The other cluster whose inertia rises least by taking in `row`, and by how much.
    fn cheapest_insertion(&self, row: &[f64], own: usize) -> (usize, f64) {
        let mut best = (own, f64::INFINITY);
        for (c, centroid) in self.centroids.iter_rows().enumerate() {
            if c == own {
                continue;
            }
            let n = self.sizes[c] as f64;
            let cost = n / (n + 1.0) * squared_distance(row, centroid);
            if cost < best.1 {
                best = (c, cost);
            }
        }
        best
    }

    fn transfer(&mut self, row: &[f64], point: usize, to: usize) {
        let from = std::mem::replace(&mut self.labels[point], to);
        self.sizes[from] -= 1;
        self.sizes[to] += 1;
        let (left, joined) = (self.sizes[from] as f64, self.sizes[to] as f64);
        for (mean, value) in self.centroids.row_mut(from).iter_mut().zip(row) {
            *mean += (*mean - value) / left;
        }
        for (mean, value) in self.centroids.row_mut(to).iter_mut().zip(row) {
            *mean += (value - *mean) / joined;
        }
    }

    /// Sum of squared distances to the centroids.
    pub(super) fn inertia(&self, x: &DenseMatrix) -> f64 {
        let rows = x.iter_rows().zip(&self.labels);
        rows.map(|(row, &c)| squared_distance(row, self.centroids.row(c))).sum()
    }

    /// Labels numbered by first appearance, and the centroids in that order.
    pub(super) fn renumbered(self) -> (Vec<usize>, DenseMatrix) {
        let mut order = Vec::new();
        let mut number = vec![usize::MAX; self.sizes.len()];
        for &label in &self.labels {
            if number[label] == usize::MAX {
                number[label] = order.len();
                order.push(label);
            }
        }
        let labels = self.labels.iter().map(|&l| number[l]).collect();
        (labels, self.centroids.select_rows(&order))
    }
}

/// Index of the centroid nearest to `row`; `current` wins ties, then the smallest index.
pub(super) fn nearest(row: &[f64], centroids: &DenseMatrix, current: usize) -> usize {
    let mut best = (current, squared_distance(row, centroids.row(current)));
    for (c, centroid) in centroids.iter_rows().enumerate() {
        let far = squared_distance(row, centroid);
        if far < best.1 {
            best = (c, far);
        }
    }
    best.0
}

/// Squared Euclidean distance.
pub(crate) fn squared_distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum()
}
