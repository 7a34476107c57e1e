//! Gets of the Katz similarity of two robots: a bounded queue, and the answers.

use muster_method::pairs::{Pair, PairError};
use muster_model::header::Header;
use muster_model::id::RobotId;
use muster_model::katz::PairSimilarity;
use muster_service::{Context, Get};
use muster_wire::Message;
use muster_wire::json::Problem;

use crate::Embedder;

/// Most gets that wait for their answers: a dashboard that asks for all pairs of a dozen robots at once
/// is served, and no flood of gets takes memory.
const MAX_WAITING_GETS: usize = 256;

/// Most gets that one job answers: in a large fleet each may take a second, and embeddings wait
/// meanwhile.
const GETS_PER_JOB: usize = 16;

/// The gets that wait.
#[derive(Debug, Default)]
pub(crate) struct Questions {
    waiting: Vec<Question>,
    /// Those that the running job answers, with the header of their answers.
    asked: Vec<Question>,
    head: Option<Header>,
}

#[derive(Debug)]
struct Question {
    get: Get,
    pair: [RobotId; 2],
}

impl Question {
    fn answer(self, answer: Result<Vec<Message>, PairError>, context: &mut Context<'_, Embedder>) {
        match answer {
            Ok(messages) => context.reply(self.get, messages),
            Err(error @ PairError::NoEmbedding) => self.refuse(&error.to_string(), context),
            Err(error) => {
                context.reply_error(self.get, Problem::new("katz", &error.to_string()).to_json());
            }
        }
    }

    /// Refuses it for a reason that passes.
    fn refuse(self, problem: &str, context: &mut Context<'_, Embedder>) {
        context.reply_error(self.get, Problem::unavailable("katz", problem).to_json());
    }
}

impl Questions {
    /// Whether any get waits for a job.
    pub(crate) fn wait(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Queues a get, or refuses it where too many wait.
    pub(crate) fn accept(
        &mut self,
        get: Get,
        pair: [RobotId; 2],
        context: &mut Context<'_, Embedder>,
    ) {
        let question = Question { get, pair };
        if self.waiting.len() < MAX_WAITING_GETS {
            self.waiting.push(question);
        } else {
            let problem = format!("{MAX_WAITING_GETS} questions wait already; ask again later");
            question.refuse(&problem, context);
        }
    }

    /// The pairs of the next job, by the embedding with the header; the oldest gets first.
    pub(crate) fn ask(&mut self, head: Header) -> Vec<[RobotId; 2]> {
        self.head = Some(head);
        let count = self.waiting.len().min(GETS_PER_JOB);
        self.asked = self.waiting.drain(..count).collect();
        self.asked.iter().map(|question| question.pair.clone()).collect()
    }

    /// Answers what was asked.
    pub(crate) fn answered(
        &mut self,
        answers: Vec<Result<Pair, PairError>>,
        context: &mut Context<'_, Embedder>,
    ) {
        let Some(header) = self.head.take() else { return };
        for (question, compared) in std::mem::take(&mut self.asked).into_iter().zip(answers) {
            let [from, to] = question.pair.clone();
            let answer = compared.map(|pair| {
                let Pair { similarity, shares, alpha, method, residual } = pair;
                let header = header.clone();
                let pair = PairSimilarity {
                    header,
                    from,
                    to,
                    similarity,
                    shares,
                    alpha,
                    method,
                    residual,
                };
                vec![Message::Katz(Box::new(pair))]
            });
            question.answer(answer, context);
        }
    }

    /// Answers every waiting get with the reason why there is no answer.
    pub(crate) fn refuse(&mut self, reason: &str, context: &mut Context<'_, Embedder>) {
        self.head = None;
        let waiting = std::mem::take(&mut self.waiting);
        for question in std::mem::take(&mut self.asked).into_iter().chain(waiting) {
            question.refuse(reason, context);
        }
    }
}
