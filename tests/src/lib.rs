//! Two ways to look at Muster from outside.
//!
//! Whole processes: [`client`] uses plain Zenoh and JSON, as a robot or dashboard in another language
//! would, without Muster's own code between a test and the bus; [`process`] starts, kills and
//! stops programs; [`cluster`] is a router with the four services, each of which can be killed alone;
//! [`hosts`] puts them on three hosts and breaks the links between; [`manager`] is what they report
//! to a service manager; [`process_stats`] is what they take; [`neighbours`] keep the processors busy;
//! [`ports`] are those that nothing else takes; [`latency`] measures the way from a pose to a team, [`joining`] how long a fleet takes to join,
//! [`ros_load`] plays fleets of ROS 2, and [`many_fleets`] a host full of fleets.
//!
//! And the [`simulation`]: the cores of all services in one thread, on a virtual bus, with seeded
//! faults.

pub mod access;
pub mod client;
pub mod cluster;
pub mod hosts;
pub mod joining;
pub mod latency;
pub mod manager;
pub mod many_fleets;
pub mod neighbours;
pub mod ports;
pub mod process;
pub mod process_stats;
pub mod relay;
pub mod ros_load;
pub mod simulation;
pub mod soak;

/// Within which everything happens that a test waits for without judging how long it takes. It is long: other work may keep the
/// processors busy, and a test that waits in vain fails anyway.
pub const SOON: std::time::Duration = std::time::Duration::from_secs(60);

/// How many times as long as on an idle machine a test waits for what is promised there: programs are built without
/// optimisation, and another test runs on the same two processors. What is measured without other work stands in `peers`.
pub const BUSY: u64 = 2;
