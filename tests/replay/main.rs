//! Random lives of all four services on a bus that loses messages: each is recorded, and replayed.
//!
//! No process and no socket: the recordings are made as the shell makes them, of inputs that could have
//! come in any order. They show that no host depends on anything but its inputs.

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
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, InstanceId, RobotId, ServiceName};
use muster_model::observation::{CheckedReport, Link, Links, Pose, Rank, Report};
use muster_model::role::LeaseRenewal;
use muster_model::time::Tick;
use muster_service::recording::{Entry, Head, commands_frame, input_frame};
use muster_service::replay::{Comparison, Ending, compare};
use muster_service::testkit::command_of;
use muster_service::{
    Arrival, Ask, AskId, Command, Core, GetId, Host, IncomingGet, Input, Start, Stopwatch, Stored,
    Wiring,
};
use muster_wire::recording::{Reader, begin, frame};
use muster_wire::{Key, KeySpace, Message, Packet, Pattern, Request};
use proptest::prelude::*;

fn space() -> KeySpace {
    KeySpace::new(FleetId::new("alpha").unwrap())
}

/// A host as a shell runs and records it.
struct Node<C: Core> {
    host: Host<C>,
    job: Option<C::Job>,
    recording: Vec<u8>,
    stored: Stored,
    gets: u64,
    out: Out,
}

/// What a host wants of others.
#[derive(Default)]
struct Out {
    published: Vec<Packet>,
    asks: VecDeque<Ask>,
    answers: Vec<Packet>,
    /// How many stores are not confirmed yet.
    stores: u32,
    /// How often something is to be kept, and that is not confirmed yet.
    keeps: u32,
}

/// A node whatever its service.
trait AnyNode {
    fn start(&mut self, now: Tick);
    fn receive(&mut self, now: Tick, packet: &Packet);
    fn refuse(&mut self, now: Tick);
    fn link(&mut self, now: Tick, is_up: bool);
    fn wake(&mut self, now: Tick);
    fn run_job(&mut self, now: Tick);
    fn get(&mut self, now: Tick, get: IncomingGet) -> Vec<Packet>;
    fn answer(&mut self, now: Tick, ask: AskId, packets: Vec<Packet>);
    fn serves(&self, pattern: &Pattern) -> bool;
    fn out(&mut self) -> &mut Out;
    /// Ends the run, gives its recording, and begins the next.
    fn restart(&mut self, now: Tick, run: u32) -> Vec<u8>;
    fn replay(&self, recording: &[u8]) -> Comparison;
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
        let (host, recording) = (Host::new(start), begin(&head).unwrap());
        Self { host, job: None, recording, stored, gets: 0, out: Out::default() }
    }

    fn handle(&mut self, now: Tick, input: Input) {
        self.recording.extend(input_frame(now, &input).unwrap());
        let commands = self.host.handle(now, input);
        self.recording.extend(commands_frame(&commands).unwrap());
        for command in commands {
            match command {
                Command::Publish(publication) => self.out.published.extend(publication.packets),
                Command::Reply(reply) => self.out.answers.extend(reply.answer.unwrap_or_default()),
                Command::RunJob => {
                    let job = self.host.take_job().expect("a job is to be run");
                    assert!(self.job.replace(job).is_none(), "one job at a time");
                }
                Command::Ask(ask) => self.out.asks.push_back(ask),
                Command::Store(stored) => {
                    self.stored = stored;
                    self.out.stores += 1;
                }
                Command::Keep(_) => self.out.keeps += 1,
                Command::ReplicaState(_) => {}
                other => panic!("{} wants {other:?}", C::SERVICE),
            }
        }
    }

    /// Confirms what was stored, which ends what waits for it.
    fn confirm_stores(&mut self, now: Tick) {
        for _ in 0..std::mem::take(&mut self.out.stores) {
            // Whether a disk is full decides over answers; a core must not depend on it otherwise.
            let error = (now.0 / 100).is_multiple_of(5).then(|| "the disk is full".to_owned());
            self.handle(now, Input::Stored { error });
        }
        for _ in 0..std::mem::take(&mut self.out.keeps) {
            self.handle(now, Input::Kept { error: None });
        }
    }
}

impl<C: Core> AnyNode for Node<C> {
    fn start(&mut self, now: Tick) {
        self.handle(now, Input::Started { linked: true });
    }

    fn receive(&mut self, now: Tick, packet: &Packet) {
        let Ok(message) = Message::decode(&space(), packet) else { return };
        let wiring = Wiring::of::<C>();
        let subscribed = wiring.subscriptions.iter().map(|subscription| &subscription.pattern);
        let token = matches!(message, Message::RobotToken { .. } | Message::ServiceToken { .. });
        let wanted = wiring.tokens.iter().filter(|_| token).chain(subscribed.filter(|_| !token));
        if wanted.into_iter().any(|pattern| selects(pattern, &message.keys().0)) {
            self.handle(now, Input::Arrived(Arrival::encoded(packet.clone())));
        }
    }

    fn refuse(&mut self, now: Tick) {
        let packet = Packet::put("muster/v1/alpha/robot/r0/pose", "", b"{\"x\":\"wrong\"}");
        let arrival = Arrival::decoded(&space(), packet);
        assert!(arrival.is_refused());
        self.handle(now, Input::Arrived(arrival));
    }

    fn link(&mut self, now: Tick, is_up: bool) {
        self.handle(now, if is_up { Input::LinkRestored } else { Input::LinkLost });
    }

    fn wake(&mut self, now: Tick) {
        if self.host.deadline().is_some_and(|due| due <= now) {
            self.handle(now, Input::Timer);
        }
        self.confirm_stores(now);
    }

    fn run_job(&mut self, now: Tick) {
        let Some(job) = self.job.take() else { return };
        let mut time = now.0;
        let mut stopwatch = Stopwatch::reading(move || {
            time += 17 + time % 31;
            time
        });
        let done = C::run(job, &mut stopwatch);
        self.host.finish_job(done);
        self.handle(now, Input::JobEnded { laps: stopwatch.laps().to_vec(), panic: None });
    }

    fn get(&mut self, now: Tick, get: IncomingGet) -> Vec<Packet> {
        self.gets += 1;
        self.out.answers.clear();
        self.handle(now, Input::Get(IncomingGet { get: GetId(self.gets), ..get }));
        self.confirm_stores(now);
        std::mem::take(&mut self.out.answers)
    }

    fn answer(&mut self, now: Tick, ask: AskId, packets: Vec<Packet>) {
        let answers = packets.into_iter().map(Arrival::encoded).collect();
        self.handle(now, Input::Answered { ask, answers });
    }

    fn serves(&self, pattern: &Pattern) -> bool {
        let text = space().pattern(pattern);
        let served = Wiring::of::<C>().served;
        served.into_iter().any(|served| space().pattern(&served.pattern) == text)
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

/// A get by a peer or console; the node that takes it numbers it.
fn incoming(selector: String, parameters: &str, payload: Option<&str>) -> IncomingGet {
    let payload = payload.map(|text| text.as_bytes().to_vec());
    let parameters = parameters.to_owned();
    IncomingGet { get: GetId(0), selector, narrowed: None, parameters, payload }
}

#[derive(Debug, Clone)]
enum Act {
    /// A robot, or another instance of a service.
    Publish(Message),
    Wait(u64),
    /// The messages and answers of one service are lost until the next such act.
    Lose(usize),
    Jobs(bool),
    Restart(usize),
    Link(usize, bool),
    Refuse(usize),
    Get(usize, &'static str, Option<&'static str>),
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
            let (service, instance) = (ServiceName::PIPELINE[service], InstanceId::new("other-1").unwrap());
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
            Message::LeaseRenewal(Box::new(LeaseRenewal { header, service, instance }))
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
        30 => message().prop_map(Act::Publish),
        20 => (1..400_u64).prop_map(|ms| Act::Wait(ms * ms / 100 + 1)),
        1 => (0..5_usize).prop_map(Act::Lose),
        2 => any::<bool>().prop_map(Act::Jobs),
        1 => (0..4_usize).prop_map(Act::Restart),
        1 => (0..4_usize, any::<bool>()).prop_map(|(at, up)| Act::Link(at, up)),
        1 => (0..4_usize).prop_map(Act::Refuse),
        2 => (0..4_usize, asked).prop_map(|(at, (key, payload))| Act::Get(at, key, payload)),
    ]
}

struct World {
    now: Tick,
    nodes: Vec<Box<dyn AnyNode>>,
    /// Which node's messages are lost; none if there is no such node.
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
            world.nodes[at].start(now);
        }
        world.settle();
        world
    }

    /// Carries messages, answers and jobs until no host wants anything at this moment.
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
                let asks = std::mem::take(&mut self.nodes[at].out().asks);
                is_quiet &= published.is_empty() && asks.is_empty();
                if at != self.lost {
                    for packet in &published {
                        self.nodes.iter_mut().for_each(|node| node.receive(self.now, packet));
                    }
                }
                for ask in asks {
                    self.answer(at, &ask);
                }
            }
            if is_quiet {
                break;
            }
        }
    }

    fn answer(&mut self, at: usize, ask: &Ask) {
        let mut packets = Vec::new();
        for other in (0..self.nodes.len()).filter(|other| *other != at && *other != self.lost) {
            if self.nodes[other].serves(&ask.pattern) {
                let get = incoming(space().pattern(&ask.pattern), "format=bincode", None);
                packets.extend(self.nodes[other].get(self.now, get));
            }
        }
        self.nodes[at].answer(self.now, ask.ask, packets);
    }

    fn act(&mut self, act: Act) {
        match act {
            Act::Publish(message) => {
                let packet = message.to_packet(&space());
                self.nodes.iter_mut().for_each(|node| node.receive(self.now, &packet));
            }
            Act::Wait(ms) => self.now = self.now.after(Duration::from_millis(ms)),
            Act::Lose(at) => self.lost = at,
            Act::Jobs(run) => self.jobs_run = run,
            Act::Restart(at) => {
                self.runs += 1;
                let recording = self.nodes[at].restart(self.now, self.runs);
                self.recordings.push((at, recording));
                self.nodes[at].start(self.now);
            }
            Act::Link(at, up) => self.nodes[at].link(self.now, up),
            Act::Refuse(at) => self.nodes[at].refuse(self.now),
            Act::Get(at, key, payload) => {
                let tail = key.trim_start_matches("muster/v1/alpha/");
                let id = self.now.0.to_string();
                let command = payload.and_then(|payload| command_of(self.now, tail, &id, payload));
                let (key, payload) = match &command {
                    Some((tail, command)) => {
                        (format!("muster/v1/alpha/{tail}"), Some(command.as_str()))
                    }
                    None => (key.to_owned(), payload),
                };
                self.nodes[at].get(self.now, incoming(key, "", payload));
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

/// Changes one bit of what was published in the middle of a recording. The number of its input; none
/// if nothing was published.
fn tamper(recording: &[u8]) -> Option<(u64, Vec<u8>)> {
    let (mut reader, head) = Reader::open::<Head>(recording).unwrap();
    let mut entries: Vec<Entry> = std::iter::from_fn(|| reader.next_entry().unwrap()).collect();
    let publishes = |entry: &Entry| match entry {
        Entry::Commands(commands) => {
            commands.iter().any(|command| matches!(command, Command::Publish(_)))
        }
        _ => false,
    };
    let places: Vec<_> = (0..entries.len()).filter(|at| publishes(&entries[*at])).collect();
    let at = *places.get(places.len() / 2)?;
    if let Entry::Commands(commands) = &mut entries[at] {
        for command in commands {
            if let Command::Publish(publication) = command {
                *publication.packets[0].payload.as_mut().unwrap().last_mut().unwrap() ^= 1;
            }
        }
    }
    let mut bytes = begin(&head).unwrap();
    bytes.extend(entries.iter().flat_map(|entry| frame(entry).unwrap()));
    Some((at as u64 / 2 + 1, bytes))
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 64, failure_persistence: None, ..ProptestConfig::default()
    })]

    #[test]
    fn every_life_of_every_service_comes_out_the_same(
        acts in prop::collection::vec(act(), 40..200),
    ) {
        let mut world = World::new();
        for act in acts {
            world.act(act);
        }
        let Ended { nodes, recordings } = world.end();
        for (at, recording) in recordings {
            let compared = nodes[at].replay(&recording);
            prop_assert_eq!(&compared.difference, &None, "{:?}", ServiceName::PIPELINE[at]);
            prop_assert_eq!(compared.ending, Ending::Stated("restart".to_owned()));
            if let Some((input, tampered)) = tamper(&recording) {
                let found = nodes[at].replay(&tampered).difference.map(|found| found.step.number);
                prop_assert_eq!(found, Some(input));
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
            world.act(Act::Publish(report(name, pose)));
        }
        world.act(Act::Wait(100));
    }
    let Ended { nodes, recordings } = world.end();
    for (at, recording) in recordings {
        let compared = nodes[at].replay(&recording);
        assert_eq!(compared.difference, None);
        let service = ServiceName::PIPELINE[at];
        assert!(compared.commands > 20, "{service}: {compared:?}");
        assert!(compared.jobs > 5 || service == ServiceName::Ingest, "{service}: {compared:?}");
    }
}
