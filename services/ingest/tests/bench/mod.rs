//! An `ingest` on the common bench, whose every output is followed as a consumer does.

use std::collections::BTreeMap;
use std::ops::{Deref, DerefMut};
use std::time::Duration;

use muster_ingest::Ingest;
use muster_model::content::Checked;
use muster_model::event::EventKind;
use muster_model::graph::GraphReplica;
use muster_model::header::{Header, Revision, StageTime};
use muster_model::id::{FleetId, InstanceId, Modality, RobotId, ServiceName};
use muster_model::observation::{Link, Links, Pose, Rank, Relation, Report};
use muster_model::refused::Refused;
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::settings::IngestSettings;
use muster_model::status::ServiceStatus;
use muster_model::time::Tick;
use muster_service::{Input, Start, Stored, testkit};
use muster_wire::report::encode_unchecked;
use muster_wire::{Key, KeySpace, Message, Packet, Rejection};
use serde_json::Value;

/// Some moment: cores know no absolute time.
pub(crate) const START: Tick = Tick(1_000_000_000_000);

pub(crate) fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

pub(crate) fn modality(name: &str) -> Modality {
    Modality::new(name).unwrap()
}

pub(crate) fn fleet() -> FleetId {
    FleetId::new("alpha").unwrap()
}

pub(crate) fn seconds(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds)
}

pub(crate) fn bare_pose(x: f64, y: f64) -> Pose {
    Pose { x, y, z: None, heading: None, frame: None, stamp: None, boot: None, seq: None }
}

/// Something that a robot puts on the bus, whether it is to be accepted or refused.
#[derive(Debug, Clone)]
pub(crate) enum Put {
    Report(RobotId, Report),
    Token(RobotId, bool),
}

impl From<Put> for Packet {
    fn from(put: Put) -> Self {
        let space = KeySpace::new(fleet());
        match put {
            Put::Report(robot, report) => {
                encode_unchecked(&robot, &report).unwrap().into_packet(&space)
            }
            Put::Token(robot, alive) => Self::token(space.format(&Key::RobotToken(robot)), alive),
        }
    }
}

pub(crate) fn report(name: &str, report: impl Into<Report>) -> Put {
    Put::Report(robot(name), report.into())
}

pub(crate) fn pose(name: &str, x: f64, y: f64) -> Put {
    report(name, bare_pose(x, y))
}

pub(crate) fn links(name: &str, peers: &[(&str, f64)]) -> Put {
    report(name, links_to(peers))
}

pub(crate) fn links_to(peers: &[(&str, f64)]) -> Links {
    let links = peers.iter().map(|(peer, quality)| Link { peer: robot(peer), quality: *quality });
    Links { links: links.collect(), stamp: None, boot: None, seq: None }
}

pub(crate) fn rank(name: &str, superior: Option<&str>, weight: Option<f64>) -> Put {
    report(name, Rank { weight, ..Rank::under(superior.map(robot)) })
}

pub(crate) fn relation(name: &str, of: &str, edges: &[(&str, f64)]) -> Put {
    let edges = edges.iter().map(|(to, weight)| (robot(name), robot(to), *weight)).collect();
    let relation = Relation { edges, stamp: None, boot: None, seq: None };
    report(name, (modality(of), relation))
}

pub(crate) fn token(name: &str, alive: bool) -> Put {
    Put::Token(robot(name), alive)
}

/// Names with spaces between them.
pub(crate) fn names(robots: &[RobotId]) -> String {
    robots.iter().map(RobotId::as_str).collect::<Vec<_>>().join(" ")
}

/// What a roster says of a robot that said nothing but that it is there.
pub(crate) fn entry_of(name: &str, presence: Presence, last_seen: Tick) -> RosterEntry {
    RosterEntry {
        node: 0,
        robot: robot(name),
        presence,
        position: None,
        heading: None,
        frame: None,
        superior: None,
        role: None,
        skills: vec![],
        last_seen,
    }
}

/// A roster of the first term without graphs.
pub(crate) fn roster_of(published: Tick, robots: Vec<RosterEntry>) -> Message {
    let stage = StageTime { stage: ServiceName::Ingest, received: published, published };
    let header = Header {
        fleet: fleet(),
        revision: Revision { term: 1, epoch: 1 },
        oldest: None,
        newest: None,
        stages: vec![stage],
    };
    Message::Roster(Checked::new_unchecked(Roster { header, robots, graphs: Vec::new() }))
}

/// Edges by name.
pub(crate) type Named = BTreeMap<(RobotId, RobotId), f64>;

/// Most timers within one millisecond: a deadline that has passed does not stay.
const MAX_TIMERS_PER_MOMENT: usize = 4;

pub(crate) struct Bench {
    kit: testkit::Bench<Ingest>,
    /// Everything but events and settings, with its time, in order.
    pub(crate) published: Vec<(Tick, Message)>,
    pub(crate) events: Vec<EventKind>,
    /// What robots learn of their refused messages.
    pub(crate) refused: Vec<Refused>,
    pub(crate) roster: Option<Checked<Roster>>,
    pub(crate) graphs: BTreeMap<Modality, GraphReplica>,
}

impl Deref for Bench {
    type Target = testkit::Bench<Ingest>;

    fn deref(&self) -> &Self::Target {
        &self.kit
    }
}

impl DerefMut for Bench {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.kit
    }
}

impl Bench {
    /// Before its first input.
    pub(crate) fn asleep_at(now: Tick, settings: IngestSettings, stored: Stored) -> Self {
        let instance = InstanceId::new("host-1").unwrap();
        let start = Start { fleet: fleet(), instance, now, settings, stored };
        Self {
            kit: testkit::Bench::new(start),
            published: Vec::new(),
            events: Vec::new(),
            refused: Vec::new(),
            roster: None,
            graphs: BTreeMap::new(),
        }
    }

    pub(crate) fn asleep(settings: IngestSettings) -> Self {
        Self::asleep_at(START, settings, Stored::default())
    }

    /// In its term, with the first, empty frame behind it. It takes over a fleet whose last robot is
    /// gone (and has node 0), so that it waits for no robot to gather.
    pub(crate) fn new(settings: IngestSettings) -> Self {
        let mut bench = Self::asleep(settings);
        let last = entry_of("last", Presence::Stale, Tick(0));
        bench.start(vec![roster_of(Tick(0), vec![last])]);
        bench.wait(0.5);
        assert_eq!(bench.happened(), ["left last"]);
        bench
    }

    pub(crate) fn default() -> Self {
        Self::new(IngestSettings::default())
    }

    pub(crate) fn start(&mut self, answers: Vec<Message>) {
        self.kit.start(answers);
        self.follow();
    }

    /// Begins to ask so long ago that the next answers end the inquiry.
    pub(crate) fn begin_inquiry(&mut self) {
        let now = self.now;
        self.now = now.before(testkit::START_RETRY_TIME);
        self.input(Input::Started { linked: true });
        self.now = now;
    }

    pub(crate) fn answer_all(&mut self, answers: Vec<Message>) {
        self.kit.answer_all(answers);
        self.follow();
    }

    pub(crate) fn input(&mut self, input: Input) {
        self.kit.input(input);
        self.follow();
    }

    pub(crate) fn receive(&mut self, packet: impl Into<Packet>) {
        self.kit.receive_packet(packet.into());
        self.follow();
    }

    pub(crate) fn receive_refused(&mut self, rejection: Rejection) {
        self.kit.receive_refused(rejection);
        self.follow();
    }

    fn follow(&mut self) {
        assert!(self.unencodable.is_empty() && self.others_are_of_the_election());
        for message in std::mem::take(&mut self.kit.published) {
            self.follow_one(message);
        }
    }

    fn others_are_of_the_election(&self) -> bool {
        self.others.iter().all(|other| matches!(other, muster_service::Command::ReplicaState(_)))
    }

    /// What every consumer relies on.
    fn follow_one(&mut self, message: Message) {
        match &message {
            Message::Event(event) => return self.events.push(event.kind.clone()),
            Message::Refused(refused) => return self.refused.push(refused.as_ref().clone()),
            Message::Settings(..) | Message::LeaseRenewal(..) => return,
            Message::Graph(delta) => {
                let replica = self.graphs.entry(delta.modality.clone()).or_default();
                replica.apply(delta).unwrap();
            }
            Message::Roster(roster) => {
                let last = self.roster.as_ref().map(|last| last.header.revision);
                assert!(last < Some(roster.header.revision), "revisions grow");
                assert!(roster.graphs.is_sorted());
                let nodes: BTreeMap<_, _> =
                    roster.robots.iter().map(|entry| (entry.node, entry.robot.clone())).collect();
                assert_eq!(nodes.len(), roster.robots.len());
                assert!(roster.robots.is_sorted_by(|left, right| left.robot < right.robot));
                self.graphs.retain(|modality, _| {
                    roster.graphs.iter().any(|(listed, _)| listed == modality)
                });
                assert_eq!(self.graphs.len(), roster.graphs.len());
                for (modality, revision) in &roster.graphs {
                    assert_eq!(self.graphs[modality].revision(), *revision, "{modality}");
                    assert_eq!(*self.graphs[modality].nodes(), nodes, "{modality}");
                }
                self.roster = Some(roster.clone());
            }
            other => panic!("ingest does not publish {other:?}"),
        }
        self.published.push((self.now, message));
    }

    /// Lets time pass, with every deadline met.
    pub(crate) fn wait(&mut self, duration_s: f64) {
        let end = self.now.after(seconds(duration_s));
        let mut at_this_moment = 0;
        while let Some(deadline) = self.host.deadline().filter(|deadline| *deadline <= end) {
            let is_later = deadline > self.now.after(Duration::from_millis(1));
            at_this_moment = if is_later { 0 } else { at_this_moment + 1 };
            assert!(at_this_moment < MAX_TIMERS_PER_MOMENT, "a deadline that has passed stays");
            self.now = self.now.max(deadline);
            self.input(Input::Timer);
        }
        self.now = end;
    }

    pub(crate) fn get(
        &mut self,
        key: &str,
        payload: Option<&Value>,
    ) -> Result<Vec<Message>, String> {
        let payload = payload.map(Value::to_string);
        let answer = self.kit.get(key, payload.as_deref());
        self.follow();
        answer
    }

    pub(crate) fn set(&mut self, patch: &Value) {
        self.get("service/ingest/settings", Some(patch)).unwrap();
    }

    pub(crate) fn status(&mut self) -> ServiceStatus {
        match self.get("service/ingest/status", None).unwrap().remove(0) {
            Message::Status(status) => *status,
            other => panic!("{other:?}"),
        }
    }

    pub(crate) fn counter(&mut self, name: &str) -> u64 {
        self.status().counters.get(name).copied().unwrap_or_default()
    }

    /// Everything that a reader would remember.
    pub(crate) fn remembered(&mut self) -> Vec<Message> {
        let mut messages = self.get("graph/*", None).unwrap();
        messages.extend(self.get("roster", None).unwrap());
        messages
    }

    pub(crate) fn graph(&self, name: &str) -> Named {
        named(&self.graphs[&modality(name)])
    }

    pub(crate) fn weight(&self, of: &str, from: &str, to: &str) -> Option<f64> {
        self.graph(of).get(&(robot(from), robot(to))).copied()
    }

    pub(crate) fn entry(&self, name: &str) -> Option<&RosterEntry> {
        let robots = &self.roster.as_ref()?.robots;
        robots.iter().find(|entry| entry.robot.as_str() == name)
    }

    pub(crate) fn presence(&self, name: &str) -> Option<Presence> {
        self.entry(name).map(|entry| entry.presence)
    }

    pub(crate) fn names(&self) -> Vec<&str> {
        let robots = self.roster.iter().flat_map(|roster| &roster.robots);
        robots.map(|entry| entry.robot.as_str()).collect()
    }

    /// The names of what happened since the last call, such as `joined r1`.
    pub(crate) fn happened(&mut self) -> Vec<String> {
        let happened = self.events.drain(..).filter_map(|event| match event {
            EventKind::RobotJoined { robot } => Some(format!("joined {robot}")),
            EventKind::RobotStale { robot } => Some(format!("stale {robot}")),
            EventKind::RobotRecovered { robot } => Some(format!("recovered {robot}")),
            EventKind::RobotLeft { robot } => Some(format!("left {robot}")),
            EventKind::RobotsStale { robots, .. } => Some(format!("stale {}", names(&robots))),
            EventKind::RobotsRecovered { robots, .. } => {
                Some(format!("recovered {}", names(&robots)))
            }
            EventKind::RobotsLeft { robots, .. } => Some(format!("left {}", names(&robots))),
            EventKind::LinkRestored { outage_s } => Some(format!("link back after {outage_s} s")),
            EventKind::Quarantined { robot, reason, .. } => Some(format!(
                "refused {}: {reason}",
                robot.map_or_else(String::new, |r| r.to_string())
            )),
            _ => None,
        });
        happened.collect()
    }

    /// When frames were published.
    pub(crate) fn frame_times(&self) -> Vec<Tick> {
        let rosters = self.published.iter().filter(|(_, m)| matches!(m, Message::Roster(_)));
        rosters.map(|(at, _)| *at).collect()
    }

    pub(crate) fn delta_count(&self) -> usize {
        self.published.iter().filter(|(_, message)| matches!(message, Message::Graph(_))).count()
    }
}

pub(crate) fn named(graph: &GraphReplica) -> Named {
    let name = |node: &u32| graph.nodes()[node].clone();
    let edges = graph.rows().iter().flat_map(|(source, edges)| {
        edges.iter().map(move |(target, weight)| ((name(source), name(target)), *weight))
    });
    edges.collect()
}
