//! Gets that ask why a robot is in its team: a bounded queue, what is fetched for them, and the answers.
//!
//! The division and the wishes are fetched when somebody asks, so that they cost nothing while nobody does.

mod explain;

use std::sync::Arc;

use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::header::Revision;
use muster_model::id::{RobotId, ServiceName};
use muster_model::settings::{ClustererSettings, from_value};
use muster_model::teams::Teams;
use muster_model::why::Why;
use muster_model::wish::StandingWish;
use muster_service::{Context, Get};
use muster_wire::json::Problem;
use muster_wire::{Key, Message, Pattern};

pub(crate) use explain::{NO_EMBEDDING, Unexplained, explain};

use crate::Embedder;
use crate::core::EmbedderFetch;

/// Most gets that wait for their answers: a console that asks for the robots of a team is served, and no flood of gets
/// takes memory.
const MAX_WAITING_REASONS: usize = 64;

/// Most gets that one job answers, and embeddings wait for: each looks at the edges of the fleet once.
const REASONS_PER_JOB: usize = 4;

/// What reasons need beside the last embedding.
#[derive(Debug)]
pub(crate) struct Material {
    /// The division.
    pub(crate) teams: Checked<Teams>,
    /// All wishes.
    pub(crate) wishes: Vec<StandingWish>,
    /// The settings that divide.
    pub(crate) settings: ClustererSettings,
    /// Whether no service has answered with them, so that they are the defaults.
    pub(crate) settings_assumed: bool,
}

/// What a job is to explain.
#[derive(Debug)]
pub(crate) struct Task {
    pub(crate) robots: Vec<RobotId>,
    pub(crate) material: Arc<Material>,
    pub(crate) embedding: Checked<Embedding>,
    /// The first revision of an embedding with the same vectors.
    pub(crate) since: Revision,
}

/// The gets that wait.
#[derive(Debug, Default)]
pub(crate) struct ReasonQueue {
    /// Those for which the division is fetched.
    waiting: Vec<Question>,
    is_fetching: bool,
    /// Those that a job can answer.
    ready: Vec<Question>,
    material: Option<Arc<Material>>,
    /// Those that the running job answers.
    asked: Vec<Question>,
}

#[derive(Debug)]
struct Question {
    get: Get,
    robot: RobotId,
}

impl Question {
    fn answer(self, answer: Result<Why, Unexplained>, context: &mut Context<'_, Embedder>) {
        match answer {
            Ok(why) => context.reply(self.get, vec![Message::Why(Box::new(why))]),
            Err(Unexplained::NotYet(problem)) => self.refuse(&problem, context),
            Err(Unexplained::Unknown(problem)) => {
                context.reply_error(self.get, Problem::new("robot", &problem).to_json());
            }
        }
    }

    /// Refuses it for a reason that passes.
    fn refuse(self, problem: &str, context: &mut Context<'_, Embedder>) {
        context.reply_error(self.get, Problem::unavailable("robot", problem).to_json());
    }
}

/// What is fetched when somebody asks.
pub(crate) fn fetched() -> Vec<Pattern> {
    let settings = Key::Settings(ServiceName::Clusterer);
    [Key::Teams, Key::Wishes, settings].map(Pattern::One).to_vec()
}

impl ReasonQueue {
    /// Whether a job can answer any get.
    pub(crate) fn is_ready(&self) -> bool {
        !self.ready.is_empty()
    }

    /// Queues a get, or refuses it where too many wait.
    pub(crate) fn accept(&mut self, get: Get, context: &mut Context<'_, Embedder>) {
        let robot = match muster_wire::why::robot(&get.request.parameters) {
            Ok(robot) => robot,
            Err(error) => {
                let problem = Problem::new(&error.field, &error.problem).to_json();
                return context.reply_error(get, problem);
            }
        };
        let question = Question { get, robot };
        if self.waiting.len() + self.ready.len() >= MAX_WAITING_REASONS {
            let problem = format!("{MAX_WAITING_REASONS} questions wait already; ask again later");
            return question.refuse(&problem, context);
        }
        self.waiting.push(question);
        if !std::mem::replace(&mut self.is_fetching, true) {
            context.fetch(EmbedderFetch::Division, fetched());
        }
    }

    /// Accepts what was fetched.
    pub(crate) fn fetched(&mut self, context: &mut Context<'_, Embedder>, answers: &[Message]) {
        self.is_fetching = false;
        let teams = answers.iter().filter_map(|message| match message {
            Message::Teams { teams, .. } => Some(teams),
            _ => None,
        });
        let Some(teams) = teams.max_by_key(|teams| teams.header.revision) else {
            for question in std::mem::take(&mut self.waiting) {
                let problem = "there is no division yet: clusterer has not answered with one; see muster status";
                question.refuse(problem, context);
            }
            return;
        };
        let wishes = answers.iter().filter_map(|message| match message {
            Message::Wishes(list) => Some(list),
            _ => None,
        });
        let wishes = wishes.max_by_key(|list| list.header.revision);
        let settings = answers.iter().filter_map(|message| match message {
            Message::Settings(announced) if announced.service == ServiceName::Clusterer => {
                Some(announced)
            }
            _ => None,
        });
        let settings = settings.max_by_key(|announced| announced.header.revision);
        let settings: Option<ClustererSettings> = settings.and_then(|announced| {
            let value = serde_json::from_str(&announced.settings).ok()?;
            from_value(value).ok()
        });
        self.material = Some(Arc::new(Material {
            teams: teams.clone(),
            wishes: wishes.map(|list| list.wishes.clone()).unwrap_or_default(),
            settings_assumed: settings.is_none(),
            settings: settings.unwrap_or_default(),
        }));
        self.ready.append(&mut self.waiting);
    }

    /// What the next job explains, the oldest gets first; none if nothing is ready.
    pub(crate) fn ask(&mut self, embedding: Checked<Embedding>, since: Revision) -> Option<Task> {
        let material = self.material.clone()?;
        let count = self.ready.len().min(REASONS_PER_JOB);
        self.asked = self.ready.drain(..count).collect();
        let robots = self.asked.iter().map(|question| question.robot.clone()).collect();
        Some(Task { robots, material, embedding, since })
    }

    /// Answers what was asked.
    pub(crate) fn answered(
        &mut self,
        answers: Vec<Result<Why, Unexplained>>,
        context: &mut Context<'_, Embedder>,
    ) {
        for (question, answer) in std::mem::take(&mut self.asked).into_iter().zip(answers) {
            question.answer(answer, context);
        }
        if self.ready.is_empty() {
            self.material = None;
        }
    }

    /// Answers gets with the reason why there is no answer: those that a job was to answer, or `all`.
    pub(crate) fn refuse(&mut self, reason: &str, all: bool, context: &mut Context<'_, Embedder>) {
        let mut refused = std::mem::take(&mut self.asked);
        refused.append(&mut self.ready);
        if all {
            refused.append(&mut self.waiting);
        }
        for question in refused {
            question.refuse(reason, context);
        }
    }
}
