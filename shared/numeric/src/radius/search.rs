//! The search for a bracket of the spectral radius by sweeps over the edges.

use super::patch::Patches;
use super::sweep::{Chebyshev, Sweep, averaged_power, multiply};
use crate::linalg::matrix::SparseMatrix;

/// Nodes of the first patch; each further one is twice as large.
const FIRST_PATCH_NODES: usize = 48;

/// Nodes of the largest patch. Its m × m means are multiplied several times.
const MAX_PATCH_NODES: usize = 384;

/// Sweeps before the second patch. The pause doubles each time, as long searches profit from long
/// uninterrupted sequences of Chebyshev steps.
const PATCH_PAUSE_SWEEPS: usize = 6;

/// The shift is σ = (1 + this part of the width) × lower bound.
const SHIFT_WIDTHS: f64 = 0.75;

/// Part of the width by which a round on a patch must raise its bound to be followed by another.
const PATCH_PROGRESS_WIDTHS: f64 = 1.0 / 64.0;

/// Sweeps without a better upper bound after which Chebyshev steps end: the spectrum is far from
/// real, or the lower bound is far too low.
const MAX_STALLED_SWEEPS: usize = 32;

/// Number of sweeps that one counts as whose bracket is more than twice as wide as the best: near ρ
/// the quotients of a good iterate stay close to the best for long before they improve.
const WIDE_BRACKET_SWEEPS: usize = 4;

/// Sweeps without a better upper bound after which the power method ends.
const MAX_STALLED_POWER_STEPS: usize = 64;

/// Largest useful entry of an iterate; beyond it the weights span too many orders of magnitude for
/// sweeps.
const MAX_ITERATE: f64 = 1e150;

/// End of a search.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// Relative width of the bracket at which it ends.
    pub(crate) width: f64,
    /// Most sweeps.
    pub(crate) sweeps: usize,
}

/// A bracket, except for the rounding of its sums.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Found {
    pub(crate) lower: f64,
    pub(crate) upper: f64,
    pub(crate) sweeps: usize,
}

impl Found {
    /// True when the bracket is at most `width` wide.
    pub(crate) fn tight(&self, width: f64) -> bool {
        self.upper <= self.lower * (1.0 + width)
    }

    fn take(&mut self, sweep: Sweep) -> bool {
        let better =
            sweep.upper < self.upper * (1.0 - 1e-3 * (self.upper - self.lower) / self.upper);
        self.upper = self.upper.min(sweep.upper);
        self.lower = self.lower.max(sweep.lower);
        self.sweeps += 1;
        better
    }
}

/// Vectors of n entries for a search.
#[derive(Debug, Default)]
pub(crate) struct Vectors {
    /// The iterate: positive, and close to a solution of (σI − A) x = σ1 at the end.
    pub(crate) x: Vec<f64>,
    next: Vec<f64>,
    pub(crate) patches: Patches,
    /// Nodes of the last patch of the previous search, where the next one starts.
    size: usize,
}

impl Vectors {
    /// Resets the iterate to ones unless it has the right length.
    pub(crate) fn prepare(&mut self, nodes: usize) {
        if self.x.len() != nodes {
            self.x.clear();
            self.x.resize(nodes, 1.0);
            self.size = 0;
        }
        self.next.resize(nodes, 0.0);
    }

    /// Brackets ρ(A) or, where that is larger, the lower bound `floor`, starting from the positive
    /// vector x, until a limit is reached or progress ends.
    ///
    /// The solution of (σI − A) x = σ1 for σ > ρ(A) has (Ax)_i/x_i = σ(1 − 1/x_i) < σ, and with a
    /// residual r it is σ(1 − (1 − r_i)/x_i): even a rough solution certifies ρ(A) < σ. Each step
    /// of the semi-iteration evaluates the quotients of its iterate anyway. If σ is below ρ(A), the
    /// same steps amplify the Perron vector, which shows where a patch gives a better lower bound.
    pub(crate) fn search(&mut self, a: &SparseMatrix, floor: f64, limits: Limits) -> Found {
        let n = a.nodes();
        self.prepare(n);
        let Self { x, next, patches, size: sufficed } = self;
        let width = limits.width;
        let mut found = Found { lower: floor, upper: f64::INFINITY, sweeps: 0 };
        let first = multiply(a, x, next);
        found.take(first);
        // A round on a patch of √edges nodes costs as much as a sweep.
        let mut size = FIRST_PATCH_NODES.max((*sufficed).min(a.edges().isqrt())).min(n);
        if !found.tight(width) && first.top > 0.0 {
            let own = patches.lower_bound(a, next, first.peak, size, width * PATCH_PROGRESS_WIDTHS);
            found.lower = found.lower.max(own);
        }
        if found.tight(width) || found.lower <= 0.0 {
            return found;
        }
        let (mut sigma, mut chebyshev) = shift(found.lower, width);
        for y in next.iter_mut() {
            *y = 1.0 + *y / sigma;
        }
        chebyshev.advance();
        std::mem::swap(x, next);

        let mut pause = PATCH_PAUSE_SWEEPS;
        let mut next_patch = found.sweeps + pause;
        let mut stalled = 0;
        let mut power = false;
        while !found.tight(width) && found.sweeps < limits.sweeps {
            let sweep = match power {
                false => chebyshev.step(a, x, next),
                true => averaged_power(a, x, next, sigma),
            };
            std::mem::swap(x, next);
            let better = found.take(sweep);
            let bad = sweep.upper - found.lower > 2.0 * (found.upper - found.lower);
            stalled = match (better, bad) {
                (true, _) => 0,
                (_, true) => stalled + WIDE_BRACKET_SWEEPS,
                _ => stalled + 1,
            };
            if sweep.top.is_nan() || sweep.top > MAX_ITERATE {
                x.fill(1.0);
                break;
            }
            if found.tight(width) || (power && stalled > MAX_STALLED_POWER_STEPS) {
                break;
            }
            let stuck = !power && stalled > MAX_STALLED_SWEEPS;
            if found.sweeps >= next_patch || stuck {
                // The upper bound makes no progress, but the lower one may.
                size = (size * if stuck { 4 } else { 2 }).min(MAX_PATCH_NODES).min(n);
                // A search that is stuck at the last digits asks for many patches.
                pause = pause.saturating_mul(2);
                next_patch = found.sweeps.saturating_add(pause);
                let own =
                    patches.lower_bound(a, x, sweep.peak, size, width * PATCH_PROGRESS_WIDTHS);
                found.lower = found.lower.max(own);
            }
            let risen = found.lower * (1.0 + SHIFT_WIDTHS * width) > sigma * (1.0 + 0.25 * width);
            if risen && !power {
                (sigma, chebyshev) = shift(found.lower, width);
                stalled = 0;
            } else if stuck {
                (power, stalled) = (true, 0);
            }
        }
        *sufficed = size;
        found
    }
}

/// The shift σ for a lower bound, and the first step of the semi-iteration for decay 1/σ.
fn shift(lower: f64, width: f64) -> (f64, Chebyshev) {
    let sigma = lower * (1.0 + SHIFT_WIDTHS * width);
    (sigma, Chebyshev::new(1.0 / sigma, lower / sigma))
}
