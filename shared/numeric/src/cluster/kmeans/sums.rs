//! Sums of the points of each cluster, in about twice the precision of the points.
//!
//! Thousands of points move while k-means runs. With the rounding error of every addition kept
//! separately (Knuth, The Art of Computer Programming 2, section 4.2.2), a sum that was changed
//! point by point equals a recomputed one up to the last digit.

use pulp::{Simd, WithSimd};

use crate::linalg::matrix::DenseMatrix;
use crate::linalg::simd::{dispatch, prefetch};
use crate::linalg::simd_pack::GROUP_POINTS;

/// Moves between the one in work and the one whose row is prefetched: the rows are at random
/// places, which the processor cannot predict.
const PREFETCH_MOVES: usize = 8;

/// A point that moves from one cluster to another.
#[derive(Debug, Clone, Copy)]
pub(super) struct Move {
    pub(super) point: u32,
    pub(super) from: u32,
    pub(super) to: u32,
}

/// Sum of the rows of every cluster: `high` + `low`, each clusters × dimensions.
#[derive(Clone)]
pub(super) struct Sums {
    dims: usize,
    high: Vec<f64>,
    low: Vec<f64>,
}

impl Sums {
    /// Sums of no points.
    pub(super) fn zeros(clusters: usize, dims: usize) -> Self {
        Self { dims, high: vec![0.0; clusters * dims], low: vec![0.0; clusters * dims] }
    }

    /// Adds the rows of `x` from `first` on to the clusters of `labels`.
    pub(super) fn add_rows(&mut self, x: &DenseMatrix, first: usize, labels: &[u32]) {
        dispatch(AddRows { sums: self, x, first, labels });
    }

    /// Moves rows of `x` from one cluster to another.
    pub(super) fn transfer(&mut self, x: &DenseMatrix, moves: &[Move]) {
        dispatch(Transfer { sums: self, x, moves });
    }

    /// Adds other sums of the same shape.
    pub(super) fn merge(&mut self, other: &Self) {
        let sums = self.high.iter_mut().zip(&mut self.low);
        for ((high, low), (h, l)) in sums.zip(other.high.iter().zip(&other.low)) {
            let (sum, error) = two_sum(*high, *h);
            *high = sum;
            *low += error + l;
        }
    }

    /// Writes the mean of cluster `c`, of `size` points, into `mean`; zero if there are none.
    pub(super) fn mean(&self, c: usize, size: usize, mean: &mut [f64]) {
        let range = c * self.dims..(c + 1) * self.dims;
        let size = size.max(1) as f64;
        for ((mean, high), low) in
            mean.iter_mut().zip(&self.high[range.clone()]).zip(&self.low[range])
        {
            *mean = (high + low) / size;
        }
    }
}

/// a + b rounded, and its rounding error.
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let part = sum - a;
    (sum, (a - (sum - part)) + (b - part))
}

/// As [`two_sum`], with the error added to `low`.
#[inline(always)]
fn accumulate<S: Simd>(simd: S, high: &mut S::f64s, low: &mut S::f64s, x: S::f64s) {
    let sum = simd.add_f64s(*high, x);
    let part = simd.sub_f64s(sum, *high);
    let error = simd.sub_f64s(*high, simd.sub_f64s(sum, part));
    let error = simd.add_f64s(error, simd.sub_f64s(x, part));
    *high = sum;
    *low = simd.add_f64s(*low, error);
}

/// Adds `row` to the sum in two parts, or subtracts it.
#[inline(always)]
fn add_row<S: Simd>(simd: S, high: &mut [f64], low: &mut [f64], row: &[f64], minus: bool) {
    let sign = simd.splat_f64s(if minus { -0.0 } else { 0.0 });
    let (row, row_rest) = S::as_simd_f64s(row);
    let (high, high_rest) = S::as_mut_simd_f64s(high);
    let (low, low_rest) = S::as_mut_simd_f64s(low);
    for ((high, low), x) in high.iter_mut().zip(low).zip(row) {
        accumulate(simd, high, low, simd.xor_f64s(*x, sign));
    }
    if !row_rest.is_empty() {
        let mut sum = simd.partial_load_f64s(high_rest);
        let mut error = simd.partial_load_f64s(low_rest);
        let x = simd.partial_load_f64s(row_rest);
        accumulate(simd, &mut sum, &mut error, simd.xor_f64s(x, sign));
        simd.partial_store_f64s(high_rest, sum);
        simd.partial_store_f64s(low_rest, error);
    }
}

struct AddRows<'a> {
    sums: &'a mut Sums,
    x: &'a DenseMatrix,
    first: usize,
    labels: &'a [u32],
}

impl WithSimd for AddRows<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let dims = self.sums.dims;
        let per = dims / S::F64_LANES;
        if per > 0 && dims.is_multiple_of(S::F64_LANES) {
            // Most rows are whole registers.
            let (rows, _) = S::as_simd_f64s(&self.x.data()[self.first * dims..]);
            let (high, _) = S::as_mut_simd_f64s(&mut self.sums.high);
            let (low, _) = S::as_mut_simd_f64s(&mut self.sums.low);
            for (row, &label) in rows.chunks_exact(per).zip(self.labels) {
                let range = label as usize * per..(label as usize + 1) * per;
                let sums = high[range.clone()].iter_mut().zip(&mut low[range]);
                for ((high, low), x) in sums.zip(row) {
                    accumulate(simd, high, low, *x);
                }
            }
            return;
        }
        for (i, &label) in self.labels.iter().enumerate() {
            let range = label as usize * dims..(label as usize + 1) * dims;
            let (high, low) = (&mut self.sums.high[range.clone()], &mut self.sums.low[range]);
            add_row(simd, high, low, self.x.row(self.first + i), false);
        }
    }
}

struct Transfer<'a> {
    sums: &'a mut Sums,
    x: &'a DenseMatrix,
    moves: &'a [Move],
}

impl WithSimd for Transfer<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let dims = self.sums.dims;
        for (i, &Move { point, from, to }) in self.moves.iter().enumerate() {
            if let Some(later) = self.moves.get(i + PREFETCH_MOVES) {
                for line in self.x.row(later.point as usize).chunks(GROUP_POINTS) {
                    prefetch(&line[0], 0);
                }
            }
            let row = self.x.row(point as usize);
            for (cluster, minus) in [(from as usize, true), (to as usize, false)] {
                let range = cluster * dims..(cluster + 1) * dims;
                let (high, low) = (&mut self.sums.high[range.clone()], &mut self.sums.low[range]);
                add_row(simd, high, low, row, minus);
            }
        }
    }
}
