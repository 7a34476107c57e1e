//! Parameters of the search for leading triplets: unchecked, checked, and what may be wrong.

use thiserror::Error;

/// Largest residual of triplets that need not be exact. The error of a value falls with its square.
pub const ROUGH_TOLERANCE: f64 = 0.02;

/// Unchecked parameters of a search; [`KatzSvdOptions::check`] makes them valid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KatzSvdOptions {
    /// Number of triplets, from 1 to n.
    pub rank: usize,
    /// How many of them, the leading ones, have to reach the tolerance; none for all. The others are searched
    /// for until their residual is [`ROUGH_TOLERANCE`], which gives their values to a fraction of a percent.
    pub exact: Option<usize>,
    /// Largest residual ‖Sᵀu − σv‖/σ₁, above 0. It is bounded by (1 + σ₁) ‖Mᵀ(Sᵀu − σv)‖/σ₁ with M = I − αA,
    /// and S v − σu is zero but for rounding.
    pub tolerance: f64,
    /// Seed of the random directions.
    pub seed: u64,
    /// Number of threads, at least 1, that share the rows of large graphs. The result does not depend
    /// on it, bit for bit. More than one are started by the first frame and kept; at most 1024 are
    /// started.
    pub threads: usize,
}

/// The parameter of [`KatzSvdOptions`] that is out of its range.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum KatzSvdOptionsError {
    /// No triplet is asked for.
    #[error("the rank must be at least 1")]
    Rank,
    /// The tolerance is not a positive number.
    #[error("tolerance {0} is not a positive number")]
    Tolerance(f64),
    /// No thread is asked for.
    #[error("the number of threads must be at least 1")]
    Threads,
}

impl KatzSvdOptions {
    /// How many triplets have to reach the tolerance, at most as many as there are.
    pub(crate) fn exact(&self) -> usize {
        self.exact.map_or(self.rank, |exact| exact.min(self.rank))
    }

    /// The parameters with the guarantee that each is in its range.
    ///
    /// # Errors
    /// The first parameter that is not, as [`KatzSvdOptionsError`].
    pub fn check(self) -> Result<ValidKatzSvdOptions, KatzSvdOptionsError> {
        match self {
            Self { rank: 0, .. } => Err(KatzSvdOptionsError::Rank),
            Self { threads: 0, .. } => Err(KatzSvdOptionsError::Threads),
            Self { tolerance, .. } if !(tolerance.is_finite() && tolerance > 0.0) => {
                Err(KatzSvdOptionsError::Tolerance(tolerance))
            }
            valid => Ok(ValidKatzSvdOptions(valid)),
        }
    }
}

/// Parameters of a search that [`KatzSvdOptions::check`] found in their ranges.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ValidKatzSvdOptions(KatzSvdOptions);

impl ValidKatzSvdOptions {
    /// The values.
    #[must_use]
    pub fn get(&self) -> &KatzSvdOptions {
        &self.0
    }
}
