//! Which robots may wait in their last team although a new division has them elsewhere.

use std::collections::BTreeMap;

use muster_model::id::{RobotId, TeamId};
use muster_model::teams::Teams;
use muster_numeric::assignment::{Assigner, Bounds, Column, CostMatrix, Rules};

use super::{TeamRules, grants_group};
use crate::needs::NeedLimits;

impl TeamRules {
    /// Of the robots that are to be kept in their last team, as many as the rules let stay there. The others are where
    /// the new division has them, which obeys the rules. Every team keeps a robot.
    pub fn keep(&self, new: &Teams, held: BTreeMap<RobotId, TeamId>) -> BTreeMap<RobotId, TeamId> {
        let plain = |held: &BTreeMap<RobotId, TeamId>| -> BTreeMap<RobotId, TeamId> {
            let others = held.iter().filter(|(robot, _)| !self.needs.concern(robot));
            others.map(|(robot, team)| (robot.clone(), team.clone())).collect()
        };
        let others = plain(&held);
        let found = self.kept(new, held).or_else(|| self.kept(new, others));
        found.unwrap_or_default()
    }

    /// As [`TeamRules::keep`]; none if groups or needs that are no limits of classes do not allow it.
    fn kept(
        &self,
        new: &Teams,
        mut held: BTreeMap<RobotId, TeamId>,
    ) -> Option<BTreeMap<RobotId, TeamId>> {
        let columns: Vec<TeamId> = new.teams.iter().map(|team| team.id.clone()).collect();
        let robots: Vec<(&RobotId, &TeamId)> = new.assignments().collect();
        let (names, teams): (Vec<&RobotId>, Vec<&TeamId>) = robots.iter().copied().unzip();
        let needs = self.needs.limits_as_in(&columns, &names, &teams);
        let is_kept = self.assigned_with(&columns, &robots, &held, &needs).unwrap_or_default();
        let mut is_kept = is_kept.into_iter();
        for (robot, _) in &robots {
            if !is_kept.next().unwrap_or(false) {
                held.remove(*robot);
            }
        }
        let place = |(robot, team): &(&RobotId, &TeamId)| {
            ((*robot).clone(), held.get(*robot).unwrap_or(team).clone())
        };
        let placed: BTreeMap<RobotId, TeamId> = robots.iter().map(place).collect();
        let are_filled = needs.needs.iter().all(|need| {
            let Column::Team(at) = need.column else { return true };
            let there =
                need.robots.iter().filter(|robot| placed.get(names[**robot]) == Some(&columns[at]));
            (need.at_least..=need.at_most).contains(&there.count())
        });
        let are_granted = self.wishes.iter().all(|asked| grants_group(&asked.wish, &placed));
        (are_filled && are_granted).then_some(held)
    }

    /// For each robot of a division, whether it is to stay in its last team and may; none if robots would have to be in neither
    /// of their two teams.
    fn assigned_with(
        &self,
        columns: &[TeamId],
        robots: &[(&RobotId, &TeamId)],
        held: &BTreeMap<RobotId, TeamId>,
        needs: &NeedLimits,
    ) -> Option<Vec<bool>> {
        let bounds = columns.iter().map(|id| {
            let Bounds { lower, upper } = self.bounds(id);
            Bounds::new(lower.max(1), upper)
        });
        let names: Vec<&RobotId> = robots.iter().map(|(robot, _)| *robot).collect();
        let pairs = self.ties(columns, &names).into_iter().map(|tie| tie.pair).collect();
        let rules = Rules {
            robots: robots.len(),
            teams: bounds.collect(),
            pairs,
            classes: needs.classes.clone(),
            class_limits: needs.class_limits.clone(),
            ..Rules::default()
        }
        .check();
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
        let placed = robots.iter().zip(found.columns).map(|((robot, to), column)| {
            let Column::Team(at) = column else { return None };
            let stays = held.get(*robot) == columns.get(at);
            (stays || columns.get(at) == Some(*to)).then_some(stays)
        });
        // A rule that counts only from the next division on, such as a pin into a team that this one begins, has a robot in a
        // third team. None is there to take the place of who stays then.
        placed.collect()
    }
}
