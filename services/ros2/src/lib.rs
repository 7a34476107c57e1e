#![doc = include_str!("../README.md")]
//!
//! # This crate
//!
//! [`core::Bridge`] is the core: samples of ROS, messages of the fleet and time are its [`core::Input`]s, reports,
//! messages of ROS and refusals its [`core::Output`]s. [`config`] is the file, checked; [`template`] topics with `{robot}`
//! in them. `shell` is everything else: both buses and the clock.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

pub mod config;
pub mod core;
#[cfg(feature = "binary")]
pub mod shell;
pub mod template;
