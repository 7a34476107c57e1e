//! From vectors to teams: k-means over the robots with an embedding.

use std::borrow::Cow;
use std::collections::BTreeMap;

use muster_numeric::kmeans::{KMeansError, KMeansOptions, kmeans_with_progress};
use muster_numeric::margins::{MarginError, margins};
use muster_numeric::matrix::DenseMatrix;

use crate::params::ValidDivisionParams;
use crate::step::{Progress, Step};

/// A division of N robots.
#[derive(Debug, Clone, PartialEq)]
pub struct Division {
    /// The team of each robot, numbered by first appearance; none for a robot without an embedding.
    pub labels: Vec<Option<usize>>,
    /// The mean row of each team; fewer rows than teams were asked for where fewer are distinct.
    pub centroids: DenseMatrix,
    /// Sum of squared distances of the robots to the mean rows of their teams.
    pub inertia: f64,
    /// Iterations of the start that was best.
    pub iterations: usize,
    /// Whether that start reached a fixed point within its iterations.
    pub converged: bool,
}

/// A division with a number for every robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Numbered {
    /// The number of each robot.
    pub labels: Vec<usize>,
    /// The number that robots without an embedding share; it is no team.
    pub unassigned: Option<usize>,
}

/// Divides the robots whose rows are those of `x`, N × D. `without_embedding` states of each robot whether it
/// is to be left out; `previous` is the team of each robot before, any numbers, none for a robot without
/// one.
///
/// # Errors
/// [`KMeansError`] where the lists do not fit the rows.
pub fn divide(
    x: &DenseMatrix,
    without_embedding: &[bool],
    params: &ValidDivisionParams,
    previous: Option<&[Option<usize>]>,
    progress: &mut Progress<'_>,
) -> Result<Division, KMeansError> {
    let rows = rows_with_embedding(without_embedding);
    if rows.is_empty() {
        return Ok(Division {
            labels: vec![None; x.rows()],
            centroids: x.select_rows(&[]),
            inertia: 0.0,
            iterations: 0,
            converged: true,
        });
    }
    let warm: Option<Vec<Option<usize>>> =
        previous.map(|teams| rows.iter().map(|&i| teams.get(i).copied().flatten()).collect());
    let restarts = params.restarts;
    let options = KMeansOptions {
        clusters: params.teams.min(rows.len()),
        init: params.init,
        restarts,
        max_iterations: params.max_iterations,
        seed: params.seed,
        warm_labels: warm.as_deref(),
        hysteresis: params.hysteresis,
        threads: params.threads,
    };
    progress(Step::KMeans { done: 0, restarts });
    let mut watch = |done| progress(Step::KMeans { done, restarts });
    let found = kmeans_with_progress(&selected(x, &rows), &options, &mut watch)?;
    let mut labels = vec![None; x.rows()];
    for (&row, label) in rows.iter().zip(found.labels) {
        labels[row] = Some(label);
    }
    Ok(Division {
        labels,
        centroids: found.centroids,
        inertia: found.inertia,
        iterations: found.iterations,
        converged: found.converged,
    })
}

impl Division {
    /// One number per robot, by first appearance. Robots without an embedding share a number of their own,
    /// which is returned with the list if there are any.
    #[must_use]
    pub fn numbered(&self) -> Numbered {
        let mut numbers = BTreeMap::new();
        let mut number = |team: Option<usize>| {
            let next = numbers.len();
            *numbers.entry(team).or_insert(next)
        };
        let labels = self.labels.iter().map(|team| number(*team)).collect();
        Numbered { labels, unassigned: numbers.get(&None).copied() }
    }

    /// How clearly each robot belongs to its team, from 0 to 1 (see [`muster_numeric::margins`]); 0 for a
    /// robot without one. `x` holds the rows that were divided.
    ///
    /// # Errors
    /// [`MarginError`] for other rows.
    pub fn margins(&self, x: &DenseMatrix) -> Result<Vec<f64>, MarginError> {
        let rows: Vec<usize> =
            (0..self.labels.len()).filter(|&i| self.labels[i].is_some()).collect();
        let mut all = vec![0.0; self.labels.len()];
        if rows.is_empty() {
            return Ok(all);
        }
        let labels: Vec<usize> = self.labels.iter().flatten().copied().collect();
        let found = margins(&selected(x, &rows), &labels, &self.centroids)?;
        for (&row, margin) in rows.iter().zip(found) {
            all[row] = margin;
        }
        Ok(all)
    }
}

fn rows_with_embedding(without_embedding: &[bool]) -> Vec<usize> {
    (0..without_embedding.len()).filter(|&i| !without_embedding[i]).collect()
}

/// The rows, without a copy if they are all.
fn selected<'a>(x: &'a DenseMatrix, rows: &[usize]) -> Cow<'a, DenseMatrix> {
    if rows.len() == x.rows() { Cow::Borrowed(x) } else { Cow::Owned(x.select_rows(rows)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::DivisionParams;

    fn divided(rows: &[[f64; 2]], without: &[bool], teams: usize) -> Division {
        let x = DenseMatrix::from_rows(&rows.iter().map(|row| row.to_vec()).collect::<Vec<_>>());
        let params = DivisionParams { teams, ..DivisionParams::default() }.check().unwrap();
        divide(&x.unwrap(), without, &params, None, &mut |_| {}).unwrap()
    }

    #[test]
    fn robots_without_an_embedding_take_no_team() {
        let rows = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.9]];
        let found = divided(&rows, &[true, false, false, false], 2);
        assert_eq!(found.labels, [None, Some(0), Some(1), Some(1)]);
        let numbered = found.numbered();
        assert_eq!((numbered.labels, numbered.unassigned), (vec![0, 1, 2, 2], Some(0)));
        let none = divided(&rows, &[true; 4], 2);
        assert_eq!((none.labels, none.inertia), (vec![None; 4], 0.0));
    }

    #[test]
    fn there_are_no_more_teams_than_robots() {
        let found = divided(&[[1.0, 0.0], [0.0, 1.0]], &[false, false], 5);
        assert_eq!(found.labels, [Some(0), Some(1)]);
    }

    #[test]
    fn margins_are_of_the_robots_with_a_team() {
        let rows = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.4, 0.6]];
        let found = divided(&rows, &[true, false, false, false], 2);
        let x = DenseMatrix::from_rows(&rows.map(Vec::from)).unwrap();
        let margins = found.margins(&x).unwrap();
        assert_eq!(margins[0], 0.0);
        assert!(margins[1] > margins[3], "{margins:?}");
    }
}
