//! What is scored when, and what is published of it.

mod watching;

use std::sync::Arc;
use std::time::Duration;

use muster_division::scores::ScoreError;
use muster_model::alert::Alerts;
use muster_model::audit::{Audit, Quality};
use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::graph::GraphDelta;
use muster_model::header::Revision;
use muster_model::id::ServiceName;
use muster_model::roster::Roster;
use muster_model::settings::AuditorSettings;
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_service::following::{self, Follower};
use muster_service::{
    Connectivity, Core, Delivery, Get, JobEnd, MemoryUse, ServedKey, SingleFlight, Stopwatch,
    Subscription, TooManyNames, Wiring, answer_teams,
};
use muster_wire::{Key, Message, Pattern, Request};

use crate::alerts::AlertBook;
use crate::alerts::fleet::{Alert, FlappingAlert};
use crate::flapping::FlappingWindow;
use crate::history::{Acceptance, History};
use crate::recordings::Recordings;
use crate::score::{AuditInput, Job, Scores, quality, same_graphs, score};

type Context<'a> = muster_service::Context<'a, Auditor>;
type View<'a> = muster_service::View<'a, Auditor>;

/// The fetches of the service.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AuditorFetch {
    /// A division and the embedding that it names.
    Inputs,
    /// Roster and graphs that are missing.
    Frame,
}

/// Most packets of one key that wait: the slot of the newest alone would lose the embedding that a
/// division names when two come at once.
const QUEUE_PACKETS: usize = 4;

/// Most packets of one graph, or of rosters between them, that wait: some seconds of deltas.
const FRAME_QUEUE_PACKETS: usize = 64;

/// How often an unchanged audit is republished, so that a reader notices when messages are lost.
const HEARTBEAT: Duration = Duration::from_secs(1);

/// How long a division waits for its embedding before that is fetched: the two keys overtake each
/// other on the bus by far less.
const EMBEDDING_GRACE: Duration = Duration::from_millis(250);

/// Time between two fetches of a missing embedding.
const FETCH_INTERVAL: Duration = Duration::from_secs(1);

/// Least time between two scores of the same teams by other graphs: links and places of a fleet that moves
/// change in every frame, and no operator reads faster.
const TEAMS_INTERVAL: Duration = Duration::from_secs(1);

/// A division, and when it was received.
#[derive(Debug, Clone)]
struct Received {
    teams: Checked<Teams>,
    at: Tick,
}

/// What a job is for.
#[derive(Debug, Clone)]
struct Task {
    input: AuditInput,
    source: Received,
}

impl PartialEq for Task {
    fn eq(&self, other: &Self) -> bool {
        self.input.is_same(&other.input)
    }
}

/// The scores of a division.
#[derive(Debug)]
struct Scored {
    scores: Scores,
    /// The newest division that they hold for.
    source: Received,
    published: Tick,
}

/// Scores divisions.
#[derive(Debug, Default)]
pub struct Auditor {
    newest: Option<Received>,
    embeddings: History<Embedding>,
    rosters: History<Roster>,
    follow: Follower,
    flight: SingleFlight<Task>,
    scored: Option<Scored>,
    /// What historians say of themselves.
    recordings: Recordings,
    /// The last good answer; of the leader before until this one has its own.
    audit: Option<Arc<Audit>>,
    book: AlertBook,
    /// The list of open alerts that was last published, by this leader or the one before.
    alerts: Option<Arc<Alerts>>,
    /// When this leader last published it.
    alerts_published: Option<Tick>,
    alert: Alert,
    flapping: FlappingWindow,
    flapping_alert: FlappingAlert,
    /// When to fetch the embedding that the newest division names.
    fetch_at: Option<Tick>,
    /// When the teams were last scored by graphs.
    teams_scored: Option<Tick>,
    /// When to score them again, because graphs or places have changed since.
    teams_at: Option<Tick>,
    /// Whether the last job has left what is said of the teams as it was.
    teams_outdated: bool,
}

impl Auditor {
    fn accept(&mut self, context: &mut Context<'_>, message: Message, wanted: Option<Revision>) {
        let acceptance = match message {
            Message::Teams { teams, .. } => self.accept_teams(context, teams),
            Message::Embedding(embedding) => self.embeddings.keep(embedding, wanted),
            Message::Roster(roster) => self.accept_roster(roster),
            Message::Graph(delta) => {
                self.accept_graph(context, &delta);
                Acceptance::Kept
            }
            Message::Alerts(alerts) => {
                self.accept_alerts(context, alerts);
                Acceptance::Kept
            }
            Message::HistoryState(state) => {
                self.recordings.receive(context.now(), &state);
                self.watch_fleet(context);
                Acceptance::Kept
            }
            Message::ServiceToken { service: ServiceName::Historian, instance, alive: false } => {
                self.recordings.gone(&instance);
                self.watch_fleet(context);
                Acceptance::Kept
            }
            _ => Acceptance::Kept,
        };
        match acceptance {
            Acceptance::Old => context.count("messages_old"),
            Acceptance::Wanted => self.consider(context),
            Acceptance::Kept => {}
        }
    }

    fn accept_teams(&mut self, context: &mut Context<'_>, teams: Checked<Teams>) -> Acceptance {
        let revision = teams.header.revision;
        let last = self.newest.as_ref().map(|newest| newest.teams.header.revision);
        if last.is_some_and(|last| revision <= last) {
            // The same one may come twice: by subscription and by fetch.
            return if last == Some(revision) { Acceptance::Kept } else { Acceptance::Old };
        }
        // No later division names an older embedding.
        self.embeddings.drop_before(teams.embedding);
        self.flapping.observe(context.now(), teams.clone());
        self.newest = Some(Received { teams, at: context.now() });
        self.watch_flapping(context);
        self.watch_fleet(context);
        Acceptance::Wanted
    }

    fn accept_roster(&mut self, roster: Checked<Roster>) -> Acceptance {
        let embedding = self.wanted().and_then(|named| self.embeddings.find(named));
        let wanted = embedding.map(|embedding| embedding.roster);
        self.follow.accept_roster(roster.clone());
        self.rosters.keep(roster, wanted)
    }

    /// Accepts a delta or snapshot of a graph. Only who leads follows graphs: they are large, and a standby that
    /// takes over fetches them.
    fn accept_graph(
        &mut self,
        context: &mut Context<'_>,
        delta: &Arc<GraphDelta>,
    ) -> Option<following::Acceptance> {
        if !context.has_term() {
            return None;
        }
        match self.follow.accept_graph(delta) {
            Ok(acceptance) => {
                if acceptance == following::Acceptance::Gap {
                    context.count("gaps");
                }
                Some(acceptance)
            }
            Err(error) => {
                context.refuse(&Key::Graph(delta.modality.clone()), error.to_string());
                None
            }
        }
    }

    /// Accepts roster and graphs that were fetched.
    fn accept_frame(&mut self, context: &mut Context<'_>, answers: Vec<Message>) {
        let mut old = Vec::new();
        for message in answers {
            match message {
                Message::Graph(delta) => {
                    let became = self.accept_graph(context, &delta);
                    old.extend((became == Some(following::Acceptance::Old)).then_some(delta));
                }
                Message::Roster(roster) => {
                    self.accept_roster(roster);
                }
                _ => {}
            }
        }
        for delta in old {
            if self.follow.roll_back(context.now(), &delta) {
                context.count("graphs_taken_back");
            }
        }
        self.follow.fetch_ended();
    }

    /// The embedding that the newest division names.
    fn wanted(&self) -> Option<Revision> {
        self.newest.as_ref().map(|newest| newest.teams.embedding)
    }

    /// The newest division with what it was made from, if that is there.
    fn input(&self) -> Option<(AuditInput, Received)> {
        let newest = self.newest.as_ref()?;
        let embedding = self.embeddings.find(newest.teams.embedding)?;
        let roster = self.rosters.find(embedding.roster).or_else(|| self.rosters.newest());
        let frame = self.follow.frame();
        let input = AuditInput {
            teams: newest.teams.clone(),
            embedding: embedding.clone(),
            roster: roster.cloned(),
            graphs: frame.map(|frame| frame.graphs.clone()).unwrap_or_default(),
            graphs_of: frame.map(|frame| frame.roster.header.revision),
        };
        Some((input, newest.clone()))
    }

    /// Starts a job if there is something to score that is neither scored nor failed.
    fn consider(&mut self, context: &mut Context<'_>) {
        let Some(slot) = context.free_job_slot().filter(|_| self.newest.is_some()) else { return };
        let Some((input, source)) = self.input() else {
            self.fetch_at = self.fetch_at.or_else(|| Some(context.now().after(EMBEDDING_GRACE)));
            // What comes is considered again; until then no newer graph helps.
            self.teams_at = None;
            return;
        };
        self.fetch_at = None;
        let now = context.now();
        let task = Task { input, source };
        let last = self.flight.completed().filter(|_| self.flight.failure().is_none());
        let scored = last.map(|last| &last.input).zip(self.scored.as_ref());
        let known = scored.map(|(last, scored)| {
            let points = last.has_same_points(&task.input).then_some(&scored.scores);
            let teams = last.has_same_teams(&task.input).then_some(&scored.scores.teams);
            (points, teams)
        });
        let (points, teams) = known.unwrap_or_default();
        let teams_due = self.teams_scored.map(|at| at.after(TEAMS_INTERVAL)).filter(|at| *at > now);
        let waits = points.is_some() && teams.is_some() && teams_due.is_some();
        let overdue = self.teams_outdated && teams.is_some() && teams_due.is_none();
        let should_start = self.flight.should_start(now, &task) || overdue;
        self.teams_at = teams_due.filter(|_| should_start || self.teams_outdated);
        if !should_start || waits {
            if self.flight.failure().is_none()
                && let Some(scored) = &mut self.scored
            {
                scored.source = task.source;
            }
            return;
        }
        let job = Job {
            input: task.input.clone(),
            silhouettes: points
                .map(|scores| [scores.in_embedding.clone(), scores.in_physical.clone()]),
            teams: teams.filter(|_| teams_due.is_some()).cloned(),
        };
        self.teams_outdated = job.teams.is_some();
        if !self.teams_outdated {
            (self.teams_scored, self.teams_at) = (Some(now), None);
        }
        self.flight.started(task);
        context.count("jobs_started");
        context.start_job(slot, job);
    }

    fn accept_scores(&mut self, context: &mut Context<'_>, scores: Scores) {
        let Some(task) = self.flight.completed() else { return };
        context.count("divisions_judged");
        let source = task.source.clone();
        self.scored = Some(Scored { scores, source, published: context.now() });
        // The same division may have come again, fresher, while the job ran.
        self.consider(context);
        self.publish(context);
        self.watch(context);
        self.watch_teams(context);
    }

    /// When a job that has panicked is to be tried again. One whose embedding is missing now waits
    /// for that first.
    fn retry_at(&self, view: &View<'_>) -> Option<Tick> {
        let is_possible = self.fetch_at.is_none() && view.is_leading() && !view.is_job_running();
        self.flight.retry_at().filter(|_| is_possible)
    }

    /// When the teams are to be scored by newer graphs.
    fn teams_at(&self, view: &View<'_>) -> Option<Tick> {
        self.teams_at.filter(|_| view.is_leading() && !view.is_job_running())
    }

    /// Whether the graphs of the newest frame are others than those of the last job.
    fn has_new_graphs(&self) -> bool {
        let scored = self.flight.completed().map_or(&[][..], |task| &task.input.graphs);
        let newest = self.follow.frame().map_or(&[][..], |frame| &frame.graphs);
        !same_graphs(scored, newest)
    }

    /// Whether graphs are followed. Without a roster there is nothing to follow: `ingest` publishes it with every frame.
    fn follows(&self, view: &View<'_>) -> bool {
        view.is_leading() && self.follow.has_roster()
    }

    /// When the alert is to be raised.
    fn alert_at(&self, view: &View<'_>) -> Option<Tick> {
        self.alert.due(view.settings()).filter(|_| view.is_leading())
    }

    /// When the alert of flapping may end though no division comes.
    fn flapping_at(&self, view: &View<'_>) -> Option<Tick> {
        let falls = self.flapping.falls_at();
        falls.filter(|_| self.flapping_alert.is_raised() && view.is_leading())
    }

    /// Publishes the last scores.
    fn publish(&mut self, context: &mut Context<'_>) {
        let Some(scored) = &mut self.scored else { return };
        scored.published = context.now();
        let revision = context.next_revision();
        let stage = context.stage(scored.source.at);
        let teams = &scored.source.teams;
        let audit = Arc::new(Audit {
            header: teams.header.next_stage(revision, stage),
            teams: teams.header.revision,
            embedding: teams.embedding,
            in_embedding: scored.scores.in_embedding.clone(),
            in_physical: scored.scores.in_physical.clone(),
            quality: quality(scored.scores.in_embedding.mean, context.settings()),
            flapping: self.flapping.flapping(context.now()),
            graphs: scored.scores.teams.graphs,
            per_team: scored.scores.teams.teams.clone(),
            losses: scored.scores.teams.losses.clone(),
        });
        self.audit = Some(Arc::clone(&audit));
        context.publish(Message::Audit(audit));
    }

    /// Takes over the newest audit of an earlier leader.
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

    /// Accepts answers, which come in no order: divisions last, when all that they may name is there, and
    /// older ones before newer ones. An embedding that a division among them names is kept however old it is.
    fn accept_all(&mut self, context: &mut Context<'_>, mut messages: Vec<Message>) {
        messages.sort_by_key(|message| {
            let teams = matches!(message, Message::Teams { .. });
            (teams, message.header().map(|header| header.revision))
        });
        let divisions = messages.iter().filter_map(|message| match message {
            Message::Teams { teams, .. } => Some(teams),
            _ => None,
        });
        let newest = divisions
            .chain(self.newest.as_ref().map(|newest| &newest.teams))
            .max_by_key(|teams| teams.header.revision);
        let wanted = newest.map(|teams| teams.embedding);
        for message in messages {
            self.accept(context, message, wanted);
        }
        self.consider(context);
    }

    fn select(
        &self,
        context: &Context<'_>,
        request: &Request,
    ) -> Result<Vec<Message>, TooManyNames> {
        let space = context.space();
        let selects = |key: &Key| request.selects(space, key);
        let mut messages = Vec::new();
        if let Some(audit) = &self.audit
            && (selects(&Key::Audit) || selects(&Key::JsonAudit))
        {
            messages.push(Message::Audit(Arc::clone(audit)));
        }
        if let Some(alerts) = &self.alerts
            && (selects(&Key::Alerts) || selects(&Key::JsonAlerts))
        {
            messages.push(Message::Alerts(Arc::clone(alerts)));
        }
        if let Some(Received { teams, .. }) = &self.newest {
            messages.extend(answer_teams(space, request, teams)?);
        }
        if let Some(embedding) = self.embeddings.newest()
            && selects(&Key::Embedding)
        {
            messages.push(Message::Embedding(embedding.clone()));
        }
        if let Some(roster) = self.rosters.newest()
            && selects(&Key::Roster)
        {
            messages.push(Message::Roster(roster.clone()));
        }
        Ok(messages)
    }
}

impl Core for Auditor {
    type Settings = AuditorSettings;
    type Fetch = AuditorFetch;
    type Job = Job;
    type Done = Result<Scores, ScoreError>;
    const SERVICE: ServiceName = ServiceName::Auditor;

    fn wiring() -> Wiring {
        let subscription = |key, delivery| Subscription { pattern: Pattern::One(key), delivery };
        let frames = Delivery::Queue(FRAME_QUEUE_PACKETS);
        let graphs = Subscription { pattern: Pattern::Graphs, delivery: frames };
        let own = [Key::Audit, Key::JsonAudit, Key::Alerts, Key::JsonAlerts].map(Pattern::One);
        let cached = [Key::Teams, Key::JsonTeams, Key::Embedding, Key::Roster].map(Pattern::One);
        let cached = cached.into_iter().chain([Pattern::RobotTeams]);
        Wiring {
            subscriptions: vec![
                subscription(Key::Teams, Delivery::Latest),
                subscription(Key::Embedding, Delivery::Queue(QUEUE_PACKETS)),
                subscription(Key::Roster, frames),
                // As a standby.
                subscription(Key::Alerts, Delivery::Latest),
                graphs,
                Subscription { pattern: Pattern::HistoryStates, delivery: Delivery::Latest },
            ],
            tokens: vec![Pattern::InstanceTokens(ServiceName::Historian)],
            fetched: vec![],
            served: own
                .map(ServedKey::own)
                .into_iter()
                .chain(cached.map(ServedKey::cached))
                .collect(),
        }
    }

    fn initial() -> Vec<Pattern> {
        let keys = [Key::Audit, Key::Alerts, Key::Teams, Key::Embedding, Key::Roster];
        keys.map(Pattern::One).into_iter().chain([Pattern::HistoryStates]).collect()
    }

    fn output() -> Key {
        Key::Audit
    }

    fn is_output(message: &Message) -> bool {
        matches!(message, Message::Audit(_) | Message::Alerts(_))
    }

    fn new(_now: Tick, _settings: &AuditorSettings) -> Self {
        Self::default()
    }

    fn on_lead(&mut self, context: &mut Context<'_>, answers: Vec<Message>) {
        self.inherit(&answers);
        for message in &answers {
            self.keep_alerts(message);
        }
        // The leader before has reported what it saw. A standby may have missed some of it, and an alert
        // twice for the same robots helps nobody: the window of a leader begins with its term.
        self.flapping = FlappingWindow::default();
        self.inherit_alerts(context);
        self.accept_all(context, answers);
    }

    fn on_follow(&mut self, context: &mut Context<'_>, answers: Vec<Message>) {
        self.accept_all(context, answers);
    }

    fn on_stand_down(&mut self, _context: &mut Context<'_>) {
        *self = Self::default();
    }

    fn on_new_term(&mut self, context: &mut Context<'_>, found: Vec<Message>) {
        if self.scored.is_none() {
            self.inherit(&found);
        }
        self.publish(context);
        self.publish_alerts(context);
    }

    fn on_message(&mut self, context: &mut Context<'_>, message: Message) {
        let wanted = self.wanted();
        self.accept(context, message, wanted);
    }

    fn on_answers(
        &mut self,
        context: &mut Context<'_>,
        fetch: AuditorFetch,
        answers: Vec<Message>,
    ) {
        match fetch {
            AuditorFetch::Inputs => self.accept_all(context, answers),
            AuditorFetch::Frame => self.accept_frame(context, answers),
        }
    }

    fn on_get(&mut self, context: &mut Context<'_>, get: Get) {
        if let Some(payload) = get.request.payload.clone()
            && get.request.exact_key(context.space()) == Some(Key::Alerts)
        {
            return self.acknowledge(context, get, &payload);
        }
        match self.select(context, &get.request) {
            Ok(answer) => context.reply(get, answer),
            Err(problem) => context.reply_error(get, problem.to_string()),
        }
    }

    /// The same scores may have another quality by the new thresholds.
    fn on_settings(&mut self, context: &mut Context<'_>) {
        self.publish(context);
        self.watch(context);
        self.watch_flapping(context);
        self.watch_teams(context);
    }

    fn on_connectivity(&mut self, context: &mut Context<'_>, connectivity: Connectivity) {
        if connectivity == Connectivity::Online {
            // The tokens of historians were lost with the link, and they say nothing before something is new.
            let patterns = [Key::Teams, Key::Embedding, Key::Roster].map(Pattern::One);
            let patterns = patterns.into_iter().chain([Pattern::HistoryStates]);
            context.fetch(AuditorFetch::Inputs, patterns.collect());
            self.follow.refresh();
            self.publish(context);
            self.watch(context);
            self.watch_flapping(context);
            self.watch_teams(context);
            self.publish_alerts(context);
            self.consider(context);
        }
    }

    fn on_timer(&mut self, context: &mut Context<'_>) {
        let now = context.now();
        let is_due = |at: Option<Tick>| at.is_some_and(|at| at <= now);
        if is_due(self.fetch_at) {
            self.fetch_at = Some(now.after(FETCH_INTERVAL));
            let patterns = [Key::Embedding, Key::Teams].map(Pattern::One);
            context.fetch(AuditorFetch::Inputs, patterns.to_vec());
        }
        if is_due(self.scored.as_ref().map(|scored| scored.published.after(HEARTBEAT))) {
            self.publish(context);
            // The rate also falls while the window grows to its whole length.
            self.watch_flapping(context);
            self.watch_teams(context);
        }
        if is_due(self.flapping_at(&context.view())) {
            self.watch_flapping(context);
        }
        if is_due(self.alert_at(&context.view())) {
            self.watch(context);
        }
        if is_due(self.alerts_at(&context.view())) {
            self.advance_alerts(context);
        }
        if is_due(self.alerts_published.map(|at| at.after(HEARTBEAT))) {
            // What was lost of a history is an alert for a while.
            self.watch_fleet(context);
            self.publish_alerts(context);
        }
        if is_due(self.retry_at(&context.view())) || is_due(self.teams_at(&context.view())) {
            self.consider(context);
        }
    }

    /// Makes frames of what has been received, and fetches what is missing.
    fn after_input(&mut self, context: &mut Context<'_>) {
        let now = context.now();
        if self.follow.make_frame(now) {
            context.count("frames_consistent");
            if self.has_new_graphs() {
                self.consider(context);
            }
        }
        if self.follows(&context.view())
            && let Some((patterns, within)) = self.follow.fetch(now)
        {
            context.count("fetches");
            context.fetch_within(AuditorFetch::Frame, patterns, within);
        }
    }

    fn on_job(&mut self, context: &mut Context<'_>, end: JobEnd<Self::Done>) {
        match self.flight.ended(context, |_| "score", end) {
            Some(scores) => self.accept_scores(context, scores),
            None => self.consider(context),
        }
    }

    fn on_job_slot_free(&mut self, context: &mut Context<'_>) {
        self.consider(context);
    }

    fn deadline(&self, view: &View<'_>) -> Option<Tick> {
        let heartbeat = self.scored.as_ref().map(|scored| scored.published.after(HEARTBEAT));
        let alerts = [self.alert_at(view), self.flapping_at(view)];
        let follow = self.follow.fetch_due().filter(|_| self.follows(view));
        let list = self.alerts_published.map(|at| at.after(HEARTBEAT));
        let list = [list.filter(|_| view.is_leading()), self.alerts_at(view)];
        let due = [self.fetch_at, heartbeat, self.retry_at(view), self.teams_at(view), follow];
        due.into_iter().chain(list).chain(alerts).flatten().min()
    }

    fn state(&self, view: &View<'_>) -> String {
        match (&self.scored, &self.newest) {
            (Some(scored), _) => {
                let mean = scored.scores.in_embedding.mean;
                let word = match quality(mean, view.settings()) {
                    Quality::Good => "good",
                    Quality::Fair => "fair",
                    Quality::Poor => "poor",
                    Quality::Undefined => "undefined with fewer than two teams",
                };
                let mean =
                    mean.map_or(String::new(), |mean| format!(", mean silhouette {mean:.2}"));
                format!("{word}{mean}")
            }
            (None, Some(_)) if self.fetch_at.is_some() => {
                "waiting for the embedding of a division".to_owned()
            }
            (None, Some(_)) => "scoring the first division".to_owned(),
            (None, None) => "waiting for a division".to_owned(),
        }
    }

    fn memory_use(&self) -> MemoryUse {
        let single = [
            self.newest.is_some(),
            self.scored.is_some(),
            self.audit.is_some(),
            self.flapping.has_division(),
        ];
        let single = single.into_iter().filter(|held| *held).count();
        let followed = self.follow.memory_use();
        MemoryUse {
            edges: followed.edges,
            robots: self.rosters.iter().map(|roster| roster.robots.len()).sum::<usize>()
                + self.flapping.robots()
                + followed.robots,
            messages: followed.messages
                + self.recordings.count()
                + self.embeddings.iter().len()
                + self.rosters.iter().len()
                + single,
            ..MemoryUse::default()
        }
    }

    fn run(job: Job, _: &mut Stopwatch) -> Self::Done {
        score(job)
    }
}
