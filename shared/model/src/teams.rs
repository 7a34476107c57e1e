//! The division of the fleet, and what changed since the one before.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::content::{Content, ContentError, refuse};
use crate::header::{Header, Revision};
use crate::id::{RobotId, SkillId, TeamId};
use crate::limits::{MAX_CONFLICT_LENGTH, MAX_MEMBERS_PUBLISHED, MAX_NEEDED_SKILLS, MAX_TEAMS};
use crate::remembered::RememberedTeams;

/// One robot within its team.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Member {
    /// The robot.
    pub robot: RobotId,
    /// (b − a) / max(a, b), where a is the distance to the own centroid and b that to the nearest
    /// other one: 1 in the middle of a lone team, 0 on the border, negative beyond it.
    pub margin: f64,
}

/// One team.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Team {
    /// Its lasting name.
    pub id: TeamId,
    /// Its robots, ordered by name.
    pub members: Vec<Member>,
    /// The robot that is superior to most of the others; the previous leader if none is.
    pub leader: RobotId,
    /// The mean of its members' vectors.
    pub centroid: Vec<f64>,
}

/// How a division came from the one before.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TeamChange {
    /// A team without a predecessor.
    Born {
        /// The new team.
        team: TeamId,
    },
    /// A team whose robots are gone or in other teams.
    Died {
        /// The old team.
        team: TeamId,
    },
    /// A new team whose members mostly come from an older one that lives on.
    Split {
        /// The older team.
        from: TeamId,
        /// The new team.
        into: TeamId,
    },
    /// A team that died into another one.
    Merged {
        /// The team that died.
        from: TeamId,
        /// The team that most of its members are in now.
        into: TeamId,
    },
    /// A robot whose team is another than before.
    Moved {
        /// The robot.
        robot: RobotId,
        /// Its team before; none if it had none.
        from: Option<TeamId>,
        /// Its team now; none if it has none.
        to: Option<TeamId>,
    },
}

/// The evidence for a number of teams.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TeamCountScore {
    /// How many teams.
    pub teams: u32,
    /// How clearly the relations of the robots show so many, from 0 to 1.
    #[schemars(range(min = 0, max = 1))]
    pub score: f64,
}

/// How a division stands to the limits that operators have set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Limited {
    /// Whether no assignment of the robots to these teams that respects the limits has a lesser sum of squared distances
    /// to the teams' centroids.
    pub optimal: bool,
    /// By which share that sum could be lower at most, from 0 to 1.
    pub gap: f64,
    /// Why nothing satisfies the limits, so that the last division stands; none where this one does.
    pub conflict: Option<String>,
    /// What a place in each team costs, in the order of the teams, as a squared distance: above zero where the team is
    /// full, below where it has as few robots as it must have. Empty while nothing satisfies the limits.
    pub prices: Vec<f64>,
    /// What a place costs robots with a needed skill beside that.
    pub skill_prices: Vec<SkillPrices>,
    /// Robots that are placed together with others, by wishes of groups or for skills of which robots have several, ordered
    /// by name. No price stands for their places; those of the other robots hold while these stay.
    pub jointly: Vec<RobotId>,
}

/// What a place costs the robots that have one needed skill, beside what it costs any robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SkillPrices {
    /// The skill.
    pub skill: SkillId,
    /// The robots that pay: those that have the skill and are not stale, ordered by name.
    pub robots: Vec<RobotId>,
    /// The price in each team, in the order of the teams, as a squared distance: above zero where no more robots with the
    /// skill may be, below where the team needs them.
    pub prices: Vec<f64>,
}

/// A robot that is kept in its team for now.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct HeldRobot {
    /// The robot.
    pub robot: RobotId,
    /// The team that it would be in if it did not have to last.
    pub team: TeamId,
}

impl Limited {
    /// That of a division which stands because nothing satisfies the limits.
    #[must_use]
    pub fn standing(conflict: String) -> Self {
        Self { gap: 1.0, ..Self::lacking(conflict) }
    }

    /// That of a division which goes on although needs cannot all be filled.
    #[must_use]
    pub fn lacking(conflict: String) -> Self {
        Self { optimal: false, conflict: Some(conflict), ..Self::open() }
    }

    /// That of a division of which nothing is asked.
    #[must_use]
    pub const fn open() -> Self {
        Self {
            optimal: true,
            gap: 0.0,
            conflict: None,
            prices: Vec::new(),
            skill_prices: Vec::new(),
            jointly: Vec::new(),
        }
    }

    /// Whether the last division stands, as against one that goes on and lacks what it needs.
    #[must_use]
    pub fn stands(&self) -> bool {
        self.conflict.is_some() && self.gap >= 1.0
    }
}

/// What a team needs of a skill, and what it has.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TeamNeed {
    /// The team.
    pub team: TeamId,
    /// The skill.
    pub skill: SkillId,
    /// Least number of robots with the skill.
    pub min: u32,
    /// Most of them; null for no limit.
    pub max: Option<u32>,
    /// Whether it may have fewer than `min` where there is no other way.
    pub soft: bool,
    /// How many of its robots have the skill and are not stale.
    pub have: u32,
}

impl TeamNeed {
    /// How many robots it lacks.
    #[must_use]
    pub const fn lacks(&self) -> u32 {
        self.min.saturating_sub(self.have)
    }
}

/// The division of the fleet.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Teams {
    /// The head of the message.
    pub header: Header,
    /// The embedding that was divided.
    pub embedding: Revision,
    /// How many teams were asked for, or chosen by the evidence; there may be fewer.
    pub requested: u32,
    /// The numbers of teams that could be chosen, in order, with the evidence for each in the embedding; empty
    /// where a number was asked for.
    pub considered: Vec<TeamCountScore>,
    /// The teams, ordered by id as people count: t2 before t10.
    pub teams: Vec<Team>,
    /// Robots that belong to no team, ordered by name: nothing relates them to the others, or limits leave no place.
    pub unassigned: Vec<RobotId>,
    /// Stale robots, with or without a team, ordered by name.
    pub stale: Vec<RobotId>,
    /// Sum of squared distances of the members to their centroids.
    pub inertia: f64,
    /// What changed since the division before.
    pub changes: Vec<TeamChange>,
    /// The number that the next new team will get; numbers are never given twice.
    pub next_team: u64,
    /// How it stands to the limits; none without any.
    pub limited: Option<Limited>,
    /// What the teams need and have, ordered as the teams, then by skill. A team whose robots are all stale needs nothing
    /// until one of them is back.
    pub needs: Vec<TeamNeed>,
    /// Robots with a team that one modality alone relates to others, where several relate robots of the fleet, ordered by
    /// name: nothing confirms their place.
    pub provisional: Vec<RobotId>,
    /// Robots that the newest vectors put into another team, for not long enough yet, ordered by name.
    pub held: Vec<HeldRobot>,
    /// The last teams of robots that are in none now, and teams that ended, each for a minute or, where the leader changes
    /// meanwhile, for a minute from then on. Whoever divides next keeps their places and ids by it.
    pub remembered: RememberedTeams,
}

impl Teams {
    /// The team of each member, in the order of the teams.
    pub fn assignments(&self) -> impl Iterator<Item = (&RobotId, &TeamId)> {
        self.teams
            .iter()
            .flat_map(|team| team.members.iter().map(move |member| (&member.robot, &team.id)))
    }

    /// Whether another division has the same teams with the same members and leaders, and the same
    /// robots without a team, stale or provisional, and stands to limits and needs alike.
    #[must_use]
    pub fn same_division(&self, other: &Self) -> bool {
        let conflict =
            |teams: &Self| teams.limited.as_ref().map(|limited| limited.conflict.clone());
        self.unassigned == other.unassigned
            && self.stale == other.stale
            && self.provisional == other.provisional
            && conflict(self) == conflict(other)
            && self.needs == other.needs
            && self.teams.len() == other.teams.len()
            && self.teams.iter().zip(&other.teams).all(|(left, right)| {
                left.id == right.id
                    && left.leader == right.leader
                    && left.members.len() == right.members.len()
                    && left.members.iter().zip(&right.members).all(|(l, r)| l.robot == r.robot)
            })
    }

    /// The team of one robot; none if the division does not contain the robot.
    #[must_use]
    pub fn robot_team(&self, robot: &RobotId) -> Option<RobotTeam> {
        let place = self.teams.iter().find_map(|team| {
            let found = team.members.binary_search_by(|member| member.robot.cmp(robot)).ok()?;
            Some((team, &team.members[found]))
        });
        if place.is_none() && self.unassigned.binary_search(robot).is_err() {
            return None;
        }
        Some(RobotTeam {
            header: self.header.clone(),
            robot: robot.clone(),
            team: place.map(|(team, _)| team.id.clone()),
            members: match place {
                None => Some(Vec::new()),
                Some((team, _)) if team.members.len() > MAX_MEMBERS_PUBLISHED => None,
                Some((team, _)) => {
                    Some(team.members.iter().map(|member| member.robot.clone()).collect())
                }
            },
            leader: place.map(|(team, _)| team.leader.clone()),
            confidence: place.map_or(0.0, |(_, member)| member.margin.clamp(0.0, 1.0)),
        })
    }
}

impl Content for Teams {
    /// Every robot stands once, and all numbers are finite.
    fn check(&self) -> Result<(), ContentError> {
        let mut robots: Vec<_> =
            self.assignments().map(|(robot, _)| robot).chain(&self.unassigned).collect();
        let count = robots.len();
        robots.sort_unstable();
        robots.dedup();
        if robots.len() != count {
            return refuse("teams", "a robot stands twice");
        }
        let mut ids: Vec<_> = self.teams.iter().map(|team| &team.id).collect();
        ids.sort_unstable();
        ids.dedup();
        if ids.len() != self.teams.len() {
            return refuse("teams.id", "a team stands twice");
        }
        let by_name = |members: &[Member]| members.is_sorted_by(|l, r| l.robot < r.robot);
        if !self.teams.iter().all(|team| by_name(&team.members))
            || !self.unassigned.is_sorted()
            || !self.stale.is_sorted()
            || !self.provisional.is_sorted()
            || !self.held.is_sorted_by(|left, right| left.robot < right.robot)
        {
            return refuse("teams", "robots must be ordered by name");
        }
        for team in &self.teams {
            if !team.members.iter().any(|member| member.robot == team.leader) {
                return refuse("teams.leader", "is no member of the team");
            }
            let mut numbers = team.members.iter().map(|member| member.margin);
            if !numbers.all(f64::is_finite) || !team.centroid.iter().all(|x| x.is_finite()) {
                return refuse("teams", "a margin or centroid is not finite");
            }
        }
        if let Some(limited) = &self.limited {
            if !(0.0..=1.0).contains(&limited.gap) {
                return refuse("gap", "must be a number from 0 to 1");
            }
            let fits = |text: &String| text.chars().count() <= MAX_CONFLICT_LENGTH;
            if !limited.conflict.iter().all(fits) {
                return refuse("conflict", "is longer than it may be");
            }
            let prices = &limited.prices;
            if !prices.is_empty() && prices.len() != self.teams.len()
                || !prices.iter().all(|price| price.is_finite())
            {
                return refuse("price", "must be a finite number for each team, or for none");
            }
            if limited.skill_prices.len() > MAX_NEEDED_SKILLS {
                return refuse("skill_prices", "are of more skills than there may be");
            }
            let is_sound = |of: &SkillPrices| {
                of.robots.is_sorted_by(|left, right| left < right)
                    && of.prices.len() == self.teams.len()
                    && of.prices.iter().all(|price| price.is_finite())
            };
            if !limited.skill_prices.iter().all(is_sound) {
                return refuse("skill_prices", "must be finite, one for each team");
            }
            if !limited.jointly.is_sorted_by(|left, right| left < right) {
                return refuse("jointly", "must be ordered by name");
            }
        }
        if self.needs.len() > MAX_TEAMS as usize * MAX_NEEDED_SKILLS {
            return refuse("needs", "are more than teams may have");
        }
        let mut needs: Vec<_> = self.needs.iter().map(|need| (&need.team, &need.skill)).collect();
        needs.sort_unstable();
        if !needs.is_sorted_by(|left, right| left < right) {
            return refuse("needs", "a skill of a team stands twice");
        }
        if !self.considered.iter().all(|number| number.score.is_finite()) {
            return refuse("considered", "a score is not finite");
        }
        self.remembered.check()?;
        if self.inertia.is_finite() { Ok(()) } else { refuse("inertia", "must be finite") }
    }
}

/// The team of one robot, as it is published to the robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RobotTeam {
    /// The head of the message; its revision is that of the division.
    pub header: Header,
    /// The robot.
    pub robot: RobotId,
    /// Its team; none if nothing relates it to the others.
    pub team: Option<TeamId>,
    /// All robots of the team, itself among them, ordered by name; none if they are more than
    /// [`MAX_MEMBERS_PUBLISHED`]: the division has the list.
    pub members: Option<Vec<RobotId>>,
    /// Who leads the team.
    pub leader: Option<RobotId>,
    /// How clearly it belongs there: its margin, and 0 where that is negative.
    pub confidence: f64,
}

impl Content for RobotTeam {
    /// The team agrees with its members and leader.
    fn check(&self) -> Result<(), ContentError> {
        if !(0.0..=1.0).contains(&self.confidence) {
            return refuse("confidence", "must be a number from 0 to 1");
        }
        if self.team.is_some() != self.leader.is_some() {
            return refuse("leader", "a team has one, and no team has none");
        }
        let Some(members) = &self.members else { return Ok(()) };
        if members.len() > MAX_MEMBERS_PUBLISHED {
            return refuse("members", "are more than a robot's team may list");
        }
        if !members.is_sorted_by(|left, right| left < right) {
            return refuse("members", "must be ordered by name, each once");
        }
        if self.team.is_some() != members.contains(&self.robot) {
            return refuse("members", "must hold the robot itself if it has a team");
        }
        Ok(())
    }
}
