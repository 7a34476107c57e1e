//! The key space: every key that Muster uses, typed.
//!
//! All keys stand under `muster/v1/{fleet}/`, so that fleets share a bus without seeing each other
//! and a later version of the key space can share the bus with this one. The text of a key is canonical
//! (a test checks that against the bus itself).

use std::fmt;

use muster_model::id::{
    CommandId, FleetId, InstanceId, Modality, OperatorId, ProposalId, RobotId, ServiceName, WishId,
};
use muster_model::limits::MAX_ROBOT_PAYLOAD;
use muster_model::observation::Stream;
use serde::{Deserialize, Serialize};

use crate::envelope::{MAX_SERVICE_PAYLOAD, MAX_SMALL_PAYLOAD};
use crate::foreign::{ForeignKey, ForeignPattern};
use crate::packet::quoted;

/// What services put for a robot, below its name.
const KEYS_FOR_ROBOTS: [&str; 2] = ["team", "refused"];

/// What stands before the fleet in every key.
pub(crate) const ROOT: &str = "muster/v1";

/// One place of a fleet on the bus.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Key {
    /// `robot/{robot}`: liveliness token of a robot.
    RobotToken(RobotId),
    /// `robot/{robot}/pose`, `links`, `rank` or `relation/{modality}`: one stream of a robot.
    Stream(RobotId, Stream),
    /// `robot/{robot}/team`: the team of the robot.
    RobotTeam(RobotId),
    /// `graph/{modality}`: one relation of all robots.
    Graph(Modality),
    /// `roster`: who belongs to the fleet, and which graphs belong together.
    Roster,
    /// `embedding`: one vector per robot.
    Embedding,
    /// `teams`: the division.
    Teams,
    /// `audit`: the audit of the division.
    Audit,
    /// `event`: what happens.
    Event,
    /// `json/teams`: the division as JSON.
    JsonTeams,
    /// `json/audit`: the audit as JSON.
    JsonAudit,
    /// `json/event`: what happens, as JSON.
    JsonEvent,
    /// `schema`: a get answers with the JSON Schema of every message at the edge.
    Schema,
    /// `service/{service}/settings`: a get answers with the settings, one with a payload changes them.
    Settings(ServiceName),
    /// `service/{service}/status`: a get answers with the status of the service.
    Status(ServiceName),
    /// `service/{service}/holder`: the lease renewals of the leader among several instances.
    Lease(ServiceName),
    /// `service/{service}/{instance}`: liveliness token of a running service.
    ServiceToken(ServiceName, InstanceId),
    /// A key of another program, outside of the fleet's keys. [`KeySpace::parse`] never returns it.
    Foreign(ForeignKey),
    // Recordings hold keys and patterns by their number: new ones come last.
    /// `robot/{robot}/refused`: why messages of the robot are refused.
    RobotRefused(RobotId),
    /// `history/{instance}`: a get answers with what an instance of `historian` has recorded.
    History(InstanceId),
    /// `history/{instance}/state`: how far the recording of an instance of `historian` goes.
    HistoryState(InstanceId),
    /// `alerts`: all open alerts; a get with a payload acknowledges one.
    Alerts,
    /// `json/alerts`: all open alerts as JSON.
    JsonAlerts,
    /// `wish/{operator}/{id}`: a get answers with the wish, one with a payload puts or withdraws it.
    Wish(OperatorId, WishId),
    /// `wishes`: all wishes.
    Wishes,
    /// `json/wishes`: all wishes as JSON.
    JsonWishes,
    /// `command/{service}/{operator}/{id}`: a get with a payload commands a service, one without answers what came of it.
    Command(ServiceName, OperatorId, CommandId),
    /// `why`: a get of `why?robot=` answers with the reasons why a robot is in its team.
    Why,
    /// `propose/{operator}/{id}`: a get answers with the proposal, one with a payload asks for it or drops it.
    Proposal(OperatorId, ProposalId),
    /// `bridge/{instance}`: a get answers with what a bridge to robots of another protocol takes and refuses.
    Bridge(InstanceId),
}

/// A set of keys to subscribe to, serve or get.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Pattern {
    /// `robot/*`, of liveliness tokens.
    RobotTokens,
    /// `robot/*/{stream}`: one stream of all robots.
    Stream(Stream),
    /// `robot/*/relation/*`: the relations of all declared modalities.
    Relations,
    /// `robot/*/team`
    RobotTeams,
    /// `graph/*`
    Graphs,
    /// `service/*/*`, of liveliness tokens.
    ServiceTokens,
    /// `service/{service}/*`, of liveliness tokens.
    InstanceTokens(ServiceName),
    /// `service/*/status`
    Statuses,
    /// `**`: everything of the fleet.
    Everything,
    /// One key.
    One(Key),
    /// Keys of other programs, outside of the fleet's keys.
    Foreign(ForeignPattern),
    /// `robot/*/*`, of which only names are meant that no stream of a robot has.
    UnknownStreams,
    /// `robot/*/refused`
    RobotRefusals,
    /// `history/*`: the recordings of all instances.
    Histories,
    /// `history/*/state`: how far those go.
    HistoryStates,
    /// `wish/*/*`
    EachWish,
    /// `command/{service}/*/*`: all commands of a service.
    Commands(ServiceName),
    /// `propose/*/*`
    EachProposal,
    /// `propose/{operator}/*`
    ProposalsOf(OperatorId),
    /// `bridge/*`: all bridges.
    Bridges,
}

/// Why a text is not a key of the fleet.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum KeyError {
    /// It does not stand under the fleet.
    #[error("the key does not stand under {ROOT}/{0}/")]
    Elsewhere(FleetId),
    /// It has wild chunks: a sample must name exactly one place.
    #[error("the key is wild; put to exactly one key")]
    Wild,
    /// No stream of a robot has this name.
    #[error(
        "the stream {0:?} is unknown; a robot puts pose, links, rank and relation/{{modality}}"
    )]
    UnknownStream(String),
    /// No key has this form.
    #[error("no key of the fleet has this form")]
    Unknown,
}

/// The keys of one fleet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeySpace {
    fleet: FleetId,
    prefix: String,
}

/// Every key of every fleet, for those who look for fleets that they do not know.
pub const ANY_FLEET: &str = "muster/v1/**";

/// The name of the fleet whose key a text is, whether such a fleet may be or not.
#[must_use]
pub fn fleet_name(text: &str) -> Option<&str> {
    let (fleet, _) = text.strip_prefix(ROOT)?.strip_prefix('/')?.split_once('/')?;
    Some(fleet)
}

/// The fleet that a key belongs to, whichever that is, and the key; none if it is no key of ours.
#[must_use]
pub fn parse_any(text: &str) -> Option<(FleetId, Key)> {
    let fleet = text.strip_prefix(ROOT)?.strip_prefix('/')?.split('/').next()?;
    let space = KeySpace::new(FleetId::new(fleet).ok()?);
    let key = space.parse(text).ok()?;
    Some((space.fleet, key))
}

impl KeySpace {
    /// The keys of a fleet.
    #[must_use]
    pub fn new(fleet: FleetId) -> Self {
        let prefix = format!("{ROOT}/{fleet}/");
        Self { fleet, prefix }
    }

    /// The fleet.
    #[must_use]
    pub fn fleet(&self) -> &FleetId {
        &self.fleet
    }

    /// The text of a key on the bus.
    #[must_use]
    pub fn format(&self, key: &Key) -> String {
        match key {
            Key::Foreign(key) => key.to_string(),
            key => format!("{}{key}", self.prefix),
        }
    }

    /// What stands before the service in the keys of all commands.
    pub(crate) fn commands(&self) -> String {
        format!("{}command/", self.prefix)
    }

    /// The key expression of a set of keys.
    #[must_use]
    pub fn pattern(&self, pattern: &Pattern) -> String {
        below(&self.prefix, pattern)
    }

    /// Reads a key off the bus.
    ///
    /// # Errors
    /// [`KeyError`] if it is wild, of another fleet, or of no known form.
    pub fn parse(&self, text: &str) -> Result<Key, KeyError> {
        let Some(tail) = text.strip_prefix(&self.prefix) else {
            return Err(KeyError::Elsewhere(self.fleet.clone()));
        };
        if tail.contains(['*', '$']) {
            return Err(KeyError::Wild);
        }
        // The longest key has four chunks; a fifth means that the form is not known.
        let mut chunks = tail.splitn(5, '/');
        let chunks = [chunks.next(), chunks.next(), chunks.next(), chunks.next(), chunks.next()];
        parse_chunks(chunks).ok_or_else(|| match chunks {
            [Some("robot"), Some(robot), Some(stream), None, _] if RobotId::new(robot).is_ok() => {
                KeyError::UnknownStream(quoted(stream))
            }
            _ => KeyError::Unknown,
        })
    }

    /// The robot that the text of a key names, also where the rest is no key of the fleet.
    #[must_use]
    pub fn robot_of(&self, text: &str) -> Option<RobotId> {
        let mut chunks = text.strip_prefix(&self.prefix)?.split('/');
        let robot = (chunks.next() == Some("robot")).then(|| chunks.next()).flatten()?;
        RobotId::new(robot).ok()
    }
}

/// The key expression of a set of keys below a prefix.
pub(crate) fn below(prefix: &str, pattern: &Pattern) -> String {
    let tail = match pattern {
        Pattern::RobotTokens => "robot/*",
        Pattern::Stream(stream) => return format!("{prefix}robot/*/{stream}"),
        Pattern::UnknownStreams => "robot/*/*",
        Pattern::Relations => "robot/*/relation/*",
        Pattern::RobotTeams => "robot/*/team",
        Pattern::RobotRefusals => "robot/*/refused",
        Pattern::Histories => "history/*",
        Pattern::HistoryStates => "history/*/state",
        Pattern::Graphs => "graph/*",
        Pattern::ServiceTokens => "service/*/*",
        Pattern::InstanceTokens(service) => {
            return format!("{prefix}service/{service}/*");
        }
        Pattern::Statuses => "service/*/status",
        Pattern::EachWish => "wish/*/*",
        Pattern::EachProposal => "propose/*/*",
        Pattern::Bridges => "bridge/*",
        Pattern::ProposalsOf(operator) => {
            return format!("{prefix}propose/{operator}/*");
        }
        Pattern::Commands(service) => {
            return format!("{prefix}command/{service}/*/*");
        }
        Pattern::Everything => "**",
        Pattern::One(Key::Foreign(key)) => return key.to_string(),
        Pattern::One(key) => return format!("{prefix}{key}"),
        Pattern::Foreign(pattern) => return pattern.to_string(),
    };
    format!("{prefix}{tail}")
}

fn parse_chunks(chunks: [Option<&str>; 5]) -> Option<Key> {
    Some(match chunks {
        [Some("roster"), None, ..] => Key::Roster,
        [Some("embedding"), None, ..] => Key::Embedding,
        [Some("teams"), None, ..] => Key::Teams,
        [Some("audit"), None, ..] => Key::Audit,
        [Some("event"), None, ..] => Key::Event,
        [Some("alerts"), None, ..] => Key::Alerts,
        [Some("schema"), None, ..] => Key::Schema,
        [Some("json"), Some("teams"), None, ..] => Key::JsonTeams,
        [Some("json"), Some("audit"), None, ..] => Key::JsonAudit,
        [Some("json"), Some("event"), None, ..] => Key::JsonEvent,
        [Some("json"), Some("alerts"), None, ..] => Key::JsonAlerts,
        [Some("json"), Some("wishes"), None, ..] => Key::JsonWishes,
        [Some("wishes"), None, ..] => Key::Wishes,
        [Some("why"), None, ..] => Key::Why,
        [Some("wish"), Some(operator), Some(id), None, _] => {
            Key::Wish(operator.parse().ok()?, id.parse().ok()?)
        }
        [Some("propose"), Some(operator), Some(id), None, _] => {
            Key::Proposal(operator.parse().ok()?, id.parse().ok()?)
        }
        [Some("command"), Some(service), Some(operator), Some(id), None] => {
            Key::Command(service.parse().ok()?, operator.parse().ok()?, id.parse().ok()?)
        }
        [Some("graph"), Some(modality), None, ..] => Key::Graph(modality.parse().ok()?),
        [Some("robot"), Some(robot), None, ..] => Key::RobotToken(robot.parse().ok()?),
        [Some("robot"), Some(robot), Some(stream), None, _] => {
            let robot = robot.parse().ok()?;
            match stream {
                "team" => Key::RobotTeam(robot),
                "refused" => Key::RobotRefused(robot),
                stream => Key::Stream(robot, Stream::built_in(stream)?),
            }
        }
        [Some("robot"), Some(robot), Some("relation"), Some(modality), None] => {
            Key::Stream(robot.parse().ok()?, Stream::Relation(modality.parse().ok()?))
        }
        [Some("history"), Some(instance), None, ..] => Key::History(instance.parse().ok()?),
        [Some("history"), Some(instance), Some("state"), None, _] => {
            Key::HistoryState(instance.parse().ok()?)
        }
        [Some("bridge"), Some(instance), None, ..] => Key::Bridge(instance.parse().ok()?),
        [Some("service"), Some(service), Some(last), None, _] => {
            let service = service.parse().ok()?;
            match last {
                "settings" => Key::Settings(service),
                "status" => Key::Status(service),
                "holder" => Key::Lease(service),
                instance => Key::ServiceToken(service, instance.parse().ok()?),
            }
        }
        _ => return None,
    })
}

impl Pattern {
    /// All streams of all robots, and those that there are not.
    #[must_use]
    pub fn streams() -> [Self; 5] {
        let [first, second, third] = Stream::BUILT_IN.map(Self::Stream);
        [first, second, third, Self::Relations, Self::UnknownStreams]
    }

    /// Whether a packet is meant for a reader of the pattern: one of unknown streams reads neither the known
    /// ones, which have patterns of their own, nor what services put for a robot.
    #[must_use]
    pub fn is_meant_for_reader(&self, key: &str) -> bool {
        if *self != Self::UnknownStreams {
            return true;
        }
        let name = key.rsplit('/').next().unwrap_or_default();
        Stream::built_in(name).is_none() && !KEYS_FOR_ROBOTS.contains(&name)
    }

    /// Most bytes that may stand on any of the keys.
    #[must_use]
    pub const fn payload_limit(&self) -> usize {
        match self {
            Self::Stream(_) | Self::UnknownStreams | Self::Relations => MAX_ROBOT_PAYLOAD,
            Self::RobotTeams
            | Self::RobotRefusals
            | Self::Statuses
            | Self::HistoryStates
            | Self::EachWish
            | Self::Bridges
            | Self::Commands(_) => MAX_SMALL_PAYLOAD,
            Self::RobotTokens | Self::ServiceTokens | Self::InstanceTokens(_) => 0,
            Self::Graphs
            | Self::Everything
            | Self::Foreign(_)
            | Self::Histories
            | Self::EachProposal
            | Self::ProposalsOf(_) => MAX_SERVICE_PAYLOAD,
            Self::One(key) => key.payload_limit(),
        }
    }
}

impl Key {
    /// Most bytes that may stand on the key.
    #[must_use]
    pub const fn payload_limit(&self) -> usize {
        match self {
            Self::Stream(..) => MAX_ROBOT_PAYLOAD,
            Self::RobotTeam(_)
            | Self::RobotRefused(_)
            | Self::Event
            | Self::JsonEvent
            | Self::Settings(_)
            | Self::Status(_)
            | Self::Lease(_)
            | Self::HistoryState(_)
            | Self::Wish(..)
            | Self::Bridge(_)
            | Self::Command(..) => MAX_SMALL_PAYLOAD,
            Self::RobotToken(_) | Self::ServiceToken(..) => 0,
            _ => MAX_SERVICE_PAYLOAD,
        }
    }

    /// The robot whose key this is.
    #[must_use]
    pub fn robot(&self) -> Option<&RobotId> {
        match self {
            Self::RobotToken(robot)
            | Self::Stream(robot, _)
            | Self::RobotTeam(robot)
            | Self::RobotRefused(robot) => Some(robot),
            _ => None,
        }
    }
}

/// The text of the key below the fleet's prefix; of a foreign key, the whole text.
impl fmt::Display for Key {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::RobotToken(robot) => write!(formatter, "robot/{robot}"),
            Self::Stream(robot, stream) => write!(formatter, "robot/{robot}/{stream}"),
            Self::RobotTeam(robot) => write!(formatter, "robot/{robot}/team"),
            Self::RobotRefused(robot) => write!(formatter, "robot/{robot}/refused"),
            Self::Graph(modality) => write!(formatter, "graph/{modality}"),
            Self::Roster => formatter.write_str("roster"),
            Self::Embedding => formatter.write_str("embedding"),
            Self::Teams => formatter.write_str("teams"),
            Self::Audit => formatter.write_str("audit"),
            Self::Event => formatter.write_str("event"),
            Self::JsonTeams => formatter.write_str("json/teams"),
            Self::JsonAudit => formatter.write_str("json/audit"),
            Self::JsonEvent => formatter.write_str("json/event"),
            Self::Alerts => formatter.write_str("alerts"),
            Self::JsonAlerts => formatter.write_str("json/alerts"),
            Self::Schema => formatter.write_str("schema"),
            Self::Settings(service) => write!(formatter, "service/{service}/settings"),
            Self::Status(service) => write!(formatter, "service/{service}/status"),
            Self::Lease(service) => write!(formatter, "service/{service}/holder"),
            Self::ServiceToken(service, instance) => {
                write!(formatter, "service/{service}/{instance}")
            }
            Self::History(instance) => write!(formatter, "history/{instance}"),
            Self::HistoryState(instance) => write!(formatter, "history/{instance}/state"),
            Self::Wish(operator, id) => write!(formatter, "wish/{operator}/{id}"),
            Self::Command(service, operator, id) => {
                write!(formatter, "command/{service}/{operator}/{id}")
            }
            Self::Proposal(operator, id) => write!(formatter, "propose/{operator}/{id}"),
            Self::Bridge(instance) => write!(formatter, "bridge/{instance}"),
            Self::Wishes => formatter.write_str("wishes"),
            Self::JsonWishes => formatter.write_str("json/wishes"),
            Self::Why => formatter.write_str("why"),
            Self::Foreign(key) => key.fmt(formatter),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn space() -> KeySpace {
        KeySpace::new(FleetId::new("alpha").unwrap())
    }

    #[test]
    fn every_key_is_read_back_from_its_text() {
        let robot = RobotId::new("r1").unwrap();
        let thermal = Modality::new("thermal").unwrap();
        let mut keys = vec![
            Key::RobotToken(robot.clone()),
            Key::Stream(robot.clone(), Stream::Relation(thermal.clone())),
            Key::RobotTeam(robot.clone()),
            Key::RobotRefused(robot),
            Key::Graph(thermal),
            Key::Roster,
            Key::Embedding,
            Key::Teams,
            Key::Audit,
            Key::Event,
            Key::JsonTeams,
            Key::JsonAudit,
            Key::JsonEvent,
            Key::Schema,
            Key::History(InstanceId::new("host-1").unwrap()),
            Key::HistoryState(InstanceId::new("host-1").unwrap()),
            Key::Alerts,
            Key::JsonAlerts,
            Key::Wish(OperatorId::new("alice").unwrap(), WishId::new("p1").unwrap()),
            Key::Wishes,
            Key::JsonWishes,
            Key::Why,
            Key::Proposal(OperatorId::new("alice").unwrap(), ProposalId::new("p1").unwrap()),
            Key::Bridge(InstanceId::new("host-1").unwrap()),
        ];
        let robot = RobotId::new("r2").unwrap();
        keys.extend(Stream::BUILT_IN.map(|stream| Key::Stream(robot.clone(), stream)));
        for service in ServiceName::ALL {
            keys.push(Key::Settings(service));
            keys.push(Key::Status(service));
            keys.push(Key::Lease(service));
            keys.push(Key::ServiceToken(service, InstanceId::new("host-1").unwrap()));
        }
        for key in keys {
            let text = space().format(&key);
            assert_eq!(space().parse(&text), Ok(key), "{text}");
        }
    }

    #[test]
    fn a_key_names_its_fleet() {
        let robot = Key::RobotToken(RobotId::new("r1").unwrap());
        let fleet = FleetId::new("beta").unwrap();
        assert_eq!(parse_any("muster/v1/beta/robot/r1"), Some((fleet, robot)));
        for other in ["muster/v1", "muster/v1/", "muster/v1/B/teams", "muster/v2/b/teams", "x"] {
            assert_eq!(parse_any(other), None, "{other}");
        }
    }

    #[test]
    fn a_stream_that_no_robot_has_is_named_with_those_that_there_are() {
        for stream in ["poze", "relation", "Pose", "@x"] {
            let text = format!("muster/v1/alpha/robot/r1/{stream}");
            let error = space().parse(&text).unwrap_err();
            assert_eq!(error, KeyError::UnknownStream(stream.to_owned()));
            let error = error.to_string();
            for name in Stream::BUILT_IN.map(|stream| stream.to_string()) {
                assert!(error.contains(&format!(" {name}")), "{error}");
            }
            assert_eq!(space().robot_of(&text), RobotId::new("r1").ok());
        }
        assert_eq!(space().robot_of("muster/v1/beta/robot/r1/pose"), None);
        assert_eq!(space().robot_of("muster/v1/alpha/graph/r1"), None);
    }

    #[test]
    fn a_reader_of_unknown_streams_is_meant_by_nothing_else() {
        for (tail, meant) in [("pose", false), ("poze", true), ("team", false), ("refused", false)]
        {
            let key = format!("muster/v1/alpha/robot/r1/{tail}");
            assert_eq!(Pattern::UnknownStreams.is_meant_for_reader(&key), meant, "{tail}");
            assert!(Pattern::Everything.is_meant_for_reader(&key));
        }
    }

    #[test]
    fn what_is_no_key_of_the_fleet_is_refused() {
        let parse = |text: &str| space().parse(text).unwrap_err();
        assert!(matches!(parse("muster/v1/beta/teams"), KeyError::Elsewhere(_)));
        assert!(matches!(parse("muster/v2/alpha/teams"), KeyError::Elsewhere(_)));
        assert_eq!(parse("muster/v1/alpha/robot/*/pose"), KeyError::Wild);
        assert_eq!(parse("muster/v1/alpha/**"), KeyError::Wild);
        for unknown in [
            "",
            "team",
            "teams/x",
            "robot",
            "robot/R1/pose",
            "robot/r1/pose/x",
            "robot//pose",
            "robot/r1/relation/a/b",
            "service/ingest",
            "service/x/settings",
            "json/embedding",
            "graph",
            "graph/a/b",
            "why/r1",
            "wish/alice",
            "wish/alice/p1/x",
            "wish/A/p1",
            "propose/alice",
            "bridge",
            "bridge/host-1/x",
            "propose/alice/p1/x",
            "robot/r1/relation/a/",
        ] {
            assert_eq!(
                parse(&format!("muster/v1/alpha/{unknown}")),
                KeyError::Unknown,
                "{unknown}"
            );
        }
    }
}
