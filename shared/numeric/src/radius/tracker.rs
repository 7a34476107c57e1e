//! Certified bounds of the spectral radius from frame to frame, for the cost of a few products.
//!
//! [`crate::spectral_radius`] finds ρ to the last digits by factorisations. A moving fleet only
//! needs a bound in each frame that rejects a decay α ≥ 1/ρ, for up to 100,000 robots. For A ≥ 0
//! and *any* x > 0 the Collatz–Wielandt quotients bound ρ(A) ≤ max_i (Ax)_i/x_i. A good x is a
//! rough solution of (σI − A) x = σ1 for σ just above ρ, which a handful of Chebyshev steps finds;
//! the x of the previous frame is often good enough. Lower bounds come from the smallest quotient
//! and from small parts of the graph. All bounds are widened by the rounding of their sums, so they
//! hold whatever the iteration does.

use thiserror::Error;

use super::exact::SpectralRadius;
use super::perron::{MAX_FACTORISED, TOLERANCE, factorisation, perron};
use super::search::{Found, Limits, Vectors};
use crate::graph::components::{is_acyclic, strongly_connected};
use crate::graph::subgraph::induced_subgraph;
use crate::linalg::matrix::SparseMatrix;

/// Relative width of the bracket of [`RadiusTracker::bound`]: enough to keep αρ within a band, and
/// reached within about ten sweeps where a tenth of it takes three times as many.
pub const LIVE_WIDTH: f64 = 0.04;

/// Sweeps over the whole graph before its components are bracketed one by one.
const WHOLE_SWEEPS: usize = 48;

/// Sweeps over a component before it is factorised, where it can be.
const BLOCK_SWEEPS: usize = 48;

/// Multiply-adds spent on sweeps over components that are too large to factorise: about a second.
const SWEEP_WORK: usize = 1_000_000_000;

/// Least and most sweeps over a component that is too large to factorise.
const LARGE_SWEEPS: (usize, usize) = (100, 20_000);

/// Certified enclosure of a spectral radius ρ, in the unit of the weights.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RadiusBound {
    /// ρ is at least this.
    pub lower: f64,
    /// ρ is at most this.
    pub upper: f64,
    /// True when the graph has no cycle; both bounds are then exactly 0.
    pub acyclic: bool,
    /// Number of products with the whole matrix, or with as many edges.
    pub sweeps: usize,
}

impl RadiusBound {
    const ZERO: Self = Self { lower: 0.0, upper: 0.0, acyclic: true, sweeps: 0 };
}

/// The relative width that was asked for is negative or not a number.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error("relative width {0} of a bracket is not a number from 0 on")]
pub struct WidthError(pub f64);

/// Bounds of ρ from frame to frame; starts from the vectors of the previous frame.
#[derive(Debug, Default)]
pub struct RadiusTracker {
    work: Vectors,
    block: Vectors,
    /// Katz centralities of the last solve, and the iterate before (see `katz::centrality`).
    pub(crate) centrality: Vec<f64>,
    pub(crate) previous: Vec<f64>,
}

impl RadiusTracker {
    /// Bounds of ρ(A) to a relative width of [`LIVE_WIDTH`], where the limits of
    /// [`RadiusTracker::refine`] allow it.
    pub fn bound(&mut self, a: &SparseMatrix) -> RadiusBound {
        self.search(a, LIVE_WIDTH)
    }

    /// Bounds of ρ(A) to the relative width `width`, or as close to it as the limits on work allow:
    /// 1e-13 for components of up to 4096 nodes, for larger ones what 1e9 multiply-adds give. The
    /// bounds hold in any case.
    ///
    /// Sweeps over the whole graph suffice for most. Where they do not, every strongly connected
    /// component is bracketed on its own (ρ is the largest of their radii), so that acyclic and
    /// isolated parts spoil neither bound; small ones finally by Noda's iteration.
    ///
    /// Works in kept memory; only components and factorisations allocate.
    ///
    /// # Errors
    /// [`WidthError`] for a negative width, or one that is not a number. A width below 2e-13, which
    /// rounding does not allow, counts as 2e-13.
    pub fn refine(&mut self, a: &SparseMatrix, width: f64) -> Result<RadiusBound, WidthError> {
        if width.is_nan() || width < 0.0 {
            return Err(WidthError(width));
        }
        // Half of the narrowest width is left to the widening by rounding.
        Ok(self.search(a, width.max(2.0 * TOLERANCE)))
    }

    fn search(&mut self, a: &SparseMatrix, width: f64) -> RadiusBound {
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

    /// Brackets every component that the bounds of the whole leave open.
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
            let block = induced_subgraph(a, &nodes, &mut place);
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
            let open = !own.tight(width) && factorised;
            if let Some(elimination) = open.then(|| factorisation(&block)).flatten() {
                let top = self.block.x.iter().fold(1.0_f64, |top, x| x.max(top));
                let known = (own.lower, own.upper);
                let start = std::mem::take(&mut self.block.x);
                let root = perron(&block, &elimination, start, known, 0.5 * width);
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

    /// The positive vector of the last bounds, one entry per node.
    #[must_use]
    pub fn vector(&self) -> &[f64] {
        &self.work.x
    }

    /// The bounds as the [`SpectralRadius`] that the other functions of this crate take.
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

    /// Moves the vectors to a new list of `nodes` nodes: node i becomes node `map[i]`, or
    /// disappears. New nodes start from 1. A map that does not fit discards the vectors.
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
}
