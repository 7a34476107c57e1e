//! The mathematics of dividing a fleet into teams, from weighted graphs to labels.
//!
//! The method is that of Reily, Reardon and Zhang, *Representing Multi-Robot Structure through
//! Multimodal Graph Embedding for the Selection of Robot Teams* (ICRA 2020), called "the paper"
//! in this crate. Its steps, in the order in which they are applied:
//!
//! | step | module |
//! | --- | --- |
//! | fuse the graphs of all modalities into one, A* = Σ w_m A_m | [`fuse`] |
//! | bound the spectral radius of A*, on which the choice of α rests | [`spectral_radius`], [`radius_bound`] |
//! | choose the scales of the graphs and α, and keep them while they hold | [`norm_band`], [`katz`], [`alpha_band`] |
//! | Katz similarity S = (I − αA*)⁻¹ − I | [`katz`], [`cached_katz`], [`katz_column`] |
//! | singular value decomposition of S, cut at K | [`svd`], [`dimension`] |
//! | the same for large graphs, without S, from frame to frame | [`katz_svd`] |
//! | representation X = \[U, V\], one row per node | [`embedding`], [`alignment`] |
//! | k-means on the rows of X | [`kmeans`], [`margins`] |
//! | carry cluster identities over from the previous division | [`matching`] |
//! | score the division | [`silhouette`] |
//!
//! The crate knows nodes by their index only, does no input or output, keeps no state but in values
//! that the caller holds, and is deterministic: the same input gives the same output, bit for bit,
//! on the same machine.
//! Everything runs on the calling thread, except where an option asks for more threads; that never
//! changes a result. Public signatures use the types of this crate;
//! the linear algebra library behind them can be exchanged without touching a caller.
//!
//! Every entry of a [`matrix::DenseMatrix`] or [`matrix::SparseMatrix`] is finite and bounded by
//! [`matrix::MAX_ENTRY`], which is checked on construction; functions that take them rely on it.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

mod aligned;
pub mod alignment;
pub mod alpha_band;
mod backend;
pub mod cached_katz;
mod components;
pub mod dimension;
pub mod embedding;
pub mod fuse;
mod jacobi;
pub mod katz;
pub mod katz_column;
pub mod katz_svd;
pub mod kmeans;
mod lanczos;
pub mod margins;
pub mod matching;
pub mod matrix;
mod noda;
pub mod norm;
pub mod norm_band;
mod operator;
mod order;
mod panels;
mod partial;
pub mod radius_bound;
mod scaling;
mod share;
pub mod silhouette;
pub mod spectral_radius;
pub mod svd;
mod tall;
