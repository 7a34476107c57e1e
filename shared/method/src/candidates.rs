//! The divisions by which the number of teams is chosen: one for each number that is possible.
//!
//! A division is made as `clusterer` would make it, with fewer starts, and begins with that of the frame
//! before. In large fleets a frame renews only some of them; the others keep their modularity.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::sync::Arc;

use muster_model::settings::{ClustererSettings, Dimension};
use muster_numeric::dimension::{Coverage, Spectrum};
use muster_numeric::embedding::embed_powers;
use muster_numeric::katz_svd::KatzSvd;
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::modularity::Modularity;
use muster_numeric::svd::{FullSvd, RankKSvd, SvdError};

use crate::correspondence::Correspondence;
use crate::division::divide;
use crate::error::MethodError;
use crate::params::{DivisionParams, EmbeddingParams, Pace};
use crate::team_count::{RESOLUTION, TeamEvidence, choose, gaps, scores};

/// Starts of k-means for a division that no frame before has, and for one of a fleet at rest: the fewer robots, the more.
const FIRST_STARTS: RangeInclusive<usize> = 4..=50;

/// Robots times teams times columns, for all starts of such a division: a fifth of [`WORK_AT_ONCE`]. Two processes that begin on
/// the same graphs then find the same divisions of a few robots, and so the same number of teams, whatever their seeds.
const FIRST_WORK: usize = 20_000;

/// Starts besides the division of the frame before: with another seed in each frame, so that a better division
/// is found within a few.
const LATER_STARTS: usize = 1;

/// Robots times teams times columns after which a frame renews no further division, except for those near the
/// number before: a few milliseconds. A fleet of fifty robots renews all, one of thousands one in turn.
const WORK_AT_ONCE: usize = 100_000;

/// Leading singular triplets that are known.
pub(crate) trait Triplets: Spectrum {
    /// The first `rank` of them.
    fn leading(&self, rank: usize) -> Result<RankKSvd, SvdError>;
}

impl Triplets for FullSvd {
    fn leading(&self, rank: usize) -> Result<RankKSvd, SvdError> {
        self.truncate(rank)
    }
}

impl Triplets for KatzSvd {
    fn leading(&self, rank: usize) -> Result<RankKSvd, SvdError> {
        self.truncate(rank)
    }
}

/// The graph of a relation, with the trust in its edges, and the weight of the relation.
pub(crate) type Relation = (Arc<SparseMatrix>, f64);

/// A frame whose teams are counted.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Counted<'a> {
    pub(crate) relations: &'a [Relation],
    pub(crate) params: &'a EmbeddingParams,
    pub(crate) alpha: f64,
    /// How many teams the frame before showed.
    pub(crate) previous: Option<u32>,
    /// Per robot, whether it has an edge from or to another one: there are no more teams than these.
    pub(crate) linked: &'a [bool],
}

/// The divisions of the last frame.
#[derive(Debug, Default)]
pub(crate) struct Candidates {
    known: BTreeMap<u32, Candidate>,
    /// The number that is renewed next where not all are.
    next: u32,
}

/// A division into one number of teams.
#[derive(Debug)]
struct Candidate {
    labels: Vec<Option<usize>>,
    modularity: f64,
}

impl Candidates {
    /// Takes the divisions along to other robots.
    pub(crate) fn carry(&mut self, robots: &Correspondence) {
        for candidate in self.known.values_mut() {
            let old = |place: &Option<usize>| {
                place.and_then(|old| candidate.labels.get(old).copied().flatten())
            };
            candidate.labels = robots.to_old().iter().map(old).collect();
        }
    }

    /// How many teams the triplets of a frame show.
    ///
    /// # Errors
    /// [`MethodError`], never for triplets of the frame.
    pub(crate) fn count(
        &mut self,
        svd: &impl Triplets,
        frame: Counted<'_>,
    ) -> Result<TeamEvidence, MethodError> {
        if let Some(teams) = frame.params.teams.fixed() {
            return Ok(TeamEvidence { teams, scores: Vec::new() });
        }
        let range = frame.params.teams.range();
        let linked = frame.linked.iter().filter(|linked| **linked).count();
        let most = (*range.end()).min(u32::try_from(linked).unwrap_or(u32::MAX));
        self.known.retain(|teams, _| *teams <= most);
        let coverage = Coverage::new(svd, frame.linked, most as usize);
        let graphs: Vec<(Modularity<'_>, f64)> = frame
            .relations
            .iter()
            .filter_map(|(graph, weight)| Some((Modularity::new(graph)?, *weight)))
            .collect();
        for teams in self.renewed(svd.nodes(), most, frame) {
            let labels = self.divide(svd, &coverage, teams, frame)?;
            let modularity = mean_modularity(&graphs, &labels);
            self.known.insert(teams, Candidate { labels, modularity });
        }
        let modularity: Vec<f64> = self.known.values().map(|known| known.modularity).collect();
        let gaps = gaps(svd.singular_values(), frame.alpha);
        let mut scores = scores(linked, &modularity, &gaps);
        scores.truncate(most as usize);
        // What a fleet at rest shows does not depend on how it came there: it shows the same after a restart.
        let kept = frame.previous.filter(|_| frame.params.pace == Pace::Moving);
        Ok(TeamEvidence { teams: choose(&scores, range, kept), scores })
    }

    /// The numbers whose divisions are made in this frame: all, or those near the number before and some others
    /// in turn.
    fn renewed(&mut self, robots: usize, most: u32, frame: Counted<'_>) -> Vec<u32> {
        let near = frame.previous.unwrap_or(1);
        let near = near.saturating_sub(1)..=near.saturating_add(1);
        let mut numbers: Vec<u32> = (2..=most)
            .filter(|teams| near.contains(teams) || !self.known.contains_key(teams))
            .collect();
        let mut done: usize = numbers.iter().map(|teams| work(robots, *teams)).sum();
        for turn in 1..most {
            let is_enough = turn > 1 && done >= WORK_AT_ONCE;
            if is_enough && frame.params.pace == Pace::Moving {
                break;
            }
            self.next = if (2..most).contains(&self.next) { self.next + 1 } else { 2 };
            if !numbers.contains(&self.next) {
                done = done.saturating_add(work(robots, self.next));
                numbers.push(self.next);
            }
        }
        numbers
    }

    /// The labels of a division of a frame into so many teams.
    fn divide<S: Triplets>(
        &self,
        svd: &S,
        coverage: &Coverage<'_, S>,
        teams: u32,
        frame: Counted<'_>,
    ) -> Result<Vec<Option<usize>>, MethodError> {
        let params = frame.params;
        let most = svd.singular_values().len().min(svd.nodes());
        let rank = match params.dimension {
            Dimension::Fixed(dimension) => dimension as usize / 2,
            Dimension::Auto => coverage.choose(teams as usize, None).dimension.min(params.max_rank),
        };
        let embedded = embed_powers(&svd.leading(rank.clamp(1, most))?, params.power, params.rows);
        let before = self.known.get(&teams).map(|known| &known.labels[..]);
        let is_moving = params.pace == Pace::Moving;
        let starts = match before {
            Some(_) if is_moving => LATER_STARTS,
            _ => first_starts(svd.nodes(), teams),
        };
        let division = DivisionParams {
            restarts: starts,
            seed: params.seed,
            hysteresis: 0.0,
            ..DivisionParams::new(&ClustererSettings::default(), teams as usize)
        };
        let found = divide(&embedded.x, &embedded.weak, &division.check()?, before, &mut |_| {})?;
        Ok(found.labels)
    }
}

/// The mean modularity of a division by graphs with weights; 0 without any.
fn mean_modularity(graphs: &[(Modularity<'_>, f64)], labels: &[Option<usize>]) -> f64 {
    let weights: f64 = graphs.iter().map(|(_, weight)| weight).sum();
    let sum: f64 = graphs.iter().map(|(graph, weight)| weight * graph.of(labels, RESOLUTION)).sum();
    if weights > 0.0 { sum / weights } else { 0.0 }
}

/// How many starts the first division of so many robots has.
fn first_starts(robots: usize, teams: u32) -> usize {
    (FIRST_WORK / work(robots, teams).max(1)).clamp(*FIRST_STARTS.start(), *FIRST_STARTS.end())
}

/// What a division of so many robots costs.
fn work(robots: usize, teams: u32) -> usize {
    let teams = teams as usize;
    robots.saturating_mul(2 * teams * teams)
}
