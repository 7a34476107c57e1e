//! The job: from one consistent frame to one vector per robot.
//!
//! A job owns or shares everything that it needs, and its result depends on nothing else but the
//! times that its stopwatch tells ([`EmbeddingQuality::stage_us`]).

use std::collections::BTreeMap;
use std::sync::Arc;

use muster_machine::Stopwatch;
use muster_model::embedding::{Embedding, EmbeddingMode, EmbeddingQuality};
use muster_model::graph::{GraphReplica, Node};
use muster_model::header::Revision;
use muster_model::id::{Modality, RobotId};
use muster_model::settings::{
    Alpha, Dimension, EmbedderSettings, MAX_DIMENSION, Normalization, RowScaling,
    SingularValueScaling,
};
use muster_numeric::alignment::align;
use muster_numeric::embedding::{Rows, Scale, embed};
use muster_numeric::fuse::{self, fuse};
use muster_numeric::katz::{self, KatzError};
use muster_numeric::katz_svd::KatzSvdError;
use muster_numeric::matrix::{DenseMatrix, MatrixError, SparseMatrix};
use muster_numeric::svd::SvdError;

use crate::cache::{Cache, Cut, Obtained, Wanted, obtain, radius_of};
use crate::follow::Frame;

/// What an embedding rests on. As long as it stays the same, so does the embedding.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Basis {
    /// The robots, ordered by name.
    pub(crate) robots: Arc<[RobotId]>,
    /// The graphs with their revisions.
    pub(crate) graphs: Vec<(Modality, Revision)>,
    /// The settings.
    pub(crate) settings: EmbedderSettings,
    /// How many teams the rule for the dimension reckons with; none if the dimension is fixed.
    pub(crate) teams: Option<u32>,
}

/// The computation of one embedding.
#[derive(Debug)]
pub struct Job {
    pub(crate) frame: Arc<Frame>,
    pub(crate) basis: Basis,
    /// With which embedding the new one is aligned.
    pub(crate) previous: Option<Arc<Embedding>>,
    /// It returns with the end of the job.
    pub(crate) cache: Option<Cache>,
}

/// The end of a job.
#[derive(Debug)]
pub struct Done {
    pub(crate) frame: Arc<Frame>,
    pub(crate) basis: Basis,
    pub(crate) cache: Option<Cache>,
    pub(crate) result: Result<Computed, ComputeError>,
}

/// An embedding without its head.
#[derive(Debug)]
pub(crate) struct Computed {
    pub(crate) graphs: Vec<(Modality, Revision, f64)>,
    pub(crate) dimension: u32,
    pub(crate) values: Vec<f64>,
    pub(crate) unseen: Vec<bool>,
    pub(crate) quality: EmbeddingQuality,
}

/// Why a frame has no embedding.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum ComputeError {
    /// No graph counts.
    #[error("weights: none of the modalities that have a weight is among the fleet's: {0}")]
    Weightless(String),
    /// The series of paths does not converge.
    #[error(
        "alpha: {alpha} must be less than 1/ρ = {limit} of this frame; \
         set it below, or as {{\"fraction\": 0.5}}"
    )]
    Diverges {
        /// The decay of the settings.
        alpha: f64,
        /// What it must stay below.
        limit: f64,
    },
    /// A graph is no matrix.
    #[error("a graph cannot be used: {0}")]
    Graph(#[from] MatrixError),
    /// The graphs cannot be fused.
    #[error("the graphs cannot be fused: {0}")]
    Fuse(#[from] fuse::FuseError),
    /// The similarity cannot be computed.
    #[error("the similarity cannot be computed: {0}")]
    Katz(KatzError),
    /// The similarity cannot be decomposed.
    #[error("the similarity cannot be decomposed: {0}")]
    Svd(#[from] SvdError),
    /// Its leading triplets cannot be searched for.
    #[error("the similarity cannot be decomposed: {0}")]
    Search(KatzSvdError),
}

impl ComputeError {
    /// What tells failures apart, whatever numbers stand in their text.
    pub(crate) fn kind(&self) -> &'static str {
        match self {
            Self::Weightless(_) => "weights",
            Self::Diverges { .. } => "alpha",
            Self::Graph(_) => "graph",
            Self::Fuse(_) => "fuse",
            Self::Katz(_) => "katz",
            Self::Svd(_) | Self::Search(_) => "svd",
        }
    }
}

/// Does a job.
pub(crate) fn run(job: Job, stopwatch: &mut Stopwatch) -> Done {
    let Job { frame, basis, previous, mut cache } = job;
    let result = compute(&frame, &basis, previous.as_deref(), &mut cache, stopwatch);
    Done { frame, basis, cache, result }
}

fn compute(
    frame: &Frame,
    basis: &Basis,
    previous: Option<&Embedding>,
    cache: &mut Option<Cache>,
    stopwatch: &mut Stopwatch,
) -> Result<Computed, ComputeError> {
    let settings = &basis.settings;
    let names = basis.graphs.iter().map(|(name, _)| name);
    let weights = match weights(&settings.weights, names) {
        // Whatever the weights, nobody is left to be divided, and that must be told.
        Err(_) if basis.robots.is_empty() => vec![0.0; basis.graphs.len()],
        weights => weights?,
    };
    let fused = fused(frame, &weights, settings.normalize)?;
    let radius = radius_of(cache.as_ref(), &fused);
    let alpha = match settings.alpha {
        Alpha::Value(alpha) => katz::Alpha::Value(alpha),
        Alpha::Fraction { fraction } => katz::Alpha::Fraction(fraction),
    };
    let alpha = alpha.resolve(&fused, &radius)?;
    let fused_us = stopwatch.lap();

    let named = basis.graphs.iter().zip(weights);
    let graphs = named.map(|((name, at), weight)| (name.clone(), *at, weight)).collect();
    let robots = basis.robots.len();
    let bounds = (radius.lower, radius.upper);
    if robots < 2 || fused.is_zero() {
        let quality = EmbeddingQuality {
            spectral_radius: bounds,
            alpha,
            singular_values: vec![0.0],
            next_singular_value: 0.0,
            residual: 0.0,
            katz_residual: 0.0,
            gap: 0.0,
            ambiguous: false,
            mode: EmbeddingMode::Dense,
            stage_us: [fused_us, 0, 0],
        };
        let (values, unseen) = (vec![0.0; 2 * robots], vec![true; robots]);
        return Ok(Computed { graphs, dimension: 2, values, unseen, quality });
    }

    let related = related(&fused);
    let before = previous.map(|embedding| embedding.dimension as usize / 2);
    let cut = match (settings.dimension, basis.teams) {
        (Dimension::Fixed(dimension), _) => Cut::Fixed(dimension as usize / 2),
        (Dimension::Auto, teams) => Cut::Seeing {
            teams: teams.unwrap_or(2) as usize,
            related: &related,
            before,
            most: MAX_DIMENSION as usize / 2,
        },
    };
    let wanted = Wanted {
        fused,
        radius,
        alpha,
        robots: &basis.robots,
        tolerance: settings.residual_tolerance,
        seed: frame.roster.header.revision.epoch,
        cut,
    };
    let Obtained { svd, mode, residual, probe, took_us } = obtain(cache, wanted, stopwatch)?;
    let scale = match settings.scale {
        SingularValueScaling::None => Scale::None,
        SingularValueScaling::SqrtSigma => Scale::SqrtSigma,
    };
    let rows = match settings.rows {
        RowScaling::None => Rows::None,
        RowScaling::Unit => Rows::Unit,
    };
    let embedded = embed(&svd, scale, rows);
    let x = match previous {
        Some(previous) => aligned(embedded.x, &svd.sigma, previous, &basis.robots),
        None => embedded.x,
    };
    let [katz_us, svd_us] = took_us;
    Ok(Computed {
        graphs,
        dimension: u32::try_from(x.cols()).unwrap_or(u32::MAX),
        unseen: embedded.weak,
        quality: EmbeddingQuality {
            spectral_radius: bounds,
            alpha,
            next_singular_value: svd.sigma_next.unwrap_or(0.0),
            residual,
            katz_residual: probe,
            gap: svd.gap(),
            ambiguous: svd.ambiguous(),
            mode,
            stage_us: [fused_us, katz_us, svd_us.saturating_add(stopwatch.lap())],
            singular_values: svd.sigma,
        },
        values: x.into_data(),
    })
}

/// The weight of each modality of the fleet. Weights of modalities that the fleet does not have are
/// shared out among those that it has, in proportion.
fn weights<'a>(
    set: &BTreeMap<Modality, f64>,
    fleet: impl ExactSizeIterator<Item = &'a Modality> + Clone,
) -> Result<Vec<f64>, ComputeError> {
    if set.is_empty() {
        #[expect(clippy::cast_precision_loss, reason = "there are a few modalities")]
        return Ok(vec![1.0 / fleet.len() as f64; fleet.len()]);
    }
    let weights: Vec<f64> =
        fleet.clone().map(|name| set.get(name).copied().unwrap_or(0.0)).collect();
    let present: f64 = weights.iter().sum();
    if present <= 0.0 && !weights.is_empty() {
        let names: Vec<_> = fleet.map(Modality::as_str).collect();
        return Err(ComputeError::Weightless(names.join(", ")));
    }
    // Where nothing is missing, the weights stay as the operator wrote them.
    let counted = set.values().filter(|weight| **weight > 0.0).count();
    if weights.iter().filter(|weight| **weight > 0.0).count() == counted {
        return Ok(weights);
    }
    Ok(weights.into_iter().map(|weight| weight / present).collect())
}

/// A* of a frame.
fn fused(
    frame: &Frame,
    weights: &[f64],
    normalize: Normalization,
) -> Result<SparseMatrix, ComputeError> {
    if frame.graphs.is_empty() {
        return Ok(SparseMatrix::from_triplets(frame.robots.len(), [])?);
    }
    let matrices = frame.graphs.iter().map(|(_, graph)| adjacency(graph, &frame.robots));
    let matrices = matrices.collect::<Result<Vec<_>, _>>()?;
    let weighted: Vec<_> = matrices.iter().zip(weights.iter().copied()).collect();
    let normalization = match normalize {
        Normalization::None => fuse::Normalization::None,
        Normalization::Spectral => fuse::Normalization::Spectral,
    };
    Ok(fuse(&weighted, normalization)?)
}

/// The matrix of a graph over robots that are ordered by name. Edges of other robots are left out;
/// a consistent frame has none.
fn adjacency(graph: &GraphReplica, robots: &[RobotId]) -> Result<SparseMatrix, MatrixError> {
    let place = |(node, robot): (&Node, &RobotId)| Some((*node, robots.binary_search(robot).ok()?));
    let places: BTreeMap<_, _> = graph.nodes().iter().filter_map(place).collect();
    let edges = graph.rows().iter().filter_map(|(source, edges)| {
        let row = *places.get(source)?;
        let places = &places;
        Some(
            edges
                .iter()
                .filter_map(move |(target, weight)| Some((row, *places.get(target)?, *weight))),
        )
    });
    SparseMatrix::from_triplets(robots.len(), edges.flatten())
}

/// Whether each robot has an edge, from it or to it.
fn related(fused: &SparseMatrix) -> Vec<bool> {
    let mut related = vec![false; fused.nodes()];
    for (from, to, _) in fused.triplets() {
        related[from] = true;
        related[to] = true;
    }
    related
}

/// X with its columns turned onto those of the embedding before, over the robots that both have.
/// An embedding before that has no usable form is no reason to have none now.
fn aligned(x: DenseMatrix, sigma: &[f64], previous: &Embedding, robots: &[RobotId]) -> DenseMatrix {
    let old = &previous.robots;
    let columns = previous.dimension as usize;
    let Ok(before) = DenseMatrix::new(old.len(), columns, previous.values.clone()) else {
        return x;
    };
    let pair = |(new, robot): (usize, &RobotId)| Some((new, old.binary_search(robot).ok()?));
    let pairs: Vec<_> = robots.iter().enumerate().filter_map(pair).collect();
    let turned = align(&x, sigma, &before, &pairs).ok();
    turned.unwrap_or(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn weighed(set: &[(&str, f64)], fleet: &[&str]) -> Result<Vec<f64>, ComputeError> {
        let name = |text: &str| Modality::new(text).unwrap();
        let set = set.iter().map(|(text, weight)| (name(text), *weight)).collect();
        let fleet: Vec<_> = fleet.iter().map(|text| name(text)).collect();
        weights(&set, fleet.iter())
    }

    #[test]
    fn weights_are_equal_unless_set() {
        assert_eq!(weighed(&[], &["a", "b"]), Ok(vec![0.5, 0.5]));
        assert_eq!(weighed(&[], &[]), Ok(vec![]));
        assert_eq!(weighed(&[("a", 0.3), ("b", 0.7)], &["a", "b", "c"]), Ok(vec![0.3, 0.7, 0.0]));
    }

    #[test]
    fn weights_of_modalities_that_the_fleet_lacks_are_shared_out() {
        let set = [("a", 0.25), ("b", 0.25), ("c", 0.5)];
        assert_eq!(weighed(&set, &["a", "b"]), Ok(vec![0.5, 0.5]));
        assert!(matches!(weighed(&[("c", 1.0)], &["a"]), Err(ComputeError::Weightless(_))));
    }
}
