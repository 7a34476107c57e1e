//! k-means whose teams have limits (after Bradley, Bennett and Demiriz, *Constrained K-Means Clustering*, Microsoft
//! Research TR-2000-65).
//!
//! Points go to columns by an exact assignment at the least sum of squared distances, instead of each to its nearest
//! centroid; prices are kept from iteration to iteration. Exchanges move single points where the limits leave room,
//! and swap two points of two teams where they do not. Clusters are teams with limits of their own, so that they keep
//! the numbers that the rules give them.

mod exact;
mod exchange;
mod places;
mod seeding;
mod start;

use std::collections::BTreeSet;

use rayon::prelude::*;
use thiserror::Error;

use super::division::{INERTIA_TIE, KMeansError, RESTARTS_PER_THREAD};
use super::options::{KMeansOptions, ValidKMeansOptions};
use super::points::Points;
use crate::assignment::{AssignmentError, Column, CostError, CostMatrix, ValidRules};
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::parallel::Threads;
use crate::linalg::vector::squared_distance;
use start::{Divided, Later, Task};

/// What a division has to respect.
#[derive(Debug, Clone, Copy)]
pub struct KMeansLimits<'a> {
    /// Limits of the teams, which are the clusters, for as many robots as points. Soft minima come before nearness: of two
    /// divisions the one whose missing robots have the lesser prices is better, whatever its inertia. Their prices count
    /// in the assignments in units of which the largest distance has 2³², and should be above that.
    pub rules: &'a ValidRules,
    /// What a point in the reserve adds to the inertia, at least 0, in squared units of the points.
    pub reserve_cost: f64,
    /// Column of every point in the previous division, if there was one; `None` for a new point. It takes the place of
    /// [`KMeansOptions::warm_labels`], which is not read.
    pub previous: Option<&'a [Option<Column>]>,
    /// Whether the previous division is only refined, if there was one, and no restart is tried.
    pub refine_only: bool,
}

/// A division of N points that respects limits.
#[derive(Debug, Clone, PartialEq)]
pub struct LimitedKMeans {
    /// Column of every point.
    pub columns: Vec<Column>,
    /// Mean of every team, one row each; where a team is empty, the centroid that it would start with.
    pub centroids: DenseMatrix,
    /// Sum of squared distances of the points to their centroids, and of the costs of those in the reserve.
    pub inertia: f64,
    /// Assignments and exchange passes of the start that won.
    pub iterations: usize,
    /// True when that start reached a fixed point within its iterations.
    pub converged: bool,
    /// True when the previous division, refined, was kept.
    pub warm: bool,
}

/// Why points could not be divided under limits.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum LimitedKMeansError {
    /// The parameters or points are wrong for any division.
    #[error(transparent)]
    KMeans(#[from] KMeansError),
    /// The limits are for another number of teams.
    #[error("{clusters} clusters, but limits of {teams} teams")]
    Teams {
        /// Clusters asked for.
        clusters: usize,
        /// Teams of the rules.
        teams: usize,
    },
    /// The limits are for another number of points.
    #[error("{points} points, but limits for {robots} robots")]
    Robots {
        /// Points given.
        points: usize,
        /// Robots of the rules.
        robots: usize,
    },
    /// The previous division has another number of points.
    #[error("{columns} previous columns for {points} points")]
    Previous {
        /// Columns given.
        columns: usize,
        /// Points given.
        points: usize,
    },
    /// The cost of the reserve is negative or not a number.
    #[error("the cost of the reserve is {0}: it must be a number from 0 on")]
    ReserveCost(f64),
    /// The costs do not fit integers.
    #[error(transparent)]
    Costs(#[from] CostError),
    /// No assignment satisfies the rules.
    #[error(transparent)]
    Assignment(#[from] AssignmentError),
}

impl ValidKMeansOptions<'_> {
    /// Divides the rows of `x`, N × D, into the teams of `limits` so that the sum of squared distances to the means of
    /// the teams is small.
    ///
    /// Takes the best of all restarts, and of up to ten points the best division of all where a bounded search ends. A
    /// previous division is refined, and kept unless a restart is better by more than the hysteresis, as by
    /// [`ValidKMeansOptions::divide`]; its columns keep their numbers. Of several optimal assignments the result is one;
    /// it depends on the input alone.
    ///
    /// # Errors
    /// [`LimitedKMeansError`], with a conflict if no division satisfies the rules.
    pub fn divide_within(
        &self,
        x: &DenseMatrix,
        limits: &KMeansLimits<'_>,
    ) -> Result<LimitedKMeans, LimitedKMeansError> {
        let options = self.get();
        check(x, options, limits)?;
        let threads = Threads::new(options.threads);
        let points = threads.run(|| Points::new(x, 1));
        let task = Task::new(&points, options, limits);
        if limits.refine_only
            && let Some(kept) = task.refined()?
        {
            return Ok(finished(kept, limits.rules, true));
        }
        let mut visited = BTreeSet::new();
        let visit = |key: u64| {
            visited.insert(key);
            Ok::<(), LimitedKMeansError>(())
        };
        let mut best = threads.run(|| task.start(0, visit))?;
        let parallel = threads.count() > 1;
        let batch = if parallel { threads.count() * RESTARTS_PER_THREAD } else { 1 };
        for first in (1..options.restarts).step_by(batch) {
            let numbers = first..options.restarts.min(first + batch);
            let run = |number: usize| task.later_start(number as u64, &visited);
            let found: Result<Vec<Later>, LimitedKMeansError> = threads.run(|| match parallel {
                true => numbers.into_par_iter().map(run).collect(),
                false => numbers.map(run).collect(),
            });
            for Later { visited: keys, found } in found? {
                visited.extend(keys);
                if let Some(next) = found
                    && (next.shortfall < best.shortfall
                        || next.shortfall == best.shortfall
                            && next.inertia < best.inertia * (1.0 - INERTIA_TIE))
                {
                    best = next;
                }
            }
        }
        best = task.searched(best);
        let mut warm = false;
        if let Some(kept) = task.refined()? {
            let noise = INERTIA_TIE * spread(x);
            warm = kept.shortfall < best.shortfall
                || kept.shortfall == best.shortfall
                    && kept.inertia <= (1.0 + options.hysteresis) * best.inertia + noise;
            if warm {
                best = kept;
            }
        }
        Ok(finished(best, limits.rules, warm))
    }
}

/// The division that a start found.
fn finished(found: Divided, rules: &ValidRules, warm: bool) -> LimitedKMeans {
    let Divided { labels, centroids, inertia, iterations, converged, shortfall: _ } = found;
    let teams = rules.get().teams.len();
    let column = |at: &u32| {
        let at = *at as usize;
        if at < teams { Column::Team(at) } else { Column::Reserve }
    };
    let columns = labels.iter().map(column).collect();
    LimitedKMeans { columns, centroids, inertia, iterations, converged, warm }
}

/// Refuses what does not fit together.
fn check(
    x: &DenseMatrix,
    options: &KMeansOptions<'_>,
    limits: &KMeansLimits<'_>,
) -> Result<(), LimitedKMeansError> {
    let rules = limits.rules.get();
    let (points, clusters) = (x.rows(), options.clusters);
    let (robots, teams) = (rules.robots, rules.teams.len());
    if points == 0 {
        return Err(KMeansError::NoPoints.into());
    }
    if clusters > points {
        return Err(KMeansError::Clusters { clusters, points }.into());
    }
    if clusters != teams {
        return Err(LimitedKMeansError::Teams { clusters, teams });
    }
    if points != robots {
        return Err(LimitedKMeansError::Robots { points, robots });
    }
    if let Some(columns) = limits.previous.map(<[_]>::len)
        && columns != points
    {
        return Err(LimitedKMeansError::Previous { columns, points });
    }
    if !(limits.reserve_cost.is_finite() && limits.reserve_cost >= 0.0) {
        return Err(LimitedKMeansError::ReserveCost(limits.reserve_cost));
    }
    Ok(())
}

/// Sum of squared distances of all points from their mean.
fn spread(x: &DenseMatrix) -> f64 {
    let mean: Vec<f64> = (0..x.cols())
        .map(|j| x.iter_rows().map(|row| row[j]).sum::<f64>() / x.rows() as f64)
        .collect();
    x.iter_rows().map(|row| squared_distance(row, &mean)).sum()
}

/// Unit of squared distances of these points, in which costs are integers.
fn cost_unit(points: &Points<'_>) -> f64 {
    // No two points, and no point and a mean, are further apart than twice the longest centred row.
    CostMatrix::unit_for(4.0 * points.pack().squares.iter().fold(0.0, |a: f64, b| a.max(*b)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assignment::{Bounds, Rules};
    use crate::cluster::kmeans::options::Init;

    /// A number from 0 to 1 for each pair of numbers.
    fn noise(a: u64, b: u64) -> f64 {
        let mixed = (a << 32 | b).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        ((mixed ^ mixed >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 11) as f64 / 2_f64.powi(53)
    }

    #[test]
    fn starts_that_are_left_out_would_have_found_nothing_better() {
        let mut left_out = 0;
        for case in 0..30 {
            let at = |row: usize, column: usize| noise(case, (2 * row + column) as u64);
            let x = DenseMatrix::from_fn(40, 2, |row, column| {
                at(row, column) + if case % 2 == 0 { 3.0 * (row % 4) as f64 } else { 0.0 }
            });
            let rules = Rules { teams: vec![Bounds::new(5, 12); 4], ..Rules::new(40, 4) };
            let rules = rules.check().unwrap();
            let options = KMeansOptions {
                clusters: 4,
                init: Init::PlusPlus,
                restarts: 30,
                max_iterations: 100,
                seed: case,
                warm_labels: None,
                hysteresis: 0.0,
                threads: 1,
            };
            let options = options.check().unwrap();
            let limits = KMeansLimits {
                rules: &rules,
                reserve_cost: 0.0,
                previous: None,
                refine_only: false,
            };
            let found = options.divide_within(&x, &limits).unwrap();
            let points = Points::new(&x, 1);
            let task = Task::new(&points, options.get(), &limits);
            let mut visited = BTreeSet::new();
            for number in 0..30 {
                let every = task.start(number, |_| Ok::<(), LimitedKMeansError>(())).unwrap();
                assert!(
                    found.inertia <= every.inertia * (1.0 + 2.0 * INERTIA_TIE),
                    "case {case}, start {number}: {} and {}",
                    found.inertia,
                    every.inertia
                );
                let later = task.later_start(number, &visited).unwrap();
                left_out += usize::from(later.found.is_none());
                visited.extend(later.visited);
            }
        }
        assert!(left_out > 200, "{left_out} of 900 starts were left out");
    }
}
