//! What is judged when, and what is told of it.

use std::sync::Arc;
use std::time::Duration;

use muster_machine::{
    Answered, Core, Delivery, Effect, Effects, Event, Footprint, JobGate, QueryId, Role,
    START_FETCH, Start, Stopwatch, Subscription, TERM_FETCH, Turn, Wiring, answer_teams,
};
use muster_model::audit::{Audit, Verdict};
use muster_model::embedding::Embedding;
use muster_model::event::{EventKind, Severity};
use muster_model::header::Revision;
use muster_model::id::ServiceName;
use muster_model::role::Standing;
use muster_model::roster::Roster;
use muster_model::settings::AuditorSettings;
use muster_model::status::ServiceStatus;
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_wire::{Key, Message, Pattern, Request};

use crate::alert::Alert;
use crate::history::{History, Taken};
use crate::judge::{Case, Job, Judgement, Outcome, judge, verdict};

/// The number of the fetch of an embedding that a division names and that has not come.
const PAIR_FETCH: u32 = 1;

/// Most packets that wait between two turns of the loop: the slot of the newest alone would lose
/// the embedding that a division names when two come at once.
const QUEUE: usize = 4;

/// An unchanged judgement is told again after this long, so that a reader can tell silence from
/// loss.
const HEARTBEAT: Duration = Duration::from_secs(1);

/// How long a division waits for its embedding before that is asked for: the two keys overtake each
/// other on the bus by far less.
const PATIENCE: Duration = Duration::from_millis(250);

/// How long after an asking that did not help the next one follows.
const ASK_AGAIN: Duration = Duration::from_secs(1);

/// A division, and when it was heard of.
#[derive(Debug, Clone)]
struct Heard {
    teams: Arc<Teams>,
    received: Tick,
}

/// What a job is for.
#[derive(Debug, Clone)]
struct Task {
    case: Case,
    source: Heard,
}

impl PartialEq for Task {
    fn eq(&self, other: &Self) -> bool {
        self.case.is_same(&other.case)
    }
}

/// A judgement, and what it is about.
#[derive(Debug)]
struct Judged {
    judgement: Judgement,
    /// The newest division that it holds for.
    source: Heard,
    published: Tick,
}

/// Judges divisions.
#[derive(Debug)]
pub struct Auditor {
    role: Role<AuditorSettings>,
    newest: Option<Heard>,
    embeddings: History<Embedding>,
    rosters: History<Roster>,
    gate: JobGate<Task>,
    judged: Option<Judged>,
    /// The last good answer; of the holder before until this one has its own.
    audit: Option<Arc<Audit>>,
    alert: Alert,
    /// When to ask for the embedding that the newest division names.
    ask: Option<Tick>,
}

impl Auditor {
    /// An instance that has told nothing yet.
    fn following(role: Role<AuditorSettings>, gate: JobGate<Task>) -> Self {
        Self {
            role,
            newest: None,
            embeddings: History::default(),
            rosters: History::default(),
            gate,
            judged: None,
            audit: None,
            alert: Alert::default(),
            ask: None,
        }
    }

    fn take_event(&mut self, now: Tick, event: Event<Outcome>, effects: &mut Effects<Job>) {
        match event {
            Event::Started => {
                let wanted = [Key::Audit, Key::Teams, Key::Embedding, Key::Roster];
                self.role.ask(wanted.map(Pattern::One).to_vec(), effects);
            }
            Event::Fetched { fetch: START_FETCH, messages } if self.role.is_beginning() => {
                self.begin(now, messages, effects);
            }
            Event::Fetched { fetch: TERM_FETCH, messages } => {
                self.check_term(now, &messages, effects);
            }
            Event::Fetched { messages, .. } => self.take_all(now, messages, effects),
            Event::Received(message) => {
                let wanted = self.wanted();
                self.take_in(now, message, wanted, effects);
            }
            Event::Rejected(rejection) => self.role.quarantine(now, rejection, effects),
            Event::Timeout => self.expire(now, effects),
            Event::Done(_) | Event::JobFailed(_) if self.gate.was_abandoned() => {
                self.consider(now, effects);
            }
            Event::Done(Outcome(result)) => self.finish(now, result, effects),
            Event::JobFailed(said) => {
                let told = self.gate.panicked(now, &said);
                self.fail(now, told, effects);
            }
            Event::Query { query, request } => self.answer(now, query, request, effects),
            Event::LinkLost => {}
            Event::LinkRestored => {
                self.role.link_restored(now);
                let patterns = [Key::Teams, Key::Embedding, Key::Roster].map(Pattern::One);
                effects.push(Effect::Fetch { fetch: PAIR_FETCH, patterns: patterns.to_vec() });
                self.publish(now, effects);
                self.watch(now, effects);
                self.consider(now, effects);
            }
        }
    }

    fn take_in(
        &mut self,
        now: Tick,
        message: Message,
        wanted: Option<Revision>,
        effects: &mut Effects<Job>,
    ) {
        let taken = match message {
            Message::Teams { teams, .. } => self.take_teams(now, teams, effects),
            Message::Embedding(embedding) => self.take_embedding(now, embedding, wanted, effects),
            Message::Roster(roster) => self.take_roster(roster),
            _ => Taken::Kept,
        };
        match taken {
            Taken::Old => self.role.count("messages_old"),
            Taken::Wanted => self.consider(now, effects),
            Taken::Kept => {}
        }
    }

    fn take_teams(&mut self, now: Tick, teams: Arc<Teams>, effects: &mut Effects<Job>) -> Taken {
        let revision = teams.header.revision;
        let last = self.newest.as_ref().map(|heard| heard.teams.header.revision);
        if last.is_some_and(|last| revision <= last) {
            // The same one may well come twice: by subscription and by fetch.
            return if last == Some(revision) { Taken::Kept } else { Taken::Old };
        }
        if let Err(reason) = teams.check() {
            self.role.refuse(now, &Key::Teams, &reason.to_string(), effects);
            return Taken::Kept;
        }
        // Divisions go forward through the embeddings: no later one names what lies before this
        // one.
        self.embeddings.drop_before(teams.embedding);
        self.newest = Some(Heard { teams, received: now });
        Taken::Wanted
    }

    fn take_embedding(
        &mut self,
        now: Tick,
        embedding: Arc<Embedding>,
        wanted: Option<Revision>,
        effects: &mut Effects<Job>,
    ) -> Taken {
        if let Err(reason) = embedding.check() {
            self.role.refuse(now, &Key::Embedding, &reason.to_string(), effects);
            return Taken::Kept;
        }
        self.embeddings.keep(embedding, wanted)
    }

    fn take_roster(&mut self, roster: Arc<Roster>) -> Taken {
        let embedding = self.wanted().and_then(|named| self.embeddings.find(named));
        let wanted = embedding.map(|embedding| embedding.roster);
        self.rosters.keep(roster, wanted)
    }

    /// The embedding that the newest division names.
    fn wanted(&self) -> Option<Revision> {
        self.newest.as_ref().map(|heard| heard.teams.embedding)
    }

    /// The newest division with what it was made from, if that is there.
    fn case(&self) -> Option<(Case, Heard)> {
        let heard = self.newest.as_ref()?;
        let embedding = self.embeddings.find(heard.teams.embedding)?;
        let roster = self.rosters.find(embedding.roster).or_else(|| self.rosters.newest());
        let (teams, embedding) = (Arc::clone(&heard.teams), Arc::clone(embedding));
        let case = Case::new(teams, embedding, roster.map(AsRef::as_ref));
        Some((case, heard.clone()))
    }

    /// Starts a job if there is something to judge that is neither judged nor failed.
    fn consider(&mut self, now: Tick, effects: &mut Effects<Job>) {
        if !self.role.is_holding() || self.gate.is_running() || self.newest.is_none() {
            return;
        }
        let Some((case, source)) = self.case() else {
            self.ask = self.ask.or_else(|| Some(now.after(PATIENCE)));
            return;
        };
        self.ask = None;
        let task = Task { case, source };
        if !self.gate.wants(now, &task) {
            if self.gate.standing_failure().is_none()
                && let Some(judged) = &mut self.judged
            {
                judged.source = task.source;
            }
            return;
        }
        let job = Job { case: task.case.clone() };
        self.gate.started(task);
        self.role.count("jobs_started");
        effects.push(Effect::Start(job));
    }

    fn finish(&mut self, now: Tick, result: Result<Judgement, String>, effects: &mut Effects<Job>) {
        match result {
            Ok(judgement) => {
                self.gate.succeeded();
                let Some(task) = self.gate.settled() else { return };
                self.role.count("divisions_judged");
                let source = task.source.clone();
                self.judged = Some(Judged { judgement, source, published: now });
                // The same division may have come again, fresher, while the job ran.
                self.consider(now, effects);
                self.publish(now, effects);
                self.watch(now, effects);
            }
            Err(reason) => {
                let told = self.gate.refused(now, "judgement", reason);
                self.fail(now, told, effects);
            }
        }
    }

    fn fail(&mut self, now: Tick, told: Option<String>, effects: &mut Effects<Job>) {
        self.role.count("jobs_failed");
        if let Some(reason) = told {
            let kind = EventKind::JobFailed { reason };
            self.role.tell(now, Severity::Error, kind, effects);
        }
        self.consider(now, effects);
    }

    /// When a job that has panicked is to be tried again. One whose embedding is missing now waits
    /// for that first.
    fn retry_at(&self) -> Option<Tick> {
        self.gate.deadline().filter(|_| self.ask.is_none() && self.role.is_holding())
    }

    /// When the alert is to be raised.
    fn alert_at(&self) -> Option<Tick> {
        self.alert.due(self.role.settings()).filter(|_| self.role.is_holding())
    }

    /// Tells the last judgement.
    fn publish(&mut self, now: Tick, effects: &mut Effects<Job>) {
        let Some(judged) = &mut self.judged else { return };
        judged.published = now;
        let revision = self.role.next_revision();
        let stage = self.role.stage(judged.source.received, now);
        let teams = &judged.source.teams;
        let audit = Arc::new(Audit {
            header: teams.header.next_stage(revision, stage),
            teams: teams.header.revision,
            embedding: teams.embedding,
            in_embedding: judged.judgement.in_embedding.clone(),
            in_physical: judged.judgement.in_physical.clone(),
            verdict: verdict(judged.judgement.in_embedding.mean, self.role.settings()),
        });
        self.audit = Some(Arc::clone(&audit));
        effects.publish(Message::Audit(audit));
    }

    /// Raises or ends the alert, once that can be told: in doubt of the role it would be lost.
    fn watch(&mut self, now: Tick, effects: &mut Effects<Job>) {
        let Some(judged) = self.judged.as_ref().filter(|_| self.role.is_holding()) else { return };
        let mean = judged.judgement.in_embedding.mean;
        let Some(kind) = self.alert.observe(now, mean, self.role.settings()) else { return };
        let severity = if matches!(kind, EventKind::QualityLow { .. }) {
            self.role.count("alerts");
            Severity::Warning
        } else {
            Severity::Info
        };
        self.role.tell(now, severity, kind, effects);
    }

    fn begin(&mut self, now: Tick, messages: Vec<Message>, effects: &mut Effects<Job>) {
        self.inherit(&messages);
        let seen = self.audit.as_ref().map(|audit| audit.header.revision);
        self.role.begin_term(now, seen, effects);
        self.take_all(now, messages, effects);
    }

    /// Takes over the newest audit of an earlier holder.
    fn inherit(&mut self, messages: &[Message]) {
        for message in messages {
            if let Message::Audit(audit) = message {
                let last = self.audit.as_ref().map(|audit| audit.header.revision);
                if last.is_none_or(|last| audit.header.revision > last) {
                    self.audit = Some(Arc::clone(audit));
                }
            }
        }
    }

    /// Looks whether readers hold a higher revision, and if so, tells the judgement under a new term.
    fn check_term(&mut self, now: Tick, messages: &[Message], effects: &mut Effects<Job>) {
        if self.role.checked(now, messages, effects) {
            if self.judged.is_none() {
                self.inherit(messages);
            }
            self.publish(now, effects);
        }
    }

    /// Takes answers in, which come in no order: divisions last, when all that they may name is
    /// there, and the older of two before the newer. An embedding that a division among them names
    /// is taken however old it is.
    fn take_all(&mut self, now: Tick, mut messages: Vec<Message>, effects: &mut Effects<Job>) {
        messages.sort_by_key(|message| {
            let teams = matches!(message, Message::Teams { .. });
            (teams, message.header().map(|header| header.revision))
        });
        let divisions = messages.iter().filter_map(|message| match message {
            Message::Teams { teams, .. } => Some(teams),
            _ => None,
        });
        let newest = divisions
            .chain(self.newest.as_ref().map(|heard| &heard.teams))
            .max_by_key(|teams| teams.header.revision);
        let wanted = newest.map(|teams| teams.embedding);
        for message in messages {
            self.take_in(now, message, wanted, effects);
        }
        self.consider(now, effects);
    }

    fn expire(&mut self, now: Tick, effects: &mut Effects<Job>) {
        if self.ask.is_some_and(|due| now >= due) {
            self.ask = Some(now.after(ASK_AGAIN));
            let patterns = vec![Pattern::One(Key::Embedding), Pattern::One(Key::Teams)];
            effects.push(Effect::Fetch { fetch: PAIR_FETCH, patterns });
        }
        if self.judged.as_ref().is_some_and(|judged| now >= judged.published.after(HEARTBEAT)) {
            self.publish(now, effects);
        }
        if self.alert_at().is_some_and(|due| now >= due) {
            self.watch(now, effects);
        }
        if self.retry_at().is_some_and(|due| now >= due) {
            self.consider(now, effects);
        }
    }

    fn answer(&mut self, now: Tick, query: QueryId, request: Request, effects: &mut Effects<Job>) {
        let state = self.state();
        match self.role.answer(now, query, request, &state, effects) {
            Answered::Done => {}
            Answered::SettingsChanged => {
                // The thresholds judge the same silhouettes.
                self.publish(now, effects);
                self.watch(now, effects);
            }
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
        if let Some(audit) = &self.audit
            && (selects(&Key::Audit) || selects(&Key::JsonAudit))
        {
            messages.push(Message::Audit(Arc::clone(audit)));
        }
        if let Some(Heard { teams, .. }) = &self.newest {
            messages.extend(answer_teams(space, request, teams)?);
        }
        if let Some(embedding) = self.embeddings.newest()
            && selects(&Key::Embedding)
        {
            messages.push(Message::Embedding(Arc::clone(embedding)));
        }
        if let Some(roster) = self.rosters.newest()
            && selects(&Key::Roster)
        {
            messages.push(Message::Roster(Arc::clone(roster)));
        }
        Ok(messages)
    }

    fn state(&self) -> String {
        match (&self.judged, &self.newest) {
            (Some(judged), _) => {
                let mean = judged.judgement.in_embedding.mean;
                let word = match verdict(mean, self.role.settings()) {
                    Verdict::Good => "good",
                    Verdict::Fair => "fair",
                    Verdict::Poor => "poor",
                    Verdict::Undefined => "undefined with fewer than two teams",
                };
                let mean =
                    mean.map_or(String::new(), |mean| format!(", mean silhouette {mean:.2}"));
                format!("{word}{mean}")
            }
            (None, Some(_)) if self.ask.is_some() => {
                "waiting for the embedding of a division".to_owned()
            }
            (None, Some(_)) => "judging the first division".to_owned(),
            (None, None) => "waiting for a division".to_owned(),
        }
    }
}

impl Core for Auditor {
    type Settings = AuditorSettings;
    type Job = Job;
    type Done = Outcome;
    const SERVICE: ServiceName = ServiceName::Auditor;

    fn wiring() -> Wiring {
        let subscription = |key, delivery| Subscription { pattern: Pattern::One(key), delivery };
        Wiring {
            subscriptions: vec![
                subscription(Key::Teams, Delivery::Latest),
                subscription(Key::Embedding, Delivery::Queue(QUEUE)),
                subscription(Key::Roster, Delivery::Queue(QUEUE)),
            ],
            tokens: vec![],
            served: vec![
                (Pattern::One(Key::Audit), true),
                (Pattern::One(Key::JsonAudit), true),
                (Pattern::One(Key::Teams), false),
                (Pattern::One(Key::JsonTeams), false),
                (Pattern::RobotTeams, false),
                (Pattern::One(Key::Embedding), false),
                (Pattern::One(Key::Roster), false),
            ],
        }
    }

    fn new(start: Start<AuditorSettings>) -> Self {
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
        self.role.advance(now, Pattern::One(Key::Audit), effects);
    }

    fn standing(&self) -> Standing {
        self.role.standing()
    }

    fn deadline(&self) -> Option<Tick> {
        let heartbeat = self.judged.as_ref().map(|judged| judged.published.after(HEARTBEAT));
        let due = [self.ask, heartbeat, self.alert_at(), self.retry_at(), self.role.deadline()];
        due.into_iter().flatten().min()
    }

    fn status(&self, now: Tick) -> ServiceStatus {
        self.role.status(now, &self.state())
    }

    fn footprint(&self) -> Footprint {
        let single = [self.newest.is_some(), self.judged.is_some(), self.audit.is_some()];
        let single = single.into_iter().filter(|held| *held).count();
        Footprint {
            robots: self.rosters.iter().map(|roster| roster.robots.len()).sum(),
            edges: 0,
            messages: self.embeddings.iter().len() + self.rosters.iter().len() + single,
            offenders: self.role.offender_count(),
        }
    }

    fn run(job: Job, _: &mut Stopwatch) -> Outcome {
        Outcome(judge(&job.case))
    }
}
