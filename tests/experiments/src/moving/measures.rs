//! How well a mission was followed.
//!
//! Ten times a second the newest division is compared with what is true at that moment. A team counts for the
//! true one that it is matched with, so that the most robots are right.

use std::collections::{BTreeSet, HashMap};

use muster_model::id::{RobotId, TeamId};
use muster_model::teams::Teams;
use muster_numeric::matching::{MatchError, match_by_overlap, overlap_table};

use super::mission::{Act, Mission};
use crate::score::adjusted_rand_index;

/// When the start is over, in seconds: `ingest` waits a second for all robots.
pub const START_TIME_S: f64 = 3.0;

/// What counts as following, as a share of robots in the right team.
pub const FOLLOWED_SHARE: f64 = 0.95;

/// Comparisons before the next change, or the end, that must find it at least: a second.
const LEAST_SAMPLES: usize = 10;

/// One comparison.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Seconds from the beginning.
    pub t: f64,
    /// Share of all robots that are in the right team.
    pub accuracy: f64,
    /// The same of those in teams to which something happens in the mission; of all where nothing does.
    pub involved: f64,
    /// Adjusted Rand index.
    pub rand: f64,
    /// Mean silhouette in the embedding, by the auditor.
    pub silhouette: Option<f64>,
    /// Columns of the embedding.
    pub dimension: u32,
}

/// How a change of the truth was followed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Following {
    /// When it came, in seconds.
    pub at: f64,
    /// What came.
    pub act: Act,
    /// After how many seconds it was followed; none if it was not before the next change or the end.
    pub took_s: Option<f64>,
    /// How long that would have been.
    pub until_next_s: f64,
}

/// What became of a mission.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// All comparisons, in order.
    pub series: Vec<Sample>,
    /// How the changes of the truth were followed, in order.
    pub followings: Vec<Following>,
    /// Changes of a robot's team that the truth does not have, in all: every one but the first into the team that
    /// is matched with its true one after that has become another.
    pub needless: usize,
    /// The same per robot and minute.
    pub needless_rate: f64,
}

impl Outcome {
    /// The mean of a number over all samples after the start.
    pub fn mean(&self, number: impl Fn(&Sample) -> f64) -> f64 {
        let after = self.series.iter().filter(|sample| sample.t >= START_TIME_S);
        let numbers: Vec<f64> = after.map(number).collect();
        numbers.iter().sum::<f64>() / (numbers.len() as f64).max(1.0)
    }

    /// How often the dimension of the embedding changed after the start.
    #[must_use]
    pub fn dimension_changes(&self) -> usize {
        let after: Vec<u32> = self
            .series
            .iter()
            .filter(|sample| sample.t >= START_TIME_S)
            .map(|sample| sample.dimension)
            .collect();
        after.windows(2).filter(|two| two[0] != two[1]).count()
    }
}

/// Compares a mission's divisions with the truth.
#[derive(Debug)]
pub struct Scorer<'a> {
    mission: &'a Mission,
    places: HashMap<RobotId, usize>,
    ids: Vec<TeamId>,
    /// The team of each robot, by place in `ids`.
    found: Vec<Option<usize>>,
    /// The true team of each robot when its team was last changed for that.
    served: Vec<Option<usize>>,
    /// Changes of a robot's team that the truth does not have.
    needless: usize,
    series: Vec<Sample>,
}

impl<'a> Scorer<'a> {
    /// Nothing has been compared yet.
    #[must_use]
    pub fn new(mission: &'a Mission) -> Self {
        let robots = &mission.fleet.robots;
        let places = robots.iter().enumerate().map(|(place, robot)| (robot.name.clone(), place));
        let served = (0..robots.len()).map(|robot| mission.team(robot, 0.0)).collect();
        Self {
            mission,
            places: places.collect(),
            ids: Vec::new(),
            found: vec![None; robots.len()],
            served,
            needless: 0,
            series: Vec::new(),
        }
    }

    /// Compares the newest division with what is true at a moment.
    ///
    /// # Errors
    /// If there are too many teams to be matched.
    pub fn compare(
        &mut self,
        t: f64,
        silhouette: Option<f64>,
        dimension: u32,
    ) -> Result<(), MatchError> {
        let robots = self.found.len();
        let truth = self.truth(t);
        // Robots without a team are together in one that is none of the true ones.
        let none = self.ids.len();
        let found: Vec<usize> = self.found.iter().map(|id| id.unwrap_or(none)).collect();
        let rand = adjusted_rand_index(&compact(&found), &truth)?;
        let right = self.right(&truth)?;
        let share = |counts: &dyn Fn(usize) -> bool| {
            let of: Vec<usize> =
                (0..robots).filter(|at| truth[*at].is_some() && counts(*at)).collect();
            let good = of.iter().filter(|at| right[**at]).count();
            if of.is_empty() { 1.0 } else { good as f64 / of.len() as f64 }
        };
        let accuracy = share(&|_| true);
        let is_calm = !(0..robots).any(|robot| self.mission.is_involved(robot));
        let involved = share(&|robot| is_calm || self.mission.is_involved(robot));
        self.series.push(Sample { t, accuracy, involved, rand, silhouette, dimension });
        Ok(())
    }

    fn truth(&self, t: f64) -> Vec<Option<usize>> {
        (0..self.found.len()).map(|robot| self.mission.team(robot, t)).collect()
    }

    /// Accepts a division that has come at a moment, and counts the robots that have changed team for nothing.
    ///
    /// # Errors
    /// As [`Scorer::compare`].
    pub fn accept(&mut self, t: f64, teams: &Teams) -> Result<(), MatchError> {
        let mut found = vec![None; self.found.len()];
        for (robot, team) in teams.assignments() {
            let id = match self.ids.iter().position(|id| id == team) {
                Some(id) => id,
                None => {
                    self.ids.push(team.clone());
                    self.ids.len() - 1
                }
            };
            if let Some(place) = self.places.get(robot) {
                found[*place] = Some(id);
            }
        }
        let before = std::mem::replace(&mut self.found, found);
        if t < START_TIME_S || before == self.found {
            return Ok(());
        }
        let truth = self.truth(t);
        let right = self.right(&truth)?;
        for (robot, old) in before.iter().enumerate() {
            if *old == self.found[robot] || truth[robot].is_none() {
                continue;
            }
            if right[robot] && self.served[robot] != truth[robot] {
                self.served[robot] = truth[robot];
            } else {
                self.needless += 1;
            }
        }
        Ok(())
    }

    /// Whether each robot is in the right team.
    fn right(&self, truth: &[Option<usize>]) -> Result<Vec<bool>, MatchError> {
        let here: Vec<usize> = (0..truth.len()).filter(|at| self.found[*at].is_some()).collect();
        let found: Vec<usize> =
            compact(&here.iter().filter_map(|at| self.found[*at]).collect::<Vec<_>>());
        let of_those: Vec<Option<usize>> = here.iter().map(|at| truth[*at]).collect();
        let count = found.iter().max().map_or(0, |most| most + 1);
        let true_teams = self.mission.fleet.teams + 1;
        let table = overlap_table(&found, count, &of_those, true_teams)?;
        let matched = match_by_overlap(&table)?;
        let mut right = vec![false; truth.len()];
        for ((robot, team), truth) in here.iter().zip(&found).zip(&of_those) {
            right[*robot] = truth.is_some() && matched[*team] == *truth;
        }
        Ok(right)
    }

    /// What has become of the mission.
    #[must_use]
    pub fn outcome(self) -> Outcome {
        let end = self.mission.case.lasts_s();
        let points: Vec<(f64, Act)> = self.mission.turning_points().collect();
        let next = |at: usize| points.get(at + 1).map_or(end, |(next, _)| *next);
        let followings = points
            .iter()
            .enumerate()
            .map(|(number, (at, act))| Following {
                at: *at,
                act: *act,
                took_s: followed(&self.series, *at, next(number)),
                until_next_s: next(number) - at,
            })
            .collect();
        let minutes = (end - START_TIME_S) / 60.0;
        let needless_rate = self.needless as f64 / (minutes * self.found.len() as f64);
        Outcome { series: self.series, followings, needless: self.needless, needless_rate }
    }
}

/// After how many seconds [`FOLLOWED_SHARE`] of all robots and of those involved are in the right team, and stay so.
fn followed(series: &[Sample], at: f64, until: f64) -> Option<f64> {
    let within: Vec<&Sample> =
        series.iter().filter(|s| s.t >= at - 1e-9 && s.t < until - 1e-9).collect();
    let is_good =
        |sample: &&&Sample| sample.accuracy >= FOLLOWED_SHARE && sample.involved >= FOLLOWED_SHARE;
    let good = within.iter().rev().take_while(is_good).count();
    // A moment before the end proves nothing.
    (good >= LEAST_SAMPLES).then(|| within[within.len() - good].t - at)
}

/// The same labels by numbers from 0 without gaps.
fn compact(labels: &[usize]) -> Vec<usize> {
    let all: Vec<usize> = labels.iter().copied().collect::<BTreeSet<_>>().into_iter().collect();
    labels.iter().map(|label| all.partition_point(|other| other < label)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(t: f64, accuracy: f64) -> Sample {
        Sample { t, accuracy, involved: 1.0, rand: 1.0, silhouette: None, dimension: 4 }
    }

    #[test]
    fn following_must_last() {
        let mut series: Vec<Sample> =
            (0..60).map(|step| sample(f64::from(step) / 10.0, 1.0)).collect();
        for step in [20, 21, 22, 25] {
            series[step].accuracy = 0.5;
        }
        let took = followed(&series, 2.0, 6.0);
        assert!(took.is_some_and(|took| (took - 0.6).abs() < 1e-9), "{took:?}");
        assert_eq!(followed(&series, 2.0, 3.5), None);
    }

    #[test]
    fn labels_are_compacted_in_order() {
        assert_eq!(compact(&[7, 2, 7, 9]), [1, 0, 1, 2]);
    }
}
