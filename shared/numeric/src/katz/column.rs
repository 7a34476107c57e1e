//! One column of the Katz similarity, for graphs whose similarity is too large to store.
//!
//! S e_j = Σ_{l ≥ 1} (αA)ˡ e_j has no negative term, so the sum loses no digit however small an
//! entry is, and every partial sum is a lower bound. The number of products is the length of the
//! longest walk that still matters.

use super::alpha::check_alpha;
use super::error::KatzError;
use crate::linalg::matrix::SparseMatrix;

/// Most multiply-adds for one column: one or two seconds.
const MAX_WORK: usize = 2_000_000_000;

/// Size of a term, relative to the sum, below which rounding of the sum loses it.
const NEGLIGIBLE_RATIO: f64 = 1e-17;

/// A column of S.
#[derive(Debug, Clone, PartialEq)]
pub struct KatzColumn {
    /// S_ij for each node i, summed over all walks of at most `steps` steps: never above the true
    /// value except by rounding.
    pub values: Vec<f64>,
    /// Largest weight of a walk to node j of the next length. The omitted walks of S_ij weigh at
    /// most this times the Katz centrality of node i (see
    /// [`crate::radius_bound::RadiusTracker::centralities`]).
    pub remainder: f64,
    /// Steps of the longest walks in the sum.
    pub steps: usize,
}

/// Column `node` of S = (I − αA)⁻¹ − I: the similarity of each node *to* that one.
///
/// `radius` is an upper bound of ρ(A). Ends when rounding loses further terms, or after two billion
/// multiply-adds; check [`KatzColumn::remainder`].
///
/// # Errors
/// [`KatzError::Alpha`] and [`KatzError::Diverges`] for a decay that the bound does not admit,
/// [`KatzError::Overflow`] when an entry leaves the range of `f64`, and [`KatzError::Node`] for a
/// node beyond the graph.
pub fn katz_column(
    a: &SparseMatrix,
    alpha: f64,
    radius: f64,
    node: usize,
) -> Result<KatzColumn, KatzError> {
    check_alpha(alpha, radius)?;
    let n = a.nodes();
    if node >= n {
        return Err(KatzError::Node { node, nodes: n });
    }
    let mut values = vec![0.0; n];
    let mut term = vec![0.0; n];
    let mut next = vec![0.0; n];
    term[node] = 1.0;
    let most = MAX_WORK / a.edges().max(1);
    let mut steps = 0;
    loop {
        let mut largest = 0.0_f64;
        // True when a term still changes an entry: small entries of distant nodes grow last.
        let mut counts = false;
        for (i, next) in next.iter_mut().enumerate() {
            let sum: f64 = a.row(i).map(|(j, w)| w * term[j]).sum();
            *next = alpha * sum;
            largest = largest.max(*next);
            counts |= *next > NEGLIGIBLE_RATIO * values[i];
        }
        if !largest.is_finite() {
            return Err(KatzError::Overflow { alpha });
        }
        if !counts || steps >= most {
            return Ok(KatzColumn { values, remainder: largest, steps });
        }
        for (value, next) in values.iter_mut().zip(&next) {
            *value += next;
        }
        std::mem::swap(&mut term, &mut next);
        steps += 1;
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::katz::katz_similarity;
    use crate::radius::exact::spectral_radius;

    #[test]
    fn columns_are_those_of_the_similarity() {
        for (seed, fraction) in [(1, 0.3), (2, 0.9), (3, 0.99)] {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let n = 60;
            let edges: Vec<_> = (0..2 * n)
                .map(|_| (rng.random_range(0..n), rng.random_range(0..n), rng.random::<f64>()))
                .collect();
            let a = SparseMatrix::from_triplets(n, edges).unwrap();
            let radius = spectral_radius(&a, None);
            let alpha = fraction / radius.upper;
            let s = katz_similarity(&a, alpha, &radius).unwrap();
            for j in 0..n {
                let column = katz_column(&a, alpha, radius.upper, j).unwrap();
                for i in 0..n {
                    let (found, wanted) = (column.values[i], s.row(i)[j]);
                    assert!((found - wanted).abs() < 1e-12 * (1.0 + wanted), "S({i}, {j})");
                }
            }
        }
    }

    #[test]
    fn a_chain_is_exact_however_small() {
        let n = 200;
        let a = SparseMatrix::from_triplets(n, (1..n).map(|i| (i - 1, i, 0.25))).unwrap();
        let column = katz_column(&a, 0.5, 0.0, n - 1).unwrap();
        for (i, value) in column.values[..n - 1].iter().enumerate() {
            assert_eq!(*value, 0.125_f64.powi((n - 1 - i) as i32));
        }
        assert_eq!((column.values[n - 1], column.remainder, column.steps), (0.0, 0.0, n - 1));
    }

    #[test]
    fn invalid_input_is_refused() {
        let a = SparseMatrix::from_triplets(2, [(0, 1, 1.0), (1, 0, 1.0)]).unwrap();
        assert!(matches!(katz_column(&a, 1.0, 1.0, 0), Err(KatzError::Diverges { .. })));
        assert!(matches!(katz_column(&a, 0.5, 1.0, 2), Err(KatzError::Node { .. })));
    }
}
