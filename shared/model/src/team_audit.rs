//! What an audit says of each team, and which losses would hurt the fleet most.

use std::fmt::Write as _;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::content::{Content, ContentError, refuse};
use crate::id::{Modality, RobotId, SkillId, TeamId};
use crate::limits::{MAX_AUDITED_SKILLS, MAX_CUT_ROBOTS, MAX_LOSS_PARTS, MAX_LOSSES};

/// How much of the weight of a graph's edges lies between a team and the others.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Conductance {
    /// The graph.
    pub modality: Modality,
    /// The weight of the edges between the team and the others, as a share of the weight of all ends of edges
    /// in the team, or outside of it if that is less (Kannan, Vempala and Vetta 2004): 0 apart, 1 no edge
    /// within.
    #[schemars(range(min = 0, max = 1))]
    pub conductance: f64,
}

/// The robot of a team that fits it least.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LeastFitting {
    /// The robot.
    pub robot: RobotId,
    /// Its silhouette among the vectors.
    #[schemars(range(min = -1, max = 1))]
    pub silhouette: f64,
}

/// How the members of a team that are not stale hear each other: the graph `connectivity` within the team, whatever the
/// direction and the weight of its edges.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Radio {
    /// How many parts the team has that no link joins; 0 if all its robots are stale.
    pub parts: u32,
    /// How many robots the leader reaches over any number of links within the team; 0 if it is stale.
    pub reached_by_leader: u32,
    /// How many robots there are without which a part of the team falls apart (articulation points).
    pub cut_robot_count: u32,
    /// Those of them that would cut off most others, the worst first.
    #[schemars(length(max = MAX_CUT_ROBOTS))]
    pub cut_robots: Vec<RobotId>,
    /// How many links there are without which a part of the team falls apart (bridges).
    pub bridges: u32,
    /// The largest share of the robots that are not stale which the loss of a single one would cut off from
    /// the largest rest.
    #[schemars(range(min = 0, max = 1))]
    pub worst_cut: f64,
}

/// How far apart the members of a team are, of those in the frame that most robots of the fleet use.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Spread {
    /// Root mean square distance to the mean of their positions, in metres.
    #[schemars(range(min = 0))]
    pub rms_m: f64,
    /// The largest of these distances, in metres.
    #[schemars(range(min = 0))]
    pub largest_m: f64,
}

/// How many robots of a team have a skill.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SkillCover {
    /// The skill.
    pub skill: SkillId,
    /// How many robots of the team have it and are not stale.
    pub robots: u32,
    /// How many the team needs; 0 for a skill that it does not need.
    pub needed: u32,
    /// How many it has beyond those.
    pub spare: u32,
    /// How many it lacks.
    pub lacking: u32,
}

/// What an audit says of one team.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TeamAudit {
    /// The team.
    pub team: TeamId,
    /// How many robots it has.
    pub robots: u32,
    /// How many of them are stale.
    pub stale: u32,
    /// Whether its leader is stale.
    pub leader_stale: bool,
    /// Mean silhouette among the vectors; none with fewer than two teams.
    #[schemars(range(min = -1, max = 1))]
    pub silhouette: Option<f64>,
    /// The robot with the least silhouette; none with fewer than two teams.
    pub least: Option<LeastFitting>,
    /// The conductance in each graph, in the order of their names, where it is defined: both the team and the rest have an edge.
    pub conductance: Vec<Conductance>,
    /// How its members hear each other; none where no robot of the fleet reports links.
    pub radio: Option<Radio>,
    /// How many of its robots have no superior, or one outside of the team.
    pub heads: u32,
    /// The only one of them, if the team has others as well.
    pub only_head: Option<RobotId>,
    /// How far apart its robots are; none if none of them has a position.
    pub spread: Option<Spread>,
    /// The skills of its robots, those that it needs first, then by name.
    #[schemars(length(max = MAX_AUDITED_SKILLS))]
    pub skills: Vec<SkillCover>,
}

/// What the loss of one robot would do to its team.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Loss {
    /// The robot.
    pub robot: RobotId,
    /// Its team.
    pub team: TeamId,
    /// How many parts the robots that it is linked with over any number of links within the team fall into; at
    /// most 1 if they stay together.
    pub part_count: u32,
    /// How many robots each of the largest parts has, the largest first; empty if they stay together.
    #[schemars(length(max = MAX_LOSS_PARTS))]
    pub parts: Vec<u32>,
    /// How many robots all parts but the largest have.
    pub cut_off: u32,
    /// Whether it leads the team.
    pub is_leader: bool,
    /// Whether it is the only robot of the team whose superior is none of the team.
    pub is_only_head: bool,
}

impl Loss {
    /// What happens, in words: `r7: t2 falls into 2 parts of 5 and 4`.
    #[must_use]
    pub fn describe(&self) -> String {
        let mut text = format!("{}: {}", self.robot, self.team);
        if self.cut_off > 0 {
            let mut sizes: Vec<_> = self.parts.iter().map(ToString::to_string).collect();
            if sizes.len() < self.part_count as usize {
                sizes.push("fewer".to_owned());
            }
            let last = sizes.pop().unwrap_or_default();
            // Writing to a text cannot fail.
            let _ = write!(
                text,
                " falls into {} parts of {} and {last}",
                self.part_count,
                sizes.join(", ")
            );
        }
        let lost = match (self.is_leader, self.is_only_head) {
            (true, true) => "its leader and only command head",
            (true, false) => "its leader",
            (false, true) => "its only command head",
            (false, false) => return text,
        };
        let joint = if self.cut_off > 0 { " and" } else { "" };
        let _ = write!(text, "{joint} loses {lost}");
        text
    }
}

impl Content for TeamAudit {
    /// All numbers are finite and in their ranges, and no more robots are listed than may be.
    fn check(&self) -> Result<(), ContentError> {
        let is_silhouette = |value: f64| (-1.0..=1.0).contains(&value);
        let is_share = |value: f64| (0.0..=1.0).contains(&value);
        let least = self.least.as_ref().map(|least| least.silhouette);
        if !self.silhouette.into_iter().chain(least).all(is_silhouette) {
            return refuse("teams.silhouette", "must be a number from -1 to 1");
        }
        if !self.conductance.iter().all(|of| is_share(of.conductance)) {
            return refuse("teams.conductance", "must be a number from 0 to 1");
        }
        if let Some(radio) = &self.radio {
            if !is_share(radio.worst_cut) {
                return refuse("teams.radio.worst_cut", "must be a number from 0 to 1");
            }
            if radio.cut_robots.len() > MAX_CUT_ROBOTS {
                return refuse("teams.radio.cut_robots", "are more than may be listed");
            }
        }
        if self.skills.len() > MAX_AUDITED_SKILLS {
            return refuse("teams.skills", "are more than may be listed");
        }
        let is_length = |metres: f64| metres.is_finite() && metres >= 0.0;
        if !self.spread.is_none_or(|of| is_length(of.rms_m) && is_length(of.largest_m)) {
            return refuse("teams.spread", "must be finite and at least 0");
        }
        Ok(())
    }
}

/// Whether a list of losses is no longer than may be, and so are the parts that each names.
pub(crate) fn check_losses(losses: &[Loss]) -> Result<(), ContentError> {
    if losses.len() > MAX_LOSSES {
        return refuse("losses", "are more than may be listed");
    }
    if losses.iter().any(|loss| loss.parts.len() > MAX_LOSS_PARTS) {
        return refuse("losses.parts", "are more than may be listed");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loss_says_what_happens() {
        let loss = |parts: &[u32], part_count, is_leader, is_only_head| Loss {
            robot: RobotId::new("r7").unwrap(),
            team: TeamId::numbered(2),
            part_count,
            parts: parts.to_vec(),
            cut_off: parts.iter().skip(1).sum(),
            is_leader,
            is_only_head,
        };
        let cases = [
            (loss(&[5, 4], 2, false, false), "r7: t2 falls into 2 parts of 5 and 4"),
            (loss(&[5, 2, 1], 3, false, false), "r7: t2 falls into 3 parts of 5, 2 and 1"),
            (loss(&[1, 1], 9, false, false), "r7: t2 falls into 9 parts of 1, 1 and fewer"),
            (
                loss(&[5, 4], 2, true, true),
                "r7: t2 falls into 2 parts of 5 and 4 and loses its leader and only command head",
            ),
            (loss(&[], 1, true, false), "r7: t2 loses its leader"),
            (loss(&[], 1, false, true), "r7: t2 loses its only command head"),
        ];
        for (loss, text) in cases {
            assert_eq!(loss.describe(), text);
        }
    }
}
