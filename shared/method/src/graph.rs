//! The graphs of one frame, as whoever calls the method holds them.

use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;

use muster_model::graph::{GraphReplica, Node};
use muster_model::id::{Modality, RobotId};
use muster_model::settings::WHOLE_FROM;
use muster_numeric::matrix::{MatrixError, SparseMatrix};

/// A fleet at one moment.
#[derive(Debug, Clone)]
pub struct Frame {
    /// The robots; each row of a result is that of the robot at the same place. Frames that follow one
    /// another must list them by name.
    pub robots: Arc<[RobotId]>,
    /// One graph per modality.
    pub graphs: Vec<(Modality, Graph)>,
}

/// A graph of weighted directed edges. Clones share it, and a shared graph counts as unchanged.
#[derive(Debug, Clone)]
pub enum Graph {
    /// That of the live fleet, by nodes with names.
    Replica(Arc<GraphReplica>),
    /// By the places of the robots in the frame.
    Matrix(Arc<SparseMatrix>),
}

impl Graph {
    /// Whether both are the same allocation.
    pub(crate) fn is(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Replica(left), Self::Replica(right)) => Arc::ptr_eq(left, right),
            (Self::Matrix(left), Self::Matrix(right)) => Arc::ptr_eq(left, right),
            _ => false,
        }
    }

    /// The share of so many robots that have an edge of the graph, from 0 to 1. Counting may end where
    /// the graph has its whole default weight.
    #[expect(clippy::cast_precision_loss, reason = "there are fewer robots than 2⁵³")]
    pub(crate) fn related_share(&self, robots: usize) -> f64 {
        let graph = match self {
            Self::Replica(graph) => graph,
            Self::Matrix(matrix) => return matrix.related_share(),
        };
        let enough = robots as f64 * WHOLE_FROM;
        let mut related = HashSet::new();
        for (source, edges) in graph.rows() {
            if !edges.is_empty() {
                related.insert(*source);
                related.extend(edges.iter().map(|(target, _)| *target));
            }
            if related.len() as f64 >= enough {
                break;
            }
        }
        related.len() as f64 / robots.max(1) as f64
    }

    /// A + `reciprocity` · Aᵀ over the robots of a frame, which for a replica are ordered by name. Edges
    /// of other robots are left out; a consistent frame has none.
    ///
    /// # Errors
    /// [`MatrixError`] where a sum of weights leaves the range of a matrix entry, or the share is negative.
    pub fn matrix(
        &self,
        robots: &[RobotId],
        reciprocity: f64,
    ) -> Result<Arc<SparseMatrix>, MatrixError> {
        let reported = match self {
            Self::Replica(graph) => Arc::new(adjacency(graph, robots)?),
            Self::Matrix(matrix) => Arc::clone(matrix),
        };
        if reciprocity > 0.0 {
            Ok(Arc::new(reported.with_reverse(reciprocity)?))
        } else {
            Ok(reported)
        }
    }
}

fn adjacency(graph: &GraphReplica, robots: &[RobotId]) -> Result<SparseMatrix, MatrixError> {
    let place = |(node, robot): (&Node, &RobotId)| Some((*node, robots.binary_search(robot).ok()?));
    let places: BTreeMap<_, _> = graph.nodes().iter().filter_map(place).collect();
    let edges = graph.rows().iter().filter_map(|(source, edges)| {
        let row = *places.get(source)?;
        let places = &places;
        Some(
            edges
                .iter()
                .filter_map(move |(target, weight)| Some((row, *places.get(target)?, *weight))),
        )
    });
    SparseMatrix::from_triplets(robots.len(), edges.flatten())
}
