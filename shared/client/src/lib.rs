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
//!             told = team.changed() => println!("{:?}", told?),
//!         }
//!     }
//! }
//! ```
//!
//! Name of the run, numbers and stamps are set. What is put is checked first: an [`Error::Input`] names
//! the field. Putting never waits and never queues: of each stream, the newest waits for its turn.
//! Links, rank and relations hold until the next report, and are said again by themselves. The team is
//! what was told last, with whether it still holds. Dropping the robot takes it out of the fleet;
//! [`Robot::leave`] does so and sends what waits first. `examples/robot.rs` is a whole program.
//!
//! # What happens when something is lost
//!
//! | lost | the robot sees |
//! | --- | --- |
//! | the link to the router | its last team, stale at once ([`Staleness::LinkLost`]) |
//! | the services, or their links | its last team, stale after [`Config::stale_after`] ([`Staleness::Silent`]) |
//! | nothing any more | fresh as soon as somebody tells it anew; it asks by itself |
//!
//! A silent link counts as lost after 2 s. The session connects again by itself. A message that is
//! older than the last one, by (term, epoch), or speaks to another robot or fleet, changes nothing. If
//! a whole fleet begins anew with lower terms, it is believed after it was the only one to speak for
//! as long as makes a team stale, and once more.
//!
//! Two processes cannot be the same robot: the second is refused with [`Error::Taken`]. If both joined
//! while they could not see each other, [`Robot::is_contested`] says so.
//!
//! # A console
//!
//! [`Client`] is a session without a robot. This one reads and prints the division; like all of this
//! crate it runs on tokio's multi-threaded runtime, and says so elsewhere:
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
//! let patience = Some(std::time::Duration::from_millis(100));
//! let config = Config { routers: vec!["tcp/127.0.0.1:1".to_owned()], patience, ..config };
//! let multi = tokio::runtime::Runtime::new().unwrap();
//! let error = multi.block_on(print_teams(&config)).unwrap_err();
//! assert!(error.to_string().contains("muster router"), "{error}");
//! ```
//!
//! # How it is made
//!
//! `voice` checks, numbers and remembers what a robot says, `outgoing` is the bounded way out,
//! `keeper` decides what is newest and when it is stale: none of them knows the bus, and each is tested
//! without one. [`Watch`] and [`Robot`] tie them to a session.

mod client;
mod config;
mod error;
mod events;
mod keeper;
mod outgoing;
mod robot;
mod voice;
mod watch;

pub use muster_model as model;
pub use muster_model::observation::{Pose, Report};
pub use muster_wire::Format;

pub use crate::client::Client;
pub use crate::config::Config;
pub use crate::error::Error;
pub use crate::events::Events;
pub use crate::keeper::{Latest, Staleness, Telling};
pub use crate::robot::Robot;
pub use crate::watch::Watch;
