//! One instance of a service: its process, and what waits for its host.
//!
//! What comes over subscriptions waits in the real [`Inbox`]. As in the shell's loop, one of the kinds
//! of input that are ready is taken at a time, and any of them may be first.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use muster_model::id::ServiceName;
use muster_model::role::ReplicaState;
use muster_model::wish::Wish;
use muster_service::inbox::{Inbox, Parcel};
use muster_service::records::Recorder;
use muster_service::{Delivery, GetId, IncomingGet, Input, Stored};
use muster_wire::{KeySpace, Packet, Pattern};

use super::chance::Chance;
use super::clock::{HostClock, Micros, ProcessClock};
use super::host::{AnyHost, ServiceKind};
use super::oracle::Publisher;
use super::recording::Disk;
use super::router::{BusGet, BusGetId, LinkId, includes, intersects};

/// Most gets that wait for the host, as the shell has them: a bounded channel from the threads of the
/// bus.
const MAX_WAITING_GETS: usize = 256;

/// A running process.
pub(crate) struct Process {
    pub(crate) host: Box<dyn AnyHost>,
    pub(crate) clock: ProcessClock,
    inbox: Inbox,
    waiting_gets: VecDeque<IncomingGet>,
    /// What has ended or changed: jobs, questions, stores, the link.
    completed: VecDeque<Input>,
    /// Gets that the host has not answered.
    pub(crate) unanswered: BTreeMap<GetId, UnansweredGet>,
    next_get: u64,
    /// Liveliness tokens that it sees.
    visible_tokens: BTreeSet<Arc<str>>,
    /// How many times state was handed to the disk.
    pub(crate) stores_begun: u64,
    /// How many of those have ended, as the host knows. Replies wait for them.
    pub(crate) stores_ended: u64,
    /// The same of what its core keeps: an answer that confirms a wish waits for that.
    pub(crate) keeps_begun: u64,
    pub(crate) keeps_ended: u64,
    /// When its disk has written everything.
    pub(crate) disk_free_at: Micros,
    /// Where the instance stands, as the host has announced it.
    pub(crate) announced_state: ReplicaState,
    /// The settings that it has published last, and how many times those differed from the ones before.
    pub(crate) settings: String,
    pub(crate) settings_changes: u32,
    /// The wishes that it has published last: their changes count as changes of settings.
    pub(crate) wishes: Vec<(String, Wish)>,
    /// The same count as its last job began …
    pub(crate) changes_before_job: u32,
    /// … and as the job began whose result it goes by.
    pub(crate) changes_before_result: u32,
    /// How many timers in a row led to nothing.
    pub(crate) idle_timers: u32,
    /// The key of its liveliness token.
    pub(crate) token: Arc<str>,
    /// What writes its records, if it keeps some.
    pub(crate) recorder: Option<Recorder>,
}

/// A get that the host has not answered.
#[derive(Debug)]
pub(crate) struct UnansweredGet {
    /// The get as the bus knows it.
    pub(crate) bus_get: BusGetId,
    /// How many stores had started when the host took the get; none if it has not.
    pub(crate) stores_before: Option<u64>,
    /// How many times its core had handed out what it keeps.
    pub(crate) keeps_before: u64,
}

/// A subscription as the bus knows it.
struct Subscribed {
    pattern: Pattern,
    text: String,
    delivery: Delivery,
}

/// One instance of a service on a machine of its own.
pub(crate) struct Node {
    pub(crate) service: ServiceName,
    pub(crate) instance: usize,
    pub(crate) kind: ServiceKind,
    pub(crate) link: LinkId,
    pub(crate) machine_clock: HostClock,
    /// What is on its disk.
    pub(crate) stored: Stored,
    /// What its core keeps there.
    pub(crate) kept: Option<Vec<u8>>,
    /// Counts the processes.
    pub(crate) life: u32,
    pub(crate) process: Option<Process>,
    /// It is not started again before this.
    pub(crate) down_until: Micros,
    /// It takes no input before this.
    pub(crate) busy_until: Micros,
    /// Until when and how long it takes over each input.
    pub(crate) slow: (Micros, Micros),
    /// Until when and how long its jobs take.
    pub(crate) slow_jobs: (Micros, Micros),
    /// Until when its jobs panic.
    pub(crate) panics_until: Micros,
    /// The next step that is on the agenda.
    pub(crate) step_at: Option<Micros>,
    pub(crate) chance: Chance,
    /// The disk for the records of a historian.
    pub(crate) disk: Option<Disk>,
    /// Since when its process runs and that disk has room.
    pub(crate) recording_since: Micros,
    subscribed: Vec<Subscribed>,
    tokens: Vec<String>,
    served: Vec<String>,
}

impl Node {
    pub(crate) fn new(
        space: &KeySpace,
        service: ServiceName,
        instance: usize,
        link: LinkId,
        machine_clock: HostClock,
        chance: Chance,
    ) -> Self {
        let kind = ServiceKind::of(service);
        let subscribed = kind.wiring.subscriptions.iter().map(|subscription| Subscribed {
            pattern: subscription.pattern.clone(),
            text: space.pattern(&subscription.pattern),
            delivery: subscription.delivery,
        });
        let subscribed = subscribed.collect();
        let served = kind.wiring.served.iter().map(|served| space.pattern(&served.pattern));
        let served = served.collect();
        let tokens = kind.wiring.tokens.iter().map(|pattern| space.pattern(pattern)).collect();
        Self {
            service,
            instance,
            kind,
            link,
            machine_clock,
            stored: Stored::default(),
            kept: None,
            life: 0,
            process: None,
            down_until: 0,
            busy_until: 0,
            slow: (0, 0),
            slow_jobs: (0, 0),
            panics_until: 0,
            step_at: None,
            chance,
            disk: (service == ServiceName::Historian).then(Disk::default),
            recording_since: 0,
            subscribed,
            tokens,
            served,
        }
    }

    /// Its process, as the oracle knows it.
    pub(crate) fn publisher(&self) -> Publisher {
        Publisher { service: self.service, instance: self.instance, process: self.life }
    }

    /// How it is called in the log.
    pub(crate) fn name(&self) -> String {
        format!("{}/{}", self.service, self.instance)
    }

    /// A process begins with the host that was made for it.
    pub(crate) fn begin(&mut self, host: Box<dyn AnyHost>, clock: ProcessClock, token: Arc<str>) {
        let restored = self.kept.clone().map(Input::Restored).into_iter();
        self.process = Some(Process {
            host,
            clock,
            inbox: Inbox::default(),
            waiting_gets: VecDeque::new(),
            // A process waits for its router before it starts its host.
            completed: restored.chain([Input::Started { linked: true }]).collect(),
            unanswered: BTreeMap::new(),
            next_get: 0,
            visible_tokens: BTreeSet::new(),
            stores_begun: 0,
            stores_ended: 0,
            keeps_begun: 0,
            keeps_ended: 0,
            disk_free_at: 0,
            announced_state: ReplicaState::Starting,
            settings: String::new(),
            settings_changes: 0,
            wishes: Vec::new(),
            changes_before_job: 0,
            changes_before_result: 0,
            idle_timers: 0,
            token,
            recorder: self.disk.as_ref().map(Disk::recorder),
        });
    }

    /// Whether a put on a key reaches it.
    pub(crate) fn subscribes_to(&self, key: &str) -> bool {
        // A put on a wild key reaches every subscription that it meets.
        self.subscribed.iter().any(|subscribed| intersects(&subscribed.text, key))
    }

    /// Whether it follows a token.
    pub(crate) fn follows(&self, token: &str) -> bool {
        self.tokens.iter().any(|pattern| includes(pattern, token))
    }

    /// How many patterns it serves that a get asks for.
    pub(crate) fn serves(&self, selector: &str) -> usize {
        self.served.iter().filter(|served| intersects(served, selector)).count()
    }

    /// A packet has come over the subscriptions. Each cuts it off at its limit, as the bus does.
    pub(crate) fn receive(&mut self, space: &KeySpace, packet: &Arc<Packet>) {
        let Some(process) = &mut self.process else { return };
        for Subscribed { pattern, text, delivery } in &self.subscribed {
            if !intersects(text, &packet.key) {
                continue;
            }
            let mut packet = packet.as_ref().clone();
            let size = packet.payload.as_ref().map_or(0, Vec::len);
            if size > pattern.payload_limit() {
                packet.payload = Err(size);
            }
            if let Some(parcel) = Parcel::new(space, packet, pattern, *delivery) {
                process.inbox.push(parcel);
            }
        }
    }

    /// A token has appeared or is gone, as far as the process can see.
    pub(crate) fn token_changed(&mut self, space: &KeySpace, key: &Arc<str>, alive: bool) {
        if !self.follows(key) {
            return;
        }
        let Some(process) = &mut self.process else { return };
        let tokens = &mut process.visible_tokens;
        let is_new = if alive { tokens.insert(Arc::clone(key)) } else { tokens.remove(key) };
        if !is_new {
            return;
        }
        process.inbox.push(Parcel::token(space, Packet::token(&**key, alive)));
    }

    /// The link is lost or back. The bus forgets the tokens of others with a lost link; which of
    /// the two the host receives first is random.
    pub(crate) fn link_changed(&mut self, space: &KeySpace, is_up: bool) {
        let Some(process) = &mut self.process else { return };
        process.completed.push_back(if is_up { Input::LinkRestored } else { Input::LinkLost });
        if !is_up {
            for key in process.visible_tokens.clone() {
                self.token_changed(space, &key, false);
            }
        }
    }

    /// A get has reached it, once for each pattern that it serves, and narrowed to that.
    pub(crate) fn receive_get(&mut self, bus_get: BusGetId, asked: &BusGet) {
        let Some(process) = &mut self.process else { return };
        for served in &self.served {
            let is_full = process.waiting_gets.len() >= MAX_WAITING_GETS;
            if !intersects(served, &asked.selector) || is_full {
                continue;
            }
            let get = GetId(process.next_get);
            process.next_get += 1;
            let stores_before = None;
            process
                .unanswered
                .insert(get, UnansweredGet { bus_get, stores_before, keeps_before: 0 });
            process.waiting_gets.push_back(IncomingGet {
                get,
                selector: asked.selector.clone(),
                narrowed: includes(&asked.selector, served).then(|| served.clone()),
                parameters: asked.parameters.to_owned(),
                payload: asked.payload.clone(),
            });
        }
    }

    /// Something that the process started has ended.
    pub(crate) fn complete(&mut self, input: Input) {
        if let Some(process) = &mut self.process {
            process.completed.push_back(input);
        }
    }

    /// When it has something to do; none if it waits for others.
    pub(crate) fn next_step(&self, now: Micros) -> Option<Micros> {
        let process = self.process.as_ref()?;
        let is_ready = !process.waiting_gets.is_empty()
            || !process.completed.is_empty()
            || !process.inbox.is_empty();
        let due = process.host.deadline().map(|tick| process.clock.when(tick));
        let wanted = if is_ready { Some(now) } else { due };
        Some(wanted?.max(self.busy_until).max(now))
    }

    /// Takes one input for the host; none if there is none.
    pub(crate) fn take_input(&mut self, now: Micros) -> Option<Input> {
        let process = self.process.as_mut()?;
        let is_due = process.host.deadline().is_some_and(|due| process.clock.tick(now) >= due);
        // The start comes before everything else, as in the shell.
        if matches!(process.completed.front(), Some(Input::Started { .. })) {
            return process.completed.pop_front();
        }
        let ready = [
            is_due,
            !process.inbox.is_empty(),
            !process.waiting_gets.is_empty(),
            !process.completed.is_empty(),
        ];
        let ready: Vec<usize> = (0..ready.len()).filter(|kind| ready[*kind]).collect();
        match self.chance.pick(&ready)? {
            0 => Some(Input::Timer),
            1 => process.inbox.pop().map(Input::Arrived),
            2 => process.waiting_gets.pop_front().map(Input::Get),
            _ => process.completed.pop_front(),
        }
    }
}

impl Process {
    /// How many gets the host has taken and not answered although all that was to be stored before is on
    /// the disk, and nothing is being stored: what came of a command is stored once the core has kept what it changed.
    pub(crate) fn overdue_answers(&self) -> usize {
        if self.stores_begun > self.stores_ended {
            return 0;
        }
        let is_stored = |before: u64| before <= self.stores_ended;
        let gets = self.unanswered.values();
        gets.filter(|get| {
            get.stores_before.is_some_and(is_stored) && get.keeps_before <= self.keeps_ended
        })
        .count()
    }
}
