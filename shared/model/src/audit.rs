//! The independent judgement of a division.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::content::{Content, ContentError, refuse};
use crate::header::{Header, Revision};
use crate::id::{RobotId, TeamId};
use crate::limits::MAX_FLAPPING_ROBOTS;
use crate::team_audit::{Loss, TeamAudit, check_losses};

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

/// A robot that came back into a team that it had left.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RobotReturns {
    /// The robot.
    pub robot: RobotId,
    /// How often it came back within the last minute.
    #[schemars(range(min = 1))]
    pub returns: u32,
}

/// How often robots change their team and change back, over the last minute.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Flapping {
    /// Changes into a team that the robot had left within the minute, per robot of the fleet and minute.
    #[schemars(range(min = 0))]
    pub returns_per_robot_minute: f64,
    /// The robots that came back most often, most often first.
    #[schemars(length(max = MAX_FLAPPING_ROBOTS))]
    pub robots: Vec<RobotReturns>,
}

impl Flapping {
    /// Returns of one robot from which on it goes to and fro. One return may be an errand: the robot did
    /// something with another team and came home. Twice within a minute is no errand, and in a small fleet
    /// a single return is already more than any sensible threshold per robot and minute.
    const MIN_RETURNS: u32 = 2;

    /// Whether there are more returns per robot and minute than a threshold, and a robot goes to and fro.
    #[must_use]
    pub fn is_above(&self, threshold: f64) -> bool {
        self.returns_per_robot_minute > threshold
            && self.robots.iter().any(|robot| robot.returns >= Self::MIN_RETURNS)
    }
}

impl Content for Flapping {
    /// The rate is finite and not negative, and no more robots are listed than may be.
    fn check(&self) -> Result<(), ContentError> {
        if !self.returns_per_robot_minute.is_finite() || self.returns_per_robot_minute < 0.0 {
            return refuse("flapping.returns_per_robot_minute", "must be finite and at least 0");
        }
        if self.robots.len() > MAX_FLAPPING_ROBOTS {
            return refuse("flapping.robots", "are more than may be listed");
        }
        Ok(())
    }
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
    /// How often robots change their team and change back.
    pub flapping: Flapping,
    /// The roster with whose graphs the teams were scored; none if there is no conductance and no radio, because
    /// the graphs are not known yet.
    pub graphs: Option<Revision>,
    /// Each team, in the order of the division.
    pub per_team: Vec<TeamAudit>,
    /// The robots whose loss would hurt a team most, the worst first.
    pub losses: Vec<Loss>,
}

impl Content for Audit {
    /// [`Flapping`], teams and losses satisfy their rules.
    fn check(&self) -> Result<(), ContentError> {
        self.flapping.check()?;
        self.per_team.iter().try_for_each(Content::check)?;
        check_losses(&self.losses)
    }
}
