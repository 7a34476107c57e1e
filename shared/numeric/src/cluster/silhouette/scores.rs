//! Silhouettes of divisions of any size, by the method that their size allows.

use super::pairs::silhouette;
use super::sample::{SAMPLE_POINTS, SilhouetteOptions, estimate_silhouette};
use super::squared::silhouette_squared;
use super::types::{Method, Silhouette, SilhouetteError};
use crate::linalg::matrix::DenseMatrix;

/// The mean silhouette of a division, and the silhouettes of its clusters and points.
#[derive(Debug, Clone, PartialEq)]
pub struct Scores {
    /// Mean over all points, or its estimate.
    pub mean: f64,
    /// Standard error of `mean`; 0 unless it is an estimate.
    pub standard_error: f64,
    /// How `mean` was computed.
    pub method: Method,
    /// Every cluster and every point. When `mean` is an estimate, they are computed from squared
    /// distances for all points; `details.method` is then [`Method::SquaredExact`].
    pub details: Silhouette,
}

/// [`Method::Exact`] for `exact_points` at most, and [`Method::Sampled`] for more.
#[must_use]
pub fn method_by_size(points: usize, exact_points: usize) -> Method {
    if points <= exact_points { Method::Exact } else { Method::Sampled }
}

/// Silhouettes of the rows of `x`, N × D, for `labels`, N arbitrary numbers, with the mean by `method`.
///
/// O(N² D) for [`Method::Exact`], O(N k D) for [`Method::SquaredExact`]. [`Method::Sampled`] compares
/// [`SAMPLE_POINTS`] points, drawn by `seed`, with all others, in O(N D) each; [`SAMPLE_POINTS`] points or fewer are
/// all scored, and their mean is exact.
///
/// # Errors
/// As of [`silhouette`].
pub fn scores(
    x: &DenseMatrix,
    labels: &[usize],
    method: Method,
    seed: u64,
) -> Result<Scores, SilhouetteError> {
    if method == Method::Sampled && x.rows() > SAMPLE_POINTS {
        let options = SilhouetteOptions { exact_points: 0, sample: SAMPLE_POINTS, seed };
        let estimate = estimate_silhouette(x, labels, &options)?;
        return Ok(Scores {
            mean: estimate.mean,
            standard_error: estimate.standard_error,
            method: estimate.method,
            details: silhouette_squared(x, labels)?,
        });
    }
    let details = match method {
        Method::SquaredExact => silhouette_squared(x, labels)?,
        Method::Exact | Method::Sampled => silhouette(x, labels)?,
    };
    Ok(Scores { mean: details.mean, standard_error: 0.0, method: details.method, details })
}
