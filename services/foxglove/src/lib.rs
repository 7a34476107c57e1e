#![doc = include_str!("../README.md")]
//!
//! # This crate
//!
//! [`Bridge`] is the core: messages of the fleet, viewers and time are its [`Input`]s; scenes, parameters and commands are
//! its [`Output`]s. [`scene`] has scenes as plain values, [`limits`] what may be sent, [`schema`] the JSON Schema as viewers
//! read it. `messages` gives scenes their bytes, and `shell` is everything else: the server, the bus and the clock.
//!
//! What holds at all times:
//! - Nothing is made that no one watches, and no topic has more than ten scenes in a second.
//! - One turn has no more messages than may wait for one viewer.
//! - Parameters are what services confirmed, and never what a viewer wished.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

mod core;
#[cfg(feature = "messages")]
pub mod messages;
#[cfg(feature = "reading")]
pub mod recording;
pub mod schema;
#[cfg(feature = "binary")]
pub mod shell;

pub use crate::core::{
    Access, Bridge, Fetch, Input, Output, Parameter, RequestId, Stale, TEAMS, Ticket, Topic,
    WEIGHTS, are_bounded, limits, scene, team_color,
};
