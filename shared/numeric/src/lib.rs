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
//! | choose the scales of the graphs and α, and keep them from frame to frame | [`norm_band`], [`katz`], [`alpha_band`] |
//! | Katz similarity S = (I − αA*)⁻¹ − I | [`katz`], [`cached_katz`], [`katz_column`] |
//! | singular value decomposition of S, cut at K | [`svd`], [`dimension`] |
//! | the same for large graphs, without S, from frame to frame | [`katz_svd`] |
//! | representation X = \[U, V\], one row per node | [`embedding`], [`alignment`] |
//! | k-means on the rows of X | [`kmeans`], [`margins`] |
//! | carry cluster identities over from the previous division | [`matching`] |
//! | score the division | [`silhouette`] |
//! | compare two divisions | [`agreement`] |
//! | score divisions into several numbers of groups | [`modularity`] |
//! | score each group, and find what holds it together | [`conductance`], [`cuts`] |
//! | divide under limits, wishes and needs at the least cost | [`assignment`] |
//!
//! The folders are fields of mathematics, and imports between them lead downwards only: `svd`
//! (decomposition and representation), `katz` (similarity and decay), `fuse`, `norm` (spectral
//! norm), `radius` (spectral radius), `graph` (algorithms on graphs) and `linalg` (matrices
//! and kernels); `cluster` (division and its quality) needs `linalg` and `assignment` (limits, which
//! need nothing) alone. Public modules are
//! re-exported here under the names of the table.
//!
//! The crate identifies nodes by their index, does no input or output, and has no state except in
//! values of the caller. It is deterministic: the same input gives the same output, bit for bit,
//! on the same machine. All work runs on the calling thread unless a parameter asks for more
//! threads, which never changes a result. Public signatures use the types of this crate, so that
//! the linear algebra library can be exchanged without a change of callers.
//!
//! Every entry of a [`matrix::DenseMatrix`] or [`matrix::SparseMatrix`] is finite and bounded by
//! [`matrix::MAX_ENTRY`], which is checked on construction; functions that take them rely on it.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

pub mod assignment;
mod cluster;
pub mod fuse;
mod graph;
pub mod katz;
mod linalg;
pub mod norm;
mod radius;
pub mod svd;

pub use cluster::{agreement, kmeans, margins, matching, silhouette};
pub use graph::{conductance, cuts, modularity};
pub use katz::{alpha_band, cached as cached_katz, column as katz_column};
pub use linalg::matrix;
pub use norm::band as norm_band;
pub use radius::{exact as spectral_radius, tracker as radius_bound};
pub use svd::{alignment, dimension, embedding, katz_svd};
