//! Starts the real programs as separate processes on loopback, and looks at them from outside.
//!
//! Nothing of Muster's own code is between a test and the bus: [`client`] speaks plain Zenoh and
//! JSON, as a robot or dashboard in another language would. [`process`] starts, kills and stops
//! programs; [`cluster`] is a router with the four services, each of which can be killed alone;
//! [`hosts`] puts them on three hosts and breaks the links between; [`manager`] is what a service
//! manager hears of them.

pub mod client;
pub mod cluster;
pub mod hosts;
pub mod manager;
pub mod process;
