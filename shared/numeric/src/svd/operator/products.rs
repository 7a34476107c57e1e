//! Products of αA and αAᵀ with blocks of vectors, fused with the next operation on each row of the
//! result.
//!
//! Blocks are n rows of `stride` values, of which `width` are used, a multiple of the lanes of the
//! widest register. Every function computes some rows of the result, so that calls for other rows
//! can run in parallel.

use std::ops::Range;

use pulp::{Simd, WithSimd, bytemuck};

use super::rows::Rows;
use super::{KatzOperator, Orientation};
use crate::linalg::simd::dispatch;

/// Most registers of columns that are summed at a time.
const MAX_COLUMN_REGISTERS: usize = 4;

impl KatzOperator {
    /// Rows `range` of Y = B X for B = αA or αAᵀ: writes the products to the columns of `y` from
    /// `first` on; `y` holds these rows, of `y_stride` values.
    #[expect(clippy::too_many_arguments, reason = "two blocks with their strides")]
    pub(crate) fn multiply(
        &self,
        orientation: Orientation,
        range: Range<usize>,
        x: &[f64],
        x_stride: usize,
        width: usize,
        y: &mut [f64],
        y_stride: usize,
        first: usize,
    ) {
        let place = Place { stride: y_stride, first };
        dispatch(Multiply { rows: self.rows(orientation), range, x, x_stride, width, y, place });
    }

    /// Rows `range` of αA W and of V = W − αA W, into the columns of `image` and `space` from
    /// `first` on, which hold these rows of `stride` values.
    #[expect(clippy::too_many_arguments, reason = "two blocks with their strides")]
    pub(crate) fn map_directions(
        &self,
        range: Range<usize>,
        w: &[f64],
        w_stride: usize,
        width: usize,
        space: &mut [f64],
        image: &mut [f64],
        stride: usize,
        first: usize,
    ) {
        let place = Place { stride, first };
        let rows = &self.forward;
        dispatch(MapDirections { rows, range, w, w_stride, width, space, image, place });
    }

    /// Rows `range` of αAᵀ X − V Σ, times `scale` and rounded to `residual`, rows of
    /// `single_stride` values, of which those from `width` on become 0. Adds the squares by columns
    /// to `squares`. All blocks have rows of `width` values.
    #[expect(clippy::too_many_arguments, reason = "three blocks and their scales")]
    pub(crate) fn residual(
        &self,
        range: Range<usize>,
        x: &[f64],
        right: &[f64],
        sigma: &[f64],
        scale: f64,
        residual: &mut [f32],
        single_stride: usize,
        squares: &mut [f64],
    ) {
        let rows = &self.backward;
        dispatch(Residual {
            rows,
            range,
            x,
            right,
            sigma,
            width: sigma.len(),
            scale,
            residual,
            single_stride,
            squares,
        });
    }

    /// Rows `range` of one step of Horner's scheme in single precision: `next` = `own` r + `factor` B z,
    /// rows of `width` values.
    #[expect(clippy::too_many_arguments, reason = "three blocks and two numbers")]
    pub(crate) fn horner_step(
        &self,
        orientation: Orientation,
        range: Range<usize>,
        (own, factor): (f32, f32),
        r: &[f32],
        z: &[f32],
        next: &mut [f32],
        width: usize,
    ) {
        let rows = self.rows(orientation);
        dispatch(HornerStep { rows, range, own, factor, r, z, next, width });
    }
}

/// Location of the columns of a result in rows of `stride` values.
#[derive(Debug, Clone, Copy)]
struct Place {
    stride: usize,
    first: usize,
}

/// The sums Σ w x over the entries of row `i`, for C registers of columns from `at` on.
#[inline(always)]
fn sums<S: Simd, const C: usize>(
    simd: S,
    rows: &Rows,
    i: usize,
    x: &[f64],
    stride: usize,
    at: usize,
) -> [S::f64s; C] {
    let mut sums = [simd.splat_f64s(0.0); C];
    let (columns, weights) = rows.row(i);
    for (&j, &w) in columns.iter().zip(weights) {
        let start = j as usize * stride + at;
        let (row, _) = S::as_simd_f64s(&x[start..start + C * S::F64_LANES]);
        let w = simd.splat_f64s(w);
        for c in 0..C {
            sums[c] = simd.mul_add_e_f64s(w, row[c], sums[c]);
        }
    }
    sums
}

/// Runs a kernel over all columns, a few registers at a time.
macro_rules! for_all_columns {
    ($self:ident, $simd:ident, $lanes:expr) => {
        let mut at = 0;
        while at < $self.width {
            at += $lanes
                * match (($self.width - at) / $lanes).min(MAX_COLUMN_REGISTERS) {
                    1 => $self.columns::<S, 1>($simd, at),
                    2 => $self.columns::<S, 2>($simd, at),
                    3 => $self.columns::<S, 3>($simd, at),
                    _ => $self.columns::<S, 4>($simd, at),
                };
        }
    };
}

struct Multiply<'a> {
    rows: &'a Rows,
    range: Range<usize>,
    x: &'a [f64],
    x_stride: usize,
    width: usize,
    y: &'a mut [f64],
    place: Place,
}

impl WithSimd for Multiply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        for_all_columns!(self, simd, S::F64_LANES);
    }
}

impl Multiply<'_> {
    #[inline(always)]
    fn columns<S: Simd, const C: usize>(&mut self, simd: S, at: usize) -> usize {
        let Place { stride, first } = self.place;
        for (i, y) in self.range.clone().zip(self.y.chunks_mut(stride)) {
            let sums = sums::<S, C>(simd, self.rows, i, self.x, self.x_stride, at);
            let y = &mut y[first + at..first + at + C * S::F64_LANES];
            S::as_mut_simd_f64s(y).0.copy_from_slice(&sums);
        }
        C
    }
}

struct MapDirections<'a> {
    rows: &'a Rows,
    range: Range<usize>,
    w: &'a [f64],
    w_stride: usize,
    width: usize,
    space: &'a mut [f64],
    image: &'a mut [f64],
    place: Place,
}

impl WithSimd for MapDirections<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        for_all_columns!(self, simd, S::F64_LANES);
    }
}

impl MapDirections<'_> {
    #[inline(always)]
    fn columns<S: Simd, const C: usize>(&mut self, simd: S, at: usize) -> usize {
        let (Place { stride, first }, wide) = (self.place, C * S::F64_LANES);
        let rows = self.space.chunks_mut(stride).zip(self.image.chunks_mut(stride));
        for (i, (space, image)) in self.range.clone().zip(rows) {
            let sums = sums::<S, C>(simd, self.rows, i, self.w, self.w_stride, at);
            let image = &mut image[first + at..first + at + wide];
            S::as_mut_simd_f64s(image).0.copy_from_slice(&sums);
            let (own, _) = S::as_simd_f64s(&self.w[i * self.w_stride + at..][..wide]);
            let (space, _) = S::as_mut_simd_f64s(&mut space[first + at..first + at + wide]);
            for c in 0..C {
                space[c] = simd.sub_f64s(own[c], sums[c]);
            }
        }
        C
    }
}

struct Residual<'a> {
    rows: &'a Rows,
    range: Range<usize>,
    x: &'a [f64],
    right: &'a [f64],
    sigma: &'a [f64],
    width: usize,
    scale: f64,
    residual: &'a mut [f32],
    single_stride: usize,
    squares: &'a mut [f64],
}

impl WithSimd for Residual<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        for row in self.residual.chunks_exact_mut(self.single_stride) {
            row[self.width..].fill(0.0);
        }
        for_all_columns!(self, simd, S::F64_LANES);
    }
}

impl Residual<'_> {
    #[inline(always)]
    fn columns<S: Simd, const C: usize>(&mut self, simd: S, at: usize) -> usize {
        let (width, wide) = (self.width, C * S::F64_LANES);
        let (sigma, _) = S::as_simd_f64s(&self.sigma[at..at + wide]);
        let (squares, _) = S::as_mut_simd_f64s(&mut self.squares[at..at + wide]);
        let mut own = [simd.splat_f64s(0.0); C];
        own.copy_from_slice(squares);
        let rows = self.residual.chunks_exact_mut(self.single_stride);
        for (i, residual) in self.range.clone().zip(rows) {
            let mut sums = sums::<S, C>(simd, self.rows, i, self.x, width, at);
            let (right, _) = S::as_simd_f64s(&self.right[i * width + at..][..wide]);
            for c in 0..C {
                sums[c] = simd.sub_f64s(sums[c], simd.mul_f64s(right[c], sigma[c]));
                own[c] = simd.mul_add_e_f64s(sums[c], sums[c], own[c]);
            }
            let values: &[f64] = bytemuck::cast_slice(&sums);
            for (to, value) in residual[at..at + wide].iter_mut().zip(values) {
                *to = (self.scale * value) as f32;
            }
        }
        squares.copy_from_slice(&own);
        C
    }
}

struct HornerStep<'a> {
    rows: &'a Rows,
    range: Range<usize>,
    own: f32,
    factor: f32,
    r: &'a [f32],
    z: &'a [f32],
    next: &'a mut [f32],
    width: usize,
}

impl WithSimd for HornerStep<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        for_all_columns!(self, simd, S::F32_LANES);
    }
}

impl HornerStep<'_> {
    #[inline(always)]
    fn columns<S: Simd, const C: usize>(&mut self, simd: S, at: usize) -> usize {
        let (width, wide) = (self.width, C * S::F32_LANES);
        let (own, factor) = (simd.splat_f32s(self.own), simd.splat_f32s(self.factor));
        for (i, next) in self.range.clone().zip(self.next.chunks_exact_mut(width)) {
            let mut sums = [simd.splat_f32s(0.0); C];
            let (columns, weights) = self.rows.row_single(i);
            for (&j, &w) in columns.iter().zip(weights) {
                let start = j as usize * width + at;
                let (row, _) = S::as_simd_f32s(&self.z[start..start + wide]);
                let w = simd.splat_f32s(w);
                for c in 0..C {
                    sums[c] = simd.mul_add_e_f32s(w, row[c], sums[c]);
                }
            }
            let (r, _) = S::as_simd_f32s(&self.r[i * width + at..][..wide]);
            let (next, _) = S::as_mut_simd_f32s(&mut next[at..at + wide]);
            for c in 0..C {
                next[c] = simd.mul_add_e_f32s(factor, sums[c], simd.mul_f32s(own, r[c]));
            }
        }
        C
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::super::tests::random;
    use super::*;

    #[test]
    fn products_equal_the_definition_in_every_width() {
        let (n, alpha) = (57, 0.3);
        let a = random(n, 3);
        let mut operator = KatzOperator::default();
        operator.assign(&a, alpha, false, 1);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let weight = |orientation, i, j| match orientation {
            Orientation::Forward => alpha * a.weight(i, j),
            Orientation::Backward => alpha * a.weight(j, i),
        };
        for width in (8..64).step_by(8) {
            let x: Vec<f64> = (0..n * width).map(|_| rng.random::<f64>()).collect();
            let exact = |orientation, i: usize, c: usize| -> f64 {
                (0..n).map(|j| weight(orientation, i, j) * x[j * width + c]).sum()
            };
            let (stride, range) = (width + 9, 3..50);
            let mut y = vec![0.0; range.len() * stride];
            for orientation in [Orientation::Forward, Orientation::Backward] {
                operator.multiply(orientation, range.clone(), &x, width, width, &mut y, stride, 7);
                for (i, y) in range.clone().zip(y.chunks(stride)) {
                    for c in 0..width {
                        assert!((y[7 + c] - exact(orientation, i, c)).abs() < 1e-12);
                    }
                }
            }
            let mut space = y.clone();
            operator.map_directions(range.clone(), &x, width, width, &mut space, &mut y, stride, 7);
            for (i, (v, s)) in range.clone().zip(space.chunks(stride).zip(y.chunks(stride))) {
                for c in 0..width {
                    let wanted = exact(Orientation::Forward, i, c);
                    assert!((s[7 + c] - wanted).abs() < 1e-12);
                    assert!((v[7 + c] - (x[i * width + c] - wanted)).abs() < 1e-12);
                }
            }
            let sigma: Vec<f64> = (0..width).map(|c| c as f64).collect();
            let single_stride = width.next_multiple_of(16);
            let mut residual = vec![1.0; range.len() * single_stride];
            let mut squares = vec![0.5; width];
            operator.residual(
                range.clone(),
                &x,
                &x,
                &sigma,
                2.0,
                &mut residual,
                single_stride,
                &mut squares,
            );
            let mut wanted = vec![0.5; width];
            for (i, row) in range.clone().zip(residual.chunks(single_stride)) {
                for c in 0..width {
                    let exact = exact(Orientation::Backward, i, c) - x[i * width + c] * sigma[c];
                    wanted[c] += exact * exact;
                    assert!((f64::from(row[c]) - 2.0 * exact).abs() < 1e-4);
                }
                assert!(row[width..].iter().all(|value| *value == 0.0));
            }
            assert!(squares.iter().zip(wanted).all(|(l, r)| (l - r).abs() < 1e-9 * r));
        }
    }

    #[test]
    fn a_step_of_horner_equals_the_definition() {
        let (n, alpha, width) = (41, 0.2, 48);
        let a = random(n, 5);
        let mut operator = KatzOperator::default();
        operator.assign(&a, alpha, false, 1);
        let r: Vec<f32> = (0..n * width).map(|at| (at % 13) as f32).collect();
        let z: Vec<f32> = (0..n * width).map(|at| (at % 7) as f32).collect();
        let mut next = vec![0.0; 20 * width];
        let scales = (0.5, 3.0);
        operator.horner_step(Orientation::Backward, 11..31, scales, &r, &z, &mut next, width);
        for (i, row) in (11..31).zip(next.chunks(width)) {
            for c in 0..width {
                let term = |j| alpha * a.weight(j, i) * f64::from(z[j * width + c]);
                let sum: f64 = (0..n).map(term).sum();
                let wanted = 0.5 * f64::from(r[i * width + c]) + 3.0 * sum;
                assert!((f64::from(row[c]) - wanted).abs() < 1e-4 * wanted.max(1.0));
            }
        }
    }
}
