//! Why a frame has no embedding.

use muster_model::id::Modality;
use muster_numeric::fuse::FuseError;
use muster_numeric::katz::KatzError;
use muster_numeric::katz_svd::KatzSvdError;
use muster_numeric::kmeans::KMeansError;
use muster_numeric::matrix::MatrixError;
use muster_numeric::svd::SvdError;

use crate::params::ParamsError;

/// Why a frame has no embedding.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MethodError {
    /// The parameters are not valid.
    #[error(transparent)]
    Params(#[from] ParamsError),
    /// No graph of the frame has a weight.
    #[error(
        "weights: none of the modalities that have a weight is among the fleet's: {modalities}"
    )]
    Weightless {
        /// The modalities of the frame.
        modalities: String,
    },
    /// The series of walks does not converge.
    #[error(
        "alpha: {alpha} must be less than 1/ρ = {} of this frame; \
         set it below, or as {{\"fraction\": 0.5}}",
        radius.recip()
    )]
    Diverges {
        /// The decay of the settings.
        alpha: f64,
        /// Upper bound of ρ(A*).
        radius: f64,
    },
    /// A graph is no matrix.
    #[error("a graph cannot be used: {error}")]
    Graph {
        /// The graph.
        modality: Modality,
        /// What is wrong with it.
        error: MatrixError,
    },
    /// The graphs cannot be fused.
    #[error("the graphs cannot be fused: {0}")]
    Fuse(#[from] FuseError),
    /// The similarity cannot be computed.
    #[error("the similarity cannot be computed: {0}")]
    Katz(KatzError),
    /// The similarity cannot be decomposed.
    #[error("the similarity cannot be decomposed: {0}")]
    Svd(#[from] SvdError),
    /// The leading triplets of the similarity cannot be searched for.
    #[error("the similarity cannot be decomposed: {0}")]
    Search(KatzSvdError),
    /// The divisions by which the number of teams is chosen cannot be made.
    #[error("the number of teams cannot be chosen: {0}")]
    TeamCount(#[from] KMeansError),
}

impl MethodError {
    /// One word per kind of failure, whatever numbers its text holds.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Params(_) => "params",
            Self::Weightless { .. } => "weights",
            Self::Diverges { .. } => "alpha",
            Self::Graph { .. } => "graph",
            Self::Fuse(_) => "fuse",
            Self::Katz(_) => "katz",
            Self::Svd(_) | Self::Search(_) => "svd",
            Self::TeamCount(_) => "teams",
        }
    }
}

impl From<KatzError> for MethodError {
    fn from(error: KatzError) -> Self {
        match error {
            KatzError::Diverges { alpha, radius } => Self::Diverges { alpha, radius },
            other => Self::Katz(other),
        }
    }
}

impl From<KatzSvdError> for MethodError {
    fn from(error: KatzSvdError) -> Self {
        match error {
            KatzSvdError::Katz(error) => error.into(),
            KatzSvdError::Rank(error) => Self::Svd(error),
            other => Self::Search(other),
        }
    }
}
