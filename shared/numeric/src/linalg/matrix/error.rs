//! Limits of matrices, and the error that names the one that was exceeded.

use thiserror::Error;

/// Largest modulus of a matrix entry. The bound leaves room for sums of products of entries, so
/// that no intermediate result of this crate overflows.
pub const MAX_ENTRY: f64 = 1e100;

/// Smallest weight that a [`SparseMatrix`] keeps; anything below is dropped as zero, so that
/// quotients of weights stay within the range of `f64`.
pub const MIN_WEIGHT: f64 = 1e-100;

/// Largest number of entries of a dense matrix (2 GiB).
pub const MAX_DENSE_ENTRIES: usize = 1 << 28;

/// Largest number of nodes of a sparse matrix.
pub const MAX_NODES: usize = 1 << 24;

/// Why a matrix could not be built or applied.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum MatrixError {
    /// The number of values does not equal rows × columns.
    #[error("a {rows} × {cols} matrix cannot hold {len} values")]
    Shape {
        /// Rows asked for.
        rows: usize,
        /// Columns asked for.
        cols: usize,
        /// Values given.
        len: usize,
    },
    /// The matrix would exceed [`MAX_DENSE_ENTRIES`] or [`MAX_NODES`].
    #[error("a {rows} × {cols} matrix is too large")]
    TooLarge {
        /// Rows asked for.
        rows: usize,
        /// Columns asked for.
        cols: usize,
    },
    /// An entry is not a number, infinite, or larger than [`MAX_ENTRY`] in modulus.
    #[error("entry ({row}, {col}) is {value}: not finite or too large")]
    Entry {
        /// Row of the entry.
        row: usize,
        /// Column of the entry.
        col: usize,
        /// Its value.
        value: f64,
    },
    /// A weight of a sparse matrix is negative.
    #[error("weight ({row}, {col}) is {value}: negative")]
    Negative {
        /// Row of the weight.
        row: usize,
        /// Column of the weight.
        col: usize,
        /// Its value.
        value: f64,
    },
    /// A triplet lies outside of the matrix.
    #[error("position ({row}, {col}) lies outside of {nodes} nodes")]
    OutOfBounds {
        /// Row of the triplet.
        row: usize,
        /// Column of the triplet.
        col: usize,
        /// Number of nodes.
        nodes: usize,
    },
    /// A vector does not have one entry per column.
    #[error("a vector of {len} entries does not fit {cols} columns")]
    Vector {
        /// Columns of the matrix.
        cols: usize,
        /// Entries of the vector.
        len: usize,
    },
}
