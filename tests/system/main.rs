//! Whole processes over a real bus: what a fleet, an operator and an attacker see.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod alerts;
mod busy;
mod cli;
mod client;
mod commands;
mod conformance;
mod console;
mod dashboards;
mod demo;
mod deploy;
mod doctor;
mod documents;
mod fleets;
mod foxglove;
mod history;
mod hostile;
mod joining;
mod json_forms;
mod keys;
mod languages;
mod latency;
mod limits;
mod lost_team;
mod needs;
mod notify;
mod observe;
mod partition;
mod pipeline;
mod power_cut;
mod presence;
mod propose;
mod record;
mod recordings;
mod restarts;
mod ros2;
mod routers;
mod schema;
mod secured;
mod settings;
mod soak;
mod standby;
mod terms;
mod wishes;
