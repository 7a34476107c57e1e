//! The bus: a Zenoh session with the keys of one fleet. No other crate of the workspace knows Zenoh.
//!
//! It stands by itself, below the shell of the services and the client of robots, so that a robot
//! takes the same session with the same defaults and none of what only a program of ours needs.
//! [`config`] says which bus; [`Bus`] is the session; `zenoh_config` puts Zenoh's own configuration
//! together; [`handshake`] looks what answers where no session opens.

mod bus;
pub mod config;
pub mod handshake;
mod zenoh_config;

pub use bus::{
    Answer, Ask, Asked, Bus, OpenError, Patience, Query, Served, Subscription, Token, Urgency,
};
pub use config::{BusConfig, Mode};
/// A session of Zenoh, for callers that have one of their own.
pub use zenoh::Session;
pub use zenoh_config::{QUIET_LOG, check_endpoint, check_zenoh_config, routers};
