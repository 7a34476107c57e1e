//! `clusterer`: divides the embedded robots into teams with lasting identities.
//!
//! Read in the order of the data's path: [`Clusterer`] receives embeddings and decides what is published when; the job is
//! that of `muster-division`, k-means on the rows of an embedding, started from the teams before, under the rules that
//! limits, wishes and needs make. `wishes` are those of operators, and what has become of each; `dwell` says how long a
//! change must last before it counts; `leader` finds the commander of each team; `keeping` has what is on disk;
//! `publishing` says which robots are informed.
//!
//! What holds at all times:
//! - A robot of the embedding stands in exactly one team, or among those without one.
//! - A team keeps its id while most of its robots stay together, and gets it back if the same robots form it
//!   again within a minute of its end. No id is given to another team, not even after a restart of
//!   everything, as long as a disk or any service holds the last division.
//! - A robot changes from one living team to another only after every division has said so for `dwell_s`,
//!   unless its orders, the number of teams or what operators ask for have changed.
//! - A division obeys the limits of the settings and the wishes of operators. While nothing does, robots stay in the team that they have, no team
//!   has more robots than it may have, robots without a place have no team, and the division and an event say why.
//! - A robot that is stale fills no need. While needs cannot all be filled, as many are as can be, and all else goes on.
//! - The same embedding under the same settings is divided once, and once more where another number of teams
//!   has lasted. What is republished is the same division
//!   with a new revision, and its data grows older.
//! - A job that fails changes nothing: the last division is republished. A job that panics is tried again.
//! - A robot is informed of its team when that changes. All robots are also informed again in rotation, a
//!   bounded number in each heartbeat, so that a lost message is repaired without a burst.
//! - A robot that has left the fleet counts as stale until the next embedding, and leads no team
//!   while another member can.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

mod core;
mod dwell;
mod keeping;
mod leader;
mod publishing;
mod replacement;
mod wishes;

pub use crate::core::{Clusterer, MissedInputs};
pub use muster_division::division::{DivisionError, Job};
