//! All methods on all kinds over all seeds.

use std::fmt;

use anyhow::Context as _;
use muster_numeric::matching::MatchError;
use rayon::prelude::*;

use super::divided::{Labels, muster, muster_by_itself, paper};
use super::exchange::Baselines;
use super::kinds::{Kind, List};
use crate::score::{Correct, adjusted_rand_index, correct};

/// A situation by its kind and seed.
#[derive(Debug, Clone, Copy)]
pub struct Case {
    /// Of which kind.
    pub kind: &'static Kind,
    /// By which seed.
    pub seed: u64,
}

impl fmt::Display for Case {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}, seed {}", self.kind.name, self.seed)
    }
}

/// A method on the page.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Divider {
    /// Muster, with the number of teams.
    Muster,
    /// Muster, which chooses the number of teams.
    MusterByItself,
    /// The paper's method to the letter.
    Paper,
    /// Spectral clustering.
    Spectral,
    /// Multiplex Leiden, at the resolution that gives the number of teams.
    LeidenTeams,
    /// Multiplex Leiden, which chooses the number of teams.
    Leiden,
    /// k-means on positions.
    KMeans,
    /// The tree of command, cut near its top.
    Tree,
}

impl Divider {
    /// All methods that Muster is compared with, in the order of the page.
    pub const OTHERS: [Self; 6] =
        [Self::Spectral, Self::LeidenTeams, Self::Leiden, Self::KMeans, Self::Tree, Self::Paper];

    /// What it is called in tables, and, if it is a baseline, in the files of the exchange.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Muster => "Muster",
            Self::MusterByItself => "Muster by itself",
            Self::Paper => "the paper's method",
            Self::Spectral => "spectral",
            Self::LeidenTeams => "Leiden with k",
            Self::Leiden => "Leiden",
            Self::KMeans => "k-means on positions",
            Self::Tree => "tree of command",
        }
    }

    /// Whether it is one of those in Python.
    #[must_use]
    pub fn is_baseline(self) -> bool {
        !matches!(self, Self::Muster | Self::MusterByItself | Self::Paper)
    }
}

/// How good a division is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Score {
    /// Share of the robots in the right team.
    pub accuracy: f64,
    /// Rand index adjusted for chance; robots without a team count as teams of their own.
    pub rand_index: f64,
    /// How many teams it has.
    pub teams: usize,
}

impl Score {
    /// Of a division, against the truth. A robot without a team is wrong.
    ///
    /// # Errors
    /// If both are not of the same robots.
    pub fn of(labels: &[Option<usize>], truth: &[Option<usize>]) -> Result<Self, MatchError> {
        let most = labels.iter().flatten().max().map_or(0, |team| team + 1);
        let mut alone = most..;
        let numbered: Vec<usize> =
            labels.iter().map(|label| label.or_else(|| alone.next()).unwrap_or(most)).collect();
        // A robot without a team must not be matched with a true team of one.
        let divided: Vec<Option<usize>> = truth
            .iter()
            .enumerate()
            .map(|(robot, team)| team.filter(|_| labels.get(robot).is_some_and(Option::is_some)))
            .collect();
        let right = correct(&numbered, &divided)?.right;
        let total = truth.iter().flatten().count() as u64;
        let mut teams: Vec<usize> = labels.iter().copied().flatten().collect();
        teams.sort_unstable();
        teams.dedup();
        Ok(Self {
            accuracy: Correct { right, total }.share(),
            rand_index: adjusted_rand_index(&numbered, truth)?,
            teams: teams.len(),
        })
    }
}

/// What all methods made of a situation.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// Which situation.
    pub case: Case,
    /// How many robots it has.
    pub robots: usize,
    /// How many teams it has.
    pub teams: usize,
    /// The score of each method that has something to work on.
    pub scores: Vec<(Divider, Score)>,
}

impl Outcome {
    /// The score of a method, if it has one.
    #[must_use]
    pub fn score(&self, divider: Divider) -> Option<Score> {
        self.scores.iter().find(|(of, _)| *of == divider).map(|(_, score)| *score)
    }
}

/// The cases of lists of kinds: so many seeds from `first` on, or else from the first of the list.
#[must_use]
pub fn cases(lists: &[List], seeds: usize, first: Option<u64>) -> Vec<Case> {
    let of_list = |list: &List| {
        let first = first.unwrap_or(list.seeds().start);
        list.kinds().iter().flat_map(move |kind| {
            (first..).take(kind.seeds(seeds)).map(move |seed| Case { kind, seed })
        })
    };
    lists.iter().flat_map(of_list).collect()
}

/// All methods on all cases, side by side.
///
/// # Errors
/// Names the case of which a method fails, or that the baselines did not see.
pub fn outcomes(cases: &[Case], baselines: Option<&Baselines>) -> anyhow::Result<Vec<Outcome>> {
    let of = |case: &Case| outcome(case, baselines).with_context(|| case.to_string());
    cases.par_iter().map(of).collect()
}

fn outcome(case: &Case, baselines: Option<&Baselines>) -> anyhow::Result<Outcome> {
    let theirs = baselines.map(|all| all.of(case).context("the baselines have not seen it"));
    let theirs = theirs.transpose()?;
    let situation = case.kind.situation(case.seed)?;
    let teams = situation.teams;
    let mut scores = Vec::new();
    let mut add = |divider: Divider, labels: &Labels| -> anyhow::Result<()> {
        let score = Score::of(labels, &situation.truth).context(divider.name())?;
        scores.push((divider, score));
        Ok(())
    };
    let given = muster(&situation, teams)?;
    add(Divider::Muster, &given)?;
    add(Divider::MusterByItself, &muster_by_itself(&situation)?.0)?;
    add(Divider::Paper, &paper(&situation, teams, case.seed)?)?;
    if let Some(found) = theirs {
        for divider in Divider::OTHERS.into_iter().filter(|divider| divider.is_baseline()) {
            let labels = found.get(divider.name()).with_context(|| divider.name())?;
            if let Some(labels) = labels {
                add(divider, labels)?;
            }
        }
    }
    Ok(Outcome { case: *case, robots: situation.robots(), teams, scores })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_without_a_team_is_wrong() {
        let truth = [0, 0, 1, 2].map(Some);
        let whole = Score::of(&[Some(1), Some(1), Some(0), Some(2)], &truth).unwrap();
        assert_eq!(whole, Score { accuracy: 1.0, rand_index: 1.0, teams: 3 });
        // Not even if it would be right as a team of its own.
        let lacking = Score::of(&[Some(1), Some(1), Some(0), None], &truth).unwrap();
        assert_eq!((lacking.accuracy, lacking.teams), (0.75, 2));
        let uncounted = Score::of(&[Some(0), None], &[Some(0), None]).unwrap();
        assert_eq!(uncounted.accuracy, 1.0);
        assert_eq!(Score::of(&[None, None], &[Some(0), Some(1)]).unwrap().accuracy, 0.0);
        assert!(Score::of(&[None], &truth).is_err());
    }

    #[test]
    fn cases_have_the_seeds_of_their_list_unless_others_are_asked_for() {
        let all = cases(&List::ALL, 10, None);
        for case in &all {
            let is_chosen = List::ChosenOn.kinds().iter().any(|kind| kind.name == case.kind.name);
            let list = if is_chosen { List::ChosenOn } else { List::LookedAtOnce };
            assert!(list.seeds().contains(&case.seed), "{case}");
        }
        let seeds = |large: bool| {
            all.iter().filter(|case| case.kind.large == large).count()
                / List::ALL.iter().flat_map(|l| l.kinds()).filter(|k| k.large == large).count()
        };
        assert_eq!([seeds(false), seeds(true)], [10, super::super::kinds::FEW_SEEDS]);
        let later = cases(&[List::ChosenOn], 2, Some(70));
        assert!(later.iter().all(|case| (70..72).contains(&case.seed)));
    }

    #[test]
    fn muster_divides_what_is_plain_to_see() {
        let kinds = List::ChosenOn.kinds().iter();
        let easy = ["round teams", "two and two", "headquarters"];
        let easy: Vec<_> = kinds.filter(|kind| easy.contains(&kind.name)).collect();
        assert_eq!(easy.len(), 3);
        for kind in easy {
            for seed in [0, 1] {
                let situation = kind.situation(seed).unwrap();
                let labels = muster(&situation, situation.teams).unwrap();
                let score = Score::of(&labels, &situation.truth).unwrap();
                assert!(score.accuracy >= 0.95, "{}, seed {seed}: {score:?}", kind.name);
            }
        }
    }
}
