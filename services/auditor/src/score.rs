//! The job: silhouettes of a division among the vectors and among the positions, and what is said of its teams.

use muster_division::scores::{Positions, ScoreError, positions, silhouettes_of};
use muster_model::audit::{Quality, SilhouetteReport};
use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::header::Revision;
use muster_model::roster::{Roster, RosterEntry};
use muster_model::settings::AuditorSettings;
use muster_model::teams::Teams;

use crate::teams::{Graph, TeamScores, refresh_silhouettes, score_teams};

/// One division to score, and which of its scores are known.
#[derive(Debug, Clone)]
pub struct Job {
    pub(crate) input: AuditInput,
    /// The silhouettes, if those before were of the same points.
    pub(crate) silhouettes: Option<[SilhouetteReport; 2]>,
    /// What is said of the teams, if that is fresh enough.
    pub(crate) teams: Option<TeamScores>,
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

/// Scores a division in both spaces, and its teams.
pub(crate) fn score(job: Job) -> Result<Scores, ScoreError> {
    let Job { input, silhouettes, teams: known } = job;
    let roster = input.roster.as_deref();
    let positions = || roster.map(|roster| positions(&input.teams, roster)).unwrap_or_default();
    let is_known = silhouettes.is_some() && known.is_some();
    let positions = if is_known { Positions::default() } else { positions() };
    let [in_embedding, in_physical] = match silhouettes {
        Some(silhouettes) => silhouettes,
        None => silhouettes_of(&input.teams, &input.embedding, &positions)?,
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

/// The quality of a division in one word.
pub(crate) fn quality(mean: Option<f64>, settings: &AuditorSettings) -> Quality {
    match mean {
        None => Quality::Undefined,
        Some(mean) if mean >= settings.good => Quality::Good,
        Some(mean) if mean < settings.poor => Quality::Poor,
        Some(_) => Quality::Fair,
    }
}
