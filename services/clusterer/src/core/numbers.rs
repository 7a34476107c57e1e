//! How many teams the next division has, by what operators want, the evidence, and the rules.

use muster_division::needs::Needs;
use muster_division::number::{Asking, Evidence, Situation};
use muster_division::rules::{TeamRules, asks_alike};
use muster_model::embedding::Embedding;
use muster_model::settings::{ClustererSettings, SettingsError};
use muster_model::time::Tick;

use super::Clusterer;

/// What to do about limits that nothing satisfies.
const REMEDY: &str = "change a limit, a need or the number of teams";

/// The number of teams of a division.
#[derive(Debug, Clone, Copy)]
pub(super) struct Number {
    /// How many.
    pub(super) teams: u32,
    /// Whether these robots were in as many before.
    pub(super) is_same: bool,
    /// Whether a whole team is absent.
    pub(super) is_team_absent: bool,
    /// Whether operators have asked for something else since the last job.
    pub(super) is_asked_for: bool,
}

impl Clusterer {
    /// How many teams the next division has.
    pub(super) fn decide_number(
        &mut self,
        now: Tick,
        settings: &ClustererSettings,
        rules: Option<&TeamRules>,
        embedding: &Embedding,
    ) -> Number {
        let mut situation = Situation {
            now,
            division: self.division.as_deref(),
            divided_into: self.divided_into(),
            memory: &self.memory,
            arrivals: self.arrivals.clone(),
            embedding,
        };
        let Evidence { demand, shown, last } = situation.evidence(settings.teams, rules);
        self.arrivals = situation.arrivals;
        let is_asked_for = self.flight.completed().is_some_and(|made| {
            made.settings != *settings || !asks_alike(made.rules.as_ref(), rules)
        });
        let teams = self.count.decide(now, demand.wanted, shown, last, is_asked_for);
        let is_same = demand.current == Some(teams);
        Number { teams, is_same, is_team_absent: demand.absent > 0, is_asked_for }
    }

    /// How many teams the robots that were there were divided into last, without those that were absent.
    fn divided_into(&self) -> Option<u32> {
        let made = self.flight.completed().filter(|_| self.flight.failure().is_none());
        made.map(|made| made.teams)
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

    /// Why nothing satisfies rules for the robots that are there; none if something does, or if the conflict is one of
    /// needs alone that there was `before`.
    pub(super) fn new_conflict(
        &self,
        now: Tick,
        settings: &ClustererSettings,
        rules: &TeamRules,
        before: &ClustererSettings,
        last: Option<&TeamRules>,
    ) -> Option<String> {
        let embedding = &*self.newest.as_ref()?.embedding;
        let situation = Situation {
            now,
            division: self.division.as_deref(),
            divided_into: self.divided_into(),
            memory: &self.memory,
            arrivals: self.arrivals.clone(),
            embedding,
        };
        let last = last.map(|rules| Asking { teams: before.teams, rules });
        situation.new_conflict(Asking { teams: settings.teams, rules }, last)
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
