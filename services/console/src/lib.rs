#![doc = include_str!("../README.md")]
//!
//! # This crate
//!
//! [`Console`] is the core: browsers, messages of the fleet and time are its [`Input`]s, frames and texts for browsers and
//! commands to the fleet are its [`Output`]s. `fleet` is the fleet as browsers see it, `browser` what one of them may do
//! and has, `turn` what it is sent next, [`frame`] the bytes of what is drawn, [`limits`] what a browser may cost.
//! [`access`] says who may come in, [`assets`] is the page, [`image`] what lies below the map. `shell` is everything else: sockets, the bus and the clock.
//!
//! What holds at all times:
//! - A browser that reads nothing costs at most [`limits::MAX_WAITING_BYTES`], and no one else any time.
//! - A browser is never sent anything but the newest state.
//! - Who is no operator commands nothing, whatever the code in the browser is.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

pub mod access;
pub mod assets;
mod core;
pub mod image;
#[cfg(feature = "binary")]
pub mod shell;
#[cfg(test)]
mod testkit;

pub use crate::core::{
    BrowserId, Command, Console, Fetch, Input, Output, Problem, ProblemKind, ProposalOrder,
    ProposalStep, Question, Role, Stale, Ticket, frame, limits, proposal,
};
