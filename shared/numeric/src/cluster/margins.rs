//! How clearly each point belongs to its cluster rather than to the next one.

use thiserror::Error;

use crate::linalg::matrix::DenseMatrix;
use crate::linalg::vector::squared_distance;

/// Why no margins could be computed.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum MarginError {
    /// There is not one label per point.
    #[error("{labels} labels for {points} points")]
    Labels {
        /// Labels given.
        labels: usize,
        /// Points given.
        points: usize,
    },
    /// Points and centroids have different dimensions.
    #[error("points of {points} dimensions but centroids of {centroids}")]
    Dimensions {
        /// Columns of the points.
        points: usize,
        /// Columns of the centroids.
        centroids: usize,
    },
    /// A label has no centroid.
    #[error("label {label} has no centroid among {clusters}")]
    Label {
        /// The label.
        label: usize,
        /// Number of centroids.
        clusters: usize,
    },
}

/// Margin (b − a) / max(a, b) of every row of `x`, with a the distance to the centroid of its own
/// cluster and b the distance to the nearest other centroid.
///
/// `x` is N × D, `labels` holds N numbers below k, `centroids` is k × D. 1 is certain, 0 is
/// undecided, negative is nearer to another centroid (which hysteresis allows). 1 for a single
/// cluster, 0 when a = b = 0. The simplified silhouette of Hruschka et al. (2006).
///
/// # Errors
/// [`MarginError`] when shapes or labels do not fit.
pub fn margins(
    x: &DenseMatrix,
    labels: &[usize],
    centroids: &DenseMatrix,
) -> Result<Vec<f64>, MarginError> {
    if labels.len() != x.rows() {
        return Err(MarginError::Labels { labels: labels.len(), points: x.rows() });
    }
    if x.cols() != centroids.cols() {
        return Err(MarginError::Dimensions { points: x.cols(), centroids: centroids.cols() });
    }
    let clusters = centroids.rows();
    if let Some(&label) = labels.iter().find(|l| **l >= clusters) {
        return Err(MarginError::Label { label, clusters });
    }
    let margin = |(row, &own): (&[f64], &usize)| {
        if clusters == 1 {
            return 1.0;
        }
        let a = squared_distance(row, centroids.row(own)).sqrt();
        let others = centroids.iter_rows().enumerate().filter(|c| c.0 != own);
        let distances = others.map(|(_, c)| squared_distance(row, c));
        let b = distances.fold(f64::INFINITY, f64::min).sqrt();
        let larger = a.max(b);
        if larger > 0.0 { (b - a) / larger } else { 0.0 }
    };
    Ok(x.iter_rows().zip(labels).map(margin).collect())
}
