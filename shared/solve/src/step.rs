//! What the method is doing, for whoever waits for it.

use std::fmt;

/// A step of the method, told when it begins.
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
    Search,
    /// k-means, of which so many restarts are done; several at a time where it is shared out.
    KMeans {
        /// How many are done.
        done: usize,
        /// How many there are in all.
        restarts: usize,
    },
    /// The silhouettes of the division.
    Silhouettes,
}

impl fmt::Display for Step {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match self {
            Self::Fuse => "fuse the graphs",
            Self::SpectralRadius => "spectral radius",
            Self::Katz => "Katz similarity",
            Self::Svd => "singular value decomposition",
            Self::Search => "leading singular triplets",
            Self::KMeans { done: 0, .. } => "k-means",
            Self::KMeans { done, restarts } => {
                return write!(formatter, "k-means, {done} of {restarts} restarts");
            }
            Self::Silhouettes => "silhouettes",
        };
        formatter.pad(name)
    }
}
