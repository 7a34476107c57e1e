//! The symmetric part H = (αA + αAᵀ)/2 in single precision, and a step of a recurrence with it.

use std::ops::Range;

use pulp::{Simd, WithSimd};

use super::{KatzOperator, Orientation};
use crate::linalg::simd::dispatch;

/// Most registers of columns that are summed at a time.
const MAX_COLUMN_REGISTERS: usize = 4;

/// H in compressed rows, in the inner order.
#[derive(Debug, Default)]
pub(crate) struct SymmetricRows {
    starts: Vec<u32>,
    columns: Vec<u32>,
    weights: Vec<f32>,
    /// ‖αA − αAᵀ‖ relative to ‖αA‖, by the squares of the entries.
    asymmetry: f64,
}

impl SymmetricRows {
    /// Computes H in the existing memory.
    pub(crate) fn assign(&mut self, operator: &KatzOperator) {
        self.starts.clear();
        self.columns.clear();
        self.weights.clear();
        self.starts.push(0);
        let (mut difference, mut all) = (0.0, 0.0);
        for i in 0..operator.nodes() {
            let (columns, weights) = operator.row(Orientation::Forward, i);
            let (other_columns, other_weights) = operator.row(Orientation::Backward, i);
            if columns == other_columns && weights == other_weights {
                all += weights.iter().map(|weight| weight * weight).sum::<f64>();
                self.columns.extend_from_slice(columns);
                self.weights.extend(weights.iter().map(|weight| *weight as f32));
                self.starts.push(self.columns.len() as u32);
                continue;
            }
            let (mut k, mut l) = (0, 0);
            while k < columns.len() || l < other_columns.len() {
                let own = columns.get(k).copied().unwrap_or(u32::MAX);
                let other = other_columns.get(l).copied().unwrap_or(u32::MAX);
                let column = own.min(other);
                let from = if own == column { weights[k] } else { 0.0 };
                let to = if other == column { other_weights[l] } else { 0.0 };
                k += usize::from(own == column);
                l += usize::from(other == column);
                difference += (from - to) * (from - to);
                all += from * from;
                self.columns.push(column);
                self.weights.push((0.5 * (from + to)) as f32);
            }
            self.starts.push(self.columns.len() as u32);
        }
        self.asymmetry = if all > 0.0 { (difference / all).sqrt() } else { 0.0 };
    }

    /// ‖αA − αAᵀ‖ relative to ‖αA‖, by the squares of the entries.
    pub(crate) fn asymmetry(&self) -> f64 {
        self.asymmetry
    }

    /// `out` = H `x` for one vector.
    pub(crate) fn multiply(&self, x: &[f64], out: &mut [f64]) {
        for (out, ends) in out.iter_mut().zip(self.starts.windows(2)) {
            let range = ends[0] as usize..ends[1] as usize;
            let term = |(j, w): (&u32, &f32)| f64::from(*w) * x[*j as usize];
            let (columns, other) = self.columns[range.clone()].as_chunks::<4>();
            let (weights, rest) = self.weights[range].as_chunks::<4>();
            // Several sums at a time: one would wait for each of its additions.
            let mut sums = [0.0; 4];
            for (columns, weights) in columns.iter().zip(weights) {
                for (sum, entry) in sums.iter_mut().zip(columns.iter().zip(weights)) {
                    *sum += term(entry);
                }
            }
            *out = sums.iter().sum::<f64>() + other.iter().zip(rest).map(term).sum::<f64>();
        }
    }

    /// Rows `range` of `to` = `factor` H z + `own` z + `before` `to`, rows of `width` values; `to` is not
    /// read where `before` is zero. `sum` has coefficients by columns and a block to whose rows those of
    /// `to`, times the coefficients, are added.
    pub(crate) fn step(
        &self,
        range: Range<usize>,
        scales: Scales,
        z: &[f32],
        to: &mut [f32],
        sum: Option<(&[f32], &mut [f32])>,
        width: usize,
    ) {
        let rows = self;
        match sum {
            Some((coefficients, sum)) => {
                dispatch(Step { rows, range, scales, z, to, coefficients, sum, width });
            }
            None => {
                let (coefficients, sum) = (&[][..], &mut [][..]);
                dispatch(Step { rows, range, scales, z, to, coefficients, sum, width });
            }
        }
    }
}

/// The numbers of a step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scales {
    pub(crate) factor: f32,
    pub(crate) own: f32,
    pub(crate) before: f32,
}

struct Step<'a, 'b> {
    rows: &'a SymmetricRows,
    range: Range<usize>,
    scales: Scales,
    z: &'a [f32],
    to: &'b mut [f32],
    coefficients: &'a [f32],
    sum: &'b mut [f32],
    width: usize,
}

impl WithSimd for Step<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let mut at = 0;
        while at < self.width {
            at += S::F32_LANES
                * match ((self.width - at) / S::F32_LANES).min(MAX_COLUMN_REGISTERS) {
                    1 => self.columns::<S, 1>(simd, at),
                    2 => self.columns::<S, 2>(simd, at),
                    3 => self.columns::<S, 3>(simd, at),
                    _ => self.columns::<S, 4>(simd, at),
                };
        }
    }
}

impl Step<'_, '_> {
    #[inline(always)]
    fn columns<S: Simd, const C: usize>(&mut self, simd: S, at: usize) -> usize {
        let (width, wide) = (self.width, C * S::F32_LANES);
        let Scales { factor, own, before } = self.scales;
        let reads = before != 0.0;
        let [factor, own, before] = [factor, own, before].map(|scale| simd.splat_f32s(scale));
        let first = self.range.start;
        for i in self.range.clone() {
            let mut sums = [simd.splat_f32s(0.0); C];
            let range = self.rows.starts[i] as usize..self.rows.starts[i + 1] as usize;
            let (columns, weights) = (&self.rows.columns[range.clone()], &self.rows.weights[range]);
            for (&j, &w) in columns.iter().zip(weights) {
                let start = j as usize * width + at;
                let (row, _) = S::as_simd_f32s(&self.z[start..start + wide]);
                let w = simd.splat_f32s(w);
                for c in 0..C {
                    sums[c] = simd.mul_add_e_f32s(w, row[c], sums[c]);
                }
            }
            let (z, _) = S::as_simd_f32s(&self.z[i * width + at..][..wide]);
            let place = (i - first) * width + at;
            let (to, _) = S::as_mut_simd_f32s(&mut self.to[place..place + wide]);
            for c in 0..C {
                let mut value = simd.mul_f32s(own, z[c]);
                if reads {
                    value = simd.mul_add_e_f32s(before, to[c], value);
                }
                to[c] = simd.mul_add_e_f32s(factor, sums[c], value);
            }
            if !self.sum.is_empty() {
                let (scale, _) = S::as_simd_f32s(&self.coefficients[at..at + wide]);
                let (sum, _) = S::as_mut_simd_f32s(&mut self.sum[place..place + wide]);
                for c in 0..C {
                    sum[c] = simd.mul_add_e_f32s(scale[c], to[c], sum[c]);
                }
            }
        }
        C
    }
}
