//! A session of robots or of a console.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use muster_bus::{Answer, Ask, Bus};
use muster_model::audit::Audit;
use muster_model::id::{RobotId, ServiceName};
use muster_model::teams::{RobotTeam, Teams};
use muster_wire::message::quoted;
use muster_wire::{Key, KeySpace, Message, Packet, Pattern, Rejection};
use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::sync::watch;

use crate::config::Config;
use crate::error::Error;
use crate::events::Events;
use crate::outgoing::Outgoing;
use crate::robot::Robot;
use crate::watch::Watch;

/// How long a console waits for the answer to a question.
const ANSWER_WITHIN: Duration = Duration::from_secs(3);

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
    outgoing: Outgoing,
    joined: Mutex<BTreeSet<RobotId>>,
}

impl Drop for Inner {
    fn drop(&mut self) {
        // The thread that sends holds the session; it ends, and lets it go.
        self.outgoing.close();
    }
}

impl Client {
    /// Opens a session, and waits for a router as long as the configuration says.
    ///
    /// # Errors
    /// [`Error::Input`] for a wrong configuration, [`Error::Runtime`] outside of a multi-threaded
    /// tokio runtime, [`Error::Unreachable`] if no router answers in time.
    pub async fn open(config: &Config) -> Result<Self, Error> {
        let flavor = Handle::try_current().map(|handle| handle.runtime_flavor());
        // Zenoh would panic.
        if !matches!(flavor, Ok(RuntimeFlavor::MultiThread)) {
            return Err(Error::Runtime);
        }
        let bus = config.bus()?;
        // Zenoh's own configuration may name others than ours does.
        let routers = muster_bus::routers(&bus).unwrap_or_else(|_| config.routers.clone());
        let bus = Bus::open(bus, config.bus_patience()).await;
        let bus = bus.map_err(|error| Error::open(error, &routers))?;
        let outgoing = Outgoing::default();
        let sending = bus.clone();
        let started = outgoing.start(move |message| {
            if let Err(error) = sending.put(message) {
                tracing::debug!("{error:#}");
            }
        });
        started.map_err(Error::bus)?;
        let (config, joined) = (config.clone(), Mutex::default());
        Ok(Self(Arc::new(Inner { bus, config, outgoing, joined })))
    }

    /// Joins the fleet as a robot. Several robots may share a session.
    ///
    /// # Errors
    /// [`Error::Input`] if the id is none, [`Error::Taken`] if another process speaks for the robot
    /// and goes on for longer than it takes to notice a dead one, [`Error::Bus`] if the bus fails.
    pub async fn join(&self, robot: &str) -> Result<Robot, Error> {
        let robot = RobotId::new(robot).map_err(Error::id("robot"))?;
        Robot::begin(self.clone(), robot, false).await
    }

    /// Follows the division of the fleet.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn teams(&self) -> Result<Watch<Teams>, Error> {
        self.follow(Key::Teams, |space, packet| match Message::decode(space, packet)? {
            Message::Teams { teams, .. } => Ok(Arc::unwrap_or_clone(teams)),
            _ => Err(Rejection::new(space, &packet.key, "this is no division")),
        })
        .await
    }

    /// Follows the judgement of the division.
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

    /// Follows what happens in the fleet from now on.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn events(&self) -> Result<Events, Error> {
        Events::follow(&self.0.bus).await
    }

    /// Reads the settings of a service, as the JSON object that `muster set SERVICE` shows.
    ///
    /// # Errors
    /// [`Error::Unanswered`] if the service does not run, [`Error::Bus`] if the bus fails or the
    /// answer is an error.
    pub async fn settings(&self, service: ServiceName) -> Result<serde_json::Value, Error> {
        let key = Key::Settings(service);
        let what = key.to_string();
        let ask = Ask {
            parameters: "format=json",
            payload: None,
            within: ANSWER_WITHIN,
            everybody: false,
        };
        let answers = self.0.bus.get(&Pattern::One(key), ask).await.map_err(Error::bus)?;
        let mut problem = Error::Unanswered { what };
        for answer in answers {
            match answer {
                Answer::Packet(Packet { payload: Ok(payload), .. }) => {
                    match serde_json::from_slice(&payload) {
                        Ok(settings) => return Ok(settings),
                        Err(error) => problem = Error::bus(error),
                    }
                }
                Answer::Packet(_) => {}
                Answer::Error(error) => problem = Error::Bus(quoted(&error)),
            }
        }
        Err(problem)
    }

    /// Whether a router is linked, and every change of it.
    #[must_use]
    pub fn link(&self) -> watch::Receiver<bool> {
        self.0.bus.link()
    }

    /// How many messages gave way to newer ones of the same stream before they were sent, because the
    /// link was busy.
    #[must_use]
    pub fn superseded(&self) -> u64 {
        self.0.outgoing.superseded()
    }

    /// Sends what waits, and closes the session for all clones. Their robots vanish from the fleet.
    pub async fn close(self) {
        self.flush().await;
        self.0.outgoing.close();
        self.0.bus.close().await;
    }

    async fn follow<T: crate::keeper::Telling>(
        &self,
        key: Key,
        decode: fn(&KeySpace, &Packet) -> Result<T, Rejection>,
    ) -> Result<Watch<T>, Error> {
        Watch::follow(&self.0.bus, key, self.0.config.stale_after, decode).await
    }

    pub(crate) async fn team(&self, robot: &RobotId) -> Result<Watch<RobotTeam>, Error> {
        self.follow(Key::RobotTeam(robot.clone()), |space, packet| {
            muster_wire::robot_team::decode(space, packet, crate::voice::wall_clock())
        })
        .await
    }

    pub(crate) async fn flush(&self) {
        let outgoing = self.0.outgoing.clone();
        // It fails only as the runtime ends; then nothing is left to wait for.
        let _ = tokio::task::spawn_blocking(move || outgoing.flush()).await;
    }

    pub(crate) fn bus(&self) -> &Bus {
        &self.0.bus
    }

    pub(crate) fn config(&self) -> &Config {
        &self.0.config
    }

    pub(crate) fn outgoing(&self) -> &Outgoing {
        &self.0.outgoing
    }

    /// The robots that speak through this session.
    pub(crate) fn joined(&self) -> MutexGuard<'_, BTreeSet<RobotId>> {
        self.0.joined.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
