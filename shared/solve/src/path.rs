//! Which of the two ways to decompose the Katz similarity is taken.

use muster_method::decomposition::Path;
use muster_numeric::matrix::MAX_DENSE_ENTRIES;

use super::cost::Size;
use super::error::{SolveError, refuse};
use super::file::Emit;
use super::memory::{available_mib, fits_path};
use super::options::PathChoice;
use super::problem::Problem;

/// Fleets up to this size are decomposed whole, which takes a few seconds and is exact to rounding.
pub(super) const DENSE_ROBOTS: usize = 2000;

/// Most robots whose similarity can be held: the square of it is the largest dense matrix.
pub(super) const MAX_DENSE_ROBOTS: usize = MAX_DENSE_ENTRIES.isqrt();

/// The search for the leading triplets is worth while only if its space has at most this share of all
/// directions: otherwise it decomposes the whole, step by step.
const SEARCH_SHARE: f64 = 0.5;

/// The way in which a problem is solved.
pub(super) fn path_of(problem: &Problem, choice: PathChoice) -> Result<Path, SolveError> {
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
        PathChoice::Dense => Ok(Path::Dense),
        PathChoice::InverseFree => Ok(Path::InverseFree),
        PathChoice::Auto if wants_katz => Ok(Path::Dense),
        PathChoice::Auto => Ok(automatic(robots, &Size::of(problem))),
    }
}

fn automatic(robots: usize, size: &Size) -> Path {
    let whole = Path::Dense;
    if robots > MAX_DENSE_ROBOTS {
        return Path::InverseFree;
    }
    if size.search_width() > SEARCH_SHARE * size.robots {
        return whole;
    }
    let is_small = robots <= DENSE_ROBOTS && fits_path(whole, robots, size, available_mib());
    if is_small { whole } else { Path::InverseFree }
}

/// In a few words.
pub(super) fn description(path: Path) -> &'static str {
    match path {
        Path::Dense => "dense: the Katz similarity by LU, and its full decomposition",
        Path::InverseFree => "inverse-free: leading triplets by products with the graphs",
    }
}
