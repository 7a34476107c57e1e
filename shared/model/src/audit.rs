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

/// How silhouettes were computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SilhouetteMethod {
    /// From the distances between all pairs of robots, up to rounding.
    Exact,
    /// From the squared distances between all pairs of robots, up to rounding. The values are further
    /// away from zero than those of distances.
    SquaredExact,
    /// From the distances between some robots, drawn at random, and all robots: an estimate.
    Sampled,
}

/// Silhouettes (Rousseeuw 1987) of a division in one space: -1 misplaced, 0 on a border, 1 apart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SilhouetteReport {
    /// In which space.
    pub space: Space,
    /// Mean over all robots that have a place there; none with fewer than two teams, where it is not
    /// defined.
    pub mean: Option<f64>,
    /// How the mean was computed.
    pub method: SilhouetteMethod,
    /// Standard error of the mean; 0 unless it is an estimate.
    pub standard_error: f64,
    /// Mean over the members of each team.
    pub per_team: Vec<(TeamId, f64)>,
    /// Each robot that has a place there, ordered by name.
    pub per_robot: Vec<(RobotId, f64)>,
    /// How those of teams and robots were computed: a sampled mean has none of the robots that were not
    /// drawn.
    pub detail_method: SilhouetteMethod,
}

impl SilhouetteReport {
    /// That of a division of fewer than two teams, where silhouettes are not defined.
    #[must_use]
    pub fn undefined(space: Space) -> Self {
        Self {
            space,
            mean: None,
            method: SilhouetteMethod::Exact,
            standard_error: 0.0,
            per_team: Vec::new(),
            per_robot: Vec::new(),
            detail_method: SilhouetteMethod::Exact,
        }
    }
}

/// The quality of a division in one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
#[schemars(rename = "Verdict")]
pub enum Quality {
    /// The mean silhouette in the embedding reaches the upper threshold.
    Good,
    /// It lies between the thresholds.
    Fair,
    /// It stays below the lower threshold.
    Poor,
    /// There are fewer than two teams.
    Undefined,
}

/// The scores of one division.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Audit {
    /// The head of the message.
    pub header: Header,
    /// The division that was scored.
    pub teams: Revision,
    /// The embedding that the division was made from.
    pub embedding: Revision,
    /// Silhouettes among the vectors.
    pub in_embedding: SilhouetteReport,
    /// Silhouettes among the positions, over the robots that have one.
    pub in_physical: SilhouetteReport,
    /// The quality of a division in one word.
    pub quality: Quality,
}
