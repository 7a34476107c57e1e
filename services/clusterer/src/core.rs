//! What is divided when, and what is published of it.

use std::collections::BTreeSet;
use std::sync::Arc;

use muster_model::audit::Audit;
use muster_model::embedding::Embedding;
use muster_model::event::{EventKind, Severity};
use muster_model::id::{RobotId, ServiceName};
use muster_model::roster::{Presence, Roster};
use muster_model::settings::ClustererSettings;
use muster_model::teams::Teams;
use muster_model::time::{Tick, seconds};
use muster_service::{
    Connectivity, Core, Delivery, Get, JobEnd, MemoryUse, ServedKey, SingleFlight, Stopwatch,
    Subscription, Wiring, answer_teams,
};
use muster_wire::{Key, Message, Pattern, Request};

use crate::division::{Job, Outcome, divide, same_data};
use crate::identity::Memory;
use crate::leader::leaders;
use crate::publishing::{Rotation, plural, robots_to_inform, shortage};

type Context<'a> = muster_service::Context<'a, Clusterer>;
type View<'a> = muster_service::View<'a, Clusterer>;

/// Most changes of one division that are published as events: when a whole fleet is divided anew, the
/// division itself says it better than one event per robot. The others are counted.
const MAX_CHANGE_EVENTS: usize = 64;

/// Names the one fetch of the service: what was missed while the link was lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MissedInputs;

/// An embedding, and when it was received.
#[derive(Debug, Clone)]
struct Received {
    embedding: Arc<Embedding>,
    at: Tick,
}

/// What a division is made of.
#[derive(Debug, Clone)]
struct Task {
    source: Received,
    /// The settings without those that change no division.
    settings: ClustererSettings,
}

impl PartialEq for Task {
    fn eq(&self, other: &Self) -> bool {
        self.settings == other.settings
            && same_data(&self.source.embedding, &other.source.embedding)
    }
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
    roster: Option<Arc<Roster>>,
    /// What the auditor last published, in case it is gone.
    audit: Option<Arc<Audit>>,
    flight: SingleFlight<Task>,
    /// The last good answer; of the leader before until this one has its own.
    division: Option<Arc<Teams>>,
    /// The division that others have received last: the output of a suspect is suppressed, and its
    /// changes are published with the next one.
    received_by_others: Option<Arc<Teams>>,
    /// The embedding that the division names.
    divided: Option<Arc<Embedding>>,
    /// Teams that robots had before the division.
    memory: Arc<Memory>,
    published: Option<Published>,
    rotation: Rotation,
    /// How many teams were asked for and formed when that was last reported to be too few.
    fewer: Option<(u32, u32)>,
}

impl Clusterer {
    fn accept_message(&mut self, context: &mut Context<'_>, message: Message) {
        match message {
            Message::Embedding(embedding) => self.accept_embedding(context, embedding),
            Message::Roster(roster) => self.accept_roster(context, roster),
            Message::Audit(audit) => self.accept_audit(audit),
            _ => {}
        }
    }

    /// Takes answers, the newest first, so that no older one is divided before it.
    fn accept_all(&mut self, context: &mut Context<'_>, mut messages: Vec<Message>) {
        let revision = |message: &Message| message.header().map(|header| header.revision);
        messages.sort_by_key(|message| std::cmp::Reverse(revision(message)));
        for message in messages {
            self.accept_message(context, message);
        }
    }

    fn accept_audit(&mut self, audit: Arc<Audit>) {
        let last = self.audit.as_ref().map(|audit| audit.header.revision);
        if last.is_none_or(|last| audit.header.revision > last) {
            self.audit = Some(audit);
        }
    }

    fn accept_embedding(&mut self, context: &mut Context<'_>, embedding: Arc<Embedding>) {
        let revision = embedding.header.revision;
        let last = self.newest.as_ref().map(|newest| newest.embedding.header.revision);
        if last.is_some_and(|last| revision <= last) {
            // The same one may well come twice: by subscription and by fetch.
            if last != Some(revision) {
                context.count("messages_old");
            }
            return;
        }
        if let Err(reason) = embedding.check() {
            return context.refuse(&Key::Embedding, reason.to_string());
        }
        context.count("embeddings_received");
        self.newest = Some(Received { embedding, at: context.now() });
        self.consider(context);
    }

    fn accept_roster(&mut self, context: &mut Context<'_>, roster: Arc<Roster>) {
        let revision = roster.header.revision;
        let last = self.roster.as_ref().map(|roster| roster.header.revision);
        if last.is_some_and(|last| revision <= last) {
            if last != Some(revision) {
                context.count("messages_old");
            }
            return;
        }
        if let Err(reason) = roster.check() {
            return context.refuse(&Key::Roster, reason.to_string());
        }
        self.roster = Some(roster);
        // Robots went silent, left, or command others now: the same labels, published again.
        if let (Some(published), Some(division)) = (&self.published, &self.division) {
            let (leaders, stale) = self.roster_view(division, &published.source.embedding);
            let led = division.teams.iter().zip(leaders);
            if stale != division.stale
                || led.into_iter().any(|(team, leader)| leader.is_some_and(|l| l != team.leader))
            {
                let source = published.source.clone();
                self.republish_from(context, source);
            }
        }
    }

    /// What the newest roster says of the division of an embedding: the leader of each team, and who
    /// is stale. A robot that is missing from a roster that is not older than the embedding's is about to go.
    fn roster_view(
        &self,
        teams: &Teams,
        embedding: &Embedding,
    ) -> (Vec<Option<RobotId>>, Vec<RobotId>) {
        let mut stale = Vec::new();
        if let Some(roster) = self.roster.as_deref() {
            let is_new = roster.header.revision >= embedding.roster;
            let mut entries = roster.robots.iter().peekable();
            for robot in &embedding.robots {
                while entries.next_if(|entry| entry.robot < *robot).is_some() {}
                let is_stale = match entries.peek().filter(|entry| entry.robot == *robot) {
                    Some(entry) => entry.presence == Presence::Stale,
                    None => is_new,
                };
                if is_stale {
                    stale.push(robot.clone());
                }
            }
        } else if let Some(division) = &self.division {
            let known = |robot: &&RobotId| embedding.robots.binary_search(robot).is_ok();
            stale.extend(division.stale.iter().filter(known).cloned());
        }
        let roster = self.roster.as_deref();
        (leaders(&teams.teams, roster, self.division.as_deref(), &stale), stale)
    }

    /// Starts a job if there is something to divide that is neither divided nor failed.
    fn consider(&mut self, context: &mut Context<'_>) {
        let Some(slot) = context.free_job_slot() else { return };
        let Some(newest) = &self.newest else { return };
        let now = context.now();
        let settings = ClustererSettings { heartbeat_s: 1.0, ..context.settings().clone() };
        let task = Task { source: newest.clone(), settings };
        if !self.flight.should_start(now, &task) {
            if self.flight.failure().is_none()
                && let Some(published) = &mut self.published
            {
                published.source = newest.clone();
            }
            return;
        }
        if self.memory.is_overdue(now) {
            Arc::make_mut(&mut self.memory).forget(now);
        }
        let job = Job {
            embedding: Arc::clone(&newest.embedding),
            settings: task.settings.clone(),
            previous: self.division.clone(),
            memory: Arc::clone(&self.memory),
        };
        self.flight.started(task);
        context.count("jobs_started");
        context.start_job(slot, job);
    }

    fn accept_division(&mut self, context: &mut Context<'_>, teams: Teams) {
        self.flight.succeeded();
        let Some(task) = self.flight.completed() else { return };
        // An embedding with the same data may have come while the job ran.
        let is_same = |newest: &&Received| same_data(&newest.embedding, &task.source.embedding);
        let source = self.newest.as_ref().filter(is_same).unwrap_or(&task.source).clone();
        let division = self.division.as_deref();
        Arc::make_mut(&mut self.memory).follow(context.now(), division, &teams);
        self.publish(context, teams, source);
    }

    /// Publishes what a division has changed.
    fn report_changes(&mut self, context: &mut Context<'_>, teams: &Teams) {
        let changes = teams.changes.clone();
        let count = changes.len();
        context.add("team_changes", count as u64);
        for change in changes.into_iter().take(MAX_CHANGE_EVENTS) {
            context.publish_event(Severity::Info, EventKind::TeamChanged(change));
        }
        let unreported = count.saturating_sub(MAX_CHANGE_EVENTS);
        if unreported > 0 {
            context.add("team_changes_untold", unreported as u64);
        }
        match shortage(teams) {
            Some((requested, formed, reason)) if self.fewer != Some((requested, formed)) => {
                self.fewer = Some((requested, formed));
                let kind = EventKind::FewerTeams { requested, formed, reason };
                context.publish_event(Severity::Warning, kind);
            }
            Some(_) => {}
            None => self.fewer = None,
        }
    }

    /// Publishes the last division of this leader again, if there is one.
    fn republish(&mut self, context: &mut Context<'_>) {
        if let Some(published) = &self.published {
            let source = published.source.clone();
            self.republish_from(context, source);
        }
    }

    /// Publishes the last division again, as it stands by the newest roster.
    fn republish_from(&mut self, context: &mut Context<'_>, source: Received) {
        let Some(division) = &self.division else { return };
        let mut teams = Teams::clone(division);
        if self.received_by_others.as_ref().is_some_and(|last| Arc::ptr_eq(last, division)) {
            teams.changes.clear();
        }
        self.publish(context, teams, source);
    }

    fn publish(&mut self, context: &mut Context<'_>, teams: Teams, source: Received) {
        let now = context.now();
        let (leaders, stale) = self.roster_view(&teams, &source.embedding);
        let mut teams = Teams { stale, ..teams };
        for (team, leader) in teams.teams.iter_mut().zip(leaders) {
            if let Some(leader) = leader {
                team.leader = leader;
            }
        }
        let revision = context.next_revision();
        let stage = context.stage(source.at);
        teams.embedding = source.embedding.header.revision;
        // A restart goes by the division alone, so that it says which numbers others have given.
        teams.next_team = teams.next_team.max(self.memory.next_team);
        teams.header = source.embedding.header.next_stage(revision, stage);

        let heartbeat = seconds(context.settings().heartbeat_s);
        let before = self.received_by_others.as_deref();
        let mirrored = self.published.as_ref().map(|published| published.mirrored);
        let mirror = mirrored.is_none_or(|last| now.since(last) >= heartbeat)
            || before.is_none_or(|before| !before.same_division(&teams));
        let teams = Arc::new(teams);
        context.publish(Message::Teams { teams: Arc::clone(&teams), mirror });
        context.count("divisions_published");

        let changed = robots_to_inform(&teams, before);
        for robot in &changed {
            if let Some(team) = teams.robot_team(robot) {
                context.publish(Message::RobotTeam(team));
            }
        }
        let changed: BTreeSet<&RobotId> = changed.into_iter().collect();
        let mirrored = if mirror { now } else { mirrored.unwrap_or(now) };
        self.divided = Some(Arc::clone(&source.embedding));
        self.published = Some(Published { source, at: now, mirrored });
        self.division = Some(Arc::clone(&teams));
        self.inform_in_rotation(context, &changed);
        if context.is_leading() {
            self.received_by_others = Some(Arc::clone(&teams));
            self.report_changes(context, &teams);
        }
    }

    /// When the next robots are to be informed again.
    fn rotation_at(&self, view: &View<'_>) -> Option<Tick> {
        self.published.as_ref().filter(|_| view.is_leading())?;
        Some(self.rotation.due(seconds(view.settings().heartbeat_s)))
    }

    /// Publishes the team of those robots again whose turn it is, if it is time, but for those that
    /// were just informed.
    fn inform_in_rotation(&mut self, context: &mut Context<'_>, informed: &BTreeSet<&RobotId>) {
        let now = context.now();
        if self.rotation_at(&context.view()).is_none_or(|due| now < due) {
            return;
        }
        let (Some(published), Some(teams)) = (&self.published, &self.division) else { return };
        // The embedding has the robots of the division, ordered by name.
        for robot in self.rotation.next(now, &published.source.embedding.robots) {
            if !informed.contains(&robot)
                && let Some(team) = teams.robot_team(&robot)
            {
                context.publish(Message::RobotTeam(team));
            }
        }
    }

    /// Takes over the newest division of an earlier leader among messages. Whatever is published was
    /// checked, but a division that contradicts itself would spoil every later one.
    fn inherit(&mut self, messages: &[Message]) {
        for message in messages {
            let Message::Teams { teams, .. } = message else { continue };
            let last = self.division.as_ref().map(|division| division.header.revision);
            if last.is_none_or(|last| teams.header.revision > last) && teams.check().is_ok() {
                self.division = Some(Arc::clone(teams));
            }
        }
        let named = self.division.as_ref().map(|division| division.embedding);
        for message in messages {
            if let Message::Embedding(embedding) = message
                && named == Some(embedding.header.revision)
                && embedding.check().is_ok()
            {
                self.divided = Some(Arc::clone(embedding));
            }
        }
        self.received_by_others = self.division.clone();
    }

    fn heartbeat_at(&self, view: &View<'_>) -> Option<Tick> {
        let published = self.published.as_ref()?;
        Some(published.at.after(seconds(view.settings().heartbeat_s)))
    }

    fn select(&self, context: &Context<'_>, request: &Request) -> Result<Vec<Message>, String> {
        let space = context.space();
        let selects = |key: &Key| request.selects(space, key);
        let mut messages = Vec::new();
        if let Some(teams) = &self.division {
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
        if let Some(roster) = &self.roster
            && selects(&Key::Roster)
        {
            messages.push(Message::Roster(Arc::clone(roster)));
        }
        if let Some(audit) = &self.audit
            && (selects(&Key::Audit) || selects(&Key::JsonAudit))
        {
            messages.push(Message::Audit(Arc::clone(audit)));
        }
        Ok(messages)
    }
}

impl Core for Clusterer {
    type Settings = ClustererSettings;
    type Fetch = MissedInputs;
    type Job = Job;
    type Done = Outcome;
    const SERVICE: ServiceName = ServiceName::Clusterer;

    fn wiring() -> Wiring {
        let subscription =
            |key| Subscription { pattern: Pattern::One(key), delivery: Delivery::Latest };
        let cached = [Key::Embedding, Key::Roster, Key::Audit, Key::JsonAudit].map(Pattern::One);
        let own = [Pattern::One(Key::Teams), Pattern::One(Key::JsonTeams), Pattern::RobotTeams];
        let served = own.map(ServedKey::own).into_iter().chain(cached.map(ServedKey::cached));
        Wiring {
            subscriptions: [Key::Embedding, Key::Roster, Key::Audit].map(subscription).to_vec(),
            tokens: vec![],
            served: served.collect(),
        }
    }

    fn initial() -> Vec<Pattern> {
        [Key::Teams, Key::Embedding, Key::Roster].map(Pattern::One).to_vec()
    }

    fn output() -> Key {
        Key::Teams
    }

    fn is_output(message: &Message) -> bool {
        matches!(message, Message::Teams { .. })
    }

    fn new(_now: Tick, _settings: &ClustererSettings) -> Self {
        Self::default()
    }

    fn on_lead(&mut self, context: &mut Context<'_>, answers: Vec<Message>) {
        self.inherit(&answers);
        self.accept_all(context, answers);
        self.consider(context);
    }

    fn on_follow(&mut self, context: &mut Context<'_>, answers: Vec<Message>) {
        self.accept_all(context, answers);
    }

    fn on_stand_down(&mut self, _context: &mut Context<'_>) {
        *self = Self::default();
    }

    fn on_new_term(&mut self, context: &mut Context<'_>, found: Vec<Message>) {
        for message in &found {
            if let Message::Teams { teams, .. } = message {
                // The numbers of that division are taken, whichever instance has given them.
                let memory = Arc::make_mut(&mut self.memory);
                memory.next_team = memory.next_team.max(teams.next_team);
            }
        }
        // The job that runs knows neither those numbers nor, at first, that division.
        if context.view().is_job_running() {
            context.abandon_job();
            self.flight = SingleFlight::default();
        }
        self.rotation.hurry();
        if self.published.is_some() {
            self.republish(context);
        } else {
            self.inherit(&found);
        }
    }

    fn on_message(&mut self, context: &mut Context<'_>, message: Message) {
        self.accept_message(context, message);
    }

    fn on_answers(&mut self, context: &mut Context<'_>, _: MissedInputs, answers: Vec<Message>) {
        self.accept_all(context, answers);
    }

    fn on_get(&mut self, context: &mut Context<'_>, get: Get) {
        match self.select(context, &get.request) {
            Ok(answer) => context.reply(get, answer),
            Err(problem) => context.reply_error(get, problem.to_string()),
        }
    }

    fn on_settings(&mut self, context: &mut Context<'_>) {
        self.consider(context);
    }

    fn on_connectivity(&mut self, context: &mut Context<'_>, connectivity: Connectivity) {
        if connectivity == Connectivity::Online {
            let patterns = [Key::Embedding, Key::Roster].map(Pattern::One);
            context.fetch(MissedInputs, patterns.to_vec());
            self.rotation.hurry();
            self.republish(context);
            self.consider(context);
        }
    }

    fn on_timer(&mut self, context: &mut Context<'_>) {
        let now = context.now();
        if self.heartbeat_at(&context.view()).is_some_and(|due| now >= due) {
            self.republish(context);
        }
        self.inform_in_rotation(context, &BTreeSet::new());
        if self.flight.retry_at().is_some_and(|due| now >= due) {
            self.consider(context);
        }
    }

    fn on_job(&mut self, context: &mut Context<'_>, end: JobEnd<Outcome>) {
        match end {
            JobEnd::Finished(Outcome(Ok(teams))) => self.accept_division(context, teams),
            JobEnd::Finished(Outcome(Err(reason))) => {
                context.report_job_failure("division", &reason);
                self.flight.refused(reason);
            }
            JobEnd::Panicked(reason) => {
                context.report_job_failure("panic", &reason);
                self.flight.panicked(context.now(), reason);
            }
        }
        self.consider(context);
    }

    fn on_job_slot_free(&mut self, context: &mut Context<'_>) {
        self.consider(context);
    }

    fn deadline(&self, view: &View<'_>) -> Option<Tick> {
        // An instance whose output is suppressed divides nothing.
        let retry = self.flight.retry_at();
        let retry = retry.filter(|_| view.is_leading() && !view.is_job_running());
        [self.heartbeat_at(view), self.rotation_at(view), retry].into_iter().flatten().min()
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
            (_, None) => "waiting for an embedding".to_owned(),
        }
    }

    fn memory_use(&self) -> MemoryUse {
        let held = [
            self.newest.is_some(),
            self.roster.is_some(),
            self.audit.is_some(),
            self.division.is_some(),
            self.received_by_others.is_some(),
            self.divided.is_some(),
            self.published.is_some(),
        ];
        MemoryUse {
            robots: self.memory.robot_count(),
            messages: held.into_iter().filter(|held| *held).count(),
            ..MemoryUse::default()
        }
    }

    fn run(job: Job, _: &mut Stopwatch) -> Outcome {
        Outcome(divide(&job))
    }
}
