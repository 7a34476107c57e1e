//! How many teams the next division has, by what operators want, the evidence, and the rules.

use std::collections::BTreeSet;

use muster_model::embedding::Embedding;
use muster_model::id::{RobotId, TeamId};
use muster_model::settings::{ClustererSettings, SettingsError, TeamCount};
use muster_model::teams::Teams;
use muster_model::time::Tick;

use super::Clusterer;
use crate::dwell::{best_number, possible_number};
use crate::identity::Memory;
use crate::needs::Needs;
use crate::rules::{TeamColumn, TeamRules};
use crate::seats::{Seats, last_of};

/// What to do about limits that nothing satisfies.
const REMEDY: &str = "change a limit, a need or the number of teams";

/// How many teams are wanted of the robots that are there.
#[derive(Debug, Clone, Copy)]
struct Demand {
    /// The numbers that operators and seats leave.
    wanted: TeamCount,
    /// How many teams these robots were in; none if there is no division to go on from.
    current: Option<u32>,
}

/// The number of teams of a division.
#[derive(Debug, Clone, Copy)]
pub(super) struct Number {
    /// How many.
    pub(super) teams: u32,
    /// Whether these robots were in as many before.
    pub(super) is_same: bool,
}

impl Clusterer {
    /// How many teams are wanted now, by these settings.
    fn demand(
        &mut self,
        now: Tick,
        settings: &ClustererSettings,
        rules: Option<&TeamRules>,
        embedding: &Embedding,
    ) -> Demand {
        let reserved = rules.map(TeamRules::reserved).unwrap_or_default();
        let last = self.division.as_deref().filter(|division| !division.teams.is_empty());
        let vacant = self.vacancies.count(now, last);
        let seats = Seats::of(self.division.as_deref(), &self.memory, vacant, &reserved, embedding);
        let current = seats.current(last.map(|division| division.requested));
        let wanted = seats.wanted(now, settings.teams, current, &mut self.arrivals);
        Demand { wanted, current }
    }

    /// How many teams the next division has.
    pub(super) fn decide_number(
        &mut self,
        now: Tick,
        settings: &ClustererSettings,
        rules: Option<&TeamRules>,
        embedding: &Embedding,
    ) -> Number {
        let Demand { wanted, current } = self.demand(now, settings, rules, embedding);
        let quality = &embedding.quality;
        let (mut shown, mut last) = (quality.teams_shown, current);
        if let Some(rules) = rules {
            let best = best_number(wanted, shown, current);
            let division = self.division.as_deref();
            let rules = rules.clone().resolved(division, &self.memory, embedding);
            let robots = self.placeable(&rules, embedding);
            let possible = robots.possible(Demand { wanted, current }, best);
            if let Some(best) = possible_number(&possible, best, &quality.team_scores) {
                shown = Some(best);
                last = current.filter(|teams| possible.contains(teams));
            }
        }
        let teams = self.count.decide(now, wanted, shown, last);
        Number { teams, is_same: current == Some(teams) }
    }

    /// The robots of an embedding that may be in a team.
    fn placeable<'a>(&'a self, rules: &'a TeamRules, embedding: &'a Embedding) -> Placeable<'a> {
        let rows = rules.rows(embedding);
        let previous = self.division.as_deref();
        let last = last_of(previous, &self.memory, embedding, &rows);
        let robots = rows.iter().map(|row| &embedding.robots[*row]).collect();
        Placeable { rules, robots, last, previous, memory: &self.memory }
    }

    /// Refuses settings whose limits nothing satisfies for the robots that are there.
    pub(super) fn check_limits(
        &self,
        now: Tick,
        before: &ClustererSettings,
        settings: &ClustererSettings,
    ) -> Result<(), SettingsError> {
        let field = if settings.size != before.size {
            "size"
        } else if settings.team_size != before.team_size {
            "team_size"
        } else if settings.needs != before.needs {
            "needs"
        } else if settings.teams != before.teams {
            "teams"
        } else {
            return Ok(());
        };
        let Some(rules) = self.rules(settings) else { return Ok(()) };
        let last = self.rules(before);
        match self.new_conflict(now, settings, &rules, before, last.as_ref()) {
            Some(conflict) => Err(SettingsError::new(field, format!("{conflict}; {REMEDY}"))),
            None => Ok(()),
        }
    }

    /// As [`Self::conflict`], but for a conflict of needs alone that there was `before`: what operators change meanwhile
    /// is no reason to refuse it.
    pub(super) fn new_conflict(
        &self,
        now: Tick,
        settings: &ClustererSettings,
        rules: &TeamRules,
        before: &ClustererSettings,
        last: Option<&TeamRules>,
    ) -> Option<String> {
        let conflict = self.conflict(now, settings, rules)?;
        let last = last.filter(|last| last.needs.asks_as(&rules.needs) && !last.needs.is_empty());
        if last.is_some_and(|last| self.conflict(now, before, last).is_some()) {
            return self.conflict(now, settings, &rules.with_needs(Needs::default()));
        }
        Some(conflict)
    }

    /// Why nothing satisfies rules for the robots that are there, with any number of teams that is wanted; none if
    /// something does.
    pub(super) fn conflict(
        &self,
        now: Tick,
        settings: &ClustererSettings,
        rules: &TeamRules,
    ) -> Option<String> {
        let embedding = &*self.newest.as_ref()?.embedding;
        let rules = rules.clone().resolved(self.division.as_deref(), &self.memory, embedding);
        // What is asked of seats and arrivals must not change them.
        let mut asked = Self {
            division: self.division.clone(),
            memory: self.memory.clone(),
            vacancies: self.vacancies.clone(),
            arrivals: self.arrivals.clone(),
            ..Self::default()
        };
        let demand = asked.demand(now, settings, Some(&rules), embedding);
        let best = best_number(demand.wanted, embedding.quality.teams_shown, demand.current);
        let robots = self.placeable(&rules, embedding);
        if !robots.possible(demand, best).is_empty() {
            return None;
        }
        let columns: Vec<TeamId> =
            robots.columns(best).into_iter().map(|column| column.team).collect();
        let text = rules.conflict(&columns, &robots.robots);
        Some(text.unwrap_or_else(|| format!("wishes name more teams than {best}")))
    }

    /// What divisions have to respect, by settings and wishes; none if nothing is asked of them.
    pub(super) fn rules(&self, settings: &ClustererSettings) -> Option<TeamRules> {
        TeamRules::of(settings, self.wishes.asked(), self.needs(settings))
    }

    /// What teams need, with those who can fill it now.
    pub(super) fn needs(&self, settings: &ClustererSettings) -> Needs {
        Needs::of(settings, self.roster.as_deref(), self.division.as_deref())
    }
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
    fn columns(&self, teams: u32) -> Vec<TeamColumn> {
        let teams = (teams as usize).min(self.robots.len());
        self.rules.columns(teams, &self.robots, &self.last, self.previous, self.memory)
    }

    /// Whether something divides these robots into so many teams as the rules want it. Teams that wishes name must be
    /// among them, if any robot may be there.
    fn is_possible(&self, teams: u32) -> bool {
        if self.robots.is_empty() {
            return true;
        }
        let columns = self.columns(teams);
        let known: BTreeSet<&TeamId> = self.last.iter().flatten().copied().collect();
        let kept: BTreeSet<&TeamId> =
            columns.iter().filter_map(|column| column.last.as_ref()).collect();
        let closed = self.rules.closed(&self.last, &self.robots);
        let mut left_out = known.difference(&kept).filter(|team| !closed.contains(*team));
        let is_left_out = left_out.any(|team| self.rules.is_wished(team));
        let columns: Vec<TeamId> = columns.iter().map(|column| column.team.clone()).collect();
        !is_left_out && self.rules.is_possible(&columns, &self.robots)
    }

    /// The numbers of teams into which something divides these robots as the rules want it: the best one and the last
    /// one, and all if the best is not among them.
    fn possible(&self, demand: Demand, best: u32) -> Vec<u32> {
        let range = demand.wanted.range();
        let is_possible = |teams: &u32| self.is_possible(*teams);
        if is_possible(&best) {
            let last = demand.current.filter(|last| *last != best && range.contains(last));
            return [best].into_iter().chain(last.filter(is_possible)).collect();
        }
        range.filter(is_possible).collect()
    }
}
