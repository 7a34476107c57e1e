//! How many teams the next division has, by what operators want, the evidence, and the rules.

use muster_model::embedding::Embedding;
use muster_model::id::TeamId;
use muster_model::settings::{ClustererSettings, SettingsError, TeamCount};
use muster_model::time::Tick;

use super::Clusterer;
use crate::dwell::{best_number, possible_number};
use crate::rules::TeamRules;
use crate::seats::{Seats, last_teams};

/// What to do about limits that nothing satisfies.
const REMEDY: &str = "change a limit or the number of teams";

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
    fn demand(&mut self, now: Tick, settings: &ClustererSettings, embedding: &Embedding) -> Demand {
        let last = self.division.as_deref().filter(|division| !division.teams.is_empty());
        let vacant = self.vacancies.count(now, last);
        let seats = Seats::of(self.division.as_deref(), &self.memory, vacant, embedding);
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
        let Demand { wanted, current } = self.demand(now, settings, embedding);
        let quality = &embedding.quality;
        let (mut shown, mut last) = (quality.teams_shown, current);
        if let Some(rules) = rules {
            let possible = self.possible(rules, wanted, embedding);
            let best = best_number(wanted, shown, current);
            if let Some(best) = possible_number(&possible, best, &quality.team_scores) {
                shown = Some(best);
                last = current.filter(|teams| possible.contains(teams));
            }
        }
        let teams = self.count.decide(now, wanted, shown, last);
        Number { teams, is_same: current == Some(teams) }
    }

    /// The numbers of teams into which something divides these robots as the rules want it.
    fn possible(&self, rules: &TeamRules, wanted: TeamCount, embedding: &Embedding) -> Vec<u32> {
        let robots = placeable(embedding);
        let is_possible =
            |teams: &u32| rules.is_possible(&self.columns(rules, *teams, embedding), robots);
        wanted.range().filter(|teams| robots == 0 || is_possible(teams)).collect()
    }

    /// The teams that so many may be.
    fn columns(&self, rules: &TeamRules, teams: u32, embedding: &Embedding) -> Vec<TeamId> {
        let division = self.division.as_deref();
        let last = division.map_or_else(Vec::new, |last| last_teams(last, &self.memory, embedding));
        let teams = (teams as usize).min(placeable(embedding));
        let columns = rules.columns(teams, &last, division, &self.memory);
        columns.into_iter().map(|column| column.team).collect()
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
        } else if settings.teams != before.teams {
            "teams"
        } else {
            return Ok(());
        };
        let (Some(rules), Some(newest)) = (TeamRules::of(settings), &self.newest) else {
            return Ok(());
        };
        let embedding = &*newest.embedding;
        // What is asked of seats and arrivals must not change them.
        let mut asked = Self {
            division: self.division.clone(),
            memory: self.memory.clone(),
            vacancies: self.vacancies.clone(),
            arrivals: self.arrivals.clone(),
            ..Self::default()
        };
        let Demand { wanted, current } = asked.demand(now, settings, embedding);
        if !self.possible(&rules, wanted, embedding).is_empty() {
            return Ok(());
        }
        let teams = best_number(wanted, embedding.quality.teams_shown, current);
        let robots = embedding.robots.iter().zip(&embedding.without_embedding);
        let robots = robots.filter(|(_, without)| !**without).map(|(robot, _)| robot);
        let columns = self.columns(&rules, teams, embedding);
        match rules.conflict(&columns, &robots.collect::<Vec<_>>()) {
            Some(conflict) => Err(SettingsError::new(field, format!("{conflict}; {REMEDY}"))),
            None => Ok(()),
        }
    }
}

/// How many robots have a non-zero embedding, and so may be in a team.
fn placeable(embedding: &Embedding) -> usize {
    embedding.without_embedding.iter().filter(|without| !**without).count()
}
