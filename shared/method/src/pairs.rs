//! The Katz similarity of two robots, and the share of each modality in it.

use muster_model::id::{Modality, RobotId};
use muster_model::katz::PairMethod;
use muster_numeric::katz::KatzError;
use muster_numeric::katz_column::katz_column;
use muster_numeric::matrix::SparseMatrix;

use crate::embedding::{Frames, LastGraph};

/// Fleets of up to so many robots keep the similarity of all pairs for further questions: 8 MiB, and well
/// below a tenth of a second for the first one.
const MAX_KEPT_ROBOTS: usize = 1024;

/// S_ij of two robots.
#[derive(Debug, Clone, PartialEq)]
pub struct Pair {
    /// S_ij.
    pub similarity: f64,
    /// The weight of those walks whose first step to another robot is of each modality.
    pub shares: Vec<(Modality, f64)>,
    /// The decay α.
    pub alpha: f64,
    /// How it was computed.
    pub method: PairMethod,
    /// How exact it is; see [`muster_model::katz::PairSimilarity::residual`].
    pub residual: f64,
}

/// Why two robots cannot be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PairError {
    /// There was no embedding yet.
    #[error("there is no embedding to compare robots by yet; ask again once there is one")]
    NoEmbedding,
    /// The embedding does not have the robot.
    #[error("{0} is no robot of the embedding")]
    Robot(RobotId),
    /// The similarity cannot be computed.
    #[error("the similarity cannot be computed: {0}")]
    Katz(#[from] KatzError),
}

impl Frames {
    /// The similarity of each pair of robots by the graphs of the last embedding.
    pub fn compare(&mut self, pairs: &[[RobotId; 2]]) -> Vec<Result<Pair, PairError>> {
        // By a single column, the residual is a multiple of the centrality.
        if let Err(error) = self.centralities() {
            let error = PairError::Katz(match error {
                crate::MethodError::Katz(error) => error,
                _ => KatzError::Overflow { alpha: f64::NAN },
            });
            return pairs.iter().map(|_| Err(error.clone())).collect();
        }
        let Some(last) = &self.last else {
            return pairs.iter().map(|_| Err(PairError::NoEmbedding)).collect();
        };
        let probe = (last.fused.nodes() <= MAX_KEPT_ROBOTS)
            .then(|| self.similarity.update(&last.fused, &last.decay, &self.robots).ok())
            .flatten()
            .map(|update| update.probe);
        let find = |names: &[RobotId; 2]| {
            let places = self.places(names)?;
            match probe {
                Some(probe) => self.by_similarity(last, places, probe),
                None => self.by_column(last, places),
            }
        };
        pairs.iter().map(find).collect()
    }

    /// The places of two robots in the list.
    fn places(&self, names: &[RobotId; 2]) -> Result<[usize; 2], PairError> {
        let place = |name: &RobotId| {
            self.robots.binary_search(name).map_err(|_| PairError::Robot(name.clone()))
        };
        Ok([place(&names[0])?, place(&names[1])?])
    }

    fn by_similarity(
        &self,
        last: &LastGraph,
        pair: [usize; 2],
        probe: f64,
    ) -> Result<Pair, PairError> {
        let parts =
            self.fusion.parts().map(|(name, matrix, weight)| (name.clone(), (matrix, weight)));
        let (names, parts): (Vec<_>, Vec<_>) = parts.unzip();
        let found = self.similarity.pair(pair, &parts);
        let (similarity, shares) = found.ok_or(PairError::NoEmbedding)?;
        let staying = self.staying(last.decay.alpha);
        let shares = shares.into_iter().map(|share| staying * share);
        Ok(Pair {
            similarity,
            shares: names.into_iter().zip(shares).collect(),
            alpha: last.decay.alpha,
            method: PairMethod::Cached,
            residual: probe,
        })
    }

    /// The weight of all walks that stay at a robot by its self-loop before they leave, with that of leaving at
    /// once: Σ (αβ)ˡ. The loop is no modality; walks that begin with it count for that of the step after.
    fn staying(&self, alpha: f64) -> f64 {
        (1.0 - alpha * self.fusion.self_loops()).recip()
    }

    fn by_column(&self, last: &LastGraph, [from, to]: [usize; 2]) -> Result<Pair, PairError> {
        let alpha = last.decay.alpha;
        let column = katz_column(&last.fused, alpha, last.decay.radius.upper, to)?;
        let centrality = last.centralities.as_ref().and_then(|all| all.get(from).copied());
        let staying = self.staying(alpha);
        // S = αA (I + S): a first step, and then nothing or another walk.
        let onward = |k: usize| column.values[k] + f64::from(u8::from(k == to));
        let share = |(name, matrix, weight): (&Modality, &SparseMatrix, f64)| {
            let steps = matrix.row(from).map(|(k, w)| w * onward(k));
            (name.clone(), staying * alpha * weight * steps.sum::<f64>())
        };
        Ok(Pair {
            similarity: column.values[from],
            shares: self.fusion.parts().map(share).collect(),
            alpha,
            method: PairMethod::Column,
            residual: column.remainder * centrality.unwrap_or(f64::INFINITY),
        })
    }
}
