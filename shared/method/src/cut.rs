//! How many of the leading triplets are kept: K.
//!
//! There is one rule, [`choose_covering_dimension`]: the last large drop of the singular values, raised until
//! every robot with relations has a non-zero embedding. From frame to frame it may keep the K before; for a
//! single problem there is no K before.

use muster_model::settings::Dimension;
use muster_numeric::dimension::{Choice, Spectrum, choose_covering_dimension, least_rank};
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::svd::FullSvd;

use crate::params::EmbeddingParams;

/// Where the triplets are cut off.
#[derive(Debug, Clone)]
pub(crate) enum Cut {
    /// After so many.
    Fixed(usize),
    /// By the rule.
    Rule {
        teams: usize,
        /// Whether each robot has an edge, from it or to it.
        related: Vec<bool>,
        /// K of the frame before.
        previous: Option<usize>,
        /// Largest K.
        most: usize,
    },
}

impl Cut {
    /// That of the parameters for A*.
    pub(crate) fn new(
        params: &EmbeddingParams,
        fused: &SparseMatrix,
        previous: Option<usize>,
    ) -> Self {
        if let Dimension::Fixed(dimension) = params.dimension {
            return Self::Fixed(dimension as usize / 2);
        }
        let mut related = vec![false; fused.nodes()];
        for (from, to, _) in fused.triplets() {
            (related[from], related[to]) = (true, true);
        }
        Self::Rule { teams: params.teams, related, previous, most: params.max_rank }
    }

    /// K where all triplets are known.
    pub(crate) fn of_all(&self, svd: &FullSvd) -> usize {
        self.choose(svd).dimension
    }

    /// The number of triplets, of `nodes`, that must be known for a choice.
    pub(crate) fn least_rank(&self, nodes: usize) -> usize {
        let rank = match self {
            Self::Fixed(dimension) => dimension + 1,
            Self::Rule { teams, previous, most, .. } => {
                least_rank(nodes, *teams).max(previous.unwrap_or(0).min(*most) + 1)
            }
        };
        rank.clamp(1, nodes)
    }

    /// K where `rank` leading triplets are known; none if these are too few.
    pub(crate) fn of_leading(&self, svd: &impl Spectrum, rank: usize) -> Option<Choice> {
        let nodes = svd.nodes();
        if rank < self.least_rank(nodes) {
            return None;
        }
        let choice = self.choose(svd);
        let most = match self {
            Self::Fixed(_) => nodes,
            Self::Rule { most, .. } => *most,
        };
        Some(Choice { short: choice.short && rank < nodes.min(most + 1), ..choice })
    }

    fn choose(&self, svd: &impl Spectrum) -> Choice {
        let nodes = svd.nodes();
        match self {
            Self::Fixed(dimension) => {
                Choice { dimension: (*dimension).clamp(1, nodes), short: false }
            }
            Self::Rule { teams, related, previous, most } => {
                let choice = choose_covering_dimension(svd, related, *teams, *previous);
                Choice { dimension: choice.dimension.min(*most).clamp(1, nodes), ..choice }
            }
        }
    }
}
