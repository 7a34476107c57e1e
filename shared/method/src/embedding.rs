//! From graphs to vectors, at once and from frame to frame.

use std::sync::Arc;

use muster_model::embedding::{Embedding, EmbeddingMode};
use muster_model::id::RobotId;
use muster_model::settings::Dimension;
use muster_numeric::alignment::align;
use muster_numeric::embedding::embed_powers;
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::svd::RankKSvd;

use crate::candidates::Counted;
use crate::correspondence::Correspondence;
use crate::cut::Cut;
use crate::decay::{Decay, DecayTracker};
use crate::decomposition::{Decomposer, Decomposition, Path, Task};
use crate::error::MethodError;
use crate::fusion::{Fused, Fusion};
use crate::graph::Frame;
use crate::params::{Pace, ValidEmbeddingParams};
use crate::similarity::Similarity;
use crate::step::{Progress, Step};
use crate::team_count::TeamEvidence;
use crate::trust::Trust;
use crate::weights::weights;

/// The vectors of a frame, and what they rest on.
#[derive(Debug)]
pub struct Embedded {
    /// The weight of each graph of the frame, in its order, with the trust in it.
    pub weights: Vec<f64>,
    /// The trust in each graph of the frame, in its order.
    pub trust: Vec<Trust>,
    /// The decay and bounds of ρ(A*).
    pub decay: Decay,
    /// The leading triplets of the similarity.
    pub decomposition: Decomposition,
    /// X, one row of D = 2K entries per robot.
    pub x: DenseMatrix,
    /// Per robot, whether its row holds nothing: it has no edge, or its part of the fleet is weaker than the
    /// K leading triplets. Such a robot belongs to no team.
    pub without_embedding: Vec<bool>,
    /// Per robot, whether one modality alone relates it to others, where several relate robots of the fleet:
    /// nothing confirms its place.
    pub provisional: Vec<bool>,
}

/// The embedding of a single frame: one frame of new [`Frames`].
///
/// # Errors
/// [`MethodError`]
pub fn embed(
    frame: &Frame,
    params: &ValidEmbeddingParams,
    progress: &mut Progress<'_>,
) -> Result<Embedded, MethodError> {
    Frames::default().embed(frame, params, None, progress)
}

/// What is kept from frame to frame.
#[derive(Debug, Default)]
pub struct Frames {
    pub(crate) robots: Arc<[RobotId]>,
    pub(crate) fusion: Fusion,
    decay: DecayTracker,
    pub(crate) similarity: Similarity,
    decomposer: Decomposer,
    /// Robots whose superior has changed lately; see [`Frames::set_new_orders`].
    new_orders: Vec<RobotId>,
    /// How many teams the last frame showed.
    teams: Option<u32>,
    /// K of the last frame of a run before this one; none once there is a frame.
    rank: Option<usize>,
    pub(crate) last: Option<LastGraph>,
}

/// A* of the last embedding.
#[derive(Debug)]
pub(crate) struct LastGraph {
    pub(crate) fused: Arc<SparseMatrix>,
    pub(crate) decay: Decay,
    /// Katz centralities, once they were asked for.
    pub(crate) centralities: Option<Vec<f64>>,
}

impl Frames {
    /// The embedding of the next frame. `previous` is the embedding that the columns of X are turned onto,
    /// over the robots that both have; the rule for K may keep its dimension, and the number of teams that it showed is kept
    /// where these are the first frame.
    ///
    /// # Errors
    /// [`MethodError`]; the next frame begins with what is left of those before.
    pub fn embed(
        &mut self,
        frame: &Frame,
        params: &ValidEmbeddingParams,
        previous: Option<&Embedding>,
        progress: &mut Progress<'_>,
    ) -> Result<Embedded, MethodError> {
        progress(Step::Fuse);
        self.last = None;
        if let Some(between) = Correspondence::between(&self.robots, &frame.robots) {
            self.decay.carry(&between);
            self.decomposer.carry(&between);
        }
        self.robots = Arc::clone(&frame.robots);
        let weights = weights(&params.weights, frame)?;
        let place = |robot: &RobotId| frame.robots.binary_search(robot).ok();
        let new_orders: Vec<usize> = self.new_orders.iter().filter_map(place).collect();
        let Fused { matrix, weights, trust, relations, provisional } =
            self.fusion.fuse(frame, weights, &new_orders, params)?;
        let fused = Arc::new(matrix);
        progress(Step::SpectralRadius);
        let decay = self.decay.choose(&fused, params)?;
        if params.pace == Pace::AtRest {
            // Solved to the last digits, not updated.
            self.similarity = Similarity::default();
        }
        let decomposition = if fused.is_zero() {
            of_no_edges(fused.nodes(), params)?
        } else {
            let last = || previous.map(|embedding| embedding.dimension as usize / 2);
            let rank = self.rank.or_else(last);
            let cut = Cut::new(params, &fused, rank);
            let counted = Counted {
                relations: &relations,
                params,
                alpha: decay.alpha,
                previous: self.teams.or_else(|| previous?.quality.teams_shown),
                linked: &linked(&fused),
            };
            let robots = &frame.robots;
            let task = Task { fused: &fused, decay: &decay, robots, params, cut: &cut, counted };
            self.decomposer.decompose(&mut self.similarity, task, progress)?
        };
        (self.teams, self.rank) = (Some(decomposition.teams.teams), None);
        let svd = &decomposition.svd;
        let embedded = embed_powers(svd, params.power, params.rows);
        let x = match previous {
            Some(previous) if !fused.is_zero() => {
                aligned(embedded.x, &svd.sigma, previous, &frame.robots)
            }
            _ => embedded.x,
        };
        self.last = Some(LastGraph { fused, decay: decay.clone(), centralities: None });
        let without_embedding = embedded.weak;
        Ok(Embedded { weights, trust, decay, decomposition, x, without_embedding, provisional })
    }

    /// The robots whose superior is another than a moment ago, for the frames that follow: their ranks count
    /// before their places and links.
    pub fn set_new_orders(&mut self, robots: Vec<RobotId>) {
        self.new_orders = robots;
    }

    /// How many teams a frame before showed, where the first of these goes on from one that is elsewhere: the number is
    /// kept unless another is clearly better.
    pub fn set_teams_shown(&mut self, teams: Option<u32>) {
        self.teams = teams;
    }

    /// The next frame goes on from one of which the vectors are lost, with so many teams and triplets: both are kept unless
    /// others are clearly better.
    pub fn resume(&mut self, teams: Option<u32>, rank: usize) {
        (self.teams, self.rank) = (teams, Some(rank));
    }

    /// The robots of the last frame, ordered by name; none before it.
    #[must_use]
    pub fn robots(&self) -> &[RobotId] {
        &self.robots
    }

    /// A* of the last embedding; none before it.
    #[must_use]
    pub fn fused(&self) -> Option<&SparseMatrix> {
        self.last.as_ref().map(|last| &*last.fused)
    }

    /// The Katz centrality of each robot by the graphs of the last embedding, at least 1; empty before it.
    ///
    /// # Errors
    /// [`MethodError::Katz`] where they leave the range of numbers.
    pub fn centralities(&mut self) -> Result<&[f64], MethodError> {
        let Some(last) = &mut self.last else { return Ok(&[]) };
        if last.centralities.is_none() {
            let found = self.decay.centralities(&last.fused, &last.decay)?;
            last.centralities = Some(found.to_vec());
        }
        Ok(last.centralities.as_deref().unwrap_or_default())
    }
}

/// Per robot, whether it has an edge from or to another one.
fn linked(fused: &SparseMatrix) -> Vec<bool> {
    let mut linked = vec![false; fused.nodes()];
    for (from, to, _) in fused.triplets().filter(|(from, to, _)| from != to) {
        (linked[from], linked[to]) = (true, true);
    }
    linked
}

/// The decomposition of a similarity of zeros: one triplet of zeros, or as many as the parameters fix.
fn of_no_edges(nodes: usize, params: &ValidEmbeddingParams) -> Result<Decomposition, MethodError> {
    let rank = match params.dimension {
        Dimension::Auto => 1,
        Dimension::Fixed(dimension) => (dimension as usize / 2).clamp(1, nodes.max(1)),
    };
    let zeros = |rows, columns| DenseMatrix::zeros(rows, columns);
    let side = || zeros(nodes, rank).map_err(muster_numeric::katz::KatzError::from);
    let path = if nodes <= params.dense_robots { Path::Dense } else { Path::InverseFree };
    let similarity = match path {
        Path::Dense => Some(zeros(nodes, nodes).map_err(muster_numeric::katz::KatzError::from)?),
        Path::InverseFree => None,
    };
    Ok(Decomposition {
        svd: RankKSvd {
            u: side()?,
            sigma: vec![0.0; rank],
            v: side()?,
            sigma_next: (rank < nodes).then_some(0.0),
            next_residual: 0.0,
        },
        teams: TeamEvidence { teams: *params.teams.range().start(), scores: Vec::new() },
        path,
        mode: EmbeddingMode::Dense,
        residual: 0.0,
        converged: true,
        complete: true,
        probe: similarity.as_ref().map(|_| 0.0),
        similarity,
    })
}

/// X with its columns turned onto those of the embedding before, over the robots that both have. An
/// embedding before that has no usable form does no harm.
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
    use muster_model::id::Modality;
    use muster_model::settings::EmbedderSettings;

    use super::*;
    use crate::graph::Graph;
    use crate::params::EmbeddingParams;

    /// Cliques of different weights, and one robot without an edge.
    fn frame(sizes: &[usize]) -> Frame {
        let robots = sizes.iter().sum::<usize>() + 1;
        let mut edges = Vec::new();
        let mut first = 0;
        for (number, size) in sizes.iter().enumerate() {
            let members = first..first + size;
            let weight = 1.0 + 0.1 * number as f64;
            let pairs = members.clone().flat_map(|i| members.clone().map(move |j| (i, j)));
            edges.extend(pairs.filter(|(i, j)| i != j).map(|(i, j)| (i, j, weight)));
            first += size;
        }
        let matrix = SparseMatrix::from_triplets(robots, edges).unwrap();
        let names = (0..robots).map(|i| RobotId::new(format!("r{i:03}")).unwrap());
        Frame {
            robots: names.collect(),
            graphs: vec![(Modality::spatial(), Graph::Matrix(Arc::new(matrix)))],
        }
    }

    fn params(teams: usize, pace: Pace) -> ValidEmbeddingParams {
        EmbeddingParams::new(&EmbedderSettings::default(), teams, pace).check().unwrap()
    }

    #[test]
    fn a_single_frame_has_the_rank_of_a_live_fleet_at_rest() {
        // More groups than teams and fewer, decomposed whole and not.
        for sizes in [&[4, 3, 5, 4][..], &[30, 25], &[40, 20, 30]] {
            let frame = frame(sizes);
            for teams in [2, 3, 6] {
                let settings = EmbedderSettings::default();
                let once = EmbeddingParams::once(&settings, teams).check().unwrap();
                let once = embed(&frame, &once, &mut |_| {}).unwrap();
                let mut frames = Frames::default();
                for pace in [Pace::Moving, Pace::AtRest] {
                    let live = frames.embed(&frame, &params(teams, pace), None, &mut |_| {});
                    let live = live.unwrap();
                    assert_eq!(live.decomposition.svd.rank(), once.decomposition.svd.rank());
                    assert_eq!(live.without_embedding, once.without_embedding);
                }
                let without: Vec<bool> = once.without_embedding;
                assert_eq!(without.iter().filter(|without| **without).count(), 1);
                assert!(without.last().unwrap());
            }
        }
    }

    #[test]
    fn robots_that_one_modality_of_several_relates_are_provisional() {
        let matrix = |edges: &[(usize, usize)]| {
            let both = edges.iter().flat_map(|(i, j)| [(*i, *j, 1.0), (*j, *i, 1.0)]);
            Graph::Matrix(Arc::new(SparseMatrix::from_triplets(5, both).unwrap()))
        };
        let links = matrix(&[(0, 1), (1, 2), (2, 3)]);
        let places = matrix(&[(0, 1), (1, 2)]);
        let found = |graphs: Vec<(Modality, Graph)>| {
            let names = (0..5).map(|i| RobotId::new(format!("r{i}")).unwrap());
            let frame = Frame { robots: names.collect(), graphs };
            let params = EmbeddingParams::once(&EmbedderSettings::default(), 2).check().unwrap();
            embed(&frame, &params, &mut |_| {}).unwrap().provisional
        };
        let both = vec![(Modality::connectivity(), links.clone()), (Modality::spatial(), places)];
        assert_eq!(found(both), [false, false, false, true, false]);
        // Where there is one modality only, nothing else could confirm anything.
        let nothing = (Modality::spatial(), matrix(&[]));
        assert_eq!(found(vec![(Modality::connectivity(), links), nothing]), [false; 5]);
    }

    #[test]
    fn graphs_without_an_edge_have_one_triplet_of_zeros() {
        let frame = frame(&[1, 1]);
        let mut frames = Frames::default();
        let found = frames.embed(&frame, &params(2, Pace::Moving), None, &mut |_| {}).unwrap();
        assert_eq!(found.decomposition.svd.sigma, [0.0]);
        assert_eq!((found.x.cols(), found.without_embedding), (2, vec![true; 3]));
        assert_eq!(frames.centralities().unwrap(), [1.0; 3]);
        let fixed = EmbedderSettings { dimension: Dimension::Fixed(4), ..Default::default() };
        let params = EmbeddingParams::once(&fixed, 2).check().unwrap();
        assert_eq!(embed(&frame, &params, &mut |_| {}).unwrap().x.cols(), 4);
    }
}
