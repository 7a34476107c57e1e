//! The flags that every program takes.

use std::fmt;
use std::path::PathBuf;

use serde::Deserialize;

/// How a process takes part in the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
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

/// The flags that every program takes.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(
    next_help_heading = "Process options (also as MUSTER_… in the environment and in --config)"
)]
pub struct ProcessArgs {
    /// The fleet: robots and services of other fleets on the same bus are not seen [MUSTER_FLEET]
    #[arg(long, global = true, value_name = "NAME")]
    pub fleet: Option<String>,
    /// Router to connect to, several with commas: the first that answers is used [MUSTER_CONNECT]
    #[arg(long, global = true, value_name = "ENDPOINT", value_delimiter = ',')]
    pub connect: Option<Vec<String>>,
    /// Where to listen, several with commas [MUSTER_LISTEN]
    #[arg(long, global = true, value_name = "ENDPOINT", value_delimiter = ',')]
    pub listen: Option<Vec<String>>,
    /// How to take part in the bus [MUSTER_MODE]
    #[arg(long, global = true, value_name = "MODE")]
    pub mode: Option<Mode>,
    /// Zenoh's own configuration in JSON5, for everything else [MUSTER_ZENOH_CONFIG]
    #[arg(long, global = true, value_name = "FILE")]
    pub zenoh_config: Option<PathBuf>,
    /// Configuration file in TOML [MUSTER_CONFIG]
    #[arg(long, global = true, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Where settings are kept over a restart; "none" for nowhere [STATE_DIRECTORY]
    #[arg(long, global = true, value_name = "DIRECTORY")]
    pub state_directory: Option<PathBuf>,
    /// What is logged to standard error, such as info or warn,muster=debug [MUSTER_LOG]
    #[arg(long, global = true, value_name = "FILTER")]
    pub log: Option<String>,
    /// Log JSON lines [MUSTER_LOG_JSON=true]
    #[arg(long, global = true)]
    pub log_json: bool,
    /// Where to serve /healthz, /readyz and /metrics, such as 127.0.0.1:9464; nowhere by default
    /// [MUSTER_HTTP]
    #[arg(long, global = true, value_name = "ADDRESS:PORT")]
    pub http: Option<String>,
    /// Check the configuration and end
    #[arg(long, global = true)]
    pub check_config: bool,
    /// Print the configuration with the origin of each value, and end
    #[arg(long, global = true)]
    pub print_config: bool,
}
