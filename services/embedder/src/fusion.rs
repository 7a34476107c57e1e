//! From the graphs of a frame to the fused one, A* = Σ w_m (A_m + r_m A_mᵀ) / s_m.
//!
//! Graphs that are those of the frame before keep their matrices, and scales s_m stay while the norms of
//! the graphs stay near them: where one robot moves, few rows of A* change.

use std::collections::BTreeMap;
use std::sync::Arc;

use muster_model::graph::{GraphReplica, Node};
use muster_model::id::{Modality, RobotId};
use muster_model::settings::Normalization;
use muster_numeric::fuse::fuse_scaled;
use muster_numeric::matrix::{MatrixError, SparseMatrix};
use muster_numeric::norm_band::NormBand;

use crate::compute::ComputeError;
use crate::follow::Frame;

/// How the graphs of a frame are put together.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Recipe<'a> {
    /// The weight of each graph of the frame.
    pub(crate) weights: &'a [f64],
    /// By which share the edges of a modality also lead back.
    pub(crate) reciprocity: &'a BTreeMap<Modality, f64>,
    pub(crate) normalize: Normalization,
    /// How far norms may drift from the scales.
    pub(crate) hysteresis: f64,
    /// Whether the scales are to be the norms of these very graphs.
    pub(crate) settle: bool,
}

/// The graphs of the last frame as matrices.
#[derive(Debug, Default)]
pub(crate) struct Fusion {
    robots: Arc<[RobotId]>,
    graphs: BTreeMap<Modality, Scaled>,
}

/// A graph that counts.
#[derive(Debug)]
struct Scaled {
    graph: Arc<GraphReplica>,
    reciprocity: f64,
    matrix: SparseMatrix,
    weight: f64,
    /// None without scaling; with the hysteresis that it has.
    band: Option<(f64, NormBand)>,
    scale: f64,
}

impl Fusion {
    /// A* of a frame.
    pub(crate) fn fuse(
        &mut self,
        frame: &Frame,
        recipe: Recipe<'_>,
    ) -> Result<SparseMatrix, ComputeError> {
        let known = std::mem::take(&mut self.graphs);
        let mut known = if *self.robots == *frame.robots { known } else { without_matrices(known) };
        self.robots = Arc::clone(&frame.robots);
        for ((name, graph), weight) in frame.graphs.iter().zip(recipe.weights) {
            if *weight > 0.0 {
                let before = known.remove(name);
                let share = recipe.reciprocity.get(name).copied().unwrap_or(0.0);
                let kept = before.filter(|before| before.reciprocity.to_bits() == share.to_bits());
                let scaled = Scaled::next(kept, graph, &frame.robots, (*weight, share), recipe)?;
                self.graphs.insert(name.clone(), scaled);
            }
        }
        if self.graphs.is_empty() {
            return Ok(SparseMatrix::from_triplets(frame.robots.len(), [])?);
        }
        let all = self.graphs.values().map(|graph| (&graph.matrix, graph.weight, graph.scale));
        Ok(fuse_scaled(&all.collect::<Vec<_>>())?)
    }

    /// The graphs that A* consists of, each with its weight there: w_m / s_m.
    pub(crate) fn parts(&self) -> impl Iterator<Item = (&Modality, &SparseMatrix, f64)> {
        self.graphs.iter().map(|(name, graph)| (name, &graph.matrix, graph.weight / graph.scale))
    }
}

/// Where robots came or went, no matrix holds any longer, but scales may.
fn without_matrices(mut known: BTreeMap<Modality, Scaled>) -> BTreeMap<Modality, Scaled> {
    known.values_mut().for_each(|scaled| scaled.graph = Arc::default());
    known
}

impl Scaled {
    fn next(
        before: Option<Self>,
        graph: &Arc<GraphReplica>,
        robots: &[RobotId],
        (weight, reciprocity): (f64, f64),
        recipe: Recipe<'_>,
    ) -> Result<Self, MatrixError> {
        let (matrix, band, scale) = match before {
            Some(before) if Arc::ptr_eq(&before.graph, graph) => {
                (before.matrix, before.band, Some(before.scale))
            }
            Some(before) => (adjacency(graph, robots, reciprocity)?, before.band, None),
            None => (adjacency(graph, robots, reciprocity)?, None, None),
        };
        let hysteresis = recipe.hysteresis;
        let (band, scale) = match recipe.normalize {
            Normalization::None => (None, 1.0),
            Normalization::Spectral => {
                let kept = band.filter(|(of, _)| of.to_bits() == hysteresis.to_bits());
                match (kept, scale) {
                    (Some(band), Some(scale)) if !recipe.settle => (Some(band), scale),
                    (kept, _) => {
                        let mut band = match kept {
                            Some((_, band)) => band,
                            // Settings have checked the hysteresis; without it norms are exact.
                            None => NormBand::new(hysteresis).unwrap_or_default(),
                        };
                        if recipe.settle {
                            band.reset();
                        }
                        let norm = band.choose(&matrix);
                        (Some((hysteresis, band)), if norm > 0.0 { norm } else { 1.0 })
                    }
                }
            }
        };
        Ok(Self { graph: Arc::clone(graph), reciprocity, matrix, weight, band, scale })
    }
}

/// The matrix of a graph over robots that are ordered by name, with what leads back. Edges of other
/// robots are left out; a consistent frame has none.
fn adjacency(
    graph: &GraphReplica,
    robots: &[RobotId],
    reciprocity: f64,
) -> Result<SparseMatrix, MatrixError> {
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
    let reported = SparseMatrix::from_triplets(robots.len(), edges.flatten())?;
    if reciprocity > 0.0 { reported.with_reverse(reciprocity) } else { Ok(reported) }
}
