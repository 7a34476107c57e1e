//! Messages: a key, a content, and the forms that the content has.

use std::borrow::Cow;
use std::sync::Arc;

use muster_model::audit::Audit;
use muster_model::embedding::Embedding;
use muster_model::event::Event;
use muster_model::graph::GraphDelta;
use muster_model::id::{InstanceId, Modality, RobotId, ServiceName};
use muster_model::katz::PairSimilarity;
use muster_model::limits::MAX_REVISION;
use muster_model::object::Object;
use muster_model::observation::{Links, Observation, Pose, Rank, Relation};
use muster_model::role::Claim;
use muster_model::roster::Roster;
use muster_model::status::ServiceStatus;
use muster_model::teams::{RobotTeam, Teams};
use muster_model::time::Tick;
use serde::de::DeserializeOwned;

use crate::envelope::{self, AnnouncedSettings, BinaryMessage, EnvelopeError, FromRobot};
use crate::json::EdgeJson;
use crate::key::{Key, KeySpace};
use crate::packet::{BINARY, Outbound, Packet, Rejection, Source, format_of};
use crate::request::{Format, Request};

pub use crate::packet::{JSON, quoted};

/// What stands, or is to stand, on the bus.
#[derive(Debug, Clone, PartialEq)]
pub enum Message {
    /// A robot's liveliness token appeared or was lost.
    RobotToken {
        /// The robot.
        robot: RobotId,
        /// Whether the token is there.
        alive: bool,
    },
    /// An instance's liveliness token appeared or was lost.
    ServiceToken {
        /// The service.
        service: ServiceName,
        /// The instance.
        instance: InstanceId,
        /// Whether the token is there.
        alive: bool,
    },
    /// Where a robot is.
    Pose(RobotId, Pose),
    /// Whom a robot hears.
    Links(RobotId, Links),
    /// Whom a robot answers to.
    Rank(RobotId, Rank),
    /// Edges of a declared modality.
    Relation(RobotId, Modality, Relation),
    /// What a robot is told of its team.
    RobotTeam(RobotTeam),
    /// A change of one graph, or a snapshot of it.
    Graph(Arc<GraphDelta>),
    /// Who belongs to the fleet.
    Roster(Arc<Roster>),
    /// One vector per robot.
    Embedding(Arc<Embedding>),
    /// The similarity of two robots: what a get of `embedding?katz=` is answered with.
    Katz(Box<PairSimilarity>),
    /// The division. `mirror` says whether `json/teams` is told as well.
    Teams {
        /// The division.
        teams: Arc<Teams>,
        /// Whether the JSON mirror is put beside the binary message.
        mirror: bool,
    },
    /// The judgement of the division.
    Audit(Arc<Audit>),
    /// Something that happened.
    Event(Event),
    /// Who holds the role of a service.
    Claim(Box<Claim>),
    /// The settings of a service.
    Settings(Box<AnnouncedSettings>),
    /// What a service tells of itself.
    Status(Box<ServiceStatus>),
}

fn from_json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, String> {
    serde_json::from_slice::<Object<T>>(bytes)
        .map(|object| object.0)
        .map_err(|error| format!("this is not the JSON it should be: {error}"))
}

fn from_robot<T>(robot: &RobotId, format: Format, bytes: &[u8]) -> Result<T, String>
where
    T: DeserializeOwned + Observation,
    FromRobot<T>: BinaryMessage,
{
    let body: T = match format {
        Format::Json => from_json(bytes)?,
        Format::Binary => {
            let FromRobot { robot: inside, body } =
                envelope::decode(bytes).map_err(|error| error.to_string())?;
            if inside != *robot {
                return Err(format!("the key speaks for {robot}, the message for {inside}"));
            }
            body
        }
    };
    body.check().map_err(|error| error.to_string())?;
    Ok(body)
}

fn binary<T: BinaryMessage>(format: Format, bytes: &[u8]) -> Result<T, String> {
    match format {
        Format::Binary => envelope::decode(bytes).map_err(|error| error.to_string()),
        Format::Json => Err(format!(
            "this key takes binary messages between services, with an encoding of {BINARY}"
        )),
    }
}

impl Message {
    /// Understands a packet.
    ///
    /// # Errors
    /// A [`Rejection`] if the key is unknown or wild, the encoding or content is not what the key
    /// demands, or the content speaks for another fleet or robot than the key.
    pub fn decode(space: &KeySpace, packet: &Packet) -> Result<Self, Rejection> {
        Self::understand(space, packet).map_err(|reason| Rejection::new(space, &packet.key, reason))
    }

    fn understand(space: &KeySpace, packet: &Packet) -> Result<Self, String> {
        let key = space.parse(&packet.key).map_err(|error| error.to_string())?;
        let alive = match packet.source {
            Source::TokenAlive => Some(true),
            Source::TokenGone => Some(false),
            Source::Put => None,
            Source::Delete => return Err("nothing is deleted on this key".to_owned()),
        };
        if let Some(alive) = alive {
            return match key {
                Key::RobotToken(robot) => Ok(Self::RobotToken { robot, alive }),
                Key::ServiceToken(service, instance) => {
                    Ok(Self::ServiceToken { service, instance, alive })
                }
                _ => Err("no liveliness token belongs on this key".to_owned()),
            };
        }
        let bytes = match &packet.payload {
            Ok(bytes) if bytes.len() <= key.payload_limit() => bytes.as_slice(),
            Ok(bytes) => return Err(too_large(bytes.len(), key.payload_limit())),
            Err(size) => return Err(too_large(*size, key.payload_limit())),
        };
        let format = format_of(&packet.encoding).ok_or_else(|| {
            format!(
                "the encoding {:?} is unknown; use {JSON} or {BINARY}",
                quoted(&packet.encoding)
            )
        })?;
        let message = match key {
            Key::Pose(robot) => {
                let pose = from_robot(&robot, format, bytes)?;
                Self::Pose(robot, pose)
            }
            Key::Links(robot) => {
                let links = from_robot(&robot, format, bytes)?;
                Self::Links(robot, links)
            }
            Key::Rank(robot) => {
                let rank = from_robot(&robot, format, bytes)?;
                Self::Rank(robot, rank)
            }
            Key::Relation(robot, modality) => {
                let relation: Relation = from_robot(&robot, format, bytes)?;
                if let Some((from, ..)) = relation.edges.iter().find(|(from, ..)| *from != robot) {
                    return Err(format!("edges: the key speaks for {robot}, an edge for {from}"));
                }
                Self::Relation(robot, modality, relation)
            }
            Key::Graph(modality) => {
                let delta: GraphDelta = binary(format, bytes)?;
                if delta.modality != modality {
                    return Err("the key and the content name different modalities".to_owned());
                }
                Self::Graph(Arc::new(delta))
            }
            Key::Roster => {
                let roster: Roster = binary(format, bytes)?;
                roster.check()?;
                Self::Roster(Arc::new(roster))
            }
            Key::Embedding => {
                let embedding: Embedding = binary(format, bytes)?;
                embedding.check()?;
                Self::Embedding(Arc::new(embedding))
            }
            Key::Teams => {
                let teams: Teams = binary(format, bytes)?;
                teams.check()?;
                Self::Teams { teams: Arc::new(teams), mirror: false }
            }
            Key::RobotTeam(robot) => {
                let told: RobotTeam = binary(format, bytes)?;
                if told.robot != robot {
                    return Err("the key and the content name different robots".to_owned());
                }
                Self::RobotTeam(told)
            }
            Key::Audit => Self::Audit(Arc::new(binary(format, bytes)?)),
            Key::Event => Self::Event(binary(format, bytes)?),
            Key::Settings(service) => {
                let announced: AnnouncedSettings = binary(format, bytes)?;
                if announced.service != service {
                    return Err("the key and the content name different services".to_owned());
                }
                Self::Settings(Box::new(announced))
            }
            Key::Holder(service) => {
                let claim: Claim = binary(format, bytes)?;
                if claim.service != service {
                    return Err("the key and the content name different services".to_owned());
                }
                Self::Claim(Box::new(claim))
            }
            Key::RobotToken(_) | Key::ServiceToken(..) => {
                return Err("this key takes liveliness tokens and no messages".to_owned());
            }
            Key::JsonTeams
            | Key::JsonAudit
            | Key::JsonEvent
            | Key::Status(_)
            | Key::Schema
            | Key::Foreign(_) => {
                return Err("no service reads this key".to_owned());
            }
        };
        let Some(header) = message.header() else { return Ok(message) };
        if header.fleet != *space.fleet() {
            let (ours, theirs) = (space.fleet(), &header.fleet);
            return Err(format!("the key speaks for fleet {ours}, the message for {theirs}"));
        }
        if header.revision.term.max(header.revision.epoch) >= MAX_REVISION {
            return Err(format!("term and epoch must be below {MAX_REVISION}"));
        }
        Ok(message)
    }

    /// The head of a message between services.
    #[must_use]
    pub fn header(&self) -> Option<&muster_model::header::Header> {
        match self {
            Self::RobotTeam(told) => Some(&told.header),
            Self::Graph(delta) => Some(&delta.header),
            Self::Roster(roster) => Some(&roster.header),
            Self::Embedding(embedding) => Some(&embedding.header),
            Self::Katz(pair) => Some(&pair.header),
            Self::Teams { teams, .. } => Some(&teams.header),
            Self::Audit(audit) => Some(&audit.header),
            Self::Event(event) => Some(&event.header),
            Self::Settings(announced) => Some(&announced.header),
            Self::Claim(claim) => Some(&claim.header),
            _ => None,
        }
    }

    /// Where the message stands, and where its JSON mirror does.
    #[must_use]
    pub fn keys(&self) -> (Key, Option<Key>) {
        match self {
            Self::RobotToken { robot, .. } => (Key::RobotToken(robot.clone()), None),
            Self::ServiceToken { service, instance, .. } => {
                (Key::ServiceToken(*service, instance.clone()), None)
            }
            Self::Pose(robot, _) => (Key::Pose(robot.clone()), None),
            Self::Links(robot, _) => (Key::Links(robot.clone()), None),
            Self::Rank(robot, _) => (Key::Rank(robot.clone()), None),
            Self::Relation(robot, modality, _) => {
                (Key::Relation(robot.clone(), modality.clone()), None)
            }
            Self::RobotTeam(told) => (Key::RobotTeam(told.robot.clone()), None),
            Self::Graph(delta) => (Key::Graph(delta.modality.clone()), None),
            Self::Roster(_) => (Key::Roster, None),
            Self::Embedding(_) | Self::Katz(_) => (Key::Embedding, None),
            Self::Teams { .. } => (Key::Teams, Some(Key::JsonTeams)),
            Self::Audit(_) => (Key::Audit, Some(Key::JsonAudit)),
            Self::Event(_) => (Key::Event, Some(Key::JsonEvent)),
            Self::Settings(announced) => (Key::Settings(announced.service), None),
            Self::Claim(claim) => (Key::Holder(claim.service), None),
            Self::Status(status) => (Key::Status(status.service), None),
        }
    }

    /// What a service puts on the bus for this message: the message, and its JSON mirror.
    ///
    /// Robots are told their team in JSON; everything between services is binary.
    ///
    /// # Errors
    /// [`EnvelopeError`] if the content is larger than its kind may be.
    pub fn publish(&self, now: Tick) -> Result<Vec<Outbound>, EnvelopeError> {
        let (key, mirror) = self.keys();
        let form = if matches!(self, Self::RobotTeam(_)) { Format::Json } else { Format::Binary };
        let mut all = vec![self.encode(key, form, now)?];
        let mirrored = !matches!(self, Self::Teams { mirror: false, .. });
        if let Some(mirror) = mirror.filter(|_| mirrored) {
            all.push(self.encode(mirror, Format::Json, now)?);
        }
        Ok(all)
    }

    /// What a get is answered with for this message: nothing if the get selects none of its keys.
    ///
    /// # Errors
    /// [`EnvelopeError`] if the content is larger than its kind may be.
    pub fn answer(
        &self,
        space: &KeySpace,
        request: &Request,
        now: Tick,
    ) -> Result<Vec<Outbound>, EnvelopeError> {
        let (key, mirror) = self.keys();
        let native = match self {
            Self::RobotTeam(_) | Self::Settings(_) | Self::Status(_) | Self::Katz(_) => {
                Format::Json
            }
            _ => Format::Binary,
        };
        let mut all = Vec::new();
        // Who asks for a pair does not want the embedding, from whomever knows it.
        let of_pair = matches!(self, Self::Katz(_));
        let wanted = key != Key::Embedding || request.katz.is_some() == of_pair;
        if wanted && request.selects(space, &key) {
            all.push(self.encode(key, request.format.unwrap_or(native), now)?);
        }
        if let Some(mirror) = mirror.filter(|mirror| request.selects(space, mirror)) {
            all.push(self.encode(mirror, Format::Json, now)?);
        }
        Ok(all)
    }

    /// Writes the message in one form for one of its keys.
    ///
    /// # Errors
    /// [`EnvelopeError`] if the content is larger than its kind may be, or has no such form.
    pub fn encode(&self, key: Key, format: Format, now: Tick) -> Result<Outbound, EnvelopeError> {
        match format {
            Format::Json => {
                let payload =
                    self.json(now).map_err(|error| EnvelopeError::Encode(error.to_string()))?;
                Ok(Outbound { key, encoding: Cow::Borrowed(JSON), payload, attachment: None })
            }
            Format::Binary => {
                let (name, payload) = self.binary()?;
                let encoding =
                    Cow::Owned(format!("{BINARY};bincode;muster.{name};{}", envelope::VERSION));
                Ok(Outbound { key, encoding, payload, attachment: None })
            }
        }
    }

    fn json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        match self {
            Self::RobotToken { .. } | Self::ServiceToken { .. } => Ok(Vec::new()),
            Self::Pose(_, body) => serde_json::to_vec(body),
            Self::Links(_, body) => serde_json::to_vec(body),
            Self::Rank(_, body) => serde_json::to_vec(body),
            Self::Relation(_, _, body) => serde_json::to_vec(body),
            Self::RobotTeam(told) => told.to_json(now),
            Self::Graph(delta) => delta.to_json(now),
            Self::Roster(roster) => roster.to_json(now),
            Self::Embedding(embedding) => embedding.to_json(now),
            Self::Katz(pair) => pair.to_json(now),
            Self::Teams { teams, .. } => teams.to_json(now),
            Self::Audit(audit) => audit.to_json(now),
            Self::Event(event) => event.to_json(now),
            Self::Settings(announced) => Ok(announced.settings.clone().into_bytes()),
            Self::Claim(claim) => serde_json::to_vec(claim),
            Self::Status(status) => serde_json::to_vec(status),
        }
    }

    fn binary(&self) -> Result<(&'static str, Vec<u8>), EnvelopeError> {
        fn named<T: BinaryMessage>(content: &T) -> Result<(&'static str, Vec<u8>), EnvelopeError> {
            Ok((T::NAME, envelope::encode(content)?))
        }
        fn said<T: Clone>(robot: &RobotId, body: &T) -> FromRobot<T> {
            FromRobot { robot: robot.clone(), body: body.clone() }
        }
        match self {
            Self::Pose(robot, body) => named(&said(robot, body)),
            Self::Links(robot, body) => named(&said(robot, body)),
            Self::Rank(robot, body) => named(&said(robot, body)),
            Self::Relation(robot, _, body) => named(&said(robot, body)),
            Self::RobotTeam(told) => named(told),
            Self::Graph(delta) => named(delta.as_ref()),
            Self::Roster(roster) => named(roster.as_ref()),
            Self::Embedding(embedding) => named(embedding.as_ref()),
            Self::Teams { teams, .. } => named(teams.as_ref()),
            Self::Audit(audit) => named(audit.as_ref()),
            Self::Event(event) => named(event),
            Self::Settings(announced) => named(announced.as_ref()),
            Self::Claim(claim) => named(claim.as_ref()),
            Self::RobotToken { .. }
            | Self::ServiceToken { .. }
            | Self::Status(_)
            | Self::Katz(_) => Err(EnvelopeError::Encode(
                "this message has no binary form; ask with format=json".to_owned(),
            )),
        }
    }
}

fn too_large(size: usize, limit: usize) -> String {
    format!("{size} bytes are more than the limit of {limit} for this key")
}
