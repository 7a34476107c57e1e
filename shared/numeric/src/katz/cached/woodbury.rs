//! The Katz similarity after a change of few rows and columns.
//!
//! With M = I − αA and G = M⁻¹ = I + S, a change αΔ = U Vᵀ of αA gives (Sherman and Morrison 1950;
//! Woodbury 1950)
//!
//! S' = S + (G U) (I − VᵀG U)⁻¹ (VᵀG).
//!
//! Each changed row i is a column e_i of U and a row αδᵢ of Vᵀ, each changed column j a column of U
//! and the row e_jᵀ of Vᵀ. Both are sparse, so that G U and VᵀG cost as much per changed entry as
//! one row of S. The product of both, which touches all of S, is left to [`LowRankSum`].

use pulp::Arch;

use super::changes::{Changes, Line};
use super::low_rank_sum::LowRankSum;
use crate::linalg::backend::small_lu::{Factored, add_product, add_transposed_product};

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

    fn column(&self, a: usize) -> &[(u32, f64)] {
        &self.entries[self.starts[a]..self.starts[a + 1]]
    }

    /// The product of one row with column `a`.
    #[inline(always)]
    fn product(&self, row: &[f64], a: usize) -> f64 {
        self.column(a).iter().map(|&(j, value)| value * row[j as usize]).sum()
    }
}

/// Scratch space of the updates of one matrix.
#[derive(Debug, Default)]
pub(crate) struct Woodbury {
    /// U.
    sparse: Sparse,
    /// G U, m × k.
    left: Vec<f64>,
    /// VᵀG and then (I − VᵀGU)⁻¹VᵀG, k × m.
    right: Vec<f64>,
    /// What VᵀG takes of each pending row, k × r, and then what G U takes of each pending column, r × k.
    shares: Vec<f64>,
    factored: Factored,
}

impl Woodbury {
    /// Prepares the update of S by `alpha` times `changes`, without changing it. Returns the
    /// reciprocal condition of the k × k capacitance matrix I − VᵀGU.
    pub(crate) fn prepare(&mut self, s: &LowRankSum, alpha: f64, changes: &Changes) -> f64 {
        self.sparse.assign(alpha, changes);
        self.fill_right(s, alpha, changes);
        let m = s.side();
        let Self { sparse, right, factored, .. } = self;
        let k = sparse.columns();
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

    fn fill_right(&mut self, s: &LowRankSum, alpha: f64, changes: &Changes) {
        let (m, rank) = (s.side(), s.rank());
        self.right.clear();
        self.right.resize(m * changes.lines().len(), 0.0);
        self.shares.clear();
        self.shares.resize(rank * changes.lines().len(), 0.0);
        for (place, (line, covered)) in changes.lines().enumerate() {
            let right = &mut self.right[place * m..(place + 1) * m];
            let shares = &mut self.shares[place * rank..(place + 1) * rank];
            let mut add = |j: u32, factor: f64| {
                let j = j as usize;
                Arch::new().dispatch(|| {
                    for (sum, s) in right.iter_mut().zip(s.base_row(j)) {
                        *sum += factor * s;
                    }
                });
                for (share, left) in shares.iter_mut().zip(s.left_at(j)) {
                    *share += factor * left;
                }
                right[j] += factor;
            };
            match line {
                Line::Row(_) => covered.iter().for_each(|c| add(c.column, alpha * c.difference)),
                Line::Column(j) => add(j, 1.0),
            }
        }
        add_product(&self.shares, s.right(), &mut self.right, rank, m);
    }

    /// Adds the update of [`Woodbury::prepare`] to S.
    pub(crate) fn apply(&mut self, s: &mut LowRankSum) {
        let (m, rank, k) = (s.side(), s.rank(), self.sparse.columns());
        let Self { sparse, left, right, shares, factored } = self;
        factored.solve(right, m);
        left.clear();
        for row in s.base_rows() {
            left.extend((0..k).map(|a| sparse.product(row, a)));
        }
        for a in 0..k {
            for &(i, value) in sparse.column(a) {
                left[i as usize * k + a] += value;
            }
        }
        shares.clear();
        for row in s.right().chunks_exact(m) {
            shares.extend((0..k).map(|a| sparse.product(row, a)));
        }
        add_transposed_product(s.left(), shares, left, rank, k);
        s.add(left, right, k);
    }
}
