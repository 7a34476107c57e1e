//! The leading singular triplets of the Katz similarity S.
//!
//! Small fleets get S itself and its whole decomposition, which is exact to rounding. For larger ones the
//! leading triplets are found without S ([`LeadingTriplets`]), beginning with those of the frame before.

use std::sync::Arc;

use muster_model::embedding::EmbeddingMode;
use muster_model::id::RobotId;
use muster_numeric::katz_svd::{KatzSvd, KatzSvdError, KatzSvdOptions, KatzSvdReport, SearchRound};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::svd::{FullSvd, RankKSvd, SvdError, full_svd};
use serde::Serialize;

use crate::candidates::{Candidates, Counted};
use crate::correspondence::Correspondence;
use crate::cut::Cut;
use crate::decay::Decay;
use crate::error::MethodError;
use crate::params::{Effort, EmbeddingParams, Pace};
use crate::similarity::{Origin, Similarity, Solved};
use crate::step::{Progress, Step};
use crate::team_count::TeamEvidence;

/// A further search is worth while if it leaves at most this share of the residual.
const WORTHWHILE_SHARE: f64 = 0.5;

/// Part of the rows up to which changed rows are handed over one by one: 1 in so many. Beyond, the search
/// takes a pass over everything, which needs no list.
const CHANGED_PART: usize = 8;

/// Rounds of one frame of a moving fleet, times its robots. A round takes some microseconds for each robot, so that a frame
/// takes a few seconds of a core at most: where values lie close together a search to the tolerance takes a minute for 50,000
/// robots, and a division of vectors that are less exact serves better than one of a minute ago. The next frame goes on from there.
const FRAME_ROUND_ROBOTS: usize = 1_200_000;

/// The two ways to decompose the Katz similarity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Path {
    /// The Katz similarity by LU, and all of its singular values and vectors.
    Dense,
    /// The leading triplets from products with the graphs; the similarity is never formed.
    InverseFree,
}

/// The leading triplets of a frame, and how they were found.
#[derive(Debug)]
pub struct Decomposition {
    /// The K leading triplets.
    pub svd: RankKSvd,
    /// How many teams all triplets that are known show.
    pub teams: TeamEvidence,
    /// Which way they were found.
    pub path: Path,
    /// The same, and whether the frame before was of use.
    pub mode: EmbeddingMode,
    /// Largest ‖S v − σ u‖ or ‖Sᵀ u − σ v‖ over the triplets, relative to σ₁; where S is never formed, a
    /// bound of it.
    pub residual: f64,
    /// Whether the residual is within the tolerance.
    pub converged: bool,
    /// Whether no stronger triplet is missing, as far as is known: only then do residual and gap bound the
    /// angles to the true subspaces. See [`KatzSvdReport::complete`].
    pub complete: bool,
    /// S, where it was formed.
    pub similarity: Option<DenseMatrix>,
    /// Largest |M S z − α A z| for random signs z, relative to what rounding is relative to; none where S is never formed.
    pub probe: Option<f64>,
}

/// The frame that is decomposed.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Task<'a> {
    pub(crate) fused: &'a Arc<SparseMatrix>,
    pub(crate) decay: &'a Decay,
    pub(crate) robots: &'a Arc<[RobotId]>,
    pub(crate) params: &'a EmbeddingParams,
    pub(crate) cut: &'a Cut,
    pub(crate) counted: Counted<'a>,
}

/// The decomposition of the last frame.
#[derive(Debug, Default)]
pub(crate) struct Decomposer {
    last: Option<Last>,
    leading: LeadingTriplets,
    candidates: Candidates,
    /// The rank at which the last frame stopped although more triplets would embed more robots; else 0.
    short_at: usize,
}

/// What the last frame was decomposed into.
#[derive(Debug)]
enum Last {
    /// S of this graph and decay into all of its triplets.
    Whole { fused: Arc<SparseMatrix>, alpha: f64, all: FullSvd },
    /// Into so many leading triplets, which [`LeadingTriplets`] holds with the graph.
    Leading { alpha: f64, known: Known, report: KatzSvdReport },
}

/// How many leading triplets are known.
#[derive(Debug, Clone, Copy)]
struct Known {
    /// All of them.
    rank: usize,
    /// Those that are within the tolerance; the others serve as evidence of K and of the number of teams.
    exact: usize,
}

impl Known {
    /// Whether so many triplets are exact, and where there is time for it, the value behind them.
    fn suffices(self, dimension: usize, params: &EmbeddingParams) -> bool {
        let behind = usize::from(params.pace == Pace::AtRest);
        dimension + behind <= self.exact || self.exact == self.rank
    }
}

impl Decomposer {
    /// Takes what is known of the robots along to the next frame.
    pub(crate) fn carry(&mut self, robots: &Correspondence) {
        self.candidates.carry(robots);
    }

    /// The leading triplets of a frame. Those of the last frame serve if A* and the decay are the same bit
    /// for bit and they are exact and many enough.
    pub(crate) fn decompose(
        &mut self,
        similarity: &mut Similarity,
        task: Task<'_>,
        progress: &mut Progress<'_>,
    ) -> Result<Decomposition, MethodError> {
        let last = self.last.take();
        if task.fused.nodes() <= task.params.dense_robots {
            return self.whole(similarity, last, task, progress);
        }
        self.leading(similarity, last, task, progress)
    }

    /// The leading triplets without S.
    fn leading(
        &mut self,
        similarity: &mut Similarity,
        last: Option<Last>,
        task: Task<'_>,
        progress: &mut Progress<'_>,
    ) -> Result<Decomposition, MethodError> {
        let Task { fused, decay, robots, params, cut, counted } = task;
        let n = fused.nodes();
        progress(Step::SEARCH);
        if let Some(Last::Leading { alpha, known, report }) = last
            && alpha.to_bits() == decay.alpha.to_bits()
            && report.residual <= params.tolerance
            && known.rank >= cut.least_rank(n)
            && self.leading.compare(fused, robots) == Change::None
        {
            let teams = self.candidates.count(&self.leading.search, counted)?;
            let chosen = cut.of_leading(&self.leading.search, known.rank, teams.teams);
            if let Some(chosen) = chosen.filter(|chosen| !chosen.short)
                && known.suffices(chosen.dimension, params)
            {
                let (rank, mode) = (chosen.dimension, EmbeddingMode::Cached);
                let found = self.leading.found(rank, teams, report, mode)?;
                self.last = Some(Last::Leading { alpha, known, report });
                return Ok(found);
            }
        }
        let (tolerance, seed, threads) = (params.tolerance, params.seed, params.threads);
        let least = cut.least_rank(n).max(std::mem::take(&mut self.short_at)).min(n);
        let mut known = Known { rank: least, exact: cut.exact_rank(n).min(least) };
        // A search for more triplets may find them among those of the one before.
        let mut has_searched = false;
        // While robots move, one frame doubles the rank once: reports that are still to come join groups
        // that would each need a triplet, and the next frame goes on from there.
        let mut may_double = true;
        let mut evidence: Option<TeamEvidence> = None;
        let (chosen, teams, report) = loop {
            let Known { rank, exact } = known;
            let options = KatzSvdOptions { rank, exact: Some(exact), tolerance, seed, threads };
            let report = self.leading.search(task, options, progress)?;
            has_searched |= report.rounds > 0;
            if !report.converged && n <= params.dense_fallback_robots {
                self.leading.search.forget();
                return self.whole(similarity, None, task, progress);
            }
            // What the first search has found is evidence enough; a further one only adds digits.
            let teams = match evidence.take() {
                Some(teams) => teams,
                None => self.candidates.count(&self.leading.search, counted)?,
            };
            match cut.of_leading(&self.leading.search, rank, teams.teams) {
                Some(chosen) if chosen.short && may_double => {
                    may_double = params.pace == Pace::AtRest;
                    known.rank = (2 * rank).min(n);
                }
                Some(chosen) if known.suffices(chosen.dimension, params) => {
                    self.short_at = if chosen.short { rank } else { 0 };
                    break (chosen.dimension, teams, report);
                }
                Some(chosen) => {
                    let behind = usize::from(params.pace == Pace::AtRest);
                    known.exact = (chosen.dimension + behind).min(rank);
                }
                None => known.rank = (2 * rank).min(n),
            }
            evidence = Some(teams);
        };
        let mode = if has_searched { EmbeddingMode::InverseFree } else { EmbeddingMode::Updated };
        let found = self.leading.found(chosen, teams, report, mode)?;
        self.last = Some(Last::Leading { alpha: decay.alpha, known, report });
        Ok(found)
    }

    /// The decomposition of S as a whole: that of the last frame if S has not changed.
    fn whole(
        &mut self,
        similarity: &mut Similarity,
        last: Option<Last>,
        task: Task<'_>,
        progress: &mut Progress<'_>,
    ) -> Result<Decomposition, MethodError> {
        let Task { fused, decay, robots, params, cut, counted } = task;
        progress(Step::Katz);
        let Solved { matrix, origin, probe } = similarity.solve(fused, decay, robots, params)?;
        progress(Step::Svd);
        let kept = match last {
            Some(Last::Whole { fused: of, alpha, all })
                if alpha.to_bits() == decay.alpha.to_bits() && of == *fused =>
            {
                Some(all)
            }
            _ => None,
        };
        let (all, mode) = match (kept, origin) {
            (Some(all), Origin::Kept) => (all, EmbeddingMode::Cached),
            (_, Origin::Kept | Origin::Updated) => (full_svd(&matrix)?, EmbeddingMode::Updated),
            (_, Origin::Solved) => (full_svd(&matrix)?, EmbeddingMode::Dense),
        };
        let teams = self.candidates.count(&all, counted)?;
        let svd = all.truncate(cut.of_all(&all, teams.teams))?;
        if fused.nodes() <= params.cached_robots {
            self.last = Some(Last::Whole { fused: Arc::clone(fused), alpha: decay.alpha, all });
        }
        Ok(Decomposition {
            // No decomposition of S is more exact than S itself.
            residual: svd.residual(&matrix)?.max(probe),
            svd,
            teams,
            path: Path::Dense,
            mode,
            converged: true,
            complete: true,
            similarity: Some(matrix),
            probe: Some(probe),
        })
    }
}

/// How A* differs from that of the last frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Change {
    /// Not at all, and the robots are the same.
    None,
    /// In few rows, and the robots are the same.
    Rows,
    /// In many rows, or the robots are others.
    Much,
}

/// The leading triplets without S, from frame to frame.
#[derive(Debug, Default)]
pub struct LeadingTriplets {
    search: KatzSvd,
    /// A* of the last frame, and its robots.
    fused: Option<Arc<SparseMatrix>>,
    robots: Arc<[RobotId]>,
    changed: Vec<usize>,
}

impl LeadingTriplets {
    /// Finds the triplets of A* with its decay, beginning with those of the frame before. `watch` is called
    /// with each round of a search for which there was no frame before.
    ///
    /// Where the robots are the same, the rows of A* that have changed are found by comparing it with the one
    /// before, and handed to [`KatzSvd::solve_changed`] if they are few.
    ///
    /// # Errors
    /// [`KatzSvdError`]; the frames before are kept.
    pub fn advance(
        &mut self,
        fused: &Arc<SparseMatrix>,
        decay: &Decay,
        robots: &Arc<[RobotId]>,
        options: KatzSvdOptions,
        watch: &mut (dyn FnMut(SearchRound) + Send),
    ) -> Result<KatzSvdReport, KatzSvdError> {
        let (alpha, radius) = (decay.alpha, &decay.radius);
        let report = match self.compare(fused, robots) {
            Change::Rows => self.search.solve_changed(fused, alpha, radius, options, &self.changed),
            Change::None | Change::Much => {
                let between = Correspondence::between(&self.robots, robots);
                let to_old = between.as_ref().map(Correspondence::to_old);
                self.search.solve_with_progress(fused, alpha, radius, options, to_old, watch)
            }
        };
        if report.is_ok() {
            self.fused = Some(Arc::clone(fused));
            self.robots = Arc::clone(robots);
        }
        report
    }

    /// The `k` leading triplets that were found last.
    ///
    /// # Errors
    /// [`SvdError::Rank`] for more than are known.
    pub fn truncate(&self, k: usize) -> Result<RankKSvd, SvdError> {
        self.search.truncate(k)
    }

    /// Compares A* with that of the last frame; `changed` holds the rows that differ if they are few.
    fn compare(&mut self, fused: &Arc<SparseMatrix>, robots: &[RobotId]) -> Change {
        let Some(before) = self.fused.as_ref().filter(|before| before.nodes() == fused.nodes())
        else {
            return Change::Much;
        };
        if *self.robots != *robots {
            return Change::Much;
        }
        self.changed.clear();
        if Arc::ptr_eq(before, fused) {
            return Change::None;
        }
        let most = fused.nodes() / CHANGED_PART;
        before.differing_rows(fused, most, &mut self.changed);
        match self.changed.len() {
            0 => Change::None,
            count if count <= most => Change::Rows,
            _ => Change::Much,
        }
    }

    /// Searches as often as the effort allows.
    fn search(
        &mut self,
        task: Task<'_>,
        options: KatzSvdOptions,
        progress: &mut Progress<'_>,
    ) -> Result<KatzSvdReport, KatzSvdError> {
        let Task { fused, decay, robots, params, .. } = task;
        let n = fused.nodes();
        // At rest nobody waits for the next frame, and the vectors are to be exact.
        let is_waited_for = params.effort == Effort::OneFrame && params.pace == Pace::Moving;
        let is_limited = is_waited_for && n > params.dense_fallback_robots;
        self.search.limit_rounds(if is_limited { FRAME_ROUND_ROBOTS / n } else { usize::MAX });
        // Rounds of all searches together.
        let mut rounds = 0;
        let mut search = |leading: &mut Self| {
            let before = rounds;
            let mut watch = |found: SearchRound| {
                rounds = before + found.round;
                progress(Step::Search { round: rounds, open: found.open, rank: found.rank });
            };
            leading.advance(fused, decay, robots, options, &mut watch)
        };
        let mut report = search(self)?;
        // Where walks grow for long before they fade, one search has too few rounds.
        while params.effort == Effort::WhileItHelps && !report.converged {
            let last = report.residual;
            report = search(self)?;
            // Infinite residuals, of which none is smaller, end it too.
            if report.residual >= WORTHWHILE_SHARE * last || report.residual.is_nan() {
                break;
            }
        }
        Ok(report)
    }

    fn found(
        &self,
        rank: usize,
        teams: TeamEvidence,
        report: KatzSvdReport,
        mode: EmbeddingMode,
    ) -> Result<Decomposition, MethodError> {
        Ok(Decomposition {
            svd: self.search.truncate(rank)?,
            teams,
            path: Path::InverseFree,
            mode,
            residual: report.residual,
            converged: report.converged,
            complete: report.complete,
            similarity: None,
            probe: None,
        })
    }
}

#[cfg(test)]
mod tests {
    use muster_model::settings::Dimension;
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
        decomposer: Decomposer,
        similarity: Similarity,
    }

    impl Bench {
        fn get(&mut self, n: usize, chord: f64, alpha: f64) -> Decomposition {
            let fused = Arc::new(ring(n, chord));
            let radius = spectral_radius(&fused, None);
            let alpha = alpha / n as f64;
            assert!(alpha * radius.upper < 1.0);
            let params = EmbeddingParams {
                tolerance: 1e-8,
                seed: 7,
                dimension: Dimension::Fixed(6),
                teams: 2.into(),
                ..EmbeddingParams::default()
            };
            let counted =
                Counted { relations: &[], params: &params, alpha, previous: None, linked: &[] };
            let task = Task {
                fused: &fused,
                decay: &Decay { alpha, radius },
                robots: &names(n),
                params: &params,
                cut: &Cut::new(&params, &fused, None),
                counted,
            };
            self.decomposer.decompose(&mut self.similarity, task, &mut |_| {}).unwrap()
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
        let cold = Bench::default().get(20, 0.7, 0.5);
        assert_eq!(cold.mode, EmbeddingMode::Dense);
        for (updated, cold) in updated.svd.sigma.iter().zip(&cold.svd.sigma) {
            assert!((updated - cold).abs() < 1e-14);
        }
        assert!(updated.probe.unwrap() < 1e-14);
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
    fn the_search_goes_on_where_robots_join() {
        let mut bench = Bench::default();
        bench.get(90, 0.0, 0.5);
        assert_eq!(bench.get(92, 0.0, 0.5).mode, EmbeddingMode::InverseFree);
        assert_eq!(bench.get(20, 0.0, 0.5).mode, EmbeddingMode::Dense);
        assert_eq!(bench.get(90, 0.0, 0.5).mode, EmbeddingMode::InverseFree);
    }
}
