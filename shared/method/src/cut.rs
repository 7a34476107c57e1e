//! How many teams the leading triplets show, and how many of the triplets are kept: K.
//!
//! There is one rule for K, [`choose_covering_dimension`]: the last large drop of the singular values, raised
//! until every robot with relations has a non-zero embedding. From frame to frame it may keep the K before; for
//! a single problem there is no K before. The rule expects a number of teams. Where that is not fixed, it is
//! chosen by the same singular values, see [`crate::team_count`].

use muster_model::settings::{Dimension, TeamCount};
use muster_numeric::dimension::{Choice, Spectrum, choose_covering_dimension, least_rank};
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::svd::FullSvd;

use crate::params::EmbeddingParams;
use crate::team_count::{choose, scores};

/// How many teams the rule for K expects, and why.
#[derive(Debug, Clone, PartialEq)]
pub struct TeamEvidence {
    /// How many teams.
    pub teams: u32,
    /// The score of each number of teams from 1; empty for a fixed number.
    pub scores: Vec<f64>,
}

/// What was chosen in the frame before.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Previous {
    /// K.
    pub(crate) rank: Option<usize>,
    /// How many teams.
    pub(crate) teams: Option<u32>,
}

/// Where the triplets are cut off.
#[derive(Debug, Clone)]
pub(crate) struct Cut {
    count: TeamCount,
    alpha: f64,
    previous: Previous,
    /// Robots with an edge from or to another one: there are no more teams than these.
    linked: usize,
    rank: Rank,
}

/// The number of triplets.
#[derive(Debug, Clone)]
enum Rank {
    /// So many.
    Fixed(usize),
    /// By the rule.
    Rule {
        /// Whether each robot has an edge, from it or to it.
        related: Vec<bool>,
        /// Largest K.
        most: usize,
    },
}

/// A choice for the triplets of a frame.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Chosen {
    /// K, and whether more triplets than are known could lead to another.
    pub(crate) rank: Choice,
    pub(crate) teams: TeamEvidence,
}

impl Cut {
    /// That of the parameters for A* with its decay.
    pub(crate) fn new(
        params: &EmbeddingParams,
        fused: &SparseMatrix,
        alpha: f64,
        previous: Previous,
    ) -> Self {
        let mut related = vec![false; fused.nodes()];
        let mut linked = vec![false; fused.nodes()];
        for (from, to, _) in fused.triplets() {
            (related[from], related[to]) = (true, true);
            if from != to {
                (linked[from], linked[to]) = (true, true);
            }
        }
        let rank = match params.dimension {
            Dimension::Fixed(dimension) => Rank::Fixed(dimension as usize / 2),
            Dimension::Auto => Rank::Rule { related, most: params.max_rank },
        };
        let linked = linked.into_iter().filter(|linked| *linked).count();
        Self { count: params.teams, alpha, previous, linked, rank }
    }

    /// The choice where all triplets are known.
    pub(crate) fn of_all(&self, svd: &FullSvd) -> Chosen {
        self.choose(svd)
    }

    /// The number of triplets, of `nodes`, that must be known for a choice.
    pub(crate) fn least_rank(&self, nodes: usize) -> usize {
        // The score of the largest number needs the value behind it.
        let most = *self.count.range().end() as usize;
        let evidence = if self.count.fixed().is_some() { 0 } else { most.saturating_add(1) };
        let rank = match &self.rank {
            Rank::Fixed(rank) => rank + 1,
            Rank::Rule { most: largest, .. } => {
                let previous = self.previous.rank.unwrap_or(0).min(*largest) + 1;
                least_rank(nodes, most).max(previous)
            }
        };
        rank.max(evidence).clamp(1, nodes)
    }

    /// How many of them will have to be exact: those that can be kept, or where the number of teams is not
    /// fixed, those that the last choice kept. The one behind them is often close to its neighbours, and would
    /// take most of the rounds.
    pub(crate) fn exact_rank(&self, nodes: usize) -> usize {
        if self.count.fixed().is_some() {
            return self.least_rank(nodes).saturating_sub(1).max(1);
        }
        let rank = match self.rank {
            Rank::Fixed(rank) => rank,
            Rank::Rule { .. } => self.previous.rank.unwrap_or(2).max(2),
        };
        rank.clamp(1, nodes)
    }

    /// The choice where `rank` leading triplets are known; none if these are too few.
    pub(crate) fn of_leading(&self, svd: &impl Spectrum, rank: usize) -> Option<Chosen> {
        let nodes = svd.nodes();
        if rank < self.least_rank(nodes) {
            return None;
        }
        let Chosen { rank: choice, teams } = self.choose(svd);
        let most = match &self.rank {
            Rank::Fixed(_) => nodes,
            Rank::Rule { most, .. } => *most,
        };
        let short = choice.short && rank < nodes.min(most + 1);
        Some(Chosen { rank: Choice { short, ..choice }, teams })
    }

    /// How many teams the triplets show.
    fn teams(&self, svd: &impl Spectrum) -> TeamEvidence {
        if let Some(teams) = self.count.fixed() {
            return TeamEvidence { teams, scores: Vec::new() };
        }
        let range = self.count.range();
        let mut scores = scores(svd.singular_values(), self.alpha);
        scores.truncate(self.linked.min(*range.end() as usize));
        TeamEvidence { teams: choose(&scores, range, self.previous.teams), scores }
    }

    fn choose(&self, svd: &impl Spectrum) -> Chosen {
        let nodes = svd.nodes();
        let teams = self.teams(svd);
        let rank = match &self.rank {
            Rank::Fixed(rank) => Choice { dimension: (*rank).clamp(1, nodes), short: false },
            Rank::Rule { related, most } => {
                let expected = teams.teams as usize;
                let choice = choose_covering_dimension(svd, related, expected, self.previous.rank);
                Choice { dimension: choice.dimension.min(*most).clamp(1, nodes), ..choice }
            }
        };
        Chosen { rank, teams }
    }
}
