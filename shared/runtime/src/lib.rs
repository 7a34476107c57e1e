//! The shell around the pure cores: everything that touches the bus, a clock, a thread or a file.
//!
//! [`service`] is the whole `main` of a service binary, and [`shell`] runs the host of one service. [`config`]
//! reads flags, environment and file; [`bus`] is the session, from a crate of its own. Packets wait in
//! [`inbox`] and [`send_queue`], gets for the thread of `reply_worker`. [`store`] keeps settings over a
//! restart, [`kept`] what a core keeps, [`records`] what a service records, [`recording`] what happens to it. [`pool`] is what services of many fleets share. [`observe`] serves health
//! and metrics, [`notify`] informs a service manager, and [`stop`] turns signals into a clean end.

pub mod clock;
pub mod config;
mod declarations;
pub mod exit;
pub mod inbox;
pub mod instance;
pub mod kept;
pub mod logging;
pub mod notify;
pub mod observe;
pub mod pool;
pub mod recording;
pub mod records;
mod reply_worker;
pub mod send_queue;
pub mod service;
pub mod shell;
pub mod stop;
pub mod store;

pub use muster_bus as bus;
