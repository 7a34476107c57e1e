//! What a service is, whatever runs it.
//!
//! A service is a [`Core`]: a deterministic state machine with a hook for everything that can happen. A [`Host`]
//! wraps it and owns what every service needs: election and terms, suppressed output, settings,
//! refused messages, fetches with retries, gets, the one job, and the order in which all of that is
//! handled. A host takes one [`Input`] and returns [`Command`]s; it reads no clock, starts no thread,
//! opens no file and knows no bus. The real shell, the simulation, the replay and the tests drive the
//! same host. [`records`] has what a history is kept in, and how records wait for it. [`recording`] is a list of inputs and commands in a file, and [`replay`] hands them to
//! a host again.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

mod commands;
mod core;
mod facilities;
mod failures;
mod fetches;
pub mod following;
mod gets;
mod host;
pub mod inbox;
mod io;
mod newest;
pub mod recording;
pub mod records;
pub mod replay;
mod replica;
mod robot_teams;
mod single_flight;
mod start;
mod stopwatch;
pub mod testkit;
mod unstored;
mod wiring;

pub use crate::core::{Connectivity, Context, Core, FreeJobSlot, JobEnd, MemoryUse, View};
pub use failures::JobsFailing;
pub use gets::Get;
pub use host::Host;
pub use io::{Arrival, Ask, AskId, Command, GetId, IncomingGet, Input, Publication, Reply};
pub use newest::{Newest, Recency};
pub use replica::election::LEASE;
pub use replica::lease::RENEWAL_INTERVAL;
pub use robot_teams::{TooManyNames, answer_teams};
pub use single_flight::SingleFlight;
pub use start::{Start, Stored};
pub use stopwatch::Stopwatch;
pub use wiring::{Authority, Delivery, Replication, ServedKey, Subscription, Wiring};
