//! What silhouettes are, how they were computed, and why there are none.

pub use muster_model::audit::SilhouetteMethod as Method;
use thiserror::Error;

/// The parameter of `SilhouetteOptions` that is out of its range.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum SilhouetteOptionsError {
    /// A sample of fewer than two points has no standard error.
    #[error("a sample of {0} points has no standard error: at least 2 are needed")]
    Sample(usize),
}

/// Why there are no silhouettes.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum SilhouetteError {
    /// A parameter is out of its range.
    #[error(transparent)]
    Options(#[from] SilhouetteOptionsError),
    /// There is not one label per point.
    #[error("{labels} labels for {points} points")]
    Labels {
        /// Labels given.
        labels: usize,
        /// Points given.
        points: usize,
    },
    /// All points share one cluster, or there are none: there is no other cluster to compare with.
    #[error("silhouettes are undefined for {clusters} cluster(s)")]
    Undefined {
        /// Number of clusters, 0 or 1.
        clusters: usize,
    },
}

/// Silhouettes of one division, each between −1 and 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Silhouette {
    /// One value per point.
    pub per_point: Vec<f64>,
    /// Label and mean value of every cluster, labels ascending.
    pub per_cluster: Vec<(usize, f64)>,
    /// Mean over all points.
    pub mean: f64,
    /// How they were computed.
    pub method: Method,
}
