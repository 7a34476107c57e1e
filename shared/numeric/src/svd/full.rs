//! Full singular value decomposition of a square matrix.

use super::error::SvdError;
use super::rank_k::RankKSvd;
use super::signs::{fix_signs, scale_column};
use super::spectrum::{Spectrum, null_threshold};
use crate::linalg::backend::dense::{Factors, thin_svd};
use crate::linalg::jacobi::jacobi_svd;
use crate::linalg::matrix::DenseMatrix;

/// Full decomposition of a square n × n matrix, all n singular values and vectors.
#[derive(Debug, Clone, PartialEq)]
pub struct FullSvd {
    u: DenseMatrix,
    sigma: Vec<f64>,
    v: DenseMatrix,
}

/// Full singular value decomposition of the square matrix `s`.
///
/// The sign of each pair of vectors is chosen so that the entry of u_j with the largest modulus is
/// positive (the first of them within [`SIGN_TIE`](super::SIGN_TIE)). Vectors of negligible
/// singular values, σ_j ≤ n ε σ₁, are set to zero: null directions are arbitrary and would add
/// noise.
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

/// The library's decomposition, of the transpose if it fails (a known defect affects single
/// matrices at random), and one-sided Jacobi if that fails too.
fn robust_svd(s: &DenseMatrix) -> Factors {
    let swapped = |f: Factors| Factors { u: f.v, sigma: f.sigma, v: f.u };
    thin_svd(s).or_else(|| thin_svd(&s.transpose()).map(swapped)).unwrap_or_else(|| jacobi_svd(s))
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
            next_residual: 0.0,
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
