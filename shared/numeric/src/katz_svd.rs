//! Leading singular triplets of the Katz similarity from frame to frame, without the similarity.
//!
//! The full decomposition of S costs O(n³) however little of it is wanted. [`KatzSvd`] finds the leading
//! triplets from a few products with the sparse graph (see `partial`), and begins where the frames before
//! ended: while the graph moves smoothly, the next triplets lie close to what the last two frames span,
//! with an error of second order in the motion. Scratch space is kept between frames.
//!
//! The residual of each triplet is measured, so that every answer comes with its own error bound. A
//! residual cannot reveal a triplet that is missing altogether; random directions that are added to
//! every [`PROBE_EVERY`]th frame find those.

use thiserror::Error;

use crate::dimension::Spectrum;
use crate::katz::KatzError;
use crate::matrix::{DenseMatrix, SparseMatrix};
use crate::operator::KatzOperator;
use crate::partial::{NULL, Request, Triplets, Workspace, leading_triplets};
use crate::spectral_radius::SpectralRadius;
use crate::svd::{RankKSvd, SvdError, fix_signs};

/// How often random directions are added to those of the frames before.
pub const PROBE_EVERY: u64 = 20;

/// How many.
pub const PROBES: usize = 8;

/// Frames after which the order of the nodes is looked for anew: the graph has moved on.
const ORDER_FRAMES: u64 = 100;

/// What is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KatzSvdOptions {
    /// How many triplets, from 1 to n.
    pub rank: usize,
    /// Largest residual ‖Mᵀ(Sᵀu − σv)‖/σ₁ with M = I − αA, above 0. ‖Sᵀu − σv‖ is at most 1 + σ₁ times
    /// as large, and S v − σu is zero but for rounding.
    pub tolerance: f64,
    /// Seed of the random directions.
    pub seed: u64,
}

/// Why no triplets could be computed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum KatzSvdError {
    /// The decay is no positive number, or α ρ is not certified to be below 1.
    #[error(transparent)]
    Katz(#[from] KatzError),
    /// The rank is 0 or above the number of nodes.
    #[error(transparent)]
    Rank(#[from] SvdError),
    /// The tolerance is not a positive number.
    #[error("tolerance {0} is not a positive number")]
    Tolerance(f64),
    /// The correspondence with the frame before does not have one entry per node, or names a node
    /// that the frame before did not have.
    #[error("the correspondence with the frame before does not fit {nodes} nodes")]
    Correspondence {
        /// Nodes of the graph.
        nodes: usize,
    },
}

/// How a solve went.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KatzSvdReport {
    /// Rounds of the search.
    pub rounds: usize,
    /// The largest residual among the triplets that were asked for, as in [`KatzSvdOptions::tolerance`].
    pub residual: f64,
    /// Whether that is within the tolerance. If not, S is to be decomposed whole.
    pub converged: bool,
}

/// The triplets of the last frame, with what the next one begins with.
#[derive(Debug, Default)]
pub struct KatzSvd {
    operator: KatzOperator,
    work: Workspace,
    triplets: Triplets,
    /// W = V + UΣ of the last two frames in the caller's order, the newest first, each n × its width.
    history: [(Vec<f64>, usize); 2],
    /// The same in the order of the operator.
    start: [Vec<f64>; 2],
    nodes: usize,
    /// How many triplets were asked for last.
    rank: usize,
    frames: u64,
}

impl KatzSvd {
    /// Finds the leading triplets for the graph `a`, whose radius is `radius`, and the decay `alpha`.
    ///
    /// `previous` names for each node its number in the frame before, none for one that is new; `None`
    /// means that the nodes are the same. Nothing of the size of the graph is allocated while these
    /// stay the same in number.
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
        let n = a.nodes();
        check(n, alpha, radius, options)?;
        self.take_over(n, previous)?;
        self.rank = options.rank;
        let same_order = previous.is_none() && !self.frames.is_multiple_of(ORDER_FRAMES);
        self.operator.assign(a, alpha, same_order);
        let start = self.start();
        let request = Request {
            rank: options.rank,
            tolerance: options.tolerance,
            probes: if self.frames.is_multiple_of(PROBE_EVERY) { PROBES } else { 0 },
            seed: options.seed.wrapping_add(self.frames),
        };
        let blocks: Vec<(&[f64], usize)> =
            self.start.iter().zip(start).map(|(block, width)| (block.as_slice(), width)).collect();
        leading_triplets(&self.operator, request, &blocks, &mut self.work, &mut self.triplets);
        self.remember();
        let residuals = self.triplets.residuals.iter().take(options.rank);
        Ok(KatzSvdReport {
            rounds: self.triplets.rounds,
            residual: residuals.fold(0.0, |top, residual| residual.max(top)),
            converged: self.triplets.converged,
        })
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
        let Triplets { width, right, image, sigma, .. } = &self.triplets;
        let nodes = sigma.len();
        if k == 0 || k > nodes {
            return Err(SvdError::Rank { rank: k, nodes });
        }
        let cut = NULL * sigma[0];
        let inner = self.operator.inner();
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
        for (block, width) in &mut self.history {
            block.clear();
            *width = 0;
        }
        self.frames = 0;
    }

    /// Brings the history to the nodes of the new frame.
    fn take_over(
        &mut self,
        n: usize,
        previous: Option<&[Option<usize>]>,
    ) -> Result<(), KatzSvdError> {
        let Some(previous) = previous else {
            if n != self.nodes {
                self.forget();
            }
            self.nodes = n;
            return Ok(());
        };
        let fits = |old: &Option<usize>| old.is_none_or(|old| old < self.nodes);
        if previous.len() != n || !previous.iter().all(fits) {
            return Err(KatzSvdError::Correspondence { nodes: n });
        }
        for (block, width) in &mut self.history {
            let moved = previous.iter().flat_map(|old| {
                let row = old.map(|old| &block[old * *width..(old + 1) * *width]);
                (0..*width).map(move |c| row.map_or(0.0, |row| row[c]))
            });
            *block = moved.collect();
        }
        self.nodes = n;
        Ok(())
    }

    /// Puts the history into the order of the operator; the widths of its blocks.
    fn start(&mut self) -> [usize; 2] {
        let mut widths = [0; 2];
        let blocks = self.start.iter_mut().zip(&self.history).zip(&mut widths);
        for ((start, (block, width)), taken) in blocks {
            start.clear();
            if *width == 0 {
                continue;
            }
            for &outer in self.operator.outer() {
                start.extend_from_slice(&block[outer as usize * width..][..*width]);
            }
            *taken = *width;
        }
        widths
    }

    fn remember(&mut self) {
        self.frames += 1;
        if !self.triplets.right.iter().chain(&self.triplets.image).all(|value| value.is_finite()) {
            self.forget();
            return;
        }
        self.history.swap(0, 1);
        let width = self.triplets.width;
        let (block, kept) = &mut self.history[0];
        *kept = width;
        block.resize(self.nodes * width, 0.0);
        for (to, &inner) in block.chunks_exact_mut(width.max(1)).zip(self.operator.inner()) {
            let row = inner as usize * width..(inner as usize + 1) * width;
            let sums = self.triplets.right[row.clone()].iter().zip(&self.triplets.image[row]);
            for (to, (right, image)) in to.iter_mut().zip(sums) {
                *to = right + image;
            }
        }
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
        let Triplets { width, right, image, sigma, .. } = &self.triplets;
        let at = self.operator.inner()[i] as usize * width + j;
        if sigma[j] <= self.noise() {
            return 0.0;
        }
        image[at].powi(2) / sigma[j] + right[at].powi(2) * sigma[j]
    }
}

fn check(
    n: usize,
    alpha: f64,
    radius: &SpectralRadius,
    options: KatzSvdOptions,
) -> Result<(), KatzSvdError> {
    if !(alpha.is_finite() && alpha > 0.0) {
        return Err(KatzError::Alpha(alpha).into());
    }
    if alpha * radius.upper >= 1.0 {
        return Err(KatzError::Diverges { alpha, radius: radius.upper }.into());
    }
    if options.rank == 0 || options.rank > n {
        return Err(SvdError::Rank { rank: options.rank, nodes: n }.into());
    }
    if !(options.tolerance.is_finite() && options.tolerance > 0.0) {
        return Err(KatzSvdError::Tolerance(options.tolerance));
    }
    Ok(())
}
