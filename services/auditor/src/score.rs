//! The job: silhouettes of a division among the vectors and among the positions.

use std::collections::BTreeMap;
use std::sync::Arc;

use muster_method::silhouettes::{SilhouetteParams, silhouettes};
use muster_model::audit::{Quality, SilhouetteReport, Space};
use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::id::{RobotId, TeamId};
use muster_model::limits::MAX_COORDINATE_M;
use muster_model::roster::Roster;
use muster_model::settings::AuditorSettings;
use muster_model::teams::Teams;
use muster_numeric::matrix::{DenseMatrix, MatrixError};
use muster_numeric::silhouette::SilhouetteError;

/// One division to score.
#[derive(Debug, Clone)]
pub struct Job {
    pub(crate) input: AuditInput,
}

/// Why a division is not scored.
#[derive(Debug, thiserror::Error)]
pub enum ScoreError {
    /// The vectors or positions are no matrix.
    #[error(transparent)]
    Points(#[from] MatrixError),
    /// The silhouettes cannot be computed.
    #[error(transparent)]
    Silhouettes(#[from] SilhouetteError),
}

/// Silhouettes of one division.
#[derive(Debug, Clone, PartialEq)]
pub struct Scores {
    /// Among the vectors.
    pub in_embedding: SilhouetteReport,
    /// Among the positions.
    pub in_physical: SilhouetteReport,
}

/// A division, and what it is scored by.
#[derive(Debug, Clone)]
pub(crate) struct AuditInput {
    pub(crate) teams: Checked<Teams>,
    pub(crate) embedding: Checked<Embedding>,
    pub(crate) positions: Arc<BTreeMap<RobotId, [f64; 3]>>,
}

impl AuditInput {
    /// A division with its embedding, and the positions of its robots by a roster.
    pub(crate) fn new(
        teams: Checked<Teams>,
        embedding: Checked<Embedding>,
        roster: Option<&Roster>,
    ) -> Self {
        let positions = roster.map(|roster| positions(&teams, roster)).unwrap_or_default();
        Self { teams, embedding, positions: Arc::new(positions) }
    }

    /// Whether another division would get the same scores.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        self.teams.assignments().eq(other.teams.assignments())
            && same_vectors(&self.embedding, &other.embedding)
            && self.positions == other.positions
    }
}

fn same_vectors(left: &Embedding, right: &Embedding) -> bool {
    std::ptr::eq(left, right)
        || left.dimension == right.dimension
            && left.robots == right.robots
            && left.values == right.values
}

/// The positions of the robots that have a team, in the frame that most of them use: distances
/// between frames mean nothing. Among equally many, the first frame by name.
fn positions(teams: &Teams, roster: &Roster) -> BTreeMap<RobotId, [f64; 3]> {
    let mut frames: BTreeMap<Option<&str>, BTreeMap<RobotId, [f64; 3]>> = BTreeMap::new();
    let entries: BTreeMap<&RobotId, _> =
        roster.robots.iter().map(|entry| (&entry.robot, entry)).collect();
    for (robot, _) in teams.assignments() {
        let Some(entry) = entries.get(robot) else { continue };
        let sound = |x: &f64| x.abs() <= MAX_COORDINATE_M;
        if let Some(position) = entry.position.filter(|position| position.iter().all(sound)) {
            frames.entry(entry.frame.as_deref()).or_default().insert(robot.clone(), position);
        }
    }
    // Of equal elements the last is the maximum; from the back, that is the first by name.
    frames.into_values().rev().max_by_key(BTreeMap::len).unwrap_or_default()
}

/// Scores a division in both spaces.
pub(crate) fn score(input: &AuditInput) -> Result<Scores, ScoreError> {
    let embedding = &*input.embedding;
    let dimension = embedding.dimension as usize;
    let in_embedding = report(Space::Embedding, &input.teams, dimension, |robot| {
        let row = embedding.robots.binary_search(robot).ok()?;
        embedding.values.get(row * dimension..(row + 1) * dimension)
    })?;
    let in_physical = report(Space::Physical, &input.teams, 3, |robot| {
        input.positions.get(robot).map(|position| &position[..])
    })?;
    Ok(Scores { in_embedding, in_physical })
}

/// Silhouettes over the robots that have a team and a place.
fn report<'a>(
    space: Space,
    teams: &Teams,
    dimension: usize,
    place: impl Fn(&RobotId) -> Option<&'a [f64]>,
) -> Result<SilhouetteReport, ScoreError> {
    let mut scored: Vec<(&RobotId, usize)> = Vec::new();
    let mut present = 0;
    for (number, team) in teams.teams.iter().enumerate() {
        let before = scored.len();
        let members = team.members.iter().map(|member| &member.robot);
        scored.extend(members.filter(|robot| place(robot).is_some()).map(|r| (r, number)));
        present += usize::from(scored.len() > before);
    }
    if present < 2 {
        return Ok(SilhouetteReport::undefined(space));
    }
    scored.sort_unstable();
    let values = scored.iter().filter_map(|(robot, _)| place(robot)).flatten().copied();
    let x = DenseMatrix::new(scored.len(), dimension, values.collect())?;
    let labels: Vec<usize> = scored.iter().map(|(_, number)| *number).collect();
    let params = SilhouetteParams::default();
    let found = silhouettes(&x, &labels, &params)?;
    let details = found.details;
    let named = |(number, mean): (usize, f64)| -> Option<(TeamId, f64)> {
        Some((teams.teams.get(number)?.id.clone(), mean))
    };
    Ok(SilhouetteReport {
        space,
        mean: Some(found.mean),
        method: found.method,
        standard_error: found.standard_error,
        per_team: details.per_cluster.into_iter().filter_map(named).collect(),
        per_robot: scored.into_iter().map(|(r, _)| r.clone()).zip(details.per_point).collect(),
        detail_method: details.method,
    })
}

/// The quality of a division in one word.
pub(crate) fn quality(mean: Option<f64>, settings: &AuditorSettings) -> Quality {
    match mean {
        None => Quality::Undefined,
        Some(mean) if mean >= settings.good => Quality::Good,
        Some(mean) if mean < settings.poor => Quality::Poor,
        Some(_) => Quality::Fair,
    }
}
