//! `auditor`: scores every division by silhouettes, independent of the service that made it.
//!
//! Read in the order of the data's path: [`Auditor`] receives messages, finds the embedding and the
//! roster that a division was made from, and decides what is published when; `history` keeps those;
//! `score` is the job, silhouettes among the vectors and among the positions, by `muster-method`;
//! `flapping` counts robots that change their team and change back; `alert` reports lasting bad quality and
//! flapping to the operator, and their end.
//!
//! What holds at all times:
//! - A division is scored by the embedding that it names, or not at all. A late embedding is waited
//!   for, then fetched.
//! - The same division of the same data is scored once. What is published again has the same scores and
//!   a new revision, and its data grows older.
//! - A job that fails changes nothing: the last scores are published on. A job that panics is tried
//!   again.
//! - Gets of the other services' last output are answered from the cache, so that a service that was
//!   killed finds its own.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

mod alerts;
mod core;
mod flapping;
mod history;
mod recordings;
mod score;
mod teams;

pub use crate::core::{Auditor, AuditorFetch};
pub use crate::score::{Job, Scores};
pub use crate::teams::TeamScores;
pub use muster_division::scores::ScoreError;
