//! First centroids of a start.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::partition::squared_distance;
use crate::matrix::DenseMatrix;

/// Points nearer to each other than this fraction of the longest row count as equal: nodes that
/// are interchangeable in the graph have equal rows up to rounding, which must not divide them.
pub const DISTINCT: f64 = 1e-9;

/// Number of distinct rows, counted up to `limit`.
pub(super) fn count_distinct(x: &DenseMatrix, limit: usize) -> usize {
    let squares = x.iter_rows().map(|r| r.iter().map(|v| v * v).sum::<f64>());
    let longest = squares.fold(0.0, f64::max);
    let tolerance = DISTINCT * DISTINCT * longest;
    let mut found: Vec<&[f64]> = Vec::new();
    for row in x.iter_rows() {
        if found.len() == limit {
            break;
        }
        if found.iter().all(|f| squared_distance(f, row) > tolerance) {
            found.push(row);
        }
    }
    found.len()
}

/// `clusters` different points drawn uniformly (a partial Fisher–Yates shuffle).
pub(super) fn random(x: &DenseMatrix, clusters: usize, rng: &mut ChaCha8Rng) -> DenseMatrix {
    let mut indices: Vec<usize> = (0..x.rows()).collect();
    for i in 0..clusters {
        let j = rng.random_range(i..x.rows());
        indices.swap(i, j);
    }
    x.select_rows(&indices[..clusters])
}

/// Greedy k-means++: every further centroid is a point drawn with probability proportional to
/// its squared distance from the nearest one so far, the best of 2 + ln k draws.
pub(super) fn plus_plus(x: &DenseMatrix, clusters: usize, rng: &mut ChaCha8Rng) -> DenseMatrix {
    let trials = 2 + (clusters as f64).ln() as usize;
    let mut chosen = vec![rng.random_range(0..x.rows())];
    let mut nearest = distances(x, chosen[0]);
    while chosen.len() < clusters {
        let mut best: Option<(f64, usize, Vec<f64>)> = None;
        for _ in 0..trials {
            let candidate = draw(&nearest, rng);
            let mut next = distances(x, candidate);
            for (new, old) in next.iter_mut().zip(&nearest) {
                *new = new.min(*old);
            }
            let potential: f64 = next.iter().sum();
            if best.as_ref().is_none_or(|b| potential < b.0) {
                best = Some((potential, candidate, next));
            }
        }
        if let Some((_, candidate, next)) = best {
            chosen.push(candidate);
            nearest = next;
        }
    }
    x.select_rows(&chosen)
}

/// Squared distances of all points from point `i`.
fn distances(x: &DenseMatrix, i: usize) -> Vec<f64> {
    x.iter_rows().map(|row| squared_distance(row, x.row(i))).collect()
}

/// Index drawn with probability proportional to `weights`; uniform when all are zero.
fn draw(weights: &[f64], rng: &mut ChaCha8Rng) -> usize {
    let total: f64 = weights.iter().sum();
    if total <= 0.0 {
        return rng.random_range(0..weights.len());
    }
    let mut left = rng.random::<f64>() * total;
    let mut last = 0;
    for (i, &weight) in weights.iter().enumerate() {
        if weight > 0.0 {
            last = i;
            left -= weight;
            if left < 0.0 {
                break;
            }
        }
    }
    // The last positive weight takes what rounding leaves over.
    last
}
