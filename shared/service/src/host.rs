//! Everything that every service needs around its core, without doing any of it: one input in,
//! commands out.
//!
//! The host owns the election, suppressed output, settings, refused messages, fetches with retries,
//! gets, the one job, and the order of it all. It reads no clock and touches no bus. The real shell,
//! the simulation, the replay and the tests drive this one host, so that the order that ships is the
//! order that is tested.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use muster_model::event::{EventKind, Severity};
use muster_model::header::Revision;
use muster_model::role::ReplicaState;
use muster_model::time::Tick;
use muster_wire::message::quoted;
use muster_wire::{Key, KeySpace, Message, Outbound, Pattern, Request, schema};

use crate::context::{Context, Facilities, JobSlot, ReplyKind, View};
use crate::core::{Connectivity, Core, JobEnd, MemoryUse, Replication, Start};
use crate::failures::Failures;
use crate::fetches::{Fetched, Fetches, Purpose};
use crate::gets::{Get, Gets};
use crate::io::{Arrival, AskId, Command, GetId, IncomingGet, Input, Reply};
use crate::replica::Replica;
use crate::replica::election::{Decision, Reconnection, RenewalSource, Rivalry, TermCheck};
use crate::replica::settings::{Adoption, problem_json};

/// Shortest time between two timers: a core that names a past moment again and again must not keep
/// its process from everything else.
const TIMER_INTERVAL: Duration = Duration::from_millis(1);

/// A core with everything around it but the world.
pub struct Host<C: Core> {
    core: C,
    facilities: Facilities<C>,
    /// The result of the job, from [`Host::finish_job`] to the input that says it has ended.
    done: Option<C::Done>,
    /// No timer comes before this.
    timer_not_before: Tick,
    /// Where the instance stood when its caller was last told.
    announced_state: ReplicaState,
    process_counters: BTreeMap<String, u64>,
    next_query: u64,
}

impl<C: Core> Host<C> {
    /// A host to which nothing has happened; the first input is [`Input::Started`].
    #[must_use]
    pub fn new(start: Start<C::Settings>) -> Self {
        let now = start.now;
        let replica = Replica::new(C::SERVICE, C::REPLICATION, start);
        let core = C::new(now, replica.settings.current());
        let facilities = Facilities {
            now,
            replica,
            fetches: Fetches::default(),
            fetched: VecDeque::new(),
            gets: Gets::default(),
            job: JobSlot::Free,
            failures: Failures::default(),
            commands: Vec::new(),
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

    /// Takes one input and returns what is to be done, in order.
    #[must_use = "commands that are not carried out are lost"]
    pub fn handle(&mut self, now: Tick, input: Input) -> Vec<Command> {
        self.core.before_input(now);
        self.facilities.now = now;
        if self.facilities.replica.election.notice_pause(now) {
            if self.facilities.replica.election.is_linked() {
                self.ask_for_leader();
            }
            self.tell_connectivity(Connectivity::Paused);
        }
        self.dispatch(input);
        self.take_fetched();
        if self.facilities.replica.election.takes_over(now) {
            self.inquire();
        }
        self.core.after_input(&mut Context(&mut self.facilities));
        self.renew();
        self.take_fetched();
        let state = self.facilities.replica.election.state();
        if state != std::mem::replace(&mut self.announced_state, state) {
            self.facilities.commands.push(Command::ReplicaState(state));
        }
        std::mem::take(&mut self.facilities.commands)
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

    /// Brings the result of the job; [`Input::JobEnded`] says next that it has ended.
    pub fn finish_job(&mut self, done: C::Done) {
        self.done = Some(done);
    }

    /// When [`Input::Timer`] is wanted.
    #[must_use]
    pub fn deadline(&self) -> Option<Tick> {
        let core = self.core.deadline(&View(&self.facilities));
        let election = self.facilities.replica.election.deadline();
        let fetches = self.facilities.fetches.deadline();
        let due = [core, election, fetches].into_iter().flatten().min()?;
        Some(due.max(self.timer_not_before))
    }

    /// Where the instance stands in the election.
    #[must_use]
    pub fn replica_state(&self) -> ReplicaState {
        self.facilities.replica.election.state()
    }

    /// What the service reports of itself.
    #[must_use]
    pub fn status(&self, now: Tick) -> muster_model::status::ServiceStatus {
        self.facilities.replica.status(now, self.core.state(&View(&self.facilities)))
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
                let asks = self.facilities.fetches.due(self.facilities.now);
                self.facilities.commands.extend(asks.into_iter().map(Command::Ask));
                self.core.on_timer(&mut Context(&mut self.facilities));
            }
            Input::JobEnded { panic, .. } => self.job_ended(panic),
            Input::Answered { ask, answers } => self.answered(ask, answers),
            Input::Get(get) => self.get(get),
            Input::LinkLost => {
                self.facilities.replica.election.link_lost();
                self.tell_connectivity(Connectivity::Offline);
            }
            Input::LinkRestored => self.link_restored(),
            Input::Stored { error } => {
                self.confirm_leadership();
                let replies = self.facilities.gets.stored(error.as_deref());
                self.facilities.commands.extend(replies.into_iter().map(Command::Reply));
            }
            Input::Found { lookup, records } => {
                self.confirm_leadership();
                self.core.on_records(&mut Context(&mut self.facilities), lookup, records);
            }
            Input::ProcessCounters(counters) => self.process_counters = counters,
        }
    }

    fn tell_connectivity(&mut self, connectivity: Connectivity) {
        self.core.on_connectivity(&mut Context(&mut self.facilities), connectivity);
    }

    fn start(&mut self, linked: bool) {
        self.inquire();
        if !linked {
            self.facilities.replica.election.link_lost();
            self.tell_connectivity(Connectivity::Offline);
        }
    }

    /// Asks the bus for what an instance begins with: what the core wants, who leads, and with which
    /// settings.
    fn inquire(&mut self) {
        let takes_over = self.facilities.replica.election.inquire();
        let purpose = if takes_over { Purpose::TakeOver } else { Purpose::Start };
        let mut patterns = C::initial();
        if C::REPLICATION == Replication::OneLeads {
            let of_leader = [Key::Lease(C::SERVICE), Key::Settings(C::SERVICE)];
            patterns.extend(of_leader.map(Pattern::One));
        }
        self.core.on_inquiry(&mut Context(&mut self.facilities));
        self.facilities.fetch(purpose, patterns);
    }

    fn ask_for_leader(&mut self) {
        self.next_query += 1;
        let query = self.next_query;
        self.facilities.replica.election.leader_query_sent(query);
        let patterns = vec![Pattern::One(Key::Lease(C::SERVICE))];
        self.facilities.fetch(Purpose::Leader(query), patterns);
    }

    /// A suspect leads again once it knows that nobody has taken over. The core is told before
    /// anything else, so that what it makes of that is published.
    fn confirm_leadership(&mut self) {
        if self.facilities.replica.election.confirm(self.facilities.now) {
            self.tell_connectivity(Connectivity::Online);
        }
    }

    fn link_restored(&mut self) {
        match self.facilities.replica.election.link_restored(self.facilities.now) {
            Reconnection::Resume => self.tell_connectivity(Connectivity::Online),
            Reconnection::Inquire => {
                self.tell_connectivity(Connectivity::Online);
                self.inquire();
            }
            Reconnection::AskForLeader => self.ask_for_leader(),
        }
    }

    fn arrived(&mut self, arrival: Arrival) {
        if arrival.is_foreign() {
            self.confirm_leadership();
            let packet = arrival.into_packet();
            return self.core.on_foreign(&mut Context(&mut self.facilities), packet);
        }
        let message = match arrival.into_message(&self.facilities.replica.space) {
            Ok(message) => message,
            Err(rejection) => {
                self.confirm_leadership();
                return self.facilities.refuse(rejection);
            }
        };
        match message {
            Message::LeaseRenewal(renewal) => {
                let rivalry = self.renewal(&renewal, RenewalSource::Published);
                self.resolve(rivalry);
                self.confirm_leadership();
            }
            Message::ServiceToken { service, instance, alive } if service == C::SERVICE => {
                self.facilities.replica.election.token(self.facilities.now, instance, alive);
                self.confirm_leadership();
            }
            Message::Settings(announced) if announced.service == C::SERVICE => {
                self.adopt(&announced);
                self.confirm_leadership();
            }
            message => {
                self.confirm_leadership();
                self.core.on_message(&mut Context(&mut self.facilities), message);
            }
        }
    }

    fn renewal(
        &mut self,
        renewal: &muster_model::role::LeaseRenewal,
        source: RenewalSource,
    ) -> Rivalry {
        let replica = &mut self.facilities.replica;
        let term = replica.revision().term;
        replica.election.renewal(self.facilities.now, renewal, source, term)
    }

    /// Settles which of two leaders goes on.
    fn resolve(&mut self, rivalry: Rivalry) {
        match rivalry {
            Rivalry::None => {}
            Rivalry::StandDown => self.stand_down(),
            Rivalry::RaiseTerm(revision) => {
                let was_suspect = !self.facilities.replica.election.is_leading();
                self.begin_term(Some(revision));
                if was_suspect {
                    self.tell_connectivity(Connectivity::Online);
                }
                self.core.on_new_term(&mut Context(&mut self.facilities), Vec::new());
            }
        }
    }

    fn stand_down(&mut self) {
        let replica = &mut self.facilities.replica;
        replica.settings.stood_down(replica.revision());
        self.facilities.fetches.forget();
        self.facilities.fetched.clear();
        self.facilities.abandon_job();
        self.core.on_stand_down(&mut Context(&mut self.facilities));
        self.inquire();
    }

    fn adopt(&mut self, announced: &muster_wire::envelope::AnnouncedSettings) {
        let replica = &mut self.facilities.replica;
        if replica.election.has_term() {
            return;
        }
        let followed = replica.election.followed();
        match replica.settings.adopt(announced, followed) {
            Adoption::Changed => self.facilities.store(),
            Adoption::Unchanged | Adoption::WithoutTerm => {}
            Adoption::Old => replica.add("settings_old", 1),
            Adoption::Misfit => replica.add("settings_not_adopted", 1),
        }
    }

    fn answered(&mut self, ask: AskId, arrivals: Vec<Arrival>) {
        self.confirm_leadership();
        let space = &self.facilities.replica.space;
        let decoded = arrivals.into_iter().map(|arrival| arrival.into_message(space));
        let (messages, refused): (Vec<_>, Vec<_>) = decoded.partition(Result::is_ok);
        self.facilities.replica.add("answers_refused", refused.len() as u64);
        let messages = messages.into_iter().filter_map(Result::ok).collect();
        let ended = self.facilities.fetches.answered(self.facilities.now, ask, messages);
        self.facilities.fetched.extend(ended);
    }

    fn take_fetched(&mut self) {
        while let Some(fetched) = self.facilities.fetched.pop_front() {
            self.take_answers(fetched);
        }
    }

    fn take_answers(&mut self, fetched: Fetched<C::Fetch>) {
        let Fetched { purpose, answers } = fetched;
        match purpose {
            Purpose::Start | Purpose::TakeOver => self.inquiry_answered(answers),
            Purpose::Leader(query) => {
                if self.renewals_among(&answers) == Rivalry::StandDown {
                    return self.stand_down();
                }
                self.facilities.replica.election.leader_query_unanswered(query);
                self.confirm_leadership();
            }
            Purpose::TermCheck => self.term_checked(answers),
            Purpose::Core(fetch) => {
                self.core.on_answers(&mut Context(&mut self.facilities), fetch, answers);
            }
        }
    }

    /// Receives the lease renewals among answers to a get. Terms are raised for published ones alone:
    /// the sender publishes the next one soon.
    fn renewals_among(&mut self, answers: &[Message]) -> Rivalry {
        let mut rivalry = Rivalry::None;
        for answer in answers {
            if let Message::LeaseRenewal(renewal) = answer
                && renewal.service == C::SERVICE
                && self.renewal(renewal, RenewalSource::Answered) == Rivalry::StandDown
            {
                rivalry = Rivalry::StandDown;
            }
        }
        rivalry
    }

    fn inquiry_answered(&mut self, answers: Vec<Message>) {
        if !self.facilities.replica.election.inquiry_answered() {
            return;
        }
        self.renewals_among(&answers);
        let decision = self.facilities.replica.election.decide(self.facilities.now);
        if decision == Decision::Wait {
            return;
        }
        let mut wanted = Vec::new();
        for answer in answers {
            match answer {
                Message::LeaseRenewal(_) => {}
                // A suspect answers as well, with what it could not announce.
                Message::Settings(announced) if announced.service == C::SERVICE => {
                    self.adopt(&announced);
                }
                answer => wanted.push(answer),
            }
        }
        match decision {
            Decision::Lead => self.lead(wanted),
            Decision::StandBy | Decision::Wait => {
                self.core.on_follow(&mut Context(&mut self.facilities), wanted);
            }
        }
    }

    fn lead(&mut self, answers: Vec<Message>) {
        let outputs = answers.iter().filter(|answer| C::is_output(answer));
        let seen = outputs.filter_map(|output| Some(output.header()?.revision)).max();
        self.begin_term(seen);
        self.core.on_lead(&mut Context(&mut self.facilities), answers);
    }

    fn begin_term(&mut self, seen: Option<Revision>) {
        let facilities = &mut self.facilities;
        facilities.replica.begin_term(facilities.now, seen);
        facilities.store();
        let term = facilities.replica.revision().term;
        Context(facilities).publish_event(Severity::Info, EventKind::ServiceStarted { term });
        facilities.announce_settings();
        for field in facilities.replica.settings.take_dropped() {
            let kind = EventKind::SettingDropped { field };
            Context(facilities).publish_event(Severity::Warning, kind);
        }
    }

    fn term_checked(&mut self, found: Vec<Message>) {
        let replica = &mut self.facilities.replica;
        let seen = found.iter().filter_map(|message| Some(message.header()?.revision)).max();
        let own = replica.revision();
        match replica.election.term_checked(self.facilities.now, seen, own) {
            TermCheck::Sound => {}
            TermCheck::Outrun(revision) => {
                self.begin_term(Some(revision));
                self.core.on_new_term(&mut Context(&mut self.facilities), found);
            }
        }
    }

    /// Renews the lease, asks the readers what they have seen and announces the settings, each when it
    /// is due.
    fn renew(&mut self) {
        let facilities = &mut self.facilities;
        if facilities.replica.election.renews(facilities.now) {
            let renewal = facilities.replica.renewal(facilities.now);
            facilities.publish(renewal);
            if facilities.replica.settings.are_announced_again() {
                facilities.announce_settings();
            }
        }
        if facilities.replica.election.checks_term(facilities.now) {
            facilities.fetch(Purpose::TermCheck, vec![Pattern::One(C::output())]);
            facilities.announce_settings();
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
                let said = panic.as_deref().map_or("it ended without a result".into(), quoted);
                self.core.on_job(context, JobEnd::Panicked(format!("the job panicked: {said}")));
            }
            // No job was running: the caller repeats itself.
            (slot @ (JobSlot::Free | JobSlot::Ready(_)), ..) => self.facilities.job = slot,
        }
    }

    fn get(&mut self, incoming: IncomingGet) {
        self.confirm_leadership();
        let IncomingGet { get, selector, narrowed, parameters, payload } = incoming;
        let request = match Request::new(selector, &parameters, payload) {
            Ok(request) => request,
            Err(problem) => {
                let problem = problem.to_string();
                return self.answer_unopened(get, Err(problem_json("(parameters)", &problem)));
            }
        };
        let request = match narrowed {
            Some(served) => request.narrowed(served),
            None => request,
        };
        if request.exact_key(self.space()) == Some(Key::Schema) {
            let schema = Outbound::schema(schema::text()).into_packet(self.space());
            return self.answer_unopened(get, Ok(vec![schema]));
        }
        match self.facilities.gets.open(get, request) {
            Ok(get) => self.answer(get),
            Err(problem) => self.answer_unopened(get, Err(problem)),
        }
    }

    /// Answers a get that asks for nothing of this instance's own.
    fn answer_unopened(&mut self, get: GetId, answer: Result<Vec<muster_wire::Packet>, String>) {
        let reply = Reply { get, answer, messages: Vec::new() };
        self.facilities.commands.push(Command::Reply(reply));
    }

    fn answer(&mut self, get: Get) {
        let facilities = &mut self.facilities;
        let space = facilities.replica.space.clone();
        let selects = |key: &Key| get.request.selects(&space, key);
        if get.request.is_exact() && selects(&Key::Lease(C::SERVICE)) {
            let is_leading = facilities.replica.election.is_leading();
            let renewal = is_leading.then(|| facilities.replica.renewal(facilities.now));
            Context(facilities).reply(get, renewal.into_iter().collect());
        } else if selects(&Key::Settings(C::SERVICE)) {
            self.answer_settings(get);
        } else if selects(&Key::Status(C::SERVICE)) {
            let mut status = self.status(self.facilities.now);
            let held = self.memory_use();
            let counts = [
                ("held_robots", held.robots),
                ("held_edges", held.edges),
                ("held_messages", held.messages),
            ];
            let counts = counts.map(|(name, count)| (name.to_owned(), count as u64));
            status.counters.extend(counts);
            status.counters.extend(self.process_counters.clone());
            let status = Message::Status(Box::new(status));
            Context(&mut self.facilities).reply(get, vec![status]);
        } else {
            self.core.on_get(&mut Context(&mut self.facilities), get);
        }
    }

    /// Answers a get of the settings; one with a payload changes them, as a whole or not at all.
    fn answer_settings(&mut self, get: Get) {
        let facilities = &mut self.facilities;
        if facilities.replica.election.state() == ReplicaState::Standby {
            // The leader answers; two answers to one change would be one too many.
            return Context(facilities).reply(get, Vec::new());
        }
        let Some(payload) = &get.request.payload else {
            let settings = facilities.replica.settings_message(facilities.now);
            return Context(facilities).reply(get, vec![settings]);
        };
        if !get.request.is_exact() {
            let problem = "settings are changed on exactly one key, without wildcards";
            return Context(facilities).reply_error(get, problem_json("(key)", problem));
        }
        if let Err(problem) = facilities.replica.settings.change(payload) {
            return Context(facilities).reply_error(get, problem);
        }
        facilities.store();
        let settings = facilities.replica.settings_message(facilities.now);
        facilities.reply(get.id, Ok(vec![settings]), ReplyKind::ConfirmsStore);
        facilities.replica.add("settings_changed", 1);
        if facilities.replica.election.has_term() {
            facilities.announce_settings();
            let settings = facilities.replica.settings.to_json();
            let kind = EventKind::SettingsChanged { settings };
            Context(facilities).publish_event(Severity::Info, kind);
        }
        // Without a term, the term will begin with an announcement.
        self.core.on_settings(&mut Context(&mut self.facilities));
    }
}
