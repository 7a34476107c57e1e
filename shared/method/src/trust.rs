//! How far each modality can be trusted: whether its edges join robots that are near in all others.
//!
//! For robot i, the others of the fleet are ordered by their Katz similarity to i in the graphs of all
//! modalities but one. The *agreement* of an edge (i, j) of that one is the share of robots that come before
//! j in the order from the end: 1 for the nearest, about ½ for a robot drawn at random. Walks of a few steps
//! ([`STEPS`]) suffice for the order. A modality *agrees* with the others as far as the mean over its edges, by
//! weight, or, if that is more, as the mean over the edges of the others by the order of its own similarities:
//! in a column that drives behind its leader, most are far from their superior, but near those with the same.
//! Right ranks have 0.65 to 0.98, ranks that go by kind of robot or all to one about ½.
//!
//! A modality's *trust* is the factor of its weight. It is 1 where the agreement above chance is at least
//! [`FULL_SHARE`] of that of the modality with the most, 0 below [`NO_SHARE`]. The factors of the others
//! enter their similarity, so that two wrong modalities do not confirm each other against a right one. Each
//! rank has a trust of its own in addition where most join robots that are near: a wrong one among right ones
//! joins two teams. Trust takes three modalities, since two that contradict each other do not say which is
//! wrong.
//!
//! A live fleet examines a few robots per frame, in turn, so that the time of a frame does not grow by much.
//! A fleet at rest and a single problem have many examined at once, and what was found before is forgotten.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use muster_model::id::{Modality, RobotId};
use muster_numeric::katz::short_katz_rows;
use muster_numeric::matrix::{MatrixError, SparseMatrix};

use crate::correspondence::Correspondence;
use crate::error::MethodError;
use crate::params::{EmbeddingParams, Pace};

/// Fewest modalities that can contradict each other with a majority.
const LEAST_MODALITIES: usize = 3;

/// Fewest robots: among fewer, the order of the others is mostly chance.
const LEAST_ROBOTS: usize = 8;

/// Decay of the walks: a step counts half of the one before.
const DECAY: f64 = 0.5;

/// Longest walks. They reach the team of a robot; those further away are all far.
const STEPS: usize = 4;

/// Robots that are examined per frame of a fleet that moves: their walks take less time than the embedding.
const ROBOTS_PER_FRAME: usize = 8;

/// Most robots that are examined at once, in a first frame, at rest, or in a single problem.
const ROBOTS_AT_ONCE: usize = 1024;

/// Fewer than [`ROBOTS_AT_ONCE`] where edges × robots would exceed this: tenths of a second.
const EDGES_AT_ONCE: usize = 1 << 24;

/// Fewest robots that are examined at once: enough for a mean.
const LEAST_AT_ONCE: usize = 64;

/// Agreement rests on so many robots at most, those examined last: few enough to follow a change, enough
/// for a mean.
const RECENT_ROBOTS: usize = 256;

/// Agreement above chance, as a share of the largest, from which a modality has its whole weight.
const FULL_SHARE: f64 = 0.35;

/// The same, up to which it has none.
const NO_SHARE: f64 = 0.2;

/// The agreement of edges that join robots at random.
const CHANCE: f64 = 0.5;

/// The agreement of all ranks from which single ones are doubted: below, right ones join distant robots too.
const NEAR_RANKS: f64 = 0.65;

/// The agreement from which a single rank has its whole weight.
const FULL_RANK: f64 = 0.8;

/// The least trust in a single rank: some are orders to go elsewhere.
const LEAST_RANK_TRUST: f64 = 0.2;

/// Trust is kept while the new one differs by less and is neither 0 nor 1: graphs that hardly change are
/// to have a fused graph that hardly changes.
const KEPT_WITHIN: f64 = 0.1;

/// Similarities within this share of each other are equal: their sums were formed in different orders.
const ROUNDING: f64 = 1e-9;

/// Most robots that are named as those whose edges disagree most.
const MOST_NAMED: usize = 8;

/// The trust in a modality.
#[derive(Debug, Clone, PartialEq)]
pub struct Trust {
    /// The factor of its weight, from 0 to 1.
    pub factor: f64,
    /// The mean agreement of its edges with all other modalities, from 0 to 1; none where nothing is known.
    pub agreement: Option<f64>,
    /// The robots whose edges agree least, the worst first; empty where the factor is 1.
    pub disagreeing: Vec<RobotId>,
}

/// A modality of a frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Voice<'a> {
    pub(crate) name: &'a Modality,
    pub(crate) matrix: &'a SparseMatrix,
    pub(crate) weight: f64,
    /// What the matrix is to be divided by, so that its norm is at most 1.
    pub(crate) norm: f64,
    /// Whether its factor is to stay 1.
    pub(crate) is_trusted: bool,
}

/// What is known of the agreement of modalities, from frame to frame.
#[derive(Debug, Default)]
pub(crate) struct TrustTracker {
    robots: Arc<[RobotId]>,
    modalities: BTreeMap<Modality, Examined>,
    /// How many robots were examined since the list changed.
    turn: usize,
}

/// What was found of one modality.
#[derive(Debug)]
struct Examined {
    factor: f64,
    is_trusted: bool,
    /// The robots examined last.
    recent: VecDeque<Agreement>,
    /// The mean agreement of each robot's edges when it was last examined.
    by_robot: Vec<Option<f64>>,
    /// The agreement of each edge when its first end was last examined, for modalities whose edges are
    /// weighed one by one; by target.
    edges: Vec<Option<Vec<(usize, f64)>>>,
}

/// Weighted sums of agreements.
#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    sum: f64,
    weight: f64,
}

/// How far one robot's edges of a modality and those of all others agree.
#[derive(Debug, Clone, Copy)]
struct Agreement {
    /// Of its edges of the modality, by the similarities of the others.
    own: Mean,
    /// Of its edges of the others, by the similarities of the modality.
    others: Mean,
}

impl Mean {
    fn of(edges: &[Edge]) -> Self {
        edges.iter().fold(Self::default(), |mean, edge| Self {
            sum: mean.sum + edge.weight * edge.agreement,
            weight: mean.weight + edge.weight,
        })
    }

    fn value(self) -> Option<f64> {
        (self.weight > 0.0).then(|| self.sum / self.weight)
    }
}

impl std::iter::Sum for Mean {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::default(), |sum, mean| Self {
            sum: sum.sum + mean.sum,
            weight: sum.weight + mean.weight,
        })
    }
}

impl Examined {
    fn new(robots: usize) -> Self {
        Self {
            factor: 1.0,
            is_trusted: false,
            recent: VecDeque::new(),
            by_robot: vec![None; robots],
            edges: vec![None; robots],
        }
    }

    /// The agreement of its edges by the similarities of the others.
    fn own_agreement(&self) -> Option<f64> {
        self.recent.iter().map(|agreement| agreement.own).sum::<Mean>().value()
    }

    fn agreement(&self) -> Option<f64> {
        let others = self.recent.iter().map(|agreement| agreement.others).sum::<Mean>().value();
        match (self.own_agreement(), others) {
            (Some(own), Some(others)) => Some(own.max(others)),
            (own, others) => own.or(others),
        }
    }

    /// The same robots at other places.
    fn carry(&mut self, robots: &Correspondence) {
        let (to_old, to_new) = (robots.to_old(), robots.to_new());
        let place = |old: usize| to_new.get(old).copied().flatten();
        let moved = |edges: &Vec<(usize, f64)>| {
            edges.iter().filter_map(|(target, found)| Some((place(*target)?, *found))).collect()
        };
        self.by_robot = to_old.iter().map(|old| *self.by_robot.get((*old)?)?).collect();
        self.edges =
            to_old.iter().map(|old| self.edges.get((*old)?)?.as_ref().map(moved)).collect();
    }
}

/// Whether the edges of a modality are weighed one by one.
fn weighs_edges(name: &Modality) -> bool {
    *name == Modality::hierarchy()
}

impl TrustTracker {
    /// Examines robots of a frame.
    ///
    /// # Errors
    /// [`MethodError::Graph`] where weights leave the range of numbers.
    pub(crate) fn update(
        &mut self,
        robots: &Arc<[RobotId]>,
        voices: &[Voice<'_>],
        params: &EmbeddingParams,
    ) -> Result<(), MethodError> {
        if let Some(between) = Correspondence::between(&self.robots, robots) {
            self.modalities.values_mut().for_each(|examined| examined.carry(&between));
            self.robots = Arc::clone(robots);
            self.turn = 0;
        }
        let speaking: Vec<Voice<'_>> = voices
            .iter()
            .filter(|voice| voice.weight > 0.0 && !voice.matrix.is_zero())
            .copied()
            .collect();
        if speaking.len() < LEAST_MODALITIES
            || robots.len() < LEAST_ROBOTS
            || speaking.iter().all(|voice| voice.is_trusted)
        {
            self.modalities.clear();
            return Ok(());
        }
        let is_first = params.pace == Pace::AtRest || self.modalities.is_empty();
        if is_first {
            self.modalities.clear();
            self.turn = 0;
        }
        self.modalities.retain(|name, _| speaking.iter().any(|voice| voice.name == name));
        for voice in &speaking {
            let known = self.modalities.entry(voice.name.clone());
            let examined = known.or_insert_with(|| Examined::new(robots.len()));
            examined.is_trusted = voice.is_trusted;
        }
        let edges: usize = speaking.iter().map(|voice| voice.matrix.edges()).sum();
        let at_once = (EDGES_AT_ONCE / edges.max(1)).clamp(LEAST_AT_ONCE, ROBOTS_AT_ONCE);
        let (count, rounds) = if is_first { (at_once, 2) } else { (ROBOTS_PER_FRAME, 1) };
        let sources = self.next_robots(robots.len(), count);
        for _ in 0..rounds {
            for voice in &speaking {
                self.examine(voice, &speaking, &sources)
                    .map_err(|error| MethodError::Graph { modality: voice.name.clone(), error })?;
            }
            self.decide(is_first);
        }
        Ok(())
    }

    /// The robots whose turn it is, spread over the list.
    fn next_robots(&mut self, robots: usize, count: usize) -> Vec<usize> {
        let stride = spreading_stride(robots);
        let count = count.min(robots);
        let first = self.turn;
        self.turn = (first + count) % robots;
        (first..first + count).map(|turn| (turn % robots) * stride % robots).collect()
    }

    /// Compares the edges of one modality that begin at some robots with all other modalities.
    fn examine(
        &mut self,
        voice: &Voice<'_>,
        all: &[Voice<'_>],
        sources: &[usize],
    ) -> Result<(), MatrixError> {
        let factor = |name: &Modality| self.modalities.get(name).map_or(1.0, |known| known.factor);
        let others = all.iter().filter(|other| other.name != voice.name);
        let others =
            others.map(|other| (other.matrix, other.weight * factor(other.name) / other.norm));
        let others: Vec<(&SparseMatrix, f64)> =
            others.filter(|(_, weight)| *weight > 0.0).collect();
        let sum: f64 = all
            .iter()
            .filter(|other| other.name != voice.name)
            .map(|other| other.weight * factor(other.name))
            .sum();
        if others.is_empty() {
            return Ok(());
        }
        let nodes = voice.matrix.nodes();
        let own = [(voice.matrix, 1.0)];
        let by_others = short_katz_rows(nodes, &others, DECAY / sum, sources, STEPS)?;
        let by_own = short_katz_rows(nodes, &own, DECAY / voice.norm, sources, STEPS)?;
        let Some(examined) = self.modalities.get_mut(voice.name) else { return Ok(()) };
        let has_edges = weighs_edges(voice.name);
        for (row, &source) in sources.iter().enumerate() {
            let found = edges_agreement(&own, source, by_others.row(row));
            let own_mean = Mean::of(&found);
            let others = Mean::of(&edges_agreement(&others, source, by_own.row(row)));
            examined.by_robot[source] = own_mean.value();
            examined.recent.push_back(Agreement { own: own_mean, others });
            if has_edges {
                let edges = found.iter().map(|edge| (edge.target, edge.agreement));
                examined.edges[source] = Some(edges.collect());
            }
        }
        let recent = RECENT_ROBOTS.min(nodes).max(sources.len());
        let excess = examined.recent.len().saturating_sub(recent);
        examined.recent.drain(..excess);
        Ok(())
    }

    /// Chooses the factors by what was found.
    fn decide(&mut self, is_first: bool) {
        let agreements = self.modalities.values().filter_map(Examined::agreement);
        let most = agreements.fold(CHANCE, f64::max);
        for examined in self.modalities.values_mut() {
            let above = |agreement: f64| (agreement - CHANCE) / (most - CHANCE);
            let wanted = match examined.agreement() {
                Some(agreement) if !examined.is_trusted && most > CHANCE => {
                    ((above(agreement) - NO_SHARE) / (FULL_SHARE - NO_SHARE)).clamp(0.0, 1.0)
                }
                _ => 1.0,
            };
            let is_end = wanted == 0.0 || wanted == 1.0;
            if is_first || is_end || (wanted - examined.factor).abs() >= KEPT_WITHIN {
                examined.factor = wanted;
            }
        }
    }

    /// The trust in a modality.
    pub(crate) fn of(&self, name: &Modality, robots: &[RobotId]) -> Trust {
        let Some(examined) = self.modalities.get(name) else {
            return Trust { factor: 1.0, agreement: None, disagreeing: Vec::new() };
        };
        let mut disagreeing = Vec::new();
        if examined.factor < 1.0 {
            let known = examined.by_robot.iter().zip(robots);
            let mut known: Vec<_> =
                known.filter_map(|(found, robot)| Some(((*found)?, robot))).collect();
            known.sort_by(|left, right| left.0.total_cmp(&right.0).then(left.1.cmp(right.1)));
            disagreeing.extend(known.into_iter().take(MOST_NAMED).map(|(_, robot)| robot.clone()));
        }
        Trust { factor: examined.factor, agreement: examined.agreement(), disagreeing }
    }

    /// The graph of a modality with each weight multiplied by the trust in the edge.
    ///
    /// # Errors
    /// [`MatrixError`], never for a graph that was examined.
    pub(crate) fn weigh_edges(
        &self,
        name: &Modality,
        matrix: &Arc<SparseMatrix>,
    ) -> Result<Arc<SparseMatrix>, MatrixError> {
        let examined = self.modalities.get(name).filter(|_| weighs_edges(name));
        let is_doubted = |examined: &&Examined| {
            !examined.is_trusted && examined.own_agreement().is_some_and(|own| own >= NEAR_RANKS)
        };
        let Some(examined) = examined.filter(is_doubted) else {
            return Ok(Arc::clone(matrix));
        };
        let trust = |from: usize, to: usize| {
            let known = [(from, to), (to, from)].map(|(end, other)| {
                let edges = examined.edges.get(end)?.as_ref()?;
                edges.iter().find(|(target, _)| *target == other).map(|(_, found)| *found)
            });
            let [Some(there), Some(back)] = known else { return 1.0 };
            ((there.max(back) - CHANCE) / (FULL_RANK - CHANCE)).clamp(LEAST_RANK_TRUST, 1.0)
        };
        Ok(Arc::new(matrix.map_weights(|from, to, weight| weight * trust(from, to))?))
    }
}

/// An edge and its agreement.
struct Edge {
    target: usize,
    weight: f64,
    agreement: f64,
}

/// The agreement of the edges that leave a robot, by its similarities with all robots; empty where these
/// say nothing. Graphs have the weights that stand with them.
fn edges_agreement(
    graphs: &[(&SparseMatrix, f64)],
    source: usize,
    similarities: &[f64],
) -> Vec<Edge> {
    let others = similarities.iter().enumerate().filter(|(other, _)| *other != source);
    let mut sorted: Vec<f64> = others.map(|(_, similarity)| *similarity).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    if sorted.last().is_none_or(|most| *most <= 0.0) || sorted.len() < 2 {
        return Vec::new();
    }
    let edges = graphs.iter().flat_map(|(graph, of_graph)| {
        graph.row(source).map(move |(target, weight)| (target, of_graph * weight))
    });
    edges
        .filter(|(target, _)| *target != source)
        .map(|(target, weight)| {
            let similarity = similarities[target];
            let farther = sorted.partition_point(|other| *other < similarity * (1.0 - ROUNDING));
            let nearer = sorted.partition_point(|other| *other <= similarity * (1.0 + ROUNDING));
            let equal = (nearer - farther).saturating_sub(1);
            #[expect(clippy::cast_precision_loss, reason = "there are fewer robots than 2⁵³")]
            let agreement = (farther as f64 + 0.5 * equal as f64) / (sorted.len() - 1) as f64;
            Edge { target, weight, agreement }
        })
        .collect()
}

/// A step that visits every one of so many places once before it comes back, and spreads them evenly: near
/// the golden section, without a common divisor.
fn spreading_stride(places: usize) -> usize {
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a whole number below that of the robots"
    )]
    let golden = (places as f64 * 0.618_033_988_75) as usize;
    let divisor = |mut a: usize, mut b: usize| {
        while b > 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    (golden.max(1)..).find(|stride| divisor(*stride, places) == 1).unwrap_or(1)
}
