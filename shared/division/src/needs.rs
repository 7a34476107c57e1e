//! What teams need of the skills of their robots, and what is said of it.
//!
//! A robot fills a need while it is not stale. A skill of which no robot has another needed one becomes limits of a class
//! in the flow that assigns robots to teams, and so is exact; the others are searched.

use std::collections::{BTreeMap, BTreeSet};

use muster_model::id::{RobotId, SkillId, TeamId};
use muster_model::roster::{Presence, Roster};
use muster_model::settings::{ClustererSettings, Need};
use muster_model::teams::{TeamNeed, Teams};
use muster_numeric::assignment::{self as numeric, Bounds, ClassLimit, Column, MAX_COST, Wanted};

use crate::words::{list, plural};

/// What a missing robot costs where a need is soft: sixteen times the largest distance of the assignment, so that it is
/// missed only where there is no other way.
const SOFT_PRICE: i64 = 1 << 36;

/// How many robots with a skill a team is to have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Amount {
    min: u32,
    max: Option<u32>,
    soft: bool,
}

impl Amount {
    const fn of(need: &Need) -> Self {
        Self { min: need.per_team.min, max: need.per_team.max, soft: need.soft }
    }

    fn bounds(self) -> Bounds {
        let upper = self.max.map_or(usize::MAX, |max| max as usize);
        Bounds::new(if self.soft { 0 } else { self.min as usize }, upper)
    }

    fn price(self) -> Option<i64> {
        self.soft.then_some(SOFT_PRICE)
    }
}

/// A skill that teams need.
#[derive(Debug, Clone, PartialEq, Eq)]
struct NeededSkill {
    skill: SkillId,
    /// The robots that have it and are not stale.
    robots: BTreeSet<RobotId>,
    /// What every team needs that has no need of its own.
    of_all: Option<Amount>,
    of_team: BTreeMap<TeamId, Amount>,
}

/// How much of the needs is asked.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum Leniency {
    /// All of them.
    #[default]
    Strict,
    /// All are soft.
    Soft,
    /// All are soft, and no team has too many.
    SoftWithoutMost,
}

/// What teams need.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Needs {
    /// Ordered by skill.
    skills: Vec<NeededSkill>,
    /// Teams that need something and whose robots are all stale: nobody could fill that in time, and nobody could use it.
    silent: BTreeSet<TeamId>,
    leniency: Leniency,
}

/// Needs as the assignment sees them.
#[derive(Debug, Default)]
pub(crate) struct NeedLimits {
    /// Class of every robot; empty without any.
    pub(crate) classes: Vec<Option<usize>>,
    pub(crate) class_limits: Vec<ClassLimit>,
    /// Skills that need a search.
    pub(crate) needs: Vec<numeric::Need>,
    /// The skill and the team of each of these.
    pub(crate) names: Vec<(SkillId, TeamId)>,
}

impl Needs {
    /// The needs of some settings, with those who can fill them. None are known before there is a roster.
    pub fn of(
        settings: &ClustererSettings,
        roster: Option<&Roster>,
        division: Option<&Teams>,
    ) -> Self {
        let Some(roster) = roster.filter(|_| !settings.needs.is_empty()) else {
            return Self::default();
        };
        let mut skills: BTreeMap<&SkillId, NeededSkill> = BTreeMap::new();
        for need in &settings.needs {
            let skill = &need.skill;
            let entry = skills.entry(skill).or_insert_with(|| {
                let able = roster.robots.iter().filter(|entry| entry.offers(skill));
                let robots = able.map(|entry| entry.robot.clone()).collect();
                let of_team = BTreeMap::new();
                NeededSkill { skill: skill.clone(), robots, of_all: None, of_team }
            });
            match &need.team {
                Some(team) => {
                    entry.of_team.insert(team.clone(), Amount::of(need));
                }
                None => entry.of_all = Some(Amount::of(need)),
            }
        }
        let active = roster.robots.iter().filter(|entry| entry.presence == Presence::Active);
        let active: BTreeSet<&RobotId> = active.map(|entry| &entry.robot).collect();
        let teams = division.into_iter().flat_map(|division| &division.teams);
        let needs = Self { skills: skills.into_values().collect(), ..Self::default() };
        // A team that needs nothing is the same to the rules whether its robots are silent or not: a division must not be
        // made again because of it.
        let needs_any =
            |team: &TeamId| needs.skills.iter().any(|skill| needs.amount(skill, team).is_some());
        let silent = teams
            .filter(|team| needs_any(&team.id))
            .filter(|team| team.members.iter().all(|member| !active.contains(&member.robot)))
            .map(|team| team.id.clone())
            .collect();
        Self { silent, ..needs }
    }

    /// Whether nothing is needed.
    pub fn is_empty(&self) -> bool {
        self.skills.is_empty()
    }

    /// Whether other needs ask for the same, whoever can fill them.
    pub fn asks_as(&self, other: &Self) -> bool {
        let asked =
            |skill: &NeededSkill| (skill.skill.clone(), skill.of_all, skill.of_team.clone());
        self.skills.iter().map(asked).eq(other.skills.iter().map(asked))
    }

    /// The needs where nothing fills all of them: first all are soft, then no team has too many either.
    pub(crate) fn lenient(&self) -> Vec<Self> {
        if self.is_empty() {
            return Vec::new();
        }
        [Leniency::Soft, Leniency::SoftWithoutMost]
            .map(|leniency| Self { leniency, ..self.clone() })
            .to_vec()
    }

    /// Whether a need names a team.
    pub(crate) fn name(&self, team: &TeamId) -> bool {
        self.skills.iter().any(|skill| skill.of_team.contains_key(team))
    }

    /// What a team needs of a skill; none if it needs nothing of it.
    fn amount(&self, skill: &NeededSkill, team: &TeamId) -> Option<Amount> {
        let amount = skill.of_team.get(team).copied().or(skill.of_all)?;
        let amount = match self.leniency {
            Leniency::Strict => amount,
            Leniency::Soft => Amount { soft: true, ..amount },
            Leniency::SoftWithoutMost => Amount { soft: true, max: None, ..amount },
        };
        let is_open = amount.min == 0 && amount.max.is_none();
        (!is_open && !self.silent.contains(team)).then_some(amount)
    }

    /// The needs as limits for robots in columns.
    pub(crate) fn limits(&self, columns: &[TeamId], robots: &[&RobotId]) -> NeedLimits {
        self.express(columns, robots, |skill, column| self.amount(skill, &columns[column]))
    }

    /// Amounts as limits: of classes as far as no robot is in two of them.
    fn express(
        &self,
        columns: &[TeamId],
        robots: &[&RobotId],
        amount: impl Fn(&NeededSkill, usize) -> Option<Amount>,
    ) -> NeedLimits {
        let mut limits = NeedLimits::default();
        for (class, skill) in self.skills.iter().enumerate() {
            let amounts: Vec<(usize, Amount)> =
                (0..columns.len()).filter_map(|at| Some((at, amount(skill, at)?))).collect();
            if amounts.is_empty() {
                continue;
            }
            let able: Vec<usize> =
                (0..robots.len()).filter(|at| skill.robots.contains(robots[*at])).collect();
            limits.classes.resize(robots.len(), None);
            if able.iter().all(|robot| limits.classes[*robot].is_none()) {
                for robot in able {
                    limits.classes[robot] = Some(class);
                }
                limits.class_limits.extend(amounts.iter().map(|&(at, amount)| ClassLimit {
                    column: Column::Team(at),
                    class,
                    bounds: amount.bounds(),
                    wanted:
                        amount.price().map(|price| Wanted { count: amount.min as usize, price }),
                }));
                continue;
            }
            for (at, amount) in amounts {
                limits.names.push((skill.skill.clone(), columns[at].clone()));
                limits.needs.push(numeric::Need {
                    robots: able.clone(),
                    column: Column::Team(at),
                    at_least: amount.min as usize,
                    at_most: amount.bounds().upper,
                    price: amount.price(),
                });
            }
        }
        // The search can charge no more for all of them together.
        let dearest = MAX_COST / i64::try_from(limits.needs.len().max(1)).unwrap_or(MAX_COST);
        for need in &mut limits.needs {
            need.price = need.price.map(|price| price.min(dearest));
        }
        limits
    }

    /// Limits by which no team gets fewer or more robots with a skill than a division gives it, where it needs them.
    pub(crate) fn limits_as_in(
        &self,
        columns: &[TeamId],
        robots: &[&RobotId],
        teams: &[&TeamId],
    ) -> NeedLimits {
        self.express(columns, robots, |skill, column| {
            let own = &columns[column];
            let amount = self.amount(skill, own)?;
            let here = robots.iter().zip(teams).filter(|(_, team)| **team == own);
            let have = here.filter(|(robot, _)| skill.robots.contains(**robot)).count();
            let have = u32::try_from(have).unwrap_or(u32::MAX);
            let max = amount.max.map(|max| max.max(have));
            Some(Amount { min: amount.min.min(have), max, soft: false })
        })
    }

    /// How many robots with some skill these would have too few or too many as a team; none where its needs are filled.
    pub(crate) fn unfilled_by(&self, team: &TeamId, robots: &[&RobotId]) -> usize {
        let unfilled = self.skills.iter().filter_map(|skill| {
            let amount = self.amount(skill, team)?;
            let have = robots.iter().filter(|robot| skill.robots.contains(**robot)).count();
            let missing = (amount.min as usize).saturating_sub(have);
            Some(missing + have.saturating_sub(amount.bounds().upper))
        });
        unfilled.sum()
    }

    /// Whether a robot has a skill that some team needs.
    pub(crate) fn concern(&self, robot: &RobotId) -> bool {
        self.skills.iter().any(|skill| skill.robots.contains(robot))
    }

    /// Whether a robot fills needs of a skill.
    pub(crate) fn has(&self, skill: &SkillId, robot: &RobotId) -> bool {
        self.skills.iter().any(|of| of.skill == *skill && of.robots.contains(robot))
    }

    /// The name of the skill of each class.
    pub(crate) fn class_names(&self) -> Vec<&SkillId> {
        self.skills.iter().map(|skill| &skill.skill).collect()
    }

    /// A skill of which there are too few robots for all teams, with the numbers.
    pub(crate) fn shortage(&self, columns: &[TeamId], robots: &[&RobotId]) -> Option<String> {
        self.skills.iter().find_map(|skill| {
            let needed: Vec<usize> = columns
                .iter()
                .filter_map(|team| Some(self.amount(skill, team)?.bounds().lower))
                .filter(|lower| *lower > 0)
                .collect();
            let total: usize = needed.iter().sum();
            let able = robots.iter().filter(|robot| skill.robots.contains(**robot)).count();
            let verb = if needed.len() == 1 { "needs" } else { "need" };
            (able < total).then(|| {
                let (able, teams) = (plural(able, "robot"), plural(needed.len(), "team"));
                format!("{able} with {} for {teams}, which {verb} {total}", skill.skill)
            })
        })
    }

    /// Needs that cannot be filled together, by their places in `names`.
    pub(crate) fn describe(
        &self,
        places: &[usize],
        names: &[(SkillId, TeamId)],
        robots: &[&RobotId],
    ) -> String {
        let named = || places.iter().filter_map(|place| names.get(*place));
        let mut skills: Vec<&SkillId> = named().map(|(skill, _)| skill).collect();
        skills.sort_unstable();
        skills.dedup();
        let mut teams: Vec<String> = Vec::new();
        for (_, team) in named() {
            if !teams.contains(&team.to_string()) {
                teams.push(team.to_string());
            }
        }
        let able = |skill: &&SkillId| {
            let needed = self.skills.iter().find(|needed| needed.skill == **skill)?;
            let count = robots.iter().filter(|robot| needed.robots.contains(**robot)).count();
            Some(format!("{} with {skill}", plural(count, "robot")))
        };
        let able: Vec<String> = skills.iter().filter_map(able).collect();
        format!("{} for the needs of {}", list(&able), list(&teams))
    }

    /// What the teams of a division need and have.
    pub fn published(&self, teams: &Teams) -> Vec<TeamNeed> {
        let of_team = |team: &muster_model::teams::Team| {
            let needs = self.skills.iter().filter_map(|skill| {
                let Amount { min, max, soft } = self.amount(skill, &team.id)?;
                let able = team.members.iter();
                let have = able.filter(|member| skill.robots.contains(&member.robot)).count();
                Some(TeamNeed {
                    team: team.id.clone(),
                    skill: skill.skill.clone(),
                    min,
                    max,
                    soft,
                    have: u32::try_from(have).unwrap_or(u32::MAX),
                })
            });
            needs.collect::<Vec<_>>()
        };
        teams.teams.iter().flat_map(of_team).collect()
    }

    /// The robots of a team that fill a need, of those that are in a list ordered by name.
    pub fn able(&self, skill: &SkillId, team: &[RobotId]) -> Vec<RobotId> {
        let needed = self.skills.iter().find(|needed| needed.skill == *skill);
        let is_able =
            |robot: &&RobotId| needed.is_some_and(|needed| needed.robots.contains(*robot));
        team.iter().filter(is_able).cloned().collect()
    }
}
