//! Why there is no Katz similarity.

use thiserror::Error;

use crate::linalg::matrix::MatrixError;

/// Why no Katz similarity could be computed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum KatzError {
    /// α is not a positive finite number.
    #[error("decay {0} is not a positive number")]
    Alpha(f64),
    /// The fraction is not strictly between 0 and 1.
    #[error("fraction {0} is not strictly between 0 and 1")]
    Fraction(f64),
    /// The hysteresis is not a number from 0 to below 1.
    #[error("hysteresis {0} is not a number from 0 to below 1")]
    Hysteresis(f64),
    /// The rank share is negative or not a number.
    #[error("rank share {0} is not a number from 0 on")]
    RankShare(f64),
    /// α ρ(A) is not certified to be below 1.
    #[error(
        "decay {alpha} is too large: with spectral radius {radius} their product must stay below 1"
    )]
    Diverges {
        /// The decay α.
        alpha: f64,
        /// Upper bound of the spectral radius ρ(A).
        radius: f64,
    },
    /// The system could not be solved in floating point (entries out of range).
    #[error("the Katz matrix for decay {alpha} leaves the range of floating point numbers")]
    Overflow {
        /// The decay α.
        alpha: f64,
    },
    /// No way to solve the system gives a solution of it: weights are too far apart.
    #[error(
        "the Katz matrix for decay {alpha} cannot be computed: its weights are too far apart (the \
         probe of the solution is {probe:.0e})"
    )]
    Inexact {
        /// The decay α.
        alpha: f64,
        /// [`crate::katz::katz_probe`] of the best solution.
        probe: f64,
    },
    /// S does not have the shape of A.
    #[error("a {rows} × {cols} similarity does not belong to a graph of {nodes} nodes")]
    Shape {
        /// Rows of S.
        rows: usize,
        /// Columns of S.
        cols: usize,
        /// Nodes of A.
        nodes: usize,
    },
    /// There is no such node.
    #[error("node {node} is not one of {nodes}")]
    Node {
        /// The node.
        node: usize,
        /// Nodes of A.
        nodes: usize,
    },
    /// The graph is too large for a dense matrix.
    #[error(transparent)]
    Matrix(#[from] MatrixError),
}
