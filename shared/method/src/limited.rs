//! From vectors to teams that have limits: k-means over the robots with an embedding, whose assignments are exact.

use muster_numeric::assignment::{Assigner, Column, CostError, CostMatrix, ValidRules};
use muster_numeric::kmeans::{KMeansLimits, KMeansOptions, LimitedKMeansError};
use muster_numeric::matrix::{DenseMatrix, MatrixError};

use crate::division::Division;
use crate::params::ValidDivisionParams;

/// Share of the sum of squared distances below which a difference is rounding: costs are integers, of which the largest
/// is 2³².
const ROUNDING_SHARE: f64 = 1e-6;

/// What a robot without a place costs, in multiples of the largest squared distance that two robots can have: more than
/// any other robot could save by taking the place.
const RESERVE_FACTOR: f64 = 4.0;

/// What a division has to respect.
#[derive(Debug, Clone, Copy)]
pub struct Limits<'a> {
    /// Limits of the teams, for as many robots as there are rows.
    pub rules: &'a ValidRules,
    /// Column of every robot in the previous division; `None` for a new robot.
    pub previous: &'a [Option<Column>],
}

/// How far a division is from the best assignment of its robots.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Optimality {
    /// Whether no assignment to these teams under the limits has a lesser sum of squared distances to the centroids.
    pub optimal: bool,
    /// By which share the sum could be lower at most, from 0 to 1.
    pub gap: f64,
}

/// Divides robots, each a row of `x`, N × D, into the teams of `limits`. Labels are the numbers of the teams; a robot in
/// the reserve has none.
///
/// # Errors
/// [`LimitedKMeansError`]; with a conflict where nothing satisfies the limits.
pub fn divide_within(
    x: &DenseMatrix,
    params: &ValidDivisionParams,
    limits: &Limits<'_>,
) -> Result<Division, LimitedKMeansError> {
    let options = KMeansOptions {
        clusters: limits.rules.get().teams.len(),
        init: params.init,
        restarts: params.restarts,
        max_iterations: params.max_iterations,
        seed: params.seed,
        warm_labels: None,
        hysteresis: params.hysteresis,
        threads: params.threads,
    };
    let options = options.check().map_err(muster_numeric::kmeans::KMeansError::from)?;
    let reserve_cost = RESERVE_FACTOR * largest_distance(x);
    let previous = Some(limits.previous);
    let found =
        options.divide_within(x, &KMeansLimits { rules: limits.rules, reserve_cost, previous })?;
    let label = |column: &Column| match column {
        Column::Team(team) => Some(*team),
        Column::Reserve => None,
    };
    Ok(Division {
        labels: found.columns.iter().map(label).collect(),
        centroids: found.centroids,
        inertia: found.inertia,
        iterations: found.iterations,
        converged: found.converged,
    })
}

/// A bound of the squared distance of two rows that is above zero.
fn largest_distance(x: &DenseMatrix) -> f64 {
    let square = |row: &[f64]| row.iter().map(|value| value * value).sum::<f64>();
    let most = x.iter_rows().map(square).fold(0.0, f64::max);
    if most > 0.0 { 4.0 * most } else { 1.0 }
}

/// How far the robots of a division, each a row of `x`, are from the best assignment to its centroids under `rules`,
/// which have no reserve.
///
/// # Errors
/// [`CostError`] if distances are no numbers.
#[expect(clippy::cast_precision_loss, reason = "the share needs no more than 53 bits")]
pub fn optimality(
    x: &DenseMatrix,
    labels: &[usize],
    centroids: &DenseMatrix,
    rules: &ValidRules,
) -> Result<Optimality, CostError> {
    let costs = costs(x, centroids)?;
    let own = |(robot, team): (usize, &usize)| i128::from(costs.row(robot)[*team]);
    let cost: i128 = labels.iter().enumerate().map(own).sum();
    let best = match Assigner::new().solve(rules, &costs) {
        Ok(best) => best.cost,
        // The labels do not satisfy the rules either.
        Err(_) => return Ok(Optimality { optimal: false, gap: 1.0 }),
    };
    let gap = if cost > 0 { ((cost - best) as f64 / cost as f64).clamp(0.0, 1.0) } else { 0.0 };
    if gap <= ROUNDING_SHARE {
        return Ok(Optimality { optimal: true, gap: 0.0 });
    }
    Ok(Optimality { optimal: false, gap })
}

/// Squared distances of rows to centroids, as integers.
fn costs(x: &DenseMatrix, centroids: &DenseMatrix) -> Result<CostMatrix, CostError> {
    let distance = |row: &[f64], centroid: &[f64]| {
        row.iter().zip(centroid).map(|(x, c)| (x - c).powi(2)).sum::<f64>()
    };
    let rows = x.iter_rows();
    let values: Vec<f64> =
        rows.flat_map(|row| centroids.iter_rows().map(move |c| distance(row, c))).collect();
    let unit = CostMatrix::unit_for(values.iter().fold(0.0, |most: f64, value| most.max(*value)));
    CostMatrix::from_floats(x.rows(), centroids.rows(), &values, unit)
}

/// The rows of some robots.
///
/// # Errors
/// [`MatrixError`] if a value is none.
pub fn rows_of(
    values: &[f64],
    dimension: usize,
    rows: &[usize],
) -> Result<DenseMatrix, MatrixError> {
    let row = |row: &usize| &values[row * dimension..(row + 1) * dimension];
    DenseMatrix::new(rows.len(), dimension, rows.iter().flat_map(row).copied().collect())
}

#[cfg(test)]
mod tests {
    use muster_numeric::assignment::{Bounds, Rules};

    use super::*;
    use crate::params::DivisionParams;

    fn line(points: &[f64]) -> DenseMatrix {
        DenseMatrix::new(points.len(), 1, points.to_vec()).unwrap()
    }

    fn rules(robots: usize, teams: &[Bounds], reserve: Option<Bounds>) -> ValidRules {
        let rules = Rules { robots, teams: teams.to_vec(), reserve, ..Rules::default() };
        rules.check().unwrap()
    }

    #[test]
    fn limits_hold_and_the_assignment_is_the_best() {
        let x = line(&[0.0, 0.1, 0.2, 0.3, 5.0]);
        let rules = rules(5, &[Bounds::new(2, 3), Bounds::new(2, 3)], None);
        let params = DivisionParams { teams: 2, ..DivisionParams::default() }.check().unwrap();
        let limits = Limits { rules: &rules, previous: &[None; 5] };
        let found = divide_within(&x, &params, &limits).unwrap();
        let far = found.labels[4];
        assert_eq!(found.labels.iter().filter(|label| **label == far).count(), 2);
        assert_eq!(found.labels[3], far, "the nearest of the others");
        let labels: Vec<usize> = found.labels.iter().flatten().copied().collect();
        let judged = optimality(&x, &labels, &found.centroids, &rules).unwrap();
        assert_eq!(judged, Optimality { optimal: true, gap: 0.0 });
        let worse: Vec<usize> = vec![labels[0], labels[0], labels[3], labels[0], labels[3]];
        let judged = optimality(&x, &worse, &found.centroids, &rules).unwrap();
        assert!(!judged.optimal && judged.gap > 0.0 && judged.gap < 1.0, "{judged:?}");
    }

    #[test]
    fn who_has_no_place_is_in_the_reserve() {
        let x = line(&[0.0, 0.1, 9.0]);
        let rules = rules(3, &[Bounds::at_most(2)], Some(Bounds::ANY));
        let params = DivisionParams { teams: 1, ..DivisionParams::default() }.check().unwrap();
        let limits = Limits { rules: &rules, previous: &[None; 3] };
        let found = divide_within(&x, &params, &limits).unwrap();
        assert_eq!(found.labels, [Some(0), Some(0), None]);
    }
}
