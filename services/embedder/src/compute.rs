//! The job: from one consistent frame to one vector per robot, or to the similarity of pairs.
//!
//! A job owns or shares everything that it needs, and its result depends on nothing else but the
//! times that its stopwatch tells ([`EmbeddingQuality::stage_us`]).

use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;

use muster_machine::Stopwatch;
use muster_model::embedding::{Embedding, EmbeddingMode, EmbeddingQuality};
use muster_model::graph::GraphReplica;
use muster_model::header::Revision;
use muster_model::id::{Modality, RobotId};
use muster_model::settings::{
    Dimension, EmbedderSettings, MAX_DIMENSION, RowScaling, SingularValueScaling, WHOLE_FROM,
    default_weight,
};
use muster_numeric::alignment::align;
use muster_numeric::embedding::{Rows, Scale, embed};
use muster_numeric::fuse;
use muster_numeric::katz::KatzError;
use muster_numeric::katz_svd::KatzSvdError;
use muster_numeric::matrix::{DenseMatrix, MatrixError, SparseMatrix};
use muster_numeric::svd::SvdError;

use crate::cache::{Cache, Cut, Obtained, Wanted};
use crate::correspondence::Correspondence;
use crate::decay::{Chosen, Decay};
use crate::follow::Frame;
use crate::fusion::{Fusion, Recipe};
use crate::pairs::{Compared, Fused, NOTHING_TO_COMPARE, compare};
use crate::similarity::Similarity;

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
    /// Whether the fleet has come to rest, so that there is time for the scales and the decay of its very
    /// graphs, and for more digits.
    pub(crate) settled: bool,
}

impl Basis {
    /// Whether both rest on the same, at rest or not.
    pub(crate) fn is_of(&self, other: &Self) -> bool {
        (&self.robots, &self.graphs, &self.settings, self.teams)
            == (&other.robots, &other.graphs, &other.settings, other.teams)
    }
}

/// Long work.
#[derive(Debug)]
pub struct Job {
    pub(crate) task: Task,
    /// It returns with the end of the job.
    pub(crate) memory: Box<Memory>,
}

/// What a job is to do.
#[derive(Debug)]
pub(crate) enum Task {
    /// An embedding.
    Embed {
        frame: Arc<Frame>,
        basis: Basis,
        /// With which embedding the new one is aligned.
        previous: Option<Arc<Embedding>>,
    },
    /// The similarity of pairs of robots, by the graphs of the last embedding.
    Compare(Vec<[RobotId; 2]>),
}

/// The end of a job.
#[derive(Debug)]
pub struct Done {
    pub(crate) memory: Box<Memory>,
    pub(crate) result: Outcome,
}

/// What a job has led to.
#[derive(Debug)]
pub(crate) enum Outcome {
    Embedded { frame: Arc<Frame>, basis: Box<Basis>, result: Result<Box<Computed>, ComputeError> },
    Compared(Vec<Result<Compared, String>>),
}

/// What is kept from job to job.
#[derive(Debug, Default)]
pub(crate) struct Memory {
    robots: Arc<[RobotId]>,
    fusion: Fusion,
    decay: Decay,
    similarity: Similarity,
    cache: Cache,
    /// A* and its decay, once there is an embedding.
    pub(crate) last: Option<(SparseMatrix, Chosen)>,
}

/// An embedding without its head.
#[derive(Debug)]
pub(crate) struct Computed {
    pub(crate) graphs: Vec<(Modality, Revision, f64)>,
    pub(crate) dimension: u32,
    pub(crate) values: Vec<f64>,
    pub(crate) unseen: Vec<bool>,
    pub(crate) centrality: Vec<f64>,
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
    let Job { task, mut memory } = job;
    let result = match task {
        Task::Embed { frame, basis, previous } => {
            let result = compute(&frame, &basis, previous.as_deref(), &mut memory, stopwatch);
            Outcome::Embedded { frame, basis: Box::new(basis), result: result.map(Box::new) }
        }
        Task::Compare(pairs) => Outcome::Compared(memory.compare(&pairs)),
    };
    Done { memory, result }
}

impl Memory {
    /// The similarity of pairs of robots by the graphs of the last embedding.
    fn compare(&mut self, pairs: &[[RobotId; 2]]) -> Vec<Result<Compared, String>> {
        let Some((fused, chosen)) = &self.last else {
            return pairs.iter().map(|_| Err(NOTHING_TO_COMPARE.to_owned())).collect();
        };
        let fused = Fused { matrix: fused, chosen, robots: &self.robots };
        compare(fused, &self.fusion, &mut self.similarity, pairs)
    }

    /// A* and its decay for a frame.
    fn fuse(
        &mut self,
        frame: &Frame,
        basis: &Basis,
    ) -> Result<(SparseMatrix, Chosen), ComputeError> {
        let settings = &basis.settings;
        self.last = None;
        if let Some(between) = Correspondence::between(&self.robots, &frame.robots) {
            self.decay.carry(&between);
        }
        self.robots = Arc::clone(&frame.robots);
        let recipe = Recipe {
            weights: &weights_of(frame, basis)?,
            reciprocity: &settings.reciprocity,
            normalize: settings.normalize,
            hysteresis: settings.hysteresis,
            settle: basis.settled,
        };
        let fused = self.fusion.fuse(frame, recipe)?;
        let chosen =
            self.decay.choose(&fused, settings.alpha, settings.hysteresis, basis.settled)?;
        if basis.settled {
            // Not brought up to date, but solved anew: to the last digits.
            self.similarity = Similarity::default();
        }
        Ok((fused, chosen))
    }
}

fn weights_of(frame: &Frame, basis: &Basis) -> Result<Vec<f64>, ComputeError> {
    let robots = frame.robots.len();
    let fleet = frame.graphs.iter().map(|(name, graph)| (name, || related_share(graph, robots)));
    match weights(&basis.settings.weights, fleet) {
        // Whatever the weights, nobody is left to be divided, and that must be told.
        Err(_) if basis.robots.is_empty() => Ok(vec![0.0; basis.graphs.len()]),
        weights => weights,
    }
}

fn compute(
    frame: &Frame,
    basis: &Basis,
    previous: Option<&Embedding>,
    memory: &mut Memory,
    stopwatch: &mut Stopwatch,
) -> Result<Computed, ComputeError> {
    let settings = &basis.settings;
    let (fused, chosen) = memory.fuse(frame, basis)?;
    let centrality = chosen.centrality.clone();
    let fused_us = stopwatch.lap();

    let named = basis.graphs.iter().zip(weights_of(frame, basis)?);
    let graphs = named.map(|((name, at), weight)| (name.clone(), *at, weight)).collect();
    let robots = basis.robots.len();
    let bounds = (chosen.radius.lower, chosen.radius.upper);
    let alpha = chosen.alpha;
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
        memory.last = Some((fused, chosen));
        return Ok(Computed { graphs, dimension: 2, values, unseen, centrality, quality });
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
        fused: &fused,
        chosen: &chosen,
        robots: &basis.robots,
        tolerance: if basis.settled {
            settings.idle_tolerance.min(settings.residual_tolerance)
        } else {
            settings.residual_tolerance
        },
        seed: frame.roster.header.revision.epoch,
        cut,
    };
    let Memory { cache, similarity, .. } = memory;
    let obtained = cache.obtain(similarity, &wanted, stopwatch)?;
    let Obtained { svd, mode, residual, probe, took_us } = obtained;
    memory.last = Some((fused, chosen));
    let scale = match settings.scale {
        SingularValueScaling::None => Scale::None,
        SingularValueScaling::SqrtSigma => Scale::SqrtSigma,
        SingularValueScaling::InverseSqrtSigma => Scale::InverseSqrtSigma,
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
        centrality,
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

/// The share of so many robots that have an edge of a graph, as far as it matters to
/// [`default_weight`]: counting ends where the graph has its whole weight.
#[expect(clippy::cast_precision_loss, reason = "there are fewer robots than 2⁵³")]
fn related_share(graph: &GraphReplica, robots: usize) -> f64 {
    let enough = robots as f64 * WHOLE_FROM;
    let mut related = HashSet::new();
    for (source, edges) in graph.rows() {
        if !edges.is_empty() {
            related.insert(*source);
            related.extend(edges.iter().map(|(target, _)| *target));
        }
        if related.len() as f64 >= enough {
            break;
        }
    }
    related.len() as f64 / robots.max(1) as f64
}

/// The weight of each modality of the fleet, which comes with the share of robots that it relates. Weights of modalities that the fleet does not have are
/// shared out among those that it has, in proportion.
fn weights<'a>(
    set: &BTreeMap<Modality, f64>,
    fleet: impl ExactSizeIterator<Item = (&'a Modality, impl Fn() -> f64)> + Clone,
) -> Result<Vec<f64>, ComputeError> {
    if set.is_empty() {
        let weights: Vec<f64> =
            fleet.map(|(name, related)| default_weight(name, related())).collect();
        let sum: f64 = weights.iter().sum();
        return Ok(weights.into_iter().map(|weight| weight / sum).collect());
    }
    let weights: Vec<f64> =
        fleet.clone().map(|(name, _)| set.get(name).copied().unwrap_or(0.0)).collect();
    let present: f64 = weights.iter().sum();
    if present <= 0.0 && !weights.is_empty() {
        let names: Vec<_> = fleet.map(|(name, _)| name.as_str()).collect();
        return Err(ComputeError::Weightless(names.join(", ")));
    }
    // Where nothing is missing, the weights stay as the operator wrote them.
    let counted = set.values().filter(|weight| **weight > 0.0).count();
    if weights.iter().filter(|weight| **weight > 0.0).count() == counted {
        return Ok(weights);
    }
    Ok(weights.into_iter().map(|weight| weight / present).collect())
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
        weights(&set, fleet.iter().map(|name| (name, || 1.0)))
    }

    #[test]
    fn modalities_that_relate_few_weigh_little() {
        let fleet = [(Modality::hierarchy(), 0.1), (Modality::spatial(), 1.0)];
        let found =
            weights(&BTreeMap::new(), fleet.iter().map(|(name, share)| (name, || *share))).unwrap();
        let sum = 0.55 * 0.2 + 0.35;
        assert!(
            (found[0] - 0.55 * 0.2 / sum).abs() < 1e-15 && (found[1] - 0.35 / sum).abs() < 1e-15
        );
    }

    #[test]
    fn weights_are_those_of_the_evidence_unless_set() {
        assert_eq!(weighed(&[], &["a", "b"]), Ok(vec![0.5, 0.5]));
        assert_eq!(weighed(&[], &[]), Ok(vec![]));
        let three = weighed(&[], &["connectivity", "hierarchy", "spatial"]).unwrap();
        for (found, wanted) in three.iter().zip([0.1, 0.55, 0.35]) {
            assert!((found - wanted).abs() < 1e-15, "{three:?}");
        }
        let more = weighed(&[], &["connectivity", "hierarchy", "leash", "spatial"]).unwrap();
        assert!((more[2] - 0.25).abs() < 1e-15, "{more:?}");
        assert_eq!(weighed(&[("a", 0.3), ("b", 0.7)], &["a", "b", "c"]), Ok(vec![0.3, 0.7, 0.0]));
    }

    #[test]
    fn weights_of_modalities_that_the_fleet_lacks_are_shared_out() {
        let set = [("a", 0.25), ("b", 0.25), ("c", 0.5)];
        assert_eq!(weighed(&set, &["a", "b"]), Ok(vec![0.5, 0.5]));
        assert!(matches!(weighed(&[("c", 1.0)], &["a"]), Err(ComputeError::Weightless(_))));
    }
}
