//! Seeded fleets for demonstrations and tests: where robots are, which robots they receive and who is superior
//! to, at any moment, and the teams that they truly form. Fleets may also stand in files ([`Layout`]).
//!
//! There is no clock and no input or output here. Everything follows from the options and the moment
//! that is asked for, so that the same seed gives the same fleet again, from any moment on, and in
//! several processes at once.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

mod clusters;
mod crossing;
mod file;
mod fleet;
mod formation;
mod noise;
mod options;
mod radio;
mod random;

pub use file::{FileError, FileRobot, Layout, MAX_FILE_BYTES, ScenarioFile};
pub use fleet::{Fleet, RobotObservation};
pub use options::{FleetOptions, ScenarioError, ScenarioKind};
