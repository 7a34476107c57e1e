//! Whole cores: a sequence of events that bytes choose, and what must hold of everything that a core
//! wants done.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_ingest::Ingest;
use muster_machine::{Command, Core, Driver, Event, QueryId, Start, Stopwatch, Stored};
use muster_model::audit::{Audit, SilhouetteReport};
use muster_model::event::EventKind;
use muster_model::graph::GraphReplica;
use muster_model::header::Revision;
use muster_model::id::{FleetId, InstanceId, Modality};
use muster_model::settings::Settings;
use muster_model::time::Tick;
use muster_wire::report;
use muster_wire::{Format, Key, KeySpace, Message, Packet, Pattern, Request, Source};

use crate::draw::{Author, Draw, Drawn};
use crate::packets::{BINARY, NOW, space, understood};
use crate::{allocation, text};

/// Bytes that a core may hold for each byte of its input: a message is kept, copied into a job, and
/// answered in two forms.
const HELD_PER_BYTE: usize = 1024;

/// Bytes that it may hold beyond that: the working space of the mathematics, and what serde trusts a
/// count for.
const HELD_ANYWAY: usize = 32 << 20;

/// Most events of one run.
const MAX_EVENTS: usize = 400;

/// Most fetches that are left unanswered; the shell answers each after a second at the latest.
const MAX_FETCHES: usize = 8;

/// How far a silhouette may be outside of -1 to 1, by rounding.
const ROUNDING: f64 = 1e-9;

/// Longest error that a get is answered with, in characters.
const MAX_ERROR: usize = 1000;

/// Longest text in an event, in characters.
const MAX_REASON: usize = 400;

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

/// What gets select.
const SELECTORS: [&str; 16] = [
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
];

/// What gets ask for.
const PARAMETERS: [&str; 8] = [
    "",
    "format=json",
    "format=bincode",
    "x=1;format=json",
    "katz=r1,r2",
    "format=json;katz=r2,r1",
    "format=bincode;katz=r1,r2",
    "katz=r1,r1",
];

pub(crate) fn ingest(data: &[u8]) {
    run::<Ingest>(data);
}

pub(crate) fn embedder(data: &[u8]) {
    run::<Embedder>(data);
}

pub(crate) fn clusterer(data: &[u8]) {
    run::<Clusterer>(data);
}

pub(crate) fn auditor(data: &[u8]) {
    run::<Auditor>(data);
}

fn run<C: Core>(data: &[u8]) {
    let limit = HELD_PER_BYTE * data.len() + HELD_ANYWAY;
    let what = format!("{} with all that it was told", C::SERVICE);
    allocation::at_most(limit, &what, || World::<C>::new().live(&mut Draw(data)));
}

/// A core, and what its shell knows of it.
struct World<C: Core> {
    driver: Driver<C>,
    space: KeySpace,
    now: Tick,
    author: Author,
    job: Option<C::Job>,
    fetches: Vec<(u32, Vec<Pattern>)>,
    queries: u64,
    open: BTreeSet<QueryId>,
    term: u64,
    /// The last revision on each key.
    told: BTreeMap<Key, Revision>,
    graphs: BTreeMap<Modality, GraphReplica>,
}

impl<C: Core> World<C> {
    fn new() -> Self {
        Self {
            driver: Driver::new(Start {
                fleet: FleetId::new("alpha").unwrap(),
                instance: InstanceId::new("fuzz-1").unwrap(),
                now: NOW,
                settings: C::Settings::default(),
                stored: Stored::default(),
            }),
            space: space(),
            now: NOW,
            author: Author::default(),
            job: None,
            fetches: Vec::new(),
            queries: 0,
            open: BTreeSet::new(),
            term: 0,
            told: BTreeMap::new(),
            graphs: BTreeMap::new(),
        }
    }

    /// Lets everything happen that the bytes choose; then all that is under way ends.
    fn live(&mut self, draw: &mut Draw<'_>) {
        self.step(Event::Started);
        for _ in 0..MAX_EVENTS {
            if draw.is_empty() {
                break;
            }
            self.happen(draw);
        }
        self.finish_job();
        while !self.fetches.is_empty() {
            self.answer_fetch(Vec::new());
        }
        self.finish_job();
        self.now = self.now.after(Duration::from_secs(60));
        self.step(Event::Timeout);
        self.finish_job();
    }

    fn happen(&mut self, draw: &mut Draw<'_>) {
        match draw.below(16) {
            0 => self.now = self.now.after(Duration::from_millis(draw.number16().into())),
            1 => {
                self.now = self.driver.deadline().map_or(self.now, |due| due.max(self.now));
                self.step(Event::Timeout);
            }
            2..5 => {
                let message = self.author.message(self.now, draw);
                self.receive(&self.drawn(&message));
            }
            5 => {
                let packet = self.raw(draw);
                self.receive(&packet);
            }
            6..8 => {
                let many = draw.below(5);
                let drawn: Vec<_> =
                    (0..many).map(|_| self.author.message(self.now, draw)).collect();
                let packets = drawn.iter().map(|message| self.drawn(message)).collect();
                self.answer_fetch(packets);
            }
            8 => {
                let packets = (0..draw.below(5)).map(|_| self.raw(draw)).collect();
                self.answer_fetch(packets);
            }
            9 => self.query(draw),
            10 | 11 => self.finish_job(),
            12 => {
                if self.job.take().is_some() {
                    self.step(Event::JobFailed("\u{1b}[31m failed\n".repeat(40)));
                }
            }
            13 => self.step(Event::LinkLost),
            14 => self.step(Event::LinkRestored),
            _ => {
                let source =
                    if draw.below(2) == 0 { Source::TokenAlive } else { Source::TokenGone };
                let key = format!("muster/v1/alpha/robot/r{}", draw.below(8));
                let (encoding, payload) = (String::new(), Ok(Vec::new()));
                self.receive(&Packet { key, encoding, source, payload, attachment: None });
            }
        }
    }

    /// A packet whose payload stands in the input.
    fn raw(&self, draw: &mut Draw<'_>) -> Packet {
        let choice = draw.byte();
        let encoding = if choice & 16 == 0 { BINARY } else { "" };
        Packet::put(
            format!("muster/v1/alpha/{}", KEYS[usize::from(choice % 16)]),
            encoding,
            draw.block().to_vec(),
        )
    }

    /// A message as it crosses the bus.
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

    /// Hands a packet to the core if it subscribes to its key.
    fn receive(&mut self, packet: &Packet) {
        let wiring = C::wiring();
        let patterns = match packet.source {
            Source::Put | Source::Delete => {
                wiring.subscriptions.into_iter().map(|subscription| subscription.pattern).collect()
            }
            Source::TokenAlive | Source::TokenGone => wiring.tokens,
        };
        if self.is_wanted(packet, &patterns) {
            match understood(&self.space, packet) {
                Ok(message) => self.step(Event::Received(message)),
                Err(rejection) => self.step(Event::Rejected(rejection)),
            }
        }
    }

    /// Ends the oldest fetch with those of the packets that it has asked for.
    fn answer_fetch(&mut self, packets: Vec<Packet>) {
        if self.fetches.is_empty() {
            return;
        }
        let (fetch, patterns) = self.fetches.remove(0);
        let wanted = packets.iter().filter(|packet| self.is_wanted(packet, &patterns));
        let messages = wanted.filter_map(|packet| understood(&self.space, packet).ok()).collect();
        self.step(Event::Fetched { fetch, messages });
    }

    fn query(&mut self, draw: &mut Draw<'_>) {
        let selector = SELECTORS[usize::from(draw.below(16))].replace('~', "muster/v1/alpha");
        let choice = draw.byte();
        let parameters = PARAMETERS[usize::from(choice & 3 | (choice & 8) >> 1)];
        let payload = (choice & 4 != 0).then(|| draw.block().to_vec());
        let request = Request::new(selector, parameters, payload).unwrap();
        self.queries += 1;
        let query = QueryId(self.queries);
        self.open.insert(query);
        self.step(Event::Query { query, request });
        // Who asks for a pair may have to wait for a job.
        let waits = choice & 8 != 0 && self.job.is_some();
        assert!(waits || !self.open.contains(&query), "a get is not answered");
    }

    fn finish_job(&mut self) {
        if let Some(job) = self.job.take() {
            self.step(Event::Done(C::run(job, &mut Stopwatch::still())));
            assert!(self.job.is_some() || self.open.is_empty(), "a get is not answered");
        }
    }

    fn step(&mut self, event: Event<C::Done>) {
        for command in self.driver.step(self.now, event) {
            match command {
                Command::Publish(message) => self.published(&message),
                Command::Reply { query, request, answer } => self.replied(query, &request, answer),
                Command::Run(job) => {
                    assert!(self.job.replace(job).is_none(), "two jobs run at a time");
                }
                Command::Fetch { fetch, patterns } => {
                    self.fetches.push((fetch, patterns));
                }
                Command::Store(stored) => {
                    assert!(stored.term >= self.term, "a term goes back");
                    self.term = stored.term;
                    let text = serde_json::to_vec(&stored).unwrap();
                    assert_eq!(serde_json::from_slice::<Stored>(&text).unwrap(), stored);
                    C::Settings::default()
                        .patched(&serde_json::Value::Object(stored.patch))
                        .expect("stored settings do not fit");
                }
            }
        }
        if self.fetches.len() > MAX_FETCHES {
            self.answer_fetch(Vec::new());
        }
    }

    fn replied(&mut self, query: QueryId, request: &Request, answer: Result<Vec<Message>, String>) {
        assert!(self.open.remove(&query), "a get is answered that is not open");
        match answer {
            Err(error) => text::check(&error, MAX_ERROR),
            Ok(messages) => {
                for message in messages {
                    let answer = message.answer(&self.space, request, self.now);
                    // These have no binary form, and who asks for one is told so.
                    let has_none = matches!(message, Message::Status(_) | Message::Katz(_))
                        && request.format == Some(Format::Binary);
                    assert!(answer.is_ok() || has_none, "{message:?} is not answered: {answer:?}");
                }
            }
        }
    }

    /// Checks that a message is finite, in order, and accepted by those who read it.
    fn published(&mut self, message: &Message) {
        let (key, _) = message.keys();
        for out in message.publish(self.now).unwrap() {
            if out.encoding.starts_with("application/octet-stream") {
                let packet = out.into_packet(&self.space);
                let read = understood(&self.space, &packet);
                assert!(read.is_ok(), "what is published is refused: {read:?}");
            } else {
                let _: serde_json::Value = serde_json::from_slice(&out.payload).unwrap();
            }
        }
        if let Some(header) = message.header().filter(|_| !matches!(message, Message::Event(_))) {
            let before = self.told.insert(key.clone(), header.revision);
            let again =
                matches!(message, Message::Settings(_) | Message::RobotTeam(_) | Message::Claim(_));
            let in_order = before.is_none_or(|before| {
                before < header.revision || (again && before == header.revision)
            });
            assert!(in_order, "{key} goes from {before:?} to {:?}", header.revision);
        }
        match message {
            Message::Graph(delta) => {
                let graph = self.graphs.entry(delta.modality.clone()).or_default();
                assert_eq!(graph.apply(delta), Ok(()), "a delta does not fit those before");
            }
            Message::Audit(audit) => check_audit(audit),
            Message::RobotTeam(told) => {
                assert!((0.0..=1.0).contains(&told.confidence), "{}", told.confidence);
            }
            Message::Event(event) => match &event.kind {
                EventKind::Quarantined { reason, key, .. } => {
                    text::check(reason, MAX_REASON);
                    text::check(key, MAX_REASON);
                }
                EventKind::JobFailed { reason } | EventKind::FewerTeams { reason, .. } => {
                    text::check(reason, MAX_REASON);
                }
                EventKind::QualityLow { mean } | EventKind::QualityRecovered { mean } => {
                    assert!(mean.is_finite());
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
