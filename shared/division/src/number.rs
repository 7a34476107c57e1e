//! How many teams a division has, by what operators want, the evidence, and the rules; and why nothing satisfies those.

use std::cmp::Reverse;
use std::collections::BTreeSet;

use muster_model::embedding::Embedding;
use muster_model::id::{RobotId, TeamId};
use muster_model::settings::TeamCount;
use muster_model::teams::Teams;
use muster_model::time::Tick;

use crate::memory::Memory;
use crate::needs::Needs;
use crate::rules::{Columns, TeamRules};
use crate::seats::{Arrivals, Seats, last_of};

/// The number that the evidence is for, within what is wanted.
pub fn best_number(wanted: TeamCount, shown: Option<u32>, current: Option<u32>) -> u32 {
    let range = wanted.range();
    let current = current.filter(|teams| range.contains(teams));
    let best = shown.or(current).unwrap_or(*range.start());
    best.clamp(*range.start(), *range.end())
}

/// The number of teams among the possible ones: the best one if it is possible, or else the one with the highest score,
/// or else the nearest one. None if nothing is possible.
pub fn possible_number(possible: &[u32], best: u32, scores: &[f64]) -> Option<u32> {
    if possible.contains(&best) {
        return Some(best);
    }
    let score = |teams: u32| scores.get(teams.checked_sub(1)? as usize).copied();
    let rank = |teams: &u32| (score(*teams).unwrap_or(f64::MIN), Reverse(teams.abs_diff(best)));
    possible.iter().copied().reduce(|first, second| {
        let (one, other) = (rank(&first), rank(&second));
        let order = one.0.total_cmp(&other.0).then(one.1.cmp(&other.1));
        if order.is_lt() { second } else { first }
    })
}

/// How many teams are wanted of the robots that are there.
#[derive(Debug, Clone, Copy)]
pub struct Demand {
    /// The numbers that operators and seats leave.
    pub wanted: TeamCount,
    /// How many teams these robots were in; none if there is no division to go on from.
    pub current: Option<u32>,
    /// How many teams have a seat and no robot that is there.
    pub absent: u32,
}

/// What evidence and rules say of the number of teams.
#[derive(Debug, Clone, Copy)]
pub struct Evidence {
    /// How many are wanted.
    pub demand: Demand,
    /// The number that they are for; none without evidence.
    pub shown: Option<u32>,
    /// The last number, if rules allow it.
    pub last: Option<u32>,
}

impl Evidence {
    /// The number of a division that waits for nothing to last.
    #[must_use]
    pub fn best(&self) -> u32 {
        best_number(self.demand.wanted, self.shown, self.last)
    }
}

/// What the number of teams depends on, beside settings and rules.
#[derive(Debug, Clone)]
pub struct Situation<'a> {
    /// The moment.
    pub now: Tick,
    /// The last division.
    pub division: Option<&'a Teams>,
    /// How many teams its robots were divided into, without those that were absent then; none if that is not known.
    pub divided_into: Option<u32>,
    /// Teams that robots had before.
    pub memory: &'a Memory,
    /// Who came lately.
    pub arrivals: Arrivals,
    /// What is to be divided.
    pub embedding: &'a Embedding,
}

impl Situation<'_> {
    /// How many teams are wanted now; notes who came.
    pub fn demand(&mut self, teams: TeamCount, rules: Option<&TeamRules>) -> Demand {
        let reserved = rules.map(TeamRules::reserved).unwrap_or_default();
        let last = self.division.filter(|division| !division.teams.is_empty());
        let seats = Seats::of(self.division, self.memory, &reserved, self.embedding);
        let divided_into = last.map(|last| self.divided_into.unwrap_or(last.requested));
        let current = seats.current(divided_into);
        let wanted = seats.wanted(self.now, teams, rules.is_some(), current, &mut self.arrivals);
        Demand { wanted, current, absent: seats.absent }
    }

    /// What evidence and rules say of the number of teams; notes who came.
    pub fn evidence(&mut self, teams: TeamCount, rules: Option<&TeamRules>) -> Evidence {
        let mut demand = self.demand(teams, rules);
        let quality = &self.embedding.quality;
        let (mut shown, mut last) = (quality.teams_shown, demand.current);
        if let Some(rules) = rules {
            let best = best_number(demand.wanted, shown, demand.current);
            let rules = rules.clone().resolved(self.division, self.memory, self.embedding);
            let possible = self.placeable(&rules).possible(&mut demand, teams, best);
            match possible_number(&possible, best, &quality.team_scores) {
                Some(best) => {
                    shown = Some(best);
                    last = demand.current.filter(|teams| possible.contains(teams));
                }
                // The last division stands, and so does its number, whatever the evidence is.
                None => shown = last.or(shown),
            }
        }
        Evidence { demand, shown, last }
    }

    /// Why nothing satisfies rules for the robots that are there, with any number of teams that is wanted; none if
    /// something does.
    #[must_use]
    pub fn conflict(&self, teams: TeamCount, rules: &TeamRules) -> Option<String> {
        let rules = rules.clone().resolved(self.division, self.memory, self.embedding);
        // What is asked of arrivals must not change them.
        let mut demand = self.clone().demand(teams, Some(&rules));
        let best = best_number(demand.wanted, self.embedding.quality.teams_shown, demand.current);
        let robots = self.placeable(&rules);
        if !robots.possible(&mut demand, teams, best).is_empty() {
            return None;
        }
        let columns: Vec<TeamId> =
            robots.columns(best).columns.into_iter().map(|column| column.team).collect();
        let text = rules.conflict(&columns, &robots.robots);
        Some(text.unwrap_or_else(|| format!("wishes name more teams than {best}")))
    }

    /// As [`Self::conflict`], but for a conflict of needs alone that there was `before`: what operators change meanwhile
    /// is no reason to refuse it.
    #[must_use]
    pub fn new_conflict(&self, asked: Asking<'_>, before: Option<Asking<'_>>) -> Option<String> {
        let conflict = self.conflict(asked.teams, asked.rules)?;
        let same = |last: &Asking<'_>| {
            last.rules.needs.asks_as(&asked.rules.needs) && !last.rules.needs.is_empty()
        };
        let before = before.filter(same);
        if before.is_some_and(|last| self.conflict(last.teams, last.rules).is_some()) {
            return self.conflict(asked.teams, &asked.rules.with_needs(Needs::default()));
        }
        Some(conflict)
    }

    /// The robots of the embedding that may be in a team.
    fn placeable<'a>(&'a self, rules: &'a TeamRules) -> Placeable<'a> {
        let rows = rules.rows(self.embedding);
        let last = last_of(self.division, self.memory, self.embedding, &rows);
        let robots = rows.iter().map(|row| &self.embedding.robots[*row]).collect();
        Placeable { rules, robots, last, previous: self.division, memory: self.memory }
    }
}

/// A number of teams and rules that are asked for together.
#[derive(Debug, Clone, Copy)]
pub struct Asking<'a> {
    /// How many teams.
    pub teams: TeamCount,
    /// What they are to respect.
    pub rules: &'a TeamRules,
}

/// The robots that may be in a team, and their last teams.
struct Placeable<'a> {
    rules: &'a TeamRules,
    robots: Vec<&'a RobotId>,
    last: Vec<Option<&'a TeamId>>,
    previous: Option<&'a Teams>,
    memory: &'a Memory,
}

impl Placeable<'_> {
    /// The teams that so many may be.
    fn columns(&self, teams: u32) -> Columns {
        let teams = (teams as usize).min(self.robots.len());
        self.rules.columns(teams, &self.robots, &self.last, self.previous, self.memory)
    }

    /// Whether something divides these robots into so many teams as the rules want it. Teams that wishes name must be
    /// among them. One that rules name may be `replaced`, or not, by one that they do not name.
    fn is_possible(&self, teams: u32, replaced: bool) -> bool {
        if self.robots.is_empty() {
            return true;
        }
        let Columns { columns, closed, is_named_replaced } = self.columns(teams);
        if is_named_replaced && !replaced {
            return false;
        }
        let known: BTreeSet<&TeamId> = self.last.iter().flatten().copied().collect();
        let kept: BTreeSet<&TeamId> =
            columns.iter().filter_map(|column| column.last.as_ref()).collect();
        let mut left_out = known.difference(&kept).filter(|team| !closed.contains(*team));
        let is_left_out = left_out.any(|team| self.rules.is_wished(team));
        let columns: Vec<TeamId> = columns.iter().map(|column| column.team.clone()).collect();
        !is_left_out && self.rules.is_possible(&columns, &self.robots)
    }

    /// The numbers of teams into which something divides these robots as the rules want it. Where there is none while a
    /// team is absent, that team keeps its seat no longer: all numbers that `asked` allows are wanted then.
    fn possible(&self, demand: &mut Demand, asked: TeamCount, best: u32) -> Vec<u32> {
        let possible = self.possible_of(demand.wanted, demand.current, best);
        if !possible.is_empty() || demand.absent == 0 {
            return possible;
        }
        let all = self.possible_of(asked, None, best);
        if !all.is_empty() {
            demand.wanted = asked;
        }
        all
    }

    /// The possible ones of these numbers: the best one and the last one, and all if the best is not among them. A team
    /// that rules name is replaced by one that they do not name only if no number is possible with it. Else a number would
    /// be possible as soon as the one that is chosen instead has brought such a team about.
    fn possible_of(&self, wanted: TeamCount, last: Option<u32>, best: u32) -> Vec<u32> {
        let range = wanted.range();
        let last = last.filter(|last| *last != best && range.contains(last));
        let numbers = |replaced| {
            let is_possible = move |teams: &u32| self.is_possible(*teams, replaced);
            if range.contains(&best) && is_possible(&best) {
                return [best].into_iter().chain(last.filter(is_possible)).collect();
            }
            range.clone().filter(is_possible).collect::<Vec<_>>()
        };
        let possible = numbers(false);
        if possible.is_empty() { numbers(true) } else { possible }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_the_possible_numbers_the_best_is_taken() {
        let scores = [0.1, 0.5, 0.9, 0.4];
        assert_eq!(possible_number(&[2, 3, 4], 3, &scores), Some(3));
        assert_eq!(possible_number(&[1, 2, 4, 5], 3, &scores), Some(2), "the next best score");
        assert_eq!(possible_number(&[5, 7, 9], 3, &scores), Some(5), "the nearest without a score");
        assert_eq!(possible_number(&[2, 4], 3, &[]), Some(2), "of two as near the lower one");
        assert_eq!(possible_number(&[], 3, &scores), None);
    }
}
