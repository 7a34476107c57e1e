//! How many of the leading triplets are kept: K.
//!
//! There is one rule for K, [`choose_covering_dimension`]: the last large drop of the singular values, raised
//! until every robot with relations has a non-zero embedding. From frame to frame it may keep the K before; for
//! a single problem there is no K before. The rule expects a number of teams. Where that is not fixed, it is
//! chosen by the same triplets, see [`crate::candidates`].

use muster_model::settings::{Dimension, TeamCount};
use muster_numeric::dimension::{Choice, Spectrum, choose_covering_dimension, least_rank};
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::svd::FullSvd;

use crate::params::{EmbeddingParams, Pace};

/// Where the triplets are cut off.
#[derive(Debug, Clone)]
pub(crate) struct Cut {
    count: TeamCount,
    /// K of the frame before.
    previous: Option<usize>,
    /// Whether that K is kept where another one is hardly better. A fleet at rest has the same K however it came there.
    keeps: bool,
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

impl Cut {
    /// That of the parameters for A*. `previous` is the K of the frame before.
    pub(crate) fn new(
        params: &EmbeddingParams,
        fused: &SparseMatrix,
        previous: Option<usize>,
    ) -> Self {
        let rank = match params.dimension {
            Dimension::Fixed(dimension) => Rank::Fixed(dimension as usize / 2),
            Dimension::Auto => Rank::Rule { related: fused.related(), most: params.max_rank },
        };
        Self { count: params.teams, previous, keeps: params.pace == Pace::Moving, rank }
    }

    /// K where all triplets are known.
    pub(crate) fn of_all(&self, svd: &FullSvd, teams: u32) -> usize {
        self.choose(svd, teams).dimension
    }

    /// The number of triplets, of `nodes`, that must be known for a choice.
    pub(crate) fn least_rank(&self, nodes: usize) -> usize {
        // The score of the largest number needs the value behind it.
        let most = *self.count.range().end() as usize;
        let evidence = if self.count.fixed().is_some() { 0 } else { most.saturating_add(1) };
        let rank = match &self.rank {
            Rank::Fixed(rank) => rank + 1,
            Rank::Rule { most: largest, .. } => {
                let previous = self.previous.unwrap_or(0).min(*largest) + 1;
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
            Rank::Rule { .. } => self.previous.unwrap_or(2).max(2),
        };
        rank.clamp(1, nodes)
    }

    /// K where `rank` leading triplets are known, and whether more of them could lead to another; none if these
    /// are too few.
    pub(crate) fn of_leading(
        &self,
        svd: &impl Spectrum,
        rank: usize,
        teams: u32,
    ) -> Option<Choice> {
        let nodes = svd.nodes();
        if rank < self.least_rank(nodes) {
            return None;
        }
        let choice = self.choose(svd, teams);
        let most = match &self.rank {
            Rank::Fixed(_) => nodes,
            Rank::Rule { most, .. } => *most,
        };
        let short = choice.short && rank < nodes.min(most + 1);
        Some(Choice { short, ..choice })
    }

    fn choose(&self, svd: &impl Spectrum, teams: u32) -> Choice {
        let nodes = svd.nodes();
        match &self.rank {
            Rank::Fixed(rank) => Choice { dimension: (*rank).clamp(1, nodes), short: false },
            Rank::Rule { related, most } => {
                let kept = self.previous.filter(|_| self.keeps);
                let choice = choose_covering_dimension(svd, related, teams as usize, kept);
                Choice { dimension: choice.dimension.min(*most).clamp(1, nodes), ..choice }
            }
        }
    }
}
