//! Fusion of several graphs over the same nodes into one: A* = Σ w_m A_m.

pub use muster_model::settings::Normalization;
use thiserror::Error;

use crate::linalg::matrix::{MatrixError, SparseMatrix};
use crate::norm::spectral_norm;

/// A graph A_m and its weight w_m ≥ 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WeightedGraph<'a> {
    /// A_m.
    pub graph: &'a SparseMatrix,
    /// w_m.
    pub weight: f64,
}

impl<'a> From<(&'a SparseMatrix, f64)> for WeightedGraph<'a> {
    fn from((graph, weight): (&'a SparseMatrix, f64)) -> Self {
        Self { graph, weight }
    }
}

/// A graph A_m, its weight w_m ≥ 0, and the scale s_m > 0 that it is divided by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaledGraph<'a> {
    /// A_m.
    pub graph: &'a SparseMatrix,
    /// w_m.
    pub weight: f64,
    /// s_m, in the unit of the weights of A_m.
    pub scale: f64,
}

impl<'a> From<(&'a SparseMatrix, f64, f64)> for ScaledGraph<'a> {
    fn from((graph, weight, scale): (&'a SparseMatrix, f64, f64)) -> Self {
        Self { graph, weight, scale }
    }
}

/// Why graphs could not be fused.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum FuseError {
    /// There is nothing to fuse.
    #[error("no graph to fuse")]
    Empty,
    /// A graph has another number of nodes than the first one.
    #[error("graph {index} has {found} nodes instead of {expected}")]
    Nodes {
        /// Position of the graph in the list.
        index: usize,
        /// Nodes of the first graph.
        expected: usize,
        /// Nodes of this graph.
        found: usize,
    },
    /// A weight w_m is negative or not finite.
    #[error("weight {value} of graph {index} is not a non-negative number")]
    Weight {
        /// Position of the graph in the list.
        index: usize,
        /// Its weight.
        value: f64,
    },
    /// A weighted sum of edges leaves the range of a matrix entry.
    #[error(transparent)]
    Matrix(#[from] MatrixError),
}

/// Fused graph A* = Σ w_m A_m (equation 3 of the paper), each A_m scaled as `normalization` says.
///
/// [`Normalization::Spectral`] divides each graph by its spectral norm σ₁(A_m), so that weights mean the
/// same for every modality. The norm of a symmetric graph equals its spectral radius; the radius itself
/// cannot serve, since it is 0 for every acyclic graph, such as a command tree.
///
/// The graphs are n × n, the weights not negative. The paper asks for Σ w_m = 1, which is left to
/// the caller: a common factor of all weights scales A* and nothing else. A graph without edges
/// stays as it is. [`Normalization::Degree`] is no scale of a whole graph: [`degree_scaled`] does it first.
///
/// # Errors
/// [`FuseError`]: no graphs, different sizes, an unusable weight, or entries out of range.
pub fn fuse<'a>(
    graphs: &[impl Into<WeightedGraph<'a>> + Copy],
    normalization: Normalization,
) -> Result<SparseMatrix, FuseError> {
    if normalization == Normalization::Degree {
        let scaled: Vec<(SparseMatrix, f64)> = graphs
            .iter()
            .map(|graph| {
                let WeightedGraph { graph, weight } = (*graph).into();
                let (outgoing, incoming) = raised_degrees(graph);
                Ok((degree_scaled(graph, &outgoing, &incoming)?, weight))
            })
            .collect::<Result<_, FuseError>>()?;
        let scaled = scaled.iter().map(|(graph, weight)| (graph, *weight, 1.0));
        return fuse_scaled(&scaled.collect::<Vec<_>>());
    }
    let scaled = graphs.iter().map(|graph| {
        let WeightedGraph { graph, weight } = (*graph).into();
        let scale = match normalization {
            Normalization::Spectral if weight > 0.0 => spectral_norm(graph),
            _ => 1.0,
        };
        ScaledGraph { graph, weight, scale }
    });
    fuse_scaled(&scaled.collect::<Vec<_>>())
}

/// Degrees are raised by this share of their mean: a robot with faint edges alone is not tied by them as if
/// they were strong (K. Chaudhuri, F. Chung and A. Tsiatas, COLT 2012).
pub const RAISED_DEGREE: f64 = 0.2;

/// The degrees of the edges that leave and that end at each node, raised by [`RAISED_DEGREE`] times their mean
/// over the nodes that have such an edge.
#[must_use]
pub fn raised_degrees(graph: &SparseMatrix) -> (Vec<f64>, Vec<f64>) {
    let (mut outgoing, mut incoming) = graph.degrees();
    for degrees in [&mut outgoing, &mut incoming] {
        let (sum, count) = degrees
            .iter()
            .filter(|degree| **degree > 0.0)
            .fold((0.0, 0.0), |(sum, count), degree| (sum + degree, count + 1.0));
        let raise = if count > 0.0 { RAISED_DEGREE * sum / count } else { 0.0 };
        degrees.iter_mut().for_each(|degree| *degree += raise);
    }
    (outgoing, incoming)
}

/// D_out^-½ A D_in^-½ for diagonal matrices of `outgoing` and `incoming`, one positive number per node that
/// has edges of that direction.
///
/// With the degrees of the graph itself (see [`SparseMatrix::degrees`]) the largest singular value is 1, for
/// the vectors of the roots of the degrees: the graph is a bipartite one from sources to targets, and this
/// is its normalised adjacency (F. Chung, *Spectral Graph Theory*, 1997). A symmetric graph stays symmetric.
///
/// # Errors
/// [`MatrixError`] where a degree is missing or not positive, so that a result is out of range.
pub fn degree_scaled(
    graph: &SparseMatrix,
    outgoing: &[f64],
    incoming: &[f64],
) -> Result<SparseMatrix, MatrixError> {
    let nodes = graph.nodes();
    for degrees in [outgoing, incoming] {
        if degrees.len() != nodes {
            return Err(MatrixError::Vector { cols: nodes, len: degrees.len() });
        }
    }
    let roots = |degrees: &[f64]| -> Vec<f64> { degrees.iter().map(|d| d.sqrt()).collect() };
    let (outgoing, incoming) = (roots(outgoing), roots(incoming));
    graph.map_weights(|row, col, weight| weight / (outgoing[row] * incoming[col]))
}

/// Σ w_m A_m / s_m: [`fuse`] with scales of the caller, such as those of [`crate::norm_band`].
///
/// # Errors
/// As [`fuse`].
pub fn fuse_scaled<'a>(
    graphs: &[impl Into<ScaledGraph<'a>> + Copy],
) -> Result<SparseMatrix, FuseError> {
    let expected = (*graphs.first().ok_or(FuseError::Empty)?).into().graph.nodes();
    let mut used = Vec::with_capacity(graphs.len());
    for (index, graph) in graphs.iter().enumerate() {
        let scaled @ ScaledGraph { graph, weight, .. } = (*graph).into();
        if graph.nodes() != expected {
            let found = graph.nodes();
            return Err(FuseError::Nodes { index, expected, found });
        }
        if !(weight.is_finite() && weight >= 0.0) {
            return Err(FuseError::Weight { index, value: weight });
        }
        if weight > 0.0 && !graph.is_zero() {
            used.push(scaled);
        }
    }
    Ok(SparseMatrix::from_row_sums(expected, |row, add| {
        for ScaledGraph { graph, weight, scale } in &used {
            // Dividing each weight instead of multiplying by a quotient keeps symmetric graphs
            // symmetric and a lone graph of norm 1 unchanged.
            for (col, share) in graph.row(row) {
                add(col, weight * (share / scale));
            }
        }
    })?)
}
