//! `ingest`: from the streams of the robots to one weighted directed graph per modality.
//!
//! Read in the order of the data's path: [`Ingest`] receives messages and decides what is published when;
//! `admission` accepts reports or refuses them with a reason; `roster` keeps all robots, and `robot` the
//! presence and the last observation of each stream of one; `graphs` makes rows of edges out of the
//! observations; `frames` publishes what changed in them; `restore` fills the roster after a restart with
//! what other services still hold.
//!
//! What holds at all times:
//! - A refused message changes neither a robot nor a graph; it is counted and reported. An ambiguous one
//!   extends the grace period of its robot.
//! - Age is measured by the receiver's clock; order is what the robot states.
//! - A frame is whole: a reader that applies the graphs that a roster lists holds one state of the fleet.
//! - Memory is bounded by the number of robots times their streams; nothing is kept of a refused robot.
//!
//! Graphs are computed inside of [`Ingest`]'s loop and not as a job: only the modalities whose
//! observations changed are computed, at most once per frame, for at most `max_robots` robots.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

mod admission;
mod core;
mod frames;
mod graphs;
mod presence;
mod restore;
mod robot;
mod roster;

pub use crate::core::Ingest;
