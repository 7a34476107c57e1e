//! `clusterer`: divides the embedded robots into teams with lasting identities.
//!
//! Read in the order of the data's path: [`Clusterer`] takes events in and decides what is told
//! when; `division` is the job, k-means on the rows of an embedding, started from the teams before;
//! `identity` gives each cluster a team id that lives on, and names what changed; `leader` finds
//! who commands each team.
//!
//! What holds at all times:
//! - A robot of the embedding stands in exactly one team, or among those without one.
//! - A team keeps its id for as long as it shares most with itself; an id is never given twice,
//!   also over restarts, as long as any service remembers the last division.
//! - The same embedding under the same settings is divided once. What is told again is the same
//!   division with a new revision, and its data grows older honestly.
//! - A job that fails changes nothing: the last division stands and is told on.
//! - A robot is told of its team when that changes, and never otherwise; a new holder of the role,
//!   and one whose link was lost, tells every robot once, because it cannot know what arrived.

mod core;
mod division;
mod identity;
mod leader;

pub use crate::core::Clusterer;
pub use crate::division::{Job, Outcome};
