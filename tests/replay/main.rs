//! Random lives of all four cores on a bus that loses messages: each is recorded, and lives again.
//!
//! No process and no socket: the recordings are made as the shell makes them, of events that could
//! have come in any order. What is shown is that no core depends on anything but its events.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::time::Duration;

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_ingest::Ingest;
use muster_machine::recording::{Entry, Head, Output};
use muster_machine::replay::{Comparison, Ending, compare};
use muster_machine::{Command, Core, Driver, Event, QueryId, Start, Stopwatch, Stored, Wiring};
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, InstanceId, RobotId, ServiceName};
use muster_model::observation::{CheckedReport, Link, Links, Pose, Rank, Report};
use muster_model::role::Claim;
use muster_model::time::Tick;
use muster_wire::recording::{Bytes, Reader, Received, begin, frame};
use muster_wire::{Key, KeySpace, Message, Pattern, Rejection, Request};
use proptest::prelude::*;

fn space() -> KeySpace {
    KeySpace::new(FleetId::new("alpha").unwrap())
}

/// A core as a shell runs and records it.
struct Node<C: Core> {
    driver: Driver<C>,
    job: Option<C::Job>,
    recording: Vec<u8>,
    stored: Stored,
    queries: u64,
    jobs_run: u64,
    out: Out,
}

/// What a core wants of others.
#[derive(Default)]
struct Out {
    published: Vec<Message>,
    fetches: VecDeque<(u32, Vec<Pattern>)>,
    answers: Vec<Message>,
}

/// A node whatever its service.
trait AnyNode {
    fn started(&mut self, now: Tick);
    fn hear(&mut self, now: Tick, message: &Message);
    fn refuse(&mut self, now: Tick);
    fn link(&mut self, now: Tick, up: bool);
    fn wake(&mut self, now: Tick);
    fn run_job(&mut self, now: Tick);
    fn ask(&mut self, now: Tick, request: Request) -> Vec<Message>;
    fn fetched(&mut self, now: Tick, fetch: u32, messages: &[Message]);
    fn serves(&self, pattern: &Pattern) -> bool;
    fn out(&mut self) -> &mut Out;
    /// Ends the run, gives its recording, and begins the next.
    fn restart(&mut self, now: Tick, run: u32) -> Vec<u8>;
    fn replay(&self, recording: &[u8]) -> Comparison;
}

fn again(message: &Message) -> Option<Message> {
    // What is on the bus is bytes: nothing reaches a core that did not come through them.
    let packet = Received::new(&space(), &unmirrored(message)).ok()?.into_packet();
    Message::decode(&space(), &packet).ok()
}

fn unmirrored(message: &Message) -> Message {
    match message {
        Message::Teams { teams, .. } => Message::Teams { teams: teams.clone(), mirror: false },
        other => other.clone(),
    }
}

impl<C: Core> Node<C> {
    fn new(now: Tick, run: u32, stored: Stored) -> Self {
        let start = Start {
            fleet: space().fleet().clone(),
            instance: InstanceId::of_process("h", run, 1),
            now,
            settings: C::Settings::default(),
            stored: stored.clone(),
        };
        let head = Head::new::<C>(&start, String::new()).unwrap();
        Self {
            driver: Driver::new(start),
            job: None,
            recording: begin(&head).unwrap(),
            stored,
            queries: 0,
            jobs_run: 0,
            out: Out::default(),
        }
    }

    fn step(&mut self, now: Tick, event: Event<C::Done>, laps: &[u64]) {
        let entry = Entry::event(&space(), now, &event, laps).unwrap();
        self.recording.extend(frame(&entry).unwrap());
        let commands = self.driver.step(now, event);
        self.recording.extend(frame(&Entry::outputs(&space(), now, &commands)).unwrap());
        for command in commands {
            match command {
                Command::Publish(message) => self.out.published.push(message),
                Command::Reply { request, answer, .. } => {
                    let selected = answer.unwrap_or_default().into_iter();
                    let selected = selected.filter(|m| request.selects(&space(), &m.keys().0));
                    self.out.answers.extend(selected);
                }
                Command::Run(job) => {
                    assert!(self.job.replace(job).is_none(), "one job at a time");
                }
                Command::Fetch { fetch, patterns } => self.out.fetches.push_back((fetch, patterns)),
                Command::Store(stored) => self.stored = stored,
            }
        }
    }
}

impl<C: Core> AnyNode for Node<C> {
    fn started(&mut self, now: Tick) {
        self.step(now, Event::Started, &[]);
    }

    fn hear(&mut self, now: Tick, message: &Message) {
        let Some(message) = again(message) else { return };
        let wiring = Wiring::of::<C>();
        let subscribed = wiring.subscriptions.iter().map(|subscription| &subscription.pattern);
        let token = matches!(message, Message::RobotToken { .. } | Message::ServiceToken { .. });
        let wanted = wiring.tokens.iter().filter(|_| token).chain(subscribed.filter(|_| !token));
        if wanted.into_iter().any(|pattern| selects(pattern, &message.keys().0)) {
            self.step(now, Event::Received(message), &[]);
        }
    }

    fn refuse(&mut self, now: Tick) {
        let rejection = Rejection::new(&space(), "muster/v1/alpha/robot/r0/pose", "x: wrong");
        self.step(now, Event::Rejected(rejection), &[]);
    }

    fn link(&mut self, now: Tick, up: bool) {
        self.step(now, if up { Event::LinkRestored } else { Event::LinkLost }, &[]);
    }

    fn wake(&mut self, now: Tick) {
        if self.driver.deadline().is_some_and(|due| due <= now) {
            self.step(now, Event::Timeout, &[]);
        }
    }

    fn run_job(&mut self, now: Tick) {
        let Some(job) = self.job.take() else { return };
        self.jobs_run += 1;
        let mut time = now.0;
        let mut stopwatch = Stopwatch::reading(move || {
            time += 17 + time % 31;
            time
        });
        let done = C::run(job, &mut stopwatch);
        self.step(now, Event::Done(done), stopwatch.laps());
    }

    fn ask(&mut self, now: Tick, request: Request) -> Vec<Message> {
        self.queries += 1;
        self.out.answers.clear();
        self.step(now, Event::Query { query: QueryId(self.queries), request }, &[]);
        std::mem::take(&mut self.out.answers)
    }

    fn fetched(&mut self, now: Tick, fetch: u32, messages: &[Message]) {
        let messages = messages.iter().filter_map(again).collect();
        self.step(now, Event::Fetched { fetch, messages }, &[]);
    }

    fn serves(&self, pattern: &Pattern) -> bool {
        let text = space().pattern(pattern);
        let own = [(Pattern::One(Key::Settings(C::SERVICE)), true)];
        let served = C::wiring().served.into_iter().chain(own);
        served.into_iter().any(|(served, _)| space().pattern(&served) == text)
    }

    fn out(&mut self) -> &mut Out {
        &mut self.out
    }

    fn restart(&mut self, now: Tick, run: u32) -> Vec<u8> {
        let next = Self::new(now, run, self.stored.clone());
        let mut ended = std::mem::replace(self, next);
        ended.recording.extend(frame(&Entry::End("restart".to_owned())).unwrap());
        ended.recording
    }

    fn replay(&self, recording: &[u8]) -> Comparison {
        let (mut reader, head) = Reader::open(recording).unwrap();
        let see = |_: &_| ControlFlow::Continue(());
        compare::<C>(head, || reader.next_entry(), u64::MAX, see).unwrap()
    }
}

fn selects(pattern: &Pattern, key: &Key) -> bool {
    Request::new(space().pattern(pattern), "", None).unwrap().selects(&space(), key)
}

#[derive(Debug, Clone)]
enum Act {
    Say(Message),
    Wait(u64),
    /// The messages and answers of one service are lost until the next such act.
    Lose(usize),
    Jobs(bool),
    Restart(usize),
    Link(usize, bool),
    Refuse(usize),
    Ask(usize, &'static str, Option<&'static str>),
}

fn name() -> impl Strategy<Value = RobotId> {
    (0..7_u8).prop_map(|n| RobotId::new(format!("r{n}")).unwrap())
}

fn report(robot: RobotId, report: impl Into<Report>) -> Message {
    Message::Report(CheckedReport::new(robot, report).unwrap())
}

fn message() -> impl Strategy<Value = Message> {
    let (boot, stamp, seq) = (None, None, None);
    let pose = move |(robot, x, y): (RobotId, i16, i16)| {
        let (x, y) = (f64::from(x) * 0.1, f64::from(y) * 0.1);
        let (z, heading, frame, boot) = (None, None, None, boot.clone());
        report(robot, Pose { x, y, z, heading, frame, stamp, boot, seq })
    };
    prop_oneof![
        6 => (name(), -300..300_i16, -300..300_i16).prop_map(pose),
        2 => (name(), prop::collection::vec((name(), 0..=10_u8), 0..5)).prop_map(
            |(robot, peers)| {
                let mut links: Vec<_> = peers
                    .into_iter()
                    .filter(|(peer, _)| *peer != robot)
                    .map(|(peer, q)| Link { peer, quality: f64::from(q) / 10.0 })
                    .collect();
                links.sort_by(|a, b| a.peer.cmp(&b.peer));
                links.dedup_by(|a, b| a.peer == b.peer);
                report(robot, Links { links, stamp: None, boot: None, seq: None })
            },
        ),
        1 => (name(), prop::option::of(name())).prop_map(|(robot, superior)| {
            let superior = superior.filter(|superior| *superior != robot);
            report(robot, Rank::under(superior))
        }),
        1 => (name(), any::<bool>())
            .prop_map(|(robot, alive)| Message::RobotToken { robot, alive }),
        1 => (0..4_usize, 0..4_u64, any::<bool>()).prop_map(|(service, term, claims)| {
            let (service, instance) = (ServiceName::ALL[service], InstanceId::new("other-1").unwrap());
            if !claims {
                return Message::ServiceToken { service, instance, alive: term > 0 };
            }
            let header = Header {
                fleet: space().fleet().clone(),
                revision: Revision { term, epoch: 1 },
                oldest: None,
                newest: None,
                stages: Vec::new(),
            };
            Message::Claim(Box::new(Claim { header, service, instance }))
        }),
    ]
}

fn act() -> impl Strategy<Value = Act> {
    let asked = prop::sample::select(vec![
        ("**", None),
        ("muster/v1/alpha/*", None),
        ("muster/v1/alpha/service/clusterer/settings", Some("{\"teams\":3}")),
        ("muster/v1/alpha/service/clusterer/settings", Some("{\"teams\":0}")),
        ("muster/v1/alpha/service/embedder/settings", Some("{\"dimension\":4}")),
        ("muster/v1/alpha/service/ingest/settings", Some("{\"tick_hz\":4.0}")),
        ("muster/v1/alpha/service/auditor/settings", Some("{\"good\":0.9}")),
    ]);
    prop_oneof![
        30 => message().prop_map(Act::Say),
        20 => (1..400_u64).prop_map(|ms| Act::Wait(ms * ms / 100 + 1)),
        1 => (0..5_usize).prop_map(Act::Lose),
        2 => any::<bool>().prop_map(Act::Jobs),
        1 => (0..4_usize).prop_map(Act::Restart),
        1 => (0..4_usize, any::<bool>()).prop_map(|(at, up)| Act::Link(at, up)),
        1 => (0..4_usize).prop_map(Act::Refuse),
        2 => (0..4_usize, asked).prop_map(|(at, (key, payload))| Act::Ask(at, key, payload)),
    ]
}

struct World {
    now: Tick,
    nodes: Vec<Box<dyn AnyNode>>,
    /// Whose messages are lost; nobody's if it is no service's number.
    lost: usize,
    jobs_run: bool,
    runs: u32,
    recordings: Vec<(usize, Vec<u8>)>,
}

impl World {
    fn new() -> Self {
        let now = Tick(1_795_208_990_000_000);
        let nodes: Vec<Box<dyn AnyNode>> = vec![
            Box::new(Node::<Ingest>::new(now, 0, Stored::default())),
            Box::new(Node::<Embedder>::new(now, 0, Stored::default())),
            Box::new(Node::<Clusterer>::new(now, 0, Stored::default())),
            Box::new(Node::<Auditor>::new(now, 0, Stored::default())),
        ];
        let mut world =
            Self { now, nodes, lost: 9, jobs_run: true, runs: 0, recordings: Vec::new() };
        for at in 0..world.nodes.len() {
            world.nodes[at].started(now);
        }
        world.settle();
        world
    }

    /// Carries messages, answers and jobs until nobody wants anything at this moment.
    fn settle(&mut self) {
        // A core that names a past moment again and again must not keep the world from going on.
        for _ in 0..50 {
            self.now = self.now.after(Duration::from_micros(100));
            let mut is_quiet = true;
            for at in 0..self.nodes.len() {
                self.nodes[at].wake(self.now);
                if self.jobs_run {
                    self.nodes[at].run_job(self.now);
                }
                let published = std::mem::take(&mut self.nodes[at].out().published);
                let fetches = std::mem::take(&mut self.nodes[at].out().fetches);
                is_quiet &= published.is_empty() && fetches.is_empty();
                if at != self.lost {
                    for message in &published {
                        self.nodes.iter_mut().for_each(|node| node.hear(self.now, message));
                    }
                }
                for (fetch, patterns) in fetches {
                    self.answer(at, fetch, &patterns);
                }
            }
            if is_quiet {
                break;
            }
        }
    }

    fn answer(&mut self, at: usize, fetch: u32, patterns: &[Pattern]) {
        let mut messages = Vec::new();
        for pattern in patterns {
            for other in (0..self.nodes.len()).filter(|other| *other != at && *other != self.lost) {
                if self.nodes[other].serves(pattern) {
                    let selector = space().pattern(pattern);
                    let request = Request::new(selector, "format=bincode", None).unwrap();
                    messages.extend(self.nodes[other].ask(self.now, request));
                }
            }
        }
        self.nodes[at].fetched(self.now, fetch, &messages);
    }

    fn act(&mut self, act: Act) {
        match act {
            Act::Say(message) => {
                self.nodes.iter_mut().for_each(|node| node.hear(self.now, &message));
            }
            Act::Wait(ms) => self.now = self.now.after(Duration::from_millis(ms)),
            Act::Lose(at) => self.lost = at,
            Act::Jobs(run) => self.jobs_run = run,
            Act::Restart(at) => {
                self.runs += 1;
                let recording = self.nodes[at].restart(self.now, self.runs);
                self.recordings.push((at, recording));
                self.nodes[at].started(self.now);
            }
            Act::Link(at, up) => self.nodes[at].link(self.now, up),
            Act::Refuse(at) => self.nodes[at].refuse(self.now),
            Act::Ask(at, key, payload) => {
                let payload = payload.map(|text| text.as_bytes().to_vec());
                let request = Request::new(key, "", payload).unwrap();
                self.nodes[at].ask(self.now, request);
            }
        }
        self.settle();
    }

    fn end(mut self) -> Ended {
        for at in 0..self.nodes.len() {
            let recording = self.nodes[at].restart(self.now, 0);
            self.recordings.push((at, recording));
        }
        Ended { nodes: self.nodes, recordings: self.recordings }
    }
}

/// What is left of a world: its nodes, and the recordings of all their runs by the number of the node.
struct Ended {
    nodes: Vec<Box<dyn AnyNode>>,
    recordings: Vec<(usize, Vec<u8>)>,
}

/// Changes one bit of what was published in the middle of a recording. The number of its event; none
/// if nothing was published.
fn tamper(recording: &[u8]) -> Option<(u64, Vec<u8>)> {
    let (mut reader, head) = Reader::open::<Head>(recording).unwrap();
    let entries: Vec<Entry> = std::iter::from_fn(|| reader.next_entry().unwrap()).collect();
    let publishes = |entry: &Entry| match entry {
        Entry::Outputs(outputs) => {
            outputs.iter().any(|output| matches!(output, Output::Published(Ok(_))))
        }
        _ => false,
    };
    let places: Vec<_> = (0..entries.len()).filter(|at| publishes(&entries[*at])).collect();
    let at = *places.get(places.len() / 2)?;
    let mut bytes = begin(&head).unwrap();
    for (number, mut entry) in entries.into_iter().enumerate() {
        if let Entry::Outputs(outputs) = &mut entry
            && number == at
        {
            for output in outputs {
                if let Output::Published(Ok(puts)) = output {
                    let Bytes(payload) = &mut puts[0].payload;
                    *payload.last_mut().unwrap() ^= 1;
                }
            }
        }
        bytes.extend(frame(&entry).unwrap());
    }
    Some((at as u64 / 2 + 1, bytes))
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 64, failure_persistence: None, ..ProptestConfig::default()
    })]

    #[test]
    fn every_life_of_every_core_comes_out_the_same(
        acts in prop::collection::vec(act(), 40..200),
    ) {
        let mut world = World::new();
        for act in acts {
            world.act(act);
        }
        let Ended { nodes, recordings } = world.end();
        for (at, recording) in recordings {
            let compared = nodes[at].replay(&recording);
            prop_assert_eq!(&compared.difference, &None, "{:?}", ServiceName::ALL[at]);
            prop_assert_eq!(compared.ending, Ending::Told("restart".to_owned()));
            if let Some((event, tampered)) = tamper(&recording) {
                let found = nodes[at].replay(&tampered).difference.map(|found| found.step.number);
                prop_assert_eq!(found, Some(event));
            }
        }
    }
}

/// The lives above are such that every core has something to do.
#[test]
fn a_plain_life_brings_every_core_to_work() {
    let mut world = World::new();
    for round in 0..40_u32 {
        for robot in 0..6_u32 {
            let name = RobotId::new(format!("r{robot}")).unwrap();
            let x = f64::from(robot % 2) * 60.0 + f64::from(robot) + f64::from(round) * 0.1;
            let (heading, frame, stamp) = (None, None, None);
            let pose = Pose { x, y: 0.0, z: None, heading, frame, stamp, boot: None, seq: None };
            world.act(Act::Say(report(name, pose)));
        }
        world.act(Act::Wait(100));
    }
    let Ended { nodes, recordings } = world.end();
    for (at, recording) in recordings {
        let compared = nodes[at].replay(&recording);
        assert_eq!(compared.difference, None);
        let service = ServiceName::ALL[at];
        assert!(compared.outputs > 20, "{service}: {compared:?}");
        assert!(compared.jobs > 5 || service == ServiceName::Ingest, "{service}: {compared:?}");
    }
}
