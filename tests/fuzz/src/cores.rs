//! Whole services: a sequence of inputs that bytes choose, and what must hold of everything that a host
//! wants done.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_ingest::Ingest;
use muster_model::audit::{Audit, SilhouetteReport};
use muster_model::event::EventKind;
use muster_model::graph::GraphReplica;
use muster_model::header::Revision;
use muster_model::id::{FleetId, InstanceId, Modality, ServiceName};
use muster_model::proposal::ProposalState;
use muster_model::settings::Settings;
use muster_model::time::Tick;
use muster_planner::Planner;
use muster_service::testkit::{START_RETRY_TIME, command_of};
use muster_service::{
    Arrival, Ask, Command, Core, GetId, Host, IncomingGet, Input, Publication, Reply, Start,
    Stopwatch, Stored,
};
use muster_wire::message::MAX_REASON;
use muster_wire::{Format, Key, KeySpace, Message, Packet, Pattern, Request, Source, report};

use crate::draw::{Author, Draw, Drawn};
use crate::packets::{BINARY, NOW, decoded, space};
use crate::{Outcome, allocation, text};

/// Bytes that a core may hold for each byte of its input: a message is kept, copied into a job, and
/// answered in two forms.
const BYTES_PER_INPUT_BYTE: usize = 1024;

/// Bytes that it may hold beyond that: the working space of the mathematics, and what serde trusts a
/// count for.
const BASE_BYTES: usize = 32 << 20;

/// Most inputs of one run that bytes choose.
const MAX_INPUTS: usize = 400;

/// Most questions that are left unanswered; the shell answers each after a second at the latest.
const MAX_ASKS: usize = 32;

/// How often a timer comes while a service starts: often enough that the process never seems paused.
const START_STEP: Duration = Duration::from_millis(200);

/// How far a silhouette may be outside of -1 to 1, by rounding.
const ROUNDING: f64 = 1e-9;

/// Longest error that a get is answered with, in characters.
const MAX_ERROR: usize = 1000;

/// Keys that packets come in on.
pub(crate) const KEYS: [&str; 16] = [
    "robot/r0/pose",
    "robot/r1/pose",
    "robot/r2/links",
    "robot/r1/rank",
    "robot/r1/relation/thermal",
    "robot/r3",
    "graph/spatial",
    "graph/connectivity",
    "graph/hierarchy",
    "graph/thermal",
    "roster",
    "embedding",
    "teams",
    "audit",
    "service/clusterer/settings",
    "robot/R1/pose",
];

/// Keys that packets of a planner come in on: what it follows, and what it fetches for a proposal.
pub(crate) const PLANNER_KEYS: [&str; 16] = [
    "graph/spatial",
    "graph/connectivity",
    "graph/hierarchy",
    "graph/thermal",
    "roster",
    "embedding",
    "teams",
    "wishes",
    "service/clusterer/settings",
    "service/embedder/settings",
    "service/planner/settings",
    "audit",
    "robot/r1/pose",
    "graph/GRAPH",
    "propose/kim/p1",
    "event",
];

/// The keys of a service.
fn keys_of(service: ServiceName) -> &'static [&'static str; 16] {
    if service == ServiceName::Planner { &PLANNER_KEYS } else { &KEYS }
}

/// What gets of a planner select.
const PLANNER_SELECTORS: [&str; 8] = [
    "~/propose/kim/p1",
    "~/propose/kim/p2",
    "~/propose/alice/p1",
    "~/propose/*/*",
    "~/propose/kim/*",
    "~/service/planner/settings",
    "~/**",
    "~/nothing",
];

/// What proposals ask for, by the number in a payload of one byte.
const ASKED: [&str; 8] = [
    r#"{"teams":2}"#,
    r#"{"teams":{"from":1,"to":3}}"#,
    r#"{"without":["r1"]}"#,
    r#"{"size":{"max":2}}"#,
    r#"{"weights":{"spatial":1}}"#,
    r#"{"needs":[{"skill":"medic","per_team":{"min":1}}]}"#,
    r#"{"team_size":{"t1":{"min":2}},"without":["r0","r2"]}"#,
    "null",
];

/// What gets select.
const SELECTORS: [&str; 21] = [
    "~/**",
    "~/service/ingest/settings",
    "~/service/embedder/settings",
    "~/service/clusterer/settings",
    "~/service/auditor/settings",
    "~/service/*/status",
    "~/roster",
    "~/graph/*",
    "~/embedding",
    "~/teams",
    "~/json/*",
    "~/audit",
    "~/robot/*/team",
    "~/robot/r1/team",
    "**/team",
    "~/nothing",
    "~/wishes",
    "~/wish/kim/w1",
    "~/alerts",
    "~/command/*/kim/c1",
    "~/why",
];

/// What gets ask for.
const PARAMETERS: [&str; 8] = [
    "",
    "format=json",
    "format=bincode",
    "robot=r1;format=json",
    "katz=r1,r2",
    "format=json;katz=r2,r1",
    "format=bincode;katz=r1,r2",
    "katz=r1,r1",
];

pub(crate) fn ingest(data: &[u8]) -> Outcome {
    run::<Ingest>(data)
}

pub(crate) fn embedder(data: &[u8]) -> Outcome {
    run::<Embedder>(data)
}

pub(crate) fn clusterer(data: &[u8]) -> Outcome {
    run::<Clusterer>(data)
}

pub(crate) fn auditor(data: &[u8]) -> Outcome {
    run::<Auditor>(data)
}

pub(crate) fn planner(data: &[u8]) -> Outcome {
    run::<Planner>(data)
}

fn run<C: Core>(data: &[u8]) -> Outcome {
    let limit = BYTES_PER_INPUT_BYTE * data.len() + BASE_BYTES;
    let what = format!("{} with all that it received", C::SERVICE);
    allocation::at_most(limit, &what, || World::<C>::new().live(&mut Draw(data)))
}

/// A host, and what its shell knows of it.
struct World<C: Core> {
    host: Host<C>,
    space: KeySpace,
    now: Tick,
    author: Author,
    job: Option<C::Job>,
    asks: Vec<Ask>,
    /// How many stores are not confirmed.
    stores: usize,
    /// How often something is to be kept, and that is not confirmed.
    keeps: usize,
    confirmed_stores: usize,
    gets: u64,
    open: BTreeMap<GetId, OpenGet>,
    term: u64,
    /// The last revision on each key.
    published: BTreeMap<Key, Revision>,
    graphs: BTreeMap<Modality, GraphReplica>,
    outcome: Outcome,
}

/// A get that is not answered yet.
struct OpenGet {
    /// A get of a pair may wait for a job.
    is_of_pair: bool,
    is_of_reason: bool,
    /// A get of a proposal waits until that is computed, or for three seconds.
    is_of_proposal: bool,
    is_binary: bool,
}

impl<C: Core> World<C> {
    fn new() -> Self {
        let now = NOW.before(START_RETRY_TIME);
        Self {
            host: Host::new(Start {
                fleet: FleetId::new("alpha").unwrap(),
                instance: InstanceId::new("fuzz-1").unwrap(),
                now,
                settings: C::Settings::default(),
                stored: Stored::default(),
            }),
            space: space(),
            now,
            author: Author::default(),
            job: None,
            asks: Vec::new(),
            stores: 0,
            keeps: 0,
            confirmed_stores: 0,
            gets: 0,
            open: BTreeMap::new(),
            term: 0,
            published: BTreeMap::new(),
            graphs: BTreeMap::new(),
            outcome: Outcome::Refused,
        }
    }

    /// Lets everything happen that the bytes choose; then all that is under way ends.
    fn live(mut self, draw: &mut Draw<'_>) -> Outcome {
        // The start has asked for so long that its questions are not repeated.
        self.handle(Input::Started { linked: true });
        while self.now < NOW {
            self.now = self.now.after(START_STEP);
            self.handle(Input::Timer);
        }
        for _ in 0..MAX_INPUTS {
            if draw.is_empty() {
                break;
            }
            self.happen(draw);
        }
        self.end_all();
        self.now = self.now.after(Duration::from_secs(60));
        self.handle(Input::Timer);
        self.end_all();
        assert!(self.open.is_empty(), "a get is not answered");
        self.outcome
    }

    /// Ends what is under way.
    fn end_all(&mut self) {
        self.finish_job();
        self.answer_asks(&[]);
        self.confirm_stores();
        self.finish_job();
    }

    fn happen(&mut self, draw: &mut Draw<'_>) {
        match draw.below(16) {
            0 => self.now = self.now.after(Duration::from_millis(draw.number16().into())),
            1 => {
                self.now = self.host.deadline().map_or(self.now, |due| due.max(self.now));
                self.handle(Input::Timer);
            }
            2..5 => {
                let message = self.author.message(self.now, draw);
                self.receive(self.drawn(&message));
            }
            5 => {
                let packet = self.raw(draw);
                self.receive(packet);
            }
            6..8 => {
                let count = draw.below(5);
                let drawn: Vec<_> =
                    (0..count).map(|_| self.author.message(self.now, draw)).collect();
                let packets: Vec<_> = drawn.iter().map(|message| self.drawn(message)).collect();
                self.answer_asks(&packets);
            }
            8 => {
                let packets: Vec<_> = (0..draw.below(5)).map(|_| self.raw(draw)).collect();
                self.answer_asks(&packets);
            }
            9 => self.get(draw),
            10 | 11 => {
                self.confirm_stores();
                self.finish_job();
            }
            12 => {
                if self.job.take().is_some() {
                    let panic = Some("\u{1b}[31m failed\n".repeat(40));
                    self.handle(Input::JobEnded { laps: Vec::new(), panic });
                }
            }
            13 => self.handle(Input::LinkLost),
            14 => self.handle(Input::LinkRestored),
            _ => {
                let alive = draw.below(2) == 0;
                let key = format!("muster/v1/alpha/robot/r{}", draw.below(8));
                self.receive(Packet::token(key, alive));
            }
        }
    }

    /// A packet with its payload from the input.
    fn raw(&self, draw: &mut Draw<'_>) -> Packet {
        let choice = draw.byte();
        let encoding = if choice & 16 == 0 { BINARY } else { "" };
        let key = format!("muster/v1/alpha/{}", keys_of(C::SERVICE)[usize::from(choice % 16)]);
        Packet::put(key, encoding, draw.block())
    }

    /// What was drawn, as it crosses the bus.
    fn drawn(&self, drawn: &Drawn) -> Packet {
        let out = match drawn {
            Drawn::Message(message) => message.encode(message.keys().0, Format::Binary, self.now),
            Drawn::Report(robot, report) => report::encode_unchecked(robot, report),
        };
        out.unwrap().into_packet(&self.space)
    }

    fn is_wanted(&self, packet: &Packet, patterns: &[Pattern]) -> bool {
        let Ok(key) = self.space.parse(&packet.key) else { return true };
        patterns.iter().any(|pattern| {
            let request = Request::new(self.space.pattern(pattern), "", None).unwrap();
            request.selects(&self.space, &key)
        })
    }

    /// Hands a packet to the host if its core subscribes to its key.
    fn receive(&mut self, packet: Packet) {
        let wiring = C::wiring();
        let patterns: Vec<_> = match packet.source {
            Source::Put | Source::Delete => {
                wiring.subscriptions.into_iter().map(|subscription| subscription.pattern).collect()
            }
            Source::TokenAlive | Source::TokenGone => wiring.tokens,
        };
        if self.is_wanted(&packet, &patterns) {
            let arrival = self.arrival(packet);
            self.handle(Input::Arrived(arrival));
        }
    }

    /// A packet that the host decodes later; what decoding makes of it is checked here.
    fn arrival(&self, packet: Packet) -> Arrival {
        let _ = decoded(&self.space, &packet);
        Arrival::encoded(packet)
    }

    /// Ends all questions with those of the packets that they ask for.
    fn answer_asks(&mut self, packets: &[Packet]) {
        for Ask { ask, pattern, .. } in std::mem::take(&mut self.asks) {
            let pattern = [pattern];
            let wanted = packets.iter().filter(|packet| self.is_wanted(packet, &pattern));
            let answers = wanted.map(|packet| self.arrival(packet.clone())).collect();
            self.handle(Input::Answered { ask, answers });
        }
    }

    fn get(&mut self, draw: &mut Draw<'_>) {
        let tail = match C::SERVICE {
            ServiceName::Planner => PLANNER_SELECTORS[usize::from(draw.below(8))],
            _ => SELECTORS[usize::from(draw.below(21))],
        };
        let choice = draw.byte();
        let parameters = PARAMETERS[usize::from(choice & 3 | (choice & 8) >> 1)].to_owned();
        let payload = (choice & 4 != 0).then(|| draw.block().to_vec());
        let payload = payload.map(|payload| match payload[..] {
            [one] if C::SERVICE == ServiceName::Planner => {
                ASKED[usize::from(one % 8)].as_bytes().to_vec()
            }
            _ => payload,
        });
        self.gets += 1;
        let get = GetId(self.gets);
        // What a service changes by commands alone goes in one, unless it is none that could.
        let text = payload.as_deref().and_then(|payload| std::str::from_utf8(payload).ok());
        let command = text.and_then(|text| {
            command_of(self.now, tail.trim_start_matches("~/"), &format!("c{choice}"), text)
        });
        let (tail, payload) = match command {
            Some((key, command)) => (format!("~/{key}"), Some(command.into_bytes())),
            None => (tail.to_owned(), payload),
        };
        let selector = tail.replace('~', "muster/v1/alpha");
        let is_binary = parameters.contains("format=bincode");
        let is_of_reason = selector.ends_with("/why");
        let is_of_proposal = selector.contains("/propose/");
        let is_of_pair = choice & 8 != 0;
        self.open.insert(get, OpenGet { is_of_pair, is_of_reason, is_of_proposal, is_binary });
        self.handle(Input::Get(IncomingGet { get, selector, narrowed: None, parameters, payload }));
    }

    fn finish_job(&mut self) {
        if let Some(job) = self.job.take() {
            self.host.finish_job(C::run(job, &mut Stopwatch::still()));
            self.handle(Input::JobEnded { laps: Vec::new(), panic: None });
        }
    }

    /// The disk has written everything, but for every third state.
    fn confirm_stores(&mut self) {
        while self.stores > 0 {
            self.confirmed_stores += 1;
            let fails = self.confirmed_stores.is_multiple_of(3);
            let error = fails.then(|| "\u{1b}[31mthe disk is full\n".to_owned());
            self.stores -= 1;
            self.handle(Input::Stored { error });
        }
        while self.keeps > 0 {
            self.keeps -= 1;
            let error = self.keeps.is_multiple_of(3).then(|| "the disk is full".to_owned());
            self.handle(Input::Kept { error });
        }
    }

    fn handle(&mut self, input: Input) {
        for command in self.host.handle(self.now, input) {
            match command {
                Command::Publish(publication) => self.published(&publication),
                Command::Reply(reply) => self.replied(&reply),
                Command::RunJob => {
                    let job = self.host.take_job().expect("a job is to be run");
                    assert!(self.job.replace(job).is_none(), "two jobs run at a time");
                }
                Command::Ask(ask) => self.asks.push(ask),
                Command::Store(stored) => {
                    self.stores += 1;
                    assert!(stored.term >= self.term, "a term goes back");
                    self.term = stored.term;
                    let text = serde_json::to_vec(&stored).unwrap();
                    assert_eq!(serde_json::from_slice::<Stored>(&text).unwrap(), stored);
                    // Values may exclude each other: which of them count, the host decides.
                    C::Settings::default().merged(&stored.patch).expect("no stored settings");
                }
                Command::Keep(_) => self.keeps += 1,
                Command::ReplicaState(state) => assert_eq!(state, self.host.replica_state()),
                Command::Unencodable(problem) => panic!("{problem}"),
                other => panic!("{} wants {other:?}", C::SERVICE),
            }
        }
        if self.stores == 0 {
            // A reason waits for the division as well.
            let waits = |get: &OpenGet| {
                (get.is_of_pair || get.is_of_reason) && self.job.is_some()
                    || get.is_of_reason && !self.asks.is_empty()
                    || get.is_of_proposal
            };
            assert!(self.open.values().all(waits), "a get is not answered");
        }
        if self.asks.len() > MAX_ASKS {
            self.answer_asks(&[]);
        }
    }

    fn replied(&mut self, reply: &Reply) {
        let open = self.open.remove(&reply.get).expect("a get is answered that is not open");
        let is_ready = |message: &Message| matches!(message, Message::Proposal(report) if report.proposal.state == ProposalState::Ready);
        if reply.messages.iter().any(is_ready) {
            self.outcome = Outcome::Accepted;
        }
        let Err(error) = &reply.answer else { return };
        text::check(error, MAX_ERROR);
        // These have no binary form, and a get of one is answered with that.
        let has_none = |message: &Message| {
            matches!(
                message,
                Message::Status(_) | Message::Katz(_) | Message::Why(_) | Message::Proposal(_)
            )
        };
        let is_explained =
            reply.messages.is_empty() || open.is_binary && reply.messages.iter().any(has_none);
        assert!(is_explained, "{:?} is not answered: {error}", reply.messages);
    }

    /// Checks that a message is finite, in order, and accepted by its readers.
    fn published(&mut self, publication: &Publication) {
        let message = publication.message.as_ref().expect("a publication has a message");
        let (key, _) = message.keys();
        for packet in &publication.packets {
            if packet.encoding.starts_with("application/octet-stream") {
                let read = decoded(&self.space, packet);
                assert!(read.is_ok(), "what is published is refused: {read:?}");
            } else {
                let payload = packet.payload.as_ref().unwrap();
                let _: serde_json::Value = serde_json::from_slice(payload).unwrap();
            }
        }
        if let Some(header) =
            message.header().filter(|_| !matches!(message, Message::Event(_) | Message::Refused(_)))
        {
            let before = self.published.insert(key.clone(), header.revision);
            let repeats = matches!(
                message,
                Message::Settings(_) | Message::RobotTeam(_) | Message::LeaseRenewal(_)
            );
            let in_order = before.is_none_or(|before| {
                before < header.revision || (repeats && before == header.revision)
            });
            assert!(in_order, "{key} goes from {before:?} to {:?}", header.revision);
        }
        let is_result = match message {
            Message::Graph(delta) => delta.rows.iter().any(|row| !row.edges.is_empty()),
            Message::Embedding(embedding) => !embedding.robots.is_empty(),
            Message::Teams { teams, .. } => teams.assignments().next().is_some(),
            Message::Audit(audit) => audit.in_embedding.mean.is_some(),
            _ => false,
        };
        if is_result {
            self.outcome = Outcome::Accepted;
        }
        match message {
            Message::Graph(delta) => {
                let graph = self.graphs.entry(delta.modality.clone()).or_default();
                assert_eq!(graph.apply(delta), Ok(()), "a delta does not fit those before");
            }
            Message::Audit(audit) => check_audit(audit),
            Message::RobotTeam(team) => {
                assert!((0.0..=1.0).contains(&team.confidence), "{}", team.confidence);
            }
            Message::Event(event) => match &event.kind {
                EventKind::Quarantined { reason, key, .. } => {
                    text::check(reason, MAX_REASON);
                    text::check(key, MAX_REASON);
                }
                EventKind::JobFailed { reason }
                | EventKind::FewerTeams { reason, .. }
                | EventKind::Infeasible { reason }
                | EventKind::NeedFilled { reason, .. } => {
                    text::check(reason, MAX_REASON);
                }
                EventKind::QualityLow { mean } | EventKind::QualityRecovered { mean } => {
                    assert!(mean.is_finite());
                }
                EventKind::Flapping { returns_per_robot_minute, .. }
                | EventKind::FlappingEnded { returns_per_robot_minute } => {
                    assert!(returns_per_robot_minute.is_finite());
                }
                _ => {}
            },
            _ => {}
        }
    }
}

fn check_audit(audit: &Audit) {
    for report in [&audit.in_embedding, &audit.in_physical] {
        let SilhouetteReport { mean, per_team, per_robot, .. } = report;
        let teams = per_team.iter().map(|(_, value)| *value);
        let robots = per_robot.iter().map(|(_, value)| *value);
        for value in teams.chain(robots).chain(*mean) {
            assert!(value.abs() <= 1.0 + ROUNDING, "a silhouette is {value}");
        }
    }
}
