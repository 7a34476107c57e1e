//! One pass over the edges: the Collatz–Wielandt quotients of an iterate, and the next iterate.

use crate::linalg::matrix::SparseMatrix;

/// Result of one pass over the iterate x > 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sweep {
    /// Largest quotient (Ax)_i/x_i, an upper bound of ρ(A) up to the rounding of its sums.
    pub(crate) upper: f64,
    /// Smallest quotient (Ax)_i/x_i, a lower bound of ρ(A) likewise.
    pub(crate) lower: f64,
    /// Index of the largest entry of the next iterate.
    pub(crate) peak: usize,
    /// The largest entry of the next iterate.
    pub(crate) top: f64,
    /// Largest modulus of an entry of 1 − (I − αA) x; infinite where no system is solved.
    pub(crate) residual: f64,
}

/// Weights of one step of the Chebyshev semi-iteration for (I − αA) x = 1, which converges where
/// the spectrum of αA is real and within [−c, c] (Golub and Varga, Numer. Math. 3, 1961).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Chebyshev {
    /// α.
    alpha: f64,
    /// c².
    square: f64,
    /// Weight of the coming step; 1 in the first one, which needs no previous iterate.
    omega: f64,
    first: bool,
}

impl Chebyshev {
    /// The first step for decay `alpha` and spectra within `half_width` of 0, which is below 1.
    /// A half-width of 0 gives the Neumann series, which converges for all spectra.
    pub(crate) fn new(alpha: f64, half_width: f64) -> Self {
        Self { alpha, square: half_width * half_width, omega: 1.0, first: true }
    }

    /// Advances to the next step; for callers that compute the first one themselves.
    pub(crate) fn advance(&mut self) {
        let halved = if self.first { 0.5 } else { 0.25 };
        self.omega = 1.0 / (1.0 - halved * self.square * self.omega);
        self.first = false;
    }

    /// Reads the iterate `x`, n entries of at least 1, and replaces its predecessor `next` by its
    /// successor ω (1 + αAx − x₋) + x₋. Entries below 1 are raised to 1: the solution is at least
    /// 1, and every iterate stays positive.
    pub(crate) fn step(&mut self, a: &SparseMatrix, x: &[f64], next: &mut [f64]) -> Sweep {
        let (alpha, omega) = (self.alpha, self.omega);
        let mut residual = 0.0_f64;
        let mut found = sweep(a, x, next, |x, product, before| {
            let image = 1.0 + alpha * product;
            residual = residual.max((image - x).abs());
            (omega * (image - before) + before).max(1.0)
        });
        found.residual = residual;
        self.advance();
        found
    }
}

/// Reads the positive `x` and writes A x to `product`, n entries each.
pub(crate) fn multiply(a: &SparseMatrix, x: &[f64], product: &mut [f64]) -> Sweep {
    sweep(a, x, product, |_, product, _| product)
}

/// One step of the power method, √(x·Ax/σ), n entries each. The geometric mean converges for
/// periodic graphs too (see `perron`).
pub(crate) fn averaged_power(a: &SparseMatrix, x: &[f64], next: &mut [f64], sigma: f64) -> Sweep {
    let scale = 1.0 / sigma;
    sweep(a, x, next, |x, product, _| (x * (scale * product)).sqrt().max(MIN_ITERATE))
}

/// Smallest entry of an iterate of the power method, which keeps quotients finite.
const MIN_ITERATE: f64 = 1e-150;

#[inline(always)]
fn sweep(
    a: &SparseMatrix,
    x: &[f64],
    next: &mut [f64],
    mut update: impl FnMut(f64, f64, f64) -> f64,
) -> Sweep {
    let (mut upper, mut lower) = (0.0_f64, f64::INFINITY);
    let (mut peak, mut top) = (0, 0.0_f64);
    let (starts, columns, weights) = a.parts();
    for (i, ((bounds, &own), next)) in starts.windows(2).zip(x).zip(next).enumerate() {
        let range = bounds[0]..bounds[1];
        let edges = columns[range.clone()].iter().zip(&weights[range]);
        let product = edges.map(|(&j, w)| w * x[j as usize]).sum::<f64>();
        // Divide only where the quotient is a new extreme.
        if product > upper * own {
            upper = product / own;
        }
        if product < lower * own {
            lower = product / own;
        }
        *next = update(own, product, *next);
        if *next > top {
            (peak, top) = (i, *next);
        }
    }
    Sweep { upper, lower, peak, top, residual: f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_converge_to_the_centrality_of_a_star() {
        let edges = (1..5).flat_map(|i| [(0, i, 1.0), (i, 0, 1.0)]);
        let a = SparseMatrix::from_triplets(5, edges).unwrap();
        let (mut x, mut next) = (vec![1.0; 5], vec![0.0; 5]);
        let mut chebyshev = Chebyshev::new(0.4, 0.8);
        let mut last = f64::INFINITY;
        for _ in 0..60 {
            last = chebyshev.step(&a, &x, &mut next).residual;
            std::mem::swap(&mut x, &mut next);
        }
        assert!(last < 1e-14, "{last}");
        // x₀ = 1 + 4αx₁ and x₁ = 1 + αx₀.
        let hub = (1.0 + 4.0 * 0.4) / (1.0 - 4.0 * 0.16);
        assert!((x[0] - hub).abs() < 1e-13 && (x[3] - 1.0 - 0.4 * hub).abs() < 1e-13);
    }

    #[test]
    fn quotients_enclose_the_radius() {
        let a = SparseMatrix::from_triplets(2, [(0, 1, 4.0), (1, 0, 9.0)]).unwrap();
        let mut product = [0.0; 2];
        let found = multiply(&a, &[1.0, 1.0], &mut product);
        assert_eq!((found.lower, found.upper, product), (4.0, 9.0, [4.0, 9.0]));
        let found = multiply(&a, &[2.0, 3.0], &mut product);
        assert_eq!((found.lower, found.upper), (6.0, 6.0));
    }
}
