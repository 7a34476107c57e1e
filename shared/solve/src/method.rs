//! The computation: graphs to Katz similarity to embedding to labels to silhouettes.

use std::collections::BTreeMap;

use muster_model::settings::{
    Alpha, CentroidStart, ClustererSettings, Dimension, Normalization, RowScaling,
    SingularValueScaling,
};
use muster_numeric::dimension::choose_dimension;
use muster_numeric::embedding::{Rows, Scale, embed};
use muster_numeric::fuse::{self, fuse};
use muster_numeric::katz::{self, KatzError, katz_probe, katz_similarity};
use muster_numeric::kmeans::{Init, KMeansOptions, kmeans_watched};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::silhouette::{Silhouette, silhouette};
use muster_numeric::spectral_radius::{SpectralRadius, spectral_radius};
use muster_numeric::svd::full_svd;

use super::file::Emit;
use super::problem::{Division, Problem};
use super::step::Step;
use super::{SolveError, refuse};

/// How many robots a warning names.
const MOST_NAMED: usize = 10;

/// Seed of the probe that checks the Katz similarity.
const PROBE_SEED: u64 = 0;

/// Everything that was found.
#[derive(Debug)]
pub(super) struct Solution {
    pub(super) radius: SpectralRadius,
    pub(super) alpha: f64,
    /// Only where it is wanted in the output: it is as large as all else together.
    pub(super) katz: Option<DenseMatrix>,
    /// The K leading ones.
    pub(super) singular_values: Vec<f64>,
    /// The first one left out; none if none is.
    pub(super) next_singular_value: Option<f64>,
    /// (σ_K − σ_{K+1}) / σ₁.
    pub(super) gap: f64,
    /// Whether σ_K and σ_{K+1} coincide.
    pub(super) ambiguous: bool,
    pub(super) embedding: DenseMatrix,
    /// Per robot, whether its row says nothing.
    pub(super) unseen: Vec<bool>,
    pub(super) labels: Vec<usize>,
    /// Sum of squared distances to the means of the teams.
    pub(super) inertia: f64,
    /// None for fewer than two teams.
    pub(super) silhouette: Option<Silhouette>,
    pub(super) diagnostics: Option<Diagnostics>,
    pub(super) warnings: Vec<String>,
}

/// Accuracies, measured.
#[derive(Debug)]
pub(super) struct Diagnostics {
    /// Of the singular triplets, relative to σ₁.
    pub(super) residual: f64,
    /// Of the Katz similarity.
    pub(super) katz_residual: f64,
}

/// Applies the method, and tells each step that it begins.
pub(super) fn solve(
    problem: &Problem,
    progress: &mut dyn FnMut(Step),
) -> Result<Solution, SolveError> {
    progress(Step::Fuse);
    let fused = fused(problem)?;
    progress(Step::SpectralRadius);
    let radius = spectral_radius(&fused, None);
    let alpha = match problem.alpha {
        Alpha::Value(alpha) => katz::Alpha::Value(alpha),
        Alpha::Fraction { fraction } => katz::Alpha::Fraction(fraction),
    };
    let alpha = alpha.resolve(&fused, &radius).or_else(of_katz)?;
    progress(Step::Katz);
    let similarity = katz_similarity(&fused, alpha, &radius).or_else(of_katz)?;
    progress(Step::Svd);
    let full = full_svd(&similarity).or_else(of_numbers)?;
    let wanted = match problem.dimension {
        Dimension::Fixed(dimension) => dimension as usize / 2,
        Dimension::Auto => choose_dimension(full.singular_values(), wanted_teams(problem)),
    };
    let svd = full.truncate(wanted.clamp(1, problem.robots.len())).or_else(of_numbers)?;
    drop(full);
    let diagnostics = if problem.emit.contains(&Emit::Diagnostics) {
        let residual = svd.residual(&similarity).or_else(of_numbers)?;
        let probe = katz_probe(&fused, alpha, &similarity, PROBE_SEED);
        Some(Diagnostics { residual, katz_residual: probe.or_else(of_katz)? })
    } else {
        None
    };
    let katz = problem.emit.contains(&Emit::Katz).then_some(similarity);

    let scale = match problem.scale {
        SingularValueScaling::None => Scale::None,
        SingularValueScaling::SqrtSigma => Scale::SqrtSigma,
    };
    let rows = match problem.rows {
        RowScaling::None => Rows::None,
        RowScaling::Unit => Rows::Unit,
    };
    let embedded = embed(&svd, scale, rows);
    let mut warnings = Vec::new();
    if svd.ambiguous() {
        warnings.push(format!(
            "the singular values number {} and {} coincide: which directions make up the embedding \
             is arbitrary, and so may be the teams; choose another dimension than {}",
            svd.rank(),
            svd.rank() + 1,
            2 * svd.rank(),
        ));
    }
    warnings.extend(unseen_warning(problem, &embedded.weak, svd.rank()));

    let (labels, inertia) = match &problem.division {
        Division::Wanted(settings) => cluster(&embedded.x, settings, &mut warnings, progress)?,
        Division::Given(labels) => {
            let labels: Vec<usize> = labels.iter().map(|label| *label as usize).collect();
            let inertia = inertia(&embedded.x, &labels);
            (labels, inertia)
        }
    };
    progress(Step::Silhouettes);
    // The labels are one per row, so that the only error left is one of fewer than two teams.
    let silhouette = silhouette(&embedded.x, &labels).ok();
    Ok(Solution {
        radius,
        alpha,
        katz,
        next_singular_value: svd.sigma_next,
        gap: svd.gap(),
        ambiguous: svd.ambiguous(),
        singular_values: svd.sigma,
        embedding: embedded.x,
        unseen: embedded.weak,
        labels,
        inertia,
        silhouette,
        diagnostics,
        warnings,
    })
}

/// A* of the file.
fn fused(problem: &Problem) -> Result<SparseMatrix, SolveError> {
    let graphs: Vec<_> = problem.graphs.iter().map(|graph| (&graph.matrix, graph.weight)).collect();
    let normalization = match problem.normalize {
        Normalization::None => fuse::Normalization::None,
        Normalization::Spectral => fuse::Normalization::Spectral,
    };
    fuse(&graphs, normalization)
        .or_else(|error| refuse("modalities", format!("the graphs cannot be added up: {error}")))
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
    progress: &mut dyn FnMut(Step),
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
        ..KMeansOptions::new(wanted)
    };
    progress(Step::KMeans { done: 0, restarts });
    let found = kmeans_watched(x, &options, &mut |done| progress(Step::KMeans { done, restarts }))
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

/// Names the robots whose rows say nothing.
fn unseen_warning(problem: &Problem, unseen: &[bool], rank: usize) -> Option<String> {
    let robots: Vec<&str> = problem
        .robots
        .iter()
        .zip(unseen)
        .filter(|(_, unseen)| **unseen)
        .map(|(robot, _)| robot.as_str())
        .collect();
    if robots.is_empty() {
        return None;
    }
    let named = robots.iter().take(MOST_NAMED).copied().collect::<Vec<_>>().join(", ");
    let more = match robots.len().saturating_sub(MOST_NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    Some(format!(
        "the embedding does not see {named}{more}: no edges, or a part of the fleet that is weaker \
         than the {rank} leading directions; their rows are zero and say nothing about their team, \
         which a larger dimension may change"
    ))
}

/// An error of the similarity, by the field that is to be changed.
fn of_katz<T>(error: KatzError) -> Result<T, SolveError> {
    match error {
        KatzError::Diverges { alpha, radius } => refuse(
            "alpha",
            format!(
                "{alpha} must be less than 1/ρ = {} of this file (ρ = {radius}); set it below, or \
                 as {{\"fraction\": 0.5}}",
                1.0 / radius
            ),
        ),
        KatzError::Matrix(error) => refuse("robots", error.to_string()),
        other => refuse("alpha", other.to_string()),
    }
}

/// An error of the decomposition. None is left for checked input.
fn of_numbers<T>(error: muster_numeric::svd::SvdError) -> Result<T, SolveError> {
    refuse("modalities", error.to_string())
}
