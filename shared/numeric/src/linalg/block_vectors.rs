//! Products of blocks of vectors: n rows of a few values each, with small matrices.
//!
//! The products of the library repack their factors first, which for these shapes takes longer than
//! the arithmetic. Here rows stay in place, and tiles of the result stay in registers. All matrices
//! are row-major, in memory of the caller. The number of columns that are written is a multiple of
//! [`COLUMN_MULTIPLE`], so that there are no remainders.

use pulp::{Simd, WithSimd};

use super::simd::dispatch;

/// Columns of a block are a multiple of this: the doubles of the widest registers.
pub(crate) const COLUMN_MULTIPLE: usize = 8;

/// Rows of a block that are processed together, as many as fit the first-level cache.
pub(crate) const CHUNK_ROWS: usize = 64;

/// Rows of a tile of the result. With three registers of columns its sums fill the 32 registers of
/// the widest instruction sets.
const TILE_ROWS: usize = 8;

/// A view of some columns of a block of vectors whose rows start `stride` values apart.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BlockView<'a> {
    pub(crate) data: &'a [f64],
    pub(crate) stride: usize,
    pub(crate) first: usize,
    pub(crate) columns: usize,
}

impl<'a> BlockView<'a> {
    /// The first `columns` values of rows of `stride` values.
    pub(crate) fn new(data: &'a [f64], stride: usize, columns: usize) -> Self {
        Self { data, stride, first: 0, columns }
    }

    /// The columns from `first` on.
    pub(crate) fn from(self, first: usize) -> Self {
        Self { first: self.first + first, columns: self.columns - first, ..self }
    }

    #[inline(always)]
    fn row(&self, i: usize) -> &'a [f64] {
        &self.data[i * self.stride + self.first..][..self.columns]
    }

    fn rows(&self) -> usize {
        self.data.len() / self.stride.max(1)
    }
}

/// Adds Aᵀ B to `out`, which has a row of `out_stride` values for each column of A. The columns of B
/// are a multiple of [`COLUMN_MULTIPLE`].
pub(crate) fn add_gram(a: BlockView<'_>, b: BlockView<'_>, out: &mut [f64], out_stride: usize) {
    dispatch(Gram { a, b, out, out_stride });
}

/// Writes A T to the columns of `out` from `first` on, rows of `out_stride` values. T has a row for
/// each column of A; its columns are a multiple of [`COLUMN_MULTIPLE`].
pub(crate) fn product(
    a: BlockView<'_>,
    t: BlockView<'_>,
    out: &mut [f64],
    out_stride: usize,
    first: usize,
) {
    dispatch(Product { a, t, out, out_stride, first });
}

/// Replaces the columns of `rows` from `first` on by those of `rows` T. T has one row per column
/// that is read, and one column, a multiple of [`COLUMN_MULTIPLE`] in all, per column that is
/// written.
pub(crate) fn transform(
    rows: &mut [f64],
    stride: usize,
    t: BlockView<'_>,
    first: usize,
    scratch: &mut [f64],
) {
    let read = t.rows();
    let scratch = &mut scratch[..TILE_ROWS * read];
    for rows in rows.chunks_mut(TILE_ROWS * stride) {
        let count = rows.len() / stride;
        for (to, from) in scratch.chunks_exact_mut(read).zip(rows.chunks_exact(stride)) {
            to.copy_from_slice(&from[..read]);
        }
        product(BlockView::new(&scratch[..count * read], read, read), t, rows, stride, first);
    }
}

/// Length of the scratch space of [`transform`] for `read` columns that are read.
pub(crate) fn transform_scratch(read: usize) -> usize {
    TILE_ROWS * read
}

struct Gram<'a, 'b> {
    a: BlockView<'a>,
    b: BlockView<'a>,
    out: &'b mut [f64],
    out_stride: usize,
}

impl WithSimd for Gram<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let registers = self.b.columns / S::F64_LANES;
        let mut at = 0;
        while at < registers {
            // Three registers at a time, but not three and one.
            at += match registers - at {
                1 => self.columns::<S, 1>(simd, at),
                2 | 4 => self.columns::<S, 2>(simd, at),
                _ => self.columns::<S, 3>(simd, at),
            };
        }
    }
}

impl Gram<'_, '_> {
    #[inline(always)]
    fn columns<S: Simd, const C: usize>(&mut self, simd: S, at: usize) -> usize {
        let mut p = 0;
        while p + TILE_ROWS <= self.a.columns {
            // Instruction sets with narrow registers have fewer of them.
            if S::F64_LANES >= 8 {
                self.tile::<S, TILE_ROWS, C>(simd, p, at);
            } else {
                self.tile::<S, 4, C>(simd, p, at);
                self.tile::<S, 4, C>(simd, p + 4, at);
            }
            p += TILE_ROWS;
        }
        while p < self.a.columns {
            self.tile::<S, 1, C>(simd, p, at);
            p += 1;
        }
        C
    }

    #[inline(always)]
    fn tile<S: Simd, const P: usize, const C: usize>(&mut self, simd: S, p: usize, at: usize) {
        let lanes = S::F64_LANES;
        let mut sums = [[simd.splat_f64s(0.0); C]; P];
        for i in 0..self.a.rows().min(self.b.rows()) {
            let x: &[f64] = &self.a.row(i)[p..p + P];
            let y = S::as_simd_f64s(&self.b.row(i)[at * lanes..(at + C) * lanes]).0;
            let mut own = [simd.splat_f64s(0.0); C];
            own.copy_from_slice(y);
            for k in 0..P {
                let x = simd.splat_f64s(x[k]);
                for c in 0..C {
                    sums[k][c] = simd.mul_add_e_f64s(x, own[c], sums[k][c]);
                }
            }
        }
        for (k, sums) in sums.iter().enumerate() {
            let row = &mut self.out[(p + k) * self.out_stride + at * lanes..][..C * lanes];
            for (to, sum) in S::as_mut_simd_f64s(row).0.iter_mut().zip(sums) {
                *to = simd.add_f64s(*to, *sum);
            }
        }
    }
}

struct Product<'a, 'b> {
    a: BlockView<'a>,
    t: BlockView<'a>,
    out: &'b mut [f64],
    out_stride: usize,
    first: usize,
}

impl WithSimd for Product<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let registers = self.t.columns / S::F64_LANES;
        let rows = self.a.rows();
        let mut at = 0;
        while at < registers {
            at += match registers - at {
                1 => self.columns::<S, 1>(simd, at, rows),
                2 | 4 => self.columns::<S, 2>(simd, at, rows),
                _ => self.columns::<S, 3>(simd, at, rows),
            };
        }
    }
}

impl Product<'_, '_> {
    #[inline(always)]
    fn columns<S: Simd, const C: usize>(&mut self, simd: S, at: usize, rows: usize) -> usize {
        let mut i = 0;
        while i + TILE_ROWS <= rows {
            if S::F64_LANES >= 8 {
                self.tile::<S, TILE_ROWS, C>(simd, i, at);
            } else {
                self.tile::<S, 4, C>(simd, i, at);
                self.tile::<S, 4, C>(simd, i + 4, at);
            }
            i += TILE_ROWS;
        }
        while i < rows {
            self.tile::<S, 1, C>(simd, i, at);
            i += 1;
        }
        C
    }

    #[inline(always)]
    fn tile<S: Simd, const R: usize, const C: usize>(&mut self, simd: S, i: usize, at: usize) {
        let lanes = S::F64_LANES;
        let inner = self.a.columns;
        let rows: [&[f64]; R] = core::array::from_fn(|r| &self.a.row(i + r)[..inner]);
        let mut sums = [[simd.splat_f64s(0.0); C]; R];
        let start = self.t.first + at * lanes;
        for (p, t) in self.t.data.chunks(self.t.stride).take(inner).enumerate() {
            let t = S::as_simd_f64s(&t[start..start + C * lanes]).0;
            let mut own = [simd.splat_f64s(0.0); C];
            own.copy_from_slice(t);
            for r in 0..R {
                let x = simd.splat_f64s(rows[r][p]);
                for c in 0..C {
                    sums[r][c] = simd.mul_add_e_f64s(x, own[c], sums[r][c]);
                }
            }
        }
        for (r, sums) in sums.iter().enumerate() {
            let start = (i + r) * self.out_stride + self.first + at * lanes;
            let row = &mut self.out[start..start + C * lanes];
            S::as_mut_simd_f64s(row).0.copy_from_slice(sums);
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn random(len: usize) -> Vec<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(len as u64);
        (0..len).map(|_| rng.random::<f64>() - 0.5).collect()
    }

    #[test]
    fn products_equal_the_definition_in_every_shape() {
        for (rows, inner, width) in
            [(1, 1, 8), (7, 13, 16), (66, 24, 24), (131, 40, 32), (9, 5, 48)]
        {
            let (stride, other) = (inner + 3, width + 5);
            let (a, b, t) = (random(rows * stride), random(rows * other), random(inner * width));
            let left = BlockView::new(&a, stride, inner);
            let mut gram = vec![1.0; inner * width];
            add_gram(left, BlockView::new(&b, other, width), &mut gram, width);
            let mut out = random(rows * other);
            product(left, BlockView::new(&t, width, width), &mut out, other, 5);
            for q in 0..width {
                for p in 0..inner {
                    let term = |i: usize| a[i * stride + p] * b[i * other + q];
                    let wanted = 1.0 + (0..rows).map(term).sum::<f64>();
                    assert!((gram[p * width + q] - wanted).abs() < 1e-12);
                }
                for i in 0..rows {
                    let term = |p: usize| a[i * stride + p] * t[p * width + q];
                    let wanted: f64 = (0..inner).map(term).sum();
                    assert!((out[i * other + 5 + q] - wanted).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn columns_are_transformed_where_they_stand() {
        let (rows, stride, read, width) = (21, 24, 19, 16);
        let (before, t) = (random(rows * stride), random(read * width));
        let t = BlockView::new(&t, width, width);
        let (mut after, mut wanted) = (before.clone(), vec![0.0; rows * width]);
        transform(&mut after, stride, t, 8, &mut vec![0.0; transform_scratch(read)]);
        product(BlockView::new(&before, stride, read), t, &mut wanted, width, 0);
        for (after, (before, wanted)) in
            after.chunks(stride).zip(before.chunks(stride).zip(wanted.chunks(width)))
        {
            assert_eq!((&after[..8], &after[8..]), (&before[..8], wanted));
        }
    }
}
