//! Silhouettes of a division among the vectors and among the positions.

use std::collections::{BTreeMap, HashMap};

use muster_method::silhouettes::{SilhouetteParams, silhouettes};
use muster_model::audit::{SilhouetteReport, Space};
use muster_model::embedding::Embedding;
use muster_model::id::{RobotId, TeamId};
use muster_model::limits::MAX_COORDINATE_M;
use muster_model::roster::Roster;
use muster_model::teams::Teams;
use muster_numeric::matrix::{DenseMatrix, MatrixError};
use muster_numeric::silhouette::SilhouetteError;

/// The positions of robots, all in one frame.
pub type Positions = HashMap<RobotId, [f64; 3]>;

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

/// The positions of the robots that have a team, in the frame that most of them use: distances
/// between frames mean nothing. Among equally many, the first frame by name.
#[must_use]
pub fn positions(teams: &Teams, roster: &Roster) -> Positions {
    let mut frames: BTreeMap<Option<&str>, Positions> = BTreeMap::new();
    let entries: HashMap<&RobotId, _> =
        roster.robots.iter().map(|entry| (&entry.robot, entry)).collect();
    for (robot, _) in teams.assignments() {
        let Some(entry) = entries.get(robot) else { continue };
        let sound = |x: &f64| x.abs() <= MAX_COORDINATE_M;
        if let Some(position) = entry.position.filter(|position| position.iter().all(sound)) {
            frames.entry(entry.frame.as_deref()).or_default().insert(robot.clone(), position);
        }
    }
    // Of equal elements the last is the maximum; from the back, that is the first by name.
    frames.into_values().rev().max_by_key(HashMap::len).unwrap_or_default()
}

/// Silhouettes among the vectors and among the positions.
///
/// # Errors
/// [`ScoreError`] if vectors or positions are no matrix, or larger than a number can be.
pub fn silhouettes_of(
    teams: &Teams,
    embedding: &Embedding,
    positions: &Positions,
) -> Result<[SilhouetteReport; 2], ScoreError> {
    let dimension = embedding.dimension as usize;
    let rows = embedding.robots.iter().enumerate().map(|(row, robot)| (robot, row));
    let rows: HashMap<&RobotId, usize> = rows.collect();
    let in_embedding = report(Space::Embedding, teams, dimension, |robot| {
        let row = *rows.get(robot)?;
        embedding.values.get(row * dimension..(row + 1) * dimension)
    })?;
    let in_physical = report(Space::Physical, teams, 3, |robot| {
        positions.get(robot).map(|position| &position[..])
    })?;
    Ok([in_embedding, in_physical])
}

/// Silhouettes over the robots that have a team and a place.
fn report<'a>(
    space: Space,
    teams: &Teams,
    dimension: usize,
    place: impl Fn(&RobotId) -> Option<&'a [f64]>,
) -> Result<SilhouetteReport, ScoreError> {
    let mut scored: Vec<(&RobotId, usize, &[f64])> = Vec::new();
    let mut present = 0;
    for (number, team) in teams.teams.iter().enumerate() {
        let before = scored.len();
        let members = team.members.iter().map(|member| &member.robot);
        scored.extend(members.filter_map(|robot| Some((robot, number, place(robot)?))));
        present += usize::from(scored.len() > before);
    }
    if present < 2 {
        return Ok(SilhouetteReport::undefined(space));
    }
    scored.sort_unstable_by_key(|(robot, ..)| *robot);
    let values = scored.iter().flat_map(|(_, _, place)| *place).copied();
    let x = DenseMatrix::new(scored.len(), dimension, values.collect())?;
    let labels: Vec<usize> = scored.iter().map(|(_, number, _)| *number).collect();
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
        per_robot: scored.into_iter().map(|(r, ..)| r.clone()).zip(details.per_point).collect(),
        detail_method: details.method,
    })
}
