//! Which bus a process takes part in, and how.

use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use muster_model::id::FleetId;

/// Where the router of this host listens, by the custom of Zenoh.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// The fleet of a process that names none.
pub const DEFAULT_FLEET: &str = "default";

/// How long a silent link counts as alive. Zenoh's own default of 10 s would leave a lost service unnoticed for as long.
pub const LEASE: Duration = Duration::from_secs(2);

/// The same for a robot that has a session of its own. Where many join at once, or come back to a router that was restarted, a
/// router works off their declarations for seconds. What waits in the meantime counts as silence (`rx_task` of Zenoh 1.10.2),
/// and each robot that it lets go of declares everything again. Nothing waits for a lost robot: that it is stale follows from
/// its poses.
pub const ROBOT_LEASE: Duration = Duration::from_secs(6);

/// How a process takes part in the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Through a router: what robots and services are.
    Client,
    /// With direct links to other peers. Peers do not relay for each other.
    Peer,
    /// Relays for all others.
    Router,
}

impl fmt::Display for Mode {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Client => "client",
            Self::Peer => "peer",
            Self::Router => "router",
        })
    }
}

/// A value, and whether it was chosen. A choice overrides Zenoh's own configuration file, a
/// default does not.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Choice<T> {
    /// The value.
    pub value: T,
    /// Whether it was chosen.
    pub chosen: bool,
}

impl<T> Choice<T> {
    /// A value that was chosen.
    pub const fn chosen(value: T) -> Self {
        Self { value, chosen: true }
    }

    /// A value that was not chosen.
    pub const fn default(value: T) -> Self {
        Self { value, chosen: false }
    }
}

/// Which bus a process takes part in, and how.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BusConfig {
    /// The fleet whose keys the session has.
    pub fleet: FleetId,
    /// How to take part.
    pub mode: Choice<Mode>,
    /// Routers to connect to.
    pub connect: Choice<Vec<String>>,
    /// Where to listen.
    pub listen: Choice<Vec<String>>,
    /// A file with Zenoh's own configuration, for everything else.
    pub zenoh_config: Option<PathBuf>,
    /// Whether a router announces its peers to each other, so that they link directly: those of ROS 2 rely on it.
    pub gossip: bool,
    /// How long others wait for this process, if it is silent, before they close its link: [`LEASE`], or longer.
    pub lease: Duration,
}
