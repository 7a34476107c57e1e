//! The Katz similarity as the sum of all walks, by doubling their length.
//!
//! S₂ₖ = Sₖ + Bᵏ Sₖ for B = αA, where Sₖ holds the walks of up to k steps. Nothing is ever subtracted:
//! each entry of S is right to a relative error of about n ε times the length of its walks, however
//! far the weights of a graph are apart. Each doubling costs two dense products.

use super::error::KatzError;
use crate::linalg::backend::dense::multiply;
use crate::linalg::matrix::{DenseMatrix, SparseMatrix};

/// Most doublings. Walks of 2⁴⁰ steps would matter only for an αρ closer to 1 than bounds of ρ admit.
const MAX_DOUBLINGS: usize = 40;

/// Size of new walks, relative to an entry, below which rounding of the entry loses them.
const NEGLIGIBLE_RATIO: f64 = 1e-17;

/// S of the graph `a`; `None` when an entry is out of range or the sum does not end. The series of
/// `a` converges.
///
/// # Errors
/// [`KatzError::Matrix`] when n² entries are too many.
pub(super) fn sum_of_walks(a: &SparseMatrix, alpha: f64) -> Result<Option<DenseMatrix>, KatzError> {
    let n = a.nodes();
    let mut power = DenseMatrix::zeros(n, n)?;
    for (i, j, weight) in a.triplets() {
        power.row_mut(i)[j] = alpha * weight;
    }
    let mut sum = power.clone();
    for _ in 0..MAX_DOUBLINGS {
        let longer = multiply(&power, &sum);
        let mut counts = false;
        for (sum, longer) in sum.data_mut().iter_mut().zip(longer.data()) {
            counts |= *longer > NEGLIGIBLE_RATIO * *sum;
            *sum += longer;
        }
        if !counts {
            return Ok(DenseMatrix::new(n, n, sum.into_data()).ok());
        }
        power = multiply(&power, &power);
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chain_is_exact_however_small() {
        let n = 70;
        let a = SparseMatrix::from_triplets(n, (1..n).map(|i| (i - 1, i, 0.25))).unwrap();
        let s = sum_of_walks(&a, 0.5).unwrap().unwrap();
        for i in 0..n {
            for j in 0..n {
                let wanted = if j > i { 0.125_f64.powi((j - i) as i32) } else { 0.0 };
                assert_eq!(s.at(i, j), wanted);
            }
        }
    }

    #[test]
    fn sums_that_leave_the_range_are_refused() {
        let a = SparseMatrix::from_triplets(9, (1..9).map(|i| (i - 1, i, 1.0))).unwrap();
        assert!(sum_of_walks(&a, 1e60).unwrap().is_none());
        // A cycle of weight 1 never ends.
        let a = SparseMatrix::from_triplets(2, [(0, 1, 1.0), (1, 0, 1.0)]).unwrap();
        assert!(sum_of_walks(&a, 1.0).unwrap().is_none());
    }
}
