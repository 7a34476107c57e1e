//! The whole: services, robots, an operator and an attacker around one router, and an agenda of what
//! happens next. One event at a time is taken from the agenda, and after each the oracle is asked.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};
use std::sync::Arc;

use muster_model::history::RecordingReport;
use muster_model::id::{FleetId, InstanceId, RobotId, ServiceName};
use muster_model::role::ReplicaState;
use muster_service::{AskId, Stored};
use muster_wire::{Key, KeySpace, Message, Packet};
use serde_json::{Value, json};

use super::browsers::{BrowserEvent, Browsers};
use super::busy::Freshness;
use super::chance::{Chance, Purpose};
use super::clock::{HostClock, MS, Micros, SECOND};
use super::host::ProcessStart;
use super::link::{Damage, Link, State, Way};
use super::log::Log;
use super::mutants::Mutator;
use super::node::Node;
use super::operator::Operator;
use super::oracle::viewed::SCENE_LIFETIME;
use super::oracle::{ALERTED_WITHIN, Agreed, Bounds, Breach, MEMORY, Oracle, Verified};
use super::outages::{Outages, Standing};
use super::plan::{Fault, Injection, Place};
use super::proposer::{AtRest, Errand};
use super::robots::{RobotStream, Robots};
use super::ros::{Ros, RosEvent};
use super::router::{Answer, BusGetId, Carried, LinkId, Router};
use super::viewers::{ViewerEvent, Viewers};
use super::{AGREEMENT_TICKS, Mutant, Scale, Stats, TICK};

/// How long all must have agreed without a change before a run ends: viewers believe services that have lost all state, and
/// their terms with it, after five seconds and a heartbeat, and those of ROS draw a team around its robots with the next division.
const AGREED_TIME: Micros = 8 * SECOND;

/// How much longer where viewers of Foxglove watch: a slow one may not receive that a team has ended, and draws it until its
/// lifetime is over.
const DRAWN_TIME: Micros = SCENE_LIFETIME;

/// How long after the storm nothing is about to change by itself any more: the last new superior is known
/// within two seconds, counts as new orders for ten, and the fleet is at rest a second later. A division that
/// was agreed on before changes then, whether the power is cut or not.
const ORDERS_TIME: Micros = 14 * SECOND;

/// The same from the moment on in which all agree: an embedder whose fetches were lost in the storm knows the last
/// superior only then. By its end the agreement is on the disks as well.
pub(super) const AGREED_ORDERS_TIME: Micros = 12 * SECOND;

/// For how long after the last fault a seat may still be kept for a team that is absent: a minute from its last robot on, which
/// is known to have left within eight seconds, and a second until that is divided.
const SEATS_TIME: Micros = 69 * SECOND;

/// How long it may take until all agree on a division that fills such a place: it is audited and reaches the robots.
const SEAT_FILLED_TIME: Micros = SECOND;

/// One run in so many continues past the time within which all must have agreed.
const LONG_RUN_EVERY: u64 = 8;

/// How long such a run continues: longer than the longest interval at which a service asks again.
const LONG_RUN_TIME: Micros = 12 * SECOND;

/// How long all must have agreed until what was promised of an outage has held: what waits to be published has been by then.
const STANDING_TIME: Micros = 6 * SECOND;

/// In one run of so many, some hosts of services have a clock that is off by years.
const WRONG_CLOCKS_EVERY: u64 = 6;

/// Most events of a run: far more than one of the longest has.
const MAX_EVENTS: u64 = 20_000_000;

/// What is on the agenda.
#[derive(Debug)]
pub(super) enum Event {
    Step { node: usize },
    Start { node: usize },
    JobEnded { node: usize, life: u32 },
    Stored { node: usize, life: u32, stored: Stored },
    Kept { node: usize, life: u32, content: Vec<u8> },
    Report { robot: usize, life: u32, stream: RobotStream },
    RobotStarts { robot: usize, life: u32 },
    AtRouter { link: LinkId, session: u32, carried: Carried },
    AtClient { link: LinkId, session: u32, carried: Carried },
    TokensGone { link: LinkId, keys: Vec<Arc<str>> },
    Lease { link: LinkId, session: u32 },
    Heal { link: LinkId },
    LinkUp { link: LinkId },
    GetEnds { get: BusGetId },
    NoFurtherAnswer { get: BusGetId },
    Operate,
    SetLater { service: ServiceName, patch: String },
    AskForProposal(Box<Errand>),
    ListProposals,
    Inject(usize),
    StormOver,
    WriteRecords { node: usize, life: u32 },
    Written { node: usize, life: u32, report: Box<RecordingReport> },
    DiskHasRoom { node: usize },
    Browser(BrowserEvent),
    Ros(RosEvent),
    Viewer(ViewerEvent),
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

/// What waits for a get.
#[derive(Debug)]
pub(super) enum Asker {
    /// The host of a process.
    Host { node: usize, life: u32, ask: AskId },
    /// The operator, about the settings of a service, and how often that had lost its disk.
    Operator(ServiceName, u32),
    /// A console that joins when all have agreed, and what was published last by then.
    LateJoiner(Message),
    /// An operator, about a proposal, and whether one planner led and the others stood by when the get was sent.
    Proposer(Box<Errand>, bool),
    /// The bridge to ROS, by the number of its process.
    RosBridge(u32),
    /// Somebody who only wants it answered.
    Nobody,
}

/// A get as its sender knows it.
#[derive(Debug)]
pub(super) struct Pending {
    pub(super) asker: Asker,
    pub(super) answers: Vec<Arc<Answer>>,
    /// How long after an answer a further one is waited for.
    pub(super) further_within: Option<Micros>,
    /// When it ends unless another answer comes.
    pub(super) ends: Micros,
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
    pub(super) oracle: Oracle,
    pub(super) log: Log,
    pub(super) injections: Vec<Injection>,
    /// Whether the clocks of all services are right all the time, to some seconds.
    pub(super) clocks_agree: bool,
    pub(super) operator: Operator,
    pub(super) browsers: Browsers,
    pub(super) viewers: Viewers,
    pub(super) ros: Option<Ros>,
    attacker: LinkId,
    pub(super) pending: BTreeMap<BusGetId, Pending>,
    pub(super) damage: Damage,
    pub(super) mutator: Mutator,
    pub(super) freshness: Freshness,
    pub(super) files: BTreeMap<ServiceName, Value>,
    /// The names of robots on the bus, good and forged, and when each was last there.
    pub(super) names: BTreeMap<RobotId, Micros>,
    /// When a division was published last.
    pub(super) division_at: Micros,
    pub(super) max_robots: usize,
    pub(super) stats: Stats,
    storm: Micros,
    storm_over: bool,
    /// Since when nothing more goes wrong.
    quiet_since: Micros,
    /// What is to be lost once all agree.
    pub(super) outages: Outages,
    /// What becomes of a proposal while nothing else changes.
    pub(super) at_rest: Option<AtRest>,
    /// What all had agreed on when something was lost, until they agree again.
    pub(super) stands: Option<Standing>,
    pub(super) settled: Option<(Micros, Agreed)>,
    /// When a team last took the place of one that is absent, after an agreement.
    seat_filled: Micros,
    /// Since when all are about to agree on that.
    seat_being_filled: Option<Micros>,
    /// A console is to join now that all have agreed.
    joins_late: bool,
    differs: String,
    finished: bool,
    breach: Option<Breach>,
}

/// All links: services first, then robots, an operator and an attacker.
pub(super) fn places(scale: &Scale) -> Vec<Place> {
    let services = ServiceName::PIPELINE.into_iter().flat_map(|service| {
        (0..scale.instances).map(move |instance| Place::Service(service, instance))
    });
    services.chain((0..scale.robots).map(Place::Robot)).collect()
}

/// The configuration files of a seed.
fn files(seed: u64, chance: &mut Chance, scale: &Scale) -> BTreeMap<ServiceName, Value> {
    let max_robots = scale.robots + chance.below(12) + 4 + scale.ros;
    let ingest = json!({
        "stale_after_s": chance.real(1.0, 2.5),
        "gone_after_s": chance.real(3.0, 8.0),
        "tick_hz": if chance.percent(70) { 10.0 } else { 4.0 },
        "max_robots": max_robots,
    });
    let teams = chance.between(1, 4);
    // A chance of its own: how the number of teams is given has no bearing on clocks and links.
    let mut form = Chance::new(seed, Purpose::Fleet, 3);
    let clusterer = match form.below(4) {
        0 => json!({"teams": "auto"}),
        1 => json!({"teams": {"from": teams, "to": teams + 2}, "dwell_s": form.real(0.0, 2.0)}),
        _ => json!({"teams": teams}),
    };
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
        mutant: Option<Mutant>,
        logged: bool,
    ) -> Self {
        #[expect(clippy::expect_used, reason = "a simulation without a fleet would prove nothing")]
        let space = KeySpace::new(FleetId::new("fleet").expect("this is a name"));
        let mut chance = Chance::new(seed, Purpose::Fleet, 1);
        let files = files(seed, &mut chance, scale);
        let mut nodes = Vec::new();
        let sets_clock = |injection: &Injection| {
            // Nobody follows the terms of a historian.
            matches!(injection.fault, Fault::Clock { at: Place::Service(service, _), .. }
                if service != ServiceName::Historian)
        };
        let mut clocks_agree = !injections.iter().any(sets_clock);
        let mut wrong = Chance::new(seed, Purpose::Fleet, 4);
        for (link, place) in places(scale).into_iter().enumerate() {
            let Place::Service(service, instance) = place else { continue };
            let offset = |chance: &mut Chance, most: u64| {
                i64::try_from(chance.between(0, 2 * most)).unwrap_or_default()
                    - i64::try_from(most).unwrap_or_default()
            };
            let ahead = offset(&mut chance, 3 * SECOND);
            let mut clock = HostClock { ahead, drift: offset(&mut chance, 200) };
            if seed % WRONG_CLOCKS_EVERY == 3 && wrong.percent(40) {
                clock.ahead = wrong.pick(&HostClock::WRONG).copied().unwrap_or_default();
                clocks_agree = false;
            }
            let own = Chance::new(seed, Purpose::Node, link);
            nodes.push(Node::new(&space, service, instance, link, clock, own));
        }
        let pipeline = nodes.len();
        for instance in 0..scale.instances {
            let (link, service) = (nodes.len(), ServiceName::Historian);
            let (clock, own) = (HostClock::default(), Chance::new(seed, Purpose::Node, link));
            nodes.push(Node::new(&space, service, instance, link, clock, own));
        }
        let historians = nodes.len() - pipeline;
        for instance in 0..scale.instances {
            let (link, service) = (nodes.len(), ServiceName::Planner);
            let (clock, own) = (HostClock::default(), Chance::new(seed, Purpose::Node, link));
            nodes.push(Node::new(&space, service, instance, link, clock, own));
        }
        let planners = nodes.len() - pipeline - historians;
        let robots = Robots::new(seed, scale.robots, nodes.len());
        let count = nodes.len() + robots.all.len() + 2;
        // Historians and planners have numbers behind all others, so that the chance of those does not depend on them.
        let number = |link: usize| match link {
            _ if link < pipeline => link,
            _ if link < pipeline + historians + planners => count - planners + link,
            _ => link - historians - planners,
        };
        let links =
            (0..count).map(|link| Link::new(Chance::new(seed, Purpose::Link, number(link))));
        let mut links: Vec<Link> = links.collect();
        let natives: Vec<RobotId> = robots.all.iter().map(|robot| robot.name.clone()).collect();
        let ros = Ros::new(seed, count, &natives);
        links.extend(ros.iter().map(|_| Link::new(Chance::new(seed, Purpose::Ros, 2))));
        let clusterer = files.get(&ServiceName::Clusterer);
        let teams = clusterer.and_then(|file| file.get("teams")?.as_u64());
        let max_robots =
            files.get(&ServiceName::Ingest).and_then(|file| file.get("max_robots")?.as_u64());
        let browsers = Browsers::new(seed, space.fleet());
        let viewers = Viewers::new(seed, space.fleet());
        let mut world = Self {
            seed,
            space,
            now: 0,
            agenda: BinaryHeap::new(),
            scheduled: 0,
            links,
            ros,
            attacker: count - 1,
            operator: Operator::new(count - 2, teams),
            browsers,
            viewers,
            max_robots: usize::try_from(max_robots.unwrap_or_default()).unwrap_or_default(),
            nodes,
            robots,
            router: Router::default(),
            oracle: Oracle::default(),
            log: Log::new(logged),
            injections,
            clocks_agree,
            pending: BTreeMap::new(),
            damage: Damage::default(),
            mutator: Mutator::new(mutant),
            freshness: Freshness::default(),
            files,
            names: BTreeMap::new(),
            division_at: 0,
            stats: Stats::default(),
            storm: scale.storm,
            storm_over: false,
            quiet_since: scale.storm,
            outages: Outages::default(),
            at_rest: None,
            stands: None,
            settled: None,
            seat_filled: 0,
            seat_being_filled: None,
            joins_late: false,
            differs: String::new(),
            finished: false,
            breach: None,
        };
        if scale.instances == 1 {
            world.oracle.one_gives_ids();
        }
        world.fill_agenda(&mut chance, scale.fleet);
        world
    }

    fn fill_agenda(&mut self, chance: &mut Chance, fleet: usize) {
        let mut historians = Chance::new(self.seed, Purpose::Fleet, 5);
        let mut planners = Chance::new(self.seed, Purpose::Fleet, 6);
        for node in 0..self.nodes.len() {
            let chance = match self.nodes[node].service {
                ServiceName::Historian => &mut historians,
                ServiceName::Planner => &mut planners,
                _ => &mut *chance,
            };
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
        for (at, event) in self.browsers.agenda(self.storm) {
            self.schedule(at, Event::Browser(event));
        }
        let storm = self.storm;
        for (at, event) in self.viewers.agenda(storm) {
            self.schedule(at, Event::Viewer(event));
        }
        let of_ros = self.ros.as_mut().map(|ros| ros.agenda(storm)).unwrap_or_default();
        for (at, event) in of_ros {
            self.schedule(at, Event::Ros(event));
        }
        self.schedule(0, Event::Operate);
        self.schedule(self.storm, Event::StormOver);
    }

    /// The link of the attacker.
    pub(super) fn attacker(&self) -> LinkId {
        self.attacker
    }

    /// When the storm ends, and all motion with it.
    pub(super) fn storm_ends(&self) -> Micros {
        self.storm
    }

    /// Since when nothing more goes wrong.
    pub(super) fn quiet_since(&self) -> Micros {
        self.quiet_since
    }

    /// Puts something on the agenda.
    pub(super) fn schedule(&mut self, at: Micros, event: Event) {
        self.scheduled += 1;
        let scheduled = Scheduled { at: at.max(self.now), number: self.scheduled, event };
        self.agenda.push(Reverse(scheduled));
    }

    /// Accepts the result of a rule. The first breach ends the run.
    pub(super) fn require(&mut self, checked: Verified) {
        if let Err(breach) = checked
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
            self.require(self.freshness.check(self.now));
            if self.stats.events > MAX_EVENTS {
                let seen = "the run does not end".to_owned();
                self.require(Err(Breach { promise: "a run ends", seen }));
            }
            if self.finished || self.breach.is_some() {
                break;
            }
        }
        self.stats.simulated = self.now;
        self.stats.lost = self.damage.lost;
        self.stats.repeated = self.damage.repeated;
        self.stats.mixed = self.damage.mixed;
        self.stats.takeovers = self.oracle.order.takeovers;
        (self.stats, self.breach.map(|breach| (breach, self.now)), self.log.into_lines())
    }

    /// Runs to a moment.
    #[cfg(test)]
    pub(super) fn run_until(&mut self, moment: Micros) {
        while let Some(Reverse(next)) = self.agenda.pop()
            && next.at <= moment
        {
            self.now = next.at;
            self.happen(next.event);
        }
    }

    fn happen(&mut self, event: Event) {
        match event {
            Event::Step { node } => self.step(node),
            Event::Start { node } => self.start_node(node),
            Event::JobEnded { node, life } => self.job_ended(node, life),
            Event::Stored { node, life, stored } => self.stored(node, life, stored),
            Event::Kept { node, life, content } => self.kept(node, life, content),
            Event::Report { robot, life, stream } => self.report(robot, life, stream),
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
            Event::NoFurtherAnswer { get } => {
                if self.pending.get(&get).is_some_and(|pending| self.now >= pending.ends) {
                    self.get_ends(get);
                }
            }
            Event::Operate => self.operate(),
            Event::SetLater { service, patch } => self.operator.wants(service, patch),
            Event::AskForProposal(errand) => self.propose(*errand),
            Event::ListProposals => self.list_proposals(),
            Event::Inject(number) => self.inject(number),
            Event::StormOver => self.end_storm(),
            Event::WriteRecords { node, life } => self.write_records(node, life),
            Event::Written { node, life, report } => self.written(node, life, report),
            Event::DiskHasRoom { node } => self.free_disk(node),
            Event::Browser(event) => self.browser_event(event),
            Event::Ros(event) => self.ros_event(event),
            Event::Viewer(event) => self.viewer_event(event),
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
            // A process waits for its router; then it continues at once.
            self.schedule(wait, Event::Start { node: index });
            return;
        }
        let clock = node.machine_clock.start(self.now);
        let instance = format!("{}-{}-{}", node.service, node.instance, node.life);
        let (Ok(instance), file) = (InstanceId::new(&instance), self.files.get(&node.service))
        else {
            return;
        };
        let start = ProcessStart {
            fleet: self.space.fleet().clone(),
            instance: instance.clone(),
            now: clock.tick(self.now),
            stored: node.stored.clone(),
            file: file.cloned().unwrap_or(Value::Null),
        };
        let token = self.space.format(&Key::ServiceToken(node.service, instance));
        let node = &mut self.nodes[index];
        let host = node.kind.start(start);
        node.begin(host, clock, token.into());
        node.busy_until = self.now;
        node.recording_since = self.now;
        if node.disk.is_some() {
            let life = node.life;
            self.schedule(self.now, Event::WriteRecords { node: index, life });
        }
        self.log.line(self.now, format_args!("{} starts", self.nodes[index].name()));
        self.links[link].state = State::Up;
        self.declare(link);
        self.schedule_step(index);
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
        for (stream, after) in RobotStream::ALL.into_iter().zip([10, 20, 30, 40]) {
            self.schedule(self.now + after * MS, Event::Report { robot: index, life, stream });
        }
    }

    /// A robot reports on one of its streams, and will again.
    fn report(&mut self, index: usize, life: u32, stream: RobotStream) {
        if self.robots.all[index].life != life || !self.robots.all[index].runs {
            return;
        }
        self.robots.observe(self.now.min(self.storm));
        let next = self.robots.next_report(index, stream);
        self.schedule(self.now + next, Event::Report { robot: index, life, stream });
        if let Some(packet) = self.robots.report(&self.space, self.now, index, stream) {
            self.put(self.robots.all[index].link, packet);
        }
    }

    /// Puts a packet on the bus.
    pub(super) fn put(&mut self, link: LinkId, packet: Packet) {
        self.send(link, Way::Up, &Carried::Put(Arc::new(packet)));
    }

    /// Ends all faults: links are restored, processes run, and the robots stand still and republish their last
    /// reports.
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
            self.schedule_step(index);
        }
        self.calm_ros();
        self.viewers.rest(self.now);
        self.robots.observe(self.storm);
        self.schedule(self.now + TICK, Event::Poll);
    }

    /// Checks whether all agree.
    fn poll(&mut self) {
        let since = self.now.saturating_sub(self.quiet_since);
        let limit = AGREEMENT_TICKS * TICK;
        let agreed = {
            let mut ground_truth = self.operator.ground_truth(&self.robots, &self.nodes);
            if let Some(ros) = &self.ros {
                ros.add_truth(self.storm, &mut ground_truth);
            }
            if self.outages.goes_on(self.now) {
                Err("a team is cut off".to_owned())
            } else if self.operator.is_busy() {
                Err("an operator's settings are not confirmed".to_owned())
            } else {
                one_leads_each_service(&self.nodes)
                    .and_then(|()| self.oracle.agreement(&ground_truth))
            }
        };
        if agreed.is_ok() {
            self.seat_being_filled = None;
        }
        match (agreed, self.settled.take()) {
            (Ok(now), None) => {
                self.log.line(self.now, format_args!("all agree"));
                self.joins_late = now.has_robots();
                self.settled = Some((since, now));
            }
            (Ok(now), Some((at, before))) => match self.oracle.unchanged(&before) {
                Ok(()) => {
                    if since >= at + STANDING_TIME {
                        self.check_standing();
                    }
                    // Which moves are held back may be another thing by now.
                    self.settled = Some((at, now));
                }
                Err(_) if since <= limit => self.settled = Some((since, now)),
                // The seat of a team that is absent may end: its place is filled, and moves that waited for it follow.
                Err(_) if self.may_fill_seats(&before) && since <= SEATS_TIME => {
                    self.seat_filled = self.now;
                    self.settled = Some((at, now));
                }
                Err(breach) => self.require(Err(breach)),
            },
            (Err(_), Some((at, before))) if self.is_seat_being_filled(since, &before) => {
                self.settled = Some((at, before));
            }
            (Err(differs), _) => {
                if differs != self.differs {
                    self.log.line(self.now, format_args!("they differ: {differs}"));
                }
                self.differs = differs;
            }
        }
        // A console without a link cannot join; its link is back long before the run ends.
        let is_linked = self.links[self.operator.link].state == State::Up;
        if self.joins_late && self.settled.is_some() && is_linked {
            self.joins_late = false;
            self.join_late();
        }
        if since > limit && self.settled.is_none() {
            let promise = "after the last fault all agree within the stated time";
            let seen = self.differs.clone();
            self.require(Err(Breach { promise, seen }));
            return;
        }
        if let Some((at, _)) = &self.settled {
            self.stats.agreement = *at;
            let is_long = self.seed.is_multiple_of(LONG_RUN_EVERY);
            let drawn_time = if self.viewers.are_there() { DRAWN_TIME } else { 0 };
            let agreed_time = AGREED_TIME + drawn_time;
            let is_over =
                if is_long { since > limit + LONG_RUN_TIME } else { since >= at + agreed_time };
            // Whoever draws slowly is to see that as well.
            let is_shown =
                self.seat_being_filled.is_none() && self.now >= self.seat_filled + agreed_time;
            self.finished = is_over && is_shown && self.outages.are_over();
        }
        self.check_alerts(since);
        let settled_for = self.settled.as_ref().map(|(at, _)| since.saturating_sub(*at));
        self.finished &= self.historians_have_recorded(settled_for);
        if self.finished {
            // The last division of a fleet that all have left may be that of a clusterer that was killed, and lost on its way:
            // the next one has nothing to divide.
            let has_robots = self.settled.as_ref().is_some_and(|(_, agreed)| agreed.has_robots());
            let truth = self.operator.ground_truth(&self.robots, &self.nodes);
            let is_current = has_robots || self.oracle.last_runs(ServiceName::Clusterer, &truth);
            let teams = self.oracle.divisions.last().map(|teams| &**teams);
            let teams = teams
                .filter(|teams| is_current && (has_robots || teams.assignments().next().is_none()));
            let shown = self.browsers.check_agreement(teams);
            let seen = match (self.oracle.rosters.last(), teams) {
                (Some(roster), Some(teams)) => {
                    self.viewers.check_agreement(self.now, roster, teams)
                }
                _ => Ok(()),
            };
            self.require(shown.and(seen));
            self.check_ros();
        }
        self.lose_if_settled(since);
        if self.settled.is_some() {
            self.rest(settled_for);
        }
        self.finished &= self.at_rest.is_none();
        self.schedule(self.now + TICK, Event::Poll);
    }

    /// Whether the seat of a team that is absent may end, or what was held back for such a team has just followed.
    fn may_fill_seats(&self, before: &Agreed) -> bool {
        before.has_free_seats()
            || self.oracle.has_team_ended_within(self.now, SEATS_TIME)
            || self.oracle.has_only_released(before)
    }

    /// Whether all differ only because a division that fills the place of an absent team has just been published, long after
    /// the last fault.
    fn is_seat_being_filled(&mut self, since: Micros, before: &Agreed) -> bool {
        let may_end = self.may_fill_seats(before)
            && (AGREEMENT_TICKS * TICK..=SEATS_TIME).contains(&since)
            && self.oracle.unchanged(before).is_err();
        may_end && self.now <= *self.seat_being_filled.get_or_insert(self.now) + SEAT_FILLED_TIME
    }

    /// Whether nothing is about to change by itself.
    pub(super) fn is_at_rest(&self) -> bool {
        let is_rested = self.now >= self.storm.max(self.quiet_since) + ORDERS_TIME;
        is_rested && self.outages.are_over() && self.stands.is_none() && !self.operator.is_busy()
    }

    /// Something changes on purpose: all have to agree again.
    pub(super) fn forget_agreement(&mut self) {
        self.quiet_since = self.now;
        self.settled = None;
    }

    /// Checks, once all have agreed for a while, what the list of alerts says.
    fn check_alerts(&mut self, since: Micros) {
        let is_late = |(at, _): &(Micros, Agreed)| since >= *at + ALERTED_WITHIN;
        if self.settled.as_ref().is_some_and(is_late) {
            let checked = self.oracle.alerts.check_conflict(self.now);
            self.require(checked);
        }
    }

    /// Loses the next thing that is to be lost, once nothing is about to change by itself, and what all have agreed on is on
    /// the disks.
    fn lose_if_settled(&mut self, since: Micros) {
        let is_settled = |(at, agreed): &mut (Micros, Agreed)| {
            since >= ORDERS_TIME.max(*at + AGREED_ORDERS_TIME) && !agreed.has_moves_under_way()
        };
        if self.outages.are_over() {
            return;
        }
        let Some((at, agreed)) = self.settled.take_if(is_settled) else { return };
        match self.lose(agreed.clone()) {
            Some(lasts) => self.quiet_since = self.now + lasts,
            None => self.settled = Some((at, agreed)),
        }
    }

    /// Makes sure that a service takes its next input in time.
    pub(super) fn schedule_step(&mut self, index: usize) {
        let Some(at) = self.nodes[index].next_step(self.now) else { return };
        if self.nodes[index].step_at.is_none_or(|planned| at < planned) {
            self.nodes[index].step_at = Some(at);
            self.schedule(at, Event::Step { node: index });
        }
    }
}

/// Of the instances of a service, one leads and all others are standbys.
fn one_leads_each_service(nodes: &[Node]) -> Result<(), String> {
    for service in ServiceName::PIPELINE {
        let states: Vec<ReplicaState> = nodes
            .iter()
            .filter(|node| node.service == service)
            .filter_map(|node| Some(node.process.as_ref()?.host.replica_state()))
            .collect();
        let count = |wanted| states.iter().filter(|state| **state == wanted).count();
        let (leaders, standbys) = (count(ReplicaState::Leading), count(ReplicaState::Standby));
        if leaders != 1 || leaders + standbys != states.len() {
            return Err(format!("the instances of {service} are {states:?}"));
        }
    }
    Ok(())
}
