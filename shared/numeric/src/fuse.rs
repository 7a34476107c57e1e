//! Fusion of several graphs over the same nodes into one: A* = Σ w_m A_m.

pub use muster_model::settings::Normalization;
use thiserror::Error;

use crate::matrix::{MatrixError, SparseMatrix};
use crate::norm::spectral_norm;

/// Why graphs could not be fused.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum FuseError {
    /// There is nothing to fuse.
    #[error("no graph to fuse")]
    Empty,
    /// A graph has another number of nodes than the first one.
    #[error("graph {index} has {found} nodes instead of {expected}")]
    Nodes {
        /// Position of the graph in the list.
        index: usize,
        /// Nodes of the first graph.
        expected: usize,
        /// Nodes of this graph.
        found: usize,
    },
    /// A weight w_m is negative or not finite.
    #[error("weight {value} of graph {index} is not a non-negative number")]
    Weight {
        /// Position of the graph in the list.
        index: usize,
        /// Its weight.
        value: f64,
    },
    /// A weighted sum of edges leaves the range of a matrix entry.
    #[error(transparent)]
    Matrix(#[from] MatrixError),
}

/// Fused graph A* = Σ w_m A_m (equation 3 of the paper), each A_m scaled as `normalization` says.
///
/// [`Normalization::Spectral`] divides each graph by its spectral norm σ₁(A_m), so that weights mean the
/// same for every modality. The norm of a symmetric graph equals its spectral radius; the radius itself
/// cannot serve, since it is 0 for every acyclic graph, such as a command tree.
///
/// Takes pairs (A_m, w_m) of n × n matrices and non-negative weights. The paper asks for
/// Σ w_m = 1, which is left to the caller: a common factor of all weights scales A* and nothing
/// else. A graph without edges stays as it is.
///
/// # Errors
/// [`FuseError`]: no graphs, different sizes, an unusable weight, or entries out of range.
pub fn fuse(
    graphs: &[(&SparseMatrix, f64)],
    normalization: Normalization,
) -> Result<SparseMatrix, FuseError> {
    let norm = |&(graph, weight): &(&SparseMatrix, f64)| match normalization {
        Normalization::Spectral if weight > 0.0 => spectral_norm(graph),
        _ => 1.0,
    };
    let scaled: Vec<_> = graphs.iter().map(|pair| (pair.0, pair.1, norm(pair))).collect();
    fuse_scaled(&scaled)
}

/// Σ w_m A_m / s_m from (A_m, w_m, s_m): [`fuse`] with the scales s_m > 0 of the caller, such as those
/// of [`crate::norm_band`].
///
/// # Errors
/// As [`fuse`].
pub fn fuse_scaled(graphs: &[(&SparseMatrix, f64, f64)]) -> Result<SparseMatrix, FuseError> {
    let expected = graphs.first().ok_or(FuseError::Empty)?.0.nodes();
    let mut entries = Vec::new();
    for (index, &(graph, weight, scale)) in graphs.iter().enumerate() {
        if graph.nodes() != expected {
            let found = graph.nodes();
            return Err(FuseError::Nodes { index, expected, found });
        }
        if !(weight.is_finite() && weight >= 0.0) {
            return Err(FuseError::Weight { index, value: weight });
        }
        if weight == 0.0 || graph.is_zero() {
            continue;
        }
        // Dividing each weight rather than multiplying by a quotient keeps symmetric graphs
        // symmetric and a lone graph of norm 1 unchanged.
        entries.extend(graph.triplets().map(|(i, j, w)| (i, j, weight * (w / scale))));
    }
    Ok(SparseMatrix::from_triplets(expected, entries)?)
}
