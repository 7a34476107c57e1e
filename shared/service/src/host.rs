//! Everything that every service needs around its core, without doing any of it: one input in,
//! commands out.
//!
//! The host owns the election, suppressed output, settings, refused messages, fetches with retries,
//! gets, the one job, and the order of it all. It reads no clock and touches no bus. The real shell,
//! the simulation, the replay and the tests drive this one host, so that the order that ships is the
//! order that is tested.

mod answering;
mod commanding;
mod leadership;
mod state_loss;

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use muster_model::role::ReplicaState;
use muster_model::status::ServiceStatus;
use muster_model::time::Tick;
use muster_wire::message::quoted;
use muster_wire::{KeySpace, Message};

use self::leadership::Occasion;
use crate::commands::Commands;
use crate::core::{Connectivity, Context, Core, CoreFacilities, JobEnd, MemoryUse, View};
use crate::facilities::{Facilities, JobSlot};
use crate::failures::{Failures, JobOutcomes, JobsFailing};
use crate::fetches::{Fetched, Fetches, Purpose};
use crate::gets::Gets;
use crate::io::{Arrival, AskId, Command, Input};
use crate::replica::Replica;
use crate::replica::election::{RenewalSource, Rivalry};
use crate::start::Start;
use crate::unstored::UnstoredTerm;

/// Shortest time between two timers: a core that names a past moment again and again must not keep
/// its process from everything else.
const TIMER_INTERVAL: Duration = Duration::from_millis(1);

/// A core with everything around it but the world.
pub struct Host<C: Core> {
    core: C,
    facilities: CoreFacilities<C>,
    /// The result of the job, from [`Host::finish_job`] to the input that says it has ended.
    done: Option<C::Done>,
    /// No timer comes before this.
    timer_not_before: Tick,
    /// Where the instance stood when its caller last learned of it.
    announced_state: ReplicaState,
    process_counters: BTreeMap<String, u64>,
    next_query: u64,
}

impl<C: Core> Host<C> {
    /// A host to which nothing has happened; the first input is [`Input::Started`].
    #[must_use]
    pub fn new(start: Start<C::Settings>) -> Self {
        let now = start.now;
        let operator_commands = Commands::new(&start.stored.commands);
        let replica = Replica::new(C::SERVICE, C::REPLICATION, start);
        let core = C::new(now, replica.settings.current());
        let facilities = Facilities {
            now,
            replica,
            fetches: Fetches::default(),
            fetched: VecDeque::new(),
            gets: Gets::default(),
            operator_commands,
            unsaid: VecDeque::new(),
            is_loss_reported: false,
            job: JobSlot::Free,
            failures: Failures::default(),
            jobs: JobOutcomes::default(),
            commands: Vec::new(),
            store_again_at: None,
            unstored_term: UnstoredTerm::default(),
        };
        Self {
            core,
            facilities,
            done: None,
            timer_not_before: now,
            announced_state: ReplicaState::Starting,
            process_counters: BTreeMap::new(),
            next_query: 0,
        }
    }

    /// Handles one input and returns what is to be done, in order.
    #[must_use = "commands that are not carried out are lost"]
    pub fn handle(&mut self, now: Tick, input: Input) -> Vec<Command> {
        self.core.before_input(now);
        self.facilities.now = now;
        let was_leading = self.facilities.replica.election.is_leading();
        if self.facilities.replica.election.notice_pause(now) {
            self.paused(was_leading);
        }
        self.dispatch(input);
        self.handle_fetched();
        if self.facilities.replica.election.takes_over(now) {
            self.inquire();
        }
        self.ask_for_settings();
        self.core.after_input(&mut Context(&mut self.facilities));
        self.renew();
        self.handle_fetched();
        let state = self.facilities.replica.election.state();
        if state != std::mem::replace(&mut self.announced_state, state) {
            self.facilities.commands.push(Command::ReplicaState(state));
        }
        let mut commands = std::mem::take(&mut self.facilities.commands);
        self.facilities.unstored_term.pass(now, state, &mut commands);
        commands
    }

    /// The job that [`Command::RunJob`] is about; none if it was taken already.
    pub fn take_job(&mut self) -> Option<C::Job> {
        match std::mem::replace(&mut self.facilities.job, JobSlot::Running) {
            JobSlot::Ready(job) => Some(job),
            other => {
                self.facilities.job = other;
                None
            }
        }
    }

    /// Brings the result of the job; [`Input::JobEnded`] is the next input.
    pub fn finish_job(&mut self, done: C::Done) {
        self.done = Some(done);
    }

    /// When [`Input::Timer`] is wanted.
    #[must_use]
    pub fn deadline(&self) -> Option<Tick> {
        let core = self.core.deadline(&View(&self.facilities));
        let election = self.facilities.replica.election.deadline();
        let fetches = self.facilities.fetches.deadline();
        let store = self.facilities.store_again_at;
        let unstored = self.facilities.unstored_term.deadline(self.replica_state());
        let due = [core, election, fetches, store, unstored].into_iter().flatten().min()?;
        Some(due.max(self.timer_not_before))
    }

    /// Where the instance stands in the election.
    #[must_use]
    pub fn replica_state(&self) -> ReplicaState {
        self.facilities.replica.election.state()
    }

    /// What the service reports of itself.
    #[must_use]
    pub fn status(&self, now: Tick) -> ServiceStatus {
        let state = self.core.state(&View(&self.facilities));
        let status = self.facilities.replica.status(now, state);
        ServiceStatus { departed: self.core.departed(now), ..status }
    }

    /// Since when every job of a leader has failed; none if the last one has not.
    #[must_use]
    pub fn failing_jobs(&self) -> Option<&JobsFailing> {
        let is_leading = self.facilities.replica.election.is_leading();
        self.facilities.jobs.failing().filter(|_| is_leading)
    }

    /// What the service holds in memory.
    #[must_use]
    pub fn memory_use(&self) -> MemoryUse {
        let offenders = self.facilities.replica.refusals.offender_count();
        MemoryUse { offenders, ..self.core.memory_use() }
    }

    /// The keys of the fleet.
    #[must_use]
    pub fn space(&self) -> &KeySpace {
        &self.facilities.replica.space
    }

    /// The core, to look at.
    #[must_use]
    pub fn core(&self) -> &C {
        &self.core
    }

    fn dispatch(&mut self, input: Input) {
        match input {
            Input::Started { linked } => self.start(linked),
            Input::Arrived(arrival) => self.arrived(arrival),
            Input::Timer => {
                self.timer_not_before = self.facilities.now.after(TIMER_INTERVAL);
                self.confirm_leadership();
                self.facilities.store_again_when_due();
                let asks = self.facilities.fetches.due(self.facilities.now);
                self.facilities.commands.extend(asks.into_iter().map(Command::Ask));
                self.core.on_timer(&mut Context(&mut self.facilities));
            }
            Input::JobEnded { panic, .. } => self.job_ended(panic),
            Input::Answered { ask, answers } => self.answered(ask, answers),
            Input::Get(get) => {
                self.facilities.replica.election.others_heard();
                self.get(get);
            }
            Input::LinkLost => {
                self.facilities.replica.election.link_lost();
                self.report_connectivity(Connectivity::Offline);
            }
            Input::LinkRestored => self.link_restored(),
            Input::Stored { error } => {
                self.facilities.unstored_term.stored();
                self.confirm_leadership();
                self.facilities.store_ended(error.as_deref());
                let replies = self.facilities.gets.stored(error.as_deref());
                self.facilities.commands.extend(replies.into_iter().map(Command::Reply));
            }
            Input::Restored(content) => {
                if let Err(problem) = self.core.on_restored(&content) {
                    self.facilities.commands.push(Command::KeptIsUnusable(problem));
                }
            }
            Input::Kept { error } => {
                self.confirm_leadership();
                self.core.on_kept(&mut Context(&mut self.facilities), error.is_none());
            }
            Input::Found { lookup, page } => {
                self.confirm_leadership();
                self.core.on_records(&mut Context(&mut self.facilities), lookup, page);
            }
            Input::Recorded(report) => {
                self.confirm_leadership();
                self.core.on_recorded(&mut Context(&mut self.facilities), *report);
            }
            Input::ProcessCounters(counters) => self.process_counters = counters,
            Input::StateLost { reason } => self.facilities.state_lost(&reason),
        }
    }

    fn report_connectivity(&mut self, connectivity: Connectivity) {
        self.core.on_connectivity(&mut Context(&mut self.facilities), connectivity);
    }

    fn start(&mut self, linked: bool) {
        self.inquire();
        if !linked {
            self.facilities.replica.election.link_lost();
            self.report_connectivity(Connectivity::Offline);
        }
    }

    fn arrived(&mut self, arrival: Arrival) {
        if arrival.is_foreign() {
            self.confirm_leadership();
            let packet = arrival.into_packet();
            return self.core.on_foreign(&mut Context(&mut self.facilities), packet);
        }
        let key = arrival.packet().key.clone();
        let decoded = arrival.into_message(&self.facilities.replica.space);
        let message = match decoded.and_then(|message| self.facilities.believed(&key, message)) {
            Ok(message) => message,
            Err(rejection) => {
                self.confirm_leadership();
                return self.facilities.refuse(rejection);
            }
        };
        if !self.is_own(&message) {
            self.facilities.replica.election.others_heard();
        }
        match message {
            Message::LeaseRenewal(renewal) => {
                let rivalry = self.renewal(&renewal, RenewalSource::Published);
                self.resolve(rivalry);
                self.leader_renewed();
                self.confirm_leadership();
            }
            Message::ServiceToken { service, instance, alive } if service == C::SERVICE => {
                self.facilities.replica.election.token(self.facilities.now, instance, alive);
                self.confirm_leadership();
            }
            Message::Settings(announced) if announced.service == C::SERVICE => {
                self.adopt(&announced);
                self.replace_leader_without_state(&announced);
                self.confirm_leadership();
            }
            Message::Outcome(outcome) if outcome.service == C::SERVICE => {
                self.learn_outcome(outcome);
                self.confirm_leadership();
            }
            message => {
                self.confirm_leadership();
                self.core.on_message(&mut Context(&mut self.facilities), message);
            }
        }
    }

    /// Whether a message may be one that this instance has put itself: the bus delivers those as well.
    fn is_own(&self, message: &Message) -> bool {
        match message {
            Message::LeaseRenewal(renewal) => {
                renewal.instance == *self.facilities.replica.election.instance()
            }
            Message::ServiceToken { .. } | Message::Settings(_) | Message::Outcome(_) => true,
            message => C::is_output(message),
        }
    }

    fn answered(&mut self, ask: AskId, arrivals: Vec<Arrival>) {
        self.confirm_leadership();
        let (mut messages, mut refused) = (Vec::new(), Vec::new());
        for arrival in arrivals {
            let key = arrival.packet().key.clone();
            let decoded = arrival.into_message(&self.facilities.replica.space);
            match decoded.and_then(|message| self.facilities.believed(&key, message)) {
                Ok(message) => messages.push(message),
                Err(rejection) => refused.push(rejection),
            }
        }
        self.facilities.replica.add("answers_refused", refused.len() as u64);
        if !messages.is_empty() {
            self.facilities.replica.election.others_heard();
        }
        let ended = self.facilities.fetches.answered(self.facilities.now, ask, messages);
        self.facilities.fetched.extend(ended);
    }

    fn handle_fetched(&mut self) {
        while let Some(fetched) = self.facilities.fetched.pop_front() {
            self.handle_answers(fetched);
        }
    }

    fn handle_answers(&mut self, fetched: Fetched<C::Fetch>) {
        let Fetched { purpose, answers } = fetched;
        match purpose {
            Purpose::Start => self.inquiry_answered(answers, Occasion::Start),
            Purpose::TakeOver => self.inquiry_answered(answers, Occasion::TakeOver),
            Purpose::Leader(query) => {
                if self.renewals_among(&answers) == Rivalry::StandDown {
                    return self.stand_down();
                }
                self.facilities.replica.election.leader_query_unanswered(query);
                self.confirm_leadership();
            }
            Purpose::Settings => self.adopt_all(&answers),
            Purpose::TermCheck => self.term_checked(answers),
            Purpose::Core(fetch) => {
                self.core.on_answers(&mut Context(&mut self.facilities), fetch, answers);
            }
        }
    }

    fn job_ended(&mut self, panic: Option<String>) {
        self.confirm_leadership();
        let done = self.done.take();
        let slot = std::mem::replace(&mut self.facilities.job, JobSlot::Free);
        let context = &mut Context(&mut self.facilities);
        match (slot, done, panic) {
            (JobSlot::Abandoned, ..) => self.core.on_job_slot_free(context),
            (JobSlot::Running, Some(done), None) => {
                self.core.on_job(context, JobEnd::Finished(done));
            }
            (JobSlot::Running, _, panic) => {
                let text = panic.as_deref().map_or("it ended without a result".into(), quoted);
                self.core.on_job(context, JobEnd::Panicked(format!("the job panicked: {text}")));
            }
            // No job was running: the caller repeats itself.
            (slot @ (JobSlot::Free | JobSlot::Ready(_)), ..) => self.facilities.job = slot,
        }
    }
}
