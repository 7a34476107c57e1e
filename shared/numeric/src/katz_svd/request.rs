//! What is asked of the search for leading triplets, what comes of it, and what may be wrong with it.

use thiserror::Error;

use crate::katz::KatzError;
use crate::matrix::SparseMatrix;
use crate::spectral_radius::SpectralRadius;
use crate::svd::SvdError;

/// Most edges of a graph, so that places among them, with what is moved when rows change, can be told by
/// 32 bits.
pub const MAX_EDGES: usize = 1 << 30;

/// What is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KatzSvdOptions {
    /// How many triplets, from 1 to n.
    pub rank: usize,
    /// Largest residual ‖Mᵀ(Sᵀu − σv)‖/σ₁ with M = I − αA, above 0. ‖Sᵀu − σv‖ is at most 1 + σ₁ times
    /// as large, and S v − σu is zero but for rounding.
    pub tolerance: f64,
    /// Seed of the random directions.
    pub seed: u64,
    /// Threads that the rows of large graphs are shared out over; 0 counts as 1. The result does not
    /// depend on it, bit for bit. More than one are started by the first frame and kept.
    pub threads: usize,
}

/// Why no triplets could be computed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum KatzSvdError {
    /// The decay is no positive number, or α ρ is not certified to be below 1.
    #[error(transparent)]
    Katz(#[from] KatzError),
    /// The rank is 0 or above the number of nodes.
    #[error(transparent)]
    Rank(#[from] SvdError),
    /// The tolerance is not a positive number.
    #[error("tolerance {0} is not a positive number")]
    Tolerance(f64),
    /// The correspondence with the frame before does not have one entry per node, or names a node
    /// that the frame before did not have.
    #[error("the correspondence with the frame before does not fit {nodes} nodes")]
    Correspondence {
        /// Nodes of the graph.
        nodes: usize,
    },
    /// A row is said to have changed that the graph does not have.
    #[error("row {row} is said to have changed in a graph of {nodes} nodes")]
    Changed {
        /// The row.
        row: usize,
        /// Nodes of the graph.
        nodes: usize,
    },
    /// The graph has more than [`MAX_EDGES`] edges.
    #[error(
        "{edges} edges are more than the {} that can be decomposed: thin the graph out",
        MAX_EDGES
    )]
    Edges {
        /// Edges of the graph.
        edges: usize,
    },
}

/// How a solve went.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KatzSvdReport {
    /// Rounds of the search; 0 when the triplets of the frame before could be brought up to date without.
    pub rounds: usize,
    /// The largest residual among the triplets that were asked for, as in [`KatzSvdOptions::tolerance`].
    /// [`crate::svd::RankKSvd::angle_bound`] says what it means for the subspaces.
    pub residual: f64,
    /// Whether that is within the tolerance. If not, S is to be decomposed whole.
    pub converged: bool,
}

/// Refuses what cannot be asked for.
pub(super) fn check(
    a: &SparseMatrix,
    alpha: f64,
    radius: &SpectralRadius,
    options: KatzSvdOptions,
) -> Result<(), KatzSvdError> {
    let n = a.nodes();
    if a.edges() > MAX_EDGES {
        return Err(KatzSvdError::Edges { edges: a.edges() });
    }
    if !(alpha.is_finite() && alpha > 0.0) {
        return Err(KatzError::Alpha(alpha).into());
    }
    if alpha * radius.upper >= 1.0 {
        return Err(KatzError::Diverges { alpha, radius: radius.upper }.into());
    }
    if options.rank == 0 || options.rank > n {
        return Err(SvdError::Rank { rank: options.rank, nodes: n }.into());
    }
    if !(options.tolerance.is_finite() && options.tolerance > 0.0) {
        return Err(KatzSvdError::Tolerance(options.tolerance));
    }
    Ok(())
}
