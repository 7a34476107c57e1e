//! The shell around the pure cores: everything that touches the bus, a clock, a thread or a file.
//!
//! [`config`] reads flags, environment and file; [`bus`] is the session, from a crate of its own;
//! [`inbox`] and [`outbox`] are the bounded ways in and out, `errands` the thread that answers
//! gets; [`shell`] runs one core, [`observe`] shows it to probes and scrapers; [`store`] keeps settings over a restart,
//! [`recording`] what happens to a service; [`service`] is the whole
//! `main` of a service binary; [`stop`] turns signals into a clean end; [`notify`] tells a service
//! manager how the process is.

pub mod clock;
pub mod config;
mod errands;
pub mod exit;
pub mod inbox;
pub mod instance;
pub mod logging;
pub mod notify;
pub mod observe;
pub mod outbox;
pub mod recording;
pub mod service;
pub mod shell;
pub mod stop;
pub mod store;

pub use muster_bus as bus;
