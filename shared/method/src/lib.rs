//! The method: from graphs and settings to vectors, teams and silhouettes.
//!
//! | step | module |
//! | --- | --- |
//! | weights of the modalities | [`weights`] |
//! | trust in each modality and in each rank | [`trust`] |
//! | what is left of the edges of robots with new orders | `orders` |
//! | fused graph A* = Σ w_m N_m + β I, N_m the scaled A_m + r_m A_mᵀ | `fusion` |
//! | bounds of ρ(A*), decay α, Katz centralities | `decay` |
//! | leading singular triplets of the Katz similarity S, whole or without forming S | [`decomposition`] |
//! | divisions into each number of teams | `candidates` |
//! | how many teams they show | [`team_count`] |
//! | how many of them are kept: K | `cut` |
//! | rows of X = \[U, V\], scaled | [`embedding`] |
//! | k-means over the rows | [`division`] |
//! | the same within limits of the teams | [`limited`] |
//! | silhouettes of a division | [`silhouettes`] |
//! | S_ij of two robots, by modality | [`pairs`] |
//! | why a robot is in its team, by modality | [`reasons`] |
//!
//! The same code serves a live fleet and a single problem. [`embedding::Frames`] keeps what the next frame
//! can begin with; [`embedding::embed`] is one frame of a new [`embedding::Frames`]. Services, `muster solve`,
//! experiments and benchmarks differ only in the fields of [`params::EmbeddingParams`] and
//! [`params::DivisionParams`], each of which has one documented default.
//!
//! This crate reads no clock and starts no thread of its own; [`step::Progress`] reports what it is doing.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

mod candidates;
mod correspondence;
mod cut;
mod decay;
pub mod decomposition;
pub mod division;
pub mod embedding;
mod error;
mod fusion;
mod graph;
pub mod limited;
mod orders;
pub mod pairs;
pub mod params;
pub mod reasons;
pub mod silhouettes;
mod similarity;
pub mod step;
pub mod team_count;
pub mod trust;
pub mod weights;

pub use decay::Decay;
pub use error::MethodError;
pub use graph::{Frame, Graph};
pub use team_count::TeamEvidence;
