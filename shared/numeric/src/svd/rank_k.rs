//! The leading singular triplets, their gap, and how exact they are.

use super::error::SvdError;
use super::spectrum::null_threshold;
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::vector::dot;

/// Gap after σ_K, relative to σ_K, up to which the choice of the first K vectors is arbitrary.
pub const AMBIGUOUS_GAP: f64 = 1e-9;

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
    /// Residual of the triplet of σ_{K+1}, by which σ_{K+1} may be off; 0 for whole decompositions.
    pub next_residual: f64,
}

impl RankKSvd {
    /// Number of triplets K.
    #[must_use]
    pub fn rank(&self) -> usize {
        self.sigma.len()
    }

    /// Relative gap after the cut, (σ_K − σ_{K+1}) / σ₁; 0 for a zero matrix. See
    /// [`RankKSvd::angle_bound`] for what follows from it.
    #[must_use]
    pub fn gap(&self) -> f64 {
        match (self.sigma.first(), self.sigma.last()) {
            (Some(&first), Some(&last)) if first > 0.0 => {
                (last - self.sigma_next.unwrap_or(0.0)) / first
            }
            _ => 0.0,
        }
    }

    /// A bound on the sine of the largest angle between the computed and the true subspaces of U
    /// and of V, given that no ‖S v_j − σ_j u_j‖ or ‖Sᵀ u_j − σ_j v_j‖ exceeds `residual`, relative
    /// to σ₁ (as [`RankKSvd::residual`] measures it, or as [`crate::katz_svd::KatzSvdReport`] has
    /// it).
    ///
    /// By Wedin's theorem (BIT 12, 1972) the sine is at most ‖R‖/δ. The residuals of K triplets
    /// give ‖R‖ ≤ √K·`residual`. δ is the distance from the computed σ_K to the true σ_{K+1},
    /// which differs from the computed one by no more than all K + 1 residuals together (Kahan,
    /// 1967). 1, the trivial bound, where the gap is no larger than that. Like every bound from
    /// residuals, it assumes that no triplet is missing altogether.
    #[must_use]
    pub fn angle_bound(&self, residual: f64) -> f64 {
        let first = self.sigma.first().copied().unwrap_or(0.0);
        let next = if first > 0.0 { self.next_residual / first } else { 0.0 };
        let together = (self.rank() as f64).sqrt() * residual;
        let distance = self.gap() - together.hypot(next);
        let bound = together / distance;
        if together == 0.0 {
            0.0
        } else if distance > 0.0 && bound < 1.0 {
            bound
        } else {
            1.0
        }
    }

    /// True when σ_K and σ_{K+1} coincide up to [`AMBIGUOUS_GAP`] or up to rounding, so that the
    /// kept vectors are an arbitrary choice. False when both are negligible: their vectors are zero
    /// anyway.
    #[must_use]
    pub fn ambiguous(&self) -> bool {
        let noise = null_threshold(&self.sigma, self.u.rows());
        let last = self.sigma.last().copied().unwrap_or(0.0);
        let same = (AMBIGUOUS_GAP * last).max(noise);
        self.sigma_next.is_some_and(|next| next > noise && last - next <= same)
    }

    /// Accuracy as a decomposition of `s`, relative to σ₁: the largest of ‖S v_j − σ_j u_j‖ and ‖Sᵀ
    /// u_j − σ_j v_j‖ over all j whose vectors are not zero. 0 for a zero matrix.
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
    let error = |(row, y): (&[f64], &f64)| (dot(row, x) - sigma * y).powi(2);
    a.iter_rows().zip(y).map(error).sum::<f64>().sqrt()
}
