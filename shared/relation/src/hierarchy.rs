//! Hierarchy: rank reports to edges from superiors to their subordinates.

use crate::edge::{Edge, EdgeError, relation_edges};

/// Strength of a tie whose report gives none.
pub const DEFAULT_TIE: f64 = 1.0;

/// One edge from each superior to each of its subordinates.
///
/// Each report is a robot, its superior (none at the top) and the strength of the tie
/// (dimensionless, 0 to 1e6, [`DEFAULT_TIE`] if left out). Ties of strength 0 are dropped. Robots
/// may be superior to each other in a circle: hierarchies are not checked.
///
/// # Errors
/// Names the first robot that is its own superior, that has a tie out of range, or that reports the
/// same superior twice.
pub fn hierarchy_edges(
    ranks: impl IntoIterator<Item = (u32, Option<u32>, Option<f64>)>,
) -> Result<Vec<Edge>, EdgeError> {
    relation_edges(ranks.into_iter().filter_map(|(robot, superior, weight)| {
        superior.map(|superior| (superior, robot, weight.unwrap_or(DEFAULT_TIE)))
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_run_from_the_superior_down() {
        let ranks =
            [(0, None, None), (1, Some(0), Some(0.5)), (2, Some(1), None), (3, Some(0), Some(0.0))];
        assert_eq!(hierarchy_edges(ranks), Ok(vec![(0, 1, 0.5), (1, 2, 1.0)]));
    }

    #[test]
    fn circles_are_allowed_but_no_robot_is_its_own_superior() {
        assert!(hierarchy_edges([(0, Some(1), None), (1, Some(0), None)]).is_ok());
        assert_eq!(
            hierarchy_edges([(4, Some(4), None)]),
            Err(EdgeError::SelfRelation { robot: 4 })
        );
        assert!(hierarchy_edges([(1, Some(0), Some(f64::NAN))]).is_err());
    }
}
