//! A session of robots or of a console.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use muster_bus::config::LEASE;
use muster_bus::{Bus, BusConfig, DeclaredKeys, Session};
use muster_model::alert::Alerts;
use muster_model::audit::Audit;
use muster_model::id::RobotId;
use muster_model::observation::Stream;
use muster_model::roster::Roster;
use muster_model::teams::{RobotTeam, Teams};
use muster_wire::{Key, KeySpace, Message, Packet, Rejection};
use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::sync::watch;

use crate::config::Config;
use crate::error::Error;
use crate::feed::{self, Events, Feed, ReceivedJson, ReceivedPose, Refusals};
use crate::freshness::Publication;
use crate::send_queue::SendQueue;
use crate::watch::Watch;

/// How long a robot that leaves, or a client that closes, waits until its last messages are sent.
const FLUSH_TIMEOUT: Duration = Duration::from_millis(500);

/// A session on the bus, for one robot, for many in one process, or for a console. Clones share it.
///
/// It connects again by itself whenever its router is lost. It ends with its last clone, or when it
/// is closed.
#[derive(Debug, Clone)]
pub struct Client(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    bus: Bus,
    config: Config,
    queue: SendQueue,
    joined: Mutex<BTreeSet<RobotId>>,
}

impl Drop for Inner {
    fn drop(&mut self) {
        // The sending thread owns a clone of the session; it ends, and drops it.
        self.queue.abandon();
    }
}

/// Refuses runtimes on which Zenoh would panic.
fn check_runtime() -> Result<(), Error> {
    let flavor = Handle::try_current().map(|handle| handle.runtime_flavor());
    if matches!(flavor, Ok(RuntimeFlavor::MultiThread)) { Ok(()) } else { Err(Error::Runtime) }
}

impl Client {
    /// Opens a session, and waits for a router for [`Config::connect_timeout`].
    ///
    /// # Errors
    /// [`Error::Input`] for a wrong configuration, [`Error::Runtime`] outside of a multi-threaded
    /// tokio runtime, [`Error::Unreachable`] if no router answers in time.
    pub async fn open(config: &Config) -> Result<Self, Error> {
        Self::open_with(config, LEASE).await
    }

    /// The same with another lease.
    pub(crate) async fn open_with(config: &Config, lease: Duration) -> Result<Self, Error> {
        check_runtime()?;
        let bus = BusConfig { lease, ..config.bus()? };
        // Zenoh's own configuration may name other routers.
        let routers = muster_bus::routers(&bus).unwrap_or_else(|_| bus.connect.value.clone());
        let bus = Bus::open(bus, config.connect_timeout()).await;
        Self::on_bus(bus.map_err(|error| Error::open(error, &routers))?, config)
    }

    /// A client on a Zenoh session of the caller's, which stays open when the client is closed. Of the
    /// configuration it uses [`Config::fleet`], [`Config::stale_after`], [`Config::republish_every`] and
    /// [`Config::format`]; how the session reaches its routers is the caller's choice.
    ///
    /// # Errors
    /// [`Error::Input`] for a wrong configuration, [`Error::Runtime`] outside of a multi-threaded
    /// tokio runtime, [`Error::Bus`] if the session is closed.
    pub async fn on_session(session: Session, config: &Config) -> Result<Self, Error> {
        check_runtime()?;
        let bus = Bus::on_session(session, config.fleet()?).await.map_err(Error::bus)?;
        Self::on_bus(bus, config)
    }

    fn on_bus(bus: Bus, config: &Config) -> Result<Self, Error> {
        let queue = SendQueue::default();
        let mut sending = DeclaredKeys::new(bus.clone());
        let started = queue.start("muster-client", move |message| {
            if let Err(error) = sending.put(message) {
                tracing::debug!("{error:#}");
            }
        });
        started.map_err(Error::bus)?;
        let (config, joined) = (config.clone(), Mutex::default());
        Ok(Self(Arc::new(Inner { bus, config, queue, joined })))
    }

    /// Follows the division of the fleet.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn teams(&self) -> Result<Watch<Teams>, Error> {
        self.follow(Key::Teams, |space, packet| match Message::decode(space, packet)? {
            Message::Teams { teams, .. } => Ok(Arc::unwrap_or_clone(teams.into_arc())),
            _ => Err(Rejection::new(space, &packet.key, "this is no division")),
        })
        .await
    }

    /// Follows the silhouettes of the division.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn audits(&self) -> Result<Watch<Audit>, Error> {
        self.follow(Key::Audit, |space, packet| match Message::decode(space, packet)? {
            Message::Audit(audit) => Ok(Arc::unwrap_or_clone(audit)),
            _ => Err(Rejection::new(space, &packet.key, "this is no audit")),
        })
        .await
    }

    /// Follows the list of open alerts.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn alerts(&self) -> Result<Watch<Alerts>, Error> {
        self.follow(Key::Alerts, |space, packet| match Message::decode(space, packet)? {
            Message::Alerts(alerts) => Ok(Arc::unwrap_or_clone(alerts)),
            _ => Err(Rejection::new(space, &packet.key, "this is no list of alerts")),
        })
        .await
    }

    /// Follows the roster. In a fleet that moves it changes with every frame of `ingest`.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn rosters(&self) -> Result<Watch<Roster>, Error> {
        self.follow(Key::Roster, |space, packet| match Message::decode(space, packet)? {
            Message::Roster(roster) => Ok(Arc::unwrap_or_clone(roster.into_arc())),
            _ => Err(Rejection::new(space, &packet.key, "this is no roster")),
        })
        .await
    }

    /// Subscribes to the events of the fleet, from now on.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn events(&self) -> Result<Events, Error> {
        Feed::subscribe(self.bus(), [Key::Event], feed::event).await
    }

    /// Subscribes to the poses of some robots, from now on.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn poses(
        &self,
        robots: impl IntoIterator<Item = RobotId>,
    ) -> Result<Feed<ReceivedPose>, Error> {
        let keys = robots.into_iter().map(|robot| Key::Stream(robot, Stream::Pose));
        Feed::subscribe(self.bus(), keys, feed::pose).await
    }

    /// Subscribes to the poses of all robots, whether they have joined or not, from now on.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn all_poses(&self) -> Result<Feed<ReceivedPose>, Error> {
        Feed::of_poses(self.bus(), feed::pose).await
    }

    /// Subscribes to everything of robots and consoles that has a form in JSON, from now on: the streams of robots, their
    /// teams and refusals, and all keys below `json/`. For recordings.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn json_messages(&self) -> Result<Feed<ReceivedJson>, Error> {
        Feed::of_json(self.bus(), feed::json).await
    }

    /// Subscribes to why messages of a robot are refused, from now on.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn refusals(&self, robot: &RobotId) -> Result<Refusals, Error> {
        Feed::subscribe(self.bus(), [Key::RobotRefused(robot.clone())], feed::refused).await
    }

    /// Whether a router is linked, and every change of it.
    #[must_use]
    pub fn link(&self) -> watch::Receiver<bool> {
        self.0.bus.link()
    }

    /// How many messages were replaced by newer ones of the same stream before they were sent, because
    /// the link was busy.
    #[must_use]
    pub fn superseded(&self) -> u64 {
        self.0.queue.counts().dropped
    }

    /// Sends what is queued, and closes the session for all clones. Their robots vanish from the fleet.
    /// A session that belongs to the caller stays open, and robots stay until they leave or are dropped.
    pub async fn close(self) {
        self.flush().await;
        self.0.queue.abandon();
        self.0.bus.close().await;
    }

    async fn follow<T: Publication>(
        &self,
        key: Key,
        decode: fn(&KeySpace, &Packet) -> Result<T, Rejection>,
    ) -> Result<Watch<T>, Error> {
        Watch::follow(&self.0.bus, key, self.0.config.stale_after, decode).await
    }

    pub(crate) async fn team(&self, robot: &RobotId) -> Result<Watch<RobotTeam>, Error> {
        self.follow(Key::RobotTeam(robot.clone()), |space, packet| {
            muster_wire::robot_team::decode(space, packet, crate::reporter::wall_clock())
        })
        .await
    }

    pub(crate) async fn flush(&self) {
        let queue = self.0.queue.clone();
        // It fails only as the runtime ends; then nothing is left to wait for.
        let _ = tokio::task::spawn_blocking(move || queue.flush(FLUSH_TIMEOUT)).await;
    }

    pub(crate) fn bus(&self) -> &Bus {
        &self.0.bus
    }

    pub(crate) fn config(&self) -> &Config {
        &self.0.config
    }

    pub(crate) fn queue(&self) -> &SendQueue {
        &self.0.queue
    }

    /// The robots that joined through this session.
    pub(crate) fn joined(&self) -> MutexGuard<'_, BTreeSet<RobotId>> {
        self.0.joined.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
