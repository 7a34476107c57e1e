//! When an embedding is computed, and which job is next.

mod input;
mod output;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use muster_method::MethodError;
use muster_method::pairs::PairError;
use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::header::Revision;
use muster_model::id::{Modality, RobotId, ServiceName};
use muster_model::orders::NewOrders;
use muster_model::role::ReplicaState;
use muster_model::settings::{Alpha, Dimension, EmbedderSettings, SettingsError};
use muster_model::time::Tick;
use muster_service::following::{Acceptance, Follower, Frame};
use muster_service::{
    Connectivity, Core, Delivery, FreeJobSlot, Get, JobEnd, MemoryUse, ServedKey, SingleFlight,
    Stopwatch, Subscription, Wiring,
};
use muster_wire::{Key, Message, Pattern, Request};

use crate::compute::{Basis, Done, Job, Memory, Outcome, Task, run};
use crate::doubt::Doubts;
use crate::pairs::Questions;
use crate::reasons::{self, NO_EMBEDDING, ReasonQueue};
use crate::shape::Shape;
use crate::teams::TeamsWanted;

type Context<'a> = muster_service::Context<'a, Embedder>;
type View<'a> = muster_service::View<'a, Embedder>;

/// How long nothing must change for a fleet to be at rest. Two robots that stop, and a third one a moment
/// later, should not cost two thorough embeddings.
const REST_TIME: Duration = Duration::from_secs(1);

/// Packets of one graph that wait for the core: some seconds of deltas. As many rosters wait, in between: if
/// the newest took the place of the one before, an instance that is as slow as frames come would always have
/// deltas to apply before it, and never a whole frame.
const FRAME_QUEUE_PACKETS: usize = 64;

/// The fetches of the service.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EmbedderFetch {
    /// Roster and graphs that are missing.
    Frame,
    /// The settings of `clusterer`, which say how many teams there are.
    ClustererSettings,
    /// The division and the wishes, for somebody who asks why a robot is in its team.
    Division,
    /// The embedding of the leader, for a standby.
    Embedding,
}

/// The last job that was started.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum LastJob {
    /// An embedding, or none yet.
    #[default]
    Embedding,
    /// The similarity of pairs: an embedding that is wanted comes next.
    Comparison,
    /// Why robots are in their teams: the same.
    Explanation,
}

/// The service that turns graphs into an embedding.
#[derive(Debug, Default)]
pub struct Embedder {
    follow: Follower,
    /// How many teams `clusterer` divides the fleet into.
    teams: TeamsWanted,
    /// Robots whose superior has changed lately.
    orders: NewOrders,
    /// When the next of their orders will no longer be new.
    orders_old: Option<Tick>,
    /// What the last job has left for the next one; none while one runs, which has it.
    memory: Option<Box<Memory>>,
    flight: SingleFlight<Basis>,
    /// Gets of the similarity of two robots.
    questions: Questions,
    /// Gets that ask why a robot is in its team.
    reasons: ReasonQueue,
    /// The first revision of an embedding with the vectors that the last job has left.
    vectors_since: Option<Revision>,
    last_job: LastJob,
    /// The last one that was no embedding: the two kinds alternate.
    last_side_job: LastJob,
    /// The last good embedding, at first the one of the leader before.
    embedding: Option<Checked<Embedding>>,
    /// What the last embedding showed, as far as it is kept over a restart.
    shape: Shape,
    /// What the embedding rests on, and when it was last published; none for a fetched one.
    published: Option<(Basis, Tick)>,
    /// What the last embedding was computed from, and when.
    computed: Option<(Basis, Tick)>,
    heartbeat: Option<Tick>,
    /// When the fleet will be at rest if nothing changes.
    rest: Option<Tick>,
    /// Whether an embedding was computed by a suspect, so that its output was suppressed.
    was_suppressed: bool,
    /// Which modalities are in doubt.
    doubts: Doubts,
    /// The robots that disagree most with the other modalities, by the last embedding.
    disagreeing: BTreeMap<Modality, Vec<RobotId>>,
}

impl Core for Embedder {
    type Settings = EmbedderSettings;
    type Fetch = EmbedderFetch;
    type Job = Job;
    type Done = Done;
    const SERVICE: ServiceName = ServiceName::Embedder;
    const WITHOUT_KEPT: Option<&'static str> =
        Some("a number of teams may be chosen that is hardly better than the last one");

    fn wiring() -> Wiring {
        let subscription = |pattern, delivery| Subscription { pattern, delivery };
        let settings = Pattern::One(Key::Settings(ServiceName::Clusterer));
        Wiring {
            subscriptions: vec![
                subscription(Pattern::Graphs, Delivery::Queue(FRAME_QUEUE_PACKETS)),
                subscription(Pattern::One(Key::Roster), Delivery::Queue(FRAME_QUEUE_PACKETS)),
                subscription(settings, Delivery::Latest),
            ],
            tokens: Vec::new(),
            served: vec![
                ServedKey::own(Pattern::One(Key::Embedding)),
                ServedKey::own(Pattern::One(Key::Why)),
                ServedKey::cached(Pattern::One(Key::Roster)),
                ServedKey::cached(Pattern::Graphs),
            ],
            fetched: reasons::fetched(),
        }
    }

    fn initial() -> Vec<Pattern> {
        vec![
            Pattern::One(Key::Embedding),
            Pattern::One(Key::Roster),
            Pattern::Graphs,
            Pattern::One(Key::Settings(ServiceName::Clusterer)),
        ]
    }

    fn output() -> Key {
        Key::Embedding
    }

    fn is_output(message: &Message) -> bool {
        matches!(message, Message::Embedding(_))
    }

    fn new(_now: Tick, _settings: &EmbedderSettings) -> Self {
        Self::default()
    }

    fn on_inquiry(&mut self, context: &mut Context<'_>) {
        self.follow.fetch_begun(context.now());
        self.teams.asked(context.now());
    }

    fn on_lead(&mut self, context: &mut Context<'_>, answers: Vec<Message>) {
        let newest = newest_embedding(&answers);
        if let Some(newest) = &newest {
            self.shape.note(context.now(), newest);
        }
        self.shape.lead();
        self.accept_answers(context, answers);
        self.embedding = newest;
    }

    fn on_follow(&mut self, context: &mut Context<'_>, answers: Vec<Message>) {
        self.note_shape(context, &answers);
        self.accept_answers(context, answers);
    }

    fn on_stand_down(&mut self, context: &mut Context<'_>) {
        self.questions.refuse("another instance has taken over; ask again", context);
        self.reasons.refuse("another instance has taken over; ask again", true, context);
        self.shape.stand_down();
        *self = Self { shape: std::mem::take(&mut self.shape), ..Self::default() };
    }

    fn on_new_term(&mut self, context: &mut Context<'_>, _found: Vec<Message>) {
        self.republish(context);
    }

    /// If all answers to the inquiry were lost, a reader may still hold an embedding of the leader before:
    /// robots that have left since must not stay in it.
    fn on_term_sound(&mut self, _context: &mut Context<'_>, found: Vec<Message>) {
        if self.embedding.is_none() {
            self.embedding = newest_embedding(&found);
        }
    }

    fn on_message(&mut self, context: &mut Context<'_>, message: Message) {
        if self.accept(context, message) == Some(Acceptance::Old) {
            context.count("messages_old");
        }
    }

    fn on_answers(
        &mut self,
        context: &mut Context<'_>,
        fetch: EmbedderFetch,
        answers: Vec<Message>,
    ) {
        match fetch {
            EmbedderFetch::Frame => self.accept_answers(context, answers),
            EmbedderFetch::ClustererSettings => self.settings_answered(context, &answers),
            EmbedderFetch::Division => self.reasons.fetched(context, &answers),
            EmbedderFetch::Embedding => self.note_shape(context, &answers),
        }
    }

    fn on_job(&mut self, context: &mut Context<'_>, end: JobEnd<Done>) {
        let end = match end {
            JobEnd::Finished(Done { memory, result }) => {
                self.memory = Some(memory);
                match result {
                    Outcome::Compared(answers) => {
                        return self.questions.answered(answers, context);
                    }
                    Outcome::Explained(answers) => {
                        return self.reasons.answered(answers, context);
                    }
                    Outcome::Embedded { frame, basis, result } => {
                        JobEnd::Finished(result.map(|computed| (frame, basis, computed)))
                    }
                }
            }
            JobEnd::Panicked(_) if self.last_job == LastJob::Comparison => {
                context.count("comparisons_failed");
                self.flight.side_job_panicked(context.now());
                return self.questions.refuse("the comparison has failed", context);
            }
            JobEnd::Panicked(_) if self.last_job == LastJob::Explanation => {
                context.count("explanations_failed");
                self.flight.side_job_panicked(context.now());
                return self.reasons.refuse("the explanation has failed", false, context);
            }
            JobEnd::Panicked(reason) => JobEnd::Panicked(reason),
        };
        let result = self.flight.ended(context, MethodError::kind, end);
        if let Some((frame, basis, computed)) = result {
            self.accept_embedding(context, frame, *basis, *computed);
        }
    }

    fn on_restored(&mut self, content: &[u8]) -> Result<(), String> {
        self.shape.restore(content)
    }

    fn on_kept(&mut self, context: &mut Context<'_>, is_on_disk: bool) {
        self.shape.write_ended(context.now(), is_on_disk);
    }

    fn on_get(&mut self, context: &mut Context<'_>, get: Get) {
        // A get of everything asks for no reason.
        if get.request.exact_key(context.space()) == Some(Key::Why) && context.is_leading() {
            return self.reasons.accept(get, context);
        }
        let of_embedding = get.request.selects(context.space(), &Key::Embedding);
        match get.request.katz.clone() {
            // An instance that does not lead leaves the answer to the leader.
            Some(pair) if of_embedding && context.is_leading() => {
                self.questions.accept(get, pair, context);
            }
            _ => {
                let answer = self.answer(context, &get.request);
                context.reply(get, answer);
            }
        }
    }

    fn on_connectivity(&mut self, context: &mut Context<'_>, connectivity: Connectivity) {
        if connectivity == Connectivity::Online {
            self.follow.refresh();
            if self.was_suppressed {
                self.republish(context);
            }
        }
    }

    /// A decay that is a number must be below 1/ρ of the fleet as it is, or every frame would fail. ρ of other
    /// weights or another scaling of the graphs is known only once a frame is embedded with them.
    fn check_settings(
        &self,
        _view: &View<'_>,
        settings: &EmbedderSettings,
    ) -> Result<(), SettingsError> {
        let (Alpha::Value(alpha), Some((basis, _)), Some(embedding)) =
            (settings.alpha, &self.computed, &self.embedding)
        else {
            return Ok(());
        };
        let radius = embedding.quality.spectral_radius.1;
        if alpha * radius < 1.0 || !has_same_graphs(&basis.settings, settings) {
            return Ok(());
        }
        let limit = radius.recip();
        Err(SettingsError::new(
            "alpha",
            format!(
                "{alpha} must be less than 1/ρ = {limit:.4} of the present fleet; set it below, or as a \
                 part of 1/ρ, which follows the fleet: alpha={{\"fraction\":0.5}}"
            ),
        ))
    }

    /// Does what has become due, whatever happened.
    fn after_input(&mut self, context: &mut Context<'_>) {
        let now = context.now();
        let roster = self.follow.frame().map(|frame| frame.roster.clone());
        if self.follow.make_frame(now) {
            context.count("frames_consistent");
            if let Some(frame) = self.follow.frame() {
                self.orders.follow(now, roster.as_deref(), &frame.roster);
            }
        }
        // A standby holds the graphs as well: it answers for an ingest that is gone.
        if follows(&context.view())
            && let Some((mut patterns, within)) = self.follow.fetch(now)
        {
            if patterns.contains(&Pattern::Graphs) {
                // Whoever has missed graphs has missed settings as well.
                patterns.push(Pattern::One(Key::Settings(ServiceName::Clusterer)));
            }
            context.count("fetches");
            context.fetch_within(EmbedderFetch::Frame, patterns, within);
        }
        if context.replica_state() == ReplicaState::Standby && self.shape.ask_due() <= now {
            self.shape.asked(now);
            context.fetch(EmbedderFetch::Embedding, vec![Pattern::One(Key::Embedding)]);
        }
        if let Some(content) = self.shape.write(now) {
            context.keep(content);
        }
        if !context.is_leading() {
            return;
        }
        if self.teams.due() <= now {
            self.teams.asked(now);
            let patterns = vec![Pattern::One(Key::Settings(ServiceName::Clusterer))];
            context.fetch(EmbedderFetch::ClustererSettings, patterns);
        }
        (self.heartbeat, self.rest) = (None, None);
        self.orders_old = self.orders.due(now);
        let next = self.wanted().cloned().map(|frame| (self.basis(context, &frame), frame));
        if let Some((basis, frame)) = &next {
            self.republish_when_due(context, frame, basis);
        }
        let Some(slot) = context.free_job_slot() else { return };
        let next = next.filter(|(basis, _)| self.flight.should_start(now, basis));
        // Comparisons and explanations alternate with embeddings, however many gets wait.
        let asked = self.questions.wait() || self.reasons.is_ready();
        match next {
            Some((basis, frame)) if self.last_job != LastJob::Embedding || !asked => {
                self.start(context, slot, frame, basis);
            }
            _ if asked => {
                let was_compared = self.last_side_job == LastJob::Comparison;
                if self.reasons.is_ready() && (was_compared || !self.questions.wait()) {
                    self.explain(context, slot);
                } else {
                    self.compare(context, slot);
                }
            }
            _ => {}
        }
    }

    fn deadline(&self, view: &View<'_>) -> Option<Tick> {
        let follow = self.follow.fetch_due().filter(|_| follows(view));
        let write = self.shape.write_due();
        if !view.is_leading() {
            let is_standby = view.replica_state() == ReplicaState::Standby;
            let ask = is_standby.then(|| self.shape.ask_due());
            return [follow, write, ask].into_iter().flatten().min();
        }
        let retry = self.flight.retry_at().filter(|_| !view.is_job_running());
        let retry = retry.filter(|_| self.wanted().is_some());
        let due = [follow, write, Some(self.teams.due()), retry, self.heartbeat];
        let due = due.into_iter().chain([self.rest, self.orders_old]);
        due.flatten().min()
    }

    /// What the service is doing, in a few words.
    fn state(&self, view: &View<'_>) -> String {
        let fault = |text: String| match self.flight.failure() {
            Some(reason) => format!("{text}; the newest frame failed: {reason}"),
            None => text,
        };
        if !view.is_leading() {
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

    fn memory_use(&self) -> MemoryUse {
        let mut held = self.follow.memory_use();
        held.messages += usize::from(self.embedding.is_some());
        held
    }

    fn run(job: Job, stopwatch: &mut Stopwatch) -> Done {
        run(job, stopwatch)
    }
}

/// Whether two settings fuse the same graphs in the same way, so that ρ is the same.
fn has_same_graphs(left: &EmbedderSettings, right: &EmbedderSettings) -> bool {
    left.weights == right.weights
        && left.reciprocity == right.reciprocity
        && left.normalize == right.normalize
        && left.self_loops == right.self_loops
        && left.trusted == right.trusted
}

/// The newest embedding among messages.
fn newest_embedding(messages: &[Message]) -> Option<Checked<Embedding>> {
    let embeddings = messages.iter().filter_map(|message| match message {
        Message::Embedding(embedding) => Some(embedding),
        _ => None,
    });
    embeddings.max_by_key(|embedding| embedding.header.revision).cloned()
}

/// Whether the graphs are to be followed: the inquiry has asked for them.
fn follows(view: &View<'_>) -> bool {
    matches!(view.replica_state(), ReplicaState::Leading | ReplicaState::Standby)
}

impl Embedder {
    /// Starts the job that answers the questions, if there is an embedding to answer them by.
    fn compare(&mut self, context: &mut Context<'_>, slot: FreeJobSlot) {
        let (Some(embedding), Some(memory)) = (&self.embedding, self.memory.take()) else {
            self.questions.refuse(&PairError::NoEmbedding.to_string(), context);
            return;
        };
        let task = Task::Compare(self.questions.ask(embedding.header.clone()));
        context.count("comparisons_started");
        self.last_job = LastJob::Comparison;
        self.last_side_job = LastJob::Comparison;
        context.start_job(slot, Job { task, memory });
    }

    /// Starts the job that says why robots are in their teams, if there is an embedding to say it by.
    fn explain(&mut self, context: &mut Context<'_>, slot: FreeJobSlot) {
        let known = self.embedding.clone().zip(self.vectors_since);
        let task = known.and_then(|(embedding, since)| self.reasons.ask(embedding, since));
        // What was computed stays where there is nothing to answer by.
        let task = task.and_then(|task| Some((task, self.memory.take()?)));
        let Some((task, memory)) = task else {
            return self.reasons.refuse(NO_EMBEDDING, false, context);
        };
        context.count("explanations_started");
        self.last_job = LastJob::Explanation;
        self.last_side_job = LastJob::Explanation;
        let task = Task::Explain(Box::new(task));
        context.start_job(slot, Job { task, memory });
    }

    /// Notes what the leader has published, for the time when this instance leads.
    fn note_shape(&mut self, context: &Context<'_>, found: &[Message]) {
        self.shape.asked(context.now());
        if let Some(embedding) = newest_embedding(found) {
            self.shape.note(context.now(), &embedding);
        }
    }

    /// The newest frame, if it is to have an embedding. That of an empty fleet is published only where there was one
    /// before: robots that have left must not stay in a division. The one before may be without robots as well: an
    /// instance that was cut off answers with it, and no reader has received it.
    fn wanted(&self) -> Option<&Arc<Frame>> {
        let was_published = self.published.is_some() || self.embedding.is_some();
        self.follow.frame().filter(|frame| was_published || !frame.robots.is_empty())
    }

    /// The basis of the embedding of a frame; notes when the fleet will be at rest.
    fn basis(&mut self, context: &Context<'_>, frame: &Frame) -> Basis {
        let settings = context.settings().clone();
        let teams = self.teams.teams();
        let is_needed = settings.dimension == Dimension::Auto || teams.fixed().is_none();
        let graphs = frame.graphs.iter().map(|(name, graph)| (name.clone(), graph.revision()));
        let mut basis = Basis {
            robots: frame.robots.clone(),
            graphs: graphs.collect(),
            teams: is_needed.then_some(teams),
            settings,
            new_orders: self.orders.changed(context.now()).cloned().collect(),
            at_rest: false,
        };
        if let Some((computed, since)) = &self.computed
            && computed.is_of(&basis)
        {
            let due = since.after(REST_TIME);
            basis.at_rest = computed.at_rest || due <= context.now();
            self.rest = (!basis.at_rest).then_some(due);
        }
        basis
    }

    fn start(
        &mut self,
        context: &mut Context<'_>,
        slot: FreeJobSlot,
        frame: Arc<Frame>,
        basis: Basis,
    ) {
        context.count("jobs_started");
        self.last_job = LastJob::Embedding;
        self.flight.started(basis.clone());
        let has_robots = !frame.robots.is_empty();
        let shape = has_robots.then(|| self.shape.goes_on_from(context.now(), &frame.robots));
        let shape = shape.flatten();
        let previous = self.embedding.clone();
        let memory = self.memory.take().unwrap_or_default();
        let basis = Box::new(basis);
        context
            .start_job(slot, Job { task: Task::Embed { frame, basis, previous, shape }, memory });
    }

    /// The own output, and what was last received of `ingest`.
    fn answer(&self, context: &Context<'_>, request: &Request) -> Vec<Message> {
        let space = context.space();
        let own = self.embedding.iter().cloned().map(Message::Embedding);
        let own = own.filter(|_| request.selects(space, &Key::Embedding));
        own.chain(self.follow.answer(space, request)).collect()
    }
}
