//! First centroids where there is a reserve.
//!
//! Greedy k-means++ draws points far from all others first. With a reserve these are the points that belong into it,
//! so that a distance counts at most what the reserve costs (Bhaskara, Vadgama and Xu, *Greedy Sampling for Approximate
//! Clustering in the Presence of Outliers*, NeurIPS 2019).

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::linalg::matrix::DenseMatrix;
use crate::linalg::vector::squared_distance;

/// `clusters` points drawn with probability proportional to the squared distance from the nearest one so far, at most
/// `most`; each is the best of 2 + ln k draws.
pub(super) fn capped_plus_plus(
    x: &DenseMatrix,
    clusters: usize,
    most: f64,
    rng: &mut ChaCha8Rng,
) -> DenseMatrix {
    let trials = 2 + (clusters as f64).ln() as usize;
    let mut chosen = vec![rng.random_range(0..x.rows())];
    let mut weights = lowered(x, &vec![most; x.rows()], chosen[0]);
    while chosen.len() < clusters {
        let mut best: Option<(f64, usize, Vec<f64>)> = None;
        for _ in 0..trials {
            let point = draw(&weights, rng);
            let next = lowered(x, &weights, point);
            let total = next.iter().sum();
            if best.as_ref().is_none_or(|(least, ..)| total < *least) {
                best = Some((total, point, next));
            }
        }
        if let Some((_, point, next)) = best {
            chosen.push(point);
            weights = next;
        }
    }
    x.select_rows(&chosen)
}

/// The weights with one more chosen point.
fn lowered(x: &DenseMatrix, weights: &[f64], point: usize) -> Vec<f64> {
    let place = x.row(point);
    x.iter_rows().zip(weights).map(|(row, w)| w.min(squared_distance(row, place))).collect()
}

/// A point drawn with probability proportional to its weight; uniform when all are zero.
fn draw(weights: &[f64], rng: &mut ChaCha8Rng) -> usize {
    let total: f64 = weights.iter().sum();
    if total <= 0.0 {
        return rng.random_range(0..weights.len());
    }
    let mut left = rng.random::<f64>() * total;
    // The last point of positive weight absorbs the rounding.
    let mut last = 0;
    for (point, weight) in weights.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
        last = point;
        left -= weight;
        if left < 0.0 {
            break;
        }
    }
    last
}
