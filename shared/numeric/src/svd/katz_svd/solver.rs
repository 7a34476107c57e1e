//! The search for leading triplets, and their update after changes of few rows.

use std::sync::OnceLock;

use super::certificate::Certificate;
use super::error::{KatzSvdError, check};
use super::options::KatzSvdOptions;
use super::probe::{Known, MAX_LOCAL_NODES, Probe};
use crate::linalg::Aligned;
use crate::linalg::matrix::SparseMatrix;
use crate::linalg::parallel::{Parts, Strided, Threads};
use crate::radius::exact::SpectralRadius;
use crate::svd::davidson::{
    MAX_ROUNDS, NULL_VALUE_RATIO, Request, SearchRound, Triplets, Workspace, leading_triplets,
    width_for,
};
use crate::svd::operator::{KatzOperator, Orientation};

/// Steps of the probe in a row that find nothing, after which nothing is missing as far as it can
/// tell: a direction at random turns to a strong group within four to six.
pub const PROBE_STEPS: u32 = 6;

/// What a round of a search adds to the means of the probe.
const ROUND_MEANS: u32 = 16;

/// What an update adds to them: it takes a small part of the time of a round.
const UPDATE_MEANS: u32 = 1;

/// What a step of the probe takes from them. A step costs as much as a round or less, so that steps
/// add at most a twelfth to the time of all searches.
const STEP_MEANS: u32 = 12 * ROUND_MEANS;

/// Most means: for the steps in a row that follow an abrupt change. While nothing is suspected, a step
/// is taken only where so much is there.
const MOST_MEANS: u32 = 3 * STEP_MEANS;

/// What a look at a part of the graph takes, times the nodes of the graph: it takes as long in a large
/// one, of which a round takes longer; and the most that it takes.
const LOOK_MEANS_NODES: usize = 60_000;
const MOST_LOOK_MEANS: usize = 300;

/// Searches of one frame: each one that the probe asks for begins with what it has found.
const FRAME_SEARCHES: usize = 3;

/// Rows that have grown most since the last frame, which are looked at together with their
/// neighbours.
const GROWN_ROWS: usize = 16;

/// Growth of a row since it was last looked at, relative to the heaviest one, that is looked at again.
const ABRUPT_GROWTH: f64 = 0.05;

/// One row in this many may change for an update row by row. Beyond that, a pass over all rows,
/// which needs no bookkeeping, takes as long.
const CHANGED_ROW_SHARE: usize = 8;

/// Updates after which all incremental sums are recomputed; accumulated rounding is still far
/// below every tolerance.
const MAX_SUM_UPDATES: u32 = 1000;

/// Factor of the tolerance of a search when only few rows changed, so that the next changes need
/// no search.
const UPDATE_TOLERANCE_FACTOR: f64 = 0.2;

/// Rows that were replaced by longer or shorter ones and are out of date in the kept graph. They
/// are compared one by one in each frame, until copying the graph is cheaper.
const MAX_STALE_ROWS: usize = 256;

/// Searches after which the nodes are ordered again, as the graph has changed.
const REORDER_SEARCHES: u64 = 100;

/// How a solve went.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KatzSvdReport {
    /// Rounds of the search; 0 when the triplets of the previous frame were updated instead.
    pub rounds: usize,
    /// Largest residual of the triplets that had to be exact, as in [`KatzSvdOptions::tolerance`]: no
    /// ‖Sᵀu − σv‖/σ₁ is larger. [`crate::svd::RankKSvd::angle_bound`] turns it into a bound for the
    /// subspaces.
    pub residual: f64,
    /// True when the residual is within the tolerance. If not, decompose the whole of S.
    pub converged: bool,
    /// True when no stronger triplet is missing as far as probes can tell: [`PROBE_STEPS`] of them in
    /// a row have found none, or the search began cold; no row has grown by more than a twentieth of
    /// the heaviest one since; and the triplets have converged. Until then the gap and the angles hold
    /// for the known triplets only.
    pub complete: bool,
}

/// Receives each finished round of a search.
type Progress<'a> = dyn FnMut(SearchRound) + Send + 'a;

/// Input of one solve.
#[derive(Debug, Clone, Copy)]
struct Input<'a> {
    graph: &'a SparseMatrix,
    alpha: f64,
    options: KatzSvdOptions,
    previous: Option<&'a [Option<usize>]>,
}

/// The triplets of the last frame, and the start of the next search.
#[derive(Debug, Default)]
pub struct KatzSvd {
    pub(super) operator: KatzOperator,
    work: Workspace,
    pub(super) triplets: Triplets,
    start: Start,
    threads: Threads,
    pub(super) certificate: Certificate,
    /// V and S V, n × width, rotated by the certificate; computed on demand.
    pub(super) rotated: OnceLock<[Vec<f64>; 2]>,
    /// The graph of the last frame, except for the rows `stale`, which only the operator has, and
    /// the rows `changed`.
    graph: SparseMatrix,
    stale: Vec<usize>,
    changed: Vec<usize>,
    alpha: f64,
    pub(super) nodes: usize,
    /// Number of triplets that were last asked for.
    pub(super) rank: usize,
    /// Searches so far.
    searches: u64,
    /// Rounds of a frame after which its search ends, if they are limited.
    most_rounds: Option<usize>,
    probe: Probe,
    /// Steps of the probe in a row that have found nothing.
    quiet: u32,
    /// What the probe may still cost.
    means: u32,
    grown: Grown,
    /// Growth of rows since the last step of the probe, and since the last look: the sum of the largest
    /// of each frame, in which no row has grown by more.
    drift: f64,
    unseen: f64,
}

/// W = V + UΣ of the last frame in the order of the operator, n × `width`. The W of the frame
/// before it would save one round in four of a smooth motion, and add more to each of them.
#[derive(Debug, Default)]
struct Start {
    directions: Aligned<f64>,
    /// 0 for a cold start.
    width: usize,
}

/// Rows that have grown abruptly.
#[derive(Debug, Default)]
struct Grown {
    /// Those that have grown most, with their growth.
    most: Vec<(f64, usize)>,
    /// All of them.
    count: usize,
    /// The largest growth of any row, abrupt or not.
    largest: f64,
    /// Least sum of each row of αA since it was last looked at, in the order of the caller.
    levels: Vec<f64>,
}

impl Grown {
    fn clear(&mut self) {
        self.most.clear();
        (self.count, self.largest) = (0, 0.0);
    }

    fn insert(&mut self, growth: f64, row: usize) {
        self.count += 1;
        let place = self.most.partition_point(|(other, _)| *other >= growth);
        if place < GROWN_ROWS {
            self.most.truncate(GROWN_ROWS - 1);
            self.most.insert(place, (growth, row));
        }
    }
}

impl Start {
    /// Replaces a column.
    fn replace(&mut self, place: usize, values: impl Iterator<Item = f64>) {
        for (row, value) in self.directions.chunks_exact_mut(self.width).zip(values) {
            row[place] = value;
        }
    }

    /// Replaces the last column by one that is zero except for some nodes.
    fn replace_weakest(&mut self, values: impl Iterator<Item = (usize, f64)>) {
        let place = self.width - 1;
        self.replace(place, std::iter::repeat(0.0));
        for (node, value) in values {
            self.directions[node * self.width + place] = value;
        }
    }
}

impl KatzSvd {
    /// Computes the leading triplets for the graph `a`, its spectral radius `radius`, and the decay
    /// `alpha`.
    ///
    /// `previous` holds for each node its index in the previous frame, `None` for a new one;
    /// without it the nodes are the same. While nodes, rank and number of threads stay, nothing is
    /// allocated, except for a new order of the nodes every hundred searches, for more edges than
    /// ever before, and for the distribution of work when there is more than one thread.
    ///
    /// # Errors
    /// [`KatzSvdError`]; the state of the previous frame stays.
    pub fn solve(
        &mut self,
        a: &SparseMatrix,
        alpha: f64,
        radius: &SpectralRadius,
        options: KatzSvdOptions,
        previous: Option<&[Option<usize>]>,
    ) -> Result<KatzSvdReport, KatzSvdError> {
        self.solve_with_progress(a, alpha, radius, options, previous, &mut |_| {})
    }

    /// Ends the search of each frame after so many rounds, at least 1 and in any case after some hundred. Triplets that
    /// have not converged by then are those that have come nearest, and the next frame begins with them.
    pub fn limit_rounds(&mut self, most: usize) {
        self.most_rounds = Some(most.max(1));
    }

    /// [`KatzSvd::solve`] that reports each round of the search.
    ///
    /// # Errors
    /// As [`KatzSvd::solve`].
    pub fn solve_with_progress(
        &mut self,
        a: &SparseMatrix,
        alpha: f64,
        radius: &SpectralRadius,
        options: KatzSvdOptions,
        previous: Option<&[Option<usize>]>,
        progress: &mut (dyn FnMut(SearchRound) + Send),
    ) -> Result<KatzSvdReport, KatzSvdError> {
        let options = *check(a, alpha, radius, options)?.get();
        let mut follows = previous.is_none() && self.follows(a, alpha, options);
        self.accept_nodes(a.nodes(), previous)?;
        if follows {
            let most = self.most_changed_rows();
            self.changed.clear();
            self.graph.differing_rows(a, most, &mut self.changed);
            follows = self.changed.len() <= most;
            self.changed.extend_from_slice(&self.stale);
        }
        let input = Input { graph: a, alpha, options, previous };
        Ok(self.update_or_search(input, follows, progress))
    }

    /// [`KatzSvd::solve`] for a graph with the nodes of the previous frame, whose rows are bit for
    /// bit the same except for some of those in `changed`. Does not compare the others.
    ///
    /// # Errors
    /// As [`KatzSvd::solve`], and [`KatzSvdError::Changed`] for a row beyond the graph.
    pub fn solve_changed(
        &mut self,
        a: &SparseMatrix,
        alpha: f64,
        radius: &SpectralRadius,
        options: KatzSvdOptions,
        changed: &[usize],
    ) -> Result<KatzSvdReport, KatzSvdError> {
        let options = *check(a, alpha, radius, options)?.get();
        if let Some(&row) = changed.iter().find(|row| **row >= a.nodes()) {
            return Err(KatzSvdError::Changed { row, nodes: a.nodes() });
        }
        let follows = self.follows(a, alpha, options) && changed.len() <= self.most_changed_rows();
        self.accept_nodes(a.nodes(), None)?;
        self.changed.clear();
        self.changed.extend_from_slice(changed);
        let input = Input { graph: a, alpha, options, previous: None };
        Ok(self.update_or_search(input, follows, &mut |_| {}))
    }

    /// True when triplets and graph of the previous frame can be updated.
    fn follows(&self, a: &SparseMatrix, alpha: f64, options: KatzSvdOptions) -> bool {
        self.nodes == a.nodes()
            && self.graph.nodes() == a.nodes()
            && self.alpha.to_bits() == alpha.to_bits()
            && self.triplets.finite
            && self.start.width == width_for(options.rank)
    }

    /// Changed rows up to which an update row by row pays.
    fn most_changed_rows(&self) -> usize {
        self.nodes / CHANGED_ROW_SHARE
    }

    /// Updates the triplets if the input `follows` the previous frame except for the rows
    /// `changed`, and searches where that is not enough.
    fn update_or_search(
        &mut self,
        input: Input<'_>,
        follows: bool,
        progress: &mut Progress<'_>,
    ) -> KatzSvdReport {
        self.threads.start(input.options.threads);
        self.rank = input.options.rank;
        if follows && let Some(report) = self.update(input.graph, input.options) {
            return report;
        }
        // Going into the threads and out of them takes as long as a small search, so do it once.
        let threads = std::mem::take(&mut self.threads);
        let report = threads.run(|| self.search(input, follows, threads.count(), progress));
        self.threads = threads;
        report
    }

    /// The triplets after a change of the rows `changed`, without a search. `None` when their
    /// residuals are too large; the operator is up to date in any case.
    fn update(&mut self, a: &SparseMatrix, options: KatzSvdOptions) -> Option<KatzSvdReport> {
        // Sorted, so that sums do not depend on who found the rows.
        self.changed.sort_unstable();
        self.changed.dedup();
        let Self { operator, work, triplets, start, threads, certificate, .. } = self;
        certificate.replace_rows(operator, a, &self.changed);
        let changed = certificate.has_changes();
        if changed {
            let recompute = !certificate.valid
                || certificate.updates >= MAX_SUM_UPDATES
                || operator.scattered();
            if operator.scattered() {
                operator.assign(a, self.alpha, true, 1);
            }
            let (w, vectors) = (&*start.directions, work.scratch());
            let sums_hold = if recompute {
                debug_assert_eq!(start.width, triplets.width);
                let parts = Parts::new(self.nodes, threads.count());
                threads.run(|| certificate.recompute(operator, parts, w, triplets, vectors))
            } else {
                certificate.update(operator, w, triplets, vectors)
            };
            self.rotated = OnceLock::new();
            self.keep_rows(a);
            if !sums_hold {
                return None;
            }
        }
        if changed {
            self.gain(UPDATE_MEANS);
        } else if !self.is_sure() {
            // A frame without changes leaves time.
            self.gain(STEP_MEANS);
        }
        if changed && self.finds_locally(options) {
            return None;
        }
        if !self.report(options, 0).converged {
            return None;
        }
        if self.may_step(options) && self.finds_by_step(options) {
            return None;
        }
        Some(self.report(options, 0))
    }

    /// Adds to the means of the probe.
    fn gain(&mut self, means: u32) {
        self.means = self.means.saturating_add(means).min(MOST_MEANS);
    }

    /// Takes so much from the means of the probe, if they are there.
    fn spend(&mut self, means: u32) -> bool {
        let rest = self.means.checked_sub(means);
        self.means = rest.unwrap_or(self.means);
        rest.is_some()
    }

    /// True when a step of the probe is due, which its means then have paid for. Where the known
    /// triplets have become weaker than what was found outside of them, it is due in any case.
    fn may_step(&mut self, options: KatzSvdOptions) -> bool {
        if self.is_whole() {
            return false;
        }
        let suspects = self.probe.strongest() > self.threshold(options);
        let needed = if self.is_sure() { MOST_MEANS } else { STEP_MEANS };
        let due = suspects || self.means >= needed;
        if due {
            self.means = self.means.saturating_sub(STEP_MEANS);
        }
        due
    }

    /// True when the probe has long found nothing, and no row has grown much since its last step.
    fn is_sure(&self) -> bool {
        self.quiet >= PROBE_STEPS && self.drift <= self.abrupt_growth()
    }

    fn abrupt_growth(&self) -> f64 {
        ABRUPT_GROWTH * self.operator.heaviest()
    }

    /// True when a part of the graph may be looked at, which the means then have paid for.
    fn may_look(&mut self) -> bool {
        let means = LOOK_MEANS_NODES.div_ceil(self.nodes.max(1)).min(MOST_LOOK_MEANS);
        self.spend(means as u32)
    }

    /// The known triplets, for the probe.
    fn known<'a>(triplets: &'a Triplets, certificate: &'a Certificate) -> Known<'a> {
        let Triplets { width, right, image, sigma, .. } = triplets;
        let rotation = certificate.valid.then_some(&certificate.rotation[..]);
        Known { right, image, width: *width, rotation, sigma }
    }

    /// Singular values from this one on would be among those that are asked for.
    fn threshold(&self, options: KatzSvdOptions) -> f64 {
        let sigma = &self.triplets.sigma;
        let at = |place: usize| sigma.get(place).copied().unwrap_or(f64::INFINITY);
        // The known values are exact to the tolerance.
        at(options.rank - 1) + (options.tolerance + NULL_VALUE_RATIO) * at(0)
    }

    /// True when all nodes fit the known triplets: nothing can be missing then.
    fn is_whole(&self) -> bool {
        self.nodes <= self.triplets.width
    }

    /// Looks at the rows that have changed and their neighbours, if rows have grown enough since the
    /// last look. True when a triplet is missing there; the next search begins with it.
    fn finds_locally(&mut self, options: KatzSvdOptions) -> bool {
        self.drift += self.operator.growth();
        self.unseen += self.operator.growth();
        if self.is_whole() || self.unseen <= self.abrupt_growth() {
            return false;
        }
        self.unseen = 0.0;
        if self.certificate.touched().count() > MAX_LOCAL_NODES || !self.may_look() {
            self.quiet = 0;
            return false;
        }
        let threshold = self.threshold(options);
        let Self { operator, triplets, certificate, probe, start, .. } = self;
        let value =
            probe.look_at(operator, certificate.touched(), Self::known(triplets, certificate));
        if value > threshold {
            start.replace_weakest(probe.local_direction());
            self.quiet = 0;
        }
        value > threshold
    }

    /// One step of the probe. True when a triplet is missing; the next search begins with it.
    fn finds_by_step(&mut self, options: KatzSvdOptions) -> bool {
        let threshold = self.threshold(options);
        let threads = std::mem::take(&mut self.threads);
        let parts = Parts::new(self.nodes, threads.count());
        let found = threads.run(|| self.step(options, parts, threshold));
        self.threads = threads;
        found
    }

    /// The same, within the pool.
    fn step(&mut self, options: KatzSvdOptions, parts: Parts, threshold: f64) -> bool {
        let Self { operator, triplets, certificate, probe, start, work, .. } = self;
        let known = Self::known(triplets, certificate);
        let values = probe.measure(operator, parts, known, options.seed);
        let found = values.first().is_some_and(|value| *value > threshold);
        // While the sums belong to the start, it must stay as it is unless a search follows.
        if found || !certificate.valid {
            let weakest = (options.rank..start.width.min(triplets.sigma.len())).rev();
            let stronger = weakest.zip(values.iter().copied().enumerate());
            let stronger =
                stronger.take_while(|(place, (_, value))| *value > triplets.sigma[*place]);
            let count = stronger.count();
            for j in 0..count {
                start.replace(start.width.min(triplets.sigma.len()) - 1 - j, probe.direction(j));
            }
        }
        probe.advance(operator, parts, work);
        // What a cold search has found counts until rows have grown; then only steps of the probe do.
        let most = if self.drift > self.abrupt_growth() { self.probe.steps() } else { PROBE_STEPS };
        self.drift = 0.0;
        self.quiet = if found { 0 } else { (self.quiet + 1).min(most) };
        found
    }

    /// Finds the rows of αA that have grown most since the last frame, whose nodes are the same, or since
    /// they were last looked at.
    fn find_grown(&mut self, a: &SparseMatrix, alpha: f64) {
        self.grown.clear();
        if self.grown.levels.len() != a.nodes() {
            self.grown.levels.clear();
            self.grown.levels.resize(a.nodes(), f64::INFINITY);
        }
        let least = ABRUPT_GROWTH * self.operator.heaviest();
        for i in 0..a.nodes() {
            let growth = a.row_growth(i, alpha, &self.graph, self.alpha);
            self.grown.largest = self.grown.largest.max(growth);
            let sum = alpha * a.row_sum(i);
            let level = &mut self.grown.levels[i];
            *level = level.min(sum);
            let growth = growth.max(sum - *level);
            if growth > least {
                self.grown.insert(growth, i);
            }
        }
    }

    /// Looks at the rows that have grown most, with the triplets of the last frame, and lets the
    /// search begin with what is stronger there than the weakest of them.
    /// `is_comparable` while nodes and their order are those of the last frame.
    fn look_at_grown(&mut self, is_comparable: bool) {
        if self.grown.count == 0 {
            return;
        }
        if self.grown.count > GROWN_ROWS {
            self.quiet = 0;
        }
        if !self.may_look() {
            self.quiet = 0;
            return;
        }
        let Self { operator, triplets, certificate, probe, start, grown, .. } = self;
        for (_, row) in &grown.most {
            grown.levels[*row] = f64::INFINITY;
        }
        let rows = grown.most.iter().map(|(_, i)| operator.inner()[*i]);
        let nodes = rows.flat_map(|i| {
            let ends = |orientation| operator.row(orientation, i as usize).0.iter().copied();
            [i].into_iter().chain(ends(Orientation::Forward)).chain(ends(Orientation::Backward))
        });
        // Vectors in another order are of no use here: what is known is then found again.
        let known = if is_comparable { Self::known(triplets, certificate) } else { Known::NONE };
        let value = probe.look_at(operator, nodes, known);
        if triplets.sigma.last().is_some_and(|last| value > *last) {
            start.replace_weakest(probe.local_direction());
        }
    }

    /// Finds the heaviest rows of new nodes.
    fn find_new(&mut self, a: &SparseMatrix, previous: &[Option<usize>]) {
        self.grown.clear();
        let before = std::mem::take(&mut self.grown.levels);
        let level = |old: &Option<usize>| old.and_then(|old| before.get(old).copied());
        self.grown.levels.extend(previous.iter().map(|old| level(old).unwrap_or(f64::INFINITY)));
        for (i, _) in previous.iter().enumerate().filter(|(_, old)| old.is_none()) {
            self.grown.insert(a.row(i).map(|(_, weight)| weight).sum(), i);
        }
    }

    /// Copies the changed rows into the kept graph where that is cheap.
    fn keep_rows(&mut self, a: &SparseMatrix) {
        for &row in &self.changed {
            if !self.graph.copy_row(a, row) {
                self.stale.push(row);
            }
        }
        self.stale.sort_unstable();
        self.stale.dedup();
        if self.stale.len() > MAX_STALE_ROWS {
            self.graph.copy_from(a);
            self.stale.clear();
        }
    }

    /// Searches for the triplets, starting from those of the previous frame. `is_current` when the
    /// operator is up to date.
    fn search(
        &mut self,
        input: Input<'_>,
        is_current: bool,
        threads: usize,
        progress: &mut Progress<'_>,
    ) -> KatzSvdReport {
        let Input { graph, alpha, options, previous } = input;
        let reorders = previous.is_some() || self.searches.is_multiple_of(REORDER_SEARCHES);
        let is_cold = self.start.width == 0;
        let is_next = !is_cold && !reorders && self.triplets.finite && !self.is_whole();
        if !is_current && is_next && self.start.width == width_for(options.rank) {
            self.find_grown(graph, alpha);
            self.assign(input, threads);
            self.drift += self.grown.largest;
            self.look_at_grown(true);
        } else if !is_current || reorders {
            self.assign(input, threads);
            if let Some(previous) = previous.filter(|_| !is_cold) {
                // Those who left may have been what was known.
                self.quiet = 0;
                self.find_new(graph, previous);
                self.look_at_grown(false);
            }
        } else {
            self.graph.copy_from(graph);
        }
        self.alpha = alpha;
        self.stale.clear();
        self.certificate.valid = false;
        self.rotated = OnceLock::new();
        let parts = Parts::new(self.nodes, threads);
        let mut rounds = 0;
        for _ in 0..FRAME_SEARCHES {
            let factor = if is_current { UPDATE_TOLERANCE_FACTOR } else { 1.0 };
            let left = self.most_rounds.map_or(MAX_ROUNDS, |most| most.saturating_sub(rounds));
            if left == 0 {
                break;
            }
            let request = Request {
                rank: options.rank,
                exact: options.exact(),
                tolerance: options.tolerance * factor,
                most_rounds: left.min(MAX_ROUNDS),
                seed: options.seed.wrapping_add(self.searches),
                threads,
            };
            let Self { operator, work, triplets, start, .. } = self;
            let first = (&*start.directions, start.width);
            leading_triplets(operator, request, first, work, triplets, progress);
            rounds += self.triplets.rounds;
            self.keep_start(threads);
            if is_cold {
                // It began with more random directions than there are triplets.
                self.quiet = if self.triplets.converged { PROBE_STEPS } else { 0 };
                self.means = MOST_MEANS;
                (self.drift, self.unseen) = (0.0, 0.0);
                self.grown.levels.clear();
                self.grown.most.reserve(GROWN_ROWS);
                self.probe.reserve(self.nodes, self.triplets.width);
            }
            self.gain(ROUND_MEANS * self.triplets.rounds as u32);
            if is_cold || !self.triplets.finite || !self.may_step(options) {
                break;
            }
            let threshold = self.threshold(options);
            if !self.step(options, parts, threshold) {
                break;
            }
        }
        self.searches += u64::from(self.triplets.finite);
        self.report(options, rounds)
    }

    fn report(&self, options: KatzSvdOptions, rounds: usize) -> KatzSvdReport {
        let residuals = self.triplets.residuals.iter().take(options.exact());
        let residual = residuals.fold(0.0, |top: f64, residual| residual.max(top));
        let converged = residual <= options.tolerance;
        let complete = converged && (self.is_sure() || self.is_whole());
        KatzSvdReport { rounds, residual, converged, complete }
    }

    /// Discards the previous frames: the next solve starts cold.
    pub fn forget(&mut self) {
        self.start.width = 0;
        self.searches = 0;
        self.quiet = 0;
        self.probe.forget();
    }

    /// Refuses a correspondence that does not fit, and discards frames of other nodes.
    fn accept_nodes(
        &mut self,
        n: usize,
        previous: Option<&[Option<usize>]>,
    ) -> Result<(), KatzSvdError> {
        match previous {
            None if n != self.nodes => self.forget(),
            None => {}
            Some(previous) => {
                let fits = |old: &Option<usize>| old.is_none_or(|old| old < self.nodes);
                if previous.len() != n || !previous.iter().all(fits) {
                    return Err(KatzSvdError::Correspondence { nodes: n });
                }
            }
        }
        self.nodes = n;
        Ok(())
    }

    /// Brings the operator, the start with it, and the kept graph to the nodes and the weights of
    /// a new frame.
    fn assign(&mut self, input: Input<'_>, threads: usize) {
        let Input { graph: a, alpha, previous, .. } = input;
        let keep_order = previous.is_none() && !self.searches.is_multiple_of(REORDER_SEARCHES);
        let before = if keep_order { Vec::new() } else { self.operator.inner().to_vec() };
        self.operator.assign(a, alpha, keep_order, threads);
        self.graph.copy_from(a);
        if keep_order || (previous.is_none() && before == self.operator.inner()) {
            return;
        }
        let Start { directions, width } = &mut self.start;
        let width = *width;
        let mut moved = Aligned::default();
        moved.resize(self.nodes * width);
        let rows = moved.chunks_exact_mut(width.max(1));
        for (to, &outer) in rows.zip(self.operator.outer()) {
            let old = previous.map_or(Some(outer as usize), |old| old[outer as usize]);
            if let Some(inner) = old.map(|old| before[old] as usize) {
                to.copy_from_slice(&directions[inner * width..(inner + 1) * width]);
            }
        }
        *directions = moved;
        let outer = self.operator.outer();
        self.probe.rearrange(self.nodes, |i| {
            let old = previous.map_or(Some(outer[i] as usize), |old| old[outer[i] as usize]);
            old.map(|old| before[old] as usize)
        });
    }

    /// Keeps W = V + UΣ for the next frame.
    fn keep_start(&mut self, threads: usize) {
        if !self.triplets.finite {
            self.forget();
            return;
        }
        let Triplets { width, right, image, .. } = &self.triplets;
        let directions = &mut self.start.directions;
        self.start.width = *width;
        directions.resize(self.nodes * width);
        let parts = Parts::new(self.nodes, threads);
        parts.run(Strided(directions, *width), |rows, block| {
            let own = rows.start * width..rows.end * width;
            let sums = right[own.clone()].iter().zip(&image[own]);
            for (to, (right, image)) in block.0.iter_mut().zip(sums) {
                *to = right + image;
            }
        });
    }
}
