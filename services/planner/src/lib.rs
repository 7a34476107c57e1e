//! What if: divisions with other settings, or without some robots, to look at.
//!
//! `planner` computes a proposal when an operator asks for one, and publishes nothing that anybody acts on. It is a
//! service of its own so that the live division never waits: its core, its thread and its one job at a time share nothing
//! with those that divide the fleet but the bus. It follows the graphs as `embedder` does, receives the live vectors and
//! division, and asks for settings and wishes when a proposal is to be computed.
//!
//! Read in the order of the data's path: `core` is the service, `proposals` the open proposals and those who wait for
//! them, `compute` the job: the method of `muster-method` and `muster-division`, which the live services call as well.
//!
//! | comes in | goes out |
//! | --- | --- |
//! | `graph/*`, `roster`, `embedding`, `teams`; gets of `propose/{operator}/{id}` | their answers |
//!
//! What holds at all times:
//! - Every get is answered within [`ANSWER_TIME`]: with the proposal, or with how far it is.
//! - A proposal rests on one division, one set of graphs, and the settings and wishes of one moment.
//! - One leader answers. Proposals are nowhere but in its memory: they are lost when it ends or stands down.
//! - A proposal is forgotten a minute after it was computed
//!   ([`PROPOSAL_LIFETIME`](muster_model::proposal::PROPOSAL_LIFETIME)).

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

mod compute;
mod core;
mod proposals;

pub use crate::compute::Job;
pub use crate::core::{Planner, PlannerFetch};
pub use crate::proposals::ANSWER_TIME;
