//! State and policy: when an embedding is computed, published, repeated, and who is told of faults.

use std::sync::Arc;
use std::time::Duration;

use muster_machine::{
    Answered, Core, Delivery, Effect, Effects, Event, Footprint, JobGate, QueryId, Role,
    START_FETCH, Start, Stopwatch, Subscription, TERM_FETCH, Turn, Wiring,
};
use muster_method::pairs::PairError;
use muster_model::embedding::{Embedding, EmbeddingMode};
use muster_model::event::{EventKind, Severity};
use muster_model::graph::GraphError;
use muster_model::id::ServiceName;
use muster_model::role::Standing;
use muster_model::settings::{Dimension, EmbedderSettings};
use muster_model::status::ServiceStatus;
use muster_model::time::Tick;
use muster_wire::{Key, Message, Pattern, Request};

use crate::compute::{Basis, Computed, Done, Job, Memory, Outcome, Task, run};
use crate::follow::{Follower, Frame, Taken};
use crate::pairs::Questions;
use crate::teams::{SETTINGS_FETCH, TeamsWanted};

/// How often an embedding is told again while rosters go on and nothing that it rests on changes, so
/// that who reads it sees that the data behind it is fresh.
const HEARTBEAT: Duration = Duration::from_secs(1);

/// How long nothing must change for a fleet to be at rest. Two robots that stop, and a third one a moment
/// later, should not cost two thorough embeddings.
const REST: Duration = Duration::from_secs(1);

/// Difference of two coordinates of the same vector that is rounding.
const SAME: f64 = 1e-10;

/// Packets of one graph that wait for the core: some seconds of deltas.
const GRAPH_QUEUE: usize = 64;

/// The service that turns graphs into an embedding.
#[derive(Debug)]
pub struct Embedder {
    role: Role<EmbedderSettings>,
    follow: Follower,
    /// How many teams `clusterer` divides the fleet into.
    teams: TeamsWanted,
    /// What the last job has left for the next one; none while one runs, which has it.
    memory: Option<Box<Memory>>,
    gate: JobGate<Basis>,
    /// Gets of the similarity of two robots.
    questions: Questions,
    /// Whether the last job answered some of them: an embedding that is wanted comes next.
    compared: bool,
    /// The last good embedding, the one of the holder before at first.
    embedding: Option<Arc<Embedding>>,
    /// What the embedding rests on, and when it was last published; none for one that was learned.
    published: Option<(Basis, Tick)>,
    /// What the last embedding was computed from, and when.
    made: Option<(Basis, Tick)>,
    heartbeat: Option<Tick>,
    /// When the fleet will be at rest if nothing changes.
    rest: Option<Tick>,
    /// Whether an embedding was made while the role was in doubt, and so was not heard by anybody.
    unheard: bool,
}

impl Core for Embedder {
    type Settings = EmbedderSettings;
    type Job = Job;
    type Done = Done;
    const SERVICE: ServiceName = ServiceName::Embedder;

    fn wiring() -> Wiring {
        let subscription = |pattern, delivery| Subscription { pattern, delivery };
        let settings = Pattern::One(Key::Settings(ServiceName::Clusterer));
        Wiring {
            subscriptions: vec![
                subscription(Pattern::Graphs, Delivery::Queue(GRAPH_QUEUE)),
                subscription(Pattern::One(Key::Roster), Delivery::Latest),
                subscription(settings, Delivery::Latest),
            ],
            tokens: Vec::new(),
            served: vec![
                (Pattern::One(Key::Embedding), true),
                (Pattern::One(Key::Roster), false),
                (Pattern::Graphs, false),
            ],
        }
    }

    fn new(start: Start<EmbedderSettings>) -> Self {
        Self::following(Role::new(Self::SERVICE, start), JobGate::default())
    }

    fn handle(&mut self, now: Tick, event: Event<Done>, effects: &mut Effects<Job>) {
        match self.role.attend(now, event, effects) {
            Turn::Events(events) => {
                events.into_iter().for_each(|event| self.take_event(now, event, effects));
            }
            Turn::StandDown => {
                self.questions.refuse("another instance has taken over; ask again", effects);
                *self = Self::following(self.role.clone(), self.gate.abandoned());
                self.take_event(now, Event::Started, effects);
            }
        }
        self.advance(now, effects);
    }

    fn deadline(&self) -> Option<Tick> {
        let follow = self.follow.fetch_due().filter(|_| self.follows());
        if !self.role.is_holding() {
            return self.role.deadline().into_iter().chain(follow).min();
        }
        let retry = self.gate.deadline().filter(|_| self.wanted().is_some());
        let asking = [follow, Some(self.teams.due()), self.role.deadline()];
        asking.into_iter().chain([retry, self.heartbeat, self.rest]).flatten().min()
    }

    fn standing(&self) -> Standing {
        self.role.standing()
    }

    fn status(&self, now: Tick) -> ServiceStatus {
        self.role.status(now, &self.state())
    }

    fn footprint(&self) -> Footprint {
        let mut held = self.follow.footprint();
        held.messages += usize::from(self.embedding.is_some());
        held.offenders = self.role.offender_count();
        held
    }

    fn run(job: Job, stopwatch: &mut Stopwatch) -> Done {
        run(job, stopwatch)
    }
}

impl Embedder {
    /// An instance that has told nothing yet.
    fn following(role: Role<EmbedderSettings>, gate: JobGate<Basis>) -> Self {
        Self {
            role,
            follow: Follower::default(),
            teams: TeamsWanted::default(),
            memory: None,
            gate,
            questions: Questions::default(),
            compared: false,
            embedding: None,
            published: None,
            made: None,
            heartbeat: None,
            rest: None,
            unheard: false,
        }
    }

    fn take_event(&mut self, now: Tick, event: Event<Done>, effects: &mut Effects<Job>) {
        match event {
            Event::Started => {
                self.follow.fetch_begun(now, START_FETCH);
                self.teams.asked(now);
                let patterns = vec![
                    Pattern::One(Key::Embedding),
                    Pattern::One(Key::Roster),
                    Pattern::Graphs,
                    Pattern::One(Key::Settings(ServiceName::Clusterer)),
                ];
                self.role.ask(patterns, effects);
            }
            Event::Received(message) => {
                if self.take(now, message, effects) == Some(Taken::Old) {
                    self.role.count("messages_old");
                }
            }
            Event::Rejected(rejection) => self.role.quarantine(now, rejection, effects),
            Event::Fetched { fetch: TERM_FETCH, messages } => {
                if self.role.checked(now, &messages, effects) {
                    self.repeat(now, effects);
                }
            }
            Event::Fetched { fetch: SETTINGS_FETCH, messages } => {
                self.settings_answered(now, &messages, effects);
            }
            Event::Fetched { fetch, messages } => self.fetched(now, fetch, messages, effects),
            Event::Done(_) | Event::JobFailed(_) if self.gate.was_abandoned() => {}
            Event::Done(done) => self.done(now, done, effects),
            Event::JobFailed(_) if self.gate.failed_aside(now) => {
                self.role.count("comparisons_failed");
                self.questions.refuse("the comparison has failed", effects);
            }
            Event::JobFailed(reason) => {
                let told = self.gate.panicked(now, &reason);
                self.fail(now, told, effects);
            }
            Event::Query { query, request } => {
                let state = self.state();
                match self.role.answer(now, query, request, &state, effects) {
                    Answered::NotOurs(query, request) => {
                        self.answer_get(query, request, effects);
                    }
                    Answered::Done | Answered::SettingsChanged => {}
                }
            }
            Event::LinkRestored => {
                self.follow.refresh();
                self.role.link_restored(now);
                if self.unheard {
                    self.repeat(now, effects);
                }
            }
            Event::LinkLost | Event::Timeout => {}
        }
    }

    /// Takes a message in; what became of it, if it is known what to say of that.
    fn take(&mut self, now: Tick, message: Message, effects: &mut Effects<Job>) -> Option<Taken> {
        let (key, _) = message.keys();
        let taken = match message {
            Message::Graph(delta) => {
                self.follow.take_graph(&delta).map_err(|error: GraphError| error.to_string())
            }
            Message::Roster(roster) => self.follow.take_roster(roster).map_err(str::to_owned),
            Message::Settings(announced) if announced.service == ServiceName::Clusterer => {
                match self.teams.take(&announced) {
                    Ok(taken) => return (!taken).then_some(Taken::Old),
                    Err(error) => Err(error.to_string()),
                }
            }
            _ => return None,
        };
        match taken {
            Ok(taken) => {
                match taken {
                    Taken::Gap => self.role.count("gaps"),
                    Taken::Ignored => self.role.count("modalities_ignored"),
                    Taken::Applied | Taken::Known | Taken::Old => {}
                }
                Some(taken)
            }
            Err(reason) => {
                self.role.refuse(now, &key, &reason, effects);
                None
            }
        }
    }

    /// Takes the answers of `clusterer` in.
    fn settings_answered(&mut self, now: Tick, found: &[Message], effects: &mut Effects<Job>) {
        let announced = found.iter().filter_map(|message| match message {
            Message::Settings(told) if told.service == ServiceName::Clusterer => Some(told),
            _ => None,
        });
        let newest = announced.max_by_key(|announced| announced.header.revision);
        if let Some(Err(error)) = newest.map(|newest| self.teams.take_answer(newest)) {
            let key = Key::Settings(ServiceName::Clusterer);
            self.role.refuse(now, &key, &error.to_string(), effects);
        }
    }

    /// Takes the answers of a fetch in: graphs first, since the roster says which belong together.
    /// Several services answer, and what is older than what is known is nothing unusual.
    fn fetched(
        &mut self,
        now: Tick,
        fetch: u32,
        messages: Vec<Message>,
        effects: &mut Effects<Job>,
    ) {
        let mut learned: Option<Arc<Embedding>> = None;
        let mut rosters = Vec::new();
        let mut passed = Vec::new();
        let starting = fetch == START_FETCH && self.role.is_beginning();
        if starting {
            let revisions = messages.iter().filter_map(|message| match message {
                Message::Embedding(embedding) => Some(embedding.header.revision),
                _ => None,
            });
            self.role.begin_term(now, revisions.max(), effects);
        }
        for message in messages {
            match message {
                Message::Embedding(embedding) if starting => {
                    let newer =
                        |best: &Arc<Embedding>| best.header.revision < embedding.header.revision;
                    if learned.as_ref().is_none_or(newer) {
                        learned = Some(embedding);
                    }
                }
                Message::Roster(_) => rosters.push(message),
                Message::Graph(delta) => {
                    let taken = self.take(now, Message::Graph(delta.clone()), effects);
                    if taken == Some(Taken::Old) {
                        passed.push(delta);
                    }
                }
                other => {
                    self.take(now, other, effects);
                }
            }
        }
        for roster in rosters {
            self.take(now, roster, effects);
        }
        for delta in passed {
            if self.follow.take_back(now, &delta) {
                self.role.count("graphs_taken_back");
            }
        }
        self.follow.fetch_ended(fetch);
        if starting {
            self.embedding = learned;
        }
    }

    /// Does what has become due, whatever happened.
    fn advance(&mut self, now: Tick, effects: &mut Effects<Job>) {
        if self.follow.settle(now) {
            self.role.count("frames_consistent");
        }
        // Who stands by holds the graphs as well: it repeats them to an ingest that takes over.
        if self.follows()
            && let Some((fetch, patterns)) = self.follow.fetch(now)
        {
            self.role.count("fetches");
            effects.push(Effect::Fetch { fetch, patterns });
        }
        if !self.role.is_holding() {
            return;
        }
        self.role.advance(now, Pattern::One(Key::Embedding), effects);
        if self.teams.due() <= now {
            self.teams.asked(now);
            let patterns = vec![Pattern::One(Key::Settings(ServiceName::Clusterer))];
            effects.push(Effect::Fetch { fetch: SETTINGS_FETCH, patterns });
        }
        (self.heartbeat, self.rest) = (None, None);
        let next = self.wanted().cloned().map(|frame| (self.basis(now, &frame), frame));
        if let Some((basis, frame)) = &next {
            self.beat(now, frame, basis, effects);
        }
        let next = next.filter(|(basis, _)| self.gate.wants(now, basis));
        // Questions take turns with embeddings, however many are asked.
        let asked = self.questions.wait() && !self.gate.is_running();
        match next {
            Some((basis, frame)) if self.compared || !asked => self.start(frame, basis, effects),
            _ if asked => self.compare(effects),
            _ => {}
        }
    }

    /// Starts the job that answers the questions, if there is an embedding to answer them by.
    fn compare(&mut self, effects: &mut Effects<Job>) {
        let (Some(embedding), Some(memory)) = (&self.embedding, self.memory.take()) else {
            self.questions.refuse(&PairError::NoEmbedding.to_string(), effects);
            return;
        };
        let task = Task::Compare(self.questions.ask(embedding.header.clone()));
        self.role.count("comparisons_started");
        self.compared = true;
        self.gate.started_aside();
        effects.push(Effect::Start(Job { task, memory }));
    }

    /// Whether the graphs are to be followed: the start has asked for them.
    fn follows(&self) -> bool {
        matches!(self.role.standing(), Standing::Holding | Standing::Standby)
    }

    /// The newest frame, if it is to have an embedding. That of an empty fleet is told only where
    /// there was one before: robots that have left must not stay in a division.
    fn wanted(&self) -> Option<&Arc<Frame>> {
        let left = |embedding: &Arc<Embedding>| !embedding.robots.is_empty();
        let told = self.published.is_some() || self.embedding.as_ref().is_some_and(left);
        self.follow.frame().filter(|frame| told || !frame.robots.is_empty())
    }

    /// What the embedding of a frame rests on by the settings in force; or says when it will rest on more.
    fn basis(&mut self, now: Tick, frame: &Frame) -> Basis {
        let settings = self.role.settings().clone();
        let graphs = frame.graphs.iter().map(|(name, graph)| (name.clone(), graph.revision()));
        let mut basis = Basis {
            robots: frame.robots.clone(),
            graphs: graphs.collect(),
            teams: (settings.dimension == Dimension::Auto).then_some(self.teams.teams()),
            settings,
            settled: false,
        };
        if let Some((made, since)) = &self.made
            && made.is_of(&basis)
        {
            let due = since.after(REST);
            basis.settled = made.settled || due <= now;
            self.rest = (!basis.settled).then_some(due);
        }
        basis
    }

    fn start(&mut self, frame: Arc<Frame>, basis: Basis, effects: &mut Effects<Job>) {
        self.role.count("jobs_started");
        self.compared = false;
        self.gate.started(basis.clone());
        let previous = self.embedding.clone();
        let memory = self.memory.take().unwrap_or_default();
        let task = Task::Embed { frame, basis, previous };
        effects.push(Effect::Start(Job { task, memory }));
    }

    fn done(&mut self, now: Tick, done: Done, effects: &mut Effects<Job>) {
        self.memory = Some(done.memory);
        let (frame, basis, result) = match done.result {
            Outcome::Embedded { frame, basis, result } => (frame, *basis, result),
            Outcome::Compared(answers) => {
                self.gate.ended_aside();
                self.questions.answered(answers, effects);
                return;
            }
        };
        match result {
            Err(error) => {
                let told = self.gate.refused(now, error.kind(), error.to_string());
                self.fail(now, told, effects);
            }
            Ok(computed) => {
                let computed = *computed;
                self.role.count("jobs_done");
                self.gate.succeeded();
                self.made = Some((basis.clone(), now));
                let frame = if basis.settled { self.newest_of(now, &basis, frame) } else { frame };
                let told = self.embedding.as_ref().map(|told| told.roster);
                if basis.settled && told > Some(frame.roster.header.revision) {
                    // It was told again for a later frame meanwhile, and there is a newer one to come.
                    return;
                }
                if basis.settled && self.is_told(&computed) {
                    // Nobody needs to hear the same digits again.
                    self.role.count("embeddings_confirmed");
                    return;
                }
                let roster = &frame.roster;
                let stage = self.role.stage(frame.received, now);
                let embedding = Embedding {
                    header: roster.header.next_stage(self.role.next_revision(), stage),
                    roster: roster.header.revision,
                    graphs: computed.graphs,
                    robots: basis.robots.to_vec(),
                    dimension: computed.dimension,
                    values: computed.values,
                    unseen: computed.unseen,
                    centrality: computed.centrality,
                    quality: computed.quality,
                };
                self.published = Some((basis, now));
                self.publish(embedding, effects);
            }
        }
    }

    /// The newest frame if it rests on the same as the one that a job was begun with: while the job ran,
    /// the embedding may have been told again with the head of a later roster.
    fn newest_of(&mut self, now: Tick, basis: &Basis, frame: Arc<Frame>) -> Arc<Frame> {
        let newest = self.follow.frame().cloned();
        newest.filter(|newest| self.basis(now, newest).is_of(basis)).unwrap_or(frame)
    }

    /// Whether what was computed for a fleet at rest is what was published, as exactly as is promised.
    fn is_told(&self, computed: &Computed) -> bool {
        let Some(told) = &self.embedding else { return false };
        let tolerance = self.role.settings().idle_tolerance;
        let near = |(new, old): (&f64, &f64)| (new - old).abs() <= SAME;
        told.quality.residual <= tolerance
            && told.dimension == computed.dimension
            && told.values.len() == computed.values.len()
            && computed.values.iter().zip(&told.values).all(near)
    }

    fn publish(&mut self, embedding: Embedding, effects: &mut Effects<Job>) {
        self.role.count("embeddings_published");
        self.unheard = !self.role.is_holding();
        let embedding = Arc::new(embedding);
        self.embedding = Some(embedding.clone());
        effects.publish(Message::Embedding(embedding));
    }

    /// Tells the last good embedding again as it is, with the next revision.
    fn repeat(&mut self, now: Tick, effects: &mut Effects<Job>) {
        let Some(embedding) = &self.embedding else { return };
        let mut again = repetition(embedding);
        again.header.revision = self.role.next_revision();
        if let Some(stage) = again.header.stages.last_mut() {
            stage.published = now;
        }
        if let Some((_, at)) = &mut self.published {
            *at = now;
        }
        self.publish(again, effects);
    }

    /// Tells the embedding again with the head of the newest roster, if it still is that of the
    /// newest frame and has not been told lately; or says when that will be due.
    fn beat(&mut self, now: Tick, frame: &Frame, basis: &Basis, effects: &mut Effects<Job>) {
        let (Some((of, at)), Some(embedding)) = (&self.published, &self.embedding) else { return };
        let roster = &frame.roster.header;
        if !of.is_of(basis) || roster.revision <= embedding.roster {
            return;
        }
        let due = at.after(HEARTBEAT);
        if now < due {
            self.heartbeat = Some(due);
            return;
        }
        let mut again = repetition(embedding);
        let stage = self.role.stage(frame.received, now);
        again.header = roster.next_stage(self.role.next_revision(), stage);
        again.roster = roster.revision;
        self.published = Some((basis.clone(), now));
        self.publish(again, effects);
    }

    /// The last good embedding stands.
    fn fail(&mut self, now: Tick, told: Option<String>, effects: &mut Effects<Job>) {
        self.role.count("jobs_failed");
        if let Some(reason) = told {
            self.role.tell(now, Severity::Error, EventKind::JobFailed { reason }, effects);
        }
    }

    /// Answers a get of what the service serves.
    fn answer_get(&mut self, query: QueryId, request: Request, effects: &mut Effects<Job>) {
        let of_embedding = request.selects(self.role.space(), &Key::Embedding);
        match request.katz.clone() {
            // Who does not hold the role leaves the answer to the holder.
            Some(pair) if of_embedding && self.role.is_holding() => {
                self.questions.take(query, request, pair, effects);
            }
            _ => {
                let answer = Ok(self.answer(&request));
                effects.push(Effect::Reply { query, request, answer });
            }
        }
    }

    /// The own output, and what was last heard of `ingest`.
    fn answer(&self, request: &Request) -> Vec<Message> {
        let space = self.role.space();
        let own = self.embedding.iter().cloned().map(Message::Embedding);
        let own = own.filter(|_| request.selects(space, &Key::Embedding));
        own.chain(self.follow.answer(space, request)).collect()
    }

    /// What the service is doing, in a few words.
    fn state(&self) -> String {
        let fault = |text: String| match self.gate.standing_failure() {
            Some(reason) => format!("{text}; the newest frame failed: {reason}"),
            None => text,
        };
        if !self.role.is_holding() {
            return "starting".to_owned();
        }
        match (self.follow.has_roster(), self.follow.frame(), &self.embedding) {
            (false, ..) => "waiting for a roster".to_owned(),
            (_, None, _) => "waiting for the graphs that the roster lists".to_owned(),
            (_, Some(frame), _) if frame.robots.is_empty() => "no robots".to_owned(),
            (_, _, None) => fault("no embedding yet".to_owned()),
            (_, _, Some(embedding)) => fault(format!(
                "{} robots, dimension {}, residual {:.0e}",
                embedding.robots.len(),
                embedding.dimension,
                embedding.quality.residual,
            )),
        }
    }
}

/// An embedding that is told again: nothing was computed for it.
fn repetition(embedding: &Embedding) -> Embedding {
    let mut again = embedding.clone();
    again.quality.mode = EmbeddingMode::Cached;
    again.quality.stage_us = [0; 3];
    again
}
