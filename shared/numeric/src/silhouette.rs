//! Exact silhouettes (Rousseeuw, J. Comput. Appl. Math. 20, 1987) with Euclidean distances.

use std::collections::BTreeMap;

use thiserror::Error;

use crate::matrix::DenseMatrix;

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
}

/// Silhouette (b − a) / max(a, b) of every row of `x`, where a is the mean distance to the other
/// members of its cluster and b the smallest mean distance to the members of another cluster.
///
/// `x` is N × D, `labels` holds N arbitrary numbers. The only member of a cluster has the
/// value 0, and so has a point with a = b = 0. O(N² D) time, O(N) memory besides the result.
///
/// # Errors
/// [`SilhouetteError::Labels`], and [`SilhouetteError::Undefined`] for fewer than two clusters.
pub fn silhouette(x: &DenseMatrix, labels: &[usize]) -> Result<Silhouette, SilhouetteError> {
    let points = x.rows();
    if labels.len() != points {
        let labels = labels.len();
        return Err(SilhouetteError::Labels { labels, points });
    }
    let mut sizes: BTreeMap<usize, usize> = BTreeMap::new();
    for &label in labels {
        *sizes.entry(label).or_default() += 1;
    }
    let clusters = sizes.len();
    if clusters < 2 {
        return Err(SilhouetteError::Undefined { clusters });
    }
    let numbers: BTreeMap<usize, usize> = sizes.keys().copied().zip(0..).collect();
    let member: Vec<usize> = labels.iter().map(|l| numbers[l]).collect();
    let sizes: Vec<usize> = sizes.into_values().collect();

    let mut sums = vec![0.0; clusters];
    let mut totals = vec![0.0; clusters];
    let mut per_point = Vec::with_capacity(points);
    for i in 0..points {
        sums.fill(0.0);
        for (row, &c) in x.iter_rows().zip(&member) {
            sums[c] += distance(x.row(i), row);
        }
        let value = value(member[i], &sums, &sizes);
        totals[member[i]] += value;
        per_point.push(value);
    }
    let means = numbers.into_keys().zip(&totals).zip(&sizes);
    Ok(Silhouette {
        per_cluster: means.map(|((label, t), &n)| (label, t / n as f64)).collect(),
        mean: per_point.iter().sum::<f64>() / points as f64,
        per_point,
    })
}

/// Silhouette of a point in cluster `own`, from its summed distances to all clusters.
fn value(own: usize, sums: &[f64], sizes: &[usize]) -> f64 {
    if sizes[own] == 1 {
        return 0.0;
    }
    let a = sums[own] / (sizes[own] - 1) as f64;
    let others = sums.iter().zip(sizes).enumerate().filter(|e| e.0 != own);
    let b = others.fold(f64::INFINITY, |b, (_, (sum, &n))| b.min(sum / n as f64));
    let larger = a.max(b);
    if larger > 0.0 { (b - a) / larger } else { 0.0 }
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    let squares = a.iter().zip(b).map(|(x, y)| (x - y) * (x - y));
    squares.sum::<f64>().sqrt()
}
