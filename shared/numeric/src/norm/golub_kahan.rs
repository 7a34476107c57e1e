//! The largest singular value of a large sparse matrix, from products with it.
//!
//! Golub–Kahan bidiagonalisation (SIAM J. Numer. Anal. 2, 1965): on the vectors vⱼ, AᵀA is a
//! tridiagonal matrix T except for the last vector, and the largest eigenvalue of T grows towards
//! σ₁² with every vector. Rounding destroys the orthogonality of the vectors, which adds copies of
//! eigenvalues and changes none (Paige, 1980), so three vectors of memory suffice.

use crate::linalg::matrix::SparseMatrix;

/// Most vectors. Values as close together as those of long chains need some hundreds.
const MAX_VECTORS: usize = 4000;

/// Vectors between two convergence checks.
const CHECK_VECTORS: usize = 8;

/// Relative distance of the largest eigenvalue of T from one of AᵀA.
const TOLERANCE: f64 = 1e-14;

/// Bisections of the interval of the largest eigenvalue of T, down to rounding.
const BISECTIONS: usize = 64;

/// The largest singular value of `a` divided by its largest weight `top`, which is above 0.
///
/// The result never exceeds the true value except by rounding, and it is a singular value to a
/// relative error of 1e-14. That it is the largest one follows from the positive start vector,
/// which has a component in every direction that a non-negative matrix can stretch the most.
pub(crate) fn largest_singular_value(a: &SparseMatrix, top: f64) -> f64 {
    let n = a.nodes();
    let transposed = a.transpose();
    let mut v = vec![1.0 / (n as f64).sqrt(); n];
    let mut u = vec![0.0; n];
    let mut tridiagonal = Tridiagonal::default();
    let mut beta = 0.0;
    for count in 1..=MAX_VECTORS {
        // u ← A v − β u, v ← Aᵀ u − α v, each scaled to length 1.
        let alpha = step(a, top, &v, beta, &mut u);
        tridiagonal.diagonal.push(alpha * alpha + beta * beta);
        beta = step(&transposed, top, &u, alpha, &mut v);
        let coupling = alpha * beta;
        let is_last = coupling == 0.0 || count == MAX_VECTORS;
        if is_last || count % CHECK_VECTORS == 0 {
            let value = tridiagonal.largest_eigenvalue();
            if is_last || coupling * tridiagonal.last_component(value) <= TOLERANCE * value {
                return value.sqrt();
            }
        }
        tridiagonal.off_diagonal.push(coupling);
    }
    tridiagonal.largest_eigenvalue().sqrt()
}

/// y ← (A x/`top` − `factor` y), scaled to length 1; returns the length before scaling.
fn step(a: &SparseMatrix, top: f64, x: &[f64], factor: f64, y: &mut [f64]) -> f64 {
    let mut square = 0.0;
    for (i, y) in y.iter_mut().enumerate() {
        let sum: f64 = a.row(i).map(|(j, weight)| weight / top * x[j]).sum();
        *y = sum - factor * *y;
        square += *y * *y;
    }
    let length = square.sqrt();
    if length > 0.0 {
        for y in y {
            *y /= length;
        }
    }
    length
}

/// A symmetric tridiagonal matrix.
#[derive(Debug, Default)]
struct Tridiagonal {
    diagonal: Vec<f64>,
    /// One entry fewer than the diagonal, each above 0.
    off_diagonal: Vec<f64>,
}

impl Tridiagonal {
    fn largest_eigenvalue(&self) -> f64 {
        // Gershgorin's discs.
        let off_diagonal = |j: usize| self.off_diagonal.get(j).copied().unwrap_or(0.0);
        let upper = |j: usize| {
            self.diagonal[j] + off_diagonal(j) + if j > 0 { off_diagonal(j - 1) } else { 0.0 }
        };
        let mut high = (0..self.diagonal.len()).map(upper).fold(0.0, f64::max);
        let mut low = self.diagonal.iter().fold(0.0_f64, |top, value| top.max(*value));
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            if self.is_below(middle) {
                high = middle;
            } else {
                low = middle;
            }
        }
        0.5 * (low + high)
    }

    /// True when all eigenvalues are below `value`: all pivots of T − `value` I are negative.
    fn is_below(&self, value: f64) -> bool {
        let mut pivot = self.diagonal[0] - value;
        for (diagonal, off_diagonal) in self.diagonal[1..].iter().zip(&self.off_diagonal) {
            if pivot >= 0.0 {
                return false;
            }
            pivot = diagonal - value - off_diagonal * off_diagonal / pivot;
        }
        pivot < 0.0
    }

    /// Modulus of the last component of the unit eigenvector of the eigenvalue `value`; 0 if it is
    /// negligible. Computed from the last component to the first, the direction in which they grow.
    fn last_component(&self, value: f64) -> f64 {
        const VANISHING: f64 = 1e100;
        let (mut last, mut next) = (1.0, 0.0);
        let mut square = 1.0;
        for j in (1..self.diagonal.len()).rev() {
            let next_off = self.off_diagonal.get(j).copied().unwrap_or(0.0);
            let before =
                ((value - self.diagonal[j]) * last - next_off * next) / self.off_diagonal[j - 1];
            (last, next) = (before, last);
            square += last * last;
            if square > VANISHING {
                return 0.0;
            }
        }
        1.0 / square.sqrt()
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::norm::spectral_norm;

    fn check(a: &SparseMatrix, expected: f64) {
        let top = a.max_weight();
        let found = top * largest_singular_value(a, top);
        assert!((found - expected).abs() <= 1e-13 * expected, "{found} {expected}");
    }

    #[test]
    fn values_in_closed_form() {
        let chain = |n: usize| SparseMatrix::from_triplets(n, (1..n).map(|i| (i - 1, i, 3.0)));
        check(&chain(50).unwrap(), 3.0);
        let star = SparseMatrix::from_triplets(10, (1..10).map(|i| (0, i, 0.5)));
        check(&star.unwrap(), 1.5);
        let path = |n: usize| {
            let edges = (1..n).flat_map(|i| [(i - 1, i, 1.0), (i, i - 1, 1.0)]);
            SparseMatrix::from_triplets(n, edges).unwrap()
        };
        for n in [2, 3, 40, 300, 3000] {
            check(&path(n), 2.0 * (std::f64::consts::PI / (n as f64 + 1.0)).cos());
        }
        // The largest value may belong to a small part.
        let edges = (0..500).map(|i| (i, (i + 1) % 500, 1.0)).chain([(500, 501, 1.25)]);
        check(&SparseMatrix::from_triplets(502, edges).unwrap(), 1.25);
        check(&SparseMatrix::from_triplets(1, [(0, 0, 1e90)]).unwrap(), 1e90);
    }

    #[test]
    fn values_of_random_graphs_are_those_that_are_enclosed() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for n in [2, 5, 20, 100, 400] {
            for spread in [0.5, 6.0] {
                let edge = |rng: &mut ChaCha8Rng| {
                    let weight = 10_f64.powf(spread * rng.random::<f64>());
                    (rng.random_range(0..n), rng.random_range(0..n), weight)
                };
                let edges: Vec<_> = (0..4 * n).map(|_| edge(&mut rng)).collect();
                let a = SparseMatrix::from_triplets(n, edges).unwrap();
                check(&a, spectral_norm(&a));
            }
        }
    }
}
