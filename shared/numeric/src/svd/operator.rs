//! αA* in the two orientations and precisions that the products of the Davidson method need.
//!
//! A product reads the rows of all neighbours of a node, which should be in the cache already.
//! Where the caller's order leaves neighbours far apart, nodes are renumbered (see
//! [`crate::graph::ordering`]). Outside of this module and of `davidson` only the caller's
//! order exists.

mod products;
mod rows;
pub(crate) mod symmetric;

use crate::graph::ordering::proximity_order;
use crate::linalg::matrix::SparseMatrix;
use rows::{Rows, sort_row};

/// αA and αAᵀ of an n × n adjacency matrix, renumbered.
#[derive(Debug, Default)]
pub(crate) struct KatzOperator {
    nodes: usize,
    alpha: f64,
    /// The caller's index of each node in the inner order, and the reverse.
    outer: Vec<u32>,
    inner: Vec<u32>,
    /// True when both are 0, 1, 2 …
    natural: bool,
    forward: Rows,
    backward: Rows,
    /// A new row.
    row: (Vec<u32>, Vec<f64>),
    /// Largest row sum of αA at the last assignment.
    heaviest: f64,
    /// Largest growth of a replaced row since the last [`KatzOperator::forget_growth`].
    growth: f64,
}

/// Orientation of a product.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Orientation {
    /// αA.
    Forward,
    /// αAᵀ.
    Backward,
}

impl KatzOperator {
    /// Builds αA in the existing buffers. Keeps the order of the nodes if `keep_order` and the
    /// number of nodes is the same. More than one of `threads` threads are used only inside the
    /// caller's pool.
    pub(crate) fn assign(
        &mut self,
        a: &SparseMatrix,
        alpha: f64,
        keep_order: bool,
        threads: usize,
    ) {
        let n = a.nodes();
        if !(keep_order && self.nodes == n && self.outer.len() == n) {
            self.find_order(a);
        }
        self.nodes = n;
        self.alpha = alpha;
        let order = (!self.natural).then_some((&self.outer[..], &self.inner[..]));
        self.heaviest = self.forward.assign(a, alpha, order, threads);
        self.backward.assign_transpose(&self.forward, threads);
    }

    /// Largest row sum of αA at the last assignment.
    pub(crate) fn heaviest(&self) -> f64 {
        self.heaviest
    }

    /// Largest growth of a row, the sum of what its weights have grown by, that was replaced since the
    /// last [`KatzOperator::forget_growth`].
    pub(crate) fn growth(&self) -> f64 {
        self.growth
    }

    pub(crate) fn forget_growth(&mut self) {
        self.growth = 0.0;
    }

    fn find_order(&mut self, a: &SparseMatrix) {
        let n = a.nodes();
        let order = proximity_order(a);
        self.natural = order.is_none();
        self.outer = order.unwrap_or_else(|| (0..n as u32).collect());
        self.inner.clear();
        self.inner.resize(n, 0);
        for (inner, &outer) in self.outer.iter().enumerate() {
            self.inner[outer as usize] = inner as u32;
        }
    }

    /// Number of nodes n.
    pub(crate) fn nodes(&self) -> usize {
        self.nodes
    }

    /// The decay α.
    pub(crate) fn alpha(&self) -> f64 {
        self.alpha
    }

    /// The inner index of each node of the caller.
    pub(crate) fn inner(&self) -> &[u32] {
        &self.inner
    }

    /// The caller's index of each inner one.
    pub(crate) fn outer(&self) -> &[u32] {
        &self.outer
    }

    /// True when a node, by its inner index, has no edge.
    pub(crate) fn is_isolated(&self, inner: usize) -> bool {
        let has_none = |orientation| self.rows(orientation).row(inner).0.is_empty();
        has_none(Orientation::Forward) && has_none(Orientation::Backward)
    }

    /// True when all edges have one back of the same weight.
    pub(crate) fn is_symmetric(&self) -> bool {
        (0..self.nodes).all(|i| self.forward.row(i) == self.backward.row(i))
    }

    /// Columns and weights of row `i` of αA or αAᵀ, in the inner order.
    pub(crate) fn row(&self, orientation: Orientation, i: usize) -> (&[u32], &[f64]) {
        self.rows(orientation).row(i)
    }

    fn rows(&self, orientation: Orientation) -> &Rows {
        match orientation {
            Orientation::Forward => &self.forward,
            Orientation::Backward => &self.backward,
        }
    }

    /// True when [`KatzOperator::replace_row`] has left so many gaps that a new assignment pays.
    pub(crate) fn scattered(&self) -> bool {
        self.forward.scattered() || self.backward.scattered()
    }

    /// Brings row `outer`, an index of the caller, up to date with `a`. False when it already was;
    /// otherwise appends to `touched` the inner indices of the columns in which the row has or had
    /// entries.
    pub(crate) fn replace_row(
        &mut self,
        a: &SparseMatrix,
        outer: usize,
        touched: &mut Vec<u32>,
    ) -> bool {
        let i = self.inner[outer] as usize;
        let (columns, weights) = (&mut self.row.0, &mut self.row.1);
        columns.clear();
        weights.clear();
        for (j, w) in a.row(outer) {
            columns.push(self.inner[j]);
            weights.push(self.alpha * w);
        }
        if !self.natural {
            sort_row(columns, weights);
        }
        let (old, old_weights) = self.forward.row(i);
        if old == columns && old_weights == weights {
            return false;
        }
        // Both rows ascend: one merge finds the new weight of each column.
        let (mut k, mut l, mut growth) = (0, 0, 0.0);
        while k < old.len() || l < columns.len() {
            let before = old.get(k).copied().unwrap_or(u32::MAX);
            let now = columns.get(l).copied().unwrap_or(u32::MAX);
            let column = before.min(now);
            let weight = if now == column { weights[l] } else { 0.0 };
            let old_weight = if before == column { old_weights[k] } else { 0.0 };
            growth += (weight - old_weight).max(0.0);
            if before != column || old_weight.to_bits() != weight.to_bits() {
                self.backward.set(column as usize, i as u32, weight);
            }
            touched.push(column);
            k += usize::from(before == column);
            l += usize::from(now == column);
        }
        self.growth = self.growth.max(growth);
        self.forward.replace(i, columns, weights);
        true
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    pub(super) fn random(n: usize, seed: u64) -> SparseMatrix {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let edges: Vec<_> = (0..4 * n)
            .map(|_| (rng.random_range(0..n), rng.random_range(0..n), rng.random::<f64>()))
            .collect();
        SparseMatrix::from_triplets(n, edges).unwrap()
    }

    #[test]
    fn replaced_rows_leave_the_operator_as_a_new_assignment_does() {
        let (n, alpha) = (5000, 0.3);
        let mut a = random(n, 1);
        let mut updated = KatzOperator::default();
        updated.assign(&a, alpha, false, 1);
        assert!(!updated.natural);
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..50 {
            let (changed, degree) = (rng.random_range(0..n), rng.random_range(0..9));
            let row: Vec<_> =
                (0..degree).map(|_| (changed, rng.random_range(0..n), rng.random())).collect();
            let rest = a.triplets().filter(|edge| edge.0 != changed);
            let next = SparseMatrix::from_triplets(n, rest.chain(row)).unwrap();
            let mut touched = Vec::new();
            assert!(updated.replace_row(&next, changed, &mut touched));
            assert!(!updated.replace_row(&next, changed, &mut touched));
            for j in a.row(changed).chain(next.row(changed)) {
                assert!(touched.contains(&updated.inner[j.0]));
            }
            a = next;
        }
        let mut fresh = KatzOperator {
            nodes: n,
            outer: updated.outer.clone(),
            inner: updated.inner.clone(),
            ..KatzOperator::default()
        };
        fresh.assign(&a, alpha, true, 1);
        for orientation in [Orientation::Forward, Orientation::Backward] {
            for i in 0..n {
                let row = |of: &KatzOperator| {
                    let (columns, weights) = of.rows(orientation).row(i);
                    (columns.to_vec(), weights.to_vec())
                };
                assert_eq!(row(&updated), row(&fresh));
                let single = |of: &KatzOperator| of.rows(orientation).row_single(i).1.to_vec();
                assert_eq!(single(&updated), single(&fresh));
            }
        }
    }
}
