//! What happens between the machines: messages, tokens and gets on their way, and links that come and
//! go.

use std::sync::Arc;
use std::time::Duration;

use muster_client::Via;
use muster_model::id::ServiceName;
use muster_model::role::ReplicaState;
use muster_service::testkit::command_of;
use muster_service::{Arrival, Ask, Input};
use muster_wire::{Key, Message, Packet};

use super::clock::{MS, Micros, SECOND};
use super::link::{State, Way};
use super::log::{digest, readable};
use super::node::Process;
use super::oracle::breach;
use super::plan::{OutputKind, Place, Span};
use super::robots::Reception;
use super::router::{Answer, BusGet, BusGetId, Carried, LinkId};
use super::world::{Asker, Event, Pending, World};

/// How long robots may refuse services that have lost their state.
const BELIEVED_WITHIN: Micros = 5 * SECOND;

/// How long operators and consoles wait for the answers to a get, as the client does.
const CONSOLE_TIMEOUT: Micros = SECOND;

/// How long the bus takes to give up on a get over a link that is known to be down.
const REFUSAL_TIME: Micros = MS;

/// When the two ends of a link notice that nothing arrives: the lease that Zenoh is configured with.
const LEASE: (Micros, Micros) = (1500 * MS, 2 * SECOND);

/// How long a client needs to reconnect to its router.
const RECONNECTION: (Micros, Micros) = (20 * MS, SECOND);

/// How often an operator repeats an unanswered get.
const OPERATOR_INTERVAL: Micros = SECOND;

impl World {
    /// Sends something over a link.
    pub(super) fn send(&mut self, link: LinkId, way: Way, carried: &Carried) {
        let at = self.links[link].send(self.now, way, carried, &mut self.damage);
        let session = self.links[link].session;
        for at in at {
            let carried = carried.clone();
            let event = match way {
                Way::Up => Event::AtRouter { link, session, carried },
                Way::Down => Event::AtClient { link, session, carried },
            };
            self.schedule(at, event);
        }
    }

    /// Something has reached the router.
    pub(super) fn at_router(&mut self, link: LinkId, carried: Carried) {
        match &carried {
            Carried::Put(packet) => {
                if self.log.is_kept() {
                    let bytes = packet.payload.as_ref().map_or(&[][..], Vec::as_slice);
                    let (key, size, name) = (&packet.key, bytes.len(), digest(bytes));
                    let text = readable(bytes);
                    let line =
                        format_args!("{key} put by link {link}: {size} bytes {name:08x} {text}");
                    self.log.line(self.now, line);
                }
                let key = self.space.parse(&packet.key).ok();
                if let Some(robot) = key.as_ref().and_then(Key::robot) {
                    self.names.insert(robot.clone(), self.now);
                }
                self.watchers_receive(packet);
                self.pass_to_bridge(&carried, packet);
                for node in 0..self.nodes.len() {
                    let is_isolated = self.mutator.isolates(self.nodes[node].service);
                    if self.nodes[node].subscribes_to(&packet.key) && !is_isolated {
                        self.send(self.nodes[node].link, Way::Down, &carried);
                    }
                }
                if let Some(Key::RobotTeam(name)) = key
                    && let Some(robot) = self.robots.all.iter().find(|robot| robot.name == name)
                {
                    self.send(robot.link, Way::Down, &carried);
                }
            }
            Carried::Token { key, alive } => self.token(link, key, *alive),
            Carried::Get { get, asked } => {
                let servers: Vec<(LinkId, usize)> = self
                    .nodes
                    .iter()
                    .filter(|node| node.process.is_some() && node.link != link)
                    .filter(|node| self.links[node.link].state != State::Down)
                    .map(|node| (node.link, node.serves(&asked.selector)))
                    .filter(|(_, patterns)| *patterns > 0)
                    .collect();
                let answers = servers.iter().map(|(_, patterns)| patterns).sum();
                if self.router.pass_on(*get, answers) {
                    self.send(link, Way::Down, &Carried::Complete { get: *get });
                }
                for (server, _) in servers {
                    self.send(server, Way::Down, &carried);
                }
            }
            Carried::Answer { get, .. } => {
                let Some((asker, is_last)) = self.router.answered(*get) else { return };
                self.send(asker, Way::Down, &carried);
                if is_last {
                    self.send(asker, Way::Down, &Carried::Complete { get: *get });
                }
            }
            Carried::Complete { .. } => {}
        }
    }

    /// Something has reached a machine.
    pub(super) fn at_client(&mut self, link: LinkId, carried: &Carried) {
        match carried {
            Carried::Answer { get, answer } => {
                let Some(pending) = self.pending.get_mut(get) else { return };
                pending.answers.push(Arc::clone(answer));
                // One who has nothing to tell sends no answer that a client sees.
                let is_seen = answer.packets().is_none_or(|packets| !packets.is_empty());
                if let Some(time) = pending.further_within.filter(|_| is_seen) {
                    let ends = self.now + time;
                    pending.ends = ends;
                    self.schedule(ends, Event::NoFurtherAnswer { get: *get });
                }
                return;
            }
            Carried::Complete { get } => {
                self.get_ends(*get);
                return;
            }
            _ => {}
        }
        if self.is_bridge(link) {
            if let Carried::Put(packet) = carried {
                self.bridge_receives(std::slice::from_ref(packet.as_ref()), Via::Put);
            }
            return;
        }
        if link >= self.nodes.len() {
            let robot = link - self.nodes.len();
            if let Carried::Put(packet) = carried {
                self.robot_receives(robot, packet);
            }
            return;
        }
        let node = &mut self.nodes[link];
        match carried {
            Carried::Put(packet) => node.receive(&self.space, packet),
            Carried::Token { key, alive } => node.token_changed(&self.space, key, *alive),
            Carried::Get { get, asked } => node.receive_get(*get, asked),
            Carried::Answer { .. } | Carried::Complete { .. } => {}
        }
        self.schedule_step(link);
    }

    /// A robot receives something. Where there are no standbys, whose terms may be seconds apart, and where
    /// terms come from clocks that are right, it believes a restarted service soon.
    fn robot_receives(&mut self, robot: usize, packet: &Packet) {
        let received = self.robots.receive(robot, packet, self.now);
        let name = &self.robots.all[robot].name;
        match received {
            Reception::News => self.log.line(self.now, format_args!("{name} receives its team")),
            Reception::Known => {}
            Reception::Refused { since } => {
                let instances =
                    self.nodes.iter().filter(|node| node.service == ServiceName::Clusterer);
                let is_alone = instances.count() == 1;
                let applies = is_alone && self.clocks_agree && !self.oracle.had_forged_terms();
                if applies && self.now > since + BELIEVED_WITHIN {
                    let promise = "robots believe services that have lost their state within 5 s";
                    let seen = format!("{name} refuses its team since {}", Span(since));
                    self.require(breach(promise, seen));
                }
            }
        }
    }

    /// A token was declared or withdrawn.
    fn token(&mut self, link: LinkId, key: &Arc<str>, alive: bool) {
        if !self.router.token(link, key, alive) {
            return;
        }
        let what = if alive { "appears" } else { "is gone" };
        self.log.line(self.now, format_args!("token {key} {what}"));
        for node in 0..self.nodes.len() {
            if self.nodes[node].process.is_some() && self.nodes[node].follows(key) {
                let carried = Carried::Token { key: Arc::clone(key), alive };
                self.send(self.nodes[node].link, Way::Down, &carried);
            }
        }
    }

    /// Tokens of a session that has ended are gone.
    pub(super) fn tokens_gone(&mut self, link: LinkId, keys: &[Arc<str>]) {
        for key in keys {
            self.token(link, key, false);
        }
    }

    /// A process declares its token, and receives those that it follows.
    pub(super) fn declare(&mut self, link: LinkId) {
        let own = match self.nodes.get(link) {
            Some(node) => node.process.as_ref().map(|process| Arc::clone(&process.token)),
            None => {
                let robot = self.robots.all.get(link - self.nodes.len());
                robot.filter(|robot| robot.runs).and_then(|r| r.token(&self.space)).map(Arc::from)
            }
        };
        if let Some(key) = own {
            self.send(link, Way::Up, &Carried::Token { key, alive: true });
        }
        if link < self.nodes.len() {
            for key in self.router.tokens() {
                if self.nodes[link].follows(&key) {
                    self.send(link, Way::Down, &Carried::Token { key, alive: true });
                }
            }
        }
    }

    /// Whether a link is that of the bridge to ROS.
    fn is_bridge(&self, link: LinkId) -> bool {
        self.ros.as_ref().is_some_and(|ros| ros.link == link)
    }

    /// The link number of a place.
    pub(super) fn link_of(&self, place: Place) -> Option<LinkId> {
        match place {
            Place::Service(service, instance) => {
                let is =
                    |node: &super::node::Node| node.service == service && node.instance == instance;
                self.nodes.iter().find(|node| is(node)).map(|node| node.link)
            }
            Place::Robot(robot) => Some(self.robots.all.get(robot)?.link),
        }
    }

    /// A link is cut until a moment.
    pub(super) fn cut(&mut self, link: LinkId, until: Micros, clean: bool) {
        self.links[link].cut_until = self.links[link].cut_until.max(until);
        self.schedule(until, Event::Heal { link });
        if clean && self.links[link].state != State::Down {
            self.lose_session(link);
        } else if self.links[link].state == State::Up {
            self.links[link].state = State::Silent;
            let after = self.links[link].drawn(LEASE.0, LEASE.1);
            let session = self.links[link].session;
            self.schedule(self.now + after, Event::Lease { link, session });
        }
    }

    /// Both ends notice that a session has ended.
    pub(super) fn lose_session(&mut self, link: LinkId) {
        let keys = self.router.tokens_of(link);
        self.links[link].end_session();
        self.tokens_gone(link, &keys);
        if link < self.nodes.len() {
            self.nodes[link].link_changed(&self.space, false);
            self.schedule_step(link);
        } else if self.is_bridge(link) {
            self.bridge_link_changed(false);
        }
    }

    /// A link may be whole again.
    pub(super) fn heal(&mut self, link: LinkId) {
        if self.now < self.links[link].cut_until {
            return;
        }
        match self.links[link].state {
            State::Up => {}
            State::Silent => {
                self.log.line(self.now, format_args!("link {link} goes on"));
                self.links[link].state = State::Up;
                for (way, carried) in self.links[link].take_held() {
                    self.send(link, way, &carried);
                }
            }
            State::Down => {
                let after = self.links[link].drawn(RECONNECTION.0, RECONNECTION.1);
                self.schedule(self.now + after, Event::LinkUp { link });
            }
        }
    }

    /// A client has reconnected to its router.
    pub(super) fn link_up(&mut self, link: LinkId) {
        if self.links[link].state != State::Down || self.now < self.links[link].cut_until {
            return;
        }
        self.log.line(self.now, format_args!("link {link} is back"));
        self.links[link].state = State::Up;
        if link < self.nodes.len() {
            self.nodes[link].link_changed(&self.space, true);
            self.schedule_step(link);
        } else if self.is_bridge(link) {
            self.bridge_link_changed(true);
        }
        self.declare(link);
    }

    /// A host asks the bus.
    pub(super) fn ask_for_host(&mut self, index: usize, ask: &Ask) {
        let node = &self.nodes[index];
        let selector = self.space.pattern(&ask.pattern);
        let get = BusGet { selector, parameters: "format=bincode", payload: None };
        let micros = |time: Duration| Micros::try_from(time.as_micros()).unwrap_or(Micros::MAX);
        let asker = Asker::Host { node: index, life: node.life, ask: ask.ask };
        let further_within = ask.further_within.map(micros);
        let get = self.get(node.link, get, micros(ask.within), asker);
        if let Some(pending) = self.pending.get_mut(&get) {
            pending.further_within = further_within;
        }
    }

    /// Sends a get, whose answers are waited for so long.
    pub(super) fn get(
        &mut self,
        link: LinkId,
        asked: BusGet,
        within: Micros,
        asker: Asker,
    ) -> BusGetId {
        let get = self.router.begin_get(link);
        let (answers, further_within) = (Vec::new(), None);
        let pending = Pending { asker, answers, further_within, ends: Micros::MAX };
        self.pending.insert(get, pending);
        // A get over a link that is known to be down fails at once.
        let is_down = self.links[link].state == State::Down;
        let within = if is_down { within.min(REFUSAL_TIME) } else { within };
        self.schedule(self.now + within, Event::GetEnds { get });
        self.send(link, Way::Up, &Carried::Get { get, asked: Arc::new(asked) });
        get
    }

    /// A get has been answered by all, or has timed out.
    pub(super) fn get_ends(&mut self, get: BusGetId) {
        let Some(Pending { asker, answers, .. }) = self.pending.remove(&get) else { return };
        self.router.end_get(get);
        match asker {
            Asker::Operator(service, losses) => {
                // A standby answers with nothing.
                let is_answer = |answer: &&Arc<Answer>| match answer.as_ref() {
                    Answer::Packets(packets) => !packets.is_empty(),
                    Answer::Error(_) => true,
                };
                let confirmed = answers
                    .iter()
                    .filter(is_answer)
                    .find(|answer| matches!(***answer, Answer::Packets(_)));
                if let Some(answer) = confirmed.or(answers.iter().find(is_answer)) {
                    self.log.line(self.now, format_args!("{service} answers {answer:?}"));
                    self.operator.answered(service, losses, answer);
                }
            }
            Asker::Nobody => {}
            Asker::RosBridge(life) => self.bridge_answered(life, &answers),
            Asker::Proposer(errand, one_led) => self.proposal_answered(*errand, one_led, &answers),
            Asker::LateJoiner(last) => {
                let packets = answers.iter().filter_map(|answer| answer.packets());
                let received: Vec<Message> = packets
                    .flatten()
                    .filter_map(|packet| Message::decode(&self.space, packet).ok())
                    .collect();
                self.stats.joined += 1;
                let checked = self.oracle.joined_late(&last, &received);
                self.require(checked);
            }
            Asker::Host { node, life, ask } => {
                let packets = answers.iter().filter_map(|answer| answer.packets()).flatten();
                let answers = packets.cloned().map(Arrival::encoded).collect();
                if self.nodes[node].life == life {
                    self.nodes[node].complete(Input::Answered { ask, answers });
                    self.schedule_step(node);
                }
            }
        }
    }

    /// A console joins, and asks for what it has missed.
    pub(super) fn join_late(&mut self) {
        for kind in [OutputKind::Roster, OutputKind::Teams, OutputKind::Audit] {
            let Some(last) = self.oracle.last_on(kind) else { continue };
            let selector = self.space.format(&last.keys().0);
            let asked = BusGet { selector, parameters: "format=bincode", payload: None };
            let asker = Asker::LateJoiner(last);
            self.get(self.operator.link, asked, CONSOLE_TIMEOUT, asker);
        }
    }

    /// The operator asks for what it wants.
    pub(super) fn operate(&mut self) {
        for (service, number, patch) in self.operator.next() {
            self.set(service, number, &patch);
        }
        self.schedule(self.now + OPERATOR_INTERVAL, Event::Operate);
    }

    /// Commands a service by the clock of its leader, or of any instance that runs.
    fn set(&mut self, service: ServiceName, number: u64, patch: &str) {
        let of_service = self.nodes.iter().filter(|node| node.service == service);
        let running = of_service.filter_map(|node| node.process.as_ref());
        let leads = |process: &&Process| process.host.replica_state() == ReplicaState::Leading;
        let Some(process) = running.clone().find(leads).or(running.clone().next()) else { return };
        let now = process.clock.tick(self.now);
        // A wish stands behind its key.
        let (key, payload) = match patch.split_once(' ').filter(|_| patch.starts_with("wish/")) {
            Some((key, wish)) => (key.to_owned(), wish),
            None => (Key::Settings(service).to_string(), patch),
        };
        let Some((key, payload)) = command_of(now, &key, &format!("c{number}"), payload) else {
            return;
        };
        self.operator.sends(service, now);
        let selector = format!("muster/v1/{}/{key}", self.space.fleet());
        let asked = BusGet { selector, parameters: "", payload: Some(payload.into_bytes()) };
        let asker = Asker::Operator(service, self.operator.losses(service));
        self.get(self.operator.link, asked, CONSOLE_TIMEOUT, asker);
    }
}
