//! The Katz similarity after a change of few rows and columns.
//!
//! With M = I − αA and G = M⁻¹ = I + S, a change αΔ = U Vᵀ of αA gives (Sherman and Morrison 1950;
//! Woodbury 1950)
//!
//! S' = S + (G U) (I − VᵀG U)⁻¹ (VᵀG).
//!
//! Each changed row i is a column e_i of U and a row αδᵢ of Vᵀ, each changed column j a column of U
//! and the row e_jᵀ of Vᵀ. Both are sparse, so that G U and VᵀG cost as much per changed entry as
//! one row of S, and only the last product is dense.

use pulp::{Arch, Simd, WithSimd};

use super::changes::{Changes, Line};
use crate::linalg::backend::small_lu::{Factored, add_product};

/// Largest rank for which S' and its product with the probe are computed in one pass over memory,
/// which is all that such an update costs; beyond it the blocked product of the library is faster.
const MAX_FUSED_RANK: usize = 6;

/// The m × k matrix U by its columns, whose entries are (row, value).
#[derive(Debug, Default)]
struct Sparse {
    starts: Vec<usize>,
    entries: Vec<(u32, f64)>,
}

impl Sparse {
    fn assign(&mut self, alpha: f64, changes: &Changes) {
        self.entries.clear();
        self.starts.clear();
        self.starts.push(0);
        for (line, covered) in changes.lines() {
            match line {
                Line::Row(i) => self.entries.push((i, 1.0)),
                Line::Column(_) => {
                    self.entries.extend(covered.iter().map(|c| (c.row, alpha * c.difference)));
                }
            }
            self.starts.push(self.entries.len());
        }
    }

    fn columns(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// The product of one row with column `a`.
    #[inline(always)]
    fn product(&self, row: &[f64], a: usize) -> f64 {
        let entries = &self.entries[self.starts[a]..self.starts[a + 1]];
        entries.iter().map(|&(j, value)| value * row[j as usize]).sum()
    }
}

/// Scratch space of the updates of one matrix.
#[derive(Debug, Default)]
pub(crate) struct Woodbury {
    /// U.
    sparse: Sparse,
    /// U in rows and then G U, m × k.
    left: Vec<f64>,
    /// VᵀG and then (I − VᵀGU)⁻¹VᵀG, k × m.
    right: Vec<f64>,
    factored: Factored,
}

impl Woodbury {
    /// Prepares the update of the m × m row-major matrix `s` by `alpha` times `changes`, without
    /// changing `s`. Returns the reciprocal condition of the k × k capacitance matrix I − VᵀGU.
    pub(crate) fn prepare(&mut self, s: &[f64], m: usize, alpha: f64, changes: &Changes) -> f64 {
        self.sparse.assign(alpha, changes);
        let k = self.sparse.columns();
        self.left.clear();
        self.left.resize(m * k, 0.0);
        for (a, bounds) in self.sparse.starts.windows(2).enumerate() {
            for &(i, value) in &self.sparse.entries[bounds[0]..bounds[1]] {
                self.left[i as usize * k + a] = value;
            }
        }
        self.fill_right(s, m, alpha, changes);
        let Self { sparse, right, factored, .. } = self;
        factored.factor(k, |capacitance| {
            for (row, right) in capacitance.chunks_exact_mut(k).zip(right.chunks_exact(m)) {
                for (a, entry) in row.iter_mut().enumerate() {
                    *entry = -sparse.product(right, a);
                }
            }
            for i in 0..k {
                capacitance[i * k + i] += 1.0;
            }
        })
    }

    fn fill_right(&mut self, s: &[f64], m: usize, alpha: f64, changes: &Changes) {
        self.right.clear();
        self.right.resize(m * changes.lines().len(), 0.0);
        for (right, (line, covered)) in self.right.chunks_exact_mut(m).zip(changes.lines()) {
            match line {
                Line::Row(_) => {
                    for c in covered {
                        let (j, factor) = (c.column as usize, alpha * c.difference);
                        Arch::new().dispatch(|| {
                            for (sum, s) in right.iter_mut().zip(&s[j * m..(j + 1) * m]) {
                                *sum += factor * s;
                            }
                        });
                        right[j] += factor;
                    }
                }
                Line::Column(j) => {
                    let j = j as usize;
                    right.copy_from_slice(&s[j * m..(j + 1) * m]);
                    right[j] += 1.0;
                }
            }
        }
    }

    /// Applies the update of [`Woodbury::prepare`], and writes S' z to `product`.
    pub(crate) fn apply(&mut self, s: &mut [f64], m: usize, z: &[f64], product: &mut [f64]) {
        let k = self.sparse.columns();
        self.factored.solve(&mut self.right, m);
        let Self { sparse, left, right, .. } = self;
        if k > MAX_FUSED_RANK {
            for (left, row) in left.chunks_exact_mut(k).zip(s.chunks_exact(m)) {
                for (a, entry) in left.iter_mut().enumerate() {
                    *entry += sparse.product(row, a);
                }
            }
            add_product(left, right, s, k, m);
            multiply(s, m, z, product);
        } else {
            Arch::new().dispatch(Fused { sparse, left, right, s, m, z, product });
        }
    }
}

/// `product` = S z for the m × m matrix S in rows.
pub(crate) fn multiply(s: &mut [f64], m: usize, z: &[f64], product: &mut [f64]) {
    let sparse = &Sparse::default();
    Arch::new().dispatch(Fused { sparse, left: &[], right: &[], s, m, z, product });
}

/// S' = S + (U + S U) Z row by row, and its product with z while the row is in the cache.
struct Fused<'a> {
    sparse: &'a Sparse,
    left: &'a [f64],
    right: &'a [f64],
    s: &'a mut [f64],
    m: usize,
    z: &'a [f64],
    product: &'a mut [f64],
}

impl WithSimd for Fused<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        if self.m == 0 {
            return;
        }
        match self.sparse.columns() {
            0 => self.rows::<S, 0>(simd),
            1 => self.rows::<S, 1>(simd),
            2 => self.rows::<S, 2>(simd),
            3 => self.rows::<S, 3>(simd),
            4 => self.rows::<S, 4>(simd),
            5 => self.rows::<S, 5>(simd),
            _ => self.rows::<S, 6>(simd),
        }
    }
}

impl Fused<'_> {
    #[inline(always)]
    fn rows<S: Simd, const K: usize>(self, simd: S) {
        let m = self.m;
        let z = S::as_simd_f64s(self.z);
        let right: [_; K] =
            std::array::from_fn(|a| S::as_simd_f64s(&self.right[a * m..(a + 1) * m]));
        for (i, (row, product)) in self.s.chunks_exact_mut(m).zip(self.product).enumerate() {
            let left: [f64; K] =
                std::array::from_fn(|a| self.left[i * K + a] + self.sparse.product(row, a));
            let spread = left.map(|v| simd.splat_f64s(v));
            let (whole, rest) = S::as_mut_simd_f64s(row);
            let mut sums = [simd.splat_f64s(0.0); 4];
            for (c, s) in whole.iter_mut().enumerate() {
                let mut value = *s;
                for a in 0..K {
                    value = simd.mul_add_e_f64s(spread[a], right[a].0[c], value);
                }
                if K > 0 {
                    *s = value;
                }
                sums[c % 4] = simd.mul_add_e_f64s(value, z.0[c], sums[c % 4]);
            }
            let mut sum = 0.0;
            for (c, s) in rest.iter_mut().enumerate() {
                for a in 0..K {
                    *s += left[a] * right[a].1[c];
                }
                sum += *s * z.1[c];
            }
            for part in sums {
                sum += simd.reduce_sum_f64s(part);
            }
            *product = sum;
        }
    }
}
