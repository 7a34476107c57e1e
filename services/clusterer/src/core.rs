//! What is divided when, and what is published of it.

mod awaiting;
mod input;
mod numbers;
mod output;
mod wishing;

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use muster_division::division::{DivisionError, Job, Staying, divide, same_data};
use muster_division::identity::is_believable;
use muster_division::memory::Memory;
use muster_division::rules::{TeamRules, asks_alike};
use muster_division::seats::Arrivals;
use muster_division::words::plural;
use muster_model::alert::Alerts;
use muster_model::audit::Audit;
use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::id::{ServiceName, TeamId};
use muster_model::orders::NewOrders;
use muster_model::role::ReplicaState;
use muster_model::roster::Roster;
use muster_model::settings::{ClustererSettings, SettingsError};
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_service::{
    Connectivity, Core, Delivery, Get, JobEnd, MemoryUse, ServedKey, SingleFlight, Stopwatch,
    Subscription, TooManyNames, Wiring, answer_teams,
};
use muster_wire::json::Problem;
use muster_wire::{Key, Message, Pattern, Request};

use crate::dwell::{CountDwell, MoveDwell, TEAM_COUNT_DWELL};
use crate::keeping::Keeping;
use crate::publishing::Rotation;
use crate::wishes::WishBook;

use awaiting::Reunion;
use numbers::Number;
use output::dwell;
use wishing::{Confirmation, NO_LONGER_LEADS};

type Context<'a> = muster_service::Context<'a, Clusterer>;
type View<'a> = muster_service::View<'a, Clusterer>;

/// Names the one fetch of the service: what was missed while the link was lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MissedInputs;

/// An embedding, and when it was received.
#[derive(Debug, Clone)]
struct Received {
    embedding: Checked<Embedding>,
    at: Tick,
}

/// What a division is made of.
#[derive(Debug, Clone)]
struct Task {
    source: Received,
    /// The settings without those that change no division.
    settings: ClustererSettings,
    /// What it is to respect.
    rules: Option<TeamRules>,
    /// The teams that wishes name and that are there: a team that lives again is divided with its wishes.
    wished: BTreeSet<TeamId>,
    /// How many teams.
    teams: u32,
    /// Which robots stay in their last team.
    staying: Staying,
    /// Whether it is the first for what operators ask for.
    is_asked_for: bool,
}

impl PartialEq for Task {
    fn eq(&self, other: &Self) -> bool {
        self.settings == other.settings
            && self.rules == other.rules
            && self.wished == other.wished
            && self.teams == other.teams
            && self.staying == other.staying
            && same_data(&self.source.embedding, &other.source.embedding)
    }
}

/// A division of which some changes are held back.
#[derive(Debug)]
struct Undecided {
    teams: Teams,
    /// What it was made to respect.
    rules: Option<TeamRules>,
}

/// What this leader has published.
#[derive(Debug)]
struct Published {
    /// The newest embedding with the data of the division.
    source: Received,
    /// When the division was last published.
    at: Tick,
    /// When its JSON mirror was last published.
    mirrored: Tick,
}

/// Divides embeddings into teams.
#[derive(Debug, Default)]
pub struct Clusterer {
    newest: Option<Received>,
    roster: Option<Checked<Roster>>,
    /// What the auditor last published, in case it is gone.
    audit: Option<Arc<Audit>>,
    /// The open alerts, as the auditor last published them.
    alerts: Option<Arc<Alerts>>,
    flight: SingleFlight<Task>,
    /// The last good answer; of the leader before until this one has its own.
    division: Option<Checked<Teams>>,
    /// The division that others have received last: the output of a suspect is suppressed, and its
    /// changes are published with the next one.
    received_by_others: Option<Checked<Teams>>,
    /// The embedding that the division names.
    divided: Option<Checked<Embedding>>,
    /// What is on disk.
    keeping: Keeping,
    /// The robots of the division of an earlier leader are awaited.
    reunion: Option<Reunion>,
    /// Since when robots that return have no relations yet.
    returning_since: Option<Tick>,
    /// When it was last looked at whether a job is to start. What was due by then has had its turn, even where a
    /// later moment is awaited as well, or the job has failed.
    considered_at: Option<Tick>,
    /// Teams that robots had before the division.
    memory: Arc<Memory>,
    published: Option<Published>,
    /// The number of teams, while it may change.
    count: CountDwell,
    /// Robots that came lately.
    arrivals: Arrivals,
    /// Since when no more robots of a team are waited for; none while some are.
    settled_since: Option<Tick>,
    /// The robots that are kept in their team for now.
    moves: MoveDwell,
    /// The robots that have another superior than before.
    orders: NewOrders,
    /// The newest division as it was found, if robots are kept in their team.
    undecided: Option<Box<Undecided>>,
    rotation: Rotation,
    /// How many teams were asked for and formed when that was last reported to be too few.
    fewer: Option<(u32, u32)>,
    /// Since when nothing satisfies the rules.
    infeasible_since: Option<Tick>,
    /// The wishes of operators.
    wishes: WishBook,
    /// When they were last published.
    wishes_published: Option<Tick>,
    /// Operators who wait until their wish is on disk.
    confirmations: VecDeque<Confirmation>,
}

impl Clusterer {
    /// Starts a job if there is something to divide that is neither divided nor failed.
    fn consider(&mut self, context: &mut Context<'_>) {
        let Some(slot) = context.free_job_slot() else { return };
        let now = context.now();
        self.considered_at = Some(now);
        if self.awaits_robots(now) || self.awaits_relations(now) {
            return;
        }
        let Some(newest) = &self.newest else { return };
        let settings =
            ClustererSettings { heartbeat_s: 1.0, dwell_s: 0.0, ..context.settings().clone() };
        if self.memory.is_overdue(now) {
            Arc::make_mut(&mut self.memory).forget(now);
        }
        let newest = newest.clone();
        let rules = self.rules(&settings);
        let Number { teams, is_same, is_team_absent, is_asked_for } =
            self.decide_number(now, &settings, rules.as_ref(), &newest.embedding);
        let wished = rules.as_ref().map(|rules| rules.wished(self.division.as_deref()));
        let wished = wished.unwrap_or_default();
        // Limits and wishes count at once, so that no robot is kept where there are any.
        let staying = match rules {
            Some(_) => Staying::None,
            None if self.keeps_robots(now) => Staying::All,
            None if is_team_absent || self.still_keeps_teams(now) => Staying::KeepingTeams,
            None => Staying::None,
        };
        let task = Task {
            source: newest.clone(),
            settings,
            rules: rules.clone(),
            wished,
            teams,
            staying,
            is_asked_for,
        };
        if !self.flight.should_start(now, &task) {
            if self.flight.failure().is_none()
                && let Some(published) = &mut self.published
            {
                published.source = newest;
            }
            return;
        }
        let next = self.division.as_ref().map_or(1, |division| division.next_team);
        let need = next.max(self.memory.next_team).saturating_add(u64::from(teams));
        if !self.keeping.may_give(now, need) {
            return self.keep(context);
        }
        let job = Job {
            embedding: newest.embedding,
            teams,
            requested: teams.max(*task.settings.teams.range().start()),
            same_number: is_same,
            staying,
            renewed: self
                .orders
                .renewed(now, self.roster.as_deref())
                .into_iter()
                .cloned()
                .collect(),
            settings: task.settings.clone(),
            rules: rules.map(|rules| {
                let previous = self.division.as_deref();
                Arc::new(rules.resolved(previous, &self.memory, &task.source.embedding))
            }),
            previous: self.division.clone(),
            memory: Arc::clone(&self.memory),
        };
        self.flight.started(task);
        context.count("jobs_started");
        context.start_job(slot, job);
    }

    /// Whether all robots stay in their last team: while the robots of a team leave or return one after the other, and, where
    /// another number of teams is about to count by then, until it does or a moment has passed. So they are divided again once, not
    /// twice.
    fn keeps_robots(&mut self, now: Tick) -> bool {
        if self.arrivals.is_unsettled(now) {
            self.settled_since = None;
            return true;
        }
        // Without a link it divides nothing, and the moment begins when it does again.
        let settled = *self.settled_since.get_or_insert(now);
        let kept = self.flight.completed().is_some_and(|last| last.staying == Staying::All);
        kept && now < settled.after(2 * TEAM_COUNT_DWELL) && self.count.due().is_some()
    }

    /// Whether teams are kept as while a whole team is absent: where another number of teams is about to count after that, until
    /// it does or a moment has passed, as for [`Self::keeps_robots`].
    fn still_keeps_teams(&self, now: Tick) -> bool {
        let kept = self.flight.completed().is_some_and(|last| last.staying != Staying::None);
        let has_ended = self.arrivals.has_absence_ended_within(now, 2 * TEAM_COUNT_DWELL);
        kept && has_ended && self.count.due().is_some()
    }

    /// When a job may have to start although nothing was received.
    fn consider_at(&self) -> Option<Tick> {
        let due = [
            self.flight.retry_at(),
            self.count.due(),
            self.keeping.gives_at(),
            self.awaits_until(),
        ];
        let is_to_come = |due: &Tick| self.considered_at.is_none_or(|at| *due > at);
        let due = due.into_iter().flatten().chain(self.arrivals.settled_at());
        due.filter(is_to_come).min()
    }

    /// Keeps what has changed on disk, if that is due.
    fn keep(&mut self, context: &mut Context<'_>) {
        let now = context.now();
        if self.keeping.due().is_some_and(|due| now >= due)
            && let Some(content) = self.keeping.write(now)
        {
            context.count("divisions_kept");
            context.keep(content);
        }
    }

    fn accept_division(&mut self, context: &mut Context<'_>, teams: Teams) {
        let Some(task) = self.flight.completed() else { return };
        let rules = self.rules(context.settings());
        if !asks_alike(task.rules.as_ref(), rules.as_ref()) {
            // It may break rules that hold since; another job follows.
            return;
        }
        // An embedding with the same data may have come while the job ran.
        let is_same = |newest: &&Received| same_data(&newest.embedding, &task.source.embedding);
        let source = self.newest.as_ref().filter(is_same).unwrap_or(&task.source).clone();
        let dwell = if task.is_asked_for { Duration::ZERO } else { dwell(context.settings()) };
        self.settle(context, teams, source, dwell);
    }

    fn select(
        &self,
        context: &Context<'_>,
        request: &Request,
    ) -> Result<Vec<Message>, TooManyNames> {
        let space = context.space();
        let selects = |key: &Key| request.selects(space, key);
        let mut messages = Vec::new();
        // One that starts receives its own answer, and must not seem to know more than that.
        let teams = match context.replica_state() {
            ReplicaState::Standby => self.division.as_ref().or(self.keeping.received_division()),
            // What it has made since may never be published.
            ReplicaState::Suspect => self.received_by_others.as_ref(),
            _ => self.division.as_ref(),
        };
        if let Some(teams) = teams {
            messages.extend(answer_teams(space, request, teams)?);
        }
        if selects(&Key::Embedding) {
            // The auditor of the division needs the embedding that it names, however old it is.
            let newest = self.newest.as_ref().map(|newest| &newest.embedding);
            let named = self.divided.as_ref().filter(|named| {
                newest.is_none_or(|newest| newest.header.revision != named.header.revision)
            });
            messages.extend(newest.into_iter().chain(named).cloned().map(Message::Embedding));
        }
        messages.extend(self.select_wishes(context, request));
        if let Some(roster) = &self.roster
            && selects(&Key::Roster)
        {
            messages.push(Message::Roster(roster.clone()));
        }
        if let Some(audit) = &self.audit
            && (selects(&Key::Audit) || selects(&Key::JsonAudit))
        {
            messages.push(Message::Audit(Arc::clone(audit)));
        }
        // An acknowledgement is for the auditor alone.
        if let Some(alerts) = self.alerts.as_ref().filter(|_| request.payload.is_none())
            && (selects(&Key::Alerts) || selects(&Key::JsonAlerts))
        {
            messages.push(Message::Alerts(Arc::clone(alerts)));
        }
        Ok(messages)
    }
}

impl Core for Clusterer {
    type Settings = ClustererSettings;
    type Fetch = MissedInputs;
    type Job = Job;
    type Done = Result<Teams, DivisionError>;
    const SERVICE: ServiceName = ServiceName::Clusterer;
    const WITHOUT_KEPT: Option<&'static str> =
        Some("if no other service has its last output, ids of teams begin with t1 again");

    fn wiring() -> Wiring {
        let subscription =
            |key| Subscription { pattern: Pattern::One(key), delivery: Delivery::Latest };
        let outputs = [Key::Audit, Key::JsonAudit, Key::Alerts, Key::JsonAlerts];
        let cached = [Key::Embedding, Key::Roster].into_iter().chain(outputs).map(Pattern::One);
        let own = [
            Pattern::One(Key::Teams),
            Pattern::One(Key::JsonTeams),
            Pattern::RobotTeams,
            Pattern::One(Key::Wishes),
            Pattern::One(Key::JsonWishes),
            Pattern::EachWish,
        ];
        let served = own.map(ServedKey::own).into_iter().chain(cached.map(ServedKey::cached));
        Wiring {
            // A standby keeps the division and the wishes that the leader has.
            subscriptions: [
                Key::Embedding,
                Key::Roster,
                Key::Audit,
                Key::Teams,
                Key::Alerts,
                Key::Wishes,
            ]
            .map(subscription)
            .to_vec(),
            tokens: vec![],
            fetched: vec![],
            served: served.collect(),
        }
    }

    fn initial() -> Vec<Pattern> {
        [Key::Teams, Key::Embedding, Key::Roster, Key::Wishes].map(Pattern::One).to_vec()
    }

    fn output() -> Key {
        Key::Teams
    }

    fn is_output(message: &Message) -> bool {
        matches!(message, Message::Teams { .. } | Message::Wishes(_))
    }

    fn new(_now: Tick, _settings: &ClustererSettings) -> Self {
        Self::default()
    }

    fn on_lead(&mut self, context: &mut Context<'_>, answers: Vec<Message>) {
        self.inherit(context.now(), &answers);
        self.recover_wishes(context);
        self.publish_wishes(context, &[]);
        self.accept_all(context, answers);
        self.consider(context);
    }

    fn on_follow(&mut self, context: &mut Context<'_>, answers: Vec<Message>) {
        self.accept_all(context, answers);
    }

    fn on_stand_down(&mut self, context: &mut Context<'_>) {
        for waiting in std::mem::take(&mut self.confirmations) {
            context.reply_error(
                waiting.get,
                Problem::unavailable("(wish)", NO_LONGER_LEADS).to_json(),
            );
        }
        let mut keeping = std::mem::take(&mut self.keeping);
        keeping.next_team = keeping.next_team.max(self.memory.next_team);
        *self = Self { keeping, ..Self::default() };
    }

    fn on_new_term(&mut self, context: &mut Context<'_>, found: Vec<Message>) {
        for message in &found {
            if let Message::Teams { teams, .. } = message
                && is_believable(teams)
            {
                // The numbers of that division are taken, whichever instance has given them.
                let memory = Arc::make_mut(&mut self.memory);
                memory.next_team = memory.next_team.max(teams.next_team);
            }
        }
        // The running job has neither those numbers nor, at first, that division.
        if context.view().is_job_running() {
            context.abandon_job();
            self.flight = SingleFlight::default();
        }
        self.rotation.make_due();
        if self.published.is_some() {
            self.republish(context);
        } else {
            self.inherit(context.now(), &found);
        }
        self.publish_wishes(context, &[]);
        self.consider(context);
    }

    fn on_message(&mut self, context: &mut Context<'_>, message: Message) {
        self.accept_message(context, message);
    }

    fn on_answers(&mut self, context: &mut Context<'_>, _: MissedInputs, answers: Vec<Message>) {
        self.accept_all(context, answers);
    }

    fn on_restored(&mut self, content: &[u8]) -> Result<(), String> {
        self.keeping.restore(content)
    }

    fn on_kept(&mut self, context: &mut Context<'_>, is_on_disk: bool) {
        self.keeping.ended(context.now(), is_on_disk);
        self.confirm_wishes(context, is_on_disk);
        self.consider(context);
    }

    fn after_input(&mut self, context: &mut Context<'_>) {
        self.keep(context);
    }

    fn on_get(&mut self, context: &mut Context<'_>, get: Get) {
        let key = get.request.exact_key(context.space());
        if get.request.payload.is_some() && matches!(key, Some(Key::Wish(..))) {
            return self.change_wish(context, get);
        }
        match self.select(context, &get.request) {
            Ok(answer) => context.reply(get, answer),
            Err(problem) => context.reply_error(get, problem.to_string()),
        }
    }

    fn check_settings(
        &self,
        view: &View<'_>,
        settings: &ClustererSettings,
    ) -> Result<(), SettingsError> {
        self.check_limits(view.now(), view.settings(), settings)
    }

    fn on_settings(&mut self, context: &mut Context<'_>) {
        self.consider(context);
    }

    fn on_connectivity(&mut self, context: &mut Context<'_>, connectivity: Connectivity) {
        if connectivity == Connectivity::Online {
            let patterns = [Key::Embedding, Key::Roster].map(Pattern::One);
            context.fetch(MissedInputs, patterns.to_vec());
            self.rotation.make_due();
            // What was put while the output was suppressed has reached nobody.
            self.publish_wishes(context, &[]);
            self.republish(context);
            self.consider(context);
        }
    }

    fn on_timer(&mut self, context: &mut Context<'_>) {
        let now = context.now();
        self.expire_wishes(context);
        if self.heartbeat_at(&context.view()).is_some_and(|due| now >= due) {
            self.republish(context);
        }
        let view = context.view();
        let may_settle = view.is_leading() && !view.is_job_running();
        if may_settle && self.settle_at(&view).is_some_and(|due| now >= due) {
            self.settle_again(context);
        }
        self.inform_in_rotation(context, &BTreeSet::new());
        if self.consider_at().is_some_and(|due| now >= due) {
            self.consider(context);
        }
    }

    fn on_job(&mut self, context: &mut Context<'_>, end: JobEnd<Self::Done>) {
        if let Some(teams) = self.flight.ended(context, |_| "division", end) {
            self.accept_division(context, teams);
        }
        self.consider(context);
    }

    fn on_job_slot_free(&mut self, context: &mut Context<'_>) {
        self.consider(context);
    }

    fn deadline(&self, view: &View<'_>) -> Option<Tick> {
        // An instance whose output is suppressed divides nothing.
        let waiting = self.settle_at(view).into_iter().chain(self.consider_at());
        let waiting = waiting.min().filter(|_| view.is_leading() && !view.is_job_running());
        let expiry = self.wishes.due().filter(|_| view.has_term());
        let due =
            [self.heartbeat_at(view), self.rotation_at(view), self.keeping.due(), waiting, expiry];
        due.into_iter().flatten().min()
    }

    fn state(&self, _view: &View<'_>) -> String {
        match (&self.division, &self.newest) {
            (Some(division), Some(_)) => {
                let teams = division.teams.len();
                let assigned: usize = division.teams.iter().map(|team| team.members.len()).sum();
                let robots = assigned + division.unassigned.len();
                format!("{} of {}", plural(teams, "team"), plural(robots, "robot"))
            }
            (None, Some(_)) => "dividing the first embedding".to_owned(),
            (Some(_), None) if self.reunion.is_some() => {
                "waiting for the robots of the last division".to_owned()
            }
            (_, None) => "waiting for an embedding".to_owned(),
        }
    }

    fn memory_use(&self) -> MemoryUse {
        let held = [
            self.newest.is_some(),
            self.roster.is_some(),
            self.audit.is_some(),
            self.alerts.is_some(),
            self.division.is_some(),
            self.received_by_others.is_some(),
            self.divided.is_some(),
            self.published.is_some(),
            self.undecided.is_some(),
        ];
        MemoryUse {
            robots: self.memory.robot_count() + self.moves.robot_count(),
            messages: held.into_iter().filter(|held| *held).count() + self.keeping.message_count(),
            ..MemoryUse::default()
        }
    }

    fn run(job: Job, _: &mut Stopwatch) -> Self::Done {
        divide(&job)
    }
}
