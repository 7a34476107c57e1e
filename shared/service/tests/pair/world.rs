//! Two hosts, the bus between them, and an operator: what happens on them, in order.

mod links;
mod operator;

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, VecDeque};
use std::ops::Range;

use muster_model::command::CommandOutcome;
use muster_model::id::{InstanceId, ServiceName};
use muster_model::role::ReplicaState;
use muster_model::settings::ClustererSettings;
use muster_model::time::Tick;
use muster_service::testkit::Bench;
use muster_service::{Ask, Command, GetId, IncomingGet, Input, Start, Stored};
use muster_wire::Message;
use serde_json::{Value, json};

use crate::small::{ONE_LEADS, Small, order, space};

use super::{Fault, Planned};

/// A moment or a time in microseconds.
pub(super) type Micros = u64;

pub(super) const MS: Micros = 1000;
pub(super) const SECOND: Micros = 1000 * MS;

/// What the clock of the bus says in the beginning: terms go by the seconds of clocks.
const START: Micros = 1_795_000_000 * SECOND;

/// The instances, by the hosts they run on.
pub(super) const HOSTS: [&str; 2] = ["a", "b"];

/// Faults begin before, and are over a moment later.
pub(super) const FAULTS_UNTIL: Micros = 12 * SECOND;

/// Longest fault.
pub(super) const LONGEST_FAULT: Micros = 5 * SECOND;

/// When all must agree. The operator repeats what is not answered until then.
const END: Micros = FAULTS_UNTIL + LONGEST_FAULT + 30 * SECOND;

/// How often an operator sends a command that is not answered.
const COMMAND_INTERVAL: Micros = SECOND;

/// How long a message takes on a calm link.
const CALM: Range<Micros> = 100..600;

/// How long a disk takes.
const DISK: Range<Micros> = MS..10 * MS;

/// When the ends of a silent link notice that.
const LEASE: Range<Micros> = 1500 * MS..2 * SECOND;

/// How long the bus takes to say that a session has ended or begun.
const TOKEN: Range<Micros> = MS..20 * MS;

/// Chance by splitmix64: a course of events is the same again.
#[derive(Debug)]
struct Chance(u64);

impl Chance {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    fn within(&mut self, range: Range<u64>) -> u64 {
        range.start + self.next() % (range.end - range.start).max(1)
    }
}

/// What goes over a link.
#[derive(Debug, Clone)]
enum Carried {
    Message(Box<Message>),
    /// A get for a host, and who waits for the answer.
    Get(Waiting, IncomingGet),
    /// The answer to the question of a host: its number and that of the process, and what was found.
    Answer(u32, u64, Vec<Message>),
}

/// Who waits for an answer.
#[derive(Debug, Clone, Copy)]
enum Waiting {
    /// A host, with the number of its process and the number of the question.
    Host(usize, u32, u64),
    /// The operator, with the number of the command.
    Operator(usize),
}

/// What happens.
#[derive(Debug)]
enum Event {
    Fault(usize),
    /// Something arrives at a host, if its session is the same still.
    Arrives {
        to: usize,
        session: u32,
        from: Option<usize>,
        what: Carried,
    },
    /// The input of a process that runs still.
    Input(usize, u32, Input),
    Timer(usize, u32),
    Start(usize),
    /// A process that hung runs again.
    Resume(usize, u32),
    Cut(usize, u32),
    Heal(usize),
    EndOfQuestion(usize, u32, u64),
    Command,
}

/// A link to the router.
#[derive(Debug, Default)]
struct Link {
    is_up: bool,
    is_silent: bool,
    cut_until: Micros,
    session: u32,
    /// Until when messages are lost and late, with how many, and by how much.
    storm: Option<(Micros, u64, Micros, bool)>,
    /// What a silent link holds back.
    held: Vec<(usize, Option<usize>, Carried)>,
    /// Before this, nothing that is sent in order arrives.
    free: Micros,
    /// The same for tokens.
    tokens_free: Micros,
}

/// One host.
struct Node {
    bench: Option<Bench<Small<ONE_LEADS>>>,
    process: u32,
    stored: Stored,
    link: Link,
    hangs_until: Micros,
    /// What came while it hung.
    waiting: VecDeque<Input>,
    starts_at: Micros,
    /// Questions that are not answered yet: how many answers are still to come, and what has come.
    questions: BTreeMap<u64, (Ask, usize, Vec<Message>)>,
    /// Gets that are not answered yet.
    gets: BTreeMap<u64, Waiting>,
    /// How far the clock goes ahead of the bus.
    ahead: Micros,
    timer: Option<Tick>,
}

/// Both, the bus, and the operator.
pub(super) struct World {
    now: Micros,
    count: u64,
    events: BinaryHeap<Reverse<(Micros, u64)>>,
    of_event: BTreeMap<u64, Event>,
    nodes: Vec<Node>,
    chance: Chance,
    plan: Vec<Planned>,
    next_get: u64,
    /// How many commands there are, and the first that is not confirmed.
    wanted: usize,
    next: usize,
    /// The value of each field that was confirmed last, by whichever leader.
    confirmed: BTreeMap<&'static str, u32>,
    pub(super) log: Option<Vec<String>>,
}

/// The instance that a process is.
fn instance_of(host: usize, process: u32) -> InstanceId {
    InstanceId::of_process(HOSTS[host], process, 1)
}

/// The fields that commands change.
const FIELDS: [&str; 2] = ["teams", "restarts"];

/// What a command asks for: one of the fields, or both. No two ask for the same value.
fn patch_of(command: usize) -> Vec<(&'static str, u32)> {
    let value = 2 + u32::try_from(command).unwrap();
    let asked = |place: usize| command % 3 == place || command % 3 == 2;
    FIELDS
        .into_iter()
        .enumerate()
        .filter(|(place, _)| asked(*place))
        .map(|(_, field)| (field, value))
        .collect()
}

impl World {
    pub(super) fn new(seed: u64, plan: Vec<Planned>, ahead: [Micros; 2], is_logged: bool) -> Self {
        let node = |ahead: Micros| Node {
            bench: None,
            process: 0,
            stored: Stored::default(),
            link: Link { is_up: true, ..Link::default() },
            hangs_until: 0,
            waiting: VecDeque::new(),
            starts_at: 0,
            questions: BTreeMap::new(),
            gets: BTreeMap::new(),
            ahead,
            timer: None,
        };
        let mut world = Self {
            now: 0,
            count: 0,
            events: BinaryHeap::new(),
            of_event: BTreeMap::new(),
            nodes: ahead.into_iter().map(node).collect(),
            chance: Chance(seed),
            plan,
            next_get: 0,
            wanted: 0,
            next: 0,
            confirmed: BTreeMap::new(),
            log: is_logged.then(Vec::new),
        };
        for at in 0..world.plan.len() {
            world.at(world.plan[at].at, Event::Fault(at));
        }
        for host in 0..HOSTS.len() {
            let at = world.chance.within(0..SECOND);
            world.nodes[host].starts_at = at;
            world.at(at, Event::Start(host));
        }
        world.at(COMMAND_INTERVAL, Event::Command);
        world
    }

    fn at(&mut self, at: Micros, event: Event) {
        self.count += 1;
        self.events.push(Reverse((at.max(self.now), self.count)));
        self.of_event.insert(self.count, event);
    }

    fn after(&mut self, range: Range<Micros>, event: Event) {
        let after = self.chance.within(range);
        self.at(self.now + after, event);
    }

    fn say(&mut self, text: impl FnOnce() -> String) {
        let now = self.now;
        if let Some(log) = &mut self.log {
            log.push(format!("{:>9.6} {}", now as f64 / 1e6, text()));
        }
    }

    pub(super) fn run(&mut self) {
        while let Some(Reverse((at, number))) = self.events.pop() {
            if at > END {
                return;
            }
            self.now = at;
            let event = self.of_event.remove(&number).unwrap();
            self.happens(event);
        }
    }

    fn happens(&mut self, event: Event) {
        match event {
            Event::Fault(at) => self.fault(at),
            Event::Start(host) => self.start(host),
            Event::Heal(host) => self.heal(host),
            Event::Resume(host, process) => {
                if self.nodes[host].process != process || self.nodes[host].hangs_until > self.now {
                    return;
                }
                for _ in 0..self.nodes[host].waiting.len() {
                    if let Some(input) = self.nodes[host].waiting.pop_front() {
                        self.input(host, process, input);
                    }
                }
            }
            Event::Command => self.command(),
            Event::Cut(host, session) => {
                if self.nodes[host].link.session == session && self.nodes[host].link.is_silent {
                    self.end_session(host);
                }
            }
            Event::Timer(host, process) => {
                self.nodes[host].timer = None;
                self.input(host, process, Input::Timer);
            }
            Event::Input(host, process, input) => self.input(host, process, input),
            Event::EndOfQuestion(host, process, question) => {
                if self.nodes[host].process == process {
                    self.end_question(host, question);
                }
            }
            Event::Arrives { to, from, session, what } => self.arrives(to, from, session, what),
        }
    }

    fn fault(&mut self, at: usize) {
        let Planned { lasts, host, fault, .. } = self.plan[at].clone();
        self.say(|| format!("*** {fault:?} of {} for {lasts} µs", HOSTS[host]));
        let until = self.now + lasts;
        match fault {
            Fault::Kill => {
                if self.nodes[host].bench.take().is_some() && self.nodes[host].link.is_up {
                    self.end_session_of_process(host);
                }
                self.nodes[host].process += 1;
                self.nodes[host].questions.clear();
                self.nodes[host].gets.clear();
                self.nodes[host].timer = None;
                self.nodes[host].hangs_until = 0;
                self.nodes[host].waiting.clear();
                let starts = until.max(self.nodes[host].starts_at);
                self.nodes[host].starts_at = starts;
                self.at(starts, Event::Start(host));
            }
            Fault::Hang => {
                let node = &mut self.nodes[host];
                node.hangs_until = node.hangs_until.max(until);
                let (until, process) = (node.hangs_until, node.process);
                self.at(until, Event::Resume(host, process));
            }
            Fault::CleanCut | Fault::SilentCut => {
                let is_clean = matches!(fault, Fault::CleanCut);
                let link = &mut self.nodes[host].link;
                link.cut_until = link.cut_until.max(until);
                let (session, was_up) = (link.session, link.is_up);
                if is_clean && was_up {
                    self.end_session(host);
                } else if was_up && !self.nodes[host].link.is_silent {
                    self.nodes[host].link.is_silent = true;
                    self.after(LEASE, Event::Cut(host, session));
                }
                self.at(until, Event::Heal(host));
            }
            Fault::Storm { lost, late_ms, mixes } => {
                self.nodes[host].link.storm = Some((until, lost, late_ms * MS, mixes));
            }
            Fault::Output => {
                let process = self.nodes[host].process;
                let leads = self.nodes[host]
                    .bench
                    .as_ref()
                    .is_some_and(|bench| bench.host.replica_state() == ReplicaState::Leading);
                if leads {
                    let input = Input::Arrived(muster_service::Arrival::of_message(
                        &space(),
                        order("output"),
                    ));
                    self.input(host, process, input);
                }
            }
            Fault::Set => self.wanted += 1,
        }
    }

    fn start(&mut self, host: usize) {
        let node = &self.nodes[host];
        if node.bench.is_some() || self.now < node.starts_at {
            return;
        }
        let mut bench = Bench::new(Start {
            fleet: space().fleet().clone(),
            instance: instance_of(host, node.process),
            now: Tick(START + self.now + node.ahead),
            settings: ClustererSettings::default(),
            stored: node.stored.clone(),
        });
        (bench.hold_jobs, bench.hold_stores, bench.hold_leader_queries) = (true, true, true);
        let process = node.process;
        let linked = node.link.is_up && !node.link.is_silent;
        self.nodes[host].bench = Some(bench);
        self.say(|| format!("{} starts, linked: {linked}", HOSTS[host]));
        if !linked {
            // A process that begins on a silent link finds no router.
            let link = &mut self.nodes[host].link;
            (link.is_up, link.is_silent) = (false, false);
            link.session += 1;
            link.held.clear();
        }
        self.input(host, process, Input::Started { linked });
        if linked {
            self.tokens_appear(host);
        }
    }

    /// Hands an input to a process, and carries out what follows.
    fn input(&mut self, host: usize, process: u32, input: Input) {
        let now = self.now;
        let node = &mut self.nodes[host];
        if node.process != process || node.bench.is_none() {
            return;
        }
        if node.hangs_until > now {
            return node.waiting.push_back(input);
        }
        let text = self.log.is_some().then(|| in_short(&input));
        let node = &mut self.nodes[host];
        let Some(bench) = &mut node.bench else { return };
        let before = bench.host.replica_state();
        // No two inputs of a process come at the same moment.
        bench.now = Tick(START + now + node.ahead).max(Tick(bench.now.0 + 1));
        bench.input(input);
        let after = bench.host.replica_state();
        let (teams, restarts) = (bench.host.core().teams, bench.host.core().restarts);
        if let Some(text) = text {
            self.say(|| {
                format!("{} ({before:?}) {text}: {after:?}, has {teams}/{restarts}", HOSTS[host])
            });
        }
        self.follow_up(host);
    }

    fn follow_up(&mut self, host: usize) {
        let node = &mut self.nodes[host];
        let (process, ahead) = (node.process, node.ahead);
        let Some(bench) = &mut node.bench else { return };
        let published: Vec<Message> =
            bench.commanded.drain(..).chain(bench.published.drain(..)).collect();
        let asks = std::mem::take(&mut bench.asks);
        let replies = std::mem::take(&mut bench.replies);
        let others = std::mem::take(&mut bench.others);
        let deadline = bench.host.deadline();
        for command in others {
            if let Command::Store(stored) = command {
                self.nodes[host].stored = stored;
                self.after(DISK, Event::Input(host, process, Input::Stored { error: None }));
            }
        }
        for message in published {
            let is_read = matches!(
                message,
                Message::LeaseRenewal(_) | Message::Settings(_) | Message::Outcome(_)
            );
            if is_read {
                for to in 0..HOSTS.len() {
                    self.send(Some(host), to, Carried::Message(Box::new(message.clone())));
                }
            }
        }
        for ask in asks {
            self.ask(host, ask);
        }
        for reply in replies {
            let Some(waiting) = self.nodes[host].gets.remove(&reply.get.0) else { continue };
            match waiting {
                Waiting::Host(asker, process, question) => {
                    let messages = reply.answer.map(|_| reply.messages).unwrap_or_default();
                    self.send(Some(host), asker, Carried::Answer(process, question, messages));
                }
                Waiting::Operator(command) => {
                    let answer = reply.answer.map(|packets| !packets.is_empty());
                    self.answered(host, command, answer);
                }
            }
        }
        if let Some(due) = deadline
            && self.nodes[host].timer.is_none_or(|timer| due < timer)
        {
            self.nodes[host].timer = Some(due);
            let at = due.0.saturating_sub(START + ahead).max(self.now + 1);
            self.at(at, Event::Timer(host, process));
        }
    }
}

/// An input as it is read in a log.
fn in_short(input: &Input) -> String {
    let message = |arrival: &muster_service::Arrival| match arrival.message() {
        Some(Message::LeaseRenewal(renewal)) => {
            format!("renewal of {} {:?}", renewal.instance, renewal.header.revision)
        }
        Some(Message::Settings(announced)) => {
            let settings: Value = serde_json::from_str(&announced.settings).unwrap();
            let (teams, restarts) = (&settings["teams"], &settings["restarts"]);
            let (revision, changed) = (announced.header.revision, &announced.changed);
            format!("settings {revision:?} {teams}/{restarts} {changed:?}")
        }
        Some(Message::Outcome(outcome)) => {
            let CommandOutcome { header, id, refused, changed, .. } = &**outcome;
            format!("outcome {id} {:?} {changed:?} {refused:?}", header.revision)
        }
        other => format!("{other:?}"),
    };
    match input {
        Input::Arrived(arrival) => message(arrival),
        Input::Answered { ask, answers } => {
            format!("answers to {ask:?}: {:?}", answers.iter().map(message).collect::<Vec<_>>())
        }
        Input::Get(get) => format!("get {:?} of {}", get.get, get.selector),
        other => format!("{other:?}"),
    }
}
