//! When a proposal is computed, and how gets are answered.

use std::sync::Arc;

use muster_division::identity::is_believable;
use muster_division::memory::Memory;
use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::id::ServiceName;
use muster_model::proposal::ProposedDivision;
use muster_model::role::ReplicaState;
use muster_model::settings::{PlannerSettings, Settings, SettingsError, from_value};
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_service::following::{Acceptance, Follower};
use muster_service::{
    Connectivity, Core, Delivery, Get, JobEnd, MemoryUse, Newest, Recency, ServedKey, Stopwatch,
    Subscription, Wiring,
};
use muster_wire::command::STARTING;
use muster_wire::json::Problem;
use muster_wire::proposal::{ProposalChange, decode_request};
use muster_wire::{Key, Message, Pattern};

use crate::compute::{Basis, Job, propose};
use crate::proposals::{Asking, Name, Proposals, problem};

type Context<'a> = muster_service::Context<'a, Planner>;
type View<'a> = muster_service::View<'a, Planner>;

/// Packets of one graph that wait for the core, as in the embedder.
const FRAME_QUEUE_PACKETS: usize = 64;

/// The fetches of the service.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlannerFetch {
    /// Roster and graphs that are missing.
    Frame,
    /// The settings and wishes for the next proposal.
    Asked,
    /// What was missed while the link was lost.
    Missed,
}

/// Says what the teams would be.
#[derive(Debug, Default)]
pub struct Planner {
    follow: Follower,
    /// The live vectors.
    embedding: Option<Checked<Embedding>>,
    /// The live division.
    teams: Option<Checked<Teams>>,
    newest_roster: Newest,
    newest_embedding: Newest,
    newest_teams: Newest,
    proposals: Proposals,
    /// Whether settings and wishes are being fetched.
    is_fetching: bool,
    /// The proposal that is being computed.
    running: Option<Name>,
}

/// What is fetched when a proposal is to be computed. A leader that is asked knows what was changed a moment ago.
fn fetched() -> Vec<Pattern> {
    let settings = |service| Pattern::One(Key::Settings(service));
    vec![
        settings(ServiceName::Clusterer),
        settings(ServiceName::Embedder),
        Pattern::One(Key::Wishes),
    ]
}

fn refusal<T>(problem: impl AsRef<str>) -> Result<T, SettingsError> {
    Err(SettingsError::new("(proposal)", problem))
}

/// The newest settings of a service among answers.
fn settings_of<S: Settings>(service: ServiceName, answers: &[Message]) -> Result<S, SettingsError> {
    let announced = answers.iter().filter_map(|message| match message {
        Message::Settings(announced) if announced.service == service => Some(announced),
        _ => None,
    });
    let newest = announced.max_by_key(|announced| announced.header.revision);
    let settings = newest.and_then(|announced| {
        let value = serde_json::from_str(&announced.settings).ok()?;
        from_value(value).ok()
    });
    settings.map_or_else(
        || refusal(format!("{service} has not answered with its settings; see muster status")),
        Ok,
    )
}

impl Planner {
    fn accept(&mut self, context: &mut Context<'_>, message: Message) -> Option<Acceptance> {
        let (key, _) = message.keys();
        let accepted = match message {
            Message::Graph(delta) => {
                self.follow.accept_graph(&delta).map_err(|error| error.to_string())
            }
            Message::Roster(roster) => {
                let revision = roster.header.revision;
                if self.newest_roster.receive(context.now(), revision) == Recency::Restarted {
                    self.follow = Follower::default();
                }
                Ok(self.follow.accept_roster(roster))
            }
            Message::Embedding(embedding) => {
                let revision = embedding.header.revision;
                if self.newest_embedding.receive(context.now(), revision) != Recency::Old {
                    self.embedding = Some(embedding);
                }
                return None;
            }
            Message::Teams { teams, .. } => {
                self.accept_teams(context.now(), teams);
                return None;
            }
            _ => return None,
        };
        if let Err(reason) = &accepted {
            context.refuse(&key, reason);
        }
        accepted.ok()
    }

    /// Accepts a division.
    fn accept_teams(&mut self, now: Tick, teams: Checked<Teams>) {
        if !is_believable(&teams)
            || self.newest_teams.receive(now, teams.header.revision) == Recency::Old
        {
            return;
        }
        self.teams = Some(teams);
    }

    /// Accepts answers: graphs first, since the roster says which belong together.
    fn accept_all(&mut self, context: &mut Context<'_>, messages: Vec<Message>) {
        let (mut rosters, mut old) = (Vec::new(), Vec::new());
        for message in messages {
            match message {
                Message::Roster(_) => rosters.push(message),
                Message::Graph(delta) => {
                    let accepted = self.accept(context, Message::Graph(delta.clone()));
                    if accepted == Some(Acceptance::Old) {
                        old.push(delta);
                    }
                }
                other => {
                    self.accept(context, other);
                }
            }
        }
        for roster in rosters {
            self.accept(context, roster);
        }
        for delta in old {
            self.follow.roll_back(context.now(), &delta);
        }
    }

    /// A get that asks for a proposal or drops it.
    fn change(&mut self, context: &mut Context<'_>, get: Get, name: &Name, payload: &[u8]) {
        let result = match decode_request(payload) {
            Ok(ProposalChange::Drop) => {
                if self.proposals.drop_one(context, name, get) {
                    self.abandon(context);
                }
                return;
            }
            Ok(ProposalChange::Ask(asked)) => self.proposals.ask(context, name, *asked),
            Err(error) => Err(error),
        };
        match result {
            Ok(asking) => {
                if asking != Asking::Known {
                    context.count("proposals_asked");
                }
                if asking == Asking::InPlaceOfRunning {
                    self.abandon(context);
                }
                self.proposals.answer(context, name, get);
            }
            Err(error) => context.reply_error(get, problem(&error)),
        }
    }

    /// Gives up on the running job, whose result is no longer asked for.
    fn abandon(&mut self, context: &mut Context<'_>) {
        self.running = None;
        context.abandon_job();
    }

    /// Fetches what the next proposal needs, if one can be computed.
    fn consider(&mut self, context: &mut Context<'_>) {
        if self.proposals.next().is_some()
            && !self.is_fetching
            && self.running.is_none()
            && context.free_job_slot().is_some()
        {
            self.is_fetching = true;
            context.fetch(PlannerFetch::Asked, fetched());
        }
    }

    /// Starts the next job.
    fn start(&mut self, context: &mut Context<'_>, answers: &[Message]) {
        let Some(slot) = context.free_job_slot() else { return };
        let Some(name) = self.proposals.next().cloned() else { return };
        let basis = match self.basis(context, answers) {
            Ok(basis) => basis,
            Err(error) => return self.proposals.end(context, &name, Err(error)),
        };
        let Some(asked) = self.proposals.begin(&name) else { return };
        context.count("jobs_started");
        self.running = Some(name.clone());
        context.start_job(slot, Job { name, asked, basis });
    }

    /// What a division is made of now.
    fn basis(
        &mut self,
        context: &Context<'_>,
        answers: &[Message],
    ) -> Result<Basis, SettingsError> {
        let now = context.now();
        let (Some(frame), Some(embedding), Some(teams)) =
            (self.follow.frame(), &self.embedding, &self.teams)
        else {
            return refusal("there is no division to begin with yet; see muster status");
        };
        let (robots, most) = (frame.robots.len(), context.settings().max_robots as usize);
        if robots > most {
            return refusal(format!(
                "the fleet has {robots} robots, and max_robots of planner is {most}: raise it with muster set planner"
            ));
        }
        let wishes = answers.iter().filter_map(|message| match message {
            Message::Wishes(list) => Some(list),
            _ => None,
        });
        let wishes = wishes.max_by_key(|list| list.header.revision);
        Ok(Basis {
            now,
            frame: Arc::clone(frame),
            embedding: embedding.clone(),
            teams: teams.clone(),
            memory: Arc::new(Memory::of(&teams.remembered, now)),
            clusterer: settings_of(ServiceName::Clusterer, answers)?,
            embedder: settings_of(ServiceName::Embedder, answers)?,
            wishes: wishes.map(|list| list.wishes.clone()).unwrap_or_default(),
        })
    }
}

impl Core for Planner {
    type Settings = PlannerSettings;
    type Fetch = PlannerFetch;
    type Job = Job;
    type Done = Result<ProposedDivision, SettingsError>;
    const SERVICE: ServiceName = ServiceName::Planner;

    fn wiring() -> Wiring {
        let subscription = |pattern, delivery| Subscription { pattern, delivery };
        let frames = Delivery::Queue(FRAME_QUEUE_PACKETS);
        Wiring {
            subscriptions: vec![
                subscription(Pattern::Graphs, frames),
                subscription(Pattern::One(Key::Roster), frames),
                subscription(Pattern::One(Key::Embedding), Delivery::Latest),
                subscription(Pattern::One(Key::Teams), Delivery::Latest),
            ],
            tokens: vec![],
            fetched: fetched(),
            served: vec![ServedKey::own(Pattern::EachProposal)],
        }
    }

    fn initial() -> Vec<Pattern> {
        let keys = [Key::Roster, Key::Embedding, Key::Teams].map(Pattern::One);
        keys.into_iter().chain([Pattern::Graphs]).collect()
    }

    /// It publishes nothing else that has a place among the outputs of a leader.
    fn output() -> Key {
        Key::Settings(Self::SERVICE)
    }

    fn is_output(message: &Message) -> bool {
        matches!(message, Message::Settings(announced) if announced.service == Self::SERVICE)
    }

    fn new(_: Tick, _: &PlannerSettings) -> Self {
        Self::default()
    }

    fn on_inquiry(&mut self, context: &mut Context<'_>) {
        self.follow.fetch_begun(context.now());
    }

    fn on_lead(&mut self, context: &mut Context<'_>, answers: Vec<Message>) {
        self.accept_all(context, answers);
        self.follow.fetch_ended();
    }

    fn on_follow(&mut self, context: &mut Context<'_>, answers: Vec<Message>) {
        self.accept_all(context, answers);
        self.follow.fetch_ended();
    }

    fn on_stand_down(&mut self, context: &mut Context<'_>) {
        self.proposals.refuse_all(context, "another instance leads now; ask again");
        *self = Self::default();
    }

    fn on_new_term(&mut self, _: &mut Context<'_>, _: Vec<Message>) {}

    fn on_message(&mut self, context: &mut Context<'_>, message: Message) {
        self.accept(context, message);
    }

    fn on_answers(
        &mut self,
        context: &mut Context<'_>,
        fetch: PlannerFetch,
        answers: Vec<Message>,
    ) {
        match fetch {
            PlannerFetch::Frame => {
                self.accept_all(context, answers);
                self.follow.fetch_ended();
            }
            PlannerFetch::Asked => {
                self.is_fetching = false;
                self.start(context, &answers);
            }
            PlannerFetch::Missed => self.accept_all(context, answers),
        }
    }

    fn on_get(&mut self, context: &mut Context<'_>, get: Get) {
        if context.replica_state() == ReplicaState::Standby {
            // The leader answers.
            return context.reply(get, Vec::new());
        }
        let name = match get.request.exact_key(context.space()) {
            Some(Key::Proposal(operator, id)) => Some(Name { operator, id }),
            _ => None,
        };
        match (name, get.request.payload.clone()) {
            (Some(_), _) if !context.has_term() => {
                let problem = Problem::unavailable("(proposal)", STARTING);
                context.reply_error(get, problem.to_json());
            }
            (Some(name), Some(payload)) if get.request.is_exact() => {
                self.change(context, get, &name, &payload);
            }
            (_, Some(_)) => {
                let text = "a payload belongs on exactly one key propose/{operator}/{id}";
                context.reply_error(get, problem(&SettingsError::new("(key)", text)));
            }
            (Some(name), None) => self.proposals.answer(context, &name, get),
            (None, None) => {
                let selected = self.proposals.select(context, &get.request);
                context.reply(get, selected);
            }
        }
    }

    fn on_connectivity(&mut self, context: &mut Context<'_>, connectivity: Connectivity) {
        if connectivity == Connectivity::Online {
            self.follow.refresh();
            let patterns = [Key::Embedding, Key::Teams].map(Pattern::One);
            context.fetch(PlannerFetch::Missed, patterns.to_vec());
        }
    }

    fn on_job(&mut self, context: &mut Context<'_>, end: JobEnd<Self::Done>) {
        let Some(name) = self.running.take() else { return };
        let result = match end {
            JobEnd::Finished(result) => {
                context.report_job_success();
                result
            }
            JobEnd::Panicked(reason) => {
                context.report_job_failure("proposal", &reason);
                refusal("it could not be computed; see the log of planner")
            }
        };
        self.proposals.end(context, &name, result);
    }

    fn after_input(&mut self, context: &mut Context<'_>) {
        let now = context.now();
        if self.follow.make_frame(now) {
            context.count("frames_consistent");
        }
        if follows(&context.view())
            && let Some((patterns, within)) = self.follow.fetch(now)
        {
            context.count("fetches");
            context.fetch_within(PlannerFetch::Frame, patterns, within);
        }
        if self.proposals.due().is_some_and(|due| due <= now) {
            self.proposals.expire(context);
        }
        self.consider(context);
    }

    fn deadline(&self, view: &View<'_>) -> Option<Tick> {
        let follow = self.follow.fetch_due().filter(|_| follows(view));
        [follow, self.proposals.due()].into_iter().flatten().min()
    }

    fn state(&self, _: &View<'_>) -> String {
        let count = self.proposals.len();
        let noun = if count == 1 { "proposal" } else { "proposals" };
        match (&self.running, &self.teams) {
            (Some(name), _) => {
                format!("{count} {noun}, computing {}/{}", name.operator, name.id)
            }
            (None, None) => "waiting for a division".to_owned(),
            (None, Some(_)) if count == 0 => "no proposals".to_owned(),
            (None, Some(_)) => format!("{count} {noun}"),
        }
    }

    fn memory_use(&self) -> MemoryUse {
        let followed = self.follow.memory_use();
        let single = usize::from(self.embedding.is_some()) + usize::from(self.teams.is_some());
        MemoryUse {
            robots: followed.robots,
            messages: followed.messages + single + self.proposals.len() + self.proposals.waiting(),
            ..followed
        }
    }

    fn run(job: Job, _: &mut Stopwatch) -> Self::Done {
        propose(&job)
    }
}

/// Whether the graphs are to be followed: the inquiry has asked for them.
fn follows(view: &View<'_>) -> bool {
    matches!(view.replica_state(), ReplicaState::Leading | ReplicaState::Standby)
}
