//! The kinds of fleets, in two lists.

use std::ops::Range;

use muster_scenario::FileError;

use super::chosen_on::CHOSEN_ON;
use super::looked_at_once::LOOKED_AT_ONCE;
use super::situation::Situation;
use crate::formations::{Formation, Radio};
use crate::seeds;

/// Seeds of a kind of which a single situation takes seconds.
pub const FEW_SEEDS: usize = 3;

/// A kind of fleet.
#[derive(Debug, Clone, Copy)]
pub struct Kind {
    /// What it is called; short enough for a plot.
    pub name: &'static str,
    /// What it is, in one sentence.
    pub description: &'static str,
    /// How a seed becomes a situation.
    pub(super) source: Source,
    /// Whether it is so large that [`FEW_SEEDS`] must do.
    pub(super) large: bool,
}

/// How a seed becomes a situation.
#[derive(Debug, Clone, Copy)]
pub(super) enum Source {
    /// By random numbers.
    Drawn(fn(u64) -> Situation),
    /// By a formation of the paper on the march: squads, or platoons.
    Formations { platoons: bool, radio: Radio },
}

/// What a kind may be used for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum List {
    /// Looked at while defaults are chosen.
    ChosenOn,
    /// Looked at once, when all defaults are chosen.
    LookedAtOnce,
}

impl List {
    /// Both.
    pub const ALL: [Self; 2] = [Self::ChosenOn, Self::LookedAtOnce];

    /// Its kinds.
    #[must_use]
    pub fn kinds(self) -> &'static [Kind] {
        match self {
            Self::ChosenOn => &CHOSEN_ON,
            Self::LookedAtOnce => &LOOKED_AT_ONCE,
        }
    }

    /// The seeds of its situations, unless others are asked for.
    #[must_use]
    pub fn seeds(self) -> Range<u64> {
        match self {
            Self::ChosenOn => seeds::TRAINING,
            Self::LookedAtOnce => seeds::LOOKED_AT_ONCE,
        }
    }

    /// What it is called in tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::ChosenOn => "chosen on",
            Self::LookedAtOnce => "looked at once",
        }
    }
}

impl Kind {
    /// The situation of a seed: the same for the same seed.
    ///
    /// # Errors
    /// If the file of a formation is none.
    pub fn situation(&self, seed: u64) -> Result<Situation, FileError> {
        match self.source {
            Source::Drawn(draw) => Ok(draw(seed)),
            Source::Formations { platoons, radio } => marching(platoons, radio, seed),
        }
    }

    /// So many seeds, or fewer where this kind takes long.
    #[must_use]
    pub fn seeds(&self, asked: usize) -> usize {
        if self.large { asked.min(FEW_SEEDS) } else { asked }
    }
}

/// A formation on the march, with one of its divisions; both follow from the seed.
fn marching(platoons: bool, radio: Radio, seed: u64) -> Result<Situation, FileError> {
    let mut all = Formation::all()?;
    all.retain(|formation| formation.is_platoon() == platoons);
    let divisions: Vec<(&Formation, usize)> = all
        .iter()
        .flat_map(|formation| {
            (0..formation.layout.divisions.len()).map(move |division| (formation, division))
        })
        .collect();
    // There are three formations each, with two divisions at least.
    let (formation, division) = divisions[(seed % divisions.len() as u64) as usize];
    let system = formation.marching(radio, seed);
    let ranks = (0..).zip(&system.superiors);
    Ok(Situation {
        teams: formation.layout.teams(division),
        truth: formation.layout.divisions[division].clone(),
        positions: Some(system.positions.iter().map(|[x, y]| Some([*x, *y, 0.0])).collect()),
        ranks: Some(ranks.filter_map(|(robot, above)| Some((robot, (*above)?, 1.0))).collect()),
        links: Some(system.links),
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn all() -> impl Iterator<Item = (List, &'static Kind)> {
        List::ALL.into_iter().flat_map(|list| list.kinds().iter().map(move |kind| (list, kind)))
    }

    /// Few seeds of large kinds, and of others as many as show that seeds differ.
    fn situations() -> impl Iterator<Item = (&'static Kind, u64, Situation)> {
        all().flat_map(|(list, kind)| {
            let seeds = list.seeds().take(if kind.large { 1 } else { 4 });
            seeds.map(move |seed| (kind, seed, kind.situation(seed).unwrap()))
        })
    }

    #[test]
    fn there_are_enough_kinds_and_no_kind_is_in_both_lists() {
        let names: BTreeSet<&str> = all().map(|(_, kind)| kind.name).collect();
        assert_eq!(names.len(), all().count(), "two kinds have one name");
        let descriptions: BTreeSet<&str> = all().map(|(_, kind)| kind.description).collect();
        assert_eq!(descriptions.len(), names.len());
        assert!(names.len() >= 28, "{}", names.len());
        let [chosen, once] = List::ALL.map(|list| list.kinds().len());
        assert!(chosen.abs_diff(once) <= 3, "{chosen}, {once}");
        for (_, kind) in all() {
            assert!(kind.name.len() <= 24, "{} does not fit the plot", kind.name);
            assert!(kind.description.ends_with('.') && !kind.description.contains('|'));
        }
    }

    #[test]
    fn a_seed_always_has_the_same_situation_and_seeds_differ() {
        for (kind, seed, situation) in situations() {
            assert_eq!(kind.situation(seed).unwrap(), situation, "{}", kind.name);
            assert_ne!(kind.situation(seed + 1).unwrap(), situation, "{}", kind.name);
        }
    }

    #[test]
    fn labels_have_the_stated_teams_and_every_robot_is_there() {
        for (kind, seed, situation) in situations() {
            let of = format!("{}, seed {seed}", kind.name);
            let robots = situation.robots();
            assert!((2..=2000).contains(&robots), "{of}: {robots}");
            assert!((2..=14).contains(&situation.teams), "{of}");
            let teams: BTreeSet<usize> = situation.truth.iter().copied().flatten().collect();
            assert!(teams.into_iter().eq(0..situation.teams), "{of}");
            assert!(situation.positions.as_ref().is_none_or(|all| all.len() == robots), "{of}");
            assert!(situation.links.as_ref().is_none_or(|all| all.len() == robots), "{of}");
        }
    }

    #[test]
    fn observations_are_those_that_robots_may_report() {
        for (kind, seed, situation) in situations() {
            let of = format!("{}, seed {seed}", kind.name);
            let mut positions = situation.positions.iter().flatten().flatten().flatten();
            assert!(positions.all(|metres| metres.is_finite()), "{of}");
            let ranks = situation.ranks.as_deref().unwrap_or_default();
            let named: BTreeSet<u32> = ranks.iter().map(|rank| rank.0).collect();
            assert_eq!(named.len(), ranks.len(), "{of}: a robot has two superiors");
            // The graphs refuse robots that do not exist, relations to oneself and weights out of range.
            let graphs = [
                situation.spatial().unwrap(),
                situation.connectivity().unwrap(),
                situation.hierarchy().unwrap(),
            ];
            assert!(graphs.iter().flatten().any(|graph| !graph.is_zero()), "{of}");
            let reported = graphs.iter().flatten().count();
            assert!(
                reported > 0 && graphs.iter().flatten().all(|g| g.nodes() == situation.robots())
            );
        }
    }

    #[test]
    fn both_lists_cover_every_dimension() {
        for list in List::ALL {
            let all: Vec<Situation> = list
                .kinds()
                .iter()
                .map(|kind| kind.situation(list.seeds().start).unwrap())
                .collect();
            let has = |what: &str, is: &dyn Fn(&Situation) -> bool| {
                assert!(all.iter().any(is), "{}: {what}", list.name());
            };
            let reports =
                |s: &Situation| [s.positions.is_some(), s.links.is_some(), s.ranks.is_some()];
            for wanted in 1..8 {
                let wanted = [wanted & 1 > 0, wanted & 2 > 0, wanted & 4 > 0];
                has(&format!("{wanted:?}"), &|s| reports(s) == wanted);
            }
            has("few robots", &|s| s.robots() <= 6);
            has("many robots", &|s| s.robots() >= 1000);
            has("two teams", &|s| s.teams == 2);
            has("many teams", &|s| s.teams >= 9);
            has("sizes of 1:5 and more", &|s| {
                let size = |team| s.truth.iter().filter(|of| **of == Some(team)).count();
                let sizes: Vec<usize> = (0..s.teams).map(size).collect();
                sizes.iter().max().unwrap() >= &(5 * sizes.iter().min().unwrap())
            });
        }
    }
}
