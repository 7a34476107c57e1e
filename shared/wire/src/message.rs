//! Messages: a key, a content, and the forms that the content has.

use std::borrow::Cow;
use std::sync::Arc;

use muster_model::alert::Alerts;
use muster_model::audit::Audit;
use muster_model::command::CommandOutcome;
use muster_model::content::{Checked, Content};
use muster_model::embedding::Embedding;
use muster_model::event::Event;
use muster_model::graph::GraphDelta;
use muster_model::header::Header;
use muster_model::history::{HistoryAnswer, RecordingState};
use muster_model::id::{InstanceId, RobotId, ServiceName};
use muster_model::katz::PairSimilarity;
use muster_model::observation::CheckedReport;
use muster_model::proposal::ProposalReport;
use muster_model::refused::Refused;
use muster_model::role::LeaseRenewal;
use muster_model::roster::Roster;
use muster_model::status::ServiceStatus;
use muster_model::teams::{RobotTeam, Teams};
use muster_model::time::Tick;
use muster_model::why::Why;
use muster_model::wish::{WishList, WishReport};

use crate::decode::{DecodeError, check_header, format, payload};
use crate::envelope::{self, AnnouncedSettings, BinaryMessage, EnvelopeError};
use crate::json::EdgeJson;
use crate::key::{Key, KeySpace};
use crate::packet::{Format, Outbound, Packet, Rejection, Source, binary_encoding};
use crate::report;
use crate::request::Request;

pub use crate::packet::{JSON, MAX_REASON, plain_reason, quoted};

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
    /// What a robot reports on one of its streams.
    Report(CheckedReport),
    /// The team of a robot.
    RobotTeam(RobotTeam),
    /// Messages of a robot were refused.
    Refused(Box<Refused>),
    /// A change of one graph, or a snapshot of it.
    Graph(Arc<GraphDelta>),
    /// Who belongs to the fleet.
    Roster(Checked<Roster>),
    /// One vector per robot.
    Embedding(Checked<Embedding>),
    /// The similarity of two robots: what a get of `embedding?katz=` is answered with.
    Katz(Box<PairSimilarity>),
    /// The division.
    Teams {
        /// The division.
        teams: Checked<Teams>,
        /// Whether `json/teams` is published as well.
        mirror: bool,
    },
    /// The audit of the division.
    Audit(Arc<Audit>),
    /// Something that happened.
    Event(Event),
    /// A lease renewal of the leader of a service.
    LeaseRenewal(Box<LeaseRenewal>),
    /// The settings of a service.
    Settings(Box<AnnouncedSettings>),
    /// The status of a service.
    Status(Box<ServiceStatus>),
    /// What a history answers.
    History(Box<HistoryAnswer>),
    /// How far a recording goes.
    HistoryState(Box<RecordingState>),
    /// All open alerts.
    Alerts(Arc<Alerts>),
    /// All wishes.
    Wishes(Checked<WishList>),
    /// One wish: what a get of its key is answered with.
    Wish(Box<WishReport>),
    /// What came of a command.
    Outcome(Arc<CommandOutcome>),
    /// Why a robot is in its team: what a get of `why?robot=` is answered with.
    Why(Box<Why>),
    /// A proposal: what a get of its key is answered with.
    Proposal(Box<ProposalReport>),
}

fn binary<T: BinaryMessage>(format: Format, bytes: &[u8]) -> Result<T, DecodeError> {
    match format {
        Format::Binary => Ok(envelope::decode(bytes)?),
        Format::Json => Err(DecodeError::NotBinary),
    }
}

fn agree<T: PartialEq>(key: &T, content: &T, what: &'static str) -> Result<(), DecodeError> {
    if key == content { Ok(()) } else { Err(DecodeError::Mismatch(what)) }
}

impl Message {
    /// Reads and checks a packet.
    ///
    /// # Errors
    /// A [`Rejection`] if the key is unknown or wild, the encoding or content is not what the key
    /// demands, or the content names another fleet or robot than the key.
    pub fn decode(space: &KeySpace, packet: &Packet) -> Result<Self, Rejection> {
        Self::read(space, packet)
            .map_err(|error| Rejection::new(space, &packet.key, error.to_string()))
    }

    fn read(space: &KeySpace, packet: &Packet) -> Result<Self, DecodeError> {
        let key = space.parse(&packet.key)?;
        let alive = match packet.source {
            Source::TokenAlive => true,
            Source::TokenGone => false,
            Source::Put => return Self::read_put(space, packet, key),
            Source::Delete => return Err(DecodeError::Deleted),
        };
        match key {
            Key::RobotToken(robot) => Ok(Self::RobotToken { robot, alive }),
            Key::ServiceToken(service, instance) => {
                Ok(Self::ServiceToken { service, instance, alive })
            }
            _ => Err(DecodeError::Token),
        }
    }

    fn read_put(space: &KeySpace, packet: &Packet, key: Key) -> Result<Self, DecodeError> {
        let bytes = payload(packet, &key)?;
        let format = format(packet)?;
        if let Key::Stream(robot, stream) = key {
            return Ok(Self::Report(report::decode(robot, &stream, format, bytes)?));
        }
        let message = Self::read_service(key, format, bytes)?;
        if let Some(header) = message.header() {
            check_header(space, header)?;
        }
        if let Self::HistoryState(state) = &message {
            agree(space.fleet(), &state.fleet, "fleets")?;
        }
        Ok(message)
    }

    /// Reads a message between services.
    fn read_service(key: Key, format: Format, bytes: &[u8]) -> Result<Self, DecodeError> {
        Ok(match key {
            Key::Graph(modality) => {
                let delta: GraphDelta = binary(format, bytes)?;
                agree(&modality, &delta.modality, "modalities")?;
                Self::Graph(Arc::new(delta))
            }
            Key::Roster => Self::Roster(Checked::new(binary(format, bytes)?)?),
            Key::Embedding => Self::Embedding(Checked::new(binary(format, bytes)?)?),
            Key::Teams => {
                Self::Teams { teams: Checked::new(binary(format, bytes)?)?, mirror: false }
            }
            Key::RobotTeam(robot) => {
                let team: RobotTeam = binary(format, bytes)?;
                agree(&robot, &team.robot, "robots")?;
                team.check()?;
                Self::RobotTeam(team)
            }
            Key::Audit => {
                let audit: Audit = binary(format, bytes)?;
                audit.check()?;
                Self::Audit(Arc::new(audit))
            }
            Key::Event => Self::Event(binary(format, bytes)?),
            Key::Alerts => {
                let alerts: Alerts = binary(format, bytes)?;
                alerts.check()?;
                Self::Alerts(Arc::new(alerts))
            }
            Key::Settings(service) => {
                let announced: AnnouncedSettings = binary(format, bytes)?;
                agree(&service, &announced.service, "services")?;
                Self::Settings(Box::new(announced))
            }
            Key::Lease(service) => {
                let claim: LeaseRenewal = binary(format, bytes)?;
                agree(&service, &claim.service, "services")?;
                Self::LeaseRenewal(Box::new(claim))
            }
            Key::Wishes => Self::Wishes(Checked::new(binary(format, bytes)?)?),
            Key::Command(service, operator, id) => {
                let outcome: CommandOutcome = binary(format, bytes)?;
                agree(&service, &outcome.service, "services")?;
                agree(&operator, &outcome.operator, "operators")?;
                agree(&id, &outcome.id, "ids")?;
                outcome.check()?;
                Self::Outcome(Arc::new(outcome))
            }
            Key::HistoryState(instance) => {
                let state: RecordingState = match format {
                    Format::Json => serde_json::from_slice(bytes)?,
                    Format::Binary => return Err(DecodeError::NotJson),
                };
                agree(&instance, &state.instance, "instances")?;
                Self::HistoryState(Box::new(state))
            }
            Key::RobotToken(_) | Key::ServiceToken(..) => return Err(DecodeError::OnlyTokens),
            Key::JsonWishes
            | Key::Wish(..)
            | Key::JsonTeams
            | Key::JsonAudit
            | Key::JsonEvent
            | Key::JsonAlerts
            | Key::Status(_)
            | Key::RobotRefused(_)
            | Key::History(_)
            | Key::Schema
            | Key::Why
            | Key::Proposal(..)
            | Key::Bridge(_)
            | Key::Stream(..)
            | Key::Foreign(_) => return Err(DecodeError::NotRead),
        })
    }

    /// The head of a message between services.
    #[must_use]
    pub fn header(&self) -> Option<&Header> {
        match self {
            Self::RobotTeam(team) => Some(&team.header),
            Self::Refused(refused) => Some(&refused.header),
            Self::Graph(delta) => Some(&delta.header),
            Self::Roster(roster) => Some(&roster.header),
            Self::Embedding(embedding) => Some(&embedding.header),
            Self::Katz(pair) => Some(&pair.header),
            Self::Teams { teams, .. } => Some(&teams.header),
            Self::Audit(audit) => Some(&audit.header),
            Self::Event(event) => Some(&event.header),
            Self::Settings(announced) => Some(&announced.header),
            Self::LeaseRenewal(claim) => Some(&claim.header),
            Self::Alerts(alerts) => Some(&alerts.header),
            Self::Wishes(list) => Some(&list.header),
            Self::Wish(report) => Some(&report.header),
            Self::Outcome(outcome) => Some(&outcome.header),
            Self::Why(why) => Some(&why.header),
            Self::Proposal(report) => Some(&report.header),
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
            Self::Report(report) => (Key::Stream(report.robot().clone(), report.stream()), None),
            Self::RobotTeam(team) => (Key::RobotTeam(team.robot.clone()), None),
            Self::Refused(refused) => (Key::RobotRefused(refused.robot.clone()), None),
            Self::Graph(delta) => (Key::Graph(delta.modality.clone()), None),
            Self::Roster(_) => (Key::Roster, None),
            Self::Embedding(_) | Self::Katz(_) => (Key::Embedding, None),
            Self::Teams { .. } => (Key::Teams, Some(Key::JsonTeams)),
            Self::Audit(_) => (Key::Audit, Some(Key::JsonAudit)),
            Self::Event(_) => (Key::Event, Some(Key::JsonEvent)),
            Self::Settings(announced) => (Key::Settings(announced.service), None),
            Self::LeaseRenewal(claim) => (Key::Lease(claim.service), None),
            Self::Status(status) => (Key::Status(status.service), None),
            Self::History(answer) => (Key::History(answer.instance.clone()), None),
            Self::HistoryState(state) => (Key::HistoryState(state.instance.clone()), None),
            Self::Alerts(_) => (Key::Alerts, Some(Key::JsonAlerts)),
            Self::Wishes(_) => (Key::Wishes, Some(Key::JsonWishes)),
            Self::Wish(report) => {
                (Key::Wish(report.wish.operator.clone(), report.wish.id.clone()), None)
            }
            Self::Outcome(outcome) => {
                let (operator, id) = (outcome.operator.clone(), outcome.id.clone());
                (Key::Command(outcome.service, operator, id), None)
            }
            Self::Why(_) => (Key::Why, None),
            Self::Proposal(report) => {
                let proposal = &report.proposal;
                (Key::Proposal(proposal.operator.clone(), proposal.id.clone()), None)
            }
        }
    }

    /// What a service puts on the bus for this message: the message, and its JSON mirror.
    ///
    /// What robots and consoles read is written in JSON, everything between services in binary form.
    ///
    /// # Errors
    /// [`EnvelopeError`] if the content is larger than its kind may be.
    pub fn publish(&self, now: Tick) -> Result<Vec<Outbound>, EnvelopeError> {
        let (key, mirror) = self.keys();
        let is_json = matches!(self, Self::RobotTeam(_) | Self::Refused(_) | Self::HistoryState(_));
        let form = if is_json { Format::Json } else { Format::Binary };
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
            Self::RobotTeam(_)
            | Self::Refused(_)
            | Self::Settings(_)
            | Self::Status(_)
            | Self::History(_)
            | Self::HistoryState(_)
            | Self::Wish(_)
            | Self::Outcome(_)
            | Self::Why(_)
            | Self::Proposal(_)
            | Self::Katz(_) => Format::Json,
            _ => Format::Binary,
        };
        let mut all = Vec::new();
        // A get of a pair is not answered with the embedding, nor the other way round.
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

    /// The packet that brings the message in its binary form. One that has none, as it is larger than
    /// its kind may be, has an empty payload.
    #[must_use]
    pub fn to_packet(&self, space: &KeySpace) -> Packet {
        let (key, _) = self.keys();
        if let Self::RobotToken { alive, .. } | Self::ServiceToken { alive, .. } = self {
            return Packet::token(space.format(&key), *alive);
        }
        // Only the JSON form depends on the moment.
        match self.encode(key.clone(), Format::Binary, Tick(0)) {
            Ok(outbound) => outbound.into_packet(space),
            Err(_) => Packet::put(space.format(&key), "", []),
        }
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
                let encoding = binary_encoding(name);
                Ok(Outbound { key, encoding, payload, attachment: None })
            }
        }
    }

    fn json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        match self {
            Self::RobotToken { .. } | Self::ServiceToken { .. } => Ok(Vec::new()),
            Self::Report(report) => serde_json::to_vec(report.report()),
            Self::RobotTeam(team) => team.to_json(now),
            Self::Refused(refused) => refused.to_json(now),
            Self::Graph(delta) => delta.to_json(now),
            Self::Roster(roster) => roster.to_json(now),
            Self::Embedding(embedding) => embedding.to_json(now),
            Self::Katz(pair) => pair.to_json(now),
            Self::Teams { teams, .. } => teams.to_json(now),
            Self::Audit(audit) => audit.to_json(now),
            Self::Event(event) => event.to_json(now),
            Self::Settings(announced) => Ok(announced.settings.clone().into_bytes()),
            Self::LeaseRenewal(claim) => serde_json::to_vec(claim),
            Self::Status(status) => serde_json::to_vec(status),
            Self::History(answer) => serde_json::to_vec(answer),
            Self::HistoryState(state) => serde_json::to_vec(state),
            Self::Alerts(alerts) => alerts.to_json(now),
            Self::Wishes(list) => list.to_json(now),
            Self::Wish(report) => report.to_json(now),
            Self::Outcome(outcome) => outcome.to_json(now),
            Self::Why(why) => why.to_json(now),
            Self::Proposal(report) => report.to_json(now),
        }
    }

    fn binary(&self) -> Result<(&'static str, Vec<u8>), EnvelopeError> {
        fn named<T: BinaryMessage>(content: &T) -> Result<(&'static str, Vec<u8>), EnvelopeError> {
            Ok((T::KIND.name, envelope::encode(content)?))
        }
        match self {
            Self::Report(report) => report::encode(report.robot(), report.report()),
            Self::RobotTeam(team) => named(team),
            Self::Graph(delta) => named(delta.as_ref()),
            Self::Roster(roster) => named(roster.as_ref()),
            Self::Embedding(embedding) => named(embedding.as_ref()),
            Self::Teams { teams, .. } => named(teams.as_ref()),
            Self::Audit(audit) => named(audit.as_ref()),
            Self::Event(event) => named(event),
            Self::Settings(announced) => named(announced.as_ref()),
            Self::LeaseRenewal(claim) => named(claim.as_ref()),
            Self::Alerts(alerts) => named(alerts.as_ref()),
            Self::Wishes(list) => named(&**list),
            Self::Outcome(outcome) => named(outcome.as_ref()),
            Self::RobotToken { .. }
            | Self::ServiceToken { .. }
            | Self::Refused(_)
            | Self::Status(_)
            | Self::History(_)
            | Self::HistoryState(_)
            | Self::Wish(_)
            | Self::Why(_)
            | Self::Proposal(_)
            | Self::Katz(_) => Err(EnvelopeError::Encode(
                "this message has no binary form; ask with format=json".to_owned(),
            )),
        }
    }
}
