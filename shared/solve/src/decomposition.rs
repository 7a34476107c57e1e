//! The leading singular triplets of the Katz similarity, by either path.

use muster_model::settings::Dimension;
use muster_numeric::dimension::{choose_dimension, choose_known_dimension, least_rank};
use muster_numeric::katz::{KatzError, katz_probe, katz_similarity};
use muster_numeric::katz_svd::{KatzSvd, KatzSvdError, KatzSvdOptions, SearchRound};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::spectral_radius::SpectralRadius;
use muster_numeric::svd::{RankKSvd, SvdError, full_svd};

use super::cost::Size;
use super::division::wanted_teams;
use super::file::Emit;
use super::options::PathChoice;
use super::path::Path;
use super::problem::Problem;
use super::step::{Progress, Step};
use super::{SolveError, refuse};

/// Seed of the probe that checks the Katz similarity, and of the vectors that the search begins with.
const SEED: u64 = 0;

/// Where the search does not reach its tolerance, fleets up to this size are decomposed whole after all,
/// if that fits: it takes a minute at most.
const DENSE_IN_NEED: usize = 4000;

/// What a search that did not reach its tolerance must leave of the residual for going on with it.
const PROGRESS: f64 = 0.5;

/// The triplets, and how they were come by.
#[derive(Debug)]
pub(super) struct Decomposition {
    pub(super) path: Path,
    pub(super) svd: RankKSvd,
    /// Largest ‖S v − σ u‖ or ‖Sᵀ u − σ v‖, relative to σ₁; where S is never formed, a bound on it.
    pub(super) residual: f64,
    /// Whether the residual is what was asked for.
    pub(super) converged: bool,
    /// S, only where it is wanted in the output: it is as large as all else together.
    pub(super) katz: Option<DenseMatrix>,
    /// ‖M (S + I) z − z‖ / ‖z‖ for a random sign vector z; none where S is never formed.
    pub(super) katz_residual: Option<f64>,
}

/// The graph that is decomposed: A*, its decay and its radius.
#[derive(Debug, Clone, Copy)]
pub(super) struct Walks<'a> {
    pub(super) fused: &'a SparseMatrix,
    pub(super) alpha: f64,
    pub(super) radius: &'a SpectralRadius,
}

impl Decomposition {
    /// The leading triplets for a problem, by `path` unless that fails and the other one is at hand.
    pub(super) fn new(
        problem: &Problem,
        walks: Walks<'_>,
        path: Path,
        progress: &mut Progress<'_>,
    ) -> Result<Self, SolveError> {
        if path == Path::Dense {
            return dense(problem, walks, progress);
        }
        progress(Step::SEARCH);
        let found = inverse_free(problem, walks, progress)?;
        let robots = problem.robots.len();
        let may_change = problem.options.path == PathChoice::Auto && robots <= DENSE_IN_NEED;
        if !found.converged && may_change && Path::Dense.admit(robots, &Size::of(problem)).is_ok() {
            return dense(problem, walks, progress);
        }
        if !found.residual.is_finite() {
            return refuse(
                "modalities",
                "the weights span so many magnitudes that no singular vectors are found without the \
                 similarity; for fewer robots --path dense finds them",
            );
        }
        Ok(found)
    }

    /// Bound on the sine of the angle by which the spaces of U and of V are turned against the true ones
    /// (Wedin, BIT 12, 1972): the residuals of all K triplets over the gap behind them. 1 says nothing.
    pub(super) fn angle_bound(&self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "there are a few triplets")]
        let together = self.residual * (self.svd.rank() as f64).sqrt();
        match self.svd.gap() {
            gap if gap > together => together / gap,
            _ if together == 0.0 => 0.0,
            _ => 1.0,
        }
    }
}

/// S by LU, and its full decomposition.
fn dense(
    problem: &Problem,
    walks: Walks<'_>,
    progress: &mut Progress<'_>,
) -> Result<Decomposition, SolveError> {
    let Walks { fused, alpha, radius } = walks;
    progress(Step::Katz);
    let similarity = katz_similarity(fused, alpha, radius).or_else(of_katz)?;
    progress(Step::Svd);
    let full = full_svd(&similarity).or_else(of_numbers)?;
    let wanted = match problem.dimension {
        Dimension::Fixed(dimension) => dimension as usize / 2,
        Dimension::Auto => choose_dimension(full.singular_values(), wanted_teams(problem)),
    };
    let svd = full.truncate(wanted.clamp(1, problem.robots.len())).or_else(of_numbers)?;
    drop(full);
    let residual = svd.residual(&similarity).or_else(of_numbers)?;
    let probe = katz_probe(fused, alpha, &similarity, SEED).or_else(of_katz)?;
    Ok(Decomposition {
        path: Path::Dense,
        svd,
        residual,
        converged: true,
        katz: problem.emit.contains(&Emit::Katz).then_some(similarity),
        katz_residual: Some(probe),
    })
}

/// The leading triplets without S.
///
/// The search is for a small ‖Mᵀ(Sᵀu − σv)‖; ‖M⁻ᵀ‖ = ‖I + S‖ ≤ 1 + σ₁ bounds ‖Sᵀu − σv‖ itself.
fn inverse_free(
    problem: &Problem,
    walks: Walks<'_>,
    progress: &mut Progress<'_>,
) -> Result<Decomposition, SolveError> {
    let Walks { fused, alpha, radius } = walks;
    let n = fused.nodes();
    let rank = match problem.dimension {
        Dimension::Fixed(dimension) => dimension as usize / 2 + 1,
        Dimension::Auto => least_rank(n, wanted_teams(problem)),
    };
    let tolerance = problem.options.tolerance;
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let options = KatzSvdOptions { rank: rank.clamp(1, n), tolerance, seed: SEED, threads };
    let mut search = KatzSvd::default();
    // Rounds of all searches together.
    let mut rounds = 0;
    let mut solve = |search: &mut KatzSvd| {
        let before = rounds;
        let mut watch = |told: SearchRound| {
            rounds = before + told.round;
            progress(Step::Search { round: rounds, open: told.open, rank: told.rank });
        };
        search
            .solve_with_progress(fused, alpha, radius, options, None, &mut watch)
            .or_else(of_search)
    };
    let mut report = solve(&mut search)?;
    // Where walks grow for long before they fade, the search takes more rounds than a frame is given.
    while !report.converged {
        let last = report.residual;
        report = solve(&mut search)?;
        // Infinite ones, of which none is smaller, end it too.
        if report.residual >= PROGRESS * last {
            break;
        }
    }
    let worse = 1.0 + search.all_singular_values().first().copied().unwrap_or(0.0);
    let chosen = match problem.dimension {
        Dimension::Fixed(dimension) => dimension as usize / 2,
        Dimension::Auto => choose_known_dimension(&search, wanted_teams(problem)),
    };
    Ok(Decomposition {
        path: Path::InverseFree,
        svd: search.truncate(chosen.clamp(1, n)).or_else(of_numbers)?,
        residual: worse * report.residual,
        converged: report.converged,
        katz: None,
        katz_residual: None,
    })
}

/// An error of the similarity, by the field that is to be changed.
pub(super) fn of_katz<T>(error: KatzError) -> Result<T, SolveError> {
    match error {
        KatzError::Diverges { alpha, radius } => refuse(
            "alpha",
            format!(
                "{alpha} must be less than 1/ρ = {} of this file (ρ = {radius}); set it below, or \
                 as {{\"fraction\": 0.5}}",
                1.0 / radius
            ),
        ),
        KatzError::Matrix(error) => refuse("robots", error.to_string()),
        other => refuse("alpha", other.to_string()),
    }
}

/// An error of the decomposition. None is left for checked input.
fn of_numbers<T>(error: SvdError) -> Result<T, SolveError> {
    refuse("modalities", error.to_string())
}

fn of_search<T>(error: KatzSvdError) -> Result<T, SolveError> {
    match error {
        KatzSvdError::Katz(error) => of_katz(error),
        KatzSvdError::Rank(error) => of_numbers(error),
        other => refuse("modalities", other.to_string()),
    }
}
