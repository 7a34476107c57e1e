//! k-means division of the rows of a matrix (equation 6 and algorithm 1 of the paper).
//!
//! The paper assigns every robot to the nearest of k random centroids and repeats until the labels
//! stay (Lloyd 1982). One such run often ends in a poor local optimum, so this module adds
//! restarts, greedy k-means++ seeding (Arthur and Vassilvitskii, SODA 2007) and, after Lloyd,
//! single-point exchanges (Hartigan and Wong, 1979), whose optima are a subset of Lloyd's.
//!
//! Teams with limits are divided by [`ValidKMeansOptions::divide_within`]; nothing of it touches a division without.
//!
//! Restart r draws from stream r of one generator, and sums run over chunks of points with fixed
//! bounds: results depend on the seed alone, not on the order of the restarts or on the number of
//! threads.

mod assign;
mod division;
mod exchange;
mod limited;
mod options;
mod partition;
mod points;
mod seeding;
mod single;
mod start;
mod sums;
mod warm;

pub use division::{KMeans, KMeansError, kmeans, kmeans_with_progress, lloyd};
pub use limited::{KMeansLimits, LimitedKMeans, LimitedKMeansError};
pub use options::{Init, KMeansOptions, KMeansOptionsError, ValidKMeansOptions};
pub use seeding::{DISTINCT_ROW_RATIO, count_distinct};
