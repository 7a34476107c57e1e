//! What happens between the hosts: messages, tokens and gets on their way, and links that come and go.

use std::sync::Arc;

use muster_model::id::ServiceName;
use muster_wire::{Key, Message, Pattern};

use super::clock::{MS, Micros, SECOND};
use super::link::{State, Way};
use super::log::digest;
use super::machine::Input;
use super::plan::{Place, Throne};
use super::router::{Answer, Ask, Carried, GetId, LinkId};
use super::world::{Asker, Event, Fetch, Pending, World};

/// How long the bus waits for the answers to a get, how long a service that starts goes on asking
/// where nobody answers, and how soon it asks again: as the shell does.
const FETCH_WITHIN: Micros = SECOND;
const START_PATIENCE: Micros = 2 * SECOND;
const START_AGAIN: Micros = 200 * MS;

/// When the two ends of a link notice that nothing comes any more.
const LEASE: (Micros, Micros) = (1500 * MS, 2 * SECOND);

/// How long a client needs to find back to its router.
const RECONNECTION: (Micros, Micros) = (20 * MS, SECOND);

/// How often an operator asks again.
const OPERATOR_AGAIN: Micros = SECOND;

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
                    let line = format_args!("{key} put by link {link}: {size} bytes {name:08x}");
                    self.log.line(self.now, line);
                }
                let key = self.space.parse(&packet.key).ok();
                if let Some(robot) = key.as_ref().and_then(Key::robot) {
                    self.names.insert(robot.clone(), self.now);
                }
                for node in 0..self.nodes.len() {
                    let deaf = self.saboteur.deafens(self.nodes[node].service);
                    if self.nodes[node].hears(&packet.key) && !deaf {
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
            Carried::Ask { get, ask } => {
                let servers: Vec<(LinkId, usize)> = self
                    .nodes
                    .iter()
                    .filter(|node| node.process.is_some() && node.link != link)
                    .filter(|node| self.links[node.link].state != State::Down)
                    .map(|node| (node.link, node.serves(&ask.selector)))
                    .filter(|(_, patterns)| *patterns > 0)
                    .collect();
                let many = servers.iter().map(|(_, patterns)| patterns).sum();
                if self.router.pass_on(*get, many) {
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

    /// Something has reached a host.
    pub(super) fn at_client(&mut self, link: LinkId, carried: &Carried) {
        match carried {
            Carried::Answer { get, answer } => {
                if let Some(pending) = self.pending.get_mut(get) {
                    pending.answers.push(Arc::clone(answer));
                }
                return;
            }
            Carried::Complete { get } => {
                self.get_ends(*get);
                return;
            }
            _ => {}
        }
        if link >= self.nodes.len() {
            let robot = link - self.nodes.len();
            if let Carried::Put(packet) = carried
                && self.robots.hear(robot, packet)
            {
                let name = &self.robots.all[robot].name;
                self.log.line(self.now, format_args!("{name} hears of its team"));
            }
            return;
        }
        let node = &mut self.nodes[link];
        match carried {
            Carried::Put(packet) => node.arrive(&self.space, packet),
            Carried::Token { key, alive } => node.see_token(&self.space, key, *alive),
            Carried::Ask { get, ask } => node.asked(*get, ask),
            Carried::Answer { .. } | Carried::Complete { .. } => {}
        }
        self.kick(link);
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

    /// A process declares its token, and hears of those that it follows.
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

    /// Both ends see that a session has ended.
    pub(super) fn lose_session(&mut self, link: LinkId) {
        let keys = self.router.tokens_of(link);
        self.links[link].end_session();
        self.tokens_gone(link, &keys);
        if link < self.nodes.len() {
            self.nodes[link].link_changed(&self.space, false);
            self.kick(link);
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

    /// A client has found back to its router.
    pub(super) fn link_up(&mut self, link: LinkId) {
        if self.links[link].state != State::Down || self.now < self.links[link].cut_until {
            return;
        }
        self.log.line(self.now, format_args!("link {link} is back"));
        self.links[link].state = State::Up;
        if link < self.nodes.len() {
            self.nodes[link].link_changed(&self.space, true);
            self.kick(link);
        }
        self.declare(link);
    }

    /// A core asks the bus.
    pub(super) fn begin_fetch(&mut self, index: usize, fetch: u32, patterns: &[Pattern]) {
        self.next_fetch += 1;
        let id = self.next_fetch;
        let until = self.now + START_PATIENCE;
        let is_patient = self.nodes[index].kind.is_patient;
        let patient = patterns.iter().filter(|pattern| is_patient(fetch, pattern));
        let patient = patient.map(|pattern| self.space.pattern(pattern)).collect();
        let (life, open) = (self.nodes[index].life, patterns.len());
        let begun = Fetch { node: index, life, fetch, until, patient, open, messages: Vec::new() };
        self.fetches.insert(id, begun);
        for pattern in patterns {
            self.ask_for_fetch(id, self.space.pattern(pattern));
        }
        if patterns.is_empty() {
            self.end_fetch(id);
        }
    }

    /// Asks for one pattern of a fetch.
    pub(super) fn ask_for_fetch(&mut self, fetch: u64, pattern: String) {
        let Some(begun) = self.fetches.get(&fetch) else { return };
        if self.nodes[begun.node].life != begun.life {
            self.fetches.remove(&fetch);
            return;
        }
        let link = self.nodes[begun.node].link;
        let ask = Ask { selector: pattern.clone(), parameters: "format=bincode", payload: None };
        self.ask(link, ask, Asker::Fetch { fetch, pattern });
    }

    /// Sends a get, whose answers are waited for as long as the bus waits.
    fn ask(&mut self, link: LinkId, ask: Ask, asker: Asker) {
        let get = self.router.begin_get(link);
        self.pending.insert(get, Pending { asker, answers: Vec::new() });
        // Nobody is asked over a link that is known to be down.
        let within = if self.links[link].state == State::Down { MS } else { FETCH_WITHIN };
        self.schedule(self.now + within, Event::GetEnds { get });
        self.send(link, Way::Up, &Carried::Ask { get, ask: Arc::new(ask) });
    }

    /// A get has been answered by everybody, or has lasted for too long.
    pub(super) fn get_ends(&mut self, get: GetId) {
        let Some(Pending { asker, answers }) = self.pending.remove(&get) else { return };
        self.router.end_get(get);
        match asker {
            Asker::Operator(service) => {
                // An instance that stands by answers with nothing.
                let says = |answer: &&Arc<Answer>| match answer.as_ref() {
                    Answer::Packets(packets) => !packets.is_empty(),
                    Answer::Error(_) => true,
                };
                let confirmed = answers
                    .iter()
                    .filter(says)
                    .find(|answer| matches!(***answer, Answer::Packets(_)));
                if let Some(answer) = confirmed.or(answers.iter().find(says)) {
                    self.log.line(self.now, format_args!("{service} answers {answer:?}"));
                    self.operator.answered(service, answer);
                }
            }
            Asker::LateJoiner(last) => {
                let packets = answers.iter().filter_map(|answer| match answer.as_ref() {
                    Answer::Packets(packets) => Some(packets),
                    Answer::Error(_) => None,
                });
                let told: Vec<Message> = packets
                    .flatten()
                    .filter_map(|packet| Message::decode(&self.space, packet).ok())
                    .collect();
                self.stats.joined += 1;
                let verdict = self.judge.joined_late(&last, &told);
                self.judged(verdict);
            }
            Asker::Fetch { fetch, pattern } => self.fetch_answered(fetch, pattern, &answers),
        }
    }

    /// A console joins, and asks for what it has missed.
    pub(super) fn join_late(&mut self) {
        for throne in [Throne::Roster, Throne::Teams, Throne::Audit] {
            let Some(last) = self.judge.last_on(throne) else { continue };
            let selector = self.space.format(&last.keys().0);
            let ask = Ask { selector, parameters: "format=bincode", payload: None };
            self.ask(self.operator.link, ask, Asker::LateJoiner(last));
        }
    }

    fn fetch_answered(&mut self, id: u64, pattern: String, answers: &[Arc<Answer>]) {
        let Some(begun) = self.fetches.get_mut(&id) else { return };
        let understand = self.nodes[begun.node].kind.understand;
        let before = begun.messages.len();
        for answer in answers {
            if let Answer::Packets(packets) = answer.as_ref() {
                let understood = packets.iter().filter_map(|p| understand(&self.space, p).ok());
                begun.messages.extend(understood);
            }
        }
        let again = self.now < begun.until && begun.patient.contains(&pattern);
        if begun.messages.len() == before && again {
            self.schedule(self.now + START_AGAIN, Event::AskAgain { fetch: id, pattern });
            return;
        }
        begun.open -= 1;
        if begun.open == 0 {
            self.end_fetch(id);
        }
    }

    fn end_fetch(&mut self, id: u64) {
        let Some(Fetch { node, life, fetch, messages, .. }) = self.fetches.remove(&id) else {
            return;
        };
        if self.nodes[node].life == life {
            self.nodes[node].end(Input::Fetched { fetch, messages });
            self.kick(node);
        }
    }

    /// The operator asks for what it wants.
    pub(super) fn operate(&mut self) {
        for (service, patch) in self.operator.next() {
            self.set(service, patch);
        }
        self.schedule(self.now + OPERATOR_AGAIN, Event::Operate);
    }

    fn set(&mut self, service: ServiceName, patch: String) {
        let selector = self.space.format(&Key::Settings(service));
        let ask = Ask { selector, parameters: "", payload: Some(patch.into_bytes()) };
        self.ask(self.operator.link, ask, Asker::Operator(service));
    }
}
