//! Spectral radius of a non-negative matrix, enclosed between certified bounds.
//!
//! The Katz series converges if and only if α ρ(A) < 1; the paper's Proposition 1 asks for 1/α
//! above the largest eigenvalue, which for directed graphs with their complex eigenvalues means
//! the spectral radius.

use super::perron::{Perron, TOLERANCE, factorisation, normalised, perron, widened};
use super::search::{Limits, Vectors};
use crate::graph::components::strongly_connected;
use crate::graph::subgraph::induced_subgraph;
use crate::linalg::matrix::SparseMatrix;

/// Sweeps over every component at first, which show the ones that may have the largest radius. The
/// result is a sufficient start for Noda's iteration.
const COARSE_LIMITS: Limits = Limits { width: 1e-2, sweeps: 100 };

/// Sweeps whose multiply-adds a factorisation must take before sweeps are tried in its place: it makes a
/// few times as many in the same time.
const MIN_FACTORISATION_SWEEPS: usize = 1000;

/// Most sweeps over a component in place of a factorisation.
const MAX_BLOCK_SWEEPS: usize = 200;

/// Multiply-adds spent on sweeps over a component that is too large to factorise.
const SWEEP_WORK: usize = 400_000_000;

/// Least and most sweeps over a component that is too large to factorise.
const LARGE_SWEEPS: (usize, usize) = (100, 5000);

/// Enclosure of the spectral radius ρ, in the unit of the weights.
#[derive(Debug, Clone, PartialEq)]
pub struct SpectralRadius {
    /// ρ is at least this.
    pub lower: f64,
    /// ρ is at most this.
    pub upper: f64,
    /// Best estimate: the middle of the bounds.
    pub value: f64,
    /// True when the graph has no cycle; all bounds are then exactly 0.
    pub acyclic: bool,
    /// One positive entry per node, x, with (Ax)_i/x_i at most the upper bound within the strongly
    /// connected component of each node: the Perron vector of a component that has the largest
    /// radius, a rougher one elsewhere, and 1 for a node in no cycle. Start for the next call.
    pub vector: Vec<f64>,
}

/// The radius of a graph without nodes.
impl Default for SpectralRadius {
    fn default() -> Self {
        Self { lower: 0.0, upper: 0.0, value: 0.0, acyclic: true, vector: Vec::new() }
    }
}

/// Spectral radius ρ of the non-negative matrix `a`.
///
/// ρ is the largest Perron root among the strongly connected components (Frobenius normal form);
/// a component without a cycle contributes exactly 0, where dense eigenvalues of a nilpotent
/// matrix would come out far from 0 by rounding. Each root is enclosed by Collatz–Wielandt
/// quotients to a relative width of about 1e-13: by the sweeps of [`crate::radius_bound`] where
/// they get there, which for sparse fleets they mostly do, and by Noda's iteration where not. The
/// bounds hold whatever happens; components of more than 20,000 nodes, and those of more than 4,096 that
/// fill in much, get a limited number of sweeps only and may keep a wider bracket.
///
/// `warm` is the `vector` of a similar matrix, one entry per node; it is ignored where it does
/// not fit (wrong length, entries that are not positive and finite).
#[must_use]
pub fn spectral_radius(a: &SparseMatrix, warm: Option<&[f64]>) -> SpectralRadius {
    let n = a.nodes();
    let warm = warm.filter(|w| w.len() == n);
    let mut result = SpectralRadius { vector: vec![1.0; n], ..SpectralRadius::default() };
    let mut place = vec![usize::MAX; n];
    let mut open = Vec::new();
    for nodes in strongly_connected(a) {
        if let [only] = nodes[..] {
            let own = a.weight(only, only);
            result.acyclic &= own == 0.0;
            result.lower = result.lower.max(own);
            result.upper = result.upper.max(own);
            continue;
        }
        result.acyclic = false;
        let block = induced_subgraph(a, &nodes, &mut place);
        let mut vectors = Vectors::default();
        vectors.x = start_vector(&nodes, warm);
        let found = vectors.search(&block, result.lower, COARSE_LIMITS);
        result.lower = result.lower.max(found.lower);
        write(&mut result.vector, &nodes, &vectors.x);
        open.push((nodes, block, found.upper));
    }
    for (nodes, block, upper) in open {
        if upper <= result.lower {
            continue;
        }
        let start = nodes.iter().map(|&i| result.vector[i]).collect();
        let root = bracket(&block, start, upper);
        result.lower = result.lower.max(root.lower);
        result.upper = result.upper.max(root.upper);
        write(&mut result.vector, &nodes, &root.vector);
    }
    // A skipped component has a radius of at most the lower bound.
    result.upper = result.upper.max(result.lower);
    result.value = 0.5 * (result.lower + result.upper);
    result
}

/// Writes the entries of `nodes`.
fn write(vector: &mut [f64], nodes: &[usize], entries: &[f64]) {
    for (&node, &value) in nodes.iter().zip(entries) {
        vector[node] = value;
    }
}

/// Brackets ρ of one strongly connected component, from the positive vector `start` and the known
/// upper bound.
fn bracket(block: &SparseMatrix, start: Vec<f64>, upper: f64) -> Perron {
    let mut vectors = Vectors::default();
    vectors.x = start;
    let mut known = (0.0, upper);
    let edges = block.edges();
    let (least, most) = LARGE_SWEEPS;
    let elimination = factorisation(block);
    let sweeps = match &elimination {
        None => (SWEEP_WORK / edges).clamp(least, most),
        Some(elimination) if elimination.work() / edges < MIN_FACTORISATION_SWEEPS => 0,
        Some(_) => MAX_BLOCK_SWEEPS,
    };
    if sweeps > 0 {
        let found = vectors.search(block, 0.0, Limits { width: TOLERANCE, sweeps });
        known = (found.lower, upper.min(found.upper));
        if found.tight(TOLERANCE) {
            return widened(block, known, vectors.x);
        }
    }
    match elimination {
        Some(elimination) => perron(block, &elimination, vectors.x, known, TOLERANCE),
        None => widened(block, known, normalised(vectors.x)),
    }
}

/// The entries of `warm` for `nodes` if they are usable, ones otherwise.
fn start_vector(nodes: &[usize], warm: Option<&[f64]>) -> Vec<f64> {
    let part: Option<Vec<f64>> = warm.map(|w| nodes.iter().map(|&i| w[i]).collect());
    part.filter(|p| p.iter().all(|v| v.is_finite() && *v > 0.0))
        .unwrap_or_else(|| vec![1.0; nodes.len()])
}
