//! What was last computed from a fused graph, kept for as long as it holds and as a start for the next.
//!
//! Small fleets get the Katz similarity S itself and its whole decomposition, which is exact to rounding.
//! For larger ones the leading triplets are found without S, beginning with those of the frame before.

use std::sync::Arc;

use muster_machine::Stopwatch;
use muster_model::embedding::EmbeddingMode;
use muster_model::id::RobotId;
use muster_numeric::dimension::{Choice, choose_seeing_dimension, least_rank};
use muster_numeric::katz::{self, katz_probe, katz_similarity};
use muster_numeric::katz_svd::{KatzSvd, KatzSvdError, KatzSvdOptions};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::spectral_radius::{SpectralRadius, spectral_radius};
use muster_numeric::svd::{FullSvd, RankKSvd, full_svd};

use crate::compute::ComputeError;

/// Fleets up to this size are decomposed whole: that takes less time than anything else.
const WHOLE: usize = 64;

/// Where the search for the leading triplets fails, fleets up to this size are decomposed whole after
/// all: it takes seconds at most.
const WHOLE_IN_NEED: usize = 2000;

/// What was last computed from a fused graph.
#[derive(Debug)]
pub(crate) struct Cache {
    /// A*.
    pub(crate) fused: SparseMatrix,
    alpha: f64,
    /// Bounds of the spectral radius of the fused graph.
    pub(crate) radius: SpectralRadius,
    robots: Arc<[RobotId]>,
    kept: Kept,
    /// The search, with the triplets of the frames before.
    search: Box<KatzSvd>,
}

/// How S was decomposed.
#[derive(Debug)]
enum Kept {
    /// S, and all of its triplets.
    Whole(DenseMatrix, FullSvd),
    /// The leading triplets, which stand in the search: how many, how exactly.
    Leading { rank: usize, residual: f64 },
}

/// The frame that a decomposition is wanted for.
#[derive(Debug)]
pub(crate) struct Wanted<'a> {
    /// A*.
    pub(crate) fused: SparseMatrix,
    /// Bounds of its spectral radius.
    pub(crate) radius: SpectralRadius,
    pub(crate) alpha: f64,
    /// The robots, ordered by name.
    pub(crate) robots: &'a Arc<[RobotId]>,
    /// Largest residual.
    pub(crate) tolerance: f64,
    /// Seed of random vectors.
    pub(crate) seed: u64,
    pub(crate) cut: Cut<'a>,
}

/// Where the triplets are cut off.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Cut<'a> {
    /// After so many.
    Fixed(usize),
    /// By the rule for so many teams that sees all related robots, and may keep the K before.
    Seeing { teams: usize, related: &'a [bool], before: Option<usize>, most: usize },
}

/// The triplets of a frame, and how they were come by.
#[derive(Debug)]
pub(crate) struct Obtained {
    /// The leading triplets.
    pub(crate) svd: RankKSvd,
    pub(crate) mode: EmbeddingMode,
    /// Residual of the triplets.
    pub(crate) residual: f64,
    /// How exact S is, by a random sign vector.
    pub(crate) probe: f64,
    /// Microseconds for the similarity with its probe, and for the decomposition.
    pub(crate) took_us: [u64; 2],
}

/// The spectral radius of a fused graph: the kept one if the graph is still the same.
pub(crate) fn radius_of(cache: Option<&Cache>, fused: &SparseMatrix) -> SpectralRadius {
    match cache {
        Some(kept) if kept.fused == *fused => kept.radius.clone(),
        // Not started from the vector of the last frame, so that α depends on the graph alone.
        _ => spectral_radius(fused, None),
    }
}

/// The leading triplets of a frame. Those that are kept serve if graph and decay are the same bit for bit
/// and they are still exact and many enough.
pub(crate) fn obtain(
    cache: &mut Option<Cache>,
    wanted: Wanted<'_>,
    stopwatch: &mut Stopwatch,
) -> Result<Obtained, ComputeError> {
    if let Some(kept) = cache.as_ref().filter(|kept| kept.is_of(&wanted))
        && let Some(obtained) = kept.again(&wanted, stopwatch)?
    {
        return Ok(obtained);
    }
    let (before, mut search) = match cache.take() {
        Some(kept) => (Some(kept.robots), kept.search),
        None => (None, Box::default()),
    };
    let (kept, obtained) = if wanted.fused.nodes() <= WHOLE {
        whole(&wanted, stopwatch)?
    } else {
        leading(&wanted, before.as_deref(), &mut search, stopwatch)?
    };
    let Wanted { fused, radius, alpha, robots, .. } = wanted;
    *cache = Some(Cache { fused, alpha, radius, robots: Arc::clone(robots), kept, search });
    Ok(obtained)
}

impl Cache {
    fn is_of(&self, wanted: &Wanted<'_>) -> bool {
        self.alpha.to_bits() == wanted.alpha.to_bits() && self.fused == wanted.fused
    }

    /// The triplets of the same graph once more, unless they have spoiled or are too few.
    fn again(
        &self,
        wanted: &Wanted<'_>,
        stopwatch: &mut Stopwatch,
    ) -> Result<Option<Obtained>, ComputeError> {
        let mode = EmbeddingMode::Cached;
        match &self.kept {
            Kept::Whole(similarity, all) => {
                let probe = katz_probe(&self.fused, self.alpha, similarity, wanted.seed)?;
                if probe > wanted.tolerance {
                    return Ok(None);
                }
                let took_us = [stopwatch.lap(), 0];
                let svd = all.truncate(wanted.cut.of_all(all))?;
                let residual = svd.residual(similarity)?;
                Ok(Some(Obtained { svd, mode, residual, probe, took_us }))
            }
            Kept::Leading { rank, residual } => {
                let known = (*rank, self.fused.nodes());
                let dimension =
                    wanted.cut.of_some(&self.search, known).filter(|choice| !choice.short);
                let (Some(choice), true) = (dimension, *residual <= tolerance_of(wanted)) else {
                    return Ok(None);
                };
                let svd = self.search.truncate(choice.dimension)?;
                let took_us = [0, stopwatch.lap()];
                Ok(Some(Obtained { svd, mode, residual: *residual, probe: 0.0, took_us }))
            }
        }
    }
}

impl Cut<'_> {
    /// K where all triplets are known.
    fn of_all(self, svd: &FullSvd) -> usize {
        let n = svd.singular_values().len();
        match self {
            Self::Fixed(dimension) => dimension.clamp(1, n),
            Self::Seeing { teams, related, before, most } => {
                let choice = choose_seeing_dimension(svd, related, teams, before);
                choice.dimension.min(most).clamp(1, n)
            }
        }
    }

    /// How many triplets of `n` must be known for a choice.
    fn least_rank(self, n: usize) -> usize {
        let rank = match self {
            Self::Fixed(dimension) => dimension + 1,
            Self::Seeing { teams, before, most, .. } => {
                least_rank(n, teams).max(before.unwrap_or(0).min(most) + 1)
            }
        };
        rank.clamp(1, n)
    }

    /// K where the search knows so many triplets of so many; none if these are too few.
    fn of_some(self, search: &KatzSvd, (rank, n): (usize, usize)) -> Option<Choice> {
        if rank < self.least_rank(n) {
            return None;
        }
        Some(match self {
            Self::Fixed(dimension) => Choice { dimension: dimension.clamp(1, n), short: false },
            Self::Seeing { teams, related, before, most } => {
                let choice = choose_seeing_dimension(search, related, teams, before);
                let short = choice.short && rank < n.min(most + 1);
                Choice { dimension: choice.dimension.min(most).clamp(1, n), short }
            }
        })
    }
}

/// The residual that is searched for: below this one rounding has the last word.
fn tolerance_of(wanted: &Wanted<'_>) -> f64 {
    const LEAST: f64 = 1e-10;
    wanted.tolerance.max(LEAST)
}

/// The decomposition of S as a whole.
fn whole(wanted: &Wanted<'_>, stopwatch: &mut Stopwatch) -> Result<(Kept, Obtained), ComputeError> {
    let Wanted { fused, radius, alpha, seed, .. } = wanted;
    let similarity = katz_similarity(fused, *alpha, radius)?;
    let probe = katz_probe(fused, *alpha, &similarity, *seed)?;
    let solved_us = stopwatch.lap();
    let all = full_svd(&similarity)?;
    let svd = all.truncate(wanted.cut.of_all(&all))?;
    let residual = svd.residual(&similarity)?;
    let took_us = [solved_us, stopwatch.lap()];
    let obtained = Obtained { svd, mode: EmbeddingMode::Dense, residual, probe, took_us };
    Ok((Kept::Whole(similarity, all), obtained))
}

/// The leading triplets without S, beginning with those of the robots `before`.
fn leading(
    wanted: &Wanted<'_>,
    before: Option<&[RobotId]>,
    search: &mut KatzSvd,
    stopwatch: &mut Stopwatch,
) -> Result<(Kept, Obtained), ComputeError> {
    let Wanted { fused, radius, alpha, robots, seed, .. } = wanted;
    let n = fused.nodes();
    let mut moved: Option<Vec<Option<usize>>> = before
        .filter(|before| *before != &***robots)
        .map(|before| robots.iter().map(|robot| before.binary_search(robot).ok()).collect());
    if before.is_none() {
        search.forget();
    }
    let mut rank = wanted.cut.least_rank(n);
    let (choice, report) = loop {
        let options =
            KatzSvdOptions { rank, tolerance: tolerance_of(wanted), seed: *seed, threads: 1 };
        let report = search.solve(fused, *alpha, radius, options, moved.as_deref())?;
        moved = None;
        if !report.converged && n <= WHOLE_IN_NEED {
            search.forget();
            return whole(wanted, stopwatch);
        }
        match wanted.cut.of_some(search, (rank, n)) {
            Some(choice) if !choice.short => break (choice, report),
            _ => rank = (2 * rank).min(n),
        }
    };
    let svd = search.truncate(choice.dimension)?;
    let residual = report.residual;
    let took_us = [0, stopwatch.lap()];
    let mode = EmbeddingMode::InverseFree;
    Ok((Kept::Leading { rank, residual }, Obtained { svd, mode, residual, probe: 0.0, took_us }))
}

impl From<katz::KatzError> for ComputeError {
    fn from(error: katz::KatzError) -> Self {
        match error {
            katz::KatzError::Diverges { alpha, radius } => {
                Self::Diverges { alpha, limit: radius.recip() }
            }
            other => Self::Katz(other),
        }
    }
}

impl From<KatzSvdError> for ComputeError {
    fn from(error: KatzSvdError) -> Self {
        match error {
            KatzSvdError::Katz(error) => error.into(),
            KatzSvdError::Rank(error) => Self::Svd(error),
            other => Self::Search(other),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(n: usize) -> SparseMatrix {
        SparseMatrix::from_triplets(n, (0..n).map(|i| (i, (i + 1) % n, 1.0 + i as f64))).unwrap()
    }

    fn names(n: usize) -> Arc<[RobotId]> {
        (0..n).map(|i| RobotId::new(format!("r{i:04}")).unwrap()).collect()
    }

    fn get(cache: &mut Option<Cache>, n: usize, alpha: f64) -> Obtained {
        let (fused, robots) = (ring(n), names(n));
        let radius = radius_of(cache.as_ref(), &fused);
        let alpha = alpha / radius.upper;
        let cut = Cut::Fixed(3);
        let wanted =
            Wanted { fused, radius, alpha, robots: &robots, tolerance: 1e-8, seed: 7, cut };
        obtain(cache, wanted, &mut Stopwatch::still()).unwrap()
    }

    #[test]
    fn the_same_graph_and_decay_reuse_the_triplets() {
        for (n, mode) in [(8, EmbeddingMode::Dense), (90, EmbeddingMode::InverseFree)] {
            let mut cache = None;
            assert_eq!(get(&mut cache, n, 0.5).mode, mode);
            assert_eq!(get(&mut cache, n, 0.5).mode, EmbeddingMode::Cached);
            assert_eq!(get(&mut cache, n, 0.25).mode, mode);
        }
    }

    #[test]
    fn both_ways_agree() {
        let mut cache = None;
        let found = get(&mut cache, 90, 0.5);
        let (fused, radius) = (ring(90), spectral_radius(&ring(90), None));
        let similarity = katz_similarity(&fused, 0.5 / radius.upper, &radius).unwrap();
        let all = full_svd(&similarity).unwrap();
        for (found, wanted) in found.svd.sigma.iter().zip(all.singular_values()) {
            assert!((found - wanted).abs() < 1e-9 * wanted);
        }
        assert!(found.svd.residual(&similarity).unwrap() < 1e-7);
    }

    #[test]
    fn a_spoilt_similarity_is_found_by_the_probe_and_replaced() {
        let mut cache = None;
        get(&mut cache, 8, 0.5);
        let kept = cache.as_mut().unwrap();
        let Kept::Whole(similarity, _) = &mut kept.kept else { panic!("a small fleet") };
        let mut data = similarity.data().to_vec();
        data[5] += 1e-3;
        *similarity = DenseMatrix::new(8, 8, data).unwrap();
        let mended = get(&mut cache, 8, 0.5);
        assert_eq!(mended.mode, EmbeddingMode::Dense);
        assert!(mended.probe < 1e-14);
    }

    #[test]
    fn robots_that_join_are_no_new_beginning() {
        let mut cache = None;
        get(&mut cache, 90, 0.5);
        assert_eq!(get(&mut cache, 92, 0.5).mode, EmbeddingMode::InverseFree);
        assert_eq!(get(&mut cache, 20, 0.5).mode, EmbeddingMode::Dense);
        assert_eq!(get(&mut cache, 90, 0.5).mode, EmbeddingMode::InverseFree);
    }
}
