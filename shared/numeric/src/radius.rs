//! Certified bounds of the spectral radius ρ(A) of a non-negative matrix.

mod elimination;
pub mod exact;
mod patch;
mod perron;
mod search;
mod sweep;
pub mod tracker;

pub(crate) use sweep::Chebyshev;
