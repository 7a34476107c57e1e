//! From the embedding to the teams, or to the given ones, and to their silhouettes.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::thread::available_parallelism;

use muster_model::settings::{CentroidStart, ClustererSettings};
use muster_numeric::kmeans::{Init, KMeansOptions, kmeans_with_progress};
use muster_numeric::matrix::DenseMatrix;
use muster_numeric::silhouette::{EXACT_POINTS, Method, Scores, scores};

use super::options::SilhouetteChoice;
use super::problem::{Division, Problem};
use super::step::{Progress, Step};
use super::{SolveError, refuse};

/// Robots over all teams and restarts from which k-means is shared out over all cores: it takes some
/// milliseconds then, and starting threads a tenth of one.
const WORTH_THREADS: usize = 200_000;

/// Seed of the robots that are sampled.
const SAMPLE_SEED: u64 = 0;

/// A division and how good it is.
#[derive(Debug)]
pub(super) struct Divided {
    /// The label of each robot.
    pub(super) labels: Vec<usize>,
    /// Sum of squared distances to the means of the teams.
    pub(super) inertia: f64,
    /// None for fewer than two teams.
    pub(super) silhouette: Option<Scores>,
}

/// The teams of a problem whose vectors are the rows of `x`.
pub(super) fn divide(
    problem: &Problem,
    x: &DenseMatrix,
    warnings: &mut Vec<String>,
    progress: &mut Progress<'_>,
) -> Result<Divided, SolveError> {
    let (labels, inertia) = match &problem.division {
        Division::Wanted(settings) => cluster(x, settings, warnings, progress)?,
        Division::Given(labels) => {
            let labels: Vec<usize> = labels.iter().map(|label| *label as usize).collect();
            let inertia = inertia(x, &labels);
            (labels, inertia)
        }
    };
    progress(Step::Silhouettes);
    let method = silhouette_method(problem.options.silhouette, x.rows());
    // The labels are one per row, so that the only error left is one of fewer than two teams.
    let silhouette = scores(x, &labels, method, SAMPLE_SEED).ok();
    Ok(Divided { labels, inertia, silhouette })
}

/// How the silhouettes of so many robots are computed.
pub(super) fn silhouette_method(choice: SilhouetteChoice, robots: usize) -> Method {
    match choice {
        SilhouetteChoice::Auto => Method::by_size(robots, EXACT_POINTS),
        SilhouetteChoice::Exact => Method::Exact,
        SilhouetteChoice::Squared => Method::SquaredExact,
        SilhouetteChoice::Sampled => Method::Sampled,
    }
}

/// Threads for the k-means of so many robots: all cores where it is worth it.
pub(super) fn kmeans_threads(settings: &ClustererSettings, robots: usize) -> usize {
    let work =
        robots.saturating_mul(settings.teams as usize).saturating_mul(settings.restarts as usize);
    if work < WORTH_THREADS { 1 } else { available_parallelism().map_or(1, NonZeroUsize::get) }
}

/// How many teams the rule for the dimension reckons with.
pub(super) fn wanted_teams(problem: &Problem) -> usize {
    match &problem.division {
        Division::Wanted(settings) => settings.teams as usize,
        Division::Given(labels) => {
            let mut labels = labels.clone();
            labels.sort_unstable();
            labels.dedup();
            labels.len()
        }
    }
}

/// Labels by k-means, and their inertia.
fn cluster(
    x: &DenseMatrix,
    settings: &ClustererSettings,
    warnings: &mut Vec<String>,
    progress: &mut Progress<'_>,
) -> Result<(Vec<usize>, f64), SolveError> {
    let wanted = settings.teams as usize;
    let restarts = settings.restarts as usize;
    let options = KMeansOptions {
        init: match settings.init {
            CentroidStart::PlusPlus => Init::PlusPlus,
            CentroidStart::Random => Init::Random,
        },
        restarts,
        max_iterations: settings.max_iterations as usize,
        seed: settings.seed,
        threads: kmeans_threads(settings, x.rows()),
        ..KMeansOptions::new(wanted)
    };
    progress(Step::KMeans { done: 0, restarts });
    let found =
        kmeans_with_progress(x, &options, &mut |done| progress(Step::KMeans { done, restarts }))
            .or_else(|error| refuse("teams", error.to_string()))?;
    let teams = found.centroids.rows();
    if teams < wanted {
        warnings.push(format!(
            "{wanted} teams were asked for, but only {teams} can be told apart: robots that stand \
             in the same relations have the same row"
        ));
    }
    if !found.converged {
        warnings.push(format!(
            "k-means was stopped after {} iterations before the labels settled",
            found.iterations
        ));
    }
    Ok((found.labels, found.inertia))
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
