//! Leading singular triplets of the Katz similarity from frame to frame, without the similarity.
//!
//! The full decomposition of S costs O(n³) however few triplets are needed. [`KatzSvd`] finds the
//! leading ones from a few products with the sparse graph (see `davidson`), and starts from the
//! triplets of the previous frame: while the graph changes little, they are close to the next ones.
//! Scratch space is kept between frames.
//!
//! When only few rows of the graph have changed, the triplets and their residuals are updated from
//! those rows alone (see `certificate`), and no search runs while the residuals are within the
//! tolerance. The changed rows are found by comparison with the previous graph, or given by the
//! caller.
//!
//! The residual of each triplet is measured, so every result comes with its own error bound. A
//! residual cannot reveal a triplet that is missing altogether: directions outside of the known ones
//! are kept for that, and what has changed most is looked at directly (see `probe`).

mod certificate;
mod error;
mod options;
mod probe;
mod solver;
mod triplets;

pub use super::davidson::{SearchColumns, SearchRound, search_columns};
pub use error::{KatzSvdError, MAX_EDGES};
pub use options::{KatzSvdOptions, KatzSvdOptionsError, ROUGH_TOLERANCE, ValidKatzSvdOptions};
pub use probe::PROBE_DIRECTIONS;
pub use solver::{KatzSvd, KatzSvdReport, PROBE_STEPS};
