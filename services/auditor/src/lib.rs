//! `auditor`: judges every division by silhouettes, independent of the service that made it.
//!
//! Read in the order of the data's path: [`Auditor`] takes events in, finds the embedding and the
//! roster that a division was made from, and decides what is told when; `history` keeps those; `judge` is
//! the job, silhouettes among the vectors and among the positions, by `muster-method`;
//! `alert` tells an operator of lasting bad quality, and of its end.
//!
//! What holds at all times:
//! - A division is judged by the embedding that it names, or not at all; one that comes late is
//!   waited for, and asked for after a while.
//! - The same division of the same data is judged once. What is told again is the same judgement
//!   with a new revision, and its data grows older honestly.
//! - A job that fails changes nothing: the last judgement stands and is told on. One that panics is
//!   tried again.
//! - What was last heard of the other services is repeated to whoever asks, so that one of them
//!   that was killed finds its last output again.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

mod alert;
mod core;
mod history;
mod judge;

pub use crate::core::{Auditor, MissingInputs};
pub use crate::judge::{Job, Judgement, Outcome};
