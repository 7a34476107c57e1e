//! The whole: services, robots, an operator and a stranger around one router, and an agenda of what
//! happens next. One event at a time is taken from the agenda, and after each the judge is asked.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};
use std::sync::Arc;

use muster_machine::Stored;
use muster_model::id::{FleetId, InstanceId, RobotId, ServiceName};
use muster_model::role::Standing;
use muster_wire::{Key, KeySpace, Message, Packet};
use serde_json::{Value, json};

use super::chance::{Chance, Purpose};
use super::clock::{HostClock, MS, Micros, SECOND};
use super::link::{Damage, Link, State, Way};
use super::log::Log;
use super::machine::Birth;
use super::node::Node;
use super::operator::Operator;
use super::oracle::{Bounds, Breach, Judge, MEMORY, Settled, Verdict};
use super::plan::{Injection, Place};
use super::robots::{Robots, Speech};
use super::router::{Answer, Carried, GetId, LinkId, Router};
use super::sabotage::Saboteur;
use super::{AGREEMENT_TICKS, Sabotage, Scale, Stats, TICK};

/// How long everybody must have agreed without a change before a run ends.
const HELD: Micros = 6 * SECOND;

/// One run in so many goes on past the time within which all must have agreed.
const LONG_RUNS: u64 = 8;

/// How long such a run goes on: longer than the longest interval at which a service asks again.
const LONG: Micros = 12 * SECOND;

/// Most events of a run: far more than one of the longest has.
const MAX_EVENTS: u64 = 20_000_000;

/// What is on the agenda.
#[derive(Debug)]
pub(super) enum Event {
    Turn { node: usize },
    Start { node: usize },
    JobEnded { node: usize, life: u32 },
    Store { node: usize, life: u32, stored: Stored },
    Reply { node: usize, life: u32, get: GetId, answer: Arc<Answer> },
    Speak { robot: usize, life: u32, speech: Speech },
    RobotStarts { robot: usize, life: u32 },
    AtRouter { link: LinkId, session: u32, carried: Carried },
    AtClient { link: LinkId, session: u32, carried: Carried },
    TokensGone { link: LinkId, keys: Vec<Arc<str>> },
    Lease { link: LinkId, session: u32 },
    Heal { link: LinkId },
    LinkUp { link: LinkId },
    GetEnds { get: GetId },
    AskAgain { fetch: u64, pattern: String },
    Operate,
    SetLater { service: ServiceName, patch: String },
    Inject(usize),
    StormOver,
    Poll,
}

#[derive(Debug)]
struct Scheduled {
    at: Micros,
    number: u64,
    event: Event,
}

impl PartialEq for Scheduled {
    fn eq(&self, other: &Self) -> bool {
        (self.at, self.number) == (other.at, other.number)
    }
}

impl Eq for Scheduled {}

impl PartialOrd for Scheduled {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Scheduled {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.at, self.number).cmp(&(other.at, other.number))
    }
}

/// A fetch of a core that is under way.
#[derive(Debug)]
pub(super) struct Fetch {
    pub(super) node: usize,
    pub(super) life: u32,
    pub(super) fetch: u32,
    /// Until then, what nobody answers is asked again …
    pub(super) until: Micros,
    /// … if it is one of these.
    pub(super) patient: BTreeSet<String>,
    pub(super) open: usize,
    pub(super) messages: Vec<Message>,
}

/// Who waits for a get.
#[derive(Debug)]
pub(super) enum Asker {
    Fetch {
        fetch: u64,
        pattern: String,
    },
    Operator(ServiceName),
    /// A console that joins when everybody has agreed, and what was published last by then.
    LateJoiner(Message),
}

/// A get as who asked knows it.
#[derive(Debug)]
pub(super) struct Pending {
    pub(super) asker: Asker,
    pub(super) answers: Vec<Arc<Answer>>,
}

/// The whole.
pub(super) struct World {
    pub(super) seed: u64,
    pub(super) space: KeySpace,
    pub(super) now: Micros,
    agenda: BinaryHeap<Reverse<Scheduled>>,
    scheduled: u64,
    pub(super) nodes: Vec<Node>,
    pub(super) links: Vec<Link>,
    pub(super) robots: Robots,
    pub(super) router: Router,
    pub(super) judge: Judge,
    pub(super) log: Log,
    pub(super) injections: Vec<Injection>,
    pub(super) operator: Operator,
    pub(super) fetches: BTreeMap<u64, Fetch>,
    pub(super) next_fetch: u64,
    pub(super) pending: BTreeMap<GetId, Pending>,
    pub(super) damage: Damage,
    pub(super) saboteur: Saboteur,
    pub(super) files: BTreeMap<ServiceName, Value>,
    /// The names of robots on the bus, good and forged, and when each was last there.
    pub(super) names: BTreeMap<RobotId, Micros>,
    pub(super) max_robots: usize,
    pub(super) stats: Stats,
    storm: Micros,
    storm_over: bool,
    settled: Option<(Micros, Settled)>,
    differs: String,
    finished: bool,
    breach: Option<Breach>,
}

/// The links of everybody: services first, then robots, an operator and a stranger.
pub(super) fn places(scale: &Scale) -> Vec<Place> {
    let services = ServiceName::ALL.into_iter().flat_map(|service| {
        (0..scale.instances).map(move |instance| Place::Service(service, instance))
    });
    services.chain((0..scale.robots).map(Place::Robot)).collect()
}

/// What the configuration files of a seed say.
fn files(chance: &mut Chance, robots: usize) -> BTreeMap<ServiceName, Value> {
    let max_robots = robots + chance.below(12) + 4;
    let ingest = json!({
        "stale_after_s": chance.real(1.0, 2.5),
        "gone_after_s": chance.real(3.0, 8.0),
        "tick_hz": if chance.percent(70) { 10.0 } else { 4.0 },
        "max_robots": max_robots,
    });
    let clusterer = json!({"teams": chance.between(1, 4)});
    BTreeMap::from([
        (ServiceName::Ingest, ingest),
        (ServiceName::Embedder, json!({})),
        (ServiceName::Clusterer, clusterer),
        (ServiceName::Auditor, json!({})),
    ])
}

impl World {
    pub(super) fn new(
        seed: u64,
        scale: &Scale,
        injections: Vec<Injection>,
        sabotage: Option<Sabotage>,
        logged: bool,
    ) -> Self {
        #[expect(clippy::expect_used, reason = "a simulation without a fleet would prove nothing")]
        let space = KeySpace::new(FleetId::new("fleet").expect("this is a name"));
        let mut chance = Chance::new(seed, Purpose::Fleet, 1);
        let files = files(&mut chance, scale.robots);
        let mut nodes = Vec::new();
        for (link, place) in places(scale).into_iter().enumerate() {
            let Place::Service(service, instance) = place else { continue };
            let off = |chance: &mut Chance, most: u64| {
                i64::try_from(chance.between(0, 2 * most)).unwrap_or_default()
                    - i64::try_from(most).unwrap_or_default()
            };
            let host =
                HostClock { ahead: off(&mut chance, 3 * SECOND), drift: off(&mut chance, 200) };
            let own = Chance::new(seed, Purpose::Node, link);
            nodes.push(Node::new(&space, service, instance, link, host, own));
        }
        let robots = Robots::new(seed, scale.robots, nodes.len());
        let many = nodes.len() + robots.all.len() + 2;
        let links = (0..many).map(|link| Link::new(Chance::new(seed, Purpose::Link, link)));
        let clusterer = files.get(&ServiceName::Clusterer);
        let teams = clusterer.and_then(|file| file.get("teams")?.as_u64());
        let max_robots =
            files.get(&ServiceName::Ingest).and_then(|file| file.get("max_robots")?.as_u64());
        let mut world = Self {
            seed,
            space,
            now: 0,
            agenda: BinaryHeap::new(),
            scheduled: 0,
            links: links.collect(),
            operator: Operator::new(many - 2, teams),
            max_robots: usize::try_from(max_robots.unwrap_or_default()).unwrap_or_default(),
            nodes,
            robots,
            router: Router::default(),
            judge: Judge::default(),
            log: Log::new(logged),
            injections,
            fetches: BTreeMap::new(),
            next_fetch: 0,
            pending: BTreeMap::new(),
            damage: Damage::default(),
            saboteur: Saboteur::new(sabotage),
            files,
            names: BTreeMap::new(),
            stats: Stats::default(),
            storm: scale.storm,
            storm_over: false,
            settled: None,
            differs: String::new(),
            finished: false,
            breach: None,
        };
        world.fill_agenda(&mut chance, scale.fleet);
        world
    }

    fn fill_agenda(&mut self, chance: &mut Chance, fleet: usize) {
        for node in 0..self.nodes.len() {
            self.schedule(chance.between(0, SECOND), Event::Start { node });
        }
        for robot in 0..fleet.min(self.robots.all.len()) {
            // Most are there from the beginning; some come while the fleet is at work.
            let late = if chance.percent(20) { self.storm / 2 } else { SECOND };
            let at = chance.between(0, late);
            self.schedule(at, Event::RobotStarts { robot, life: 0 });
        }
        for number in 0..self.injections.len() {
            self.schedule(self.injections[number].at, Event::Inject(number));
        }
        self.schedule(0, Event::Operate);
        self.schedule(self.storm, Event::StormOver);
    }

    /// The link of the stranger.
    pub(super) fn stranger(&self) -> LinkId {
        self.links.len() - 1
    }

    /// Puts something on the agenda.
    pub(super) fn schedule(&mut self, at: Micros, event: Event) {
        self.scheduled += 1;
        let scheduled = Scheduled { at: at.max(self.now), number: self.scheduled, event };
        self.agenda.push(Reverse(scheduled));
    }

    /// Takes in what a rule says. The first breach ends the run.
    pub(super) fn judged(&mut self, verdict: Verdict) {
        if let Err(breach) = verdict
            && self.breach.is_none()
        {
            self.log.line(self.now, format_args!("BROKEN: {}: {}", breach.promise, breach.seen));
            self.breach = Some(breach);
        }
    }

    /// What a service may hold now.
    pub(super) fn bounds(&self) -> Bounds {
        let remembered = |at: &&Micros| **at + MEMORY >= self.now;
        let names = self.names.values().filter(remembered).count();
        Bounds { max_robots: self.max_robots, names }
    }

    /// Runs to the end, or to the first broken promise.
    pub(super) fn run(mut self) -> (Stats, Option<(Breach, Micros)>, Vec<String>) {
        while let Some(Reverse(next)) = self.agenda.pop() {
            self.now = next.at;
            self.stats.events += 1;
            self.happen(next.event);
            if self.stats.events > MAX_EVENTS {
                let seen = "the run does not end".to_owned();
                self.judged(Err(Breach { promise: "a run ends", seen }));
            }
            if self.finished || self.breach.is_some() {
                break;
            }
        }
        self.stats.simulated = self.now;
        self.stats.lost = self.damage.lost;
        self.stats.repeated = self.damage.repeated;
        self.stats.mixed = self.damage.mixed;
        self.stats.takeovers = self.judge.order.takeovers;
        (self.stats, self.breach.map(|breach| (breach, self.now)), self.log.into_lines())
    }

    fn happen(&mut self, event: Event) {
        match event {
            Event::Turn { node } => self.turn(node),
            Event::Start { node } => self.start_node(node),
            Event::JobEnded { node, life } => self.job_ended(node, life),
            Event::Store { node, life, stored } => {
                if self.nodes[node].life == life {
                    self.nodes[node].stored = stored;
                }
            }
            Event::Reply { node, life, get, answer } => {
                if self.nodes[node].life == life {
                    self.send(self.nodes[node].link, Way::Up, &Carried::Answer { get, answer });
                }
            }
            Event::Speak { robot, life, speech } => self.speak(robot, life, speech),
            Event::RobotStarts { robot, life } => self.start_robot(robot, life),
            Event::AtRouter { link, session, carried } => {
                if self.links[link].session == session {
                    self.at_router(link, carried);
                }
            }
            Event::AtClient { link, session, carried } => {
                if self.links[link].session == session {
                    self.at_client(link, &carried);
                }
            }
            Event::TokensGone { link, keys } => self.tokens_gone(link, &keys),
            Event::Lease { link, session } => {
                if self.links[link].session == session && self.links[link].state == State::Silent {
                    self.log.line(self.now, format_args!("the lease of link {link} is over"));
                    self.lose_session(link);
                }
            }
            Event::Heal { link } => self.heal(link),
            Event::LinkUp { link } => self.link_up(link),
            Event::GetEnds { get } => self.get_ends(get),
            Event::AskAgain { fetch, pattern } => self.ask_for_fetch(fetch, pattern),
            Event::Operate => self.operate(),
            Event::SetLater { service, patch } => self.operator.wants(service, patch),
            Event::Inject(number) => self.inject(number),
            Event::StormOver => self.end_storm(),
            Event::Poll => self.poll(),
        }
    }

    fn start_node(&mut self, index: usize) {
        let node = &self.nodes[index];
        let link = node.link;
        let wait = node.down_until.max(self.links[link].cut_until);
        if node.process.is_some() {
            return;
        }
        if wait > self.now {
            // A process waits for its router; then it goes on at once.
            self.schedule(wait, Event::Start { node: index });
            return;
        }
        let clock = node.host.start(self.now);
        let instance = format!("{}-{}-{}", node.service, node.instance, node.life);
        let (Ok(instance), file) = (InstanceId::new(&instance), self.files.get(&node.service))
        else {
            return;
        };
        let birth = Birth {
            fleet: self.space.fleet().clone(),
            instance: instance.clone(),
            now: clock.tick(self.now),
            stored: node.stored.clone(),
            file: file.cloned().unwrap_or(Value::Null),
        };
        let token = self.space.format(&Key::ServiceToken(node.service, instance));
        let node = &mut self.nodes[index];
        let machine = node.kind.start(birth);
        node.begin(machine, clock, token.into());
        node.busy_until = self.now;
        self.log.line(self.now, format_args!("{} starts", self.nodes[index].name()));
        self.links[link].state = State::Up;
        self.declare(link);
        self.kick(index);
    }

    fn start_robot(&mut self, index: usize, life: u32) {
        let robot = &mut self.robots.all[index];
        if robot.life != life || robot.runs {
            return;
        }
        robot.start();
        let (link, life) = (robot.link, robot.life);
        self.log.line(self.now, format_args!("{} starts", self.robots.all[index].name));
        self.declare(link);
        for (speech, after) in Speech::ALL.into_iter().zip([10, 20, 30, 40]) {
            self.schedule(self.now + after * MS, Event::Speak { robot: index, life, speech });
        }
    }

    /// A robot says something on one of its streams, and will again.
    fn speak(&mut self, index: usize, life: u32, speech: Speech) {
        if self.robots.all[index].life != life || !self.robots.all[index].runs {
            return;
        }
        self.robots.tell(self.now.min(self.storm));
        let next = self.robots.next_speech(index, speech);
        self.schedule(self.now + next, Event::Speak { robot: index, life, speech });
        if let Some(packet) = self.robots.say(&self.space, self.now, index, speech) {
            self.put(self.robots.all[index].link, packet);
        }
    }

    /// Somebody puts a message.
    pub(super) fn put(&mut self, link: LinkId, packet: Packet) {
        self.send(link, Way::Up, &Carried::Put(Arc::new(packet)));
    }

    /// Everything that goes wrong has an end: links are mended, processes run, and the robots stand
    /// still and go on to say what they said last.
    fn end_storm(&mut self) {
        self.storm_over = true;
        self.log.line(self.now, format_args!("the storm is over"));
        for link in 0..self.links.len() {
            self.links[link].calm();
            self.links[link].cut_until = self.now;
            self.heal(link);
        }
        for index in 0..self.nodes.len() {
            let node = &mut self.nodes[index];
            node.slow = (0, 0);
            node.slow_jobs = (0, 0);
            node.panics_until = 0;
            node.down_until = self.now;
            node.busy_until = node.busy_until.min(self.now);
            self.start_node(index);
            self.kick(index);
        }
        self.robots.tell(self.storm);
        self.schedule(self.now + TICK, Event::Poll);
    }

    /// Looks whether everybody agrees.
    fn poll(&mut self) {
        let since = self.now - self.storm;
        let limit = AGREEMENT_TICKS * TICK;
        let agreed = {
            let witness = self.operator.witness(&self.robots, &self.nodes);
            if self.operator.is_busy() {
                Err("an operator's settings are not confirmed".to_owned())
            } else {
                one_holds_each_role(&self.nodes).and_then(|()| self.judge.agreement(&witness))
            }
        };
        match (agreed, self.settled.take()) {
            (Ok(now), None) => {
                self.log.line(self.now, format_args!("everybody agrees"));
                if now.is_of_somebody() {
                    self.join_late();
                }
                self.settled = Some((since, now));
            }
            (Ok(now), Some((at, before))) => match self.judge.unchanged(&before) {
                Ok(()) => self.settled = Some((at, before)),
                Err(breach) if since > limit => self.judged(Err(breach)),
                Err(_) => self.settled = Some((since, now)),
            },
            (Err(differs), _) => {
                if differs != self.differs {
                    self.log.line(self.now, format_args!("they differ: {differs}"));
                }
                self.differs = differs;
            }
        }
        if since > limit && self.settled.is_none() {
            let promise = "after the last fault all agree within the stated time";
            let seen = self.differs.clone();
            self.judged(Err(Breach { promise, seen }));
            return;
        }
        if let Some((at, _)) = &self.settled {
            self.stats.agreement = *at;
            let is_long = self.seed.is_multiple_of(LONG_RUNS);
            self.finished = if is_long { since > limit + LONG } else { since >= at + HELD };
        }
        self.schedule(self.now + TICK, Event::Poll);
    }

    /// Makes sure that a service takes its next turn in time.
    pub(super) fn kick(&mut self, index: usize) {
        let Some(at) = self.nodes[index].next_turn(self.now) else { return };
        if self.nodes[index].turn_at.is_none_or(|planned| at < planned) {
            self.nodes[index].turn_at = Some(at);
            self.schedule(at, Event::Turn { node: index });
        }
    }
}

/// Of the instances of a service, one holds its role and all others stand by.
fn one_holds_each_role(nodes: &[Node]) -> Result<(), String> {
    for service in ServiceName::ALL {
        let standings: Vec<Standing> = nodes
            .iter()
            .filter(|node| node.service == service)
            .filter_map(|node| Some(node.process.as_ref()?.machine.standing()))
            .collect();
        let holding = standings.iter().filter(|standing| **standing == Standing::Holding).count();
        let waiting = standings.iter().filter(|standing| **standing == Standing::Standby).count();
        if holding != 1 || holding + waiting != standings.len() {
            return Err(format!("the instances of {service} are {standings:?}"));
        }
    }
    Ok(())
}
