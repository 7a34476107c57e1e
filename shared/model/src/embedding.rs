//! One vector per robot: its rows of the leading singular vectors of the Katz similarity.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::content::{Content, ContentError, refuse};
use crate::header::{Header, Revision};
use crate::id::{Modality, RobotId};
use crate::settings::MAX_DIMENSION;

/// Which way the embedding was computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum EmbeddingMode {
    /// The similarity was solved for by LU and decomposed whole.
    Dense,
    /// The similarity, which was then decomposed whole, or for larger fleets the leading triplets
    /// themselves were brought up to date by the rows of the graph that changed.
    Updated,
    /// The graphs and the decay are still those of the last embedding, whose triplets serve.
    Cached,
    /// The leading triplets were found from products with the graphs, and the similarity never formed.
    InverseFree,
}

/// What the embedding rests on and how exact it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EmbeddingQuality {
    /// Lower and upper bound of the spectral radius of the fused graph.
    pub spectral_radius: (f64, f64),
    /// The decay that was used.
    pub alpha: f64,
    /// The K leading singular values, falling.
    pub singular_values: Vec<f64>,
    /// The singular value after them: to about a percent while the fleet moves, exact at rest.
    pub next_singular_value: f64,
    /// Largest ‖S v − σ u‖ or ‖Sᵀ u − σ v‖ over the K triplets, relative to σ₁. Where the similarity is
    /// never formed, ‖Mᵀ(Sᵀ u − σ v)‖ instead, with M = I − α A*.
    pub residual: f64,
    /// Largest |M S z − α A z| for random signs z, relative to what rounding is relative to; 0 where the similarity is never formed.
    pub katz_residual: f64,
    /// (σ_K − σ_{K+1}) / σ₁: how far the chosen subspace stands apart from the rest.
    pub gap: f64,
    /// Whether the gap is so small that another basis would be as good.
    pub ambiguous: bool,
    /// Which way it was computed.
    pub mode: EmbeddingMode,
    /// How many teams the relations show; none where the number is fixed, or there are no relations.
    pub teams_shown: Option<u32>,
    /// The evidence for 1, 2, … teams: the modularity of the division into so many and a share of the gap in
    /// the spectrum, and for one team what a division must reach. Empty where `teams_shown` is none.
    pub team_scores: Vec<f64>,
    /// Microseconds that fusing with the spectral radius and the centralities, the similarity, and the
    /// decomposition took.
    pub stage_us: [u64; 3],
}

/// A graph that an embedding was made from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EmbeddingGraph {
    /// Which relation it is.
    pub modality: Modality,
    /// Its revision.
    pub revision: Revision,
    /// The weight that was used, with the trust in it.
    pub weight: f64,
    /// By how much the weight of the modality is multiplied, from 0 to 1, because its ties lie far from
    /// each other in the similarity of the other modalities; 1 if it is not doubted.
    pub trust: f64,
}

impl EmbeddingGraph {
    /// Trust below which a modality is in doubt: less than half of its weight is left.
    pub const DOUBTED_BELOW: f64 = 0.5;

    /// Whether the modality is in doubt.
    #[must_use]
    pub fn is_doubted(&self) -> bool {
        self.trust < Self::DOUBTED_BELOW
    }
}

impl Content for EmbeddingGraph {
    /// The weight is finite and not negative, the trust lies between 0 and 1.
    fn check(&self) -> Result<(), ContentError> {
        if !self.weight.is_finite() || self.weight < 0.0 {
            return refuse("weights", "must be finite and at least 0");
        }
        if !(0.0..=1.0).contains(&self.trust) {
            return refuse("trust", "must be a number from 0 to 1");
        }
        Ok(())
    }
}

/// The vectors of all robots.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Embedding {
    /// The head of the message.
    pub header: Header,
    /// The revision of the roster that it was made from.
    pub roster: Revision,
    /// The graphs that it was made from.
    pub graphs: Vec<EmbeddingGraph>,
    /// The robots, ordered by name: row i of `values` is that of robot i.
    pub robots: Vec<RobotId>,
    /// Length D = 2K of each vector.
    pub dimension: u32,
    /// The vectors, row after row.
    pub values: Vec<f64>,
    /// Which robots have no embedding: the K leading singular vectors are zero in their rows.
    pub without_embedding: Vec<bool>,
    /// Which robots one modality alone relates to others, where several relate robots of the fleet: nothing confirms
    /// their place.
    pub provisional: Vec<bool>,
    /// Katz centrality of each robot, at least 1: the weight of all walks that begin at it, each step
    /// damped by the decay, the walk of no step included.
    pub centrality: Vec<f64>,
    /// What it rests on and how exact it is.
    pub quality: EmbeddingQuality,
}

impl Content for Embedding {
    /// All fields have the lengths that `robots` and `dimension` give, all numbers are finite, and the
    /// graphs satisfy their rules.
    fn check(&self) -> Result<(), ContentError> {
        let robots = self.robots.len();
        if self.without_embedding.len() != robots {
            return refuse("unseen", "must have one entry per robot");
        }
        if self.provisional.len() != robots {
            return refuse("provisional", "must have one entry per robot");
        }
        // Readers allocate by it, also where there are no robots.
        if self.dimension > MAX_DIMENSION {
            return refuse("dimension", "must be at most the largest setting");
        }
        if robots.checked_mul(self.dimension as usize) != Some(self.values.len()) {
            return refuse("values", "must have one row of the dimension's length per robot");
        }
        if !self.robots.is_sorted_by(|left, right| left < right) {
            return refuse("robots", "must be ordered by name without repetition");
        }
        if self.centrality.len() != robots || !self.centrality.iter().all(|value| value.is_finite())
        {
            return refuse("centrality", "must have one finite entry per robot");
        }
        if !self.values.iter().all(|value| value.is_finite()) {
            return refuse("values", "must be finite");
        }
        if !self.quality.team_scores.iter().all(|score| score.is_finite()) {
            return refuse("quality.team_scores", "must be finite");
        }
        self.graphs.iter().try_for_each(Content::check)
    }
}
