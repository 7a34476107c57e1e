//! What a hook of a core may see and do.

use std::collections::VecDeque;

use muster_model::event::{EventKind, Severity};
use muster_model::header::{Revision, StageTime};
use muster_model::id::FleetId;
use muster_model::role::ReplicaState;
use muster_model::time::Tick;
use muster_wire::{Attachment, ForeignKey, Key, KeySpace, Message, Packet, Pattern, Rejection};

use crate::core::Core;
use crate::failures::Failures;
use crate::fetches::{Fetched, Fetches, Purpose};
use crate::gets::{Get, Gets, encode_answer};
use crate::io::{Command, GetId, Publication, Record, RecordRange, Reply};
use crate::replica::Replica;

/// The one job of a service.
pub(crate) enum JobSlot<Job> {
    /// None runs.
    Free,
    /// One is handed out next.
    Ready(Job),
    /// One runs.
    Running,
    /// One runs whose result nobody waits for.
    Abandoned,
}

/// What the host does for a core.
pub(crate) struct Facilities<C: Core> {
    pub(crate) now: Tick,
    pub(crate) replica: Replica<C::Settings>,
    pub(crate) fetches: Fetches<C::Fetch>,
    /// Fetches that have ended within the current input.
    pub(crate) fetched: VecDeque<Fetched<C::Fetch>>,
    pub(crate) gets: Gets,
    pub(crate) job: JobSlot<C::Job>,
    pub(crate) failures: Failures,
    pub(crate) commands: Vec<Command>,
}

/// The right to start a job: none runs, and this instance leads.
#[derive(Debug)]
pub struct FreeJobSlot(());

/// What a core may look at when it is asked for its deadline or state.
pub struct View<'a, C: Core>(pub(crate) &'a Facilities<C>);

impl<C: Core> View<'_, C> {
    /// The settings in force.
    #[must_use]
    pub fn settings(&self) -> &C::Settings {
        self.0.replica.settings.current()
    }

    /// Whether this instance leads, so that its output is published.
    #[must_use]
    pub fn is_leading(&self) -> bool {
        self.0.replica.election.is_leading()
    }

    /// Whether this instance has begun a term and not stood down since. A suspect has.
    #[must_use]
    pub fn has_term(&self) -> bool {
        self.0.replica.election.has_term()
    }

    /// Where this instance stands in the election.
    #[must_use]
    pub fn replica_state(&self) -> ReplicaState {
        self.0.replica.election.state()
    }

    /// Whether a job runs.
    #[must_use]
    pub fn is_job_running(&self) -> bool {
        !matches!(self.0.job, JobSlot::Free)
    }
}

/// What a hook may do. Output of an instance that does not lead is suppressed.
pub struct Context<'a, C: Core>(pub(crate) &'a mut Facilities<C>);

impl<C: Core> Context<'_, C> {
    /// What may be looked at.
    #[must_use]
    pub fn view(&self) -> View<'_, C> {
        View(self.0)
    }

    /// The moment of the input.
    #[must_use]
    pub fn now(&self) -> Tick {
        self.0.now
    }

    /// The keys of the fleet.
    #[must_use]
    pub fn space(&self) -> &KeySpace {
        &self.0.replica.space
    }

    /// The fleet.
    #[must_use]
    pub fn fleet(&self) -> &FleetId {
        self.0.replica.fleet()
    }

    /// The settings in force.
    #[must_use]
    pub fn settings(&self) -> &C::Settings {
        self.0.replica.settings.current()
    }

    /// Whether this instance leads, so that its output is published.
    #[must_use]
    pub fn is_leading(&self) -> bool {
        self.view().is_leading()
    }

    /// Whether this instance has begun a term and not stood down since. A suspect has.
    #[must_use]
    pub fn has_term(&self) -> bool {
        self.view().has_term()
    }

    /// Where this instance stands in the election.
    #[must_use]
    pub fn replica_state(&self) -> ReplicaState {
        self.view().replica_state()
    }

    /// Publishes a message, if this instance leads.
    pub fn publish(&mut self, message: Message) {
        if self.is_leading() {
            self.0.publish(message);
        }
    }

    /// Publishes a packet on a key of another program, if this instance leads.
    pub fn publish_foreign(
        &mut self,
        key: &ForeignKey,
        encoding: &str,
        payload: Vec<u8>,
        attachment: Option<Attachment>,
    ) {
        if self.is_leading() {
            let packet = Packet::put(key.as_str(), encoding, payload);
            let packets = vec![Packet { attachment, ..packet }];
            let publication = Publication { packets, is_lease_renewal: false, message: None };
            self.0.commands.push(Command::Publish(publication));
        }
    }

    /// Publishes an event of the service, if this instance leads.
    pub fn publish_event(&mut self, severity: Severity, kind: EventKind) {
        if self.has_term() {
            let event = self.0.replica.event(self.0.now, severity, kind);
            self.publish(event);
        }
    }

    /// The revision of the next output.
    pub fn next_revision(&mut self) -> Revision {
        self.0.replica.next_revision()
    }

    /// The stage of this service for the header of an output that is published now. `received` is
    /// when its input came.
    #[must_use]
    pub fn stage(&self, received: Tick) -> StageTime {
        self.0.replica.stage(received, self.0.now)
    }

    /// Adds one to a counter of the status.
    pub fn count(&mut self, counter: &'static str) {
        self.add(counter, 1);
    }

    /// Adds to a counter of the status.
    pub fn add(&mut self, counter: &'static str, count: u64) {
        self.0.replica.add(counter, count);
    }

    /// Refuses the content of a message: it is counted, and reported by an event at a bounded rate.
    pub fn refuse(&mut self, key: &Key, reason: impl AsRef<str>) {
        let space = &self.0.replica.space;
        let rejection = Rejection::new(space, &space.format(key), reason);
        self.0.refuse(rejection);
    }

    /// Asks the bus for the newest messages. The answers come by [`Core::on_answers`], within a
    /// bounded time even if nobody answers.
    pub fn fetch(&mut self, fetch: C::Fetch, patterns: Vec<Pattern>) {
        self.0.fetch(Purpose::Core(fetch), patterns);
    }

    /// The right to start a job; none if one runs or this instance does not lead.
    #[must_use]
    pub fn free_job_slot(&self) -> Option<FreeJobSlot> {
        let is_free = self.is_leading() && !self.view().is_job_running();
        is_free.then_some(FreeJobSlot(()))
    }

    /// Starts a job. Its end comes by [`Core::on_job`]. Of two jobs that a core starts at once, the
    /// second is dropped and counted.
    pub fn start_job(&mut self, _slot: FreeJobSlot, job: C::Job) {
        if !matches!(self.0.job, JobSlot::Free) {
            return self.count("jobs_dropped");
        }
        self.0.job = JobSlot::Ready(job);
        self.0.commands.push(Command::RunJob);
    }

    /// Gives up on the running job, if one runs: its result is dropped, and
    /// [`Core::on_job_slot_free`] follows its end.
    pub fn abandon_job(&mut self) {
        self.0.abandon_job();
    }

    /// Counts a failed job and reports it by an event, at a bounded rate for each kind.
    pub fn report_job_failure(&mut self, kind: &'static str, reason: &str) {
        self.count("jobs_failed");
        if self.0.failures.is_to_be_reported(self.0.now, kind) {
            let kind = EventKind::JobFailed { reason: reason.to_owned() };
            self.publish_event(Severity::Error, kind);
        }
    }

    /// Answers a get with messages, of which those are sent that it selects.
    pub fn reply(&mut self, get: Get, messages: Vec<Message>) {
        self.0.reply(get.id, Ok(messages), ReplyKind::Plain);
    }

    /// Answers a get with an error text that names the remedy.
    pub fn reply_error(&mut self, get: Get, error: impl Into<String>) {
        self.0.reply(get.id, Err(error.into()), ReplyKind::Plain);
    }

    /// Declares a liveliness token of the service's own.
    pub fn declare_token(&mut self, key: Key) {
        self.0.commands.push(Command::DeclareToken(key));
    }

    /// Withdraws a liveliness token.
    pub fn withdraw_token(&mut self, key: Key) {
        self.0.commands.push(Command::WithdrawToken(key));
    }

    /// Appends a record to the service's own, with the moment of the input.
    pub fn append(&mut self, content: Vec<u8>) {
        self.0.commands.push(Command::Append(Record { at: self.0.now.0, content }));
    }

    /// Looks records up. They come by [`Core::on_records`] with the number.
    pub fn look_up(&mut self, lookup: u64, range: RecordRange) {
        self.0.commands.push(Command::LookUp { lookup, range });
    }
}

/// What an answer says about stored state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ReplyKind {
    /// Nothing.
    Plain,
    /// That something is stored, so that it is wrong if that fails.
    ConfirmsStore,
}

impl<C: Core> Facilities<C> {
    /// Publishes a message, whatever state the instance is in.
    pub(crate) fn publish(&mut self, message: Message) {
        match message.publish(self.now) {
            Ok(outbound) => {
                let space = &self.replica.space;
                let packets = outbound.into_iter().map(|outbound| outbound.into_packet(space));
                self.commands.push(Command::Publish(Publication {
                    packets: packets.collect(),
                    is_lease_renewal: matches!(message, Message::LeaseRenewal(_)),
                    message: Some(message),
                }));
            }
            Err(error) => {
                let problem = format!("{} is not published: {error}", message.keys().0);
                self.commands.push(Command::Unencodable(problem));
            }
        }
    }

    /// Counts a refused message and reports it, unless the term has not begun or the like has just
    /// been reported.
    pub(crate) fn refuse(&mut self, rejection: Rejection) {
        self.replica.add("messages_refused", 1);
        if !self.replica.election.has_term() {
            return;
        }
        let Some(count) = self.replica.refusals.add(self.now, &rejection) else { return };
        let Rejection { robot, key, reason } = rejection;
        let kind = EventKind::Quarantined { robot, key, reason, count };
        Context(self).publish_event(Severity::Warning, kind);
    }

    pub(crate) fn fetch(&mut self, purpose: Purpose<C::Fetch>, patterns: Vec<Pattern>) {
        let of_host = [Key::Lease(C::SERVICE), Key::Settings(C::SERVICE)].map(Pattern::One);
        // An instance that starts goes on asking, for those who know the last output may need a moment to
        // reconnect after a failure of the router. A leader answers at once, or there is none.
        let retries = |pattern: &Pattern| purpose == Purpose::Start && !of_host.contains(pattern);
        let mut asks = Vec::new();
        let ended = self.fetches.begin(self.now, purpose, patterns, retries, &mut asks);
        self.fetched.extend(ended);
        self.commands.extend(asks.into_iter().map(Command::Ask));
    }

    pub(crate) fn abandon_job(&mut self) {
        match self.job {
            JobSlot::Running => self.job = JobSlot::Abandoned,
            JobSlot::Ready(_) => {
                self.job = JobSlot::Free;
                self.commands.retain(|command| *command != Command::RunJob);
            }
            JobSlot::Free | JobSlot::Abandoned => {}
        }
    }

    pub(crate) fn store(&mut self) {
        self.gets.store_started();
        self.commands.push(Command::Store(self.replica.stored()));
    }

    pub(crate) fn reply(
        &mut self,
        get: GetId,
        answer: Result<Vec<Message>, String>,
        kind: ReplyKind,
    ) {
        let Some(request) = self.gets.close(get) else { return };
        let (answer, messages) = match answer {
            Ok(messages) => {
                let packets = encode_answer(&self.replica.space, &request, &messages, self.now);
                (packets, messages)
            }
            Err(error) => (Err(error), Vec::new()),
        };
        let reply = Reply { get, answer, messages };
        let reply = self.gets.pass(reply, kind == ReplyKind::ConfirmsStore);
        self.commands.extend(reply.map(Command::Reply));
    }

    /// Publishes the settings, so that standbys and other services follow them.
    pub(crate) fn announce_settings(&mut self) {
        let message = self.replica.settings_message(self.now);
        Context(self).publish(message);
    }
}
