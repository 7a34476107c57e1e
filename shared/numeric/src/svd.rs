//! Singular value decomposition of the similarity, S = U Σ Vᵀ, cut at rank K.
//!
//! Equation 4 of the paper. Singular vectors are unique only up to a sign, and up to a rotation
//! where singular values coincide: signs are fixed here by a rule, rotations between frames by
//! [`crate::alignment`], and [`RankKSvd::ambiguous`] says when the cut itself falls between
//! coinciding values.

use thiserror::Error;

use crate::backend::{Factors, thin_svd};
use crate::dimension::Spectrum;
use crate::jacobi::jacobi_svd;
use crate::matrix::DenseMatrix;

/// Relative gap behind σ_K up to which the first K vectors count as an arbitrary choice.
pub const AMBIGUOUS_GAP: f64 = 1e-9;

/// Entries of a singular vector within this relative distance of the largest modulus count as
/// equally large when its sign is chosen, so that rounding does not decide.
pub const SIGN_TIE: f64 = 1e-8;

/// Why no decomposition could be computed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SvdError {
    /// The matrix is not square.
    #[error("a {rows} × {cols} matrix is not square")]
    NotSquare {
        /// Its rows.
        rows: usize,
        /// Its columns.
        cols: usize,
    },
    /// The rank asked for is 0 or above the size of the matrix.
    #[error("rank {rank} is not between 1 and {nodes}")]
    Rank {
        /// Rank asked for.
        rank: usize,
        /// Size n of the matrix.
        nodes: usize,
    },
    /// A matrix of another size was compared with the decomposition.
    #[error("a matrix of {found} rows does not belong to a decomposition of {expected}")]
    Size {
        /// Rows of the decomposition.
        expected: usize,
        /// Rows found.
        found: usize,
    },
}

/// Full decomposition of a square n × n matrix, all n singular values and vectors.
#[derive(Debug, Clone, PartialEq)]
pub struct FullSvd {
    u: DenseMatrix,
    sigma: Vec<f64>,
    v: DenseMatrix,
}

/// The K leading singular triplets of an n × n matrix.
#[derive(Debug, Clone, PartialEq)]
pub struct RankKSvd {
    /// Left singular vectors in columns, n × K.
    pub u: DenseMatrix,
    /// The K largest singular values, descending.
    pub sigma: Vec<f64>,
    /// Right singular vectors in columns, n × K.
    pub v: DenseMatrix,
    /// σ_{K+1}, the largest singular value left out; `None` when K = n.
    pub sigma_next: Option<f64>,
}

/// Full singular value decomposition of the square matrix `s`.
///
/// The sign of each pair of vectors is chosen so that the entry of u_j with the largest modulus
/// is positive (the first of them within [`SIGN_TIE`]). Vectors of negligible singular values,
/// σ_j ≤ n ε σ₁, are set to zero: null directions are arbitrary and would feed noise to whatever
/// uses them.
///
/// # Errors
/// [`SvdError::NotSquare`].
pub fn full_svd(s: &DenseMatrix) -> Result<FullSvd, SvdError> {
    let (rows, cols) = (s.rows(), s.cols());
    if rows != cols {
        return Err(SvdError::NotSquare { rows, cols });
    }
    let top = s.max_abs();
    if top == 0.0 {
        let zero = DenseMatrix::from_fn(rows, rows, |_, _| 0.0);
        return Ok(FullSvd { u: zero.clone(), sigma: vec![0.0; rows], v: zero });
    }
    // The library fails on very large and very small numbers that are perfectly regular.
    let scaled = DenseMatrix::from_fn(rows, rows, |i, j| s.at(i, j) / top);
    let mut factors = robust_svd(&scaled);
    let cut = null_threshold(&factors.sigma, rows);
    for (j, sigma) in factors.sigma.iter_mut().enumerate() {
        if *sigma <= cut {
            scale_column(&mut factors.u, j, 0.0);
            scale_column(&mut factors.v, j, 0.0);
        }
        *sigma *= top;
    }
    fix_signs(&mut factors.u, &mut factors.v);
    Ok(FullSvd { u: factors.u, sigma: factors.sigma, v: factors.v })
}

/// The K leading singular triplets of the square matrix `s`, see [`full_svd`].
///
/// # Errors
/// [`SvdError::NotSquare`], and [`SvdError::Rank`] unless 1 ≤ k ≤ n.
pub fn rank_k_svd(s: &DenseMatrix, k: usize) -> Result<RankKSvd, SvdError> {
    full_svd(s)?.truncate(k)
}

/// The library's decomposition, of the transpose if it fails (a known defect hits single
/// matrices at random), and one-sided Jacobi if that fails too.
fn robust_svd(s: &DenseMatrix) -> Factors {
    let swapped = |f: Factors| Factors { u: f.v, sigma: f.sigma, v: f.u };
    thin_svd(s).or_else(|| thin_svd(&s.transpose()).map(swapped)).unwrap_or_else(|| jacobi_svd(s))
}

/// Singular values of a matrix of n rows up to this one are rounding noise: n ε σ₁.
pub(crate) fn null_threshold(sigma: &[f64], n: usize) -> f64 {
    n as f64 * f64::EPSILON * sigma.first().copied().unwrap_or(0.0)
}

/// Turns each pair of columns so that the entry of u with the largest modulus is positive, the first of
/// them within [`SIGN_TIE`].
pub(crate) fn fix_signs(u: &mut DenseMatrix, v: &mut DenseMatrix) {
    for j in 0..u.cols() {
        if sign_of_column(u, j) < 0.0 {
            scale_column(u, j, -1.0);
            scale_column(v, j, -1.0);
        }
    }
}

/// Sign of the first entry of column `j` whose modulus ties with the largest one.
fn sign_of_column(u: &DenseMatrix, j: usize) -> f64 {
    let column = u.column(j);
    let top = column.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let leading = column.iter().find(|v| v.abs() >= top * (1.0 - SIGN_TIE));
    leading.map_or(1.0, |v| if *v < 0.0 { -1.0 } else { 1.0 })
}

fn scale_column(m: &mut DenseMatrix, j: usize, factor: f64) {
    for i in 0..m.rows() {
        m.row_mut(i)[j] *= factor;
    }
}

impl FullSvd {
    /// All n singular values, descending.
    #[must_use]
    pub fn singular_values(&self) -> &[f64] {
        &self.sigma
    }

    /// The `k` leading triplets, 1 ≤ k ≤ n.
    ///
    /// # Errors
    /// [`SvdError::Rank`].
    pub fn truncate(&self, k: usize) -> Result<RankKSvd, SvdError> {
        let nodes = self.sigma.len();
        if k == 0 || k > nodes {
            return Err(SvdError::Rank { rank: k, nodes });
        }
        Ok(RankKSvd {
            u: DenseMatrix::from_fn(nodes, k, |i, j| self.u.at(i, j)),
            sigma: self.sigma[..k].to_vec(),
            v: DenseMatrix::from_fn(nodes, k, |i, j| self.v.at(i, j)),
            sigma_next: self.sigma.get(k).copied(),
        })
    }
}

impl Spectrum for FullSvd {
    fn nodes(&self) -> usize {
        self.sigma.len()
    }

    fn singular_values(&self) -> &[f64] {
        &self.sigma
    }

    fn noise(&self) -> f64 {
        null_threshold(&self.sigma, self.sigma.len())
    }

    fn squared_share(&self, i: usize, j: usize) -> f64 {
        let root = self.sigma[j].sqrt();
        (self.u.at(i, j) * root).powi(2) + (self.v.at(i, j) * root).powi(2)
    }
}

impl RankKSvd {
    /// Number of triplets K.
    #[must_use]
    pub fn rank(&self) -> usize {
        self.sigma.len()
    }

    /// Relative gap behind the cut, (σ_K − σ_{K+1}) / σ₁; 0 for a zero matrix. By Wedin's
    /// theorem the subspaces of U and V turn by at most perturbation / (gap · σ₁).
    #[must_use]
    pub fn gap(&self) -> f64 {
        match (self.sigma.first(), self.sigma.last()) {
            (Some(&first), Some(&last)) if first > 0.0 => {
                (last - self.sigma_next.unwrap_or(0.0)) / first
            }
            _ => 0.0,
        }
    }

    /// A bound on the sine of the largest angle by which the subspaces of U and of V are off, given that
    /// no ‖S v_j − σ_j u_j‖ or ‖Sᵀ u_j − σ_j v_j‖ exceeds `residual`, relative to σ₁ (as
    /// [`RankKSvd::residual`] measures it, or (1 + σ₁) times that of
    /// [`crate::katz_svd::KatzSvdReport`]).
    ///
    /// By Wedin's theorem (BIT 12, 1972) the sine is at most ‖R‖/δ, where the residuals of K triplets
    /// make ‖R‖ ≤ √K·`residual`, and δ is the distance from σ_K to what is left out, which is known up
    /// to another residual. 1, the trivial bound, where the gap is no larger than what blurs it. Like
    /// every bound from residuals, it presumes that no triplet was missed altogether.
    #[must_use]
    pub fn angle_bound(&self, residual: f64) -> f64 {
        let distance = self.gap() - residual;
        let bound = (self.rank() as f64).sqrt() * residual / distance;
        if distance > 0.0 && bound < 1.0 { bound } else { 1.0 }
    }

    /// True when σ_K and σ_{K+1} coincide up to [`AMBIGUOUS_GAP`], so that which vectors were
    /// kept is arbitrary. Not so when both are negligible: their vectors are zero anyway.
    #[must_use]
    pub fn ambiguous(&self) -> bool {
        let noise = self.u.rows() as f64 * f64::EPSILON * self.sigma.first().unwrap_or(&0.0);
        self.sigma_next.is_some_and(|next| next > noise) && self.gap() <= AMBIGUOUS_GAP
    }

    /// Accuracy as a decomposition of `s`, relative to σ₁: the largest of ‖S v_j − σ_j u_j‖ and
    /// ‖Sᵀ u_j − σ_j v_j‖ over all j whose vectors were not set to zero. 0 for a zero matrix.
    ///
    /// # Errors
    /// [`SvdError::Size`] or [`SvdError::NotSquare`] when `s` does not fit.
    pub fn residual(&self, s: &DenseMatrix) -> Result<f64, SvdError> {
        let n = self.u.rows();
        if s.rows() != s.cols() {
            let (rows, cols) = (s.rows(), s.cols());
            return Err(SvdError::NotSquare { rows, cols });
        }
        if s.rows() != n {
            let found = s.rows();
            return Err(SvdError::Size { expected: n, found });
        }
        let first = self.sigma.first().copied().unwrap_or(0.0);
        if first == 0.0 {
            return Ok(s.max_abs());
        }
        let transposed = s.transpose();
        let mut worst = 0.0_f64;
        for (j, &sigma) in self.sigma.iter().enumerate() {
            let (u, v) = (self.u.column(j), self.v.column(j));
            if u.iter().all(|x| *x == 0.0) {
                continue;
            }
            worst = worst.max(distance(s, &v, &u, sigma));
            worst = worst.max(distance(&transposed, &u, &v, sigma));
        }
        Ok(worst / first)
    }
}

/// ‖A x − σ y‖.
fn distance(a: &DenseMatrix, x: &[f64], y: &[f64], sigma: f64) -> f64 {
    let error = |(row, y): (&[f64], &f64)| {
        let product: f64 = row.iter().zip(x).map(|(a, b)| a * b).sum();
        (product - sigma * y).powi(2)
    };
    a.iter_rows().zip(y).map(error).sum::<f64>().sqrt()
}
