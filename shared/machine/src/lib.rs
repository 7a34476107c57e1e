//! The contract between a service's pure core and the shell that runs it.
//!
//! A service is a deterministic state machine: [`Core::handle`] takes an [`Event`] and a moment, and
//! writes [`Effect`]s. It reads no clock, starts no thread, opens no file and knows no bus; long work
//! is a [`Core::Job`], of which one runs at a time for the newest input ([`JobGate`]). [`Driver`] hands
//! over events and collects commands, so that every shell (the real one, a simulation, a replay)
//! treats a core alike; [`recording`] is what is written down of its life, and [`replay`]
//! lives through that again. [`Role`] is what all cores share: terms, epochs, settings, events, counters.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

mod core;
mod driver;
mod jobs;
pub mod recording;
pub mod replay;
mod robot_teams;
mod role;
mod stopwatch;
mod tenure;

pub use crate::core::{
    Core, Delivery, Effect, Effects, Event, Footprint, QueryId, Start, Stored, Subscription,
    Wiring, is_patient,
};
pub use driver::{Command, Driver};
pub use jobs::JobGate;
pub use robot_teams::answer_teams;
pub use role::{Answered, Role, START_FETCH, TERM_FETCH, Turn};
pub use stopwatch::Stopwatch;
pub use tenure::{CLAIM_EVERY, HOLDER_SILENT};
