//! For robots and consoles: a small async API over the keys of a fleet.
//!
//! # A robot
//!
//! ```no_run
//! use muster_client::{Config, Error, Pose, Robot};
//!
//! #[tokio::main]
//! async fn main() -> Result<(), Error> {
//!     let robot = Robot::join(&Config::from_env(), "r1").await?;
//!     robot.put_rank(Some("r0"))?;
//!     robot.put_links([("r2", 0.93)])?;
//!     let mut team = robot.team();
//!     let mut ticks = tokio::time::interval(std::time::Duration::from_millis(100));
//!     loop {
//!         tokio::select! {
//!             _ = ticks.tick() => robot.put_pose(Pose::at(1.0, 2.0))?,
//!             latest = team.changed() => println!("{:?}", latest?),
//!         }
//!     }
//! }
//! ```
//!
//! Boot id, sequence numbers and stamps are set. Every report is checked first: an [`Error::Input`]
//! names the field. Putting never waits: of each stream, the newest message waits to be sent. Links,
//! rank and relations are valid until the next report, and are republished by themselves. The team is
//! the newest message, with whether it is still valid. Dropping the robot takes it out of the fleet;
//! [`Robot::leave`] does so after it has sent what is queued. `examples/robot.rs` is a whole program.
//!
//! What services refuse of it, such as a pose in an unknown frame, [`Robot::refusals`] delivers with the
//! reason; each is logged as a warning as well.
//!
//! # What happens when something is lost
//!
//! | lost | the robot sees |
//! | --- | --- |
//! | the link to the router | its last team, stale at once ([`Staleness::LinkLost`]) |
//! | the services, or their links | its last team, stale after [`Config::stale_after`] ([`Staleness::Silent`]) |
//! | the services with their state | its last team, stale ([`Staleness::Restarted`]), then the new one |
//! | nothing any more | a fresh team as soon as a newer message arrives; the client sends gets by itself |
//!
//! A silent link counts as lost after 2 s. The session connects again by itself. A message that is
//! older than the newest one, by (term, epoch), or names another robot or fleet, changes nothing.
//! Services that start again without their state begin with lower terms. A reader follows them within
//! [`Config::stale_after`] and one `heartbeat_s` of `clusterer`, 6 s by default: nothing newer, and only
//! the new ones, must have arrived for as long. Consoles do the same.
//!
//! Two processes cannot be the same robot: the second is refused with [`Error::Taken`]. If both joined
//! while they could not see each other, [`Robot::is_contested`] is true.
//!
//! # A console
//!
//! [`Client`] is a session without a robot. It follows the division, the audit and the roster
//! ([`Client::teams`] and so on, each a [`Watch`]), delivers events, asks once ([`Client::get_statuses`],
//! [`Client::get_graphs`], [`Client::get_similarity`], [`Client::get_reason`] and others), and changes settings
//! ([`Client::change_settings`]) and wishes ([`Client::put_wish`], [`Client::withdraw_wish`],
//! [`Client::get_wishes`]). [`Client::alerts`] is the list of open alerts, and [`Client::acknowledge_alert`] says that an
//! operator has seen one. Each watch is a stream too, and [`Client::changes`] is all in one.
//! This one prints the division; like all of this crate it runs on tokio's multi-threaded runtime, and
//! refuses others:
//!
//! ```
//! use muster_client::{Client, Config, Error};
//!
//! async fn print_teams(config: &Config) -> Result<(), Error> {
//!     let mut teams = Client::open(config).await?.teams().await?;
//!     loop {
//!         let division = teams.changed().await?;
//!         for team in &division.teams {
//!             println!("{}: {} robots, led by {}", team.id, team.members.len(), team.leader);
//!         }
//!     }
//! }
//!
//! let config = Config::default();
//! let single = tokio::runtime::Builder::new_current_thread().build().unwrap();
//! assert!(matches!(single.block_on(print_teams(&config)), Err(Error::Runtime)));
//!
//! // Nothing listens on port 1: the error names the remedy.
//! let connect_timeout = Some(std::time::Duration::from_millis(100));
//! let routers = Some(vec!["tcp/127.0.0.1:1".to_owned()]);
//! let config = Config { routers, connect_timeout, ..config };
//! let multi = tokio::runtime::Runtime::new().unwrap();
//! let error = multi.block_on(print_teams(&config)).unwrap_err();
//! assert!(error.to_string().contains("muster router"), "{error}");
//! ```
//!
//! A program that has a Zenoh session already opens the client on it with [`Client::on_session`].
//!
//! # Build settings
//!
//! Zenoh's TCP and TLS links read the environment variables `TCP_LINGER_TIMEOUT` and
//! `TLS_LINGER_TIMEOUT` when they are compiled. A dependant sets both to 0 in a `.cargo/config.toml` of its
//! own; see `README.md` of this crate for how, and for what happens without them.
//!
//! # Modules
//!
//! `reporter` checks, numbers and remembers the reports of a robot, `send_queue` is the bounded queue to
//! the bus, `freshness` decides which message is the newest and when it is stale: none of them knows the
//! bus, and each is tested without one. [`Watch`] and [`Robot`] connect them to a session; `get` has what a
//! console asks for once, `bridge` what bridges say of themselves, `history` what it asks recordings, `propose` what it asks
//! about other settings.

mod bridge;
mod changes;
mod client;
mod command;
mod config;
mod error;
mod feed;
mod freshness;
mod get;
mod history;
mod propose;
mod reporter;
mod robot;
mod send_queue;
mod watch;

pub use muster_bus::{RouterState, Session};
pub use muster_model as model;
pub use muster_model::observation::{Pose, Report};
pub use muster_model::refused::Refused;
pub use muster_wire::Format;

pub use crate::bridge::{BridgeGet, BridgeGets};
pub use crate::changes::Change;
pub use crate::client::Client;
pub use crate::config::{Config, Mode};
pub use crate::error::Error;
pub use crate::feed::{Events, Feed, ReceivedJson, ReceivedPose, Refusals};
pub use crate::freshness::{Freshness, Latest, Publication, Staleness, Via};
pub use crate::get::{FleetPresence, ServiceInstance};
pub use crate::propose::AppliedPart;
pub use crate::robot::{Robot, RobotPublisher};
pub use crate::watch::Watch;
