//! How good a division is.

use muster_numeric::agreement;
use muster_numeric::matching::{MatchError, match_by_overlap, overlap_table};

/// Robots that are in the right team, and how many count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Correct {
    /// Robots in the right team.
    pub right: u64,
    /// Robots that count.
    pub total: u64,
}

impl Correct {
    /// The share of those that are right; 1 where none counts.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "counts are far below 2⁵³")]
    pub fn share(self) -> f64 {
        if self.total == 0 { 1.0 } else { self.right as f64 / self.total as f64 }
    }
}

impl std::ops::AddAssign for Correct {
    fn add_assign(&mut self, other: Self) {
        self.right += other.right;
        self.total += other.total;
    }
}

/// Robots in the right team when the teams that were found are matched with the true ones so that the most
/// are (Kuhn 1955, Munkres 1957). `truth` has no team for robots that do not count.
///
/// # Errors
/// If both are not of the same robots.
pub fn correct(found: &[usize], truth: &[Option<usize>]) -> Result<Correct, MatchError> {
    let table = table(found, truth)?;
    let matched = match_by_overlap(&table)?;
    let right =
        table.iter().zip(matched).filter_map(|(row, team)| team.map(|team| row[team])).sum();
    Ok(Correct { right, total: truth.iter().flatten().count() as u64 })
}

/// The Rand index adjusted for chance ([`muster_numeric::agreement`]). Robots without a true team do not count.
///
/// # Errors
/// If both are not of the same robots.
pub fn adjusted_rand_index(found: &[usize], truth: &[Option<usize>]) -> Result<f64, MatchError> {
    if found.len() != truth.len() {
        return Err(MatchError::Labels { new: found.len(), old: truth.len() });
    }
    let both = found.iter().zip(truth).filter_map(|(found, truth)| Some((*found, (*truth)?)));
    Ok(agreement::adjusted_rand_index(both))
}

/// Robots by the team that was found (rows) and the true one.
fn table(found: &[usize], truth: &[Option<usize>]) -> Result<Vec<Vec<u64>>, MatchError> {
    let teams = found.iter().max().map_or(0, |team| team + 1);
    let true_teams = truth.iter().flatten().max().map_or(0, |team| team + 1);
    overlap_table(found, teams, truth, true_teams)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_teams_do_not_matter_and_the_best_matching_counts() {
        let truth = [Some(0), Some(0), Some(1), Some(1), None];
        let score = |found: [usize; 5]| correct(&found, &truth).unwrap();
        assert_eq!(score([1, 1, 0, 0, 0]), Correct { right: 4, total: 4 });
        assert_eq!(score([0, 1, 1, 1, 2]), Correct { right: 3, total: 4 });
        assert_eq!(score([0, 0, 0, 0, 0]), Correct { right: 2, total: 4 });
        assert!(correct(&[0], &truth).is_err());
        assert_eq!(Correct::default().share(), 1.0);
    }

    #[test]
    fn the_rand_index_is_that_of_the_literature() {
        // The example of scikit-learn's documentation: 4/7 of the way from chance.
        let truth = [0, 0, 1, 1].map(Some);
        let index = |found: [usize; 4]| adjusted_rand_index(&found, &truth).unwrap();
        assert_eq!(index([1, 1, 0, 0]), 1.0);
        assert!((index([0, 0, 1, 2]) - 4.0 / 7.0).abs() < 1e-15);
        assert!(index([0, 1, 0, 1]) < 0.0);
        assert_eq!(index([0; 4]), 0.0);
    }
}
