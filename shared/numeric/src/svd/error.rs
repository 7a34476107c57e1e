//! Why there is no singular value decomposition.

use thiserror::Error;

/// Why no decomposition could be computed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SvdError {
    /// The matrix is not square.
    #[error("a {rows} × {cols} matrix is not square")]
    NotSquare {
        /// Its rows.
        rows: usize,
        /// Its columns.
        cols: usize,
    },
    /// The rank asked for is 0 or above the size of the matrix.
    #[error("rank {rank} is not between 1 and {nodes}")]
    Rank {
        /// Rank asked for.
        rank: usize,
        /// Size n of the matrix.
        nodes: usize,
    },
    /// A matrix of another size was compared with the decomposition.
    #[error("a matrix of {found} rows does not belong to a decomposition of {expected}")]
    Size {
        /// Rows of the decomposition.
        expected: usize,
        /// Rows found.
        found: usize,
    },
}
