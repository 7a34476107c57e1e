//! Products of blocks of vectors in single precision with small matrices: rows of a few values each.
//!
//! As [`super::block_vectors`], for what need not be exact. Columns are a multiple of
//! [`SINGLE_COLUMN_MULTIPLE`].

use pulp::{Simd, WithSimd};

use super::simd::dispatch;

/// Columns of a block are a multiple of this: the floats of the widest registers.
pub(crate) const SINGLE_COLUMN_MULTIPLE: usize = 16;

/// Rows of a tile of the result.
const TILE_ROWS: usize = 8;

/// Rows whose products are summed in single precision.
const CHUNK_ROWS: usize = 64;

/// Adds Aᵀ B to `out`, in double precision; rows of A and B have `left` and `right` values.
pub(crate) fn add_gram(a: &[f32], left: usize, b: &[f32], right: usize, out: &mut [f64]) {
    for (a, b) in a.chunks(CHUNK_ROWS * left).zip(b.chunks(CHUNK_ROWS * right)) {
        dispatch(Gram { a, left, b, right, out });
    }
}

/// Adds Z T to `out`; rows of Z have as many values as T has rows, those of `out` `width`.
pub(crate) fn add_product(z: &[f32], t: &[f32], out: &mut [f32], width: usize) {
    dispatch(Product { z, t, out, width });
}

/// Replaces the rows Z by Z T; T is square.
pub(crate) fn rotate(z: &mut [f32], t: &[f32], width: usize, scratch: &mut Vec<f32>) {
    for rows in z.chunks_mut(CHUNK_ROWS * width) {
        scratch.clear();
        scratch.extend_from_slice(rows);
        rows.fill(0.0);
        add_product(scratch, t, rows, width);
    }
}

struct Gram<'a, 'b> {
    a: &'a [f32],
    left: usize,
    b: &'a [f32],
    right: usize,
    out: &'b mut [f64],
}

impl WithSimd for Gram<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let registers = self.right / S::F32_LANES;
        let mut at = 0;
        while at < registers {
            at += if registers - at == 1 {
                self.columns::<S, 1>(simd, at)
            } else {
                self.columns::<S, 2>(simd, at)
            };
        }
    }
}

impl Gram<'_, '_> {
    #[inline(always)]
    fn columns<S: Simd, const C: usize>(&mut self, simd: S, at: usize) -> usize {
        for p in (0..self.left).step_by(TILE_ROWS) {
            let mut sums = [[simd.splat_f32s(0.0); C]; TILE_ROWS];
            let start = at * S::F32_LANES;
            let rows = self.a.chunks_exact(self.left).zip(self.b.chunks_exact(self.right));
            for (a, b) in rows {
                let (b, _) = S::as_simd_f32s(&b[start..start + C * S::F32_LANES]);
                for (a, sums) in a[p..p + TILE_ROWS].iter().zip(&mut sums) {
                    let a = simd.splat_f32s(*a);
                    for c in 0..C {
                        sums[c] = simd.mul_add_e_f32s(a, b[c], sums[c]);
                    }
                }
            }
            for (k, sums) in sums.iter().enumerate() {
                let row = &mut self.out[(p + k) * self.right + start..][..C * S::F32_LANES];
                let sums: &[f32] = pulp::bytemuck::cast_slice(sums);
                for (to, sum) in row.iter_mut().zip(sums) {
                    *to += f64::from(*sum);
                }
            }
        }
        C
    }
}

struct Product<'a, 'b> {
    z: &'a [f32],
    t: &'a [f32],
    out: &'b mut [f32],
    width: usize,
}

impl WithSimd for Product<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let registers = self.width / S::F32_LANES;
        let mut at = 0;
        while at < registers {
            at += if registers - at == 1 {
                self.columns::<S, 1>(simd, at)
            } else {
                self.columns::<S, 2>(simd, at)
            };
        }
    }
}

impl Product<'_, '_> {
    #[inline(always)]
    fn columns<S: Simd, const C: usize>(&mut self, simd: S, at: usize) -> usize {
        let rows = self.out.len() / self.width;
        let mut i = 0;
        while i + TILE_ROWS <= rows {
            self.tile::<S, TILE_ROWS, C>(simd, i, at);
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
        let inner = self.t.len() / self.width;
        let (start, wide) = (at * S::F32_LANES, C * S::F32_LANES);
        let rows: [&[f32]; R] = core::array::from_fn(|r| &self.z[(i + r) * inner..][..inner]);
        let mut sums = [[simd.splat_f32s(0.0); C]; R];
        for (r, sums) in sums.iter_mut().enumerate() {
            let own = &self.out[(i + r) * self.width + start..][..wide];
            sums.copy_from_slice(S::as_simd_f32s(own).0);
        }
        for (p, t) in self.t.chunks_exact(self.width).enumerate() {
            let (t, _) = S::as_simd_f32s(&t[start..start + wide]);
            for r in 0..R {
                let z = simd.splat_f32s(rows[r][p]);
                for c in 0..C {
                    sums[r][c] = simd.mul_add_e_f32s(z, t[c], sums[r][c]);
                }
            }
        }
        for (r, sums) in sums.iter().enumerate() {
            let own = &mut self.out[(i + r) * self.width + start..][..wide];
            S::as_mut_simd_f32s(own).0.copy_from_slice(sums);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_equal_the_definition() {
        for (rows, left, right) in [(1, 16, 16), (70, 32, 16), (133, 16, 48)] {
            let value = |i: usize| ((i * 7919) % 101) as f32 / 50.0 - 1.0;
            let a: Vec<f32> = (0..rows * left).map(value).collect();
            let b: Vec<f32> = (0..rows * right).map(|i| value(i + 13)).collect();
            let mut gram = vec![1.0; left * right];
            add_gram(&a, left, &b, right, &mut gram);
            let t: Vec<f32> = (0..left * right).map(|i| value(i + 5)).collect();
            let mut out = b.clone();
            add_product(&a, &t, &mut out, right);
            for q in 0..right {
                for p in 0..left {
                    let term = |i: usize| f64::from(a[i * left + p] * b[i * right + q]);
                    let wanted = 1.0 + (0..rows).map(term).sum::<f64>();
                    assert!((gram[p * right + q] - wanted).abs() < 1e-4);
                }
                for i in 0..rows {
                    let term = |p: usize| a[i * left + p] * t[p * right + q];
                    let wanted = b[i * right + q] + (0..left).map(term).sum::<f32>();
                    assert!((out[i * right + q] - wanted).abs() < 1e-4);
                }
            }
        }
        let (mut z, t) = (vec![1.0; 100 * 16], vec![0.5; 16 * 16]);
        rotate(&mut z, &t, 16, &mut Vec::new());
        assert!(z.iter().all(|value| *value == 8.0));
    }
}
