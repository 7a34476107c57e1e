//! Diagonal scaling that makes the Katz system well conditioned.
//!
//! Where a graph has strong chains but weak cycles, α is large relative to the weights of the
//! chains, entries of S span many orders of magnitude, and elimination on I − αA loses digits in
//! proportion to the square of the largest. With a vector x > 0 such that αAx ≤ x, the similar
//! matrix I − αD⁻¹AD, D = diag(x), has non-negative row sums: it is diagonally dominant, its
//! elimination does not grow, and its condition is of the order 1/(1 − αρ).

use crate::graph::components::strongly_connected;
use crate::linalg::matrix::SparseMatrix;

/// Largest quotient of two scales; beyond it scaling would overflow.
const MAX_SPREAD: f64 = 1e200;

/// Scales x, one per node, each a power of two (so that scaling is exact), with αAx ≤ x up to a
/// small factor; ones where no useful scales exist.
///
/// `vector` holds the Perron vectors of the strongly connected components. Components are processed
/// in the order in which no edge leads to a later one. Within a component x = t p with the Perron
/// vector p, and t large enough for its edges to earlier components.
pub(crate) fn katz_scales(a: &SparseMatrix, alpha: f64, vector: &[f64]) -> Vec<f64> {
    let n = a.nodes();
    let plain = vec![1.0; n];
    if vector.len() != n || vector.iter().any(|v| !(v.is_finite() && *v > 0.0)) {
        return plain;
    }
    let mut x = vec![0.0; n];
    let mut inside = vec![false; n];
    for component in strongly_connected(a) {
        for &i in &component {
            inside[i] = true;
        }
        let mut t = 1.0_f64;
        for &i in &component {
            let (mut own, mut outer) = (0.0, 0.0);
            for (j, w) in a.row(i) {
                if inside[j] {
                    own += alpha * w * vector[j];
                } else {
                    outer += alpha * w * x[j];
                }
            }
            let room = vector[i] - own;
            if room <= 0.0 {
                return plain;
            }
            t = t.max(outer / room);
        }
        for &i in &component {
            inside[i] = false;
            x[i] = t * vector[i];
        }
    }
    powers_of_two(x).unwrap_or(plain)
}

/// Scales rounded to powers of two, the largest 1; `None` unless all are positive and finite and
/// within [`MAX_SPREAD`] of one another.
pub(crate) fn powers_of_two(x: Vec<f64>) -> Option<Vec<f64>> {
    let (low, high) = x.iter().fold((f64::INFINITY, 0.0_f64), |e, &v| (e.0.min(v), e.1.max(v)));
    let usable = x.iter().all(|v| v.is_finite() && *v > 0.0) && high / low <= MAX_SPREAD;
    (usable || x.is_empty()).then(|| x.iter().map(|v| (v / high).log2().round().exp2()).collect())
}
