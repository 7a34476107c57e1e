//! Perron root and vector of one irreducible non-negative matrix, with a certified bracket.
//!
//! For irreducible A ≥ 0 and any x > 0 the Collatz–Wielandt quotients enclose the Perron root:
//! min_i (Ax)_i/x_i ≤ ρ(A) ≤ max_i (Ax)_i/x_i. Noda's iteration (Numer. Math. 17, 1971) solves
//! (σI − A) y = x with σ the upper bound of x; it converges quadratically from every x > 0,
//! while power iteration needs thousands of steps when eigenvalues lie close together.
//! [`super::elimination`] has the solves.

use super::elimination::Elimination;
use crate::linalg::matrix::SparseMatrix;

/// Relative width of the bracket where the radius is wanted exactly: a few hundred roundings.
pub(crate) const TOLERANCE: f64 = 1e-13;

/// Most power steps while the bounds are far apart: far from ρ, Noda's iteration only halves the
/// upper bound per factorisation.
const MAX_POWER_STEPS: usize = 1000;

/// Quotient of the bounds above which they are far apart.
const FAR_RATIO: f64 = 4.0;

/// Most nodes of a block that is factorised whatever it costs.
pub(crate) const MAX_FACTORISED: usize = 4096;

/// Most nodes, and multiply-adds, of a larger block that is factorised: about a second for some three
/// factorisations.
const MAX_LARGE_FACTORISED: usize = 20_000;
const MAX_LARGE_WORK: usize = 1 << 30;

/// Most entries of the factor of a larger block, per node and per edge: 24 bytes each. Fleets in the plane
/// stay below. What fills in more mixes fast, so that sweeps get there.
const MAX_LARGE_ENTRIES: (usize, usize) = (128, 2);

/// Most factorisations; about three suffice from a good start.
const MAX_FACTORISATIONS: usize = 200;

/// Solves with each factorisation, which takes twenty times as long as one: the distance of the upper
/// bound from ρ then falls by its fourth power, not by its square.
const SOLVES: usize = 3;

/// Most factorisations in a row without progress. Entries many orders of magnitude below the
/// largest need a few iterations before they affect the bounds.
const MAX_STALLED_FACTORISATIONS: usize = 10;

/// Smallest entry of an iterate relative to its largest; keeps quotients finite.
const MIN_ITERATE: f64 = 1e-150;

/// Bounds of ρ of one block, and a positive vector with largest entry 1.
pub(crate) struct Perron {
    pub(crate) lower: f64,
    pub(crate) upper: f64,
    pub(crate) vector: Vec<f64>,
}

/// How the irreducible matrix `a` is factorised. `None` where that costs too much.
pub(crate) fn factorisation(a: &SparseMatrix) -> Option<Elimination> {
    let n = a.nodes();
    if n <= MAX_FACTORISED {
        return Elimination::new(a, n * n);
    }
    let (per_node, per_edge) = MAX_LARGE_ENTRIES;
    let most = per_node * n + per_edge * a.edges();
    let fits = n <= MAX_LARGE_FACTORISED;
    let found = fits.then(|| Elimination::new(a, most)).flatten();
    found.filter(|found| found.work() <= MAX_LARGE_WORK)
}

/// Brackets ρ of the irreducible matrix `a` to a relative width of `tolerance`, from the positive
/// vector `start`. Improves on the `known` bounds, 0 and infinity if there are none; the iteration
/// itself depends on the vector alone.
pub(crate) fn perron(
    a: &SparseMatrix,
    elimination: &Elimination,
    start: Vec<f64>,
    known: (f64, f64),
    tolerance: f64,
) -> Perron {
    let mut state = Bracket::new(start, tolerance);
    for _ in 0..MAX_POWER_STEPS {
        let product = state.tighten(a);
        if state.tight() || state.upper <= FAR_RATIO * state.lower {
            break;
        }
        // The mean of x and Ax makes periodic graphs (rings, two-cycles) converge too. It is the
        // geometric one, since Ax does not expand Hilbert's projective metric, so that averaging
        // logarithms converges from anywhere (Krasnoselskii and Mann), however graded A is.
        let next = state.x.iter().zip(&product).map(|(x, y)| (x * y).sqrt());
        state.x = normalised(next.collect());
    }
    if !state.tight() {
        iterate(a, elimination, &mut state);
    }
    let bounds = (state.lower.max(known.0), state.upper.min(known.1));
    widened(a, bounds, state.x)
}

/// Bounds widened by the rounding of the sums that they come from.
pub(crate) fn widened(a: &SparseMatrix, (lower, upper): (f64, f64), vector: Vec<f64>) -> Perron {
    // Sums of non-negative terms are off by at most one rounding per term.
    let slack = (a.max_degree() + 4) as f64 * f64::EPSILON;
    Perron { lower: lower * (1.0 - slack), upper: upper * (1.0 + slack), vector }
}

/// Noda's iteration until the bracket is tight or rounding stops its progress.
fn iterate(a: &SparseMatrix, elimination: &Elimination, state: &mut Bracket) {
    let mut stalled = 0;
    for _ in 0..MAX_FACTORISATIONS {
        let width = state.width();
        let product = state.tighten(a);
        if state.tight() || stalled > MAX_STALLED_FACTORISATIONS {
            return;
        }
        stalled = if state.width() < 0.99 * width { 0 } else { stalled + 1 };
        let sigma = largest_quotient(&state.x, &product);
        match elimination.solve(a, &state.x, &product, sigma, SOLVES) {
            Some(next) => state.x = normalised(next),
            None => return,
        }
    }
}

/// An iterate with the best bounds so far.
struct Bracket {
    lower: f64,
    upper: f64,
    x: Vec<f64>,
    tolerance: f64,
}

impl Bracket {
    fn new(start: Vec<f64>, tolerance: f64) -> Self {
        Self { lower: 0.0, upper: f64::INFINITY, x: normalised(start), tolerance }
    }

    /// Improves the bounds by the quotients of the current iterate and returns A x.
    ///
    /// Entries at [`MIN_ITERATE`] stand for smaller ones and would spoil the lower bound. A
    /// principal submatrix has no larger Perron root, so the lower bound may leave them out.
    fn tighten(&mut self, a: &SparseMatrix) -> Vec<f64> {
        let product = multiply(a, &self.x);
        self.upper = self.upper.min(largest_quotient(&self.x, &product));
        let kept: Vec<f64> =
            self.x.iter().map(|&v| if v > MIN_ITERATE { v } else { 0.0 }).collect();
        let inner = if kept == self.x { product.clone() } else { multiply(a, &kept) };
        let quotients = kept.iter().zip(&inner).filter(|e| *e.0 > 0.0).map(|(x, y)| y / x);
        self.lower = self.lower.max(quotients.fold(f64::INFINITY, f64::min));
        product
    }

    fn width(&self) -> f64 {
        self.upper - self.lower
    }

    fn tight(&self) -> bool {
        self.width() <= self.tolerance * self.upper
    }
}

/// Product A x.
fn multiply(a: &SparseMatrix, x: &[f64]) -> Vec<f64> {
    (0..a.nodes()).map(|i| a.row(i).map(|(j, w)| w * x[j]).sum()).collect()
}

/// Largest quotient `product`_i / `x`_i.
fn largest_quotient(x: &[f64], product: &[f64]) -> f64 {
    x.iter().zip(product).fold(0.0, |top, (x, y)| (y / x).max(top))
}

/// Scales to largest entry 1 and raises entries that would underflow.
pub(crate) fn normalised(mut x: Vec<f64>) -> Vec<f64> {
    let top = x.iter().fold(0.0_f64, |m, &v| m.max(v));
    for v in &mut x {
        *v = (*v / top).max(MIN_ITERATE);
    }
    x
}
