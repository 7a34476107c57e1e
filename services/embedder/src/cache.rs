//! The decomposition of the last frame, kept for as long as it holds and as a start for the next.
//!
//! Small fleets get the Katz similarity S itself and its whole decomposition, which is exact to rounding.
//! For larger ones the leading triplets are found without S, beginning with those of the frame before.

use std::sync::Arc;

use muster_machine::Stopwatch;
use muster_model::embedding::EmbeddingMode;
use muster_model::id::RobotId;
use muster_numeric::cached_katz::Method;
use muster_numeric::dimension::{Choice, choose_covering_dimension, least_rank};
use muster_numeric::katz;
use muster_numeric::katz_svd::{KatzSvd, KatzSvdError, KatzSvdOptions, KatzSvdReport};
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::svd::{FullSvd, RankKSvd, full_svd};

use crate::compute::ComputeError;
use crate::correspondence::Correspondence;
use crate::decay::Chosen;
use crate::similarity::Similarity;

/// Fleets up to this size are decomposed whole: that takes less time than anything else.
const WHOLE: usize = 64;

/// Where the search for the leading triplets fails, fleets up to this size are decomposed whole after
/// all: it takes seconds at most.
const WHOLE_IN_NEED: usize = 2000;

/// Threads of a search. The other services of the host run beside it, and none is to wait.
const THREADS: usize = 1;

/// The decomposition of the last frame.
#[derive(Debug, Default)]
pub(crate) struct Cache {
    last: Option<Last>,
    /// The search, with the triplets of the frames before.
    search: KatzSvd,
    /// The robots that these are of.
    robots: Arc<[RobotId]>,
}

/// A frame, and what its similarity was decomposed into.
#[derive(Debug)]
struct Last {
    fused: SparseMatrix,
    alpha: f64,
    kept: Kept,
}

/// How S was decomposed.
#[derive(Debug)]
enum Kept {
    /// Into all of its triplets.
    Whole(FullSvd),
    /// Into the leading triplets, which stand in the search: how many, how exactly.
    Leading { rank: usize, residual: f64 },
}

/// The frame that a decomposition is wanted for.
#[derive(Debug)]
pub(crate) struct Wanted<'a> {
    /// A*.
    pub(crate) fused: &'a SparseMatrix,
    /// Its decay, with bounds of its spectral radius.
    pub(crate) chosen: &'a Chosen,
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

impl Cache {
    /// The leading triplets of a frame. Those that are kept serve if graph and decay are the same bit for
    /// bit and they are still exact and many enough.
    pub(crate) fn obtain(
        &mut self,
        similarity: &mut Similarity,
        wanted: &Wanted<'_>,
        stopwatch: &mut Stopwatch,
    ) -> Result<Obtained, ComputeError> {
        let kept = self.last.take().filter(|last| last.is_of(wanted)).map(|last| last.kept);
        let (kept, obtained) = if wanted.fused.nodes() <= WHOLE {
            whole(similarity, kept, wanted, stopwatch)?
        } else {
            self.leading(similarity, kept, wanted, stopwatch)?
        };
        let (fused, alpha) = (wanted.fused.clone(), wanted.chosen.alpha);
        self.last = Some(Last { fused, alpha, kept });
        Ok(obtained)
    }

    /// The leading triplets without S.
    fn leading(
        &mut self,
        similarity: &mut Similarity,
        kept: Option<Kept>,
        wanted: &Wanted<'_>,
        stopwatch: &mut Stopwatch,
    ) -> Result<(Kept, Obtained), ComputeError> {
        let n = wanted.fused.nodes();
        let tolerance = tolerance_of(wanted);
        if let Some(Kept::Leading { rank, residual }) = kept
            && residual <= tolerance
            && let Some(choice) = wanted.cut.of_some(&self.search, (rank, n))
            && !choice.short
        {
            let svd = self.search.truncate(choice.dimension)?;
            let took_us = [0, stopwatch.lap()];
            let mode = EmbeddingMode::Cached;
            let obtained = Obtained { svd, mode, residual, probe: 0.0, took_us };
            return Ok((Kept::Leading { rank, residual }, obtained));
        }
        let mut rank = wanted.cut.least_rank(n);
        let (choice, report) = loop {
            let options = KatzSvdOptions { rank, tolerance, seed: wanted.seed, threads: THREADS };
            let report = self.search(wanted, options)?;
            if !report.converged && n <= WHOLE_IN_NEED {
                self.search.forget();
                return whole(similarity, None, wanted, stopwatch);
            }
            match wanted.cut.of_some(&self.search, (rank, n)) {
                Some(choice) if !choice.short => break (choice, report),
                _ => rank = (2 * rank).min(n),
            }
        };
        let svd = self.search.truncate(choice.dimension)?;
        let took_us = [0, stopwatch.lap()];
        let searched = report.rounds > 0;
        let mode = if searched { EmbeddingMode::InverseFree } else { EmbeddingMode::Updated };
        let residual = report.residual;
        let obtained = Obtained { svd, mode, residual, probe: 0.0, took_us };
        Ok((Kept::Leading { rank, residual }, obtained))
    }

    /// A search that begins with the triplets of the robots that were there before.
    fn search(
        &mut self,
        wanted: &Wanted<'_>,
        options: KatzSvdOptions,
    ) -> Result<KatzSvdReport, KatzSvdError> {
        let between = Correspondence::between(&self.robots, wanted.robots);
        let to_old = between.as_ref().map(Correspondence::to_old);
        let Chosen { alpha, radius, .. } = wanted.chosen;
        let report = self.search.solve(wanted.fused, *alpha, radius, options, to_old)?;
        self.robots = Arc::clone(wanted.robots);
        Ok(report)
    }
}

impl Last {
    fn is_of(&self, wanted: &Wanted<'_>) -> bool {
        self.alpha.to_bits() == wanted.chosen.alpha.to_bits() && self.fused == *wanted.fused
    }
}

impl Cut<'_> {
    /// K where all triplets are known.
    fn of_all(self, svd: &FullSvd) -> usize {
        let n = svd.singular_values().len();
        match self {
            Self::Fixed(dimension) => dimension.clamp(1, n),
            Self::Seeing { teams, related, before, most } => {
                let choice = choose_covering_dimension(svd, related, teams, before);
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
                let choice = choose_covering_dimension(search, related, teams, before);
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

/// The decomposition of S as a whole: the kept one if S has not changed.
fn whole(
    similarity: &mut Similarity,
    kept: Option<Kept>,
    wanted: &Wanted<'_>,
    stopwatch: &mut Stopwatch,
) -> Result<(Kept, Obtained), ComputeError> {
    let update = similarity.update(wanted.fused, wanted.chosen, wanted.robots)?;
    let overflow = katz::KatzError::Overflow { alpha: wanted.chosen.alpha };
    let s = similarity.matrix().ok_or(overflow)?;
    let solved_us = stopwatch.lap();
    let (all, mode) = match (kept, update.method) {
        (Some(Kept::Whole(all)), Method::Kept) => (all, EmbeddingMode::Cached),
        (_, Method::Kept | Method::Updated) => (full_svd(&s)?, EmbeddingMode::Updated),
        _ => (full_svd(&s)?, EmbeddingMode::Dense),
    };
    let svd = all.truncate(wanted.cut.of_all(&all))?;
    let residual = svd.residual(&s)?;
    let took_us = [solved_us, stopwatch.lap()];
    let obtained = Obtained { svd, mode, residual, probe: update.probe, took_us };
    Ok((Kept::Whole(all), obtained))
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
    use muster_numeric::katz::katz_similarity;
    use muster_numeric::spectral_radius::spectral_radius;

    use super::*;

    /// A ring with a chord from node 0, so heavy.
    fn ring(n: usize, chord: f64) -> SparseMatrix {
        let ring = (0..n).map(|i| (i, (i + 1) % n, 1.0 + i as f64));
        SparseMatrix::from_triplets(n, ring.chain([(0, n / 2, chord)])).unwrap()
    }

    fn names(n: usize) -> Arc<[RobotId]> {
        (0..n).map(|i| RobotId::new(format!("r{i:04}")).unwrap()).collect()
    }

    #[derive(Default)]
    struct Bench {
        cache: Cache,
        similarity: Similarity,
    }

    impl Bench {
        fn get(&mut self, n: usize, chord: f64, alpha: f64) -> Obtained {
            let fused = ring(n, chord);
            let radius = spectral_radius(&fused, None);
            let alpha = alpha / n as f64;
            assert!(alpha * radius.upper < 1.0);
            let wanted = Wanted {
                fused: &fused,
                chosen: &Chosen { alpha, radius, centrality: vec![1.0; n] },
                robots: &names(n),
                tolerance: 1e-8,
                seed: 7,
                cut: Cut::Fixed(3),
            };
            self.cache.obtain(&mut self.similarity, &wanted, &mut Stopwatch::still()).unwrap()
        }
    }

    #[test]
    fn the_same_graph_and_decay_reuse_the_triplets() {
        for (n, mode) in [(8, EmbeddingMode::Dense), (90, EmbeddingMode::InverseFree)] {
            let mut bench = Bench::default();
            assert_eq!(bench.get(n, 0.0, 0.5).mode, mode);
            assert_eq!(bench.get(n, 0.0, 0.5).mode, EmbeddingMode::Cached);
            assert_eq!(bench.get(n, 0.0, 0.25).mode, mode);
        }
    }

    #[test]
    fn few_changes_update_the_similarity_of_a_small_fleet() {
        let mut bench = Bench::default();
        bench.get(20, 0.5, 0.5);
        let updated = bench.get(20, 0.7, 0.5);
        assert_eq!(updated.mode, EmbeddingMode::Updated);
        let anew = Bench::default().get(20, 0.7, 0.5);
        assert_eq!(anew.mode, EmbeddingMode::Dense);
        for (updated, anew) in updated.svd.sigma.iter().zip(&anew.svd.sigma) {
            assert!((updated - anew).abs() < 1e-14);
        }
        assert!(updated.probe < 1e-14);
    }

    #[test]
    fn both_ways_agree() {
        let found = Bench::default().get(90, 0.0, 0.5);
        let (fused, radius) = (ring(90, 0.0), spectral_radius(&ring(90, 0.0), None));
        let similarity = katz_similarity(&fused, 0.5 / 90.0, &radius).unwrap();
        let all = full_svd(&similarity).unwrap();
        for (found, wanted) in found.svd.sigma.iter().zip(all.singular_values()) {
            assert!((found - wanted).abs() < 1e-9 * wanted);
        }
        assert!(found.svd.residual(&similarity).unwrap() < 1e-7);
    }

    #[test]
    fn robots_that_join_are_no_new_beginning() {
        let mut bench = Bench::default();
        bench.get(90, 0.0, 0.5);
        assert_eq!(bench.get(92, 0.0, 0.5).mode, EmbeddingMode::InverseFree);
        assert_eq!(bench.get(20, 0.0, 0.5).mode, EmbeddingMode::Dense);
        assert_eq!(bench.get(90, 0.0, 0.5).mode, EmbeddingMode::InverseFree);
    }
}
