//! What is observed of a fleet, and its true teams.

use muster_model::settings::IngestSettings;
use muster_numeric::matrix::{MatrixError, SparseMatrix};
use muster_relation::{EdgeError, connectivity_edges, hierarchy_edges, spatial_edges};

use crate::system::CLOSEST_M;

/// A fleet at one moment. A modality that nobody reports is `None`; lists have one entry per robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Situation {
    /// How many teams there are.
    pub teams: usize,
    /// The true team of each robot, from 0; none for a robot that does not count.
    pub truth: Vec<Option<usize>>,
    /// Metres east, north and up; none for a robot that does not know where it is.
    pub positions: Option<Vec<Option<[f64; 3]>>>,
    /// The incoming links of each robot: sender, and quality from 0 to 1.
    pub links: Option<Vec<Vec<(u32, f64)>>>,
    /// Robot, its superior, and the strength of the tie. A robot has at most one superior.
    pub ranks: Option<Vec<(u32, u32, f64)>>,
}

/// Why a situation has no graphs.
#[derive(Debug, thiserror::Error)]
pub enum SituationError {
    /// A report is wrong.
    #[error(transparent)]
    Edge(#[from] EdgeError),
    /// A graph is none.
    #[error(transparent)]
    Matrix(#[from] MatrixError),
}

impl Situation {
    /// How many robots there are.
    #[must_use]
    pub fn robots(&self) -> usize {
        self.truth.len()
    }

    /// The spatial graph by the live system's default settings; none where there are no positions.
    ///
    /// # Errors
    /// [`SituationError::Matrix`] for too many pairs.
    pub fn spatial(&self) -> Result<Option<SparseMatrix>, SituationError> {
        let Some(positions) = &self.positions else { return Ok(None) };
        // A robot without a position is not placed, which is what a position that is no number means.
        let places: Vec<_> = positions.iter().map(|at| at.unwrap_or([f64::NAN; 3])).collect();
        self.matrix(spatial_edges(&places, &IngestSettings::default().spatial)).map(Some)
    }

    /// The spatial graph of the paper: 1/d over all pairs, with d in metres.
    ///
    /// # Errors
    /// As [`Situation::spatial`].
    pub fn inverse_distances(&self) -> Result<Option<SparseMatrix>, SituationError> {
        let Some(positions) = &self.positions else { return Ok(None) };
        let placed = || (0_u32..).zip(positions).filter_map(|(i, at)| Some((i, (*at)?)));
        let pairs = placed().flat_map(|from| placed().map(move |to| (from, to)));
        let edges = pairs.filter(|(from, to)| from.0 != to.0).map(|((i, from), (j, to))| {
            let squares: f64 = from.iter().zip(to).map(|(from, to)| (from - to).powi(2)).sum();
            (i, j, 1.0 / squares.sqrt().max(CLOSEST_M))
        });
        self.matrix(edges.collect()).map(Some)
    }

    /// The graph of links, from senders to receivers; none where there are no links.
    ///
    /// # Errors
    /// [`SituationError::Edge`] for a link that no robot may report.
    pub fn connectivity(&self) -> Result<Option<SparseMatrix>, SituationError> {
        let Some(links) = &self.links else { return Ok(None) };
        let reports = (0..).zip(links).map(|(robot, links)| (robot, &links[..]));
        self.matrix(connectivity_edges(reports)?).map(Some)
    }

    /// The graph of command, from superiors down; none where there are no ranks.
    ///
    /// # Errors
    /// [`SituationError::Edge`] for a rank that no robot may report.
    pub fn hierarchy(&self) -> Result<Option<SparseMatrix>, SituationError> {
        let Some(ranks) = &self.ranks else { return Ok(None) };
        let reports =
            ranks.iter().map(|&(robot, superior, tie)| (robot, Some(superior), Some(tie)));
        self.matrix(hierarchy_edges(reports)?).map(Some)
    }

    fn matrix(&self, edges: Vec<(u32, u32, f64)>) -> Result<SparseMatrix, SituationError> {
        let edges = edges.into_iter().map(|(i, j, weight)| (i as usize, j as usize, weight));
        Ok(SparseMatrix::from_triplets(self.robots(), edges)?)
    }
}
