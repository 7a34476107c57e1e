//! Messages of which each one counts, in order: events of a fleet, poses of robots.

use std::sync::Arc;

use futures_util::{Stream, StreamExt as _, stream};
use muster_bus::{Bus, Subscription};
use muster_model::event::Event;
use muster_model::id::RobotId;
use muster_model::observation::{Pose, Report, Stream as RobotStream};
use muster_model::refused::Refused;
use muster_model::time::Tick;
use muster_wire::{Format, Key, KeySpace, Message, Packet, Pattern, Rejection};
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{broadcast, watch};

use crate::error::Error;
use crate::reporter::wall_clock;

/// Most messages that wait for a slow reader. When a whole fleet joins at once, the last of them are
/// delivered, and how many were missed.
const MAX_WAITING_MESSAGES: usize = 1024;

/// The same for a reader of everything: a second of a fleet of 2,000 robots at 10 Hz with their teams.
const MAX_WAITING_RECORDS: usize = 32 * 1024;

/// Messages from the moment of subscribing on.
#[derive(Debug)]
pub struct Feed<T> {
    receiver: broadcast::Receiver<T>,
    link: watch::Receiver<bool>,
    missed: u64,
    _subscriptions: Arc<Vec<Subscription>>,
}

/// The events of a fleet, from the moment of subscribing on.
pub type Events = Feed<Event>;

/// Why messages of a robot are refused, from the moment of subscribing on. Services send one at most every
/// two seconds for each key.
pub type Refusals = Feed<Refused>;

/// A message of the bus in JSON, as it arrived.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReceivedJson {
    /// Its key below that of the fleet, such as `robot/r1/pose`.
    pub key: String,
    /// The name of its JSON Schema, such as `pose`.
    pub schema: &'static str,
    /// Its text.
    pub json: Arc<[u8]>,
    /// When it arrived, by the clock of this host.
    pub received: Tick,
}

/// The pose of a robot, as it arrived.
#[derive(Debug, Clone, PartialEq)]
pub struct ReceivedPose {
    /// The robot.
    pub robot: RobotId,
    /// What it put.
    pub pose: Pose,
    /// When it arrived, by the clock of this host.
    pub received: Tick,
}

impl<T: Clone + Send + 'static> Feed<T> {
    /// Subscribes to keys. `read` takes what it wants of a message; others are dropped.
    pub(crate) async fn subscribe(
        bus: &Bus,
        keys: impl IntoIterator<Item = Key>,
        read: fn(&KeySpace, &Packet) -> Result<Option<T>, Rejection>,
    ) -> Result<Self, Error> {
        Self::of(bus, keys.into_iter().map(Pattern::One), read, MAX_WAITING_MESSAGES).await
    }

    /// Subscribes to the JSON of robots and consoles.
    pub(crate) async fn of_json(
        bus: &Bus,
        read: fn(&KeySpace, &Packet) -> Result<Option<T>, Rejection>,
    ) -> Result<Self, Error> {
        let streams = RobotStream::BUILT_IN.map(Pattern::Stream).into_iter();
        let robots = [Pattern::Relations, Pattern::RobotTeams, Pattern::RobotRefusals];
        let mirrors =
            [Key::JsonTeams, Key::JsonAudit, Key::JsonEvent, Key::JsonAlerts, Key::JsonWishes];
        let all = streams.chain(robots).chain(mirrors.map(Pattern::One));
        Self::of(bus, all, read, MAX_WAITING_RECORDS).await
    }

    /// Subscribes to the poses of all robots.
    pub(crate) async fn of_poses(
        bus: &Bus,
        read: fn(&KeySpace, &Packet) -> Result<Option<T>, Rejection>,
    ) -> Result<Self, Error> {
        Self::of(bus, [Pattern::Stream(RobotStream::Pose)], read, MAX_WAITING_RECORDS).await
    }

    async fn of(
        bus: &Bus,
        patterns: impl IntoIterator<Item = Pattern>,
        read: fn(&KeySpace, &Packet) -> Result<Option<T>, Rejection>,
        most_waiting: usize,
    ) -> Result<Self, Error> {
        let (sender, receiver) = broadcast::channel(most_waiting);
        let mut subscriptions = Vec::new();
        for pattern in patterns {
            let (sender, space) = (sender.clone(), bus.space().clone());
            let accept = move |packet| match read(&space, &packet) {
                Ok(Some(content)) => {
                    // It fails if the reader is gone; the subscription follows at once.
                    let _ = sender.send(content);
                }
                Ok(None) => {}
                Err(refused) => tracing::debug!("refused on {}: {}", refused.key, refused.reason),
            };
            subscriptions.push(bus.listen(&pattern, accept).await.map_err(Error::bus)?);
        }
        Ok(Self { receiver, link: bus.link(), missed: 0, _subscriptions: Arc::new(subscriptions) })
    }

    /// The next message. It may be cancelled at any time, as in `select!`, without losing one.
    ///
    /// # Errors
    /// [`Error::Closed`] once the client is closed.
    pub async fn next(&mut self) -> Result<T, Error> {
        loop {
            tokio::select! {
                biased;
                received = self.receiver.recv() => match received {
                    Ok(message) => return Ok(message),
                    Err(RecvError::Lagged(missed)) => self.missed += missed,
                    Err(RecvError::Closed) => return Err(Error::Closed),
                },
                // The session outlives the client where it belongs to the caller.
                changed = self.link.changed() => if changed.is_err() {
                    return Err(Error::Closed);
                },
            }
        }
    }

    /// The same messages for one more reader, from now on.
    #[must_use]
    pub fn resubscribe(&self) -> Self {
        Self {
            receiver: self.receiver.resubscribe(),
            link: self.link.clone(),
            missed: 0,
            _subscriptions: Arc::clone(&self._subscriptions),
        }
    }

    /// How many messages were dropped because too many waited: more than 1024, or 32768 of a feed of everything.
    #[must_use]
    pub const fn missed(&self) -> u64 {
        self.missed
    }

    /// The same messages as a stream, which ends when the client is closed.
    pub fn into_stream(self) -> impl Stream<Item = T> + Send + Unpin + 'static {
        let next = async |mut feed: Self| feed.next().await.ok().map(|message| (message, feed));
        stream::unfold(self, next).boxed()
    }
}

/// An event out of a packet.
pub(crate) fn event(space: &KeySpace, packet: &Packet) -> Result<Option<Event>, Rejection> {
    Ok(match Message::decode(space, packet)? {
        Message::Event(event) => Some(event),
        _ => None,
    })
}

/// A refusal out of a packet; it is logged, for a program that does not read them.
pub(crate) fn refused(space: &KeySpace, packet: &Packet) -> Result<Option<Refused>, Rejection> {
    let refused = muster_wire::refused::decode(space, packet, wall_clock())?;
    let Refused { key, reason, count, .. } = &refused;
    tracing::warn!("services refuse {key}: {reason} ({count} messages since the last warning)");
    Ok(Some(refused))
}

/// The name of the JSON Schema of what stands on a key; none if no JSON of robots and consoles does.
const fn schema(key: &Key) -> Option<&'static str> {
    Some(match key {
        Key::Stream(_, RobotStream::Pose) => "pose",
        Key::Stream(_, RobotStream::Links) => "links",
        Key::Stream(_, RobotStream::Rank) => "rank",
        Key::Stream(_, RobotStream::Relation(_)) => "relation",
        Key::RobotTeam(_) => "robot_team",
        Key::RobotRefused(_) => "refused",
        Key::JsonTeams => "teams",
        Key::JsonAudit => "audit",
        Key::JsonEvent => "event",
        Key::JsonAlerts => "alerts",
        Key::JsonWishes => "wishes",
        _ => return None,
    })
}

/// A message in JSON out of a packet. What a robot puts in binary form is written in JSON; what is neither is left out.
pub(crate) fn json(space: &KeySpace, packet: &Packet) -> Result<Option<ReceivedJson>, Rejection> {
    let received = wall_clock();
    let Ok(key) = space.parse(&packet.key) else { return Ok(None) };
    let (Some(schema), Ok(payload)) = (schema(&key), &packet.payload) else { return Ok(None) };
    let json: Arc<[u8]> = if serde_json::from_slice::<serde_json::Value>(payload).is_ok() {
        payload.as_slice().into()
    } else {
        let message = Message::decode(space, packet)?;
        let encoded = message.encode(key, Format::Json, received);
        let encoded =
            encoded.map_err(|error| Rejection::new(space, &packet.key, error.to_string()))?;
        encoded.payload.into()
    };
    let key = packet.key.splitn(4, '/').nth(3).unwrap_or_default().to_owned();
    Ok(Some(ReceivedJson { key, schema, json, received }))
}

/// A pose out of a packet.
pub(crate) fn pose(space: &KeySpace, packet: &Packet) -> Result<Option<ReceivedPose>, Rejection> {
    Ok(match Message::decode(space, packet)? {
        Message::Report(report) => match report.into_parts() {
            (robot, Report::Pose(pose)) => {
                Some(ReceivedPose { robot, pose, received: wall_clock() })
            }
            _ => None,
        },
        _ => None,
    })
}
