//! What is divided when, and what is told of it.

use std::collections::BTreeSet;
use std::sync::Arc;

use muster_machine::{
    Answered, Core, Delivery, Effect, Effects, Event, Footprint, JobGate, QueryId, Role,
    START_FETCH, Start, Stopwatch, Subscription, TERM_FETCH, Turn, Wiring, answer_teams,
};
use muster_model::audit::Audit;
use muster_model::embedding::Embedding;
use muster_model::event::{EventKind, Severity};
use muster_model::id::{RobotId, ServiceName};
use muster_model::role::Standing;
use muster_model::roster::{Presence, Roster};
use muster_model::settings::ClustererSettings;
use muster_model::status::ServiceStatus;
use muster_model::teams::Teams;
use muster_model::time::{Tick, seconds};
use muster_wire::{Key, Message, Pattern, Request};

use crate::division::{Job, Outcome, divide, same_data};
use crate::identity::Memory;
use crate::leader::leaders;
use crate::telling::{Turn as Turns, counted, robots_to_tell, shortage};

/// The number of the fetch that is made when a lost link is back: what came meanwhile was missed.
const LINK_FETCH: u32 = 1;

/// Most changes of one division that are told as events: when a whole fleet is divided anew, the
/// division itself says it better than one event per robot. The others are counted.
const MAX_CHANGE_EVENTS: usize = 64;

/// An embedding, and when it was heard of.
#[derive(Debug, Clone)]
struct Heard {
    embedding: Arc<Embedding>,
    received: Tick,
}

/// What a division is made of.
#[derive(Debug, Clone)]
struct Task {
    heard: Heard,
    /// The settings without those that change no division.
    settings: ClustererSettings,
}

impl PartialEq for Task {
    fn eq(&self, other: &Self) -> bool {
        self.settings == other.settings && same_data(&self.heard.embedding, &other.heard.embedding)
    }
}

/// What this holder of the role has told.
#[derive(Debug)]
struct Told {
    /// The newest embedding with the data of the division.
    source: Heard,
    /// When the division was last told.
    published: Tick,
    /// When its JSON mirror was last told.
    mirrored: Tick,
}

/// Divides embeddings into teams.
#[derive(Debug)]
pub struct Clusterer {
    role: Role<ClustererSettings>,
    newest: Option<Heard>,
    roster: Option<Arc<Roster>>,
    /// What the auditor last said, for the case that it is gone.
    audit: Option<Arc<Audit>>,
    gate: JobGate<Task>,
    /// The last good answer; of the holder before until this one has its own.
    division: Option<Arc<Teams>>,
    /// The division that others have heard last: what is told while the role is in doubt is heard by
    /// nobody, and its changes are told with the next one.
    heard: Option<Arc<Teams>>,
    /// The embedding that the division names.
    divided: Option<Arc<Embedding>>,
    /// Teams that robots had before the division.
    memory: Arc<Memory>,
    told: Option<Told>,
    turn: Turns,
    /// How many teams were asked for and formed when that was last told to be too few.
    fewer: Option<(u32, u32)>,
}

impl Clusterer {
    /// An instance that has told nothing yet.
    fn following(role: Role<ClustererSettings>, gate: JobGate<Task>) -> Self {
        Self {
            role,
            newest: None,
            roster: None,
            audit: None,
            gate,
            division: None,
            heard: None,
            divided: None,
            memory: Arc::default(),
            told: None,
            turn: Turns::default(),
            fewer: None,
        }
    }

    fn take_event(&mut self, now: Tick, event: Event<Outcome>, effects: &mut Effects<Job>) {
        match event {
            Event::Started => {
                let wanted = [Key::Teams, Key::Embedding, Key::Roster].map(Pattern::One);
                self.role.ask(wanted.to_vec(), effects);
            }
            Event::Fetched { fetch: START_FETCH, messages } if self.role.is_beginning() => {
                self.begin(now, messages, effects);
            }
            Event::Fetched { fetch: TERM_FETCH, messages } => {
                self.check_term(now, &messages, effects);
            }
            Event::Fetched { messages, .. } => self.take_all(now, messages, effects),
            Event::Received(message) => self.take_in(now, message, effects),
            Event::Rejected(rejection) => self.role.quarantine(now, rejection, effects),
            Event::Timeout => self.expire(now, effects),
            Event::Done(_) | Event::JobFailed(_) if self.gate.was_abandoned() => {
                self.consider(now, effects);
            }
            Event::Done(Outcome(result)) => self.finish(now, result, effects),
            Event::JobFailed(said) => {
                let told = self.gate.panicked(now, &said);
                self.fail(now, told, effects);
                self.consider(now, effects);
            }
            Event::Query { query, request } => self.answer(now, query, request, effects),
            Event::LinkLost => {}
            Event::LinkRestored => {
                self.role.link_restored(now);
                effects.push(Effect::Fetch {
                    fetch: LINK_FETCH,
                    patterns: vec![Pattern::One(Key::Embedding), Pattern::One(Key::Roster)],
                });
                self.turn.hurry();
                self.tell_again(now, effects);
                self.consider(now, effects);
            }
        }
    }

    fn take_in(&mut self, now: Tick, message: Message, effects: &mut Effects<Job>) {
        match message {
            Message::Embedding(embedding) => self.take_embedding(now, embedding, effects),
            Message::Roster(roster) => self.take_roster(now, roster, effects),
            Message::Audit(audit) => self.take_audit(audit),
            _ => {}
        }
    }

    /// Takes answers in, the newest first, so that no older one is divided before it.
    fn take_all(&mut self, now: Tick, mut messages: Vec<Message>, effects: &mut Effects<Job>) {
        let revision = |message: &Message| message.header().map(|header| header.revision);
        messages.sort_by_key(|message| std::cmp::Reverse(revision(message)));
        for message in messages {
            self.take_in(now, message, effects);
        }
    }

    fn take_audit(&mut self, audit: Arc<Audit>) {
        let last = self.audit.as_ref().map(|audit| audit.header.revision);
        if last.is_none_or(|last| audit.header.revision > last) {
            self.audit = Some(audit);
        }
    }

    fn take_embedding(&mut self, now: Tick, embedding: Arc<Embedding>, effects: &mut Effects<Job>) {
        let revision = embedding.header.revision;
        let last = self.newest.as_ref().map(|heard| heard.embedding.header.revision);
        if last.is_some_and(|last| revision <= last) {
            // The same one may well come twice: by subscription and by fetch.
            if last != Some(revision) {
                self.role.count("messages_old");
            }
            return;
        }
        if let Err(reason) = embedding.check() {
            self.role.refuse(now, &Key::Embedding, &reason.to_string(), effects);
            return;
        }
        self.role.count("embeddings_received");
        self.newest = Some(Heard { embedding, received: now });
        self.consider(now, effects);
    }

    fn take_roster(&mut self, now: Tick, roster: Arc<Roster>, effects: &mut Effects<Job>) {
        let revision = roster.header.revision;
        let last = self.roster.as_ref().map(|roster| roster.header.revision);
        if last.is_some_and(|last| revision <= last) {
            if last != Some(revision) {
                self.role.count("messages_old");
            }
            return;
        }
        if let Err(reason) = roster.check() {
            self.role.refuse(now, &Key::Roster, &reason.to_string(), effects);
            return;
        }
        self.roster = Some(roster);
        // Robots went silent, left, or command others now: the same labels, told anew.
        if let (Some(told), Some(division)) = (&self.told, &self.division) {
            let (leaders, stale) = self.roster_view(division, &told.source.embedding);
            let led = division.teams.iter().zip(leaders);
            if stale != division.stale
                || led.into_iter().any(|(team, leader)| leader.is_some_and(|l| l != team.leader))
            {
                let source = told.source.clone();
                self.repeat(now, source, effects);
            }
        }
    }

    /// What the newest roster says of the division of an embedding: the leader of each team, and who
    /// is stale. Who is missing from a roster that is not older than the embedding's is about to go.
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
    fn consider(&mut self, now: Tick, effects: &mut Effects<Job>) {
        if !self.role.is_holding() || self.gate.is_running() {
            return;
        }
        let Some(newest) = &self.newest else { return };
        let settings = ClustererSettings { heartbeat_s: 1.0, ..self.role.settings().clone() };
        let task = Task { heard: newest.clone(), settings };
        if !self.gate.wants(now, &task) {
            if self.gate.standing_failure().is_none()
                && let Some(told) = &mut self.told
            {
                told.source = newest.clone();
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
        self.gate.started(task);
        self.role.count("jobs_started");
        effects.push(Effect::Start(job));
    }

    fn finish(&mut self, now: Tick, result: Result<Teams, String>, effects: &mut Effects<Job>) {
        match result {
            Ok(teams) => {
                self.gate.succeeded();
                self.accept(now, teams, effects);
            }
            Err(reason) => {
                let told = self.gate.refused(now, "division", reason);
                self.fail(now, told, effects);
            }
        }
        self.consider(now, effects);
    }

    fn fail(&mut self, now: Tick, told: Option<String>, effects: &mut Effects<Job>) {
        self.role.count("jobs_failed");
        if let Some(reason) = told {
            let kind = EventKind::JobFailed { reason };
            self.role.tell(now, Severity::Error, kind, effects);
        }
    }

    fn accept(&mut self, now: Tick, teams: Teams, effects: &mut Effects<Job>) {
        let Some(task) = self.gate.settled() else { return };
        // An embedding with the same data may have come while the job ran.
        let newer = self.newest.as_ref().filter(|h| same_data(&h.embedding, &task.heard.embedding));
        let source = newer.unwrap_or(&task.heard).clone();
        Arc::make_mut(&mut self.memory).follow(now, self.division.as_deref(), &teams);
        self.publish(now, teams, source, effects);
    }

    /// Tells what a division has changed.
    fn tell_changes(&mut self, now: Tick, teams: &Teams, effects: &mut Effects<Job>) {
        let changes = teams.changes.clone();
        let many = changes.len();
        self.role.count_many("team_changes", many as u64);
        for change in changes.into_iter().take(MAX_CHANGE_EVENTS) {
            self.role.tell(now, Severity::Info, EventKind::TeamChanged(change), effects);
        }
        if let Some(untold) = many.checked_sub(MAX_CHANGE_EVENTS).filter(|untold| *untold > 0) {
            self.role.count_many("team_changes_untold", untold as u64);
        }
        match shortage(teams) {
            Some((requested, formed, reason)) if self.fewer != Some((requested, formed)) => {
                self.fewer = Some((requested, formed));
                let kind = EventKind::FewerTeams { requested, formed, reason };
                self.role.tell(now, Severity::Warning, kind, effects);
            }
            Some(_) => {}
            None => self.fewer = None,
        }
    }

    /// Tells the last division anew, as it stands by the newest roster.
    fn repeat(&mut self, now: Tick, source: Heard, effects: &mut Effects<Job>) {
        let Some(division) = &self.division else { return };
        let mut teams = Teams::clone(division);
        if self.heard.as_ref().is_some_and(|heard| Arc::ptr_eq(heard, division)) {
            teams.changes.clear();
        }
        self.publish(now, teams, source, effects);
    }

    fn publish(&mut self, now: Tick, teams: Teams, source: Heard, effects: &mut Effects<Job>) {
        let (leaders, stale) = self.roster_view(&teams, &source.embedding);
        let mut teams = Teams { stale, ..teams };
        for (team, leader) in teams.teams.iter_mut().zip(leaders) {
            if let Some(leader) = leader {
                team.leader = leader;
            }
        }
        let revision = self.role.next_revision();
        let stage = self.role.stage(source.received, now);
        teams.embedding = source.embedding.header.revision;
        // A restart goes by the division alone, so that it says which numbers others have given.
        teams.next_team = teams.next_team.max(self.memory.next_team);
        teams.header = source.embedding.header.next_stage(revision, stage);

        let heartbeat = seconds(self.role.settings().heartbeat_s);
        let before = self.heard.as_deref();
        let mirrored = self.told.as_ref().map(|told| told.mirrored);
        let mirror = mirrored.is_none_or(|last| now.since(last) >= heartbeat)
            || before.is_none_or(|before| !before.same_division(&teams));
        let teams = Arc::new(teams);
        effects.publish(Message::Teams { teams: Arc::clone(&teams), mirror });
        self.role.count("divisions_published");

        let changed = robots_to_tell(&teams, before);
        for robot in &changed {
            if let Some(told) = teams.robot_team(robot) {
                effects.publish(Message::RobotTeam(told));
            }
        }
        let changed: BTreeSet<&RobotId> = changed.into_iter().collect();
        let mirrored = if mirror { now } else { mirrored.unwrap_or(now) };
        self.divided = Some(Arc::clone(&source.embedding));
        self.told = Some(Told { source, published: now, mirrored });
        self.division = Some(Arc::clone(&teams));
        self.retell(now, &changed, effects);
        if self.role.is_holding() {
            self.heard = Some(Arc::clone(&teams));
            self.tell_changes(now, &teams, effects);
        }
    }

    /// When the next robots are to be told again.
    fn retell_at(&self) -> Option<Tick> {
        self.told.as_ref().filter(|_| self.role.is_holding())?;
        Some(self.turn.due(seconds(self.role.settings().heartbeat_s)))
    }

    /// Tells the robots whose turn it is of their team again, if it is time, but for those that have
    /// just been told.
    fn retell(&mut self, now: Tick, just_told: &BTreeSet<&RobotId>, effects: &mut Effects<Job>) {
        if self.retell_at().is_none_or(|due| now < due) {
            return;
        }
        let (Some(told), Some(teams)) = (&self.told, &self.division) else { return };
        // The embedding has the robots of the division, ordered by name.
        for robot in self.turn.next(now, &told.source.embedding.robots) {
            if !just_told.contains(&robot)
                && let Some(told) = teams.robot_team(&robot)
            {
                effects.publish(Message::RobotTeam(told));
            }
        }
    }

    /// Takes over the newest division of an earlier holder among messages. Whatever is told was
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
        self.heard = self.division.clone();
    }

    fn begin(&mut self, now: Tick, messages: Vec<Message>, effects: &mut Effects<Job>) {
        self.inherit(&messages);
        let seen = self.division.as_ref().map(|division| division.header.revision);
        self.role.begin_term(now, seen, effects);
        self.take_all(now, messages, effects);
        self.consider(now, effects);
    }

    /// Looks whether readers hold a higher revision, and if so, tells everything under a new term.
    fn check_term(&mut self, now: Tick, messages: &[Message], effects: &mut Effects<Job>) {
        if !self.role.checked(now, messages, effects) {
            return;
        }
        for message in messages {
            if let Message::Teams { teams, .. } = message {
                // The numbers of that division are taken, whoever has given them.
                let memory = Arc::make_mut(&mut self.memory);
                memory.next_team = memory.next_team.max(teams.next_team);
            }
        }
        // The job that runs knows neither those numbers nor, at first, that division.
        if self.gate.is_running() {
            self.gate = self.gate.abandoned();
        }
        self.turn.hurry();
        if self.told.is_some() {
            self.tell_again(now, effects);
        } else {
            self.inherit(messages);
        }
    }

    /// Tells the last division of this holder anew, if there is one.
    fn tell_again(&mut self, now: Tick, effects: &mut Effects<Job>) {
        if let Some(told) = &self.told {
            let source = told.source.clone();
            self.repeat(now, source, effects);
        }
    }

    fn expire(&mut self, now: Tick, effects: &mut Effects<Job>) {
        if self.heartbeat_at().is_some_and(|due| now >= due) {
            self.tell_again(now, effects);
        }
        self.retell(now, &BTreeSet::new(), effects);
        if self.gate.deadline().is_some_and(|due| now >= due) {
            self.consider(now, effects);
        }
    }

    fn heartbeat_at(&self) -> Option<Tick> {
        let told = self.told.as_ref()?;
        Some(told.published.after(seconds(self.role.settings().heartbeat_s)))
    }

    fn answer(&mut self, now: Tick, query: QueryId, request: Request, effects: &mut Effects<Job>) {
        let state = self.state();
        match self.role.answer(now, query, request, &state, effects) {
            Answered::Done => {}
            Answered::SettingsChanged => self.consider(now, effects),
            Answered::NotOurs(query, request) => {
                let answer = self.select(&request);
                effects.push(Effect::Reply { query, request, answer });
            }
        }
    }

    fn select(&self, request: &Request) -> Result<Vec<Message>, String> {
        let space = self.role.space();
        let selects = |key: &Key| request.selects(space, key);
        let mut messages = Vec::new();
        if let Some(teams) = &self.division {
            messages.extend(answer_teams(space, request, teams)?);
        }
        if selects(&Key::Embedding) {
            // Whoever judges the division needs the embedding that it names, however old it is.
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

    fn state(&self) -> String {
        match (&self.division, &self.newest) {
            (Some(division), Some(_)) => {
                let teams = division.teams.len();
                let assigned: usize = division.teams.iter().map(|team| team.members.len()).sum();
                let robots = assigned + division.unassigned.len();
                format!("{} of {}", counted(teams, "team"), counted(robots, "robot"))
            }
            (None, Some(_)) => "dividing the first embedding".to_owned(),
            (_, None) => "waiting for an embedding".to_owned(),
        }
    }
}

impl Core for Clusterer {
    type Settings = ClustererSettings;
    type Job = Job;
    type Done = Outcome;
    const SERVICE: ServiceName = ServiceName::Clusterer;

    fn wiring() -> Wiring {
        let subscription =
            |key| Subscription { pattern: Pattern::One(key), delivery: Delivery::Latest };
        Wiring {
            subscriptions: [Key::Embedding, Key::Roster, Key::Audit].map(subscription).to_vec(),
            tokens: vec![],
            served: vec![
                (Pattern::One(Key::Teams), true),
                (Pattern::One(Key::JsonTeams), true),
                (Pattern::RobotTeams, true),
                (Pattern::One(Key::Embedding), false),
                (Pattern::One(Key::Roster), false),
                (Pattern::One(Key::Audit), false),
                (Pattern::One(Key::JsonAudit), false),
            ],
        }
    }

    fn new(start: Start<ClustererSettings>) -> Self {
        Self::following(Role::new(Self::SERVICE, start), JobGate::default())
    }

    fn handle(&mut self, now: Tick, event: Event<Outcome>, effects: &mut Effects<Job>) {
        match self.role.attend(now, event, effects) {
            Turn::Events(events) => {
                events.into_iter().for_each(|event| self.take_event(now, event, effects));
            }
            Turn::StandDown => {
                *self = Self::following(self.role.clone(), self.gate.abandoned());
                self.take_event(now, Event::Started, effects);
            }
        }
        self.role.advance(now, Pattern::One(Key::Teams), effects);
    }

    fn standing(&self) -> Standing {
        self.role.standing()
    }

    fn deadline(&self) -> Option<Tick> {
        // Nothing is divided by who may not tell of it.
        let retry = self.gate.deadline().filter(|_| self.role.is_holding());
        let times = [self.heartbeat_at(), self.retell_at(), retry, self.role.deadline()];
        times.into_iter().flatten().min()
    }

    fn status(&self, now: Tick) -> ServiceStatus {
        self.role.status(now, &self.state())
    }

    fn footprint(&self) -> Footprint {
        let held = [
            self.newest.is_some(),
            self.roster.is_some(),
            self.audit.is_some(),
            self.division.is_some(),
            self.heard.is_some(),
            self.divided.is_some(),
            self.told.is_some(),
        ];
        Footprint {
            robots: self.memory.robot_count(),
            edges: 0,
            messages: held.into_iter().filter(|held| *held).count(),
            offenders: self.role.offender_count(),
        }
    }

    fn run(job: Job, _: &mut Stopwatch) -> Outcome {
        Outcome(divide(&job))
    }
}
