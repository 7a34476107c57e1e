//! Perron root and vector of one irreducible non-negative matrix, with a certified bracket.
//!
//! For irreducible A ≥ 0 and any x > 0 the Collatz–Wielandt quotients enclose the Perron root:
//! min_i (Ax)_i/x_i ≤ ρ(A) ≤ max_i (Ax)_i/x_i. Noda's iteration (Numer. Math. 17, 1971) solves
//! (σI − A) y = x with σ the upper bound of x; it converges quadratically from every x > 0,
//! while power iteration needs thousands of steps when eigenvalues lie close together.
//!
//! σI − A is an M-matrix that becomes singular as σ → ρ. Its columns scaled by x have row sums
//! r = σx − Ax ≥ 0, so elimination can carry the row sums along and recover every pivot as a sum
//! of non-negative numbers (Grassmann, Taksar and Heyman 1985; for M-matrices Alfa, Xue and Ye,
//! Math. Comp. 71, 2002). Nothing is ever subtracted: no pivoting is needed, and the solution
//! keeps its relative accuracy in every entry, however near to singular the matrix is.

use pulp::Arch;

use crate::graph::ordering::bandwidth_order;
use crate::linalg::matrix::SparseMatrix;

/// Relative width of the bracket where the radius is wanted exactly: a few hundred roundings.
pub(crate) const TOLERANCE: f64 = 1e-13;

/// Most power steps while the bounds are far apart: far from ρ, Noda's iteration only halves the
/// upper bound per factorisation.
const MAX_POWER_STEPS: usize = 1000;

/// Quotient of the bounds above which they are far apart.
const FAR_RATIO: f64 = 4.0;

/// Most nodes of a block that is factorised; larger ones keep their bounds.
pub(crate) const MAX_FACTORISED: usize = 4096;

/// Most factorisations; about five suffice from a good start.
const MAX_FACTORISATIONS: usize = 200;

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

/// Brackets ρ of the irreducible matrix `a` to a relative width of `tolerance`, from the positive
/// vector `start`. Improves on the `known` bounds, 0 and infinity if there are none; the iteration
/// itself depends on the vector alone.
pub(crate) fn perron(
    a: &SparseMatrix,
    start: Vec<f64>,
    known: (f64, f64),
    tolerance: f64,
) -> Perron {
    let mut state = Bracket::new(start, tolerance);
    let factorised = a.nodes() <= MAX_FACTORISED;
    let steps = if factorised { MAX_POWER_STEPS } else { 0 };
    for _ in 0..steps {
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
    if factorised && !state.tight() {
        iterate(a, &mut state);
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
fn iterate(a: &SparseMatrix, state: &mut Bracket) {
    let order = bandwidth_order(a);
    let mut stalled = 0;
    for _ in 0..MAX_FACTORISATIONS {
        let width = state.width();
        let product = state.tighten(a);
        if state.tight() || stalled > MAX_STALLED_FACTORISATIONS {
            return;
        }
        stalled = if state.width() < 0.99 * width { 0 } else { stalled + 1 };
        match shifted_solve(a, &state.x, &product, &order) {
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
fn normalised(mut x: Vec<f64>) -> Vec<f64> {
    let top = x.iter().fold(0.0_f64, |m, &v| m.max(v));
    for v in &mut x {
        *v = (*v / top).max(MIN_ITERATE);
    }
    x
}

/// Solves (σI − A) y = x for σ = max_i (Ax)_i/x_i, by subtraction-free elimination.
///
/// `None` when every row sum is zero (x is the Perron vector to the last bit) or the result leaves
/// the range of `f64`.
fn shifted_solve(
    a: &SparseMatrix,
    x: &[f64],
    product: &[f64],
    order: &[usize],
) -> Option<Vec<f64>> {
    let m = order.len();
    let sigma = largest_quotient(x, product);
    let mut place = vec![0; m];
    for (k, &node) in order.iter().enumerate() {
        place[node] = k;
    }
    let mut system = System {
        links: vec![0.0; m * m],
        end: vec![0; m],
        last: (0..m).collect(),
        slack: order.iter().map(|&i| (sigma * x[i] - product[i]).max(0.0)).collect(),
        rhs: order.iter().map(|&i| x[i]).collect(),
        pivot: vec![0.0; m],
    };
    for (i, &node) in order.iter().enumerate() {
        for (j, w) in a.row(node) {
            let j = place[j];
            system.links[i * m + j] = w * x[order[j]];
            system.end[i] = system.end[i].max(j + 1);
            system.last[j] = system.last[j].max(i);
        }
    }
    if !Arch::new().dispatch(|| system.eliminate()) {
        return None;
    }
    let System { links, end, rhs, pivot, .. } = system;

    let mut scaled = vec![0.0; m];
    for k in (0..m).rev() {
        let row = &links[k * m..(k + 1) * m];
        let known: f64 = (k + 1..end[k]).map(|j| row[j] * scaled[j]).sum();
        scaled[k] = (rhs[k] + known) / pivot[k];
    }
    let mut y = vec![0.0; m];
    for (k, &node) in order.iter().enumerate() {
        y[node] = scaled[k] * x[node];
    }
    let usable = y.iter().all(|v| v.is_finite()) && y.iter().any(|v| *v > 0.0);
    usable.then_some(y)
}

/// Upper bound of the multiply-adds of one factorisation of `a`.
pub(crate) fn factorisation_work(a: &SparseMatrix) -> usize {
    let mut place = vec![0; a.nodes()];
    for (k, node) in bandwidth_order(a).into_iter().enumerate() {
        place[node] = k;
    }
    let band = a.triplets().map(|(i, j, _)| place[i].abs_diff(place[j])).max().unwrap_or(0);
    a.nodes() * band * band
}

/// The system (σI − A) y = x in elimination order, columns scaled by x.
struct System {
    /// −(σI − A)_ij x_j for i ≠ j at i·m + j; the diagonal is implied.
    links: Vec<f64>,
    /// End of the non-zero entries of each row.
    end: Vec<usize>,
    /// The last row with an entry in each column.
    last: Vec<usize>,
    /// Sums of the rows, the diagonal included.
    slack: Vec<f64>,
    rhs: Vec<f64>,
    pivot: Vec<f64>,
}

impl System {
    /// Elimination without pivoting and subtraction; false when a pivot vanishes. Inlined into its
    /// dispatch to the vector instructions of the machine.
    #[inline(always)]
    fn eliminate(&mut self) -> bool {
        let Self { links, end, last, slack, rhs, pivot } = self;
        let m = end.len();
        // Eliminating a row fills in no rows below those of its own column and the columns before.
        let mut bottom = 0;
        for k in 0..m {
            bottom = bottom.max(last[k]);
            let (head, tail) = links.split_at_mut((k + 1) * m);
            let row = &head[k * m..];
            let stop = end[k].max(k + 1);
            pivot[k] = slack[k] + row[k + 1..stop].iter().sum::<f64>();
            if pivot[k] <= 0.0 {
                return false;
            }
            for (below, i) in tail.chunks_exact_mut(m).zip(k + 1..=bottom) {
                if below[k] == 0.0 {
                    continue;
                }
                let factor = below[k] / pivot[k];
                for (target, source) in below[k + 1..stop].iter_mut().zip(&row[k + 1..stop]) {
                    *target += factor * source;
                }
                end[i] = end[i].max(stop);
                slack[i] += factor * slack[k];
                rhs[i] += factor * rhs[k];
            }
        }
        true
    }
}
