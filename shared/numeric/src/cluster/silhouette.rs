//! Silhouettes (Rousseeuw, J. Comput. Appl. Math. 20, 1987): how much nearer each point is to its
//! own cluster than to the next one.
//!
//! There are three methods, named by [`Method`]. Euclidean distances between all pairs of points
//! are the definition, in O(N² D). Squared distances are another, sharper measure, for which the
//! sums over a cluster follow from its mean, in O(N k D). The mean over all points can also be
//! estimated from a sample, each point compared with all others, with a standard error. [`scores`]
//! takes the method as a parameter.

mod groups;
mod pairs;
mod sample;
mod scores;
mod squared;
mod types;

pub use pairs::silhouette;
pub use sample::{
    EXACT_POINTS, SAMPLE_POINTS, SilhouetteEstimate, SilhouetteOptions, ValidSilhouetteOptions,
    estimate_silhouette,
};
pub use scores::{Scores, method_by_size, scores};
pub use squared::silhouette_squared;
pub use types::{Method, Silhouette, SilhouetteError, SilhouetteOptionsError};
