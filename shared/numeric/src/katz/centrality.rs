//! Katz centralities: row sums of S + I, without S.

use super::alpha::check_alpha;
use super::error::KatzError;
use crate::linalg::matrix::SparseMatrix;
use crate::radius::Chebyshev;
use crate::radius::tracker::{RadiusBound, RadiusTracker};

/// Most sweeps; the Neumann series at αρ = 0.99 takes as many to 1e-9.
const CENTRALITY_SWEEPS: usize = 2000;

/// Growth of the residual over its best value that shows a spectrum far from real.
const DIVERGENCE_RATIO: f64 = 4.0;

/// Sweeps after which Chebyshev steps must be ahead of as many of the Neumann series, as they are
/// for real spectra.
const TRIAL_SWEEPS: i32 = 32;

/// Accuracy of a centrality.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Centrality {
    /// Largest modulus η of an entry of 1 − (I − αA) x. As (I − αA)⁻¹ ≥ 0, the error of no entry of
    /// x exceeds the fraction η of its true value, except by rounding.
    pub residual: f64,
    /// Number of products with A.
    pub sweeps: usize,
}

impl RadiusTracker {
    /// Solves (I − αA) x = 1 for the Katz centralities x (Katz, Psychometrika 18, 1953) to a
    /// residual of `tolerance` in the largest entry, starting from those of the last call; read
    /// them from [`RadiusTracker::centralities`]. Entry i weighs all walks that leave node i, the
    /// empty walk included, so it is at least 1.
    ///
    /// Ends early when rounding of x hides the residual, and after 2000 sweeps in any case; check
    /// [`Centrality::residual`].
    ///
    /// # Errors
    /// [`KatzError::Alpha`] and [`KatzError::Diverges`] for a decay that `bound`, which must belong
    /// to `a`, does not admit; [`KatzError::Overflow`] when x leaves the range of `f64`.
    pub fn solve_centrality(
        &mut self,
        a: &SparseMatrix,
        alpha: f64,
        bound: &RadiusBound,
        tolerance: f64,
    ) -> Result<Centrality, KatzError> {
        check_alpha(alpha, bound.upper)?;
        let n = a.nodes();
        let Self { centrality: x, previous: next, .. } = self;
        if x.len() != n {
            x.clear();
            x.resize(n, 1.0);
        }
        next.resize(n, 0.0);
        let half_width = alpha * bound.upper;
        let mut chebyshev = Chebyshev::new(alpha, half_width);
        let mut best = f64::INFINITY;
        let mut wanted = f64::INFINITY;
        let rounding = (a.max_degree() + 4) as f64 * f64::EPSILON;
        for sweeps in 1..=CENTRALITY_SWEEPS {
            let sweep = chebyshev.step(a, x, next);
            if !(sweep.top.is_finite() && sweep.residual.is_finite()) {
                x.fill(1.0);
                return Err(KatzError::Overflow { alpha });
            }
            let reached = sweep.residual <= tolerance.max(rounding * sweep.top);
            if reached || sweeps == CENTRALITY_SWEEPS || n == 0 {
                return Ok(Centrality { residual: sweep.residual, sweeps });
            }
            let checked = sweeps % TRIAL_SWEEPS as usize == 0;
            if sweep.residual > DIVERGENCE_RATIO * best || (checked && sweep.residual > wanted) {
                chebyshev = Chebyshev::new(alpha, 0.0);
            }
            best = best.min(sweep.residual);
            if checked {
                wanted = sweep.residual * half_width.powi(TRIAL_SWEEPS);
            }
            std::mem::swap(x, next);
        }
        Ok(Centrality { residual: best, sweeps: CENTRALITY_SWEEPS })
    }

    /// The Katz centralities of the last solve, one per node, each at least 1.
    #[must_use]
    pub fn centralities(&self) -> &[f64] {
        &self.centrality
    }
}
