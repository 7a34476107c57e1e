//! `ingest`: from the streams of the robots to one weighted directed graph per modality.
//!
//! Read in the order of the data's path: [`Ingest`] takes events in and decides what is told when;
//! `admission` checks what robots say, and refuses it with a reason or lets it in; `roster` keeps
//! who is there, and `robot` since when, with the last observation of each stream; `graphs` makes
//! rows of edges out of the observations; `frames` publishes what changed in them; `restore` fills
//! the roster after a restart with what other services still remember.
//!
//! What holds at all times:
//! - A refused message changes neither what is known of a robot nor a graph; it is counted, told of
//!   and forgotten. One in doubt gives its robot a little more time, no more.
//! - Age is judged by the clock of the receiver, order by what the robot says of it.
//! - A frame is whole: who applies the graphs that a roster lists holds one state of the fleet.
//! - Memory is bounded by the number of robots times their streams; nothing is kept of a robot that
//!   was not let in.
//!
//! Graphs are computed inside of [`Ingest`]'s loop and not as a job: only the modalities whose
//! observations changed are computed, at most once per frame, for at most `max_robots` robots.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

mod admission;
mod core;
mod frames;
mod graphs;
mod restore;
mod robot;
mod roster;

pub use crate::core::Ingest;
