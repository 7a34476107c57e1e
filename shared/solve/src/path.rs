//! The two ways to decompose the Katz similarity, and which of them is taken.

use muster_numeric::matrix::MAX_DENSE_ENTRIES;
use serde::Serialize;

use super::cost::Size;
use super::file::Emit;
use super::memory::available_mib;
use super::options::PathChoice;
use super::problem::Problem;
use super::{SolveError, refuse};

/// Fleets up to this size are decomposed whole, which takes a few seconds and is exact to rounding.
pub(super) const DENSE_ROBOTS: usize = 2000;

/// Most robots whose similarity can be held: the square of it is the largest dense matrix.
pub(super) const MAX_DENSE_ROBOTS: usize = MAX_DENSE_ENTRIES.isqrt();

/// The search for the leading triplets is worth while only if its space has at most this share of all
/// directions: otherwise it decomposes the whole, step by step.
const SPARE: f64 = 0.5;

/// How the Katz similarity is decomposed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Path {
    /// The Katz similarity by LU, and all of its singular values and vectors.
    Dense,
    /// The leading triplets from products with the graphs, the similarity never formed.
    InverseFree,
}

impl Path {
    /// The way in which a problem is solved.
    pub(super) fn of(problem: &Problem, choice: PathChoice) -> Result<Self, SolveError> {
        let robots = problem.robots.len();
        let wants_katz = problem.emit.contains(&Emit::Katz);
        let fits_a_matrix = robots <= MAX_DENSE_ROBOTS;
        match choice {
            PathChoice::InverseFree if wants_katz => refuse(
                "emit",
                "\"katz\" is the similarity itself, which the inverse-free path never forms; leave \
                 one of the two out",
            ),
            PathChoice::Auto | PathChoice::Dense if wants_katz && !fits_a_matrix => refuse(
                "emit",
                format!(
                    "\"katz\" is a matrix of all pairs of robots, which may be {MAX_DENSE_ROBOTS} \
                     at most, not {robots}; leave it out"
                ),
            ),
            PathChoice::Dense if !fits_a_matrix => refuse(
                "robots",
                format!(
                    "{robots} are too many for the dense path, which holds matrices of all pairs of \
                     {MAX_DENSE_ROBOTS} robots at most; leave --path out"
                ),
            ),
            PathChoice::Dense => Ok(Self::Dense),
            PathChoice::InverseFree => Ok(Self::InverseFree),
            PathChoice::Auto if wants_katz => Ok(Self::Dense),
            PathChoice::Auto => Ok(Self::automatic(robots, &Size::of(problem))),
        }
    }

    fn automatic(robots: usize, size: &Size) -> Self {
        let whole = Self::Dense;
        if robots > MAX_DENSE_ROBOTS {
            return Self::InverseFree;
        }
        if size.search_width() > SPARE * size.robots {
            return whole;
        }
        let is_small = robots <= DENSE_ROBOTS && whole.fits(robots, size, available_mib());
        if is_small { whole } else { Self::InverseFree }
    }

    /// In a few words.
    pub(super) fn description(self) -> &'static str {
        match self {
            Self::Dense => "dense: the Katz similarity by LU, and its full decomposition",
            Self::InverseFree => "inverse-free: leading triplets by products with the graphs",
        }
    }
}
