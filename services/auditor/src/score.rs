//! The job: silhouettes of a division among the vectors and among the positions, and what is said of its teams.

use std::collections::BTreeMap;

use muster_method::silhouettes::{SilhouetteParams, silhouettes};
use muster_model::audit::{Quality, SilhouetteReport, Space};
use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::header::Revision;
use muster_model::id::{RobotId, TeamId};
use muster_model::limits::MAX_COORDINATE_M;
use muster_model::roster::{Roster, RosterEntry};
use muster_model::settings::AuditorSettings;
use muster_model::teams::Teams;
use muster_numeric::matrix::{DenseMatrix, MatrixError};
use muster_numeric::silhouette::SilhouetteError;

use crate::teams::{Graph, TeamScores, refresh_silhouettes, score_teams};

/// The positions of robots, all in one frame.
pub(crate) type Positions = BTreeMap<RobotId, [f64; 3]>;

/// One division to score, and which of its scores are known.
#[derive(Debug, Clone)]
pub struct Job {
    pub(crate) input: AuditInput,
    /// The silhouettes, if those before were of the same points.
    pub(crate) silhouettes: Option<[SilhouetteReport; 2]>,
    /// What is said of the teams, if that is fresh enough.
    pub(crate) teams: Option<TeamScores>,
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

/// The scores of one division.
#[derive(Debug, Clone, PartialEq)]
pub struct Scores {
    /// Silhouettes among the vectors.
    pub in_embedding: SilhouetteReport,
    /// Silhouettes among the positions.
    pub in_physical: SilhouetteReport,
    /// What is said of the teams.
    pub teams: TeamScores,
}

/// A division, and what it is scored by.
#[derive(Debug, Clone)]
pub(crate) struct AuditInput {
    pub(crate) teams: Checked<Teams>,
    pub(crate) embedding: Checked<Embedding>,
    /// The roster of the embedding, or else the newest one.
    pub(crate) roster: Option<Checked<Roster>>,
    /// The graphs of the newest frame, with the revision of its roster.
    pub(crate) graphs: Vec<Graph>,
    pub(crate) graphs_of: Option<Revision>,
}

impl AuditInput {
    /// Whether another division would get the same silhouettes.
    pub(crate) fn has_same_points(&self, other: &Self) -> bool {
        self.teams.assignments().eq(other.teams.assignments())
            && same_vectors(&self.embedding, &other.embedding)
            && same_entries(self.roster.as_ref(), other.roster.as_ref(), |entry| {
                (entry.position, entry.frame.as_deref())
            })
    }

    /// Whether the same robots are in the same teams with the same skills, led and commanded by the same ones, and are stale.
    pub(crate) fn has_same_teams(&self, other: &Self) -> bool {
        self.teams.same_division(&other.teams)
            && same_entries(self.roster.as_ref(), other.roster.as_ref(), |entry| {
                (entry.superior.as_ref(), &entry.skills)
            })
    }

    /// Whether the graphs are the same.
    pub(crate) fn has_same_graphs(&self, other: &Self) -> bool {
        same_graphs(&self.graphs, &other.graphs)
    }

    /// Whether another division would get the same scores.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        self.has_same_graphs(other) && self.has_same_points(other) && self.has_same_teams(other)
    }
}

/// Whether two frames have the same graphs.
pub(crate) fn same_graphs(left: &[Graph], right: &[Graph]) -> bool {
    let revisions = |of: &Graph| (of.0.clone(), of.1.revision());
    left.iter().map(revisions).eq(right.iter().map(revisions))
}

/// Whether two rosters have the same robots with the same facts.
fn same_entries<'a, T: PartialEq>(
    left: Option<&'a Checked<Roster>>,
    right: Option<&'a Checked<Roster>>,
    facts: impl Fn(&'a RosterEntry) -> T,
) -> bool {
    match (left, right) {
        (None, None) => true,
        (Some(left), Some(right)) => {
            left.ptr_eq(right)
                || left.robots.len() == right.robots.len()
                    && left.robots.iter().zip(&right.robots).all(|(left, right)| {
                        left.robot == right.robot && facts(left) == facts(right)
                    })
        }
        _ => false,
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
fn positions(teams: &Teams, roster: &Roster) -> Positions {
    let mut frames: BTreeMap<Option<&str>, Positions> = BTreeMap::new();
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

/// Scores a division in both spaces, and its teams.
pub(crate) fn score(job: Job) -> Result<Scores, ScoreError> {
    let Job { input, silhouettes, teams: known } = job;
    let roster = input.roster.as_deref();
    let positions = || roster.map(|roster| positions(&input.teams, roster)).unwrap_or_default();
    let is_known = silhouettes.is_some() && known.is_some();
    let positions = if is_known { Positions::default() } else { positions() };
    let [in_embedding, in_physical] = match silhouettes {
        Some(silhouettes) => silhouettes,
        None => silhouettes_of(&input, &positions)?,
    };
    let teams = match known {
        Some(mut known) => {
            refresh_silhouettes(&mut known.teams, &input.teams, &in_embedding);
            known
        }
        None => TeamScores {
            graphs: input.graphs_of,
            ..score_teams(&input.teams, roster, &positions, &input.graphs, &in_embedding)
        },
    };
    Ok(Scores { in_embedding, in_physical, teams })
}

/// Silhouettes among the vectors and among the positions.
fn silhouettes_of(
    input: &AuditInput,
    positions: &Positions,
) -> Result<[SilhouetteReport; 2], ScoreError> {
    let embedding = &*input.embedding;
    let dimension = embedding.dimension as usize;
    let in_embedding = report(Space::Embedding, &input.teams, dimension, |robot| {
        let row = embedding.robots.binary_search(robot).ok()?;
        embedding.values.get(row * dimension..(row + 1) * dimension)
    })?;
    let in_physical = report(Space::Physical, &input.teams, 3, |robot| {
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
