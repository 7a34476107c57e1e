//! Silhouettes of divisions of any size, by the method that their size allows.

use super::{
    Method, SAMPLE, Silhouette, SilhouetteError, SilhouetteOptions, estimate_silhouette,
    silhouette, silhouette_squared,
};
use crate::matrix::DenseMatrix;

/// The mean silhouette of a division, and the silhouettes of its clusters and points.
#[derive(Debug, Clone, PartialEq)]
pub struct Scores {
    /// Mean over all points, or its estimate.
    pub mean: f64,
    /// Standard error of `mean`; 0 unless it is an estimate.
    pub standard_error: f64,
    /// How `mean` was computed.
    pub method: Method,
    /// Every cluster and every point, by a method of its own: where `mean` is an estimate, which says
    /// nothing of the points that were not drawn, these rest on squared distances, exactly.
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
/// [`SAMPLE`] points, drawn by `seed`, with all others, in O(N D) each; [`SAMPLE`] points or fewer are
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
    if method == Method::Sampled && x.rows() > SAMPLE {
        let options = SilhouetteOptions { exact_points: 0, sample: SAMPLE, seed };
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
