//! Edges, and the rules that every reported edge must keep.

use muster_model::limits::MAX_WEIGHT;

/// Source, target and weight of a directed edge between two robots, by index.
pub type Edge = (u32, u32, f64);

/// Why reported edges are refused. Robots are named by index.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum EdgeError {
    /// An edge starts where it ends: no robot relates to itself.
    #[error("robot {robot} is related to itself")]
    SelfRelation {
        /// The robot.
        robot: u32,
    },
    /// A weight is negative, too large or not a number.
    #[error(
        "the weight {weight} from robot {source_robot} to robot {target} is not within 0 to {limit:e}"
    )]
    Weight {
        /// Where the edge starts.
        source_robot: u32,
        /// Where the edge ends.
        target: u32,
        /// The weight.
        weight: f64,
        /// The largest weight that is allowed here.
        limit: f64,
    },
    /// The same edge is reported twice, so that its weight is not known.
    #[error("the edge from robot {source_robot} to robot {target} is reported twice")]
    Twice {
        /// Where the edge starts.
        source_robot: u32,
        /// Where the edge ends.
        target: u32,
    },
}

/// Checks and orders the edges of a declared modality. Edges of weight 0 are dropped: they
/// mean no relation. Weights are dimensionless.
///
/// # Errors
/// Names the first edge that relates a robot to itself, that has a weight outside of
/// 0 to [`MAX_WEIGHT`], or that is reported twice.
pub fn relation_edges(edges: impl IntoIterator<Item = Edge>) -> Result<Vec<Edge>, EdgeError> {
    checked_edges(edges, MAX_WEIGHT)
}

/// The rules of [`relation_edges`] with another limit on the weights.
pub(crate) fn checked_edges(
    edges: impl IntoIterator<Item = Edge>,
    limit: f64,
) -> Result<Vec<Edge>, EdgeError> {
    let mut edges: Vec<Edge> = edges.into_iter().collect();
    for &(source_robot, target, weight) in &edges {
        if source_robot == target {
            return Err(EdgeError::SelfRelation { robot: source_robot });
        }
        if !(0.0..=limit).contains(&weight) {
            return Err(EdgeError::Weight { source_robot, target, weight, limit });
        }
    }
    edges.sort_unstable_by_key(|&(source, target, _)| (source, target));
    // Before the zeros go: 0 and 0.7 for the same edge contradict each other as 0.1 and 0.7 do.
    for (left, right) in edges.iter().zip(edges.iter().skip(1)) {
        if (left.0, left.1) == (right.0, right.1) {
            return Err(EdgeError::Twice { source_robot: left.0, target: left.1 });
        }
    }
    edges.retain(|&(_, _, weight)| weight > 0.0);
    Ok(edges)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_come_out_ordered_and_without_zeros() {
        let edges = relation_edges([(2, 0, 1.0), (0, 2, 3.0), (0, 1, 0.0), (1, 0, -0.0)]);
        assert_eq!(edges, Ok(vec![(0, 2, 3.0), (2, 0, 1.0)]));
        assert_eq!(relation_edges([]), Ok(Vec::new()));
    }

    #[test]
    fn bad_edges_are_refused_by_name() {
        assert_eq!(relation_edges([(3, 3, 1.0)]), Err(EdgeError::SelfRelation { robot: 3 }));
        for weight in [-1.0, f64::NAN, f64::INFINITY, 2.0 * MAX_WEIGHT] {
            let error = relation_edges([(0, 1, weight)]).unwrap_err();
            assert!(matches!(error, EdgeError::Weight { source_robot: 0, target: 1, .. }));
            assert!(error.to_string().contains("from robot 0 to robot 1"), "{error}");
        }
        assert_eq!(
            relation_edges([(0, 1, 0.0), (0, 1, 0.7)]),
            Err(EdgeError::Twice { source_robot: 0, target: 1 })
        );
        assert!(relation_edges([(0, 1, 0.7), (1, 0, 0.7)]).is_ok());
    }
}
