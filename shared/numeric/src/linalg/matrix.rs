//! The two matrix types of this crate: dense row-major, and sparse square non-negative.

mod dense;
mod error;
mod sparse;

pub use dense::DenseMatrix;
pub use error::{MAX_DENSE_ENTRIES, MAX_ENTRY, MAX_NODES, MIN_WEIGHT, MatrixError};
pub use sparse::SparseMatrix;
