//! Muster, and the paper's method to the letter, on a situation.
//!
//! Muster takes the path of `muster solve` on observations: one graph per modality that is reported, the default
//! settings of all services, one embedding and one division. A modality that nobody reports is no graph.

use std::sync::Arc;

use muster_method::division::divide;
use muster_method::embedding::{Embedded, embed};
use muster_method::params::{DivisionParams, EmbeddingParams};
use muster_method::{Frame, Graph};
use muster_model::id::{Modality, RobotId};
use muster_model::settings::{CentroidStart, ClustererSettings, EmbedderSettings, TeamCount};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_scenario::FileError;

use super::situation::{Situation, SituationError};
use crate::methods::Recipe;
use crate::methods::embedding::MethodError;

/// The team of each robot; none for a robot without one.
pub type Labels = Vec<Option<usize>>;

/// Why there is no division.
#[derive(Debug, thiserror::Error)]
pub enum DividedError {
    /// There is no situation.
    #[error(transparent)]
    File(#[from] FileError),
    /// The situation has no graphs.
    #[error(transparent)]
    Situation(#[from] SituationError),
    /// A method fails.
    #[error(transparent)]
    Method(#[from] MethodError),
}

/// Muster with its defaults, divided into `teams`.
///
/// # Errors
/// [`DividedError`]
pub fn muster(situation: &Situation, teams: usize) -> Result<Labels, DividedError> {
    muster_with(situation, teams, &EmbedderSettings::default())
}

/// Muster with these settings of the embedder, and the defaults of all other services, divided into `teams`.
///
/// # Errors
/// [`DividedError`]
pub fn muster_with(
    situation: &Situation,
    teams: usize,
    settings: &EmbedderSettings,
) -> Result<Labels, DividedError> {
    let embedded = embedded(situation, TeamCount::from(teams), settings)?;
    let params = DivisionParams::new(&ClustererSettings::default(), teams);
    labels(&embedded.x, &embedded.without_embedding, params)
}

/// Muster with its defaults, which choose the number of teams; with that number.
///
/// # Errors
/// [`DividedError`]
pub fn muster_by_itself(situation: &Situation) -> Result<(Labels, usize), DividedError> {
    let embedded = embedded(situation, TeamCount::Auto, &EmbedderSettings::default())?;
    let teams = embedded.decomposition.teams.teams as usize;
    let params = DivisionParams::new(&ClustererSettings::default(), teams);
    Ok((labels(&embedded.x, &embedded.without_embedding, params)?, teams))
}

/// The paper's method to the letter, divided into `teams`.
///
/// # Errors
/// [`DividedError`]
pub fn paper(situation: &Situation, teams: usize, seed: u64) -> Result<Labels, DividedError> {
    let recipe = Recipe::plain();
    let graphs =
        [situation.inverse_distances()?, situation.connectivity()?, situation.hierarchy()?];
    let present: Vec<&SparseMatrix> = graphs.iter().flatten().collect();
    #[expect(clippy::cast_precision_loss, reason = "there are three modalities")]
    let weight = 1.0 / present.len() as f64;
    let weighted: Vec<_> = present.into_iter().map(|graph| (graph, weight)).collect();
    let vectors = recipe.form.vectors(&weighted, teams)?;
    let params = DivisionParams {
        teams,
        init: CentroidStart::Random,
        restarts: recipe.clustering.starts,
        seed,
        ..DivisionParams::default()
    };
    labels(&vectors.x, &vectors.without_embedding, params)
}

fn embedded(
    situation: &Situation,
    teams: TeamCount,
    settings: &EmbedderSettings,
) -> Result<Embedded, DividedError> {
    let graphs = [
        (Modality::spatial(), situation.spatial()?),
        (Modality::connectivity(), situation.connectivity()?),
        (Modality::hierarchy(), situation.hierarchy()?),
    ];
    let present = |(name, graph): (Modality, Option<SparseMatrix>)| {
        Some((name, Graph::Matrix(Arc::new(graph?))))
    };
    let names = (0..situation.robots()).map(|robot| RobotId::new(format!("r{robot:06}")));
    let frame = Frame {
        robots: names.collect::<Result<Vec<_>, _>>().map_err(MethodError::from)?.into(),
        graphs: graphs.into_iter().filter_map(present).collect(),
    };
    let params = EmbeddingParams::once(settings, teams).check().map_err(MethodError::from)?;
    Ok(embed(&frame, &params, &mut |_| {}).map_err(MethodError::from)?)
}

fn labels(
    x: &DenseMatrix,
    without_embedding: &[bool],
    params: DivisionParams,
) -> Result<Labels, DividedError> {
    let params = params.check().map_err(MethodError::from)?;
    let found = divide(x, without_embedding, &params, None, &mut |_| {});
    Ok(found.map_err(MethodError::from)?.labels)
}
