//! One-sided Jacobi singular value decomposition: slow, simple, and always convergent.
//!
//! Used when the library's divide and conquer gives up. Method: Hestenes (1958), see Golub and
//! Van Loan, *Matrix Computations*, 4th edition, section 8.6.3.

use super::backend::dense::Factors;
use super::matrix::DenseMatrix;
use super::vector::dot;

/// Most sweeps; about ten suffice in practice.
const MAX_SWEEPS: usize = 60;

/// Cosine between two columns below which they count as orthogonal.
const ORTHOGONAL_COSINE: f64 = 1e-15;

/// Singular value decomposition A = U diag(σ) Vᵀ of a square n × n matrix, σ descending.
///
/// Columns of U that belong to σ = 0 are zero vectors, not a completed basis.
pub(crate) fn jacobi_svd(a: &DenseMatrix) -> Factors {
    let n = a.cols();
    // Rows of `w` are the columns of A V, and rows of `v` those of V: rows are contiguous.
    let mut w = a.transpose();
    let mut v = DenseMatrix::from_fn(n, n, |i, j| if i == j { 1.0 } else { 0.0 });
    for _ in 0..MAX_SWEEPS {
        let mut rotated = false;
        for p in 0..n {
            for q in p + 1..n {
                rotated |= orthogonalise(&mut w, &mut v, p, q);
            }
        }
        if !rotated {
            break;
        }
    }
    let norms: Vec<f64> = w.iter_rows().map(|r| dot(r, r).sqrt()).collect();
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&i, &j| norms[j].total_cmp(&norms[i]));
    let scale = |j: usize| if norms[j] > 0.0 { norms[j] } else { 1.0 };
    Factors {
        u: DenseMatrix::from_fn(a.rows(), n, |i, j| w.at(order[j], i) / scale(order[j])),
        sigma: order.iter().map(|&j| norms[j]).collect(),
        v: DenseMatrix::from_fn(n, n, |i, j| v.at(order[j], i)),
    }
}

/// Rotates columns `p` and `q` of A V so that they become orthogonal; false if they were.
fn orthogonalise(w: &mut DenseMatrix, v: &mut DenseMatrix, p: usize, q: usize) -> bool {
    let alpha = dot(w.row(p), w.row(p));
    let beta = dot(w.row(q), w.row(q));
    let gamma = dot(w.row(p), w.row(q));
    if gamma == 0.0 || gamma.abs() <= ORTHOGONAL_COSINE * alpha.sqrt() * beta.sqrt() {
        return false;
    }
    let zeta = (beta - alpha) / (2.0 * gamma);
    let t = zeta.signum() / (zeta.abs() + zeta.hypot(1.0));
    let c = 1.0 / t.hypot(1.0);
    rotate(w, p, q, c, c * t);
    rotate(v, p, q, c, c * t);
    true
}

/// Applies the plane rotation (c, s) to rows `p` < `q`.
fn rotate(m: &mut DenseMatrix, p: usize, q: usize, c: f64, s: f64) {
    let cols = m.cols();
    let (head, tail) = m.data_mut().split_at_mut(q * cols);
    let first = &mut head[p * cols..(p + 1) * cols];
    for (x, y) in first.iter_mut().zip(&mut tail[..cols]) {
        (*x, *y) = (c * *x - s * *y, s * *x + c * *y);
    }
}

#[cfg(test)]
mod tests {
    use super::jacobi_svd;
    use crate::linalg::backend::dense::thin_svd;
    use crate::linalg::matrix::DenseMatrix;

    #[test]
    fn agrees_with_the_library() {
        let a = DenseMatrix::from_fn(12, 12, |i, j| ((i * 7 + j * j * 3) % 11) as f64 - 4.0);
        let own = jacobi_svd(&a);
        let other = thin_svd(&a).unwrap();
        for (x, y) in own.sigma.iter().zip(&other.sigma) {
            assert!((x - y).abs() < 1e-12 * own.sigma[0]);
        }
        for i in 0..12 {
            for j in 0..12 {
                let term = |k: usize| own.u.at(i, k) * own.sigma[k] * own.v.at(j, k);
                let sum: f64 = (0..12).map(term).sum();
                assert!((sum - a.at(i, j)).abs() < 1e-12 * own.sigma[0]);
            }
        }
    }

    #[test]
    fn zero_and_empty_matrices() {
        let zero = jacobi_svd(&DenseMatrix::from_fn(3, 3, |_, _| 0.0));
        assert_eq!(zero.sigma, [0.0; 3]);
        assert!(jacobi_svd(&DenseMatrix::from_fn(0, 0, |_, _| 0.0)).sigma.is_empty());
    }
}
