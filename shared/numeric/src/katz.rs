//! Katz similarity S = Σ_{l ≥ 1} αˡ Aˡ = (I − αA)⁻¹ − I.
//!
//! Katz, Psychometrika 18, 1953; equations 1 to 3 of the paper. S_ij is the weight of all walks
//! from node i to node j, each step damped by the decay α. The series converges if and only if
//! α ρ(A) < 1. Beyond that I − αA can still be inverted, but the result has negative entries and
//! is no similarity: every function here rejects such an α.

mod alpha;
pub mod alpha_band;
pub mod cached;
mod centrality;
pub mod column;
mod error;
mod rows;
mod scaling;
mod similarity;
mod walks;

pub(crate) use alpha::check_alpha;
pub use alpha::{Alpha, resolve_alpha};
pub use centrality::Centrality;
pub use error::KatzError;
pub use rows::short_katz_rows;
pub use similarity::{MAX_KATZ_PROBE, katz_probe, katz_similarity};
