//! Spectral norm ‖A‖₂ of a non-negative matrix, for one graph and from frame to frame.

pub mod band;
mod golub_kahan;
mod spectral;

pub use spectral::spectral_norm;
