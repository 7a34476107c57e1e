//! The bus: a Zenoh session with the keys of one fleet. No other crate of the workspace knows Zenoh.
//!
//! It is a crate of its own, below the shell of the services and the client of robots, so that a robot
//! has the same session with the same defaults, and nothing that only Muster's programs need.
//! [`config`] chooses the bus; [`Bus`] is the session; `zenoh_config` puts Zenoh's own configuration
//! together; [`send_queue`] sends without waiting, [`Turns`] for many queues by one thread; [`DeclaredKeys`] declares the keys of robots that are put to;
//! `shared` is one bus for the services of many fleets; `foreign` has what is particular to keys of other programs; [`handshake`] looks what answers where no session opens.

mod bus;
pub mod config;
mod declared_keys;
mod error;
mod foreign;
mod get;
pub mod handshake;
mod opening;
mod packet;
pub mod send_queue;
mod serve;
mod shared;
mod turns;
mod zenoh_config;

pub use bus::{Bus, ConnectTimeout, Subscription, Token, Urgency};
pub use config::{BusConfig, Mode};
pub use declared_keys::{DeclaredKeys, RobotTokens};
pub use error::{EndpointError, OpenError};
pub use foreign::RouterState;
pub use get::{Answer, Ask, Target};
pub use serve::{IncomingQuery, Query, Served};
pub use shared::{MAX_SCOPES, SharedBus};
pub use turns::Turns;
/// A session of Zenoh, for callers that have one of their own.
pub use zenoh::Session;
pub use zenoh_config::{QUIET_LOG, check_endpoint, check_zenoh_config, identity, routers};
