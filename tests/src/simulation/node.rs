//! One instance of a service: its process, and what waits for it, in the order and within the bounds
//! that the real shell has.
//!
//! What comes over subscriptions waits in the real [`Inbox`]. Like the shell's loop, a turn takes one
//! of the kinds of work that are ready, and any of them may be first.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use muster_machine::{QueryId, Stored, Wiring};
use muster_model::id::ServiceName;
use muster_model::limits::MAX_ROBOT_PAYLOAD;
use muster_runtime::inbox::Inbox;
use muster_wire::{KeySpace, Message, Packet, Rejection, Request};

use super::chance::Chance;
use super::clock::{HostClock, MS, Micros, ProcessClock};
use super::machine::{Input, Kind, Machine};
use super::oracle::Speaker;
use super::router::{Ask, GetId, LinkId, includes, intersects, texts};

/// Shortest time between two timeouts, as in the shell.
const BETWEEN_TIMEOUTS: Micros = MS;

/// Most gets that wait for the core, as in the shell.
const MAX_QUERIES: usize = 256;

/// What came over a subscription: as in the shell, what robots say is understood as it comes, and
/// what services say when its turn comes.
#[derive(Debug)]
enum Arrival {
    Understood(Result<Message, Rejection>),
    Packet(Arc<Packet>),
}

/// A running process.
pub(crate) struct Process {
    pub(crate) machine: Box<dyn Machine>,
    pub(crate) clock: ProcessClock,
    inbox: Inbox<Arrival>,
    /// How many packets were put into the inbox at most that were not taken out; it may hold fewer.
    waiting: usize,
    asks: VecDeque<(GetId, Request)>,
    ended: VecDeque<Input>,
    /// Gets whose answer the core owes.
    pub(crate) owed: BTreeMap<QueryId, GetId>,
    next_query: u64,
    /// Tokens that it sees.
    seen: BTreeSet<Arc<str>>,
    not_before: Micros,
    /// When its errands thread has done what it was told.
    pub(crate) errands_free: Micros,
    /// The settings that it has announced last, and how often those were others than before.
    pub(crate) settings: String,
    pub(crate) announced: u32,
    /// The same as its last job began …
    pub(crate) announced_before_job: u32,
    /// … and as the job began whose result it goes by.
    pub(crate) announced_before_result: u32,
    /// How often in a row it was woken by its deadline and wanted nothing.
    pub(crate) idle: u32,
    /// The key of its liveliness token.
    pub(crate) token: Arc<str>,
}

/// One instance of a service on a host of its own.
pub(crate) struct Node {
    pub(crate) service: ServiceName,
    pub(crate) instance: usize,
    pub(crate) kind: Kind,
    pub(crate) link: LinkId,
    pub(crate) host: HostClock,
    /// What is on its disk.
    pub(crate) stored: Stored,
    /// Counts the processes.
    pub(crate) life: u32,
    pub(crate) process: Option<Process>,
    /// It is not started again before this.
    pub(crate) down_until: Micros,
    /// It takes no turn before this.
    pub(crate) busy_until: Micros,
    /// Until when and how long it takes over each event.
    pub(crate) slow: (Micros, Micros),
    /// Until when and how long its jobs take.
    pub(crate) slow_jobs: (Micros, Micros),
    /// Until when its jobs panic.
    pub(crate) panics_until: Micros,
    /// The next turn that is on the agenda.
    pub(crate) turn_at: Option<Micros>,
    pub(crate) chance: Chance,
    subscribed: Vec<(String, muster_machine::Delivery, usize)>,
    tokens: Vec<String>,
    served: Vec<String>,
}

impl Node {
    pub(crate) fn new(
        space: &KeySpace,
        service: ServiceName,
        instance: usize,
        link: LinkId,
        host: HostClock,
        chance: Chance,
    ) -> Self {
        let kind = Kind::of(service);
        let Wiring { subscriptions, tokens, served } = &kind.wiring;
        let subscribed = subscriptions
            .iter()
            .map(|s| (space.pattern(&s.pattern), s.delivery, s.pattern.payload_limit()))
            .collect();
        let served = texts(space, served.iter().map(|(pattern, _)| pattern));
        let tokens = texts(space, tokens);
        Self {
            service,
            instance,
            kind,
            link,
            host,
            stored: Stored::default(),
            life: 0,
            process: None,
            down_until: 0,
            busy_until: 0,
            slow: (0, 0),
            slow_jobs: (0, 0),
            panics_until: 0,
            turn_at: None,
            chance,
            subscribed,
            tokens,
            served,
        }
    }

    /// Its process, as the judge knows it.
    pub(crate) fn speaker(&self) -> Speaker {
        Speaker { service: self.service, instance: self.instance, process: self.life }
    }

    /// How it is called in the log.
    pub(crate) fn name(&self) -> String {
        format!("{}/{}", self.service, self.instance)
    }

    /// A process begins on the machine that was made for it.
    pub(crate) fn begin(
        &mut self,
        machine: Box<dyn Machine>,
        clock: ProcessClock,
        token: Arc<str>,
    ) {
        self.process = Some(Process {
            machine,
            clock,
            inbox: Inbox::default(),
            waiting: 0,
            asks: VecDeque::new(),
            ended: VecDeque::from([Input::Started]),
            owed: BTreeMap::new(),
            next_query: 0,
            seen: BTreeSet::new(),
            not_before: 0,
            errands_free: 0,
            settings: String::new(),
            announced: 0,
            announced_before_job: 0,
            announced_before_result: 0,
            idle: 0,
            token,
        });
    }

    /// Whether a put on a key reaches it.
    pub(crate) fn hears(&self, key: &str) -> bool {
        // A put on a wild key reaches every subscription that it meets.
        self.subscribed.iter().any(|(pattern, ..)| intersects(pattern, key))
    }

    /// Whether it follows a token.
    pub(crate) fn follows(&self, token: &str) -> bool {
        self.tokens.iter().any(|pattern| includes(pattern, token))
    }

    /// The patterns that it serves and that a get asks for.
    pub(crate) fn serves(&self, selector: &str) -> usize {
        self.served.iter().filter(|served| intersects(served, selector)).count()
    }

    /// A packet has come over the subscriptions.
    pub(crate) fn arrive(&mut self, space: &KeySpace, packet: &Arc<Packet>) {
        let Some(process) = &mut self.process else { return };
        for (pattern, delivery, limit) in &self.subscribed {
            if !intersects(pattern, &packet.key) {
                continue;
            }
            let size = packet.payload.as_ref().map_or(0, Vec::len);
            let packet = if size > *limit {
                Arc::new(Packet { payload: Err(size), ..packet.as_ref().clone() })
            } else {
                Arc::clone(packet)
            };
            let size = packet.key.len() + packet.payload.as_ref().map_or(0, Vec::len);
            process.waiting += 1;
            if *limit != MAX_ROBOT_PAYLOAD {
                let key = packet.key.clone();
                process.inbox.push(key, Arrival::Packet(packet), size, *delivery);
                continue;
            }
            take_in(process, self.kind.understand, space, &packet, size, *delivery);
        }
    }

    /// A token has appeared or is gone, as far as the process can see.
    pub(crate) fn see_token(&mut self, space: &KeySpace, key: &Arc<str>, alive: bool) {
        if !self.follows(key) {
            return;
        }
        let Some(process) = &mut self.process else { return };
        let is_new =
            if alive { process.seen.insert(Arc::clone(key)) } else { process.seen.remove(key) };
        if !is_new {
            return;
        }
        let packet = Packet::token(key.to_string(), alive);
        process.waiting += 1;
        let latest = muster_machine::Delivery::Latest;
        take_in(process, self.kind.understand, space, &packet, key.len(), latest);
    }

    /// The link is lost or back. The bus forgets the tokens of others with a lost link, and it is
    /// chance whether the core hears of that first.
    pub(crate) fn link_changed(&mut self, space: &KeySpace, up: bool) {
        let Some(process) = &mut self.process else { return };
        process.ended.push_back(if up { Input::LinkRestored } else { Input::LinkLost });
        if !up {
            for key in process.seen.clone() {
                self.see_token(space, &key, false);
            }
        }
    }

    /// A get has reached it: one query for each pattern that it serves, narrowed to that.
    pub(crate) fn asked(&mut self, get: GetId, ask: &Ask) {
        let Some(process) = &mut self.process else { return };
        for served in &self.served {
            if !intersects(served, &ask.selector) || process.asks.len() >= MAX_QUERIES {
                continue;
            }
            let request = Request::new(ask.selector.clone(), ask.parameters, ask.payload.clone());
            // The simulation asks for nothing that is refused here.
            let Ok(request) = request else { continue };
            let request = if includes(&ask.selector, served) {
                request.narrowed(served.clone())
            } else {
                request
            };
            process.asks.push_back((get, request));
        }
    }

    /// Something that the process started has ended.
    pub(crate) fn end(&mut self, input: Input) {
        if let Some(process) = &mut self.process {
            process.ended.push_back(input);
        }
    }

    /// When it has something to do; none if it waits for others.
    pub(crate) fn next_turn(&self, now: Micros) -> Option<Micros> {
        let process = self.process.as_ref()?;
        let at_once = !process.asks.is_empty() || !process.ended.is_empty() || process.waiting > 0;
        let due = process.machine.deadline();
        let due = due.map(|tick| process.clock.when(tick).max(process.not_before));
        let wanted = if at_once { Some(now) } else { due };
        Some(wanted?.max(self.busy_until).max(now))
    }

    /// Takes one piece of work; none if there is none.
    pub(crate) fn take_work(&mut self, now: Micros, space: &KeySpace) -> Option<Input> {
        let process = self.process.as_mut()?;
        let due = process.machine.deadline();
        let is_due =
            due.is_some_and(|due| process.clock.tick(now) >= due) && now >= process.not_before;
        // The start comes before everything else, as in the shell.
        if matches!(process.ended.front(), Some(Input::Started)) {
            return process.ended.pop_front();
        }
        let ready =
            [is_due, process.waiting > 0, !process.asks.is_empty(), !process.ended.is_empty()];
        let ready: Vec<usize> = (0..ready.len()).filter(|kind| ready[*kind]).collect();
        match self.chance.pick(&ready)? {
            0 => {
                process.not_before = now + BETWEEN_TIMEOUTS;
                Some(Input::Timeout)
            }
            1 => {
                let Some(arrival) = process.inbox.pop() else {
                    process.waiting = 0;
                    return self.take_work(now, space);
                };
                process.waiting -= 1;
                Some(Input::Received(match arrival {
                    Arrival::Understood(understood) => understood,
                    Arrival::Packet(packet) => (self.kind.understand)(space, &packet),
                }))
            }
            2 => {
                let (get, request) = process.asks.pop_front()?;
                let query = QueryId(process.next_query);
                process.next_query += 1;
                process.owed.insert(query, get);
                Some(Input::Query { query, request })
            }
            _ => process.ended.pop_front(),
        }
    }
}

fn take_in(
    process: &mut Process,
    understand: fn(&KeySpace, &Packet) -> Result<Message, Rejection>,
    space: &KeySpace,
    packet: &Packet,
    size: usize,
    delivery: muster_machine::Delivery,
) {
    match understand(space, packet) {
        Ok(message) => {
            let arrival = Arrival::Understood(Ok(message));
            process.inbox.push(packet.key.clone(), arrival, size, delivery);
        }
        Err(refused) => {
            let place = format!("{} refused", refused.key);
            let refused = Arrival::Understood(Err(refused));
            process.inbox.push(place, refused, size, muster_machine::Delivery::Latest);
        }
    }
}
