//! Certified bounds of the spectral radius at the price of a few products, and Katz centralities.
//!
//! [`crate::spectral_radius`] finds ρ to the last digits by factorisations; a fleet that moves
//! needs no more than a bound that refuses a decay α ≥ 1/ρ, each frame, for 100,000 robots. For
//! A ≥ 0 and *any* x > 0 the quotients of Collatz and Wielandt bound ρ(A) ≤ max_i (Ax)_i/x_i, and
//! a good x is a rough solution of (σI − A) x = σ1 for σ just above ρ, which a handful of
//! Chebyshev steps finds; the one of the last frame mostly is good enough as it stands. Lower
//! bounds come from the smallest quotient and from small pieces of the graph. All are widened by
//! the rounding of their own sums, so that they hold whatever the iteration does.

mod patch;
mod search;
mod sweep;

use crate::components::{is_acyclic, strongly_connected};
use crate::katz::{KatzError, check_alpha};
use crate::matrix::SparseMatrix;
use crate::noda::{MAX_FACTORISED, TOLERANCE, perron};
use crate::spectral_radius::{SpectralRadius, restriction};
use search::Found;
pub(crate) use search::{Limits, Vectors};
use sweep::Chebyshev;

/// Relative width of the bracket that [`RadiusTracker::bound`] asks for: enough to hold αρ within
/// a band, and reached within about ten sweeps where a tenth of it takes three times as many.
pub const LIVE_WIDTH: f64 = 0.04;

/// Sweeps over the whole graph before it is taken apart into its components.
const WHOLE_SWEEPS: usize = 48;

/// Sweeps over a component before it is factorised, where it can be.
const BLOCK_SWEEPS: usize = 48;

/// Multiply-adds spent on sweeps over components that are too large to factorise: a second or so.
const SWEEP_WORK: usize = 1_000_000_000;

/// Sweeps over a component that is too large to factorise, at least and at most.
const LARGE_SWEEPS: (usize, usize) = (100, 20_000);

/// Sweeps for a centrality; the Neumann series at αρ = 0.99 takes as many to 1e-9.
const CENTRALITY_SWEEPS: usize = 2000;

/// Growth of the residual beyond its best value that shows a spectrum far from real.
const DIVERGING: f64 = 4.0;

/// Sweeps after which Chebyshev steps must have done better than as many of the Neumann series,
/// which they do for real spectra.
const TRIAL: i32 = 32;

/// Certified enclosure of a spectral radius ρ, in the unit of the weights.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RadiusBound {
    /// ρ is at least this.
    pub lower: f64,
    /// ρ is at most this.
    pub upper: f64,
    /// True when the graph has no cycle; then both bounds are exactly 0.
    pub acyclic: bool,
    /// Products with the whole matrix, or with as many edges, that it took.
    pub sweeps: usize,
}

impl RadiusBound {
    const ZERO: Self = Self { lower: 0.0, upper: 0.0, acyclic: true, sweeps: 0 };

    /// Width of the bracket relative to its upper end; 0 for an acyclic graph.
    #[must_use]
    pub fn relative_width(&self) -> f64 {
        if self.upper > 0.0 { (self.upper - self.lower) / self.upper } else { 0.0 }
    }
}

/// How exact a centrality is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Centrality {
    /// Largest modulus η of an entry of 1 − (I − αA) x. As (I − αA)⁻¹ ≥ 0, no entry of x is off by
    /// more than the fraction η of its true value, but for rounding.
    pub residual: f64,
    /// Products with A that it took.
    pub sweeps: usize,
}

/// Bounds of ρ from frame to frame: keeps the vectors of the last frame as start for the next.
#[derive(Debug, Default)]
pub struct RadiusTracker {
    work: Vectors,
    block: Vectors,
    centrality: Vec<f64>,
    other: Vec<f64>,
}

impl RadiusTracker {
    /// Bounds of ρ(A) to a relative width of [`LIVE_WIDTH`], where the limits of
    /// [`RadiusTracker::refine`] allow it.
    pub fn bound(&mut self, a: &SparseMatrix) -> RadiusBound {
        self.refine(a, LIVE_WIDTH)
    }

    /// Bounds of ρ(A) to the relative width `width`, or as near to it as the limits on work allow:
    /// 1e-13 for components of up to 4096 nodes, for larger ones what 1e9 multiply-adds give. The
    /// bounds hold in any case.
    ///
    /// Sweeps over the whole graph suffice for most. Where they do not, every strongly connected
    /// component is bracketed on its own (ρ is the largest of their radii), so that acyclic and
    /// isolated parts spoil neither bound; small ones by Noda's iteration in the end.
    ///
    /// Works in kept memory; taking the graph apart and factorising allocate.
    pub fn refine(&mut self, a: &SparseMatrix, width: f64) -> RadiusBound {
        // Half of it is left to the widening by rounding.
        let width = if width.is_nan() { LIVE_WIDTH } else { width.max(2.0 * TOLERANCE) };
        if a.is_zero() {
            self.work.x.clear();
            self.work.prepare(a.nodes());
            return RadiusBound::ZERO;
        }
        let limits = Limits { width, sweeps: WHOLE_SWEEPS };
        let mut found = self.work.search(a, 0.0, limits);
        if !found.tight(width) {
            if found.lower <= 0.0 && is_acyclic(a) {
                self.work.x.fill(1.0);
                return RadiusBound { sweeps: found.sweeps, ..RadiusBound::ZERO };
            }
            found = self.search_components(a, found, width);
        }
        // Sums of non-negative terms are off by at most one rounding per term.
        let slack = (a.max_degree() + 4) as f64 * f64::EPSILON;
        RadiusBound {
            lower: found.lower * (1.0 - slack),
            upper: found.upper * (1.0 + slack),
            acyclic: false,
            sweeps: found.sweeps,
        }
    }

    /// Brackets every component that the bounds of the whole leave in doubt.
    fn search_components(&mut self, a: &SparseMatrix, whole: Found, width: f64) -> Found {
        let mut lower = whole.lower;
        let mut upper = 0.0_f64;
        let mut edges = 0;
        let mut place = vec![usize::MAX; a.nodes()];
        for nodes in strongly_connected(a) {
            if let [only] = nodes[..] {
                let own = a.weight(only, only);
                (lower, upper) = (lower.max(own), upper.max(own));
                continue;
            }
            let block = restriction(a, &nodes, &mut place);
            let start = nodes.iter().map(|&i| self.work.x[i]);
            self.block.x.clear();
            self.block.x.extend(start);
            let (least, most) = LARGE_SWEEPS;
            let factorised = nodes.len() <= MAX_FACTORISED;
            let sweeps = match factorised {
                true => BLOCK_SWEEPS,
                false => (SWEEP_WORK / block.edges()).clamp(least, most),
            };
            let mut own = self.block.search(&block, lower, Limits { width, sweeps });
            edges += own.sweeps * block.edges();
            if !own.tight(width) && factorised {
                let top = self.block.x.iter().fold(1.0_f64, |top, x| x.max(top));
                let known = (own.lower, own.upper);
                let root = perron(&block, std::mem::take(&mut self.block.x), known, 0.5 * width);
                own.lower = own.lower.max(root.lower);
                own.upper = own.upper.min(root.upper);
                self.block.x.extend(root.vector.iter().map(|v| v * top));
            }
            (lower, upper) = (lower.max(own.lower), upper.max(own.upper));
            for (&node, &x) in nodes.iter().zip(&self.block.x) {
                self.work.x[node] = x;
            }
        }
        let upper = upper.min(whole.upper).max(lower);
        Found { lower, upper, sweeps: whole.sweeps + edges / a.edges().max(1) }
    }

    /// The positive vector, one entry per node, that the last bounds came from.
    #[must_use]
    pub fn vector(&self) -> &[f64] {
        &self.work.x
    }

    /// The bounds in the form that the other functions of this crate take.
    #[must_use]
    pub fn spectral_radius(&self, bound: &RadiusBound) -> SpectralRadius {
        SpectralRadius {
            lower: bound.lower,
            upper: bound.upper,
            value: 0.5 * (bound.lower + bound.upper),
            acyclic: bound.acyclic,
            vector: self.work.x.clone(),
        }
    }

    /// Takes the vectors along when the list of nodes changes: node i becomes node `map[i]` of
    /// `nodes`, or is gone. New nodes start from 1. A map that does not fit discards the vectors.
    pub fn carry(&mut self, map: &[Option<usize>], nodes: usize) {
        for vector in [&mut self.work.x, &mut self.centrality] {
            let mut moved = vec![1.0; nodes];
            let fits = vector.len() == map.len();
            for (value, to) in vector.iter().zip(map).filter(|_| fits) {
                if let Some(place) = to.and_then(|to| moved.get_mut(to)) {
                    *place = *value;
                }
            }
            *vector = moved;
        }
    }

    /// Solves (I − αA) x = 1 for the Katz centralities x (Katz, Psychometrika 18, 1953) to a
    /// residual of `tolerance` in the largest entry, starting from those of the last call; read
    /// them from [`RadiusTracker::centralities`]. Entry i weighs all walks that leave node i, the
    /// empty walk included, so that it is at least 1.
    ///
    /// Ends when the residual is lost in the rounding of x, and after 2000 sweeps in any case; look
    /// at the residual that is answered.
    ///
    /// # Errors
    /// [`KatzError::Alpha`] and [`KatzError::Diverges`] for a decay that `bound`, which must
    /// belong to `a`, does not admit; [`KatzError::Overflow`] when x leaves the range of `f64`.
    pub fn solve_centrality(
        &mut self,
        a: &SparseMatrix,
        alpha: f64,
        bound: &RadiusBound,
        tolerance: f64,
    ) -> Result<Centrality, KatzError> {
        check_alpha(alpha, bound.upper)?;
        let n = a.nodes();
        let Self { centrality: x, other: next, .. } = self;
        if x.len() != n {
            x.clear();
            x.resize(n, 1.0);
        }
        next.resize(n, 0.0);
        let half_width = alpha * bound.upper;
        let mut chebyshev = Chebyshev::new(alpha, half_width);
        let mut best = f64::INFINITY;
        let mut wanted = f64::INFINITY;
        let rounding = (a.max_degree() + 4) as f64 * f64::EPSILON;
        for sweeps in 1..=CENTRALITY_SWEEPS {
            let sweep = chebyshev.step(a, x, next);
            if !(sweep.top.is_finite() && sweep.residual.is_finite()) {
                x.fill(1.0);
                return Err(KatzError::Overflow { alpha });
            }
            let reached = sweep.residual <= tolerance.max(rounding * sweep.top);
            if reached || sweeps == CENTRALITY_SWEEPS || n == 0 {
                return Ok(Centrality { residual: sweep.residual, sweeps });
            }
            let checked = sweeps % TRIAL as usize == 0;
            if sweep.residual > DIVERGING * best || (checked && sweep.residual > wanted) {
                chebyshev = Chebyshev::new(alpha, 0.0);
            }
            best = best.min(sweep.residual);
            if checked {
                wanted = sweep.residual * half_width.powi(TRIAL);
            }
            std::mem::swap(x, next);
        }
        Ok(Centrality { residual: best, sweeps: CENTRALITY_SWEEPS })
    }

    /// The Katz centralities of the last solve, one per node, each at least 1.
    #[must_use]
    pub fn centralities(&self) -> &[f64] {
        &self.centrality
    }
}
