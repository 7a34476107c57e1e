//! From the graphs of a frame to the fused one, A* = Σ w_m N_m + β I.
//!
//! N_m is the graph A_m + r_m A_mᵀ, scaled as the parameters say. β is the weight of self-loops, over the
//! robots that have an edge. Each weight is multiplied by the trust in the modality, each rank by the trust
//! in it (see [`crate::trust`]).
//!
//! Graphs that are those of the frame before keep their matrices, and scales stay while norms or degrees
//! stay near them: where one robot moves, few rows of A* change.

use std::collections::BTreeMap;
use std::sync::Arc;

use muster_model::id::{Modality, RobotId};
use muster_model::settings::Normalization;
use muster_numeric::fuse::{degree_scaled, fuse_scaled, raised_degrees};
use muster_numeric::matrix::{MatrixError, SparseMatrix};
use muster_numeric::norm_band::NormBand;

use crate::candidates::Relation;
use crate::error::MethodError;
use crate::graph::{Frame, Graph};
use crate::orders::Standings;
use crate::params::{EmbeddingParams, Pace};
use crate::trust::{Trust, TrustTracker, Voice};

/// The graphs of the last frame as matrices.
#[derive(Debug, Default)]
pub(crate) struct Fusion {
    robots: Arc<[RobotId]>,
    graphs: BTreeMap<Modality, Scaled>,
    trust: TrustTracker,
    self_loops: f64,
}

/// The fused graph of a frame.
#[derive(Debug)]
pub(crate) struct Fused {
    /// A*.
    pub(crate) matrix: SparseMatrix,
    /// The weight of each graph of the frame, in its order, with the trust in it.
    pub(crate) weights: Vec<f64>,
    /// The trust in each graph of the frame, in its order.
    pub(crate) trust: Vec<Trust>,
    /// The graphs as they are reported, by which the number of teams is chosen; none where it is fixed.
    pub(crate) relations: Vec<Relation>,
    /// Per robot, whether one modality alone relates it to others, where several relate robots of the fleet.
    pub(crate) provisional: Vec<bool>,
}

/// A graph with a weight.
#[derive(Debug)]
struct Scaled {
    /// None where robots came or went: the matrix is that of another list, but its scale may hold.
    graph: Option<Graph>,
    reciprocity: f64,
    /// The matrix before it is divided by degrees.
    reported: Arc<SparseMatrix>,
    matrix: Arc<SparseMatrix>,
    scale: Scale,
    /// The matrix with the trust in each of its edges; that matrix itself where all are trusted.
    trusted: Arc<SparseMatrix>,
    weight: f64,
}

/// What a matrix was divided by, for the next frame.
#[derive(Debug)]
enum Scale {
    /// Nothing.
    None,
    /// A norm, within a band of this hysteresis.
    Norm { hysteresis: f64, band: NormBand, norm: f64 },
    /// The degrees of the edges that leave and that end at each robot: `exact` if they are those of the matrix.
    Degrees { outgoing: Vec<f64>, incoming: Vec<f64>, exact: bool },
}

impl Fusion {
    /// A* of a frame whose graphs have these weights.
    pub(crate) fn fuse(
        &mut self,
        frame: &Frame,
        mut weights: Vec<f64>,
        new_orders: &[usize],
        params: &EmbeddingParams,
    ) -> Result<Fused, MethodError> {
        let mut known = std::mem::take(&mut self.graphs);
        if *self.robots != *frame.robots {
            known.values_mut().for_each(|scaled| scaled.graph = None);
        }
        self.robots = Arc::clone(&frame.robots);
        for ((name, graph), weight) in frame.graphs.iter().zip(&weights) {
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
        let ranks = self.graphs.get(&Modality::hierarchy());
        let standings = match ranks.filter(|_| !new_orders.is_empty()) {
            Some(ranks) => {
                let reported = ranks.graph.as_ref().map(|graph| graph.matrix(&frame.robots, 0.0));
                let reported = reported.transpose().map_err(|error| MethodError::Graph {
                    modality: Modality::hierarchy(),
                    error,
                })?;
                reported.map(|reported| Standings::new(&reported, new_orders)).unwrap_or_default()
            }
            None => Standings::default(),
        };
        let trust = self.weigh_by_trust(frame, &mut weights, &standings, params)?;
        self.self_loops = params.self_loops;
        let relations = match params.teams.fixed() {
            Some(_) => Vec::new(),
            None => self.relations(&standings)?,
        };
        let Sum { matrix, provisional } = self.sum(frame.robots.len())?;
        Ok(Fused { matrix, weights, trust, relations, provisional })
    }

    /// The graphs as they are reported, without what is not trusted and what old orders explain.
    fn relations(&self, standings: &Standings) -> Result<Vec<Relation>, MethodError> {
        let relation = |(name, scaled): (&Modality, &Scaled)| {
            let weighed = self.weighed(name, &scaled.reported, standings)?;
            Ok((weighed, scaled.weight))
        };
        self.graphs.iter().map(relation).collect()
    }

    /// A graph of a modality with the trust in each of its edges.
    fn weighed(
        &self,
        name: &Modality,
        matrix: &Arc<SparseMatrix>,
        standings: &Standings,
    ) -> Result<Arc<SparseMatrix>, MethodError> {
        let weighed = if *name == Modality::hierarchy() {
            self.trust.weigh_edges(name, matrix, standings)
        } else {
            let without_old = standings.weigh_edges(matrix);
            without_old.map_or_else(|| Ok(Arc::clone(matrix)), |weighed| weighed.map(Arc::new))
        };
        weighed.map_err(|error| MethodError::Graph { modality: name.clone(), error })
    }

    /// Multiplies the weights of the modalities, and of the edges of some, by the trust in them.
    fn weigh_by_trust(
        &mut self,
        frame: &Frame,
        weights: &mut [f64],
        standings: &Standings,
        params: &EmbeddingParams,
    ) -> Result<Vec<Trust>, MethodError> {
        let voices = self.graphs.iter().map(|(name, scaled)| Voice {
            name,
            matrix: &scaled.matrix,
            weight: scaled.weight,
            norm: match scaled.scale {
                Scale::None => {
                    let (outgoing, incoming) = scaled.matrix.degrees();
                    outgoing.into_iter().chain(incoming).fold(f64::MIN_POSITIVE, f64::max)
                }
                Scale::Norm { norm, .. } => norm,
                Scale::Degrees { .. } => 1.0,
            },
            is_trusted: params.trusted.contains(name),
        });
        let voices: Vec<Voice<'_>> = voices.collect();
        self.trust.update(&frame.robots, &voices, standings, params)?;
        let trust: Vec<Trust> =
            frame.graphs.iter().map(|(name, _)| self.trust.of(name, &frame.robots)).collect();
        let before: f64 = weights.iter().sum();
        for (weight, trust) in weights.iter_mut().zip(&trust) {
            *weight *= trust.factor;
        }
        // The sum stays: self-loops keep their weight in relation to all other edges.
        let after: f64 = weights.iter().sum();
        if after > 0.0 && after != before {
            weights.iter_mut().for_each(|weight| *weight *= before / after);
        }
        for ((name, _), weight) in frame.graphs.iter().zip(weights.iter()) {
            let Some(scaled) = self.graphs.get(name) else { continue };
            let trusted = self.weighed(name, &scaled.matrix, standings)?;
            if let Some(scaled) = self.graphs.get_mut(name) {
                (scaled.weight, scaled.trusted) = (*weight, trusted);
            }
        }
        Ok(trust)
    }

    /// Σ w_m N_m + β I.
    fn sum(&self, robots: usize) -> Result<Sum, MethodError> {
        let parts = self.graphs.values();
        let parts = parts.map(|graph| (&*graph.trusted, graph.weight, graph.scale.norm()));
        let mut parts: Vec<_> = parts.collect();
        // By how many modalities each robot is related, and by which the last time.
        let mut related = vec![Related::default(); robots];
        let mut relating = 0;
        let weighty = parts.iter().filter(|(_, weight, _)| *weight > 0.0);
        for ((graph, ..), number) in weighty.zip(1..) {
            let mut any = false;
            for (row, col, _) in graph.triplets() {
                any = true;
                related[row].count_once(number);
                related[col].count_once(number);
            }
            relating += u32::from(any);
        }
        let provisional =
            related.iter().map(|related| relating > 1 && related.modalities == 1).collect();
        let loops = related.iter().enumerate().filter(|(_, related)| related.modalities > 0);
        let loops = SparseMatrix::from_triplets(robots, loops.map(|(i, _)| (i, i, 1.0)));
        let loops = loops.map_err(muster_numeric::fuse::FuseError::from)?;
        parts.push((&loops, self.self_loops, 1.0));
        Ok(Sum { matrix: fuse_scaled(&parts)?, provisional })
    }

    /// The graphs that A* consists of besides self-loops, each with its weight there: w_m / s_m.
    pub(crate) fn parts(&self) -> impl Iterator<Item = (&Modality, &SparseMatrix, f64)> {
        let weight = |graph: &Scaled| graph.weight / graph.scale.norm();
        self.graphs.iter().map(move |(name, graph)| (name, &*graph.trusted, weight(graph)))
    }

    /// The weight of self-loops in A*.
    pub(crate) fn self_loops(&self) -> f64 {
        self.self_loops
    }
}

/// A* with what was seen on the way.
struct Sum {
    matrix: SparseMatrix,
    provisional: Vec<bool>,
}

/// By how many modalities a robot is related to others.
#[derive(Clone, Copy, Default)]
struct Related {
    modalities: u32,
    last: u32,
}

impl Related {
    /// Counts a modality, whatever the number of its edges.
    fn count_once(&mut self, modality: u32) {
        self.modalities += u32::from(self.last != modality);
        self.last = modality;
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
        let is_moving = params.pace == Pace::Moving;
        let known = |scaled: &Self| scaled.graph.as_ref().is_some_and(|known| known.is(graph));
        let before = match before {
            Some(before) if known(&before) && before.scale.holds(params) => {
                let trusted = Arc::clone(&before.matrix);
                return Ok(Self { trusted, weight, ..before });
            }
            before => before,
        };
        let same_robots = before.as_ref().is_some_and(|before| before.graph.is_some());
        let reported = graph.matrix(robots, reciprocity)?;
        let (matrix, scale) = match params.normalize {
            Normalization::None => (Arc::clone(&reported), Scale::None),
            Normalization::Spectral => {
                let scale = by_norm(&reported, before.map(|before| before.scale), params);
                (Arc::clone(&reported), scale)
            }
            Normalization::Degree => {
                let kept = before.filter(|_| same_robots && is_moving).map(|before| before.scale);
                by_degrees(&reported, kept, params.hysteresis)?
            }
        };
        let trusted = Arc::clone(&matrix);
        let graph = Some(graph.clone());
        Ok(Self { graph, reciprocity, reported, matrix, scale, trusted, weight })
    }
}

impl Scale {
    /// What the matrix is still to be divided by.
    fn norm(&self) -> f64 {
        match self {
            Self::Norm { norm, .. } => *norm,
            Self::None | Self::Degrees { .. } => 1.0,
        }
    }

    /// Whether the scale of the same graph in the frame before serves.
    fn holds(&self, params: &EmbeddingParams) -> bool {
        let is_moving = params.pace == Pace::Moving;
        match (self, params.normalize) {
            (Self::None, Normalization::None) => true,
            (Self::Norm { hysteresis, .. }, Normalization::Spectral) => {
                is_moving && hysteresis.to_bits() == params.hysteresis.to_bits()
            }
            (Self::Degrees { exact, .. }, Normalization::Degree) => is_moving || *exact,
            _ => false,
        }
    }
}

/// The norm of a matrix, that of the frame before while it fits.
fn by_norm(matrix: &SparseMatrix, before: Option<Scale>, params: &EmbeddingParams) -> Scale {
    let hysteresis = params.hysteresis;
    let mut band = match before {
        Some(Scale::Norm { hysteresis: of, band, .. }) if of.to_bits() == hysteresis.to_bits() => {
            band
        }
        // Valid parameters have a valid hysteresis; without one, norms are exact.
        _ => NormBand::new(hysteresis).unwrap_or_default(),
    };
    if params.pace == Pace::AtRest {
        band.reset();
    }
    let norm = band.choose(matrix);
    Scale::Norm { hysteresis, band, norm: if norm > 0.0 { norm } else { 1.0 } }
}

/// A matrix divided by its degrees, of which each is that of the frame before while it fits.
fn by_degrees(
    matrix: &SparseMatrix,
    before: Option<Scale>,
    hysteresis: f64,
) -> Result<(Arc<SparseMatrix>, Scale), MatrixError> {
    let (mut outgoing, mut incoming) = raised_degrees(matrix);
    let mut exact = true;
    if let Some(Scale::Degrees { outgoing: out_before, incoming: in_before, .. }) = before {
        for (degrees, before) in [(&mut outgoing, out_before), (&mut incoming, in_before)] {
            for (degree, before) in degrees.iter_mut().zip(before) {
                if *degree != before && (*degree - before).abs() <= hysteresis * before {
                    *degree = before;
                    exact = false;
                }
            }
        }
    }
    let scaled = degree_scaled(matrix, &outgoing, &incoming)?;
    Ok((Arc::new(scaled), Scale::Degrees { outgoing, incoming, exact }))
}
