//! A square matrix and updates of low rank that are not added to it yet.
//!
//! Adding an update of rank k to all n² entries costs 2kn² operations and a pass over a matrix that,
//! from some hundred rows on, is larger than the caches. Kept as factors it costs nothing until an
//! entry is asked for. Many are added together by one blocked product.

use pulp::Arch;

use crate::linalg::backend::small_lu::{add_product, add_transposed_product};
use crate::linalg::vector::{dot, zeros};

/// Rank from which on updates are added to the matrix: reading rows through the factors then costs
/// about as much as adding one update. 24 and 80 were no faster at 1,000 and 2,000 nodes.
pub(crate) const MAX_PENDING_RANK: usize = 48;

/// B + LᵀR, m × m, with L and R of r rows each.
#[derive(Debug, Default)]
pub(crate) struct LowRankSum {
    side: usize,
    /// B in rows.
    base: Vec<f64>,
    /// L and R in rows.
    left: Vec<f64>,
    right: Vec<f64>,
    rank: usize,
    /// A vector z, and (B + LᵀR) z; empty when it is not known.
    vector: Vec<f64>,
    image: Vec<f64>,
}

impl LowRankSum {
    /// Replaces everything by a matrix of `side` rows, given by rows.
    pub(crate) fn replace(&mut self, side: usize, base: Vec<f64>) {
        debug_assert_eq!(base.len(), side * side);
        self.side = side;
        self.base = base;
        self.forget_updates();
        self.left.reserve(MAX_PENDING_RANK * side);
        self.right.reserve(MAX_PENDING_RANK * side);
    }

    /// Frees the matrix, which has no rows afterwards.
    pub(crate) fn clear(&mut self) {
        self.replace(0, Vec::new());
    }

    fn forget_updates(&mut self) {
        self.left.clear();
        self.right.clear();
        self.rank = 0;
        self.image.clear();
    }

    /// Number of rows, m.
    pub(crate) fn side(&self) -> usize {
        self.side
    }

    /// Rank of the updates that are not added yet, r.
    pub(crate) fn rank(&self) -> usize {
        self.rank
    }

    /// Row `i` of B.
    pub(crate) fn base_row(&self, i: usize) -> &[f64] {
        &self.base[i * self.side..(i + 1) * self.side]
    }

    /// The rows of B.
    pub(crate) fn base_rows(&self) -> impl Iterator<Item = &[f64]> {
        self.base.chunks_exact(self.side.max(1))
    }

    /// L in rows, r × m.
    pub(crate) fn left(&self) -> &[f64] {
        &self.left
    }

    /// R in rows, r × m.
    pub(crate) fn right(&self) -> &[f64] {
        &self.right
    }

    /// Column `i` of L.
    pub(crate) fn left_at(&self, i: usize) -> impl Iterator<Item = f64> {
        self.left.chunks_exact(self.side.max(1)).map(move |row| row[i])
    }

    /// The entry in row `i` and column `j`.
    pub(crate) fn entry(&self, i: usize, j: usize) -> f64 {
        let right = self.right.chunks_exact(self.side.max(1)).map(|row| row[j]);
        let pending: f64 = self.left_at(i).zip(right).map(|(left, right)| left * right).sum();
        self.base_row(i)[j] + pending
    }

    /// Adds `left` `right`, m × k and k × m in rows, and keeps the product with the vector up to date.
    pub(crate) fn add(&mut self, left: &[f64], right: &[f64], k: usize) {
        let m = self.side;
        if self.rank + k >= MAX_PENDING_RANK {
            self.add_updates();
            self.image.clear();
            add_product(left, right, &mut self.base, k, m);
            return;
        }
        for a in 0..k {
            self.left.extend(left.iter().skip(a).step_by(k));
        }
        self.right.extend_from_slice(right);
        self.rank += k;
        if self.image.is_empty() {
            return;
        }
        for (right, a) in right.chunks_exact(m).zip(0..) {
            let along = dot(right, &self.vector);
            for (image, left) in self.image.iter_mut().zip(left.chunks_exact(k)) {
                *image += along * left[a];
            }
        }
    }

    /// Adds all updates to B.
    pub(crate) fn add_updates(&mut self) {
        if self.rank > 0 {
            add_transposed_product(&self.left, &self.right, &mut self.base, self.rank, self.side);
            self.forget_updates();
        }
    }

    /// Sets row and column `at` to zero.
    pub(crate) fn clear_line(&mut self, at: usize) {
        let m = self.side;
        if let Some(&z) = self.vector.get(at).filter(|_| !self.image.is_empty()) {
            for i in 0..m {
                let entry = self.entry(i, at);
                self.image[i] -= entry * z;
            }
            self.image[at] = 0.0;
        }
        self.base[at * m..(at + 1) * m].fill(0.0);
        self.base.chunks_exact_mut(m).for_each(|row| row[at] = 0.0);
        for rows in [&mut self.left, &mut self.right] {
            rows.chunks_exact_mut(m).for_each(|row| row[at] = 0.0);
        }
    }

    /// Adds rows and columns of zeros until there are `side`.
    pub(crate) fn grow(&mut self, side: usize) {
        self.add_updates();
        self.image.clear();
        let old = self.side;
        self.base.resize(side * side, 0.0);
        // In descending order, so that no row is overwritten before it has moved.
        for i in (1..old).rev() {
            self.base.copy_within(i * old..(i + 1) * old, i * side);
            self.base[i * side + old..(i + 1) * side].fill(0.0);
        }
        if old > 0 {
            self.base[old..side].fill(0.0);
        }
        self.side = side;
    }

    /// A vector z, and the product of the matrix with it. Where none is known, all updates are added to B, and `draw`
    /// fills the vector.
    pub(crate) fn image(&mut self, draw: impl FnOnce(&mut [f64])) -> (&[f64], &[f64]) {
        if self.image.is_empty() && self.side > 0 {
            self.add_updates();
            draw(zeros(&mut self.vector, self.side));
            let vector = &self.vector;
            Arch::new().dispatch(|| {
                self.image
                    .extend(self.base.chunks_exact(self.side).map(|row| dot_in_lanes(row, vector)));
            });
        }
        (&self.vector, &self.image)
    }
}

/// Σ a_i b_i in eight sums, so that registers of any width are filled.
#[inline(always)]
fn dot_in_lanes(a: &[f64], b: &[f64]) -> f64 {
    let (a, a_rest) = a.as_chunks::<8>();
    let (b, b_rest) = b.as_chunks::<8>();
    let mut sums = [0.0; 8];
    for (a, b) in a.iter().zip(b) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    sums.iter().sum::<f64>() + dot(a_rest, b_rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The entries of `sum`, and its vector with the image that it claims.
    fn check(sum: &mut LowRankSum, wanted: &[f64]) {
        let m = sum.side();
        for (at, wanted) in wanted.iter().enumerate() {
            assert!((sum.entry(at / m, at % m) - wanted).abs() < 1e-12);
        }
        let (vector, image) = sum.image(|vector| vector.fill(1.0));
        for (row, image) in wanted.chunks_exact(m).zip(image) {
            assert!((dot(row, vector) - image).abs() < 1e-12);
        }
    }

    #[test]
    fn entries_and_image_follow_updates_cleared_lines_and_growth() {
        let m = 11;
        let mut wanted: Vec<f64> = (0..m * m).map(|at| (at % 7) as f64).collect();
        let mut sum = LowRankSum::default();
        sum.replace(m, wanted.clone());
        check(&mut sum, &wanted);
        // More than are gathered, of several ranks.
        for step in 0..MAX_PENDING_RANK {
            let k = 1 + step % 3;
            let left: Vec<f64> = (0..m * k).map(|at| ((at + step) % 5) as f64 - 2.0).collect();
            let right: Vec<f64> = (0..m * k).map(|at| ((at * step) % 3) as f64 - 1.0).collect();
            add_product(&left, &right, &mut wanted, k, m);
            sum.add(&left, &right, k);
            check(&mut sum, &wanted);
        }
        for at in [0, 6, m - 1] {
            sum.clear_line(at);
            wanted[at * m..(at + 1) * m].fill(0.0);
            wanted.iter_mut().skip(at).step_by(m).for_each(|entry| *entry = 0.0);
            check(&mut sum, &wanted);
        }
        sum.grow(m + 2);
        let grown: Vec<f64> = (0..(m + 2) * (m + 2))
            .map(|at| (at / (m + 2), at % (m + 2)))
            .map(|(i, j)| if i.max(j) < m { wanted[i * m + j] } else { 0.0 })
            .collect();
        check(&mut sum, &grown);
        sum.add_updates();
        assert_eq!(sum.rank(), 0);
        check(&mut sum, &grown);
    }
}
