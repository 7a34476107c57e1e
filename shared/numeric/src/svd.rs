//! Singular value decomposition S = U Σ Vᵀ of the Katz similarity, cut at rank K, and the
//! representation that is read off it (equations 4 and 5 of the paper).
//!
//! Singular vectors are unique only up to a sign, and up to a rotation where singular values
//! coincide. A rule fixes the signs, [`alignment`] the rotations between frames, and
//! [`RankKSvd::ambiguous`] shows when the cut itself falls between coinciding values.

pub mod alignment;
mod davidson;
pub mod dimension;
pub mod embedding;
mod error;
mod full;
pub mod katz_svd;
mod operator;
mod rank_k;
mod signs;
mod spectrum;

pub use error::SvdError;
pub use full::{FullSvd, full_svd};
pub use rank_k::{AMBIGUOUS_GAP, RankKSvd};
pub use signs::SIGN_TIE;
