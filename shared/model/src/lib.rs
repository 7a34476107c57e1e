//! The vocabulary of Muster: plain types that every other crate shares.
//!
//! The data's path reads top to bottom: robots put [`observation`]s, `ingest` turns them into a
//! [`roster`] and one [`graph`] per modality, `embedder` makes an [`embedding`], `clusterer` makes
//! [`teams`] and `auditor` an [`audit`]. Every message carries a [`header`]; [`event`]s report
//! what happens on the way, and [`settings`] are what may be changed while a service runs. `historian` keeps
//! a [`history`] of all that.
//!
//! This crate knows no bytes, no bus, no clock and no file. Its types derive serde, and none uses
//! `#[serde(default)]` or `skip_serializing_if`, because the binary codec is positional.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

pub mod alert;
pub mod audit;
pub mod bridge;
pub mod command;
pub mod content;
pub mod embedding;
pub mod event;
pub mod graph;
pub mod header;
pub mod history;
pub mod id;
pub mod katz;
pub mod limits;
pub mod object;
pub mod observation;
pub mod orders;
pub mod proposal;
pub mod refused;
pub mod remembered;
pub mod replay;
pub mod role;
pub mod roster;
mod schema;
pub mod settings;
pub mod status;
pub mod team_audit;
pub mod teams;
pub mod term;
pub mod time;
pub mod why;
pub mod wish;
