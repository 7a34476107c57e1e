//! Silhouettes (Rousseeuw, J. Comput. Appl. Math. 20, 1987): how much nearer each point is to its
//! own cluster than to the next one.
//!
//! Three ways lead to them, named by [`Method`]. All pairs of points, with Euclidean distances, is
//! the definition; it takes O(N² D) operations. Squared distances are another, sharper measure, for
//! which the sums over a cluster follow from its mean, in O(N k D). And the mean over all points
//! can be estimated from some of them, each compared with all points, with a standard error.
//! [`scores`] takes any of the three by name.

mod groups;
mod pairs;
mod sample;
mod scores;
mod squared;

pub use muster_model::audit::SilhouetteMethod as Method;
use thiserror::Error;

use crate::matrix::DenseMatrix;
use groups::Groups;

pub use sample::{
    EXACT_POINTS, SAMPLE, SilhouetteEstimate, SilhouetteOptions, estimate_silhouette,
};
pub use scores::{Scores, method_by_size, scores};
pub use squared::silhouette_squared;

/// Why there are no silhouettes.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum SilhouetteError {
    /// There is not one label per point.
    #[error("{labels} labels for {points} points")]
    Labels {
        /// Labels given.
        labels: usize,
        /// Points given.
        points: usize,
    },
    /// All points share one cluster (or there are none): no other cluster to compare with.
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

/// Silhouette (b − a) / max(a, b) of every row of `x`, where a is the mean distance to the other
/// members of its cluster and b the smallest mean distance to the members of another cluster.
///
/// `x` is N × D, `labels` holds N arbitrary numbers. The only member of a cluster has the
/// value 0, and so has a point with a = b = 0. O(N² D) time, every distance once; besides the
/// result, memory for a copy of the points, and O(N + k) more.
///
/// # Errors
/// [`SilhouetteError::Labels`], and [`SilhouetteError::Undefined`] for fewer than two clusters.
pub fn silhouette(x: &DenseMatrix, labels: &[usize]) -> Result<Silhouette, SilhouetteError> {
    let groups = Groups::new(x, labels)?;
    let per_point = pairs::all_pairs(x, &groups);
    Ok(summary(per_point, &groups, Method::Exact))
}

/// The values together with their means.
fn summary(per_point: Vec<f64>, groups: &Groups, method: Method) -> Silhouette {
    let mut totals = vec![0.0; groups.sizes.len()];
    for (value, &c) in per_point.iter().zip(&groups.member) {
        totals[c as usize] += value;
    }
    let means = groups.labels.iter().zip(&totals).zip(&groups.sizes);
    Silhouette {
        per_cluster: means.map(|((&label, total), &n)| (label, total / n as f64)).collect(),
        mean: per_point.iter().sum::<f64>() / per_point.len() as f64,
        per_point,
        method,
    }
}

/// Silhouette of a point in a cluster of `size` members, from its mean distances a to the other
/// members and b to the nearest other cluster.
fn value(size: usize, a: f64, b: f64) -> f64 {
    let larger = a.max(b);
    if size > 1 && larger > 0.0 { (b - a) / larger } else { 0.0 }
}
