//! What operators ask of divisions: how many robots each team has.
//!
//! A team is a column of the assignment, under the id that it has or will have, so that its limits are its own before
//! the robots are divided.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use muster_model::id::{RobotId, TeamId};
use muster_model::settings::{ClustererSettings, TeamSize};
use muster_model::teams::Teams;
use muster_numeric::assignment::{
    Assigner, AssignmentError, Bounds, Column, Conflict, CostMatrix, Pair, Rules, RulesError,
    ValidRules,
};

use crate::identity::{self, Memory, Numbers};

/// A team of the next division.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct TeamColumn {
    /// Its id.
    pub(crate) team: TeamId,
    /// The team that its robots were in last; none if it is new.
    pub(crate) last: Option<TeamId>,
}

/// What divisions have to respect.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct TeamRules {
    size: TeamSize,
    of_team: BTreeMap<TeamId, TeamSize>,
}

impl TeamRules {
    /// The rules of some settings; none if these limit nothing.
    pub(crate) fn of(settings: &ClustererSettings) -> Option<Self> {
        let of_team = settings.team_size.keys().map(|id| (id.clone(), settings.size_of(id)));
        let rules = Self { size: settings.size, of_team: of_team.collect() };
        settings.has_limits().then_some(rules)
    }

    /// How many robots a team may have.
    pub(crate) fn bounds(&self, team: &TeamId) -> Bounds {
        let size = self.of_team.get(team).copied().unwrap_or(self.size);
        let upper = size.max.map_or(usize::MAX, |max| max as usize);
        Bounds::new(size.least() as usize, upper)
    }

    /// The teams of the next division, ordered by id. Of those that robots were in so many stay as there are to be: teams
    /// that rules name before others, then those with most robots. New ones get the next numbers, and so do teams that
    /// ended, as long as it is not known whether most of their robots are in them again.
    pub(crate) fn columns(
        &self,
        teams: usize,
        last: &[Option<&TeamId>],
        previous: Option<&Teams>,
        memory: &Memory,
    ) -> Vec<TeamColumn> {
        let living: BTreeSet<&TeamId> =
            previous.into_iter().flat_map(|last| &last.teams).map(|team| &team.id).collect();
        let mut robots: BTreeMap<&TeamId, usize> = BTreeMap::new();
        for id in last.iter().flatten() {
            *robots.entry(id).or_default() += 1;
        }
        let mut known: Vec<(&TeamId, usize)> = robots.into_iter().collect();
        known.sort_by_key(|&(id, count)| {
            (!self.of_team.contains_key(id), Reverse(count), identity::order(id))
        });
        let mut numbers = Numbers::after(previous, memory);
        let column = |(id, _): (&TeamId, usize)| {
            let team = if living.contains(id) { id.clone() } else { numbers.next() };
            TeamColumn { team, last: Some(id.clone()) }
        };
        let mut columns: Vec<TeamColumn> = known.into_iter().take(teams).map(column).collect();
        while columns.len() < teams {
            columns.push(TeamColumn { team: numbers.next(), last: None });
        }
        columns
            .sort_by(|left, right| identity::order(&left.team).cmp(&identity::order(&right.team)));
        columns
    }

    /// The rules of the assignment of so many robots.
    pub(crate) fn assignment(
        &self,
        columns: &[TeamId],
        robots: usize,
    ) -> Result<ValidRules, RulesError> {
        let teams = columns.iter().map(|id| self.bounds(id)).collect();
        Rules { robots, teams, ..Rules::default() }.check()
    }

    /// The rules while nothing satisfies all of them: no team has more robots than it may have, robots stay in their last
    /// team, and those that have no place have no team.
    pub(crate) fn relaxed(
        &self,
        columns: &[TeamId],
        stay: &[Option<Column>],
    ) -> Result<ValidRules, RulesError> {
        let upper = |id: &TeamId| Bounds::at_most(self.bounds(id).upper);
        let forced = |(robot, column): (usize, &Option<Column>)| {
            Some(Pair::Forced { robot, column: (*column)? })
        };
        Rules {
            robots: stay.len(),
            teams: columns.iter().map(upper).collect(),
            reserve: Some(Bounds::ANY),
            pairs: stay.iter().enumerate().filter_map(forced).collect(),
            ..Rules::default()
        }
        .check()
    }

    /// Whether something satisfies the rules for so many robots in these teams.
    pub(crate) fn is_possible(&self, columns: &[TeamId], robots: usize) -> bool {
        let bounds = columns.iter().map(|id| self.bounds(id));
        let (least, most) = bounds.fold((0_usize, 0_usize), |(least, most), bounds| {
            (least.saturating_add(bounds.lower), most.saturating_add(bounds.upper))
        });
        (least..=most).contains(&robots)
    }

    /// Why nothing satisfies the rules for these robots; none if something does.
    pub(crate) fn conflict(&self, columns: &[TeamId], robots: &[&RobotId]) -> Option<String> {
        if self.is_possible(columns, robots.len()) {
            return None;
        }
        let rules = match self.assignment(columns, robots.len()) {
            Ok(rules) => rules,
            Err(error) => return Some(error.to_string()),
        };
        let conflict = conflict_of(&rules)?;
        Some(crate::words::conflict(&conflict, columns, robots))
    }

    /// Whether these robots may be a team.
    pub(crate) fn admits(&self, team: &TeamId, robots: &[&RobotId]) -> bool {
        let bounds = self.bounds(team);
        (bounds.lower..=bounds.upper).contains(&robots.len())
    }

    /// Of the robots that are to be kept in their last team, as many as the rules let stay there. The others are where
    /// the new division has them, which obeys the rules. Every team keeps a robot.
    pub(crate) fn keep(
        &self,
        new: &Teams,
        mut held: BTreeMap<RobotId, TeamId>,
    ) -> BTreeMap<RobotId, TeamId> {
        let columns: Vec<TeamId> = new.teams.iter().map(|team| team.id.clone()).collect();
        let robots: Vec<(&RobotId, &TeamId)> = new.assignments().collect();
        let is_kept = self.assigned_with(&columns, &robots, &held).unwrap_or_default();
        let mut is_kept = is_kept.into_iter();
        for (robot, _) in robots {
            if !is_kept.next().unwrap_or(false) {
                held.remove(robot);
            }
        }
        held
    }

    /// For each robot of a division, whether it is to stay in its last team and may.
    fn assigned_with(
        &self,
        columns: &[TeamId],
        robots: &[(&RobotId, &TeamId)],
        held: &BTreeMap<RobotId, TeamId>,
    ) -> Option<Vec<bool>> {
        let bounds = columns.iter().map(|id| {
            let Bounds { lower, upper } = self.bounds(id);
            Bounds::new(lower.max(1), upper)
        });
        let rules =
            Rules { robots: robots.len(), teams: bounds.collect(), ..Rules::default() }.check();
        let place_of: BTreeMap<&TeamId, usize> = columns.iter().zip(0..).collect();
        // More than all robots together can cost.
        let elsewhere = i64::try_from(robots.len()).ok()?.saturating_add(1);
        let mut costs = vec![elsewhere; robots.len() * columns.len()];
        for ((robot, to), row) in robots.iter().zip(costs.chunks_mut(columns.len().max(1))) {
            let from = held.get(*robot).and_then(|from| place_of.get(from));
            row[*place_of.get(to)?] = i64::from(from.is_some());
            if let Some(from) = from {
                row[*from] = 0;
            }
        }
        let costs = CostMatrix::new(robots.len(), columns.len(), costs).ok()?;
        let found = Assigner::new().solve(&rules.ok()?, &costs).ok()?;
        let stays = robots.iter().zip(found.columns).map(|((robot, _), column)| {
            let Column::Team(at) = column else { return false };
            held.get(*robot) == columns.get(at)
        });
        Some(stays.collect())
    }
}

/// Why nothing satisfies rules.
fn conflict_of(rules: &ValidRules) -> Option<Box<Conflict>> {
    let (robots, columns) = (rules.get().robots, rules.get().columns());
    let costs = CostMatrix::new(robots, columns, vec![0; robots * columns]).ok()?;
    match Assigner::new().solve(rules, &costs) {
        Err(AssignmentError::Infeasible(conflict)) => Some(conflict),
        _ => None,
    }
}
