//! The independent judgement of a division.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::header::{Header, Revision};
use crate::id::{RobotId, TeamId};

/// In which space distances were taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Space {
    /// The vectors that the division was made from.
    Embedding,
    /// The positions of the robots in metres.
    Physical,
}

/// Silhouettes (Rousseeuw 1987) of a division in one space: -1 misplaced, 0 on a border, 1 apart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SilhouetteReport {
    /// In which space.
    pub space: Space,
    /// Mean over all scored robots; none with fewer than two teams, where it is not defined.
    pub mean: Option<f64>,
    /// Mean over the members of each team.
    pub per_team: Vec<(TeamId, f64)>,
    /// Each scored robot, ordered by name.
    pub per_robot: Vec<(RobotId, f64)>,
}

/// The judgement in one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The mean silhouette in the embedding reaches the upper threshold.
    Good,
    /// It lies between the thresholds.
    Fair,
    /// It stays below the lower threshold.
    Poor,
    /// There are fewer than two teams.
    Undefined,
}

/// The judgement of one division.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Audit {
    /// The head of the message.
    pub header: Header,
    /// The division that was judged.
    pub teams: Revision,
    /// The embedding that the division was made from.
    pub embedding: Revision,
    /// Silhouettes among the vectors.
    pub in_embedding: SilhouetteReport,
    /// Silhouettes among the positions, over the robots that have one.
    pub in_physical: SilhouetteReport,
    /// The judgement in one word.
    pub verdict: Verdict,
}
