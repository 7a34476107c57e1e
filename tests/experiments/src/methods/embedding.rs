//! Muster's own method in all forms that are compared: the parameters of `muster-method`, named.

use std::sync::Arc;

use muster_method::division::divide;
use muster_method::embedding::embed;
use muster_method::params::{DivisionParams, EmbeddingParams, ParamsError};
use muster_method::{Frame, Graph};
use muster_model::id::{IdError, Modality, RobotId};
use muster_model::settings::{
    Alpha, CentroidStart, Dimension, EmbedderSettings, Normalization, RowScaling, Trusted,
};
use muster_numeric::kmeans::KMeansError;
use muster_numeric::matrix::{DenseMatrix, MatrixError, SparseMatrix};

use crate::system::MODALITIES;

/// How K, half of the length of a vector, is chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rank {
    /// This one, or the number of robots if that is less.
    Fixed(usize),
    /// The live system's rule: the last large ratio of neighbouring singular values from 2 to the number of
    /// teams, and more where a robot with relations would have no embedding otherwise.
    Ratio,
    /// The number of teams.
    Teams,
    /// So many more than teams.
    More(usize),
}

/// From graphs to vectors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Form {
    /// How each graph is scaled before it is weighted.
    pub normalization: Normalization,
    /// Weight of an edge from each related robot to itself in the sum of the graphs.
    pub self_loops: f64,
    /// Whether a modality that contradicts the others counts less, as in the live system.
    pub doubts: bool,
    /// α as a share of what is admissible.
    pub fraction: f64,
    /// How K is chosen.
    pub rank: Rank,
    /// Power of the singular values by which their vectors are scaled: 0 in the paper, 1/2 in HOPE and in the
    /// live system.
    pub power: f64,
    /// How the vectors of robots are scaled.
    pub rows: RowScaling,
}

/// From vectors to teams.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clustering {
    /// Where centroids start.
    pub init: CentroidStart,
    /// How often.
    pub starts: usize,
}

/// What k-means sees.
#[derive(Debug, Clone, PartialEq)]
pub struct Vectors {
    /// One row per robot.
    pub x: DenseMatrix,
    /// Whether a robot has no embedding and belongs to no team.
    pub without_embedding: Vec<bool>,
}

impl Vectors {
    /// Rows all of which are divided.
    #[must_use]
    pub fn of_all(x: DenseMatrix) -> Self {
        Self { without_embedding: vec![false; x.rows()], x }
    }
}

/// Why there is no division.
#[derive(Debug, thiserror::Error)]
pub enum MethodError {
    /// The graphs have no embedding.
    #[error(transparent)]
    Embedding(#[from] muster_method::MethodError),
    /// The parameters are not valid.
    #[error(transparent)]
    Params(#[from] ParamsError),
    /// The vectors cannot be divided.
    #[error(transparent)]
    KMeans(#[from] KMeansError),
    /// The vectors have no matrix.
    #[error(transparent)]
    Matrix(#[from] MatrixError),
    /// A number makes no name.
    #[error(transparent)]
    Name(#[from] IdError),
}

impl Form {
    /// The vectors of robots, N × 2K, from graphs and their weights, for a division into `teams`.
    ///
    /// # Errors
    /// [`MethodError`]
    pub fn vectors(
        &self,
        graphs: &[(&SparseMatrix, f64)],
        teams: usize,
    ) -> Result<Vectors, MethodError> {
        let fixed = |rank: usize| Dimension::Fixed(u32::try_from(2 * rank).unwrap_or(u32::MAX - 1));
        // Three graphs are those of the modalities. Ranks are trusted one by one, which their name decides.
        let name = |at: usize| match MODALITIES.get(at) {
            Some(name) if graphs.len() == MODALITIES.len() => Modality::new(*name),
            _ => Modality::new(format!("m{at}")),
        };
        let names: Vec<Modality> = (0..graphs.len()).map(name).collect::<Result<_, _>>()?;
        let settings = EmbedderSettings {
            weights: names.iter().cloned().zip(graphs.iter().map(|(_, weight)| *weight)).collect(),
            reciprocity: Default::default(),
            normalize: self.normalization,
            self_loops: self.self_loops,
            trusted: if self.doubts { Trusted::default() } else { Trusted::All },
            alpha: Alpha::Fraction { fraction: self.fraction },
            dimension: match self.rank {
                Rank::Fixed(rank) => fixed(rank),
                Rank::Teams => fixed(teams),
                Rank::More(more) => fixed(teams + more),
                Rank::Ratio => Dimension::Auto,
            },
            rows: self.rows,
            ..EmbedderSettings::default()
        };
        let robots = graphs.first().map_or(0, |(graph, _)| graph.nodes());
        let robots = (0..robots).map(|robot| RobotId::new(format!("r{robot:06}")));
        let matrices = graphs.iter().map(|(graph, _)| Graph::Matrix(Arc::new((*graph).clone())));
        let frame = Frame {
            robots: robots.collect::<Result<Vec<_>, _>>()?.into(),
            graphs: names.into_iter().zip(matrices).collect(),
        };
        let params = EmbeddingParams {
            power: self.power,
            // Tables show the method, not what a search leaves of it.
            dense_robots: usize::MAX,
            ..EmbeddingParams::once(&settings, teams)
        };
        let found = embed(&frame, &params.check()?, &mut |_| {})?;
        Ok(Vectors { x: found.x, without_embedding: found.without_embedding })
    }
}

impl Clustering {
    /// The team of each robot, numbered from 0 in order of first appearance. Robots without an embedding
    /// share a number of their own.
    ///
    /// # Errors
    /// [`MethodError::KMeans`] where there is nothing to divide.
    pub fn divide(
        &self,
        vectors: &Vectors,
        teams: usize,
        seed: u64,
    ) -> Result<Vec<usize>, MethodError> {
        let params = DivisionParams {
            teams,
            init: self.init,
            restarts: self.starts,
            seed,
            ..DivisionParams::default()
        };
        let Vectors { x, without_embedding } = vectors;
        let found = divide(x, without_embedding, &params.check()?, None, &mut |_| {})?;
        Ok(found.numbered().labels)
    }
}

/// Vectors of several embeddings, one behind the other.
///
/// # Errors
/// [`MethodError::Matrix`] where they are not of the same robots.
pub fn concatenated(parts: &[DenseMatrix]) -> Result<DenseMatrix, MethodError> {
    let robots = parts.first().map_or(0, DenseMatrix::rows);
    let columns = parts.iter().map(DenseMatrix::cols).sum();
    let rows = (0..robots)
        .flat_map(|i| parts.iter().filter(move |p| i < p.rows()).flat_map(move |p| p.row(i)));
    Ok(DenseMatrix::new(robots, columns, rows.copied().collect())?)
}
