//! The contract between a service's pure core and the shell that runs it.
//!
//! A service is a deterministic state machine: [`Core::handle`] takes an [`Event`] and a moment, and
//! writes [`Effect`]s. It reads no clock, starts no thread, opens no file and knows no bus; long work
//! is a [`Core::Job`], of which one runs at a time and the newest request wins ([`SingleFlight`]).
//! [`Driver`] ties a core to its jobs, so that every shell (the real one, a simulation, a replay)
//! treats it alike. [`Role`] is what all cores share: terms, epochs, settings, events, counters.

mod core;
mod driver;
mod role;

pub use crate::core::{
    Core, Delivery, Effect, Effects, Event, QueryId, Start, Stored, Subscription, Wiring,
};
pub use driver::{Command, Driver, SingleFlight};
pub use role::{Answered, Role, START_FETCH};
