//! Who belongs to the fleet now, and where each robot is.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::content::{Content, ContentError, refuse};
use crate::graph::Node;
use crate::header::{Header, Revision};
use crate::id::{Modality, RobotId, SkillId};
use crate::limits::{MAX_GRAPHS, MAX_ROBOTS, MAX_SKILLS};
use crate::time::Tick;

/// Whether a robot is still there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Presence {
    /// It has reported lately.
    Active,
    /// It has been silent, or its liveliness token has been lost, for too long.
    Stale,
}

/// One robot of the fleet.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RosterEntry {
    /// Its number in the graphs.
    pub node: Node,
    /// Its name.
    pub robot: RobotId,
    /// Whether the robot is still there.
    pub presence: Presence,
    /// Metres east, north, up; none while the robot is known but unplaced.
    pub position: Option<[f64; 3]>,
    /// Radians, counter-clockwise from east.
    pub heading: Option<f64>,
    /// The coordinate frame of the position.
    pub frame: Option<String>,
    /// Its superior.
    pub superior: Option<RobotId>,
    /// What it is within its unit.
    pub role: Option<String>,
    /// What it can do that not every robot can, ordered by name.
    pub skills: Vec<SkillId>,
    /// When anything was last received from it.
    pub last_seen: Tick,
}

impl RosterEntry {
    /// A robot that has reported lately, and of which nothing else is known.
    #[must_use]
    pub const fn active(node: Node, robot: RobotId, last_seen: Tick) -> Self {
        Self {
            node,
            robot,
            presence: Presence::Active,
            position: None,
            heading: None,
            frame: None,
            superior: None,
            role: None,
            skills: Vec::new(),
            last_seen,
        }
    }

    /// Whether the robot is there and has a skill. A stale robot can do nothing for its team.
    #[must_use]
    pub fn offers(&self, skill: &SkillId) -> bool {
        self.presence == Presence::Active && self.skills.binary_search(skill).is_ok()
    }
}

/// All robots of a frame, published after the graphs of the frame: a reader that has applied the graphs
/// that it lists holds one consistent state of the fleet.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Roster {
    /// The head of the message.
    pub header: Header,
    /// The robots, ordered by name.
    pub robots: Vec<RosterEntry>,
    /// The modalities and the revision that each graph has in this frame, ordered by name.
    pub graphs: Vec<(Modality, Revision)>,
}

impl Content for Roster {
    /// The robots and graphs are no more than a fleet may have and ordered without repetition, and all numbers are finite.
    fn check(&self) -> Result<(), ContentError> {
        if self.robots.len() > MAX_ROBOTS {
            return refuse("robots", "there are more than a fleet may have");
        }
        if self.graphs.len() > MAX_GRAPHS {
            return refuse("graphs", "there are more modalities than a fleet may have");
        }
        if !self.robots.is_sorted_by(|left, right| left.robot < right.robot) {
            return refuse("robots", "must be ordered by name without repetition");
        }
        let numbers = self
            .robots
            .iter()
            .flat_map(|entry| entry.position.iter().flatten().chain(entry.heading.iter()).copied());
        if !numbers.into_iter().all(f64::is_finite) {
            return refuse("robots.position", "must be finite");
        }
        let skills = |entry: &RosterEntry| {
            entry.skills.len() <= MAX_SKILLS
                && entry.skills.is_sorted_by(|left, right| left < right)
        };
        if !self.robots.iter().all(skills) {
            return refuse(
                "robots.skills",
                "must be ordered without repetition, and no more than allowed",
            );
        }
        if !self.graphs.is_sorted_by(|left, right| left.0 < right.0) {
            return refuse("graphs", "must be ordered by name without repetition");
        }
        Ok(())
    }
}
