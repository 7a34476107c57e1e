//! Matrices, blocks of vectors, and the kernels and threads that work on them.

mod aligned;
pub(crate) mod backend;
pub(crate) mod block_vectors;
pub(crate) mod jacobi;
pub mod matrix;
pub(crate) mod parallel;
pub(crate) mod simd;
pub(crate) mod simd_pack;
pub(crate) mod single_block;
pub(crate) mod vector;

pub(crate) use aligned::Aligned;
