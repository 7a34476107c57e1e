//! What a service is: a core with a hook for everything that can happen, and what its hooks may do.

use std::sync::Arc;
use std::time::Duration;

use muster_model::command::CommandOutcome;
use muster_model::event::{EventKind, Severity};
use muster_model::header::{Revision, StageTime};
use muster_model::history::{Entry, Page, Query, Record, RecordingReport, Retention};
use muster_model::id::{FleetId, InstanceId, ServiceName};
use muster_model::role::ReplicaState;
use muster_model::settings::{Settings, SettingsError};
use muster_model::status::{Departure, StatusGauge};
use muster_model::time::Tick;
use muster_wire::{Attachment, ForeignKey, Key, KeySpace, Message, Packet, Pattern, Rejection};

use crate::facilities::{Facilities, JobSlot, ReplyKind};
use crate::fetches::{AnswerTime, Purpose};
use crate::gets::Get;
use crate::io::{Command, Publication};
use crate::stopwatch::Stopwatch;
use crate::wiring::{Delivery, Replication, ServedKey, Subscription, Wiring};

/// How many renewals or settings of leaders wait, as all leaders of a service publish on the same key: after a partition, or
/// when several begin at once, each has to learn of the others.
const LEADERS_AT_ONCE: usize = 8;

/// What a core holds in memory, counted. Settings and `model::limits` bound every count.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct MemoryUse {
    /// Records of single robots.
    pub robots: usize,
    /// Edges of graphs and of the reports that they are made of.
    pub edges: usize,
    /// Whole messages: rosters, embeddings, divisions, audits. A message shared by two places counts
    /// twice.
    pub messages: usize,
    /// Senders of refused messages that are watched for repetition. The host counts them.
    pub offenders: usize,
}

/// Whether silence on the bus proves anything about other instances and robots.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Connectivity {
    /// The link to the router is up, and this instance's place among the others is known again.
    Online,
    /// The link to the router is lost.
    Offline,
    /// The process did not run for a while. The link was never reported lost.
    Paused,
}

/// How a job ended.
#[derive(Debug)]
pub enum JobEnd<Done> {
    /// With a result.
    Finished(Done),
    /// With a panic, and its text: at most a line, without control characters.
    Panicked(String),
}

/// A service without its shell: a deterministic state machine.
///
/// The host calls one hook per event and owns everything that all services share: election and
/// terms, suppressed output, settings, refused messages, fetches, gets, jobs and stored state. A hook
/// reads no clock, starts no thread, opens no file and knows no bus; it acts through [`Context`].
pub trait Core: Send + Sized + 'static {
    /// Its settings.
    type Settings: Settings;
    /// Names its fetches, and so their answers.
    type Fetch: std::fmt::Debug + Copy + Eq + Send + 'static;
    /// Long work.
    type Job: Send + 'static;
    /// What long work leads to.
    type Done: Send + 'static;
    /// Its name.
    const SERVICE: ServiceName;
    /// If it keeps anything over a restart itself, by [`Context::keep`]: what happens without it, in a few words for the log.
    const WITHOUT_KEPT: Option<&'static str> = None;
    /// How many instances publish.
    const REPLICATION: Replication = Replication::OneLeads;

    /// Which keys it subscribes to and serves. The host adds settings, status and the election.
    fn wiring() -> Wiring;

    /// What an instance asks the bus for before it leads: its own last output and what it reads.
    fn initial() -> Vec<Pattern>;

    /// The key of its main output. The leader asks its readers from time to time what they have
    /// seen of it.
    fn output() -> Key;

    /// Whether a message is an output of this service, so that a new term must be above it.
    fn is_output(message: &Message) -> bool;

    /// A core to which nothing has happened.
    fn new(now: Tick, settings: &Self::Settings) -> Self;

    /// This instance leads from now on; `answers` is what the bus holds of [`Core::initial`], in no
    /// particular order.
    fn on_lead(&mut self, context: &mut Context<'_, Self>, answers: Vec<Message>);

    /// Another instance leads; `answers` as in [`Core::on_lead`].
    fn on_follow(&mut self, context: &mut Context<'_, Self>, answers: Vec<Message>);

    /// Another instance has taken over. The core forgets what it published.
    fn on_stand_down(&mut self, context: &mut Context<'_, Self>);

    /// This instance goes on in a new, higher term: readers have seen a higher revision than its own,
    /// or another instance had begun the same term. Everything is to be published again. `found` is
    /// what the readers hold of [`Core::output`].
    fn on_new_term(&mut self, context: &mut Context<'_, Self>, found: Vec<Message>);

    /// The leader has asked its readers what they hold of [`Core::output`], and none of them holds a higher
    /// revision than its own for the second time. `found` is what they hold: an output of an earlier term is
    /// one that this leader did not learn of when it began.
    fn on_term_sound(&mut self, _context: &mut Context<'_, Self>, _found: Vec<Message>) {}

    /// A message arrived.
    fn on_message(&mut self, context: &mut Context<'_, Self>, message: Message);

    /// A packet arrived on a key of another program, of a subscription to [`Pattern::Foreign`].
    fn on_foreign(&mut self, _context: &mut Context<'_, Self>, _packet: Packet) {}

    /// A get of a key that the core serves. It is answered exactly once, now or later.
    fn on_get(&mut self, context: &mut Context<'_, Self>, get: Get);

    /// A fetch has ended with the messages that were answered in time.
    fn on_answers(
        &mut self,
        _context: &mut Context<'_, Self>,
        _fetch: Self::Fetch,
        _answers: Vec<Message>,
    ) {
    }

    /// The instance asks the bus for [`Core::initial`], which also answers open questions.
    fn on_inquiry(&mut self, _context: &mut Context<'_, Self>) {}

    /// The deadline has passed.
    fn on_timer(&mut self, _context: &mut Context<'_, Self>) {}

    /// The job has ended.
    fn on_job(&mut self, _context: &mut Context<'_, Self>, _end: JobEnd<Self::Done>) {}

    /// A job that the core no longer waited for has ended, so that another one may start.
    fn on_job_slot_free(&mut self, _context: &mut Context<'_, Self>) {}

    /// Takes over what it kept in its last run. It is called before everything else, if at all: the file may
    /// be lost.
    ///
    /// # Errors
    /// Why that cannot be used, for operators. The core begins without it then.
    fn on_restored(&mut self, _content: &[u8]) -> Result<(), String> {
        Ok(())
    }

    /// What was given to [`Context::keep`] is on disk; or is not, and operators have been told why.
    fn on_kept(&mut self, _context: &mut Context<'_, Self>, _is_on_disk: bool) {}

    /// A lookup of records has ended, or nothing can be looked up, and why.
    fn on_records(
        &mut self,
        _context: &mut Context<'_, Self>,
        _lookup: u64,
        _page: Result<Page, String>,
    ) {
    }

    /// Records have been written, or could not be.
    fn on_recorded(&mut self, _context: &mut Context<'_, Self>, _report: RecordingReport) {}

    /// Whether changed settings work with what the core knows of the fleet. The settings by themselves are
    /// valid; a refused change leaves those in force.
    ///
    /// # Errors
    /// Names the field that does not work, and what would.
    fn check_settings(
        &self,
        _view: &View<'_, Self>,
        _settings: &Self::Settings,
    ) -> Result<(), SettingsError> {
        Ok(())
    }

    /// An operator has changed the settings.
    fn on_settings(&mut self, _context: &mut Context<'_, Self>) {}

    /// Silence on the bus means something else than before. A leader that was cut off gets [`Connectivity::Online`] only
    /// once it knows that no other instance has taken over.
    fn on_connectivity(&mut self, _context: &mut Context<'_, Self>, _connectivity: Connectivity) {}

    /// Before every input. `now` is the moment at which all commands of the input before were
    /// carried out.
    fn before_input(&mut self, _now: Tick) {}

    /// After every input: does what has become due.
    fn after_input(&mut self, _context: &mut Context<'_, Self>) {}

    /// When [`Core::on_timer`] is wanted next. It may come early or late, but it comes.
    fn deadline(&self, view: &View<'_, Self>) -> Option<Tick>;

    /// What the service is doing, in a few words.
    fn state(&self, view: &View<'_, Self>) -> String;

    /// Robots that have left within the last hour, the last one first; at most
    /// [`MAX_DEPARTED_ROBOTS`](muster_model::limits::MAX_DEPARTED_ROBOTS).
    fn departed(&self, _now: Tick) -> Vec<Departure> {
        Vec::new()
    }

    /// What the core holds now.
    fn memory_use(&self) -> MemoryUse {
        MemoryUse::default()
    }

    /// Does long work. Runs on another thread and depends on nothing but the job and the stopwatch.
    fn run(job: Self::Job, stopwatch: &mut Stopwatch) -> Self::Done;
}

impl Wiring {
    /// The wiring of a core with what the host adds: lease renewals, settings and tokens of the other
    /// instances come in; settings, status, the leader and the schema are served.
    #[must_use]
    pub fn of<C: Core>() -> Self {
        let mut wiring = C::wiring();
        let service = C::SERVICE;
        let mut served = vec![Key::Settings(service), Key::Status(service), Key::Schema];
        if C::REPLICATION == Replication::OneLeads {
            for key in [Key::Lease(service), Key::Settings(service)] {
                let (pattern, delivery) = (Pattern::One(key), Delivery::Queue(LEADERS_AT_ONCE));
                wiring.subscriptions.push(Subscription { pattern, delivery });
            }
            let pattern = Pattern::Commands(service);
            let delivery = Delivery::Latest;
            wiring.subscriptions.push(Subscription { pattern, delivery });
            wiring.tokens.push(Pattern::InstanceTokens(service));
            served.push(Key::Lease(service));
        }
        wiring.served.extend(served.into_iter().map(|key| ServedKey::own(Pattern::One(key))));
        wiring.served.push(ServedKey::own(Pattern::Commands(service)));
        wiring
    }
}

/// What the host does for a core.
pub(crate) type CoreFacilities<C> =
    Facilities<<C as Core>::Settings, <C as Core>::Fetch, <C as Core>::Job>;

/// The right to start a job: none runs, and this instance leads.
#[derive(Debug)]
pub struct FreeJobSlot(());

/// What a core may look at when it is asked for its deadline or state.
pub struct View<'a, C: Core>(pub(crate) &'a CoreFacilities<C>);

impl<C: Core> View<'_, C> {
    /// The moment of the last input.
    #[must_use]
    pub fn now(&self) -> Tick {
        self.0.now
    }

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
pub struct Context<'a, C: Core>(pub(crate) &'a mut CoreFacilities<C>);

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

    /// The commands that were carried out after a revision, by this instance or an earlier leader, the oldest first.
    #[must_use]
    pub fn carried_out_after(&self, revision: Revision) -> Vec<Arc<CommandOutcome>> {
        let outcomes = self.0.operator_commands.outcomes();
        let after = |outcome: &&Arc<CommandOutcome>| {
            outcome.refused.is_none() && outcome.header.revision > revision
        };
        let mut after: Vec<_> = outcomes.filter(after).cloned().collect();
        // Several leaders may have said them, each in its own order.
        after.sort_by_key(|outcome| outcome.header.revision);
        after
    }

    /// Publishes a message, if this instance leads.
    pub fn publish(&mut self, message: Message) {
        self.0.publish_as_leader(message);
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
        self.0.publish_event(severity, kind);
    }

    /// The revision of the last output; before the first one of a term, the beginning of the term.
    #[must_use]
    pub fn revision(&self) -> Revision {
        self.0.replica.revision()
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

    /// Says in the status how things are.
    pub fn set(&mut self, gauge: StatusGauge, value: u64) {
        self.0.replica.set(gauge, value);
    }

    /// This instance.
    #[must_use]
    pub fn instance(&self) -> &InstanceId {
        self.0.replica.election.instance()
    }

    /// Refuses the content of a message: it is counted, and reported by an event at a bounded rate.
    pub fn refuse(&mut self, key: &Key, reason: impl AsRef<str>) {
        let space = &self.0.replica.space;
        let rejection = Rejection::new(space, &space.format(key), reason);
        self.0.refuse(rejection);
    }

    /// Asks the bus for the newest messages. The answers come by [`Core::on_answers`], within a
    /// bounded time even without an answer.
    pub fn fetch(&mut self, fetch: C::Fetch, patterns: Vec<Pattern>) {
        self.0.fetch(Purpose::Core(fetch), patterns);
    }

    /// The same, with answers that are waited for as long as `within`, at most for ten seconds: large ones take
    /// their time on a busy bus. Once one is there, the fetch does not wait for those who remain silent.
    pub fn fetch_within(&mut self, fetch: C::Fetch, patterns: Vec<Pattern>, within: Duration) {
        self.0.fetch_in(Purpose::Core(fetch), patterns, AnswerTime::newest(within));
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
        self.0.jobs.failed(self.0.now, reason);
        if self.0.failures.is_to_be_reported(self.0.now, kind) {
            let kind = EventKind::JobFailed { reason: reason.to_owned() };
            self.publish_event(Severity::Error, kind);
        }
    }

    /// A job has ended well, or what the last one was for is over: the service works again.
    pub fn report_job_success(&mut self) {
        self.0.jobs.succeeded();
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

    /// Keeps this over a restart, in place of what was kept before. [`Core::on_kept`] follows, and the next
    /// run gets it by [`Core::on_restored`]. It works in every state of the replica.
    pub fn keep(&mut self, content: Vec<u8>) {
        self.0.commands.push(Command::Keep(content));
    }

    /// Appends a record to the history that this instance keeps, with the moment of the input.
    /// [`Core::on_recorded`] follows.
    pub fn append(&mut self, record: Record) {
        let entry = Entry { at: self.0.now, record };
        self.0.commands.push(Command::Append(Box::new(entry)));
    }

    /// Looks records up. They come by [`Core::on_records`] with the number.
    pub fn look_up(&mut self, lookup: u64, query: Query) {
        self.0.commands.push(Command::LookUp { lookup, query });
    }

    /// Forgets records that are too old or too many.
    pub fn retain(&mut self, retention: Retention) {
        self.0.commands.push(Command::Retain(retention));
    }
}
