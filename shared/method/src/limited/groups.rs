//! k-means where robots are to be together or apart, or where skills are needed that robots share: each assignment is a search.

use std::collections::BTreeSet;

use muster_numeric::assignment::{
    Assigner, Bounds, Column, Relation, ValidRules, assign_with_wishes,
};
use muster_numeric::kmeans::count_distinct;
use muster_numeric::matrix::{DenseMatrix, MatrixError};

use super::{LimitedError, Limits, costs, shortfall, square};
use crate::division::Division;

/// Most flows of one assignment that is to grant wishes of groups: a number and no time, so that a replay is the same.
/// Those of 500 robots and 8 teams take some tens of milliseconds.
pub(super) const NODE_BUDGET: usize = 64;

/// Most assignments of one start that is to grant wishes of groups.
const MAX_GROUP_ITERATIONS: usize = 20;

/// Most teams that are filled one by one where not all can be at once: each is a division of its own.
const MAX_SINGLE_FILLS: usize = 8;

/// Robots divided so that the wishes of groups are granted, from some centroids on. The column before costs the share `keep`
/// only. No team is empty that could have a robot without lacking more of what is soft.
pub(super) fn grouped(
    x: &DenseMatrix,
    limits: &Limits<'_>,
    centroids: DenseMatrix,
    keep: f64,
) -> Result<Division, LimitedError> {
    let mut found = assigned(x, limits, centroids, keep)?;
    let empty = empty_teams(limits, &found.labels);
    let filled = found.labels.iter().flatten().collect::<BTreeSet<_>>().len();
    let room = most_teams(x, limits).saturating_sub(filled).min(empty.len());
    if room == 0 {
        return Ok(found);
    }
    let lacks = |found: &Division| shortfall(limits.rules, limits.groups, &found.labels);
    let with = |found: &Division, more: &[usize]| {
        let rules = with_robots_in(limits.rules, &found.labels, more)?;
        let limits = Limits { rules: &rules, ..*limits };
        let filled = assigned(x, &limits, found.centroids.clone(), keep).ok()?;
        (lacks(&filled) <= lacks(found)).then_some(filled)
    };
    if let Some(filled) = with(&found, &empty[..room]) {
        return Ok(filled);
    }
    for team in empty.into_iter().take(MAX_SINGLE_FILLS) {
        if let Some(filled) = with(&found, &[team]) {
            found = filled;
        }
    }
    Ok(found)
}

/// The teams without robots that may have one, those first that had some before.
fn empty_teams(limits: &Limits<'_>, labels: &[Option<usize>]) -> Vec<usize> {
    let bounds = limits.rules.get().teams.iter().enumerate();
    let may_have_robots =
        |team: usize| (0..labels.len()).any(|robot| limits.rules.allows(robot, Column::Team(team)));
    let is_empty = |(team, bounds): (usize, &Bounds)| {
        bounds.upper > 0 && !labels.contains(&Some(team)) && may_have_robots(team)
    };
    let mut empty: Vec<usize> =
        bounds.filter(|bounds| is_empty(*bounds)).map(|(team, _)| team).collect();
    empty.sort_by_key(|team| !limits.previous.contains(&Some(Column::Team(*team))));
    empty
}

/// A bound of how many teams there may be: robots in one place, and those that must be together, are in one.
fn most_teams(x: &DenseMatrix, limits: &Limits<'_>) -> usize {
    let mut group: Vec<usize> = (0..x.rows()).collect();
    for wish in &limits.groups.get().wishes {
        if wish.relation == Relation::Together && wish.price.is_none() {
            let joined: BTreeSet<usize> = wish.robots.iter().map(|robot| group[*robot]).collect();
            let first = joined.first().copied();
            for of in group.iter_mut().filter(|of| joined.contains(of)) {
                *of = first.unwrap_or(*of);
            }
        }
    }
    let groups = group.iter().collect::<BTreeSet<_>>().len();
    groups.min(count_distinct(x, limits.rules.get().teams.len()))
}

/// The rules with a robot in each team that has one, and in `more`.
fn with_robots_in(
    rules: &ValidRules,
    labels: &[Option<usize>],
    more: &[usize],
) -> Option<ValidRules> {
    let mut filled = rules.get().clone();
    for (team, bounds) in filled.teams.iter_mut().enumerate() {
        if labels.contains(&Some(team)) || more.contains(&team) {
            bounds.lower = bounds.lower.max(1);
        }
    }
    filled.check().ok()
}

/// Assignments that grant the wishes of groups, each followed by the means of the teams, until they stay.
fn assigned(
    x: &DenseMatrix,
    limits: &Limits<'_>,
    mut centroids: DenseMatrix,
    keep: f64,
) -> Result<Division, LimitedError> {
    let mut assigner = Assigner::new();
    assigner.set_previous(limits.rules, limits.previous);
    let mut labels: Vec<Option<usize>> = Vec::new();
    let (mut iterations, mut converged) = (0, false);
    while iterations < MAX_GROUP_ITERATIONS && !converged {
        iterations += 1;
        let (costs, _) = costs(x, &centroids, |robot, column| {
            let stays = limits.previous.get(robot) == Some(&Some(Column::Team(column)));
            if stays { keep } else { 1.0 }
        })?;
        let rules = limits.rules;
        let found = assign_with_wishes(&mut assigner, rules, limits.groups, &costs, NODE_BUDGET);
        let found = match found {
            Ok(found) => found,
            // The search was cut short. What was found before satisfies all that is asked.
            Err(_) if !labels.is_empty() => break,
            Err(error) => return Err(error.into()),
        };
        let team = |column: &Column| match column {
            Column::Team(team) => Some(*team),
            Column::Reserve => None,
        };
        let next: Vec<Option<usize>> = found.columns.iter().map(team).collect();
        converged = next == labels;
        labels = next;
        centroids = means(x, &labels, &centroids)?;
    }
    let far = |(row, label): (&[f64], &Option<usize>)| Some(square(row, centroids.row((*label)?)));
    // The sum of nothing would be -0.
    let inertia = x.iter_rows().zip(&labels).filter_map(far).fold(0.0, |sum, square| sum + square);
    Ok(Division { labels, centroids, inertia, iterations, converged })
}

/// The mean row of each label; of a label without rows the one that it had.
#[expect(clippy::cast_precision_loss, reason = "there are fewer than 2⁵³ robots")]
pub(super) fn means(
    x: &DenseMatrix,
    labels: &[Option<usize>],
    before: &DenseMatrix,
) -> Result<DenseMatrix, MatrixError> {
    let mut sums = vec![0.0; before.rows() * x.cols()];
    let mut sizes = vec![0_usize; before.rows()];
    for (row, label) in x.iter_rows().zip(labels) {
        let Some(label) = label.filter(|label| *label < sizes.len()) else { continue };
        sizes[label] += 1;
        for (sum, value) in sums[label * x.cols()..].iter_mut().zip(row) {
            *sum += value;
        }
    }
    for (label, size) in sizes.into_iter().enumerate() {
        let sums = &mut sums[label * x.cols()..(label + 1) * x.cols()];
        if size == 0 {
            sums.copy_from_slice(before.row(label));
        }
        sums.iter_mut().for_each(|sum| *sum /= size.max(1) as f64);
    }
    DenseMatrix::new(before.rows(), x.cols(), sums)
}
