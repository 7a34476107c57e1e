//! The method on a checked input, with its warnings.

use std::sync::Arc;
use std::thread::available_parallelism;

use muster_method::decomposition::{Decomposition, Path};
use muster_method::embedding::{Embedded, Frames};
use muster_method::params::EmbeddingParams;
use muster_method::step::Progress;
use muster_method::trust::Trust;
use muster_method::{Frame, Graph as FrameGraph, MethodError};
use muster_model::embedding::EmbeddingGraph;
use muster_model::id::RobotId;
use muster_numeric::katz::KatzError;
use muster_numeric::matrix::DenseMatrix;
use muster_numeric::spectral_radius::SpectralRadius;

use super::cost::Size;
use super::division::{Divided, divide, wanted_teams};
use super::error::{SolveError, refuse};
use super::file::Emit;
use super::memory::admit_path;
use super::options::PathChoice;
use super::problem::{Graph, Problem};

/// Most robots that a warning names.
const MAX_NAMED_ROBOTS: usize = 10;

/// Where the search does not reach its tolerance, fleets of up to so many robots are decomposed whole after
/// all, if that fits: it takes a minute at most.
const DENSE_FALLBACK_ROBOTS: usize = 4000;

/// Everything that was found.
#[derive(Debug)]
pub(super) struct Solution {
    /// The weight of each graph, in the order of the problem, with the trust in it.
    pub(super) weights: Vec<f64>,
    /// How far each graph agrees with the others, in the same order.
    pub(super) trust: Vec<Trust>,
    pub(super) radius: SpectralRadius,
    pub(super) alpha: f64,
    pub(super) decomposition: Decomposition,
    pub(super) embedding: DenseMatrix,
    /// Per robot, whether its row holds nothing.
    pub(super) without_embedding: Vec<bool>,
    pub(super) divided: Divided,
    pub(super) warnings: Vec<String>,
    /// What the embedding rests on, if it is kept.
    pub(super) frames: Option<Frames>,
}

impl Solution {
    /// Bound on the sine of the angle by which the spaces of U and of V are turned against the true ones. 1
    /// proves nothing.
    pub(super) fn angle_bound(&self) -> f64 {
        self.decomposition.svd.angle_bound(self.decomposition.residual)
    }
}

/// Applies the method; `progress` receives each step when it begins.
pub(super) fn solve(
    problem: &Problem,
    path: Path,
    progress: &mut Progress<'_>,
) -> Result<Solution, SolveError> {
    let graphs = problem.graphs.iter();
    let frame = Frame {
        robots: problem.robots.as_slice().into(),
        graphs: graphs
            .map(|graph| (graph.name.clone(), FrameGraph::Matrix(Arc::clone(&graph.matrix))))
            .collect(),
    };
    let params = params(problem, path).check().map_err(MethodError::from);
    let mut frames = Frames::default();
    let found = params.and_then(|params| frames.embed(&frame, &params, None, progress));
    let mut embedded = found.or_else(of_method)?;
    if !problem.emit.contains(&Emit::Katz) {
        // It is as large as all else together.
        embedded.decomposition.similarity = None;
    }
    let found = &embedded.decomposition;
    if !found.residual.is_finite() {
        return refuse(
            "modalities",
            "the weights span so many magnitudes that no singular vectors are found without the \
             similarity; for fewer robots --path dense finds them",
        );
    }
    let frames = problem.keeps_frames.then_some(frames);
    let mut warnings = warnings(problem, &embedded);
    let divided = divide(problem, &embedded, &mut warnings, progress)?;
    let Embedded { weights, trust, decay, decomposition, x, without_embedding, .. } = embedded;
    Ok(Solution {
        weights,
        trust,
        radius: decay.radius,
        alpha: decay.alpha,
        decomposition,
        embedding: x,
        without_embedding,
        divided,
        warnings,
        frames,
    })
}

/// The parameters of a problem that is solved by a path.
fn params(problem: &Problem, path: Path) -> EmbeddingParams {
    let robots = problem.robots.len();
    let dense_robots = match path {
        Path::Dense => usize::MAX,
        Path::InverseFree => 0,
    };
    let may_change = problem.options.path == PathChoice::Auto
        && robots <= DENSE_FALLBACK_ROBOTS
        && admit_path(Path::Dense, robots, &Size::of(problem)).is_ok();
    EmbeddingParams {
        tolerance: problem.options.tolerance,
        threads: available_parallelism().map_or(1, usize::from),
        dense_robots,
        dense_fallback_robots: if may_change { DENSE_FALLBACK_ROBOTS } else { 0 },
        ..EmbeddingParams::once(&problem.settings, wanted_teams(problem))
    }
}

/// An error of the method, by the field that is to be changed.
fn of_method<T>(error: MethodError) -> Result<T, SolveError> {
    match error {
        MethodError::Diverges { alpha, radius } => refuse(
            "alpha",
            format!(
                "{alpha} must be less than 1/ρ = {} of this file (ρ = {radius}); set it below, or \
                 as {{\"fraction\": 0.5}}",
                1.0 / radius
            ),
        ),
        MethodError::Katz(KatzError::Matrix(error)) => refuse("robots", error.to_string()),
        MethodError::Katz(error) => refuse("alpha", error.to_string()),
        MethodError::Fuse(error) => {
            refuse("modalities", format!("the graphs cannot be added up: {error}"))
        }
        MethodError::Svd(error) => refuse("modalities", error.to_string()),
        MethodError::Search(error) => refuse("modalities", error.to_string()),
        other => refuse("modalities", other.to_string()),
    }
}

/// What a reader should know about an embedding.
fn warnings(problem: &Problem, embedded: &Embedded) -> Vec<String> {
    let mut warnings = Vec::new();
    let Decomposition { svd, converged, residual, .. } = &embedded.decomposition;
    if svd.ambiguous() {
        warnings.push(format!(
            "the singular values number {} and {} coincide: which directions make up the embedding \
             is arbitrary, and so may be the teams; choose another dimension than {}",
            svd.rank(),
            svd.rank() + 1,
            2 * svd.rank(),
        ));
    }
    if !converged {
        warnings.push(format!(
            "the search for the singular vectors ended at a residual of {residual:.1e}, above the \
             tolerance of {:.1e}; for fewer robots --path dense is exact",
            problem.options.tolerance,
        ));
    }
    warnings.extend(doubt_warnings(problem, &embedded.trust));
    warnings.extend(without_embedding_warning(problem, &embedded.without_embedding, svd.rank()));
    warnings
}

/// Whether a graph is in doubt: less than half of its weight is left.
pub(super) fn is_doubted(trust: &Trust) -> bool {
    trust.factor < EmbeddingGraph::DOUBTED_BELOW
}

/// Names the modalities that are in doubt, and the robots whose edges agree least.
fn doubt_warnings(problem: &Problem, trust: &[Trust]) -> Vec<String> {
    let all = problem.graphs.iter().zip(trust);
    let doubted = all.filter(|(_, trust)| is_doubted(trust));
    let warning = |(graph, trust): (&Graph, &Trust)| {
        let robots: Vec<&str> = trust.disagreeing.iter().map(RobotId::as_str).collect();
        let percent = 100.0 * trust.factor;
        let name = &graph.name;
        format!(
            "modality {name} is in doubt: {percent:.0} % of its weight is used, since it ties robots that \
             the other modalities hold apart, most of all {}; where it is right, \"trusted\": [\"{name}\"] \
             holds the trust in it at 1",
            robots.join(", ")
        )
    };
    doubted.map(warning).collect()
}

/// Names the robots without an embedding.
fn without_embedding_warning(problem: &Problem, without: &[bool], rank: usize) -> Option<String> {
    let robots = problem.robots.iter().zip(without).filter(|(_, without)| **without);
    let robots: Vec<&str> = robots.map(|(robot, _)| robot.as_str()).collect();
    if robots.is_empty() {
        return None;
    }
    let named = robots.iter().take(MAX_NAMED_ROBOTS).copied().collect::<Vec<_>>().join(", ");
    let more = match robots.len().saturating_sub(MAX_NAMED_ROBOTS) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    Some(format!(
        "without an embedding: {named}{more}; they have no edges, or their part of the fleet is \
         weaker than the {rank} leading directions, which a larger dimension may change; they belong \
         to no team, and k-means gives them one label of their own"
    ))
}
