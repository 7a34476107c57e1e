//! The leading singular triplets of the Katz similarity S, without S and without any inverse.
//!
//! Write V = M W with M = I − αA. Since S = αA M⁻¹ = M⁻¹ αA, S V = αA W and W = V + S V: the
//! Rayleigh–Ritz method on the range of V needs only one product with a sparse matrix, and is
//! exact. The residual of a right vector costs one more, Mᵀ(Sᵀu − σv) = αAᵀ(u + σv) − σv. A
//! polynomial in single precision approximates the best next direction, (MᵀM)⁻¹ times that
//! residual; its quality decides the number of rounds, not the accuracy. Where no polynomial is near
//! enough, as walks grow for long before they fade, a sparse factorisation of M takes its place. This is a block Davidson
//! method (Davidson, J. Comput. Phys. 17, 1975) for SᵀS that uses the structure of the Katz
//! similarity. A search that begins with nothing gets its start and its directions from the symmetric
//! part of the graph instead, where that says enough (see `symmetric`).

mod basis;
mod factors;
mod polynomial;
mod symmetric;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::linalg::Aligned;
use crate::linalg::block_vectors::{BlockView, CHUNK_ROWS, COLUMN_MULTIPLE, product};
use crate::linalg::parallel::{Parts, Strided};
use crate::linalg::simd::dispatch;
use crate::linalg::single_block::SINGLE_COLUMN_MULTIPLE;
use crate::svd::katz_svd::ROUGH_TOLERANCE;
use crate::svd::operator::KatzOperator;
use basis::Basis;
use factors::Factors;
use polynomial::{FIT_COLUMNS, Polynomial, to_double};
use symmetric::SymmetricPart;

/// Vectors that are carried in addition to the wanted ones: the convergence of the last wanted one
/// depends on the gap to the first that is not carried.
const EXTRA_VECTORS: usize = 8;

/// Rounds of new directions that fit the search space before it restarts with the best vectors.
/// More of them save rounds but make each one dearer: by products of the length of the graph, and
/// by the small eigenproblem, which dominates for graphs of up to [`SMALL_NODES`] nodes.
const SPACE_ROUNDS: usize = 2;

/// [`SPACE_ROUNDS`] for small graphs.
const SMALL_SPACE_ROUNDS: usize = 1;

/// Most nodes of a small graph.
const SMALL_NODES: usize = 2048;

/// Rounds after which the space grows, for the search to tell close neighbours in σ apart: most
/// searches end before.
const GROWTH_ROUND: usize = 20;

/// Rounds of new directions that fit the space once it has grown. Neighbours in σ that are 1e-6 σ₁
/// apart then take some sixty rounds; with two they take more than 600.
const GROWN_SPACE_ROUNDS: usize = 6;

/// Memory by which the space may grow. Graphs of a hundred thousand nodes need less.
const MAX_GROWTH_BYTES: usize = 1 << 28;

/// Rounds after which M is factorised, as the polynomial is too far from its inverse.
const FACTOR_ROUND: usize = 60;

/// Rounds after which the search gives up.
pub(crate) const MAX_ROUNDS: usize = 300;

/// Values up to this fraction of the largest count as zero, and their vectors are ignored: their
/// squares vanish in the rounding of the square of the largest.
pub(crate) const NULL_VALUE_RATIO: f64 = 1e-7;

/// Nodes from which, and triplets up to which, a search that begins with nothing begins with the
/// symmetric part of the graph. Smaller searches take no longer than its small eigenproblems.
const MIN_SYMMETRIC_NODES: usize = 400;
const MAX_SYMMETRIC_RANK: usize = 64;

/// The same for a graph that is symmetric, relative to the carried vectors: there the search ends soon.
const MIN_SYMMETRIC_WIDTHS: usize = 4;

/// Part of its residual that a round with the symmetric part may leave, twice in a row, before the
/// polynomial takes its place.
const STALLED_SHARE: f64 = 0.5;

/// Residual below which a column yields no direction.
const SPENT_RESIDUAL: f64 = 1e-14;

/// Input of a search.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Request {
    /// Number of triplets.
    pub(crate) rank: usize,
    /// How many of them have to reach the tolerance; the others have [`ROUGH_TOLERANCE`].
    pub(crate) exact: usize,
    /// Largest of [`Triplets::residuals`].
    pub(crate) tolerance: f64,
    /// Rounds after which the search ends, converged or not; at most [`MAX_ROUNDS`].
    pub(crate) most_rounds: usize,
    /// Seed of the random directions.
    pub(crate) seed: u64,
    /// Number of threads of the pool around the search, 1 without one.
    pub(crate) threads: usize,
}

impl Request {
    /// Largest residual of the triplet at a place.
    fn tolerance_of(&self, place: usize) -> f64 {
        if place < self.exact { self.tolerance } else { self.tolerance.max(ROUGH_TOLERANCE) }
    }
}

/// Progress of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SearchRound {
    /// Number of the finished round, from 1.
    pub round: usize,
    /// Triplets that are not yet within the tolerance.
    pub open: usize,
    /// Triplets that are wanted.
    pub rank: usize,
}

/// Triplets in the inner order of the operator, in rows of `width` values.
#[derive(Debug, Default)]
pub(crate) struct Triplets {
    /// Values in a row, a multiple of [`COLUMN_MULTIPLE`]; those beyond the wanted rank are less
    /// exact, and those beyond the number of values are zero.
    pub(crate) width: usize,
    /// Right vectors V, n × width.
    pub(crate) right: Aligned<f64>,
    /// S V = U Σ, n × width.
    pub(crate) image: Aligned<f64>,
    /// Singular values, descending.
    pub(crate) sigma: Vec<f64>,
    /// A bound of ‖Sᵀu − σv‖ of each, relative to σ₁: (1 + σ₁) ‖Mᵀ(Sᵀu − σv)‖/σ₁, as ‖M⁻ᵀ‖ = ‖I + S‖.
    pub(crate) residuals: Vec<f64>,
    /// Number of rounds.
    pub(crate) rounds: usize,
    /// True when all wanted triplets are within the tolerance.
    pub(crate) converged: bool,
    /// True when all vectors are finite.
    pub(crate) finite: bool,
}

/// Scratch space, reused from frame to frame.
#[derive(Debug, Default)]
pub(crate) struct Workspace {
    basis: Basis,
    polynomial: Polynomial,
    /// Factors of M, where a search needs them.
    factors: Option<Factors>,
    symmetric: SymmetricPart,
    /// U + V Σ, later the new directions, n × carried.
    block: Aligned<f64>,
    /// Residuals and their images under the polynomial.
    single: [Aligned<f32>; 3],
    sums: Vec<f64>,
    /// σ and 1/σ of all columns.
    sigma: Vec<f64>,
    inverse: Vec<f64>,
    /// Columns that need a direction.
    open: Vec<usize>,
}

impl Workspace {
    /// Scratch space for two blocks of as many vectors as the last triplets have. The next search
    /// overwrites it.
    pub(crate) fn scratch(&mut self) -> &mut [f64] {
        &mut self.basis.space
    }

    /// Writes approximately (MᵀM)⁻¹ r to `out` for the n × `width` block r, after a search for at
    /// least as many vectors of the same graph or a similar one.
    pub(crate) fn precondition(
        &mut self,
        operator: &KatzOperator,
        parts: Parts,
        r: &[f64],
        out: &mut [f64],
        width: usize,
    ) {
        if !self.polynomial.serves(operator) {
            let mut scratch = vec![0.0; operator.nodes() * FIT_COLUMNS];
            self.polynomial.fit(operator, parts, 0, &mut scratch, &mut self.sums);
        }
        let stride = width.next_multiple_of(SINGLE_COLUMN_MULTIPLE);
        let rows = self.single[0].chunks_exact_mut(stride).zip(r.chunks_exact(width));
        for (to, from) in rows {
            let (to, padding) = to.split_at_mut(width);
            padding.fill(0.0);
            for (to, from) in to.iter_mut().zip(from) {
                *to = *from as f32;
            }
        }
        self.apply(operator, parts, out, width);
    }

    /// The same for the residuals in the first of the blocks in single precision.
    fn apply(&mut self, operator: &KatzOperator, parts: Parts, out: &mut [f64], width: usize) {
        let Self { polynomial, factors, single, .. } = self;
        let stride = width.next_multiple_of(SINGLE_COLUMN_MULTIPLE);
        match factors {
            Some(factors) => factors.apply(&single[0], stride, out, width),
            None => polynomial.apply(operator, parts, single, out, width),
        }
    }
}

/// Columns of the blocks of a search, each of one double per node: for estimates of memory and
/// time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SearchColumns {
    /// Vectors that are carried from round to round: the wanted ones and a few more.
    pub carried: usize,
    /// Directions that fit the space; as many images.
    pub space: usize,
    /// The same once the space has grown, as it does where the search is long.
    pub grown: usize,
}

/// Columns of a search for `rank` triplets of a graph of `nodes` nodes.
#[must_use]
pub fn search_columns(nodes: usize, rank: usize) -> SearchColumns {
    let carried = width_for(rank);
    let rounds = if nodes <= SMALL_NODES { SMALL_SPACE_ROUNDS } else { SPACE_ROUNDS };
    let space = carried + rounds * rank.next_multiple_of(SINGLE_COLUMN_MULTIPLE);
    SearchColumns { carried, space, grown: space.max(grown_space(nodes, rank, carried)) }
}

/// Directions that fit the space of a search for `rank` triplets once it has grown.
fn grown_space(nodes: usize, rank: usize, carried: usize) -> usize {
    let columns = rank.next_multiple_of(SINGLE_COLUMN_MULTIPLE);
    // V and S V.
    let round_bytes = 2 * size_of::<f64>() * nodes * columns;
    let grown = carried + GROWN_SPACE_ROUNDS.min(MAX_GROWTH_BYTES / round_bytes.max(1)) * columns;
    // More directions than nodes would depend on one another.
    grown.min(nodes / COLUMN_MULTIPLE * COLUMN_MULTIPLE)
}

/// Values in a row of the triplets for a wanted rank.
pub(crate) fn width_for(rank: usize) -> usize {
    (rank + EXTRA_VECTORS).next_multiple_of(COLUMN_MULTIPLE)
}

/// Leading triplets of the Katz similarity of `operator`.
///
/// `start` holds initial directions W, n × p in rows, p a multiple of [`COLUMN_MULTIPLE`], in the
/// inner order of the operator: V + UΣ of a similar graph, for example. Random ones fill the rest.
pub(crate) fn leading_triplets(
    operator: &KatzOperator,
    request: Request,
    start: (&[f64], usize),
    work: &mut Workspace,
    out: &mut Triplets,
    progress: &mut (dyn FnMut(SearchRound) + Send),
) {
    let n = operator.nodes();
    let width = width_for(request.rank);
    let parts = Parts::new(n, request.threads);
    // The rounding error along the space grows with the inverse square of the length that is left
    // of a direction; keep it below a millionth of the tolerance.
    let least_length = (2e-8 / request.tolerance).sqrt().clamp(0.003, 0.3);
    let guided = false;
    let mut search = Search { operator, request, n, width, parts, least_length, guided, work };
    search.reserve(out, start.1 == 0);
    search.begin(start);
    search.run(out, progress);
    // Later searches begin with triplets.
    search.work.symmetric = SymmetricPart::default();
}

struct Search<'a> {
    operator: &'a KatzOperator,
    request: Request,
    n: usize,
    /// Vectors that a restart keeps; length of the rows.
    width: usize,
    parts: Parts,
    /// Length that must be left of every new unit direction, orthogonal to the space and to the
    /// other ones, for rounding to keep the orthogonality.
    least_length: f64,
    /// True while the symmetric part of the graph leads the search.
    guided: bool,
    work: &'a mut Workspace,
}

impl Search<'_> {
    fn reserve(&mut self, out: &mut Triplets, is_cold: bool) {
        let (n, width) = (self.n, self.width);
        let work = &mut *self.work;
        let capacity = search_columns(n, self.request.rank).space;
        work.basis.prepare(n, capacity, FIT_COLUMNS.max(2 * width));
        for buffer in [&mut work.block, &mut out.right, &mut out.image] {
            buffer.resize(n * width);
        }
        for buffer in &mut work.single {
            buffer.resize(n * width.next_multiple_of(SINGLE_COLUMN_MULTIPLE));
        }
        out.width = width;
        work.factors = None;
        let fits = n >= MIN_SYMMETRIC_NODES
            || (n >= MIN_SYMMETRIC_WIDTHS * width && self.operator.is_symmetric());
        self.guided = is_cold
            && self.request.rank <= MAX_SYMMETRIC_RANK
            && fits
            && work.symmetric.prepare(self.operator, self.parts, width, self.request.seed);
        if !self.guided {
            self.fit();
        }
    }

    /// Fits the polynomial, or factorises M where there is none; the space is overwritten.
    fn fit(&mut self) {
        let Workspace { basis, polynomial, sums, .. } = &mut *self.work;
        polynomial.fit(self.operator, self.parts, self.request.seed, &mut basis.space, sums);
        self.work.factors =
            self.work.polynomial.is_poor().then(|| Factors::new(self.operator)).flatten();
    }

    /// True when the symmetric part has led the search to all triplets, as far as is known.
    fn sees_all(&mut self, out: &Triplets) -> bool {
        let Workspace { symmetric, single, .. } = &mut *self.work;
        let last = self.request.rank.min(out.sigma.len()).checked_sub(1);
        last.is_some_and(|last| {
            let (sigma, seed) = (out.sigma[last], self.request.seed);
            !symmetric.hides(self.operator, self.parts, sigma, seed, single)
        })
    }

    /// Goes on with the polynomial, and the best triplets.
    fn lose_guide(&mut self, out: &Triplets) {
        self.guided = false;
        let size = self.work.basis.size;
        self.fit();
        self.work.basis.size = size;
        self.restart(out);
    }

    /// Makes room for more directions between two restarts, and restarts with the best triplets.
    fn grow(&mut self, out: &Triplets) {
        let capacity = grown_space(self.n, self.request.rank, self.width);
        if capacity > self.work.basis.stride {
            let size = self.work.basis.size;
            self.work.basis.prepare(self.n, capacity, FIT_COLUMNS.max(2 * self.width));
            self.work.basis.size = size;
            self.restart(out);
        }
    }

    fn begin(&mut self, (block, stride): (&[f64], usize)) {
        let columns = stride.min(self.width);
        if columns > 0 {
            self.expand(block, stride, columns);
        } else if self.guided {
            let mut block = std::mem::take(&mut self.work.block);
            let symmetric = &self.work.symmetric;
            to_double(symmetric.vectors(), symmetric.width(), &mut block, self.width);
            self.expand(&block, self.width, self.width);
            self.work.block = block;
        }
        let missing = self.width.saturating_sub(self.work.basis.size);
        let columns = missing.next_multiple_of(COLUMN_MULTIPLE).min(self.width).min(self.room());
        if columns > 0 {
            let mut block = std::mem::take(&mut self.work.block);
            let mut rng = ChaCha8Rng::seed_from_u64(self.request.seed);
            block[..self.n * columns].fill_with(|| rng.random::<f64>() - 0.5);
            self.expand(&block, columns, columns);
            self.work.block = block;
        }
    }

    /// Columns that still fit the space, a multiple of [`COLUMN_MULTIPLE`].
    fn room(&self) -> usize {
        let basis = &self.work.basis;
        (basis.stride - basis.size) / COLUMN_MULTIPLE * COLUMN_MULTIPLE
    }

    fn run(&mut self, out: &mut Triplets, progress: &mut (dyn FnMut(SearchRound) + Send)) {
        out.rounds = 0;
        let mut plain = false;
        let (mut before, mut stalled) = (f64::INFINITY, 0);
        loop {
            out.rounds += 1;
            if !self.ritz(out) {
                out.converged = false;
                return;
            }
            if self.guided && out.rounds == 1 && !self.sees_all(out) {
                // Begin again at random, so that nothing is missed.
                self.guided = false;
                self.work.basis.discard();
                self.fit();
                self.begin((&[], 0));
                continue;
            }
            self.residuals(out);
            let rank = self.request.rank.min(out.sigma.len());
            // NaN counts as open.
            let within = (0..rank).filter(|c| out.residuals[*c] <= self.request.tolerance_of(*c));
            let open = rank - within.count();
            out.converged = open == 0;
            progress(SearchRound { round: out.rounds, open, rank });
            let whole = self.work.basis.size >= self.n;
            if out.converged || out.rounds >= self.request.most_rounds || whole {
                return;
            }
            match out.rounds {
                GROWTH_ROUND => self.grow(out),
                FACTOR_ROUND if self.work.factors.is_none() => {
                    self.work.factors = Factors::new(self.operator);
                }
                _ => {}
            }
            if self.guided {
                let worst = out.residuals[..rank].iter().fold(0.0, |top: f64, r| r.max(top));
                stalled = if worst <= STALLED_SHARE * before { 0 } else { stalled + 1 };
                before = worst;
                if stalled == 2 {
                    self.lose_guide(out);
                }
            }
            let wanted = self.choose(out);
            if self.work.basis.error > self.request.tolerance {
                self.renew(out);
            } else if wanted.next_multiple_of(COLUMN_MULTIPLE) > self.room() {
                self.restart(out);
            }
            let columns = wanted.min(self.room());
            let width = columns.next_multiple_of(COLUMN_MULTIPLE);
            if columns == 0 {
                return;
            }
            let mut block = std::mem::take(&mut self.work.block);
            let directions = &mut block[..self.n * width];
            if self.guided {
                let Workspace { symmetric, single, open, .. } = &mut *self.work;
                let stride = width.next_multiple_of(SINGLE_COLUMN_MULTIPLE);
                let sigma: Vec<f64> = open.iter().map(|c| out.sigma[*c]).collect();
                symmetric.correct(self.parts, &sigma, single, stride);
                to_double(&single[2][..self.n * stride], stride, directions, width);
            } else if plain {
                let stride = width.next_multiple_of(SINGLE_COLUMN_MULTIPLE);
                to_double(&self.work.single[0][..self.n * stride], stride, directions, width);
            } else {
                self.work.apply(self.operator, self.parts, directions, width);
            }
            let kept = self.expand(directions, width, columns);
            self.work.block = block;
            if kept == 0 && self.guided {
                self.lose_guide(out);
                continue;
            }
            if kept == 0 {
                // Weights may span more magnitudes than single precision does; use the plain
                // residuals then.
                if plain {
                    return;
                }
                plain = true;
            }
        }
    }

    /// Adds the first `columns` of the directions W, rows of `stride` values, to the space. Returns
    /// the number of independent ones.
    fn expand(&mut self, w: &[f64], stride: usize, columns: usize) -> usize {
        let operator = self.operator;
        let width = columns.next_multiple_of(COLUMN_MULTIPLE);
        let fill = |rows, space: &mut [f64], image: &mut [f64], to_stride, first| {
            operator.map_directions(rows, w, stride, width, space, image, to_stride, first);
        };
        self.work.basis.add(self.parts, columns, width, self.least_length, fill)
    }

    /// Computes the best triplets of the space, and U + VΣ into the block. False when they are not
    /// finite.
    fn ritz(&mut self, out: &mut Triplets) -> bool {
        let width = self.width;
        let Workspace { basis, block, sigma, inverse, .. } = &mut *self.work;
        let count = width.min(basis.size);
        out.sigma.clear();
        sigma.clear();
        sigma.resize(width, 0.0);
        if count == 0 || !basis.ritz(count, width) {
            out.sigma.resize(width.min(self.n), 0.0);
            out.residuals.clear();
            out.residuals.resize(out.sigma.len(), f64::INFINITY);
            out.finite = false;
            return false;
        }
        for (sigma, value) in sigma.iter_mut().zip(&basis.values) {
            *sigma = value.max(0.0).sqrt();
        }
        out.sigma.extend_from_slice(&sigma[..width.min(self.n)]);
        let null = NULL_VALUE_RATIO * sigma[0];
        inverse.clear();
        inverse.extend(sigma.iter().map(|s| if *s > null { 1.0 / s } else { 0.0 }));
        let (stride, size) = (basis.stride, basis.size);
        let coefficients = BlockView::new(&basis.coefficients, width, width);
        let vectors = (Strided(&mut out.right, width), Strided(&mut out.image, width));
        let (space, image) = basis.vectors();
        let blocks = (vectors.0, vectors.1, Strided(block, width));
        self.parts.run(blocks, |rows, (right, own_image, block)| {
            let own = rows.start * stride..rows.end * stride;
            product(
                BlockView::new(&space[own.clone()], stride, size),
                coefficients,
                right.0,
                width,
                0,
            );
            product(BlockView::new(&image[own], stride, size), coefficients, own_image.0, width, 0);
            combine(right.0, own_image.0, sigma, inverse, block.0);
        });
        true
    }

    /// Computes the residuals of all triplets, in single precision, and their lengths.
    fn residuals(&mut self, out: &mut Triplets) {
        let width = self.width;
        let operator = self.operator;
        let Workspace { block, single, sums, sigma, .. } = &mut *self.work;
        let stride = width.next_multiple_of(SINGLE_COLUMN_MULTIPLE);
        let top = sigma[0];
        let scale = if top > 0.0 { 1.0 / top } else { 0.0 };
        let (block, right, sigma) = (&*block, &*out.right, &*sigma);
        let residual = Strided(&mut single[0][..self.n * stride], stride);
        self.parts.sum(sums, width, residual, |rows, residual, sums| {
            operator.residual(rows, block, right, sigma, scale, residual.0, stride, sums);
        });
        // A value of V or S V that is not finite makes a residual so too.
        out.finite = sums[..width].iter().all(|sum| sum.is_finite());
        let null = NULL_VALUE_RATIO * top;
        out.residuals.clear();
        let bound = (1.0 + top) * scale;
        let relative = |(square, sigma): (&f64, &f64)| {
            if *sigma > null { square.sqrt() * bound } else { 0.0 }
        };
        out.residuals.extend(sums.iter().zip(&out.sigma).map(relative));
    }

    /// Moves the residuals that need directions to the front, and returns their number.
    fn choose(&mut self, out: &Triplets) -> usize {
        let request = self.request;
        let tolerance = |c: usize| request.tolerance_of(c);
        let Workspace { single, open, .. } = &mut *self.work;
        let residuals = &out.residuals;
        // Vectors beyond the wanted rank get directions only to fill registers.
        let count = residuals.len().min(self.request.rank.next_multiple_of(SINGLE_COLUMN_MULTIPLE));
        open.clear();
        open.extend((0..count).filter(|c| residuals[*c] > tolerance(*c)));
        // Fill the last register with the next best columns: a part of it costs as much as the
        // whole.
        let missing = open.len().next_multiple_of(COLUMN_MULTIPLE) - open.len();
        let rest = (0..count).filter(|c| (SPENT_RESIDUAL..=tolerance(*c)).contains(&residuals[*c]));
        open.extend(rest.take(missing));
        let width = open.len().next_multiple_of(COLUMN_MULTIPLE);
        let (from, to) = (
            self.width.next_multiple_of(SINGLE_COLUMN_MULTIPLE),
            width.next_multiple_of(SINGLE_COLUMN_MULTIPLE),
        );
        if open.iter().enumerate().all(|(place, c)| place == *c) && from == to {
            return open.len();
        }
        let (all, rest) = single.split_at_mut(1);
        let out = Strided(&mut rest[0][..self.n * to], to);
        let (all, open) = (&all[0], &*open);
        self.parts.run(out, |rows, out| {
            let rows = all[rows.start * from..rows.end * from].chunks_exact(from);
            for (to, from) in out.0.chunks_exact_mut(to).zip(rows) {
                let (chosen, padding) = to.split_at_mut(open.len());
                for (to, c) in chosen.iter_mut().zip(open) {
                    *to = from[*c];
                }
                padding.fill(0.0);
            }
        });
        single.swap(0, 1);
        open.len()
    }

    /// Restarts the space with the best triplets, whose images are computed again from W = V + S V.
    fn renew(&mut self, out: &Triplets) {
        let width = self.width;
        let columns = width.min(self.work.basis.size);
        let mut block = std::mem::take(&mut self.work.block);
        self.parts.run(Strided(&mut block, width), |rows, block| {
            let own = rows.start * width..rows.end * width;
            let vectors = out.right[own.clone()].iter().zip(&out.image[own]);
            for (to, (right, image)) in block.0.iter_mut().zip(vectors) {
                *to = right + image;
            }
        });
        self.work.basis.discard();
        self.expand(&block, width, columns);
        self.work.block = block;
    }

    /// Restarts the space with the best triplets.
    fn restart(&mut self, out: &Triplets) {
        let width = self.width;
        let basis = &mut self.work.basis;
        let columns = width.min(basis.size);
        basis.size = 0;
        basis.add(
            self.parts,
            columns,
            width,
            self.least_length,
            |rows, space, image, stride, first| {
                let own = rows.start * width..rows.end * width;
                for (to, from) in [(space, &out.right[own.clone()]), (image, &out.image[own])] {
                    for (to, from) in to.chunks_mut(stride).zip(from.chunks_exact(width)) {
                        to[first..first + width].copy_from_slice(from);
                    }
                }
            },
        );
    }
}

/// U + VΣ from V and UΣ, rows of as many values as there are in `sigma`.
fn combine(right: &[f64], image: &[f64], sigma: &[f64], inverse: &[f64], out: &mut [f64]) {
    let width = sigma.len();
    dispatch(|| {
        let rows = right.chunks_exact(width).zip(image.chunks_exact(width));
        for (out, (right, image)) in out.chunks_exact_mut(width).zip(rows) {
            let scales = sigma.iter().zip(inverse);
            for ((out, (right, image)), (sigma, inverse)) in
                out.iter_mut().zip(right.iter().zip(image)).zip(scales)
            {
                *out = image * inverse + right * sigma;
            }
        }
    });
}

const _: () = assert!(CHUNK_ROWS.is_multiple_of(COLUMN_MULTIPLE));
#[cfg(test)]
mod tests {
    use super::*;
    use crate::katz::katz_similarity;
    use crate::linalg::matrix::SparseMatrix;
    use crate::radius::exact::spectral_radius;
    use crate::svd::full_svd;

    fn random(n: usize, degree: usize, seed: u64) -> SparseMatrix {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let edges: Vec<_> = (0..degree * n)
            .map(|_| (rng.random_range(0..n), rng.random_range(0..n), rng.random::<f64>()))
            .collect();
        SparseMatrix::from_triplets(n, edges).unwrap()
    }

    #[test]
    fn triplets_equal_those_of_the_full_decomposition() {
        for (n, seed) in [(40, 1), (97, 2), (150, 3), (300, 4)] {
            for fraction in [0.5, 0.9] {
                let a = random(n, 4, seed);
                let radius = spectral_radius(&a, None);
                let alpha = fraction / radius.upper;
                let full = full_svd(&katz_similarity(&a, alpha, &radius).unwrap()).unwrap();
                let mut operator = KatzOperator::default();
                operator.assign(&a, alpha, false, 1);
                let request = Request {
                    rank: 8,
                    exact: 8,
                    tolerance: 1e-9,
                    most_rounds: MAX_ROUNDS,
                    seed: 5,
                    threads: 1,
                };
                let mut out = Triplets::default();
                leading_triplets(
                    &operator,
                    request,
                    (&[], 0),
                    &mut Workspace::default(),
                    &mut out,
                    &mut |_| {},
                );
                assert!(out.converged, "n {n}: {:?}", out.residuals);
                for j in 0..8 {
                    let wanted = full.singular_values()[j];
                    assert!((out.sigma[j] - wanted).abs() < 1e-11 * wanted, "n {n} σ{j}");
                }
            }
        }
    }
}
