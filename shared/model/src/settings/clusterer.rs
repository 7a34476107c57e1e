//! Settings of `clusterer`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Need, Settings, SettingsError, TeamCount, TeamSize, check_range, need};
use crate::id::{SkillId, TeamId};
use crate::limits::{MAX_NEEDS, MAX_TEAM_SIZES};

/// How the centroids of a start of k-means are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum CentroidStart {
    /// Robots far from each other with higher probability (Arthur and Vassilvitskii 2007).
    #[serde(rename = "kmeans++")]
    PlusPlus,
    /// Robots drawn evenly, as in the paper.
    #[serde(rename = "random")]
    Random,
}

/// Longest time between two publications of a division: robots consider a team stale that was not republished
/// for 5 s, and the readiness probe considers a clusterer dead after 10 s.
const MAX_HEARTBEAT_S: f64 = 4.0;

/// Longest time for which a robot may be kept in its team: beyond a minute it would look like a fault.
const MAX_DWELL_S: f64 = 60.0;

/// Settings of `clusterer`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ClustererSettings {
    /// How many teams the fleet is divided into. There are fewer while the robots do not allow more.
    pub teams: TeamCount,
    /// How many starts of k-means are tried in addition to the previous division.
    #[schemars(range(min = 1, max = 10_000))]
    pub restarts: u32,
    /// How the centroids of a start are chosen.
    pub init: CentroidStart,
    /// Most iterations of one start.
    #[schemars(range(min = 1, max = 100_000))]
    pub max_iterations: u32,
    /// Seed of the random choices.
    #[schemars(range(max = u64::MAX))]
    pub seed: u64,
    /// The previous division is kept while no start is better than it by more than this share of
    /// the inertia, so that noise moves no robot.
    #[schemars(range(min = 0, max = 0.99))]
    pub hysteresis: f64,
    /// A robot changes from one team to another only after every division has said so for this many seconds,
    /// unless its superior, the number of teams or what operators ask for has changed.
    #[schemars(range(min = 0, max = MAX_DWELL_S))]
    pub dwell_s: f64,
    /// An unchanged division is republished after this many seconds.
    #[schemars(range(min = 0.1, max = MAX_HEARTBEAT_S))]
    pub heartbeat_s: f64,
    /// How many robots each team has.
    pub size: TeamSize,
    /// How many robots single teams have, by their ids: what is named here replaces `size` for the team. A team that
    /// is not there keeps its limits until it is.
    #[schemars(extend("maxProperties" = MAX_TEAM_SIZES))]
    pub team_size: BTreeMap<TeamId, TeamSize>,
    /// Which robots every team, or one team, needs. Of several needs for one skill that of the team holds.
    #[serde(deserialize_with = "crate::object::list")]
    #[schemars(with = "Vec<Need>", length(max = MAX_NEEDS))]
    pub needs: Vec<Need>,
}

impl ClustererSettings {
    /// How many robots a team has: its own limits, and those of `size` where it has none.
    #[must_use]
    pub fn size_of(&self, team: &TeamId) -> TeamSize {
        self.team_size.get(team).map_or(self.size, |own| own.or(self.size))
    }

    /// What a team needs of a skill: the need that names the team, or else that of all teams.
    #[must_use]
    pub fn need_of(&self, skill: &SkillId, team: &TeamId) -> Option<&Need> {
        let of_skill = || self.needs.iter().filter(|need| need.skill == *skill);
        let own = of_skill().find(|need| need.team.as_ref() == Some(team));
        own.or_else(|| of_skill().find(|need| need.team.is_none()))
    }

    /// Whether any team has a limit.
    #[must_use]
    pub fn has_limits(&self) -> bool {
        !self.size.is_open() || self.team_size.values().any(|size| !size.is_open())
    }
}

impl Default for ClustererSettings {
    fn default() -> Self {
        Self {
            teams: TeamCount::Auto,
            restarts: 50,
            init: CentroidStart::PlusPlus,
            max_iterations: 100,
            seed: 0,
            hysteresis: 0.05,
            dwell_s: 0.5,
            heartbeat_s: 1.0,
            size: TeamSize::default(),
            team_size: BTreeMap::new(),
            needs: Vec::new(),
        }
    }
}

impl Settings for ClustererSettings {
    fn check(&self) -> Result<(), SettingsError> {
        self.teams.check()?;
        check_range("restarts", f64::from(self.restarts), 1.0..=10_000.0)?;
        check_range("max_iterations", f64::from(self.max_iterations), 1.0..=100_000.0)?;
        check_range("hysteresis", self.hysteresis, 0.0..=0.99)?;
        check_range("dwell_s", self.dwell_s, 0.0..=MAX_DWELL_S)?;
        check_range("heartbeat_s", self.heartbeat_s, 0.1..=MAX_HEARTBEAT_S)?;
        self.size.check("size", TeamSize::default())?;
        if self.team_size.len() > MAX_TEAM_SIZES {
            let problem = format!(
                "may name at most {MAX_TEAM_SIZES} teams, not {}: use `size` for the others",
                self.team_size.len()
            );
            return Err(SettingsError::new("team_size", problem));
        }
        for (team, own) in &self.team_size {
            own.check(&format!("team_size.{team}"), self.size)?;
        }
        need::check(&self.needs)
    }
}
