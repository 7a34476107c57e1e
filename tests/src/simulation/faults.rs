//! Makes a fault happen.

use std::sync::Arc;

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_ingest::Ingest;
use muster_model::header::Header;
use muster_model::id::{RobotId, ServiceName};
use muster_model::limits::MAX_REVISION;
use muster_model::observation::{CheckedReport, Pose, Stream};
use muster_model::term::highest_term;
use muster_service::{Core, Stored};
use muster_wire::{Format, Key, Message, Packet, Pattern, Source};

use super::busy::Load;
use super::chance::{Chance, Purpose};
use super::clock::{BEGINNING, HostClock, MS, Micros, SECOND};
use super::link::{State, Storm, Way};
use super::node::Node;
use super::plan::{Fault, Forgery, Injection, OutputKind, Place, Rubbish, Then};
use super::proposer::{AtRest, Errand};
use super::recording::Disk;
use super::robots::{RobotStream, packet};
use super::router::Carried;
use super::world::{Event, World};

/// How soon the bus notices that a process was killed.
const KILL_NOTICED: (Micros, Micros) = (10 * MS, 20 * MS);

/// Shortest time that a killed process is down.
const MIN_DOWN_TIME: Micros = 30 * MS;

/// How long after a fault all are connected again and have received a lease renewal.
pub(super) const RECOVERY_TIME: Micros = 3 * SECOND;

/// Who asks for many proposals at once.
const PROPOSERS: [&str; 3] = ["alice", "bob", "carol"];

/// Whether a service answers with the output of another one, or with its own.
fn answers_for(leader: ServiceName, service: ServiceName) -> bool {
    let wired = |service| match service {
        ServiceName::Ingest => Some((Ingest::output(), Ingest::wiring())),
        ServiceName::Embedder => Some((Embedder::output(), Embedder::wiring())),
        ServiceName::Clusterer => Some((Clusterer::output(), Clusterer::wiring())),
        ServiceName::Auditor => Some((Auditor::output(), Auditor::wiring())),
        ServiceName::Historian | ServiceName::Planner => None,
    };
    let (Some((output, _)), Some((_, wiring))) = (wired(leader), wired(service)) else {
        return false;
    };
    wiring.served.iter().any(|served| served.pattern == Pattern::One(output.clone()))
}

impl World {
    /// A fault happens.
    pub(super) fn inject(&mut self, number: usize) {
        let injection = self.injections[number].clone();
        self.log.line(self.now, format_args!("*** {injection}"));
        *self.stats.faults.entry(injection.fault.kind()).or_default() += 1;
        if !matches!(injection.fault, Fault::TeamCut { .. }) {
            // That is only planned here.
            self.mutator.fault(injection.fault.kind());
        }
        if let Some((service, lasts)) = injection.fault.hides_renewals() {
            self.oracle.order.disturbed(service, self.now + lasts + RECOVERY_TIME);
        }
        let mut chance = Chance::new(self.seed, Purpose::Fault, injection.number);
        let node = |world: &Self, at| world.link_of(at).filter(|link| *link < world.nodes.len());
        match injection.fault {
            Fault::Storm { at, lasts, loss, copies, delay, reorders } => {
                let Some(link) = self.link_of(at) else { return };
                let until = self.now + lasts;
                let loses_gets = true;
                self.links[link].storm(Storm { until, loss, loses_gets, copies, delay, reorders });
            }
            Fault::Cut { at, lasts, clean } => {
                let Some(link) = self.link_of(at) else { return };
                self.cut(link, self.now + lasts, clean);
            }
            Fault::Router { lasts } => {
                for link in 0..self.links.len() {
                    self.cut(link, self.now + lasts, true);
                }
            }
            Fault::Kill { at, lasts } => {
                if let Some(index) = node(self, at) {
                    self.kill(index, lasts, &mut chance);
                }
            }
            Fault::LostDisk { at, lasts } => {
                if let Some(index) = node(self, at) {
                    self.kill(index, lasts, &mut chance);
                    self.lose_disk(index);
                }
            }
            Fault::Blackout { lasts, disks } => {
                for index in 0..self.nodes.len() {
                    let lasts = chance.between(lasts / 2, lasts);
                    self.kill(index, lasts, &mut chance);
                    if !disks {
                        self.lose_disk(index);
                    }
                }
                self.oracle.all_ended();
                if !disks {
                    self.oracle.forget_ids();
                }
            }
            Fault::PowerCut { lasts } => self.outages.power = Some(lasts),
            Fault::TeamCut { lasts, clean } => self.outages.team = Some((lasts, clean)),
            Fault::ForgedTerm { what, term } => self.forge_term(what, term),
            Fault::Hang { at, lasts } => {
                let Some(index) = node(self, at) else { return };
                let until = self.now + lasts;
                self.nodes[index].busy_until = self.nodes[index].busy_until.max(until);
                self.cut(index, until, false);
            }
            Fault::FullDisk { at, lasts } => {
                let Some(index) = node(self, at) else { return };
                let Some(disk) = &self.nodes[index].disk else { return };
                disk.fill(true);
                if self.mutator.is_careless() {
                    disk.be_careless();
                }
                if let Some(lasts) = lasts {
                    self.schedule(self.now + lasts, Event::DiskHasRoom { node: index });
                }
            }
            Fault::Slow { at, lasts, each } => {
                let Some(index) = node(self, at) else { return };
                self.nodes[index].slow = (self.now + lasts, each);
            }
            Fault::SlowJobs { at, lasts, each } => {
                let Some(index) = node(self, at) else { return };
                self.nodes[index].slow_jobs = (self.now + lasts, each);
            }
            Fault::Busy { lasts, load } => self.make_busy(self.now + lasts, &load),
            Fault::Panics { at, lasts } => {
                let Some(index) = node(self, at) else { return };
                self.nodes[index].panics_until = self.now + lasts;
            }
            Fault::Clock { at, by } => {
                let Some(link) = self.link_of(at) else { return };
                let clock = match self.nodes.get_mut(link) {
                    Some(node) => &mut node.machine_clock,
                    None => &mut self.robots.all[link - self.nodes.len()].machine_clock,
                };
                clock.ahead = clock.ahead.saturating_add(by);
            }
            Fault::Leave { robot, lasts, politely } => {
                self.leave(robot, politely, Some(lasts), &mut chance);
            }
            Fault::LeaveForGood { robot } => self.leave(robot, false, None, &mut chance),
            Fault::Reboot { robot } => self.leave(robot, false, Some(MIN_DOWN_TIME), &mut chance),
            Fault::Promote { robot, superior } => {
                if let Some(robot) = self.robots.all.get_mut(robot) {
                    robot.promote(superior);
                }
            }
            Fault::Jump { robot, by } => {
                if let Some(robot) = self.robots.all.get_mut(robot) {
                    robot.jump(by);
                }
            }
            Fault::Burst { robot, count } => self.burst(robot, count),
            Fault::Rubbish { robot, kind, count } => {
                for number in 0..count {
                    if let Some(packet) = self.rubbish(&mut chance, robot, kind, number) {
                        self.put(self.attacker(), packet);
                    }
                }
            }
            Fault::Ghosts { count } => {
                for ghost in 0..count {
                    let Ok(name) = RobotId::new(format!("ghost{}-{ghost}", injection.number))
                    else {
                        continue;
                    };
                    if let Ok(report) = CheckedReport::new(name, pose(&mut chance))
                        && let Some(packet) =
                            packet(&self.space, &Message::Report(report), Format::Json)
                    {
                        self.put(self.attacker(), packet);
                    }
                }
            }
            Fault::Set { service, patch } => self.operator.wants(service, patch),
            Fault::Wish { id, robot, wish } => {
                if let Some(robot) = self.robots.all.get(robot) {
                    let wish = wish.replace("ROBOT", robot.name.as_str());
                    let change = format!("wish/alice/{id} {wish}");
                    self.operator.wants(ServiceName::Clusterer, change);
                }
            }
            Fault::Propose { operator, id, robot, asked, then } => {
                let asked = self.about(robot, asked);
                let (operator, id) = (operator.to_owned(), id.to_owned());
                self.propose(Errand { operator, id, payload: Some(asked), then, tries: 0 });
            }
            Fault::ProposeMany { count } => {
                for number in 0..count {
                    let operator = PROPOSERS[number % PROPOSERS.len()].to_owned();
                    let (id, payload) = (format!("m{number}"), Some(r#"{"teams":2}"#.to_owned()));
                    let then = Then::Forget;
                    self.propose(Errand { operator, id, payload, then, tries: 0 });
                }
                self.list_proposals();
                self.schedule(self.now + SECOND, Event::ListProposals);
            }
            Fault::ProposeAtRest { robot, asked } => {
                self.at_rest = Some(AtRest::Planned(self.about(robot, asked)));
            }
            Fault::Ros(fault) => self.inject_ros(fault, &mut chance),
            Fault::BadAlpha { lasts } => {
                self.operator.wants(ServiceName::Embedder, r#"{"alpha":1e9}"#.to_owned());
                let patch = r#"{"alpha":{"fraction":0.5}}"#.to_owned();
                let later = Event::SetLater { service: ServiceName::Embedder, patch };
                self.schedule(self.now + lasts, later);
            }
        }
    }

    /// A text about a robot.
    fn about(&self, robot: usize, text: &str) -> String {
        let name = self.robots.all.get(robot).map_or("nobody", |robot| robot.name.as_str());
        text.replace("ROBOT", name)
    }

    /// All hosts of services are busy until a moment.
    fn make_busy(&mut self, until: Micros, load: &Load) {
        let Load { each, job, delay, late, loss } = *load;
        for node in &mut self.nodes {
            node.slow = (until, each);
            node.slow_jobs = (until, job);
            let loss = if node.service == ServiceName::Embedder { loss } else { 0 };
            let link = &mut self.links[node.link];
            link.storm(Storm { until, loss, loses_gets: false, copies: 0, delay, reorders: false });
            link.delay_answers(until, late);
        }
        self.freshness.begin(self.now, until, load);
    }

    pub(super) fn kill(&mut self, index: usize, lasts: Micros, chance: &mut Chance) {
        let node = &mut self.nodes[index];
        node.down_until = node.down_until.max(self.now + lasts.max(MIN_DOWN_TIME));
        let restart = node.down_until;
        if node.process.take().is_none() {
            return;
        }
        node.life += 1;
        node.step_at = None;
        let service = node.service;
        if let Some(disk) = &node.disk {
            if self.mutator.loses_records() {
                disk.lose_last();
            }
            self.oracle.recorded.killed(node.instance, disk.entries().len());
        }
        // The session ends with the process; the link itself stays as it is.
        let link = node.link;
        let keys = self.router.tokens_of(link);
        let state = self.links[link].state;
        self.links[link].end_session();
        self.links[link].state = state;
        let seen = self.now + chance.between(KILL_NOTICED.0, KILL_NOTICED.1);
        self.schedule(seen, Event::TokensGone { link, keys });
        self.schedule(restart, Event::Start { node: index });
        self.note_lost_terms(service);
    }

    /// A process of a service was killed. Where no other one lives that answers what a leader has published, its term is
    /// known to disks alone, and that of its own host may be down for longer than another instance.
    fn note_lost_terms(&mut self, killed: ServiceName) {
        for leader in ServiceName::PIPELINE {
            let lives = |node: &Node| node.process.is_some() && answers_for(leader, node.service);
            if answers_for(leader, killed) && !self.nodes.iter().any(lives) {
                self.oracle.order.disturbed(Some(leader), self.now);
            }
        }
    }

    /// A service that was killed begins without what it stored. By a clock that is right it begins above
    /// the terms that it held all the same, unless leaders have followed each other faster than its seconds.
    fn lose_disk(&mut self, index: usize) {
        let node = &mut self.nodes[index];
        node.stored = Stored::default();
        node.kept = None;
        if let Some(disk) = &mut node.disk {
            *disk = Disk::default();
            self.oracle.recorded.forget(node.instance);
        }
        let (service, instance) = (node.service, node.instance);
        let place = Place::Service(service, instance);
        let sets_its_clock = |injection: &Injection| matches!(injection.fault, Fault::Clock { at, .. } if at == place);
        let is_right = self.clocks_agree && !self.injections.iter().any(sets_its_clock);
        let is_ahead = self.oracle.order.highest_given(service) >= (BEGINNING + self.now) / SECOND;
        if !is_right || is_ahead || self.oracle.had_forged_terms() {
            self.oracle.forget_order(service, instance);
        }
        if service == ServiceName::Clusterer && !self.is_remembered_by_others() {
            self.oracle.forget_ids();
        }
        self.operator.forgets(service);
    }

    /// Whether a service that has lost its disk hears from others what it had published: auditors and its own standbys
    /// answer that, unless they are killed or their links fail. After a blackout the next leader may begin before an instance
    /// is back whose disk has it.
    fn is_remembered_by_others(&self) -> bool {
        let answers = |place| {
            matches!(place, Place::Service(ServiceName::Auditor | ServiceName::Clusterer, _))
        };
        self.injections.iter().all(|injection| match injection.fault {
            Fault::Storm { at, .. }
            | Fault::Cut { at, .. }
            | Fault::Kill { at, .. }
            | Fault::Hang { at, .. } => !answers(at),
            Fault::Router { .. } | Fault::Busy { .. } | Fault::Blackout { .. } => false,
            _ => true,
        })
    }

    fn leave(&mut self, index: usize, politely: bool, back: Option<Micros>, chance: &mut Chance) {
        let Some(robot) = self.robots.all.get_mut(index).filter(|robot| robot.runs) else { return };
        robot.runs = false;
        robot.life += 1;
        let (link, life) = (robot.link, robot.life);
        let token = robot.token(&self.space);
        if let (true, Some(key)) = (politely, &token) {
            self.send(link, Way::Up, &Carried::Token { key: key.as_str().into(), alive: false });
        } else if self.links[link].state != State::Down {
            let keys: Vec<Arc<str>> = token.into_iter().map(Arc::from).collect();
            let is_silent = self.links[link].state == State::Silent;
            // The end of a process is noticed behind all that it has sent, and over a link that works: after a cut, unless
            // the lease ends before.
            let sent = self.links[link].arrived_at(Way::Up).max(self.now);
            let from = if is_silent { self.links[link].cut_until.max(sent) } else { sent };
            let seen = from + chance.between(KILL_NOTICED.0, KILL_NOTICED.1);
            let is_back = back.is_some_and(|lasts| self.now + lasts.max(MIN_DOWN_TIME) <= seen);
            if !is_back {
                self.schedule(seen, Event::TokensGone { link, keys });
            }
        }
        if let Some(lasts) = back {
            let event = Event::RobotStarts { robot: index, life };
            self.schedule(self.now + lasts.max(MIN_DOWN_TIME), event);
        }
    }

    /// Repeats the last message on a key with a higher term. To a reader it looks like the first
    /// message of a new leader.
    fn forge_term(&mut self, what: OutputKind, term: Forgery) {
        let Some(mut message) = self.oracle.last_on(what) else { return };
        let bound = highest_term(HostClock::default().wall(self.now));
        let forged = |term_before: u64| match term {
            Forgery::Higher(terms) => term_before + terms,
            Forgery::Bound if self.clocks_agree => bound,
            Forgery::Bound => term_before + 2,
            Forgery::Largest => MAX_REVISION - 1,
        };
        let raise = |header: &mut Header| header.revision.term = forged(header.revision.term);
        self.oracle.terms_forged();
        match &mut message {
            Message::Roster(roster) => raise(&mut roster.make_mut_unchecked().header),
            Message::Graph(delta) => raise(&mut Arc::make_mut(delta).header),
            Message::Embedding(embedding) => raise(&mut embedding.make_mut_unchecked().header),
            Message::Teams { teams, .. } => raise(&mut teams.make_mut_unchecked().header),
            Message::Audit(audit) => raise(&mut Arc::make_mut(audit).header),
            Message::Settings(announced) => raise(&mut announced.header),
            _ => return,
        }
        self.oracle.forged(&message, self.now);
        if let Some(packet) = packet(&self.space, &message, Format::Binary) {
            self.put(self.attacker(), packet);
        }
    }

    fn burst(&mut self, index: usize, count: usize) {
        for _ in 0..count {
            let Some(packet) = self.robots.report(&self.space, self.now, index, RobotStream::Pose)
            else {
                return;
            };
            self.put(self.robots.all[index].link, packet);
        }
    }

    fn rubbish(
        &self,
        chance: &mut Chance,
        robot: usize,
        kind: Rubbish,
        number: usize,
    ) -> Option<Packet> {
        let name = self.robots.all.get(robot)?.name.clone();
        let key = self.space.format(&Key::Stream(name.clone(), Stream::Pose));
        let good = Packet::put(key.clone(), "", br#"{"x":1,"y":2}"#);
        let base = key.strip_suffix("/pose")?;
        Some(match kind {
            Rubbish::Noise => {
                let mut bytes = chance.bytes(number * 7);
                let encoding = if chance.percent(50) {
                    bytes.splice(0..0, [0xB7, 1, 1]);
                    "application/octet-stream".to_owned()
                } else {
                    String::new()
                };
                let stream = *chance.pick(&["pose", "links", "rank", "relation/thermal"])?;
                Packet { key: format!("{base}/{stream}"), encoding, payload: Ok(bytes), ..good }
            }
            Rubbish::AlmostRight => {
                let deep = "[".repeat(20_000);
                let texts = [
                    r#"{"x":1e999,"y":2}"#,
                    r#"{"x":NaN,"y":2}"#,
                    r#"{"x":1,"y":2,"z":null,"speed":1}"#,
                    r#"{"x":4e8,"y":2}"#,
                    r#"{"x":1,"y":2,"frame":"mars"}"#,
                    r#"{"x":1,"y":2,"stamp":-1}"#,
                    r#"{"links":[{"peer":"ghost","quality":1e308}]}"#,
                    r#"{"x":"1","y":2}"#,
                    "\u{feff}{}",
                    deep.as_str(),
                ];
                Packet { payload: Ok(chance.pick(&texts)?.as_bytes().to_vec()), ..good }
            }
            Rubbish::TooLarge => Packet { payload: Ok(vec![b' '; 200 * 1024]), ..good },
            Rubbish::WrongKey => {
                let space = self.space.format(&Key::Teams);
                let keys = [
                    key.replace(name.as_str(), "*"),
                    format!("{base}/pose/x"),
                    format!("{base}/team"),
                    space.replace("teams", "robot/UPPER/pose"),
                    key.clone(),
                ];
                let key = chance.pick(&keys)?.clone();
                let source = if number.is_multiple_of(3) { Source::Delete } else { Source::Put };
                Packet { key, source, encoding: "video/mp4".to_owned(), ..good }
            }
            Rubbish::Forged => {
                let mut pose = pose(chance);
                if chance.percent(50) {
                    pose.boot = Some("forged".to_owned());
                    pose.seq = Some(u64::MAX);
                }
                let report = CheckedReport::new(name, pose).ok()?;
                packet(&self.space, &Message::Report(report), Format::Binary)?
            }
            Rubbish::AsService => {
                let keys = [
                    Key::Teams,
                    Key::Roster,
                    Key::Embedding,
                    Key::Settings(ServiceName::Clusterer),
                ];
                let mut bytes = vec![0xB7, 1, 6];
                bytes.extend(chance.bytes(number * 13));
                let key = self.space.format(chance.pick(&keys)?);
                let encoding = "application/octet-stream".to_owned();
                Packet { key, encoding, payload: Ok(bytes), ..good }
            }
        })
    }
}

fn pose(chance: &mut Chance) -> Pose {
    Pose {
        x: chance.real(-100.0, 100.0),
        y: chance.real(-100.0, 100.0),
        z: None,
        heading: None,
        frame: None,
        stamp: None,
        boot: None,
        seq: None,
    }
}
