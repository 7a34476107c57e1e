//! The shell around the pure cores: everything that touches the bus, a clock, a thread or a file.
//!
//! [`config`] reads flags, environment and file; [`bus`] is the session, from a crate of its own;
//! [`inbox`] and [`send_queue`] are the bounded ways in and out, `reply_worker` is the thread that answers
//! gets; [`shell`] runs the host of one service, [`observe`] shows it to probes and scrapers; [`store`]
//! keeps settings over a restart, [`records`] what a service records, [`recording`] what happens to it; [`service`] is the whole
//! `main` of a service binary; [`stop`] turns signals into a clean end; [`notify`] tells a service
//! manager how the process is.

pub mod clock;
pub mod config;
pub mod exit;
pub mod inbox;
pub mod instance;
pub mod logging;
pub mod notify;
pub mod observe;
pub mod recording;
pub mod records;
mod reply_worker;
pub mod send_queue;
pub mod service;
pub mod shell;
pub mod stop;
pub mod store;

pub use muster_bus as bus;
