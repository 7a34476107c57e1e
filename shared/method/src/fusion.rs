//! From the graphs of a frame to the fused one, A* = Σ w_m (A_m + r_m A_mᵀ) / s_m.
//!
//! Graphs that are those of the frame before keep their matrices, and scales s_m stay while the norms of
//! the graphs stay near them: where one robot moves, few rows of A* change.

use std::collections::BTreeMap;
use std::sync::Arc;

use muster_model::id::{Modality, RobotId};
use muster_model::settings::Normalization;
use muster_numeric::fuse::fuse_scaled;
use muster_numeric::matrix::{MatrixError, SparseMatrix};
use muster_numeric::norm_band::NormBand;

use crate::error::MethodError;
use crate::graph::{Frame, Graph};
use crate::params::{EmbeddingParams, Pace};

/// The graphs of the last frame as matrices.
#[derive(Debug, Default)]
pub(crate) struct Fusion {
    robots: Arc<[RobotId]>,
    graphs: BTreeMap<Modality, Scaled>,
}

/// A graph with a weight.
#[derive(Debug)]
struct Scaled {
    /// None where robots came or went: the matrix is that of another list, but its scale may hold.
    graph: Option<Graph>,
    reciprocity: f64,
    matrix: Arc<SparseMatrix>,
    weight: f64,
    /// None without scaling; with the hysteresis that it has.
    band: Option<(f64, NormBand)>,
    scale: f64,
}

impl Fusion {
    /// A* of a frame whose graphs have these weights.
    pub(crate) fn fuse(
        &mut self,
        frame: &Frame,
        weights: &[f64],
        params: &EmbeddingParams,
    ) -> Result<SparseMatrix, MethodError> {
        let mut known = std::mem::take(&mut self.graphs);
        if *self.robots != *frame.robots {
            known.values_mut().for_each(|scaled| scaled.graph = None);
        }
        self.robots = Arc::clone(&frame.robots);
        for ((name, graph), weight) in frame.graphs.iter().zip(weights) {
            if *weight > 0.0 {
                let before = known.remove(name);
                let reciprocity = params.reciprocity.get(name).copied().unwrap_or(0.0);
                let kept =
                    before.filter(|before| before.reciprocity.to_bits() == reciprocity.to_bits());
                let part = Part { graph, robots: &frame.robots, weight: *weight, reciprocity };
                let scaled = Scaled::next(kept, part, params)
                    .map_err(|error| MethodError::Graph { modality: name.clone(), error })?;
                self.graphs.insert(name.clone(), scaled);
            }
        }
        if self.graphs.is_empty() {
            let none = SparseMatrix::from_triplets(frame.robots.len(), []);
            return Ok(none.map_err(muster_numeric::fuse::FuseError::from)?);
        }
        let all = self.graphs.values().map(|graph| (&*graph.matrix, graph.weight, graph.scale));
        Ok(fuse_scaled(&all.collect::<Vec<_>>())?)
    }

    /// The graphs that A* consists of, each with its weight there: w_m / s_m.
    pub(crate) fn parts(&self) -> impl Iterator<Item = (&Modality, &SparseMatrix, f64)> {
        self.graphs.iter().map(|(name, graph)| (name, &*graph.matrix, graph.weight / graph.scale))
    }
}

/// A graph of the frame that is fused.
struct Part<'a> {
    graph: &'a Graph,
    robots: &'a [RobotId],
    weight: f64,
    reciprocity: f64,
}

impl Scaled {
    fn next(
        before: Option<Self>,
        part: Part<'_>,
        params: &EmbeddingParams,
    ) -> Result<Self, MatrixError> {
        let Part { graph, robots, weight, reciprocity } = part;
        let is_same = |before: &Self| before.graph.as_ref().is_some_and(|known| known.is(graph));
        let (matrix, band, scale) = match before {
            Some(before) if is_same(&before) => (before.matrix, before.band, Some(before.scale)),
            before => (graph.matrix(robots, reciprocity)?, before.and_then(|b| b.band), None),
        };
        let hysteresis = params.hysteresis;
        let is_kept = params.pace == Pace::Moving;
        let (band, scale) = match params.normalize {
            Normalization::None => (None, 1.0),
            Normalization::Spectral => {
                let kept = band.filter(|(of, _)| of.to_bits() == hysteresis.to_bits());
                match (kept, scale) {
                    (Some(band), Some(scale)) if is_kept => (Some(band), scale),
                    (kept, _) => {
                        let mut band = match kept {
                            Some((_, band)) => band,
                            // Valid parameters have a valid hysteresis; without one, norms are exact.
                            None => NormBand::new(hysteresis).unwrap_or_default(),
                        };
                        if !is_kept {
                            band.reset();
                        }
                        let norm = band.choose(&matrix);
                        (Some((hysteresis, band)), if norm > 0.0 { norm } else { 1.0 })
                    }
                }
            }
        };
        Ok(Self { graph: Some(graph.clone()), reciprocity, matrix, weight, band, scale })
    }
}
