//! Gets of the Katz similarity of two robots: which wait, and how they are answered.

use std::sync::Arc;

use muster_machine::{Effect, Effects, QueryId};
use muster_model::header::Header;
use muster_model::id::{Modality, RobotId};
use muster_model::katz::{PairMethod, PairSimilarity};
use muster_numeric::katz_column::katz_column;
use muster_numeric::matrix::SparseMatrix;
use muster_wire::json::Problem;
use muster_wire::{Message, Request};

use crate::compute::Job;
use crate::decay::Chosen;
use crate::fusion::Fusion;
use crate::similarity::Similarity;

/// Most gets that wait for their answers: a dashboard that asks for all pairs of a dozen robots at once
/// is served, and no flood of gets takes memory.
const MAX_WAITING: usize = 256;

/// Most gets that one job answers: in a large fleet each may take a second, and embeddings wait
/// meanwhile.
const AT_ONCE: usize = 16;

/// Fleets up to this size keep the similarity of all pairs for further questions: 8 MiB, and well below a
/// tenth of a second for the first one.
const MAX_KEPT: usize = 1024;

/// What is answered before the first embedding.
pub(crate) const NOTHING_TO_COMPARE: &str =
    "there is no embedding to compare robots by yet; ask again once there is one";

/// A* of the last embedding.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fused<'a> {
    pub(crate) matrix: &'a SparseMatrix,
    pub(crate) chosen: &'a Chosen,
    pub(crate) robots: &'a Arc<[RobotId]>,
}

/// The answer to one question, without the names and the head.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Compared {
    similarity: f64,
    shares: Vec<(Modality, f64)>,
    alpha: f64,
    method: PairMethod,
    residual: f64,
}

/// The similarity of each pair, or why there is none.
pub(crate) fn compare(
    fused: Fused<'_>,
    fusion: &Fusion,
    similarity: &mut Similarity,
    pairs: &[[RobotId; 2]],
) -> Vec<Result<Compared, String>> {
    let kept = (fused.matrix.nodes() <= MAX_KEPT)
        .then(|| similarity.update(fused.matrix, fused.chosen, fused.robots).ok())
        .flatten();
    let answer = |names: &[RobotId; 2]| {
        let [from, to] = places(fused.robots, names)?;
        match &kept {
            Some(update) => by_similarity(fused, fusion, similarity, [from, to], update.probe),
            None => by_column(fused, fusion, [from, to]),
        }
    };
    pairs.iter().map(answer).collect()
}

/// Where two robots stand in the list.
fn places(robots: &[RobotId], names: &[RobotId; 2]) -> Result<[usize; 2], String> {
    let place = |name: &RobotId| {
        robots.binary_search(name).map_err(|_| format!("{name} is no robot of the embedding"))
    };
    Ok([place(&names[0])?, place(&names[1])?])
}

fn by_similarity(
    fused: Fused<'_>,
    fusion: &Fusion,
    similarity: &Similarity,
    pair: [usize; 2],
    probe: f64,
) -> Result<Compared, String> {
    let (names, parts): (Vec<_>, Vec<_>) =
        fusion.parts().map(|(name, matrix, weight)| (name.clone(), (matrix, weight))).unzip();
    let (value, shares) =
        similarity.pair(pair, &parts).ok_or_else(|| NOTHING_TO_COMPARE.to_owned())?;
    Ok(Compared {
        similarity: value,
        shares: names.into_iter().zip(shares).collect(),
        alpha: fused.chosen.alpha,
        method: PairMethod::Cached,
        residual: probe,
    })
}

fn by_column(
    fused: Fused<'_>,
    fusion: &Fusion,
    [from, to]: [usize; 2],
) -> Result<Compared, String> {
    let Chosen { alpha, radius, centrality } = fused.chosen;
    let column = katz_column(fused.matrix, *alpha, radius.upper, to)
        .map_err(|error| format!("the similarity cannot be computed: {error}"))?;
    // S = αA (I + S): a first step, and then nothing or another walk.
    let onward = |k: usize| column.values[k] + f64::from(u8::from(k == to));
    let share = |(name, matrix, weight): (&Modality, &SparseMatrix, f64)| {
        let steps = matrix.row(from).map(|(k, w)| w * onward(k));
        (name.clone(), alpha * weight * steps.sum::<f64>())
    };
    Ok(Compared {
        similarity: column.values[from],
        shares: fusion.parts().map(share).collect(),
        alpha: *alpha,
        method: PairMethod::Column,
        residual: column.remainder * centrality[from],
    })
}

/// The gets that wait.
#[derive(Debug, Default)]
pub(crate) struct Questions {
    waiting: Vec<Question>,
    /// Those that the running job answers, with the head of their answers.
    asked: Vec<Question>,
    head: Option<Header>,
}

#[derive(Debug)]
struct Question {
    query: QueryId,
    request: Request,
    pair: [RobotId; 2],
}

impl Question {
    fn answer(self, answer: Result<Vec<Message>, String>, effects: &mut Effects<Job>) {
        let answer = answer.map_err(|problem| Problem::new("katz", &problem).to_json());
        effects.push(Effect::Reply { query: self.query, request: self.request, answer });
    }
}

impl Questions {
    /// Whether any waits for a job.
    pub(crate) fn wait(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Takes a get in.
    pub(crate) fn take(
        &mut self,
        query: QueryId,
        request: Request,
        pair: [RobotId; 2],
        effects: &mut Effects<Job>,
    ) {
        let question = Question { query, request, pair };
        if self.waiting.len() < MAX_WAITING {
            self.waiting.push(question);
        } else {
            let problem = format!("{MAX_WAITING} questions wait already; ask again later");
            question.answer(Err(problem), effects);
        }
    }

    /// The pairs that the next job is to compare, by the embedding with the head; those that asked first.
    pub(crate) fn ask(&mut self, head: Header) -> Vec<[RobotId; 2]> {
        self.head = Some(head);
        let count = self.waiting.len().min(AT_ONCE);
        self.asked = self.waiting.drain(..count).collect();
        self.asked.iter().map(|question| question.pair.clone()).collect()
    }

    /// Answers what was asked.
    pub(crate) fn answered(
        &mut self,
        answers: Vec<Result<Compared, String>>,
        effects: &mut Effects<Job>,
    ) {
        let Some(header) = self.head.take() else { return };
        for (question, compared) in std::mem::take(&mut self.asked).into_iter().zip(answers) {
            let [from, to] = question.pair.clone();
            let answer = compared.map(|compared| {
                let Compared { similarity, shares, alpha, method, residual } = compared;
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
            question.answer(answer, effects);
        }
    }

    /// Answers everything that waits with a reason why it cannot be told.
    pub(crate) fn refuse(&mut self, reason: &str, effects: &mut Effects<Job>) {
        self.head = None;
        let waiting = std::mem::take(&mut self.waiting);
        for question in std::mem::take(&mut self.asked).into_iter().chain(waiting) {
            question.answer(Err(reason.to_owned()), effects);
        }
    }
}
