//! From observations of robots to one weighted directed graph per modality.
//!
//! Robots are indices from 0 here; the caller knows their names. Every function is pure, so that
//! the live fleet and a fleet in a file have the same rules. All edge lists are ordered by
//! source, then target, and name no edge twice.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

mod compact;
pub mod connectivity;
pub mod edge;
pub mod hierarchy;
pub mod kernel;
mod neighbours;
pub mod spatial;

pub use connectivity::{connectivity_edges, link_weight, signal_weight};
pub use edge::{Edge, EdgeError, relation_edges};
pub use hierarchy::hierarchy_edges;
pub use neighbours::median_nearest_neighbour_distance;
pub use spatial::spatial_edges;
