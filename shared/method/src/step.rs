//! What the method is doing, for callers that report progress.

use std::fmt;

/// Receives each step when it begins. A search reports its rounds from a thread of its own.
pub type Progress<'a> = dyn FnMut(Step) + Send + 'a;

/// A step of the method.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// The graphs of all modalities are added up.
    Fuse,
    /// The spectral radius is bounded.
    SpectralRadius,
    /// The Katz similarity is solved for.
    Katz,
    /// The singular value decomposition of it.
    Svd,
    /// The leading singular triplets are searched for, without the similarity.
    Search {
        /// Rounds that are done.
        round: usize,
        /// Triplets that are not found yet.
        open: usize,
        /// Triplets that are searched for.
        rank: usize,
    },
    /// k-means; several restarts run at a time where there are several threads.
    KMeans {
        /// Restarts that are done.
        done: usize,
        /// Restarts in all.
        restarts: usize,
    },
    /// The silhouettes of the division.
    Silhouettes,
}

impl Step {
    /// The search for leading triplets before its first round.
    pub const SEARCH: Self = Self::Search { round: 0, open: 0, rank: 0 };
}

impl fmt::Display for Step {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match self {
            Self::Fuse => "fuse the graphs",
            Self::SpectralRadius => "spectral radius",
            Self::Katz => "Katz similarity",
            Self::Svd => "singular value decomposition",
            Self::Search { round: 0, .. } => "leading singular triplets",
            Self::Search { round, open, rank } => {
                return write!(
                    formatter,
                    "leading singular triplets, round {round}, {} of {rank} found",
                    rank - open
                );
            }
            Self::KMeans { done: 0, .. } => "k-means",
            Self::KMeans { done, restarts } => {
                return write!(formatter, "k-means, {done} of {restarts} restarts");
            }
            Self::Silhouettes => "silhouettes",
        };
        formatter.pad(name)
    }
}
