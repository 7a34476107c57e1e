//! Graphs in, one vector per robot out.
//!
//! `embedder` follows the graphs of all modalities into frames that belong together
//! ([`muster_service::following`]), embeds each frame by `muster-method`, beginning with what is kept of the
//! last one (module `compute`), and publishes the vectors as [`muster_model::embedding::Embedding`]. Module `pairs`
//! answers gets of the similarity of two robots, module `teams` follows how many teams are wanted, on
//! which the dimension and the published evidence depend, module `doubt` reports modalities that are in doubt, module
//! `reasons` says why a robot is in its team.
//! Module `core` decides when.
//!
//! | comes in | goes out |
//! | --- | --- |
//! | `graph/*`, `roster`, `service/clusterer/settings` | `embedding`, `event`, `service/embedder/settings` |
//!
//! A get of `why` makes it fetch `teams` and `wishes`.
//! It also answers gets of the last `roster` and its graphs, for an `ingest` that restarts.
//! The last good embedding stands through every fault: it is served until a newer one exists.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

mod compute;
mod core;
mod doubt;
mod pairs;
mod reasons;
mod shape;
mod teams;

pub use crate::compute::{Done, Job};
pub use crate::core::{Embedder, EmbedderFetch};
