//! Why leading triplets could not be computed.

use thiserror::Error;

use super::options::{KatzSvdOptions, KatzSvdOptionsError, ValidKatzSvdOptions};
use crate::katz::{KatzError, check_alpha};
use crate::linalg::matrix::SparseMatrix;
use crate::radius::exact::SpectralRadius;
use crate::svd::error::SvdError;

/// Most edges of a graph: 32 bits address an edge, with the room that replaced rows leave behind.
pub const MAX_EDGES: usize = 1 << 30;

/// Why no triplets could be computed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum KatzSvdError {
    /// The decay is no positive number, or α ρ is not certified to be below 1.
    #[error(transparent)]
    Katz(#[from] KatzError),
    /// A parameter is out of its range.
    #[error(transparent)]
    Options(#[from] KatzSvdOptionsError),
    /// The rank is above the number of nodes.
    #[error(transparent)]
    Rank(#[from] SvdError),
    /// The map to the previous frame does not have one entry per node, or names a node that the
    /// previous frame did not have.
    #[error("the correspondence with the frame before does not fit {nodes} nodes")]
    Correspondence {
        /// Nodes of the graph.
        nodes: usize,
    },
    /// A changed row is beyond the graph.
    #[error("row {row} is marked as changed in a graph of {nodes} nodes")]
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

/// The checked parameters, if they, the graph and the decay admit a search.
pub(super) fn check(
    a: &SparseMatrix,
    alpha: f64,
    radius: &SpectralRadius,
    options: KatzSvdOptions,
) -> Result<ValidKatzSvdOptions, KatzSvdError> {
    let n = a.nodes();
    if a.edges() > MAX_EDGES {
        return Err(KatzSvdError::Edges { edges: a.edges() });
    }
    check_alpha(alpha, radius.upper)?;
    if options.rank > n {
        return Err(SvdError::Rank { rank: options.rank, nodes: n }.into());
    }
    Ok(options.check()?)
}
