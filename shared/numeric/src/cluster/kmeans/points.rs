//! The points of one call, in the form that the kernels read.

use std::sync::OnceLock;

use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use super::single::SinglePoints;
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::simd::dispatch;
use crate::linalg::simd_pack::{BLOCK_REGISTERS, GROUP_POINTS, SimdPack, centre};

/// Points that one thread processes together: a multiple of the points of a block. The bounds of
/// the chunks depend on nothing else, so that sums over chunks are the same for any number of
/// threads.
pub(super) const CHUNK_POINTS: usize = 256 * GROUP_POINTS * BLOCK_REGISTERS;

/// Least number of points that are shared between threads; with fewer the threads would wait for
/// each other.
const PARALLEL_POINTS: usize = 100_000;

/// The points, packed and centred.
pub(super) struct CentredPack {
    pub(super) pack: SimdPack,
    /// Squared length of every packed point.
    pub(super) squares: Vec<f64>,
}

/// The points, as given, and packed and centred.
pub(super) struct Points<'a> {
    pub(super) x: &'a DenseMatrix,
    /// In double precision, once it is needed.
    pack: OnceLock<CentredPack>,
    /// In single precision, where its range is enough.
    pub(super) single: Option<SinglePoints>,
    /// Centre of the packed points.
    pub(super) centre: Vec<f64>,
    parallel: bool,
}

impl<'a> Points<'a> {
    /// Packs the rows of `x`, at least one. The threads of the surrounding pool share the chunks if
    /// `threads` is above 1 and there are enough points.
    pub(super) fn new(x: &'a DenseMatrix, threads: usize) -> Self {
        let centre = centre(x);
        let single = SinglePoints::new(x, &centre);
        let parallel = threads > 1 && x.rows() >= PARALLEL_POINTS;
        Self { x, pack: OnceLock::new(), single, centre, parallel }
    }

    /// The points in double precision.
    pub(super) fn pack(&self) -> &CentredPack {
        self.pack.get_or_init(|| {
            let (pack, _) = SimdPack::centred(self.x);
            let squares = pack.squares();
            CentredPack { pack, squares }
        })
    }

    /// True when double precision was needed.
    #[cfg(test)]
    pub(super) fn is_packed(&self) -> bool {
        self.pack.get().is_some()
    }

    /// Number of points.
    pub(super) fn len(&self) -> usize {
        self.x.rows()
    }

    /// Calls `work` with the number of each chunk of `size` values and the chunk itself. Returns
    /// the results in the order of the chunks.
    pub(super) fn for_chunks<T: Send, V: Send>(
        &self,
        values: &mut [V],
        size: usize,
        work: impl Fn(usize, &mut [V]) -> T + Sync,
    ) -> Vec<T> {
        if self.parallel {
            let chunks = values.par_chunks_mut(size).enumerate();
            return chunks.map(|(number, part)| work(number, part)).collect();
        }
        let chunks = values.chunks_mut(size).enumerate();
        chunks.map(|(number, part)| work(number, part)).collect()
    }

    /// As [`Points::for_chunks`], for values that are only read.
    pub(super) fn over_chunks<T: Send, V: Sync>(
        &self,
        values: &[V],
        size: usize,
        work: impl Fn(usize, &[V]) -> T + Sync,
    ) -> Vec<T> {
        if self.parallel {
            let chunks = values.par_chunks(size).enumerate();
            return chunks.map(|(number, part)| work(number, part)).collect();
        }
        values.chunks(size).enumerate().map(|(number, part)| work(number, part)).collect()
    }
}

/// Sum of squared distances of rows of `x` from the rows of `centroids` that `labels` name, the
/// first label being that of row `first`.
pub(super) fn spread(
    x: &DenseMatrix,
    first: usize,
    labels: &[u32],
    centroids: &DenseMatrix,
) -> f64 {
    dispatch(Spread { x, first, labels, centroids })
}

struct Spread<'a> {
    x: &'a DenseMatrix,
    first: usize,
    labels: &'a [u32],
    centroids: &'a DenseMatrix,
}

impl WithSimd for Spread<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let mut sums = [simd.splat_f64s(0.0); 2];
        for (i, &label) in self.labels.iter().enumerate() {
            let (row, row_rest) = S::as_simd_f64s(self.x.row(self.first + i));
            let (mean, mean_rest) = S::as_simd_f64s(self.centroids.row(label as usize));
            for (d, (x, m)) in row.iter().zip(mean).enumerate() {
                let gap = simd.sub_f64s(*x, *m);
                sums[d % 2] = simd.mul_add_e_f64s(gap, gap, sums[d % 2]);
            }
            if !row_rest.is_empty() {
                let x = simd.partial_load_f64s(row_rest);
                let gap = simd.sub_f64s(x, simd.partial_load_f64s(mean_rest));
                sums[1] = simd.mul_add_e_f64s(gap, gap, sums[1]);
            }
        }
        simd.reduce_sum_f64s(simd.add_f64s(sums[0], sums[1]))
    }
}

/// Largest squared length of a row of `x`.
pub(super) fn longest_square(x: &DenseMatrix) -> f64 {
    dispatch(LongestSquare(x))
}

struct LongestSquare<'a>(&'a DenseMatrix);

impl WithSimd for LongestSquare<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let mut longest = 0.0_f64;
        for row in self.0.iter_rows() {
            let (row, rest) = S::as_simd_f64s(row);
            let mut sum = simd.splat_f64s(0.0);
            for x in row {
                sum = simd.mul_add_e_f64s(*x, *x, sum);
            }
            if !rest.is_empty() {
                let x = simd.partial_load_f64s(rest);
                sum = simd.mul_add_e_f64s(x, x, sum);
            }
            longest = longest.max(simd.reduce_sum_f64s(sum));
        }
        longest
    }
}
