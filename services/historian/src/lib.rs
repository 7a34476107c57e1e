#![doc = include_str!("../README.md")]
//!
//! # This crate
//!
//! Read in the order of the data's path: [`Historian`] receives what services publish and decides what is recorded;
//! `divisions` finds what changed in a division, `audits` which scores are worth a record, `fleet` who joined and
//! left. The runtime hands records to a store ([`Records`](muster_service::records::Records)): `store` is the file,
//! `file` how it is opened, `writing`, `reading` and `forgetting` what is done with it. The simulation and the tests
//! keep records in memory instead.
//!
//! What holds at all times:
//! - The core keeps the newest message of each kind and nothing older: its memory does not grow with time.
//! - A record of what changed follows a whole one without a gap. Where records were lost, a whole division comes next.
//! - Only what the store has reported as written is promised.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

mod audits;
mod core;
mod divisions;
mod fleet;
mod positions;
#[cfg(feature = "store")]
mod store;

pub use crate::core::Historian;
#[cfg(feature = "binary")]
pub use crate::store::open;
#[cfg(feature = "store")]
pub use crate::store::{FileRecords, SCHEMA_VERSION};
