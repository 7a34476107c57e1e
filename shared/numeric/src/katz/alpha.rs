//! The decay α, and the check that the Katz series converges.

pub use muster_model::settings::Alpha;

use super::error::KatzError;
use crate::linalg::matrix::SparseMatrix;
use crate::norm::spectral_norm;
use crate::radius::exact::SpectralRadius;

/// The decay α for the graph `a` whose spectral radius is `radius`. α has the inverse unit of the
/// weights of A.
///
/// A fraction f gives α = f/ρ, with the upper bound of ρ to be on the safe side. Acyclic graphs have
/// ρ = 0 and admit every α; the fraction then refers to 1/‖A‖₂, which has the same unit and equals
/// 1/ρ for symmetric graphs. Without any edge α = f.
///
/// # Errors
/// [`KatzError::Fraction`], [`KatzError::Alpha`] or [`KatzError::Diverges`].
pub fn resolve_alpha(
    alpha: Alpha,
    a: &SparseMatrix,
    radius: &SpectralRadius,
) -> Result<f64, KatzError> {
    let alpha = match alpha {
        Alpha::Value(value) => value,
        Alpha::Fraction { fraction: f } if !(f > 0.0 && f < 1.0) => {
            return Err(KatzError::Fraction(f));
        }
        Alpha::Fraction { fraction: f } if radius.upper > 0.0 => f / radius.upper,
        Alpha::Fraction { fraction: f } if a.is_zero() => f,
        Alpha::Fraction { fraction: f } => f / spectral_norm(a),
    };
    check_alpha(alpha, radius.upper)?;
    Ok(alpha)
}

/// Refuses α unless it is positive, finite and certified to let the series converge by the upper
/// bound `radius` of ρ.
pub(crate) fn check_alpha(alpha: f64, radius: f64) -> Result<(), KatzError> {
    if !(alpha.is_finite() && alpha > 0.0) {
        return Err(KatzError::Alpha(alpha));
    }
    let product = alpha * radius;
    if product.is_nan() || product >= 1.0 {
        return Err(KatzError::Diverges { alpha, radius });
    }
    Ok(())
}
