//! The teams of a problem, by k-means or as given, and their silhouettes.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::thread::available_parallelism;

use muster_method::division::{self, Numbered};
use muster_method::embedding::Embedded;
use muster_method::params::DivisionParams;
use muster_method::silhouettes::{SilhouetteParams, silhouettes};
use muster_method::step::{Progress, Step};
use muster_model::audit::SilhouetteMethod;
use muster_model::settings::{ClustererSettings, TeamCount};
use muster_numeric::matrix::DenseMatrix;
use muster_numeric::silhouette::Scores;

use super::error::{SolveError, refuse};
use super::limited::{self, WishOutcome, Within};
use super::options::{EXACT_ROBOTS, SilhouetteChoice};
use super::problem::{Division, Problem};

/// Robots times teams times restarts from which k-means is shared out over all cores: it takes some
/// milliseconds then, and starting threads a tenth of one.
const PARALLEL_WORK: usize = 200_000;

/// A division and how good it is.
#[derive(Debug)]
pub(super) struct Divided {
    /// The label of each robot.
    pub(super) labels: Vec<usize>,
    /// The label that robots without an embedding share; it is no team.
    pub(super) unassigned: Option<usize>,
    /// Sum of squared distances to the means of the labels.
    pub(super) inertia: f64,
    /// None for fewer than two labels.
    pub(super) silhouette: Option<Scores>,
    /// What is asked of the teams, and how the division stands to it; none if nothing is.
    pub(super) within: Option<Within>,
}

/// The teams of a problem.
pub(super) fn divide(
    problem: &Problem,
    embedded: &Embedded,
    warnings: &mut Vec<String>,
    progress: &mut Progress<'_>,
) -> Result<Divided, SolveError> {
    let x = &embedded.x;
    let (Numbered { labels, unassigned }, inertia) = match &problem.division {
        Division::Wanted(settings) => {
            if let Some(rules) = limited::rules(problem, settings)? {
                progress(Step::KMeans { done: 0, restarts: settings.restarts as usize });
                let within = limited::divide(problem, settings, embedded, rules)?;
                return Ok(within_limits(problem, embedded, within, warnings, progress));
            }
            let found = cluster(embedded, settings, warnings, progress)?;
            let numbered = found.numbered();
            let without = embedded.without_embedding.iter().enumerate().filter(|(_, w)| **w);
            let rest = x.select_rows(&without.map(|(i, _)| i).collect::<Vec<_>>());
            let inertia = found.inertia + inertia(&rest, &vec![0; rest.rows()]);
            (numbered, inertia)
        }
        Division::Given(labels) => {
            let labels: Vec<usize> = labels.iter().map(|label| *label as usize).collect();
            let inertia = inertia(x, &labels);
            (Numbered { labels, unassigned: None }, inertia)
        }
    };
    progress(Step::Silhouettes);
    // The labels are one per row, so that the only error left is one of fewer than two labels.
    let silhouette = silhouettes(x, &labels, &silhouette_params(problem.options.silhouette)).ok();
    Ok(Divided { labels, unassigned, inertia, silhouette, within: None })
}

/// A division that respects what is asked of it, with the silhouettes of the robots that have a team.
fn within_limits(
    problem: &Problem,
    embedded: &Embedded,
    within: Within,
    warnings: &mut Vec<String>,
    progress: &mut Progress<'_>,
) -> Divided {
    progress(Step::Silhouettes);
    warnings.extend(within.wishes.iter().filter_map(WishOutcome::warning));
    let unassigned = within.ids.iter().position(Option::is_none);
    let rows: Vec<usize> =
        (0..within.labels.len()).filter(|row| Some(within.labels[*row]) != unassigned).collect();
    let x = embedded.x.select_rows(&rows);
    let labels: Vec<usize> = rows.iter().map(|row| within.labels[*row]).collect();
    let silhouette = silhouettes(&x, &labels, &silhouette_params(problem.options.silhouette)).ok();
    let (labels, inertia) = (within.labels.clone(), within.inertia);
    Divided { labels, unassigned, inertia, silhouette, within: Some(within) }
}

/// How silhouettes are computed.
pub(super) fn silhouette_params(choice: SilhouetteChoice) -> SilhouetteParams {
    let method = match choice {
        SilhouetteChoice::Auto => None,
        SilhouetteChoice::Exact => Some(SilhouetteMethod::Exact),
        SilhouetteChoice::Squared => Some(SilhouetteMethod::SquaredExact),
        SilhouetteChoice::Sampled => Some(SilhouetteMethod::Sampled),
    };
    SilhouetteParams { method, exact_robots: EXACT_ROBOTS, ..SilhouetteParams::default() }
}

/// Threads for the k-means of so many teams and robots: all cores for much work.
pub(super) fn kmeans_threads(settings: &ClustererSettings, teams: usize, robots: usize) -> usize {
    let work = robots.saturating_mul(teams).saturating_mul(settings.restarts as usize);
    if work < PARALLEL_WORK { 1 } else { available_parallelism().map_or(1, NonZeroUsize::get) }
}

/// How many teams the rule for the dimension expects.
pub(super) fn wanted_teams(problem: &Problem) -> TeamCount {
    match &problem.division {
        Division::Wanted(settings) => settings.teams,
        Division::Given(labels) => {
            let mut labels = labels.clone();
            labels.sort_unstable();
            labels.dedup();
            labels.len().into()
        }
    }
}

/// The teams by k-means.
fn cluster(
    embedded: &Embedded,
    settings: &ClustererSettings,
    warnings: &mut Vec<String>,
    progress: &mut Progress<'_>,
) -> Result<division::Division, SolveError> {
    let Embedded { x, without_embedding, decomposition, .. } = embedded;
    let wanted = decomposition.teams.teams as usize;
    let params = DivisionParams {
        threads: kmeans_threads(settings, wanted, x.rows()),
        ..DivisionParams::new(settings, wanted)
    };
    let params = params.check().or_else(|error| refuse("teams", error.to_string()))?;
    let found = division::divide(x, without_embedding, &params, None, progress)
        .or_else(|error| refuse("teams", error.to_string()))?;
    let teams = found.centroids.rows();
    if teams < wanted && *settings.teams.range().start() as usize > teams {
        warnings.push(format!(
            "{wanted} teams were asked for, but only {teams} can be separated: robots that stand \
             in the same relations have the same row"
        ));
    }
    if !found.converged {
        warnings.push(format!(
            "k-means was stopped after {} iterations before the labels settled",
            found.iterations
        ));
    }
    Ok(found)
}

/// Sum of squared distances of the rows to the mean of the rows with the same label.
fn inertia(x: &DenseMatrix, labels: &[usize]) -> f64 {
    let mut means: BTreeMap<usize, (f64, Vec<f64>)> = BTreeMap::new();
    for (row, label) in x.iter_rows().zip(labels) {
        let (count, sum) = means.entry(*label).or_insert_with(|| (0.0, vec![0.0; x.cols()]));
        *count += 1.0;
        for (sum, value) in sum.iter_mut().zip(row) {
            *sum += value;
        }
    }
    for (count, sum) in means.values_mut() {
        for value in sum {
            *value /= *count;
        }
    }
    let distances = x.iter_rows().zip(labels).map(|(row, label)| {
        let mean = means.get(label).map(|mean| mean.1.as_slice()).unwrap_or_default();
        row.iter().zip(mean).map(|(value, mean)| (value - mean).powi(2)).sum::<f64>()
    });
    distances.sum()
}
