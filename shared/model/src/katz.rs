//! The Katz similarity of two robots, and which relations it comes over.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::content::{Content, ContentError, refuse};
use crate::header::Header;
use crate::id::{Modality, RobotId};

/// How the similarity of a pair was come by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PairMethod {
    /// Read off the similarity of all pairs, which is kept and brought up to date.
    Cached,
    /// Summed walk by walk, for fleets whose similarity of all pairs is not kept.
    Column,
}

/// S_ij of two robots: the weight of all walks from one to the other, each step damped by α.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairSimilarity {
    /// The head of the embedding that rests on the same graphs.
    pub header: Header,
    /// Where the walks begin.
    pub from: RobotId,
    /// Where they end.
    pub to: RobotId,
    /// S_ij.
    pub similarity: f64,
    /// The weight of those walks whose first step is of each modality; they sum to S_ij.
    pub shares: Vec<(Modality, f64)>,
    /// The decay α.
    pub alpha: f64,
    /// How it was come by.
    pub method: PairMethod,
    /// How exact it is. Cached: ‖M (S + I) z − z‖ / ‖z‖ for a random sign vector z, M = I − α A*.
    /// Column: at most so much is missing of S_ij.
    pub residual: f64,
}

impl Content for PairSimilarity {
    /// No number is negative or missing.
    fn check(&self) -> Result<(), ContentError> {
        let is_wrong = |number: f64| number.is_nan() || number < 0.0;
        for (field, number) in
            [("similarity", self.similarity), ("alpha", self.alpha), ("residual", self.residual)]
        {
            if is_wrong(number) {
                return refuse(field, "must not be negative");
            }
        }
        if self.shares.iter().any(|(_, share)| is_wrong(*share)) {
            return refuse("shares", "must not be negative");
        }
        Ok(())
    }
}
