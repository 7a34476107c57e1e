//! The clusters that labels describe.

use std::collections::BTreeMap;

use super::types::{Method, Silhouette, SilhouetteError};
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::simd_pack::{GROUP_POINTS, SimdPack};

/// At least two clusters, numbered by ascending label.
pub(super) struct Groups {
    /// Label of each cluster.
    pub(super) labels: Vec<usize>,
    /// Number of members of each cluster.
    pub(super) sizes: Vec<usize>,
    /// Cluster of each point.
    pub(super) member: Vec<u32>,
}

impl Groups {
    /// Clusters of the rows of `x`.
    pub(super) fn new(x: &DenseMatrix, labels: &[usize]) -> Result<Self, SilhouetteError> {
        let points = x.rows();
        if labels.len() != points {
            return Err(SilhouetteError::Labels { labels: labels.len(), points });
        }
        let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
        for run in labels.chunk_by(|a, b| a == b) {
            *counts.entry(run[0]).or_default() += run.len();
        }
        let clusters = counts.len();
        if clusters < 2 {
            return Err(SilhouetteError::Undefined { clusters });
        }
        let numbers: BTreeMap<usize, u32> = counts.keys().copied().zip(0..).collect();
        let member = labels.iter().map(|label| numbers[label]).collect();
        let (labels, sizes) = counts.into_iter().unzip();
        Ok(Self { labels, sizes, member })
    }
}

/// The points packed by cluster, every cluster from a new group on.
pub(super) struct Ordered {
    pub(super) pack: SimdPack,
    /// First place of each cluster, and the end of the last one.
    pub(super) starts: Vec<usize>,
    /// Place of each point.
    pub(super) place: Vec<u32>,
    /// ‖x‖² of each point x, and −½‖x‖².
    pub(super) squares: Vec<f64>,
    pub(super) minus_halves: Vec<f64>,
    /// 1 for each place that holds a point, 0 for others.
    pub(super) used: Vec<f64>,
}

impl Ordered {
    /// Packs the rows of `x` less `centre` by cluster.
    pub(super) fn new(x: &DenseMatrix, centre: &[f64], groups: &Groups) -> Self {
        let mut starts = vec![0];
        let mut end = 0;
        for size in &groups.sizes {
            end += size.next_multiple_of(GROUP_POINTS);
            starts.push(end);
        }
        let mut next = starts.clone();
        let mut pack = SimdPack::zeros(end, x.cols());
        let mut used = vec![0.0; end];
        let mut place = Vec::with_capacity(x.rows());
        for (row, &c) in x.iter_rows().zip(&groups.member) {
            let at = &mut next[c as usize];
            pack.set(*at, row.iter().zip(centre).map(|(v, c)| v - c));
            used[*at] = 1.0;
            place.push(*at as u32);
            *at += 1;
        }
        let squares = pack.squares();
        let minus_halves = squares.iter().map(|square| -0.5 * square).collect();
        Self { pack, starts, place, squares, minus_halves, used }
    }
}

/// The values with their means.
pub(super) fn summary(per_point: Vec<f64>, groups: &Groups, method: Method) -> Silhouette {
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

/// Share of the extent of all points, the largest distance from their mean, up to which a distance is none: vectors that are
/// equal but for rounding are in the same place, and what rounding says of the nearer cluster is noise. Rounding is some 1e-16
/// of the extent in small fleets and 1e-14 in large ones.
const ROUNDING_SHARE: f64 = 1e-12;

/// The distance up to which points are in the same place, from the squared distances of all points to their mean.
pub(super) fn same_place(squares: &[f64]) -> f64 {
    ROUNDING_SHARE * squares.iter().copied().fold(0.0, f64::max).sqrt()
}

/// Silhouette of a point in a cluster of `size` members, from its mean distances a to the other
/// members and b to the nearest other cluster. 0 if neither is above `none`.
pub(super) fn value(size: usize, a: f64, b: f64, none: f64) -> f64 {
    let larger = a.max(b);
    if size > 1 && larger > none { (b - a) / larger } else { 0.0 }
}
