//! Silhouettes of a division, by the method that its size allows.

use muster_model::audit::SilhouetteMethod;
use muster_numeric::matrix::DenseMatrix;
use muster_numeric::silhouette::{Scores, SilhouetteError, method_by_size, scores};

/// How silhouettes are computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SilhouetteParams {
    /// The method; none for one that follows from the size.
    pub method: Option<SilhouetteMethod>,
    /// Divisions of up to so many robots are exact where the method follows from the size; larger ones are
    /// sampled. Default: 10,000, whose pairs take a few hundredths of a second, so that an audit keeps up
    /// with the divisions.
    pub exact_robots: usize,
    /// Seed of the robots that are sampled. Default: 0; the same robots are drawn in every frame while the
    /// fleet stays the same, so that the estimate moves with the division and not with the draw.
    pub seed: u64,
}

impl Default for SilhouetteParams {
    /// Those of a live fleet.
    fn default() -> Self {
        Self { method: None, exact_robots: 10_000, seed: 0 }
    }
}

impl SilhouetteParams {
    /// The method for a division of so many robots.
    #[must_use]
    pub fn method(&self, robots: usize) -> SilhouetteMethod {
        self.method.unwrap_or_else(|| method_by_size(robots, self.exact_robots))
    }
}

/// Silhouettes of the rows of `x`, N × D, for `labels`, N arbitrary numbers.
///
/// # Errors
/// [`SilhouetteError`] for fewer than two teams, or labels that do not fit.
pub fn silhouettes(
    x: &DenseMatrix,
    labels: &[usize],
    params: &SilhouetteParams,
) -> Result<Scores, SilhouetteError> {
    scores(x, labels, params.method(x.rows()), params.seed)
}
