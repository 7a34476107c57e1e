//! Parameters of k-means: unchecked, checked, and what may be wrong with them.

pub use muster_model::settings::CentroidStart as Init;
use thiserror::Error;

/// Unchecked parameters of k-means; [`KMeansOptions::check`] makes them valid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KMeansOptions<'a> {
    /// Number of clusters k, at least 1.
    pub clusters: usize,
    /// Choice of the first centroids.
    pub init: Init,
    /// Number of independent starts, at least 1.
    pub restarts: usize,
    /// Bound on the Lloyd iterations of one start, and on its exchange passes; at least 1.
    pub max_iterations: usize,
    /// Seed of all random choices.
    pub seed: u64,
    /// Cluster of every point in the previous division, if there was one: any numbers, `None`
    /// for a new point.
    pub warm_labels: Option<&'a [Option<usize>]>,
    /// Relative advantage h, 0 ≤ h < 1, that a change must have over the previous division: for
    /// one point to move, and for a restart to replace the whole division.
    pub hysteresis: f64,
    /// Number of threads, at least 1. They share the restarts and, of many points, each restart.
    /// The result does not depend on it. More than one are started for the call and end with it,
    /// which takes about 0.1 ms; at most 1024 are started.
    pub threads: usize,
}

/// The parameter of [`KMeansOptions`] that is out of its range.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum KMeansOptionsError {
    /// No cluster is asked for.
    #[error("the number of clusters must be at least 1")]
    Clusters,
    /// No start is asked for.
    #[error("the number of restarts must be at least 1")]
    Restarts,
    /// No iteration is allowed.
    #[error("the largest number of iterations must be at least 1")]
    MaxIterations,
    /// The hysteresis is not a number from 0 to below 1.
    #[error("hysteresis {0} is not a number from 0 to below 1")]
    Hysteresis(f64),
    /// No thread is asked for.
    #[error("the number of threads must be at least 1")]
    Threads,
}

impl<'a> KMeansOptions<'a> {
    /// Defaults for `clusters` clusters: 50 greedy k-means++ starts of at most 300 iterations, no
    /// previous division, all on the calling thread.
    #[must_use]
    pub fn new(clusters: usize) -> Self {
        Self {
            clusters,
            init: Init::PlusPlus,
            restarts: 50,
            max_iterations: 300,
            seed: 0,
            warm_labels: None,
            hysteresis: 0.0,
            threads: 1,
        }
    }

    /// The parameters with the guarantee that each is in its range.
    ///
    /// # Errors
    /// The first parameter that is not, as [`KMeansOptionsError`].
    pub fn check(self) -> Result<ValidKMeansOptions<'a>, KMeansOptionsError> {
        match self {
            Self { clusters: 0, .. } => Err(KMeansOptionsError::Clusters),
            Self { restarts: 0, .. } => Err(KMeansOptionsError::Restarts),
            Self { max_iterations: 0, .. } => Err(KMeansOptionsError::MaxIterations),
            Self { threads: 0, .. } => Err(KMeansOptionsError::Threads),
            Self { hysteresis, .. } if !(0.0..1.0).contains(&hysteresis) => {
                Err(KMeansOptionsError::Hysteresis(hysteresis))
            }
            valid => Ok(ValidKMeansOptions(valid)),
        }
    }
}

/// Parameters of k-means that [`KMeansOptions::check`] found in their ranges.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ValidKMeansOptions<'a>(KMeansOptions<'a>);

impl<'a> ValidKMeansOptions<'a> {
    /// The values.
    #[must_use]
    pub fn get(&self) -> &KMeansOptions<'a> {
        &self.0
    }
}
