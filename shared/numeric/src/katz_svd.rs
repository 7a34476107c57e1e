//! Leading singular triplets of the Katz similarity from frame to frame, without the similarity.
//!
//! The full decomposition of S costs O(n³) however little of it is wanted. [`KatzSvd`] finds the leading
//! triplets from a few products with the sparse graph (see `partial`), and begins where the frames before
//! ended: while the graph moves little, the next triplets lie close to the last ones. Scratch space is kept
//! between frames.
//!
//! When only few rows of the graph have changed, which is found by comparing it with the one before or told
//! by the caller, the triplets and their residuals are brought up to date from those rows alone (see
//! `certificate`), and nothing is searched for while the residuals allow it.
//!
//! The residual of each triplet is measured, so that every answer comes with its own error bound. A
//! residual cannot reveal a triplet that is missing altogether; random directions that are added to
//! every [`PROBE_EVERY`]th frame find those.

mod certificate;
mod request;

use std::sync::OnceLock;

use crate::aligned::Aligned;
use crate::dimension::Spectrum;
use crate::matrix::{DenseMatrix, SparseMatrix};
use crate::operator::KatzOperator;
use crate::partial::{NULL, Request, Triplets, Workspace, leading_triplets, width_for};
use crate::share::{Parts, Strided, Threads};
use crate::spectral_radius::SpectralRadius;
use crate::svd::{RankKSvd, SvdError, fix_signs};
use crate::tall::{Block, product};
use certificate::Certificate;
use request::check;

pub use crate::partial::{SearchColumns, SearchRound, search_columns};
pub use request::{KatzSvdError, KatzSvdOptions, KatzSvdReport, MAX_EDGES};

/// How often random directions are added to those of the frames before: with every so many searches.
pub const PROBE_EVERY: u64 = 20;

/// Frames with few changes after which random directions are due as well, by a search if need be: a few
/// rows bring a new triplet to the front more rarely than all of them.
pub const PROBE_CHANGES: u64 = 500;

/// How many.
pub const PROBES: usize = 8;

/// Part of the rows up to which a change is followed row by row: 1 in so many. Beyond, a pass over
/// everything, which needs no bookkeeping, takes as long.
const FEW: usize = 8;

/// Changes after which all sums that are carried on are made anew: what rounding adds up to by then is
/// still far below every tolerance.
const RENEWED: u32 = 1000;

/// What part of the tolerance a search may leave when only few rows changed, so that the next changes can
/// be followed without another one.
const RESERVE: f64 = 0.2;

/// Rows that were replaced by longer or shorter ones, in which the kept graph is out of date. They are
/// looked at one by one each time, until copying the graph is cheaper.
const STALE: usize = 256;

/// Frames after which the order of the nodes is looked for anew: the graph has moved on.
const ORDER_FRAMES: u64 = 100;

/// Who is told of the rounds of a search.
type Watch<'a> = dyn FnMut(SearchRound) + Send + 'a;

/// What a search is for.
#[derive(Debug, Clone, Copy)]
struct Wanted<'a> {
    graph: &'a SparseMatrix,
    alpha: f64,
    options: KatzSvdOptions,
    previous: Option<&'a [Option<usize>]>,
}

/// The triplets of the last frame, with what the next one begins with.
#[derive(Debug)]
pub struct KatzSvd {
    operator: KatzOperator,
    work: Workspace,
    triplets: Triplets,
    /// W = V + UΣ of the last frame in the order of the operator, n × its width, which is 0 when the next
    /// one is to begin cold. That of the frame before it would spare one round in four of a smooth motion,
    /// and make each of them dearer by more.
    history: (Aligned<f64>, usize),
    threads: Threads,
    certificate: Certificate,
    /// Triplets in the range of the kept vectors, once they are asked for, when the certificate has turned
    /// them: V and S V, n × width.
    turned: OnceLock<[Vec<f64>; 2]>,
    /// The graph of the last frame, but for the rows `stale`, which the operator has, and those that `changed`.
    graph: SparseMatrix,
    stale: Vec<usize>,
    changed: Vec<usize>,
    alpha: f64,
    nodes: usize,
    /// How many triplets were asked for last.
    rank: usize,
    /// Searches so far.
    frames: u64,
    /// When random directions are due: at [`PROBE_CHANGES`].
    unprobed: u64,
    /// Whether the graph has changed since there were some.
    moved: bool,
}

impl Default for KatzSvd {
    fn default() -> Self {
        Self {
            operator: KatzOperator::default(),
            work: Workspace::default(),
            triplets: Triplets::default(),
            history: Default::default(),
            threads: Threads::default(),
            certificate: Certificate::default(),
            turned: OnceLock::new(),
            graph: SparseMatrix::empty(),
            stale: Vec::new(),
            changed: Vec::new(),
            alpha: 0.0,
            nodes: 0,
            rank: 0,
            frames: 0,
            unprobed: PROBE_CHANGES,
            moved: true,
        }
    }
}

impl KatzSvd {
    /// Finds the leading triplets for the graph `a`, whose radius is `radius`, and the decay `alpha`.
    ///
    /// `previous` names for each node its number in the frame before, none for one that is new; `None`
    /// means that the nodes are the same. Nothing is allocated while they are, and the rank and the number
    /// of threads, but for a new order of the nodes every hundred searches and for graphs with more edges
    /// than any before; more than one thread allocate a little for handing work over.
    ///
    /// # Errors
    /// [`KatzSvdError`]; the frames before are kept.
    pub fn solve(
        &mut self,
        a: &SparseMatrix,
        alpha: f64,
        radius: &SpectralRadius,
        options: KatzSvdOptions,
        previous: Option<&[Option<usize>]>,
    ) -> Result<KatzSvdReport, KatzSvdError> {
        self.solve_watched(a, alpha, radius, options, previous, &mut |_| {})
    }

    /// [`KatzSvd::solve`], with word of each round of the search for whoever waits.
    ///
    /// # Errors
    /// As [`KatzSvd::solve`].
    pub fn solve_watched(
        &mut self,
        a: &SparseMatrix,
        alpha: f64,
        radius: &SpectralRadius,
        options: KatzSvdOptions,
        previous: Option<&[Option<usize>]>,
        watch: &mut Watch<'_>,
    ) -> Result<KatzSvdReport, KatzSvdError> {
        check(a, alpha, radius, options)?;
        let follows = previous.is_none() && self.follows(a, alpha, options);
        self.take_nodes(a.nodes(), previous)?;
        self.threads.start(options.threads);
        self.rank = options.rank;
        let mut current = false;
        if follows {
            let most = self.few();
            self.changed.clear();
            self.graph.differing_rows(a, most, &mut self.changed);
            if self.changed.len() <= most {
                self.changed.extend_from_slice(&self.stale);
                if let Some(report) = self.bring_up_to_date(a, options) {
                    return Ok(report);
                }
                current = true;
            }
        }
        let wanted = Wanted { graph: a, alpha, options, previous };
        Ok(self.search(wanted, current, watch))
    }

    /// [`KatzSvd::solve`] for a graph with the same nodes as the one before, for callers who know which of
    /// its rows may have changed: all others must be the same bit for bit. Takes no look at those.
    ///
    /// # Errors
    /// As [`KatzSvd::solve`], and [`KatzSvdError::Changed`] for a row that the graph does not have.
    pub fn solve_changed(
        &mut self,
        a: &SparseMatrix,
        alpha: f64,
        radius: &SpectralRadius,
        options: KatzSvdOptions,
        changed: &[usize],
    ) -> Result<KatzSvdReport, KatzSvdError> {
        check(a, alpha, radius, options)?;
        if let Some(&row) = changed.iter().find(|row| **row >= a.nodes()) {
            return Err(KatzSvdError::Changed { row, nodes: a.nodes() });
        }
        let follows = self.follows(a, alpha, options);
        self.take_nodes(a.nodes(), None)?;
        self.threads.start(options.threads);
        self.rank = options.rank;
        let mut current = false;
        if follows && changed.len() <= self.few() {
            self.changed.clear();
            self.changed.extend_from_slice(changed);
            if let Some(report) = self.bring_up_to_date(a, options) {
                return Ok(report);
            }
            current = true;
        }
        let wanted = Wanted { graph: a, alpha, options, previous: None };
        Ok(self.search(wanted, current, &mut |_| {}))
    }

    /// Whether triplets and graph of the frame before are of use for bringing up to date.
    fn follows(&self, a: &SparseMatrix, alpha: f64, options: KatzSvdOptions) -> bool {
        self.nodes == a.nodes()
            && self.graph.nodes() == a.nodes()
            && self.alpha.to_bits() == alpha.to_bits()
            && self.triplets.finite
            && self.history.1 == width_for(options.rank)
            && self.unprobed < PROBE_CHANGES
    }

    /// Rows that are few.
    fn few(&self) -> usize {
        self.nodes / FEW
    }

    /// The triplets after a change of the rows that `changed` names, without a search. `None` when their
    /// residuals are too large; the operator is up to date in any case.
    fn bring_up_to_date(
        &mut self,
        a: &SparseMatrix,
        options: KatzSvdOptions,
    ) -> Option<KatzSvdReport> {
        // In order, so that sums do not depend on who found the rows.
        self.changed.sort_unstable();
        self.changed.dedup();
        let Self { operator, work, triplets, history, threads, certificate, .. } = self;
        certificate.replace_rows(operator, a, &self.changed);
        let changed = certificate.has_changes();
        self.moved |= changed;
        self.unprobed += match (changed, self.moved) {
            (true, _) => 1,
            // Nothing to do is an opportunity.
            (false, true) => PROBE_CHANGES / PROBE_EVERY,
            (false, false) => 0,
        };
        if operator.has_grown() {
            // Random directions find what no old one leads to.
            self.unprobed = PROBE_CHANGES;
            return None;
        }
        if changed {
            let (w, width) = &*history;
            let worn = certificate.updates >= RENEWED || operator.scattered();
            if operator.scattered() {
                operator.assign(a, self.alpha, true, 1);
            }
            let vectors = work.spare();
            let sums_hold = if certificate.valid && !worn {
                certificate.update(operator, w, triplets, vectors)
            } else {
                debug_assert_eq!(*width, triplets.width);
                let parts = Parts::new(self.nodes, threads.count());
                threads.run(|| certificate.renew(operator, parts, w, triplets, vectors))
            };
            self.turned = OnceLock::new();
            self.keep_rows(a);
            if !sums_hold {
                return None;
            }
        }
        let report = self.report(options, 0);
        report.converged.then_some(report)
    }

    /// Brings the kept graph up to date where that is cheap.
    fn keep_rows(&mut self, a: &SparseMatrix) {
        for &row in &self.changed {
            if !self.graph.copy_row(a, row) {
                self.stale.push(row);
            }
        }
        self.stale.sort_unstable();
        self.stale.dedup();
        if self.stale.len() > STALE {
            self.graph.copy_from(a);
            self.stale.clear();
        }
    }

    /// Finds the triplets anew, beginning with those of the frames before. `current` says that the operator
    /// is up to date.
    fn search(
        &mut self,
        wanted: Wanted<'_>,
        current: bool,
        watch: &mut Watch<'_>,
    ) -> KatzSvdReport {
        // All of it within the threads: going in and out takes them as long as a small graph does.
        let threads = std::mem::take(&mut self.threads);
        let report = threads.run(|| self.search_within(wanted, current, threads.count(), watch));
        self.threads = threads;
        report
    }

    fn search_within(
        &mut self,
        wanted: Wanted<'_>,
        current: bool,
        threads: usize,
        watch: &mut Watch<'_>,
    ) -> KatzSvdReport {
        let Wanted { graph, alpha, options, .. } = wanted;
        let reordered = self.frames.is_multiple_of(ORDER_FRAMES);
        if !current || reordered {
            self.assign(wanted, threads);
        } else {
            self.graph.copy_from(graph);
        }
        self.operator.settle();
        self.alpha = alpha;
        self.stale.clear();
        self.certificate.valid = false;
        self.turned = OnceLock::new();
        let probed = self.unprobed + PROBE_CHANGES / PROBE_EVERY > PROBE_CHANGES;
        let request = Request {
            rank: options.rank,
            tolerance: options.tolerance * if current { RESERVE } else { 1.0 },
            probes: if probed { PROBES } else { 0 },
            seed: options.seed.wrapping_add(self.frames),
            threads,
        };
        let Self { operator, work, triplets, history, .. } = self;
        let start = (&*history.0, history.1);
        leading_triplets(operator, request, start, work, triplets, watch);
        self.unprobed = if probed { 0 } else { self.unprobed + PROBE_CHANGES / PROBE_EVERY };
        self.moved = !probed;
        self.remember(threads);
        self.report(options, self.triplets.rounds)
    }

    fn report(&self, options: KatzSvdOptions, rounds: usize) -> KatzSvdReport {
        let residuals = self.triplets.residuals.iter().take(options.rank);
        let residual = residuals.fold(0.0, |top: f64, residual| residual.max(top));
        KatzSvdReport { rounds, residual, converged: residual <= options.tolerance }
    }

    /// V and S V in the order of the operator, n × width.
    fn vectors(&self) -> (&[f64], &[f64]) {
        let Triplets { width, right, image, .. } = &self.triplets;
        if !self.certificate.valid {
            return (right, image);
        }
        let [right, image] = self.turned.get_or_init(|| {
            let rotation = Block::new(&self.certificate.rotation, *width, *width);
            [right, image].map(|block| {
                let mut turned = vec![0.0; block.len()];
                product(Block::new(block, *width, *width), rotation, &mut turned, *width, 0);
                turned
            })
        });
        (right, image)
    }

    /// Singular values, descending: those that were asked for, and some more that are less exact.
    #[must_use]
    pub fn all_singular_values(&self) -> &[f64] {
        &self.triplets.sigma
    }

    /// The `k` leading triplets in the caller's order, with the signs of [`crate::svd::full_svd`]. Vectors
    /// of values below 1e-7 σ₁ are set to zero: they cannot be told from the null space. So are the rows of
    /// nodes without an edge, where the search leaves as much as the tolerance allows.
    ///
    /// # Errors
    /// [`SvdError::Rank`] unless 1 ≤ k ≤ the number of [`KatzSvd::all_singular_values`].
    pub fn truncate(&self, k: usize) -> Result<RankKSvd, SvdError> {
        let Triplets { width, sigma, .. } = &self.triplets;
        let nodes = sigma.len();
        if k == 0 || k > nodes {
            return Err(SvdError::Rank { rank: k, nodes });
        }
        let cut = NULL * sigma[0];
        let inner = self.operator.inner();
        let (right, image) = self.vectors();
        let at = |i: usize, j: usize| inner[i] as usize * width + j;
        let isolated = |i: usize| self.operator.is_isolated(inner[i] as usize);
        let mut svd = RankKSvd {
            u: DenseMatrix::from_fn(self.nodes, k, |i, j| {
                if sigma[j] > cut && !isolated(i) { image[at(i, j)] / sigma[j] } else { 0.0 }
            }),
            sigma: sigma[..k].to_vec(),
            v: DenseMatrix::from_fn(self.nodes, k, |i, j| {
                if sigma[j] > cut && !isolated(i) { right[at(i, j)] } else { 0.0 }
            }),
            sigma_next: sigma.get(k).copied(),
        };
        fix_signs(&mut svd.u, &mut svd.v);
        Ok(svd)
    }

    /// Forgets the frames before: the next solve begins cold.
    pub fn forget(&mut self) {
        self.history.1 = 0;
        self.frames = 0;
        self.unprobed = PROBE_CHANGES;
    }

    /// Refuses a correspondence that does not fit, and forgets frames of other nodes.
    fn take_nodes(
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

    /// Brings the operator, the history with it, and the kept graph to the nodes and the weights of a new
    /// frame.
    fn assign(&mut self, wanted: Wanted<'_>, threads: usize) {
        let Wanted { graph: a, alpha, previous, .. } = wanted;
        let keep_order = previous.is_none() && !self.frames.is_multiple_of(ORDER_FRAMES);
        let before = if keep_order { Vec::new() } else { self.operator.inner().to_vec() };
        let (operator, graph) = (&mut self.operator, &mut self.graph);
        operator.assign(a, alpha, keep_order, threads);
        graph.copy_from(a);
        if keep_order || (previous.is_none() && before == self.operator.inner()) {
            return;
        }
        let (block, stride) = (&mut self.history.0, self.history.1);
        let mut moved = Aligned::default();
        moved.resize(self.nodes * stride);
        let rows = moved.chunks_exact_mut(stride.max(1));
        for (to, &outer) in rows.zip(self.operator.outer()) {
            let old = previous.map_or(Some(outer as usize), |old| old[outer as usize]);
            if let Some(inner) = old.map(|old| before[old] as usize) {
                to.copy_from_slice(&block[inner * stride..(inner + 1) * stride]);
            }
        }
        *block = moved;
    }

    /// Keeps W = V + UΣ for the next frame.
    fn remember(&mut self, threads: usize) {
        self.frames += 1;
        if !self.triplets.finite {
            self.forget();
            return;
        }
        let Triplets { width, right, image, .. } = &self.triplets;
        let (block, kept) = &mut self.history;
        *kept = *width;
        block.resize(self.nodes * width);
        let parts = Parts::new(self.nodes, threads);
        parts.run(Strided(block, *width), |rows, block| {
            let own = rows.start * width..rows.end * width;
            let sums = right[own.clone()].iter().zip(&image[own]);
            for (to, (right, image)) in block.0.iter_mut().zip(sums) {
                *to = right + image;
            }
        });
    }
}

impl Spectrum for KatzSvd {
    fn nodes(&self) -> usize {
        self.nodes
    }

    /// Those that were asked for.
    fn singular_values(&self) -> &[f64] {
        &self.triplets.sigma[..self.rank.min(self.triplets.sigma.len())]
    }

    fn noise(&self) -> f64 {
        NULL * self.triplets.sigma.first().copied().unwrap_or(0.0)
    }

    fn squared_share(&self, i: usize, j: usize) -> f64 {
        let Triplets { width, sigma, .. } = &self.triplets;
        let (right, image) = self.vectors();
        let at = self.operator.inner()[i] as usize * width + j;
        if sigma[j] <= self.noise() {
            return 0.0;
        }
        image[at].powi(2) / sigma[j] + right[at].powi(2) * sigma[j]
    }
}
