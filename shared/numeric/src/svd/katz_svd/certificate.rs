//! The leading triplets after a change of few rows, with their residuals, from those rows alone.
//!
//! Between two frames mostly little of αA changes. For the same W, S V = αA W and V = W − S V then
//! change in the same few rows, and the Rayleigh–Ritz method on the range of V needs only the Gram
//! matrices of V and of S V, from which the old rows are subtracted and to which the new ones are
//! added. The residual of a Ritz vector V y with value θ² is, with E = αAᵀ S V − Mᵀ V Σ₀² and D =
//! −Mᵀ V for fixed values Σ₀,
//!
//! Mᵀ(Sᵀu − θv) = (E y + D (θ² − Σ₀²) y)/θ,
//!
//! in which all terms are as small as the residual. Its length follows from the Gram matrix of E
//! and D without cancellation, which changes only in rows that a changed row leads to. Nothing is
//! estimated: the result is the residual that a pass over all rows would find for the best triplets
//! in the range of V, up to rounding, which the incremental sums accumulate and which is allowed
//! for.

use crate::linalg::backend::small_symmetric::{Symmetric, invert_transpose};
use crate::linalg::block_vectors::{BlockView, CHUNK_ROWS, add_gram, product};
use crate::linalg::matrix::SparseMatrix;
use crate::linalg::parallel::{Parts, Strided};
use crate::linalg::vector::zeros;
use crate::svd::davidson::{NULL_VALUE_RATIO, Triplets};
use crate::svd::operator::{KatzOperator, Orientation};

/// Roundings per update of a Gram matrix, relative to its trace.
const GRAM_ROUNDINGS: f64 = 16.0;

/// Smallest pivot of the Gram matrix of V, whose diagonal is about 1, for V to count as a basis.
const MIN_PIVOT: f64 = 0.01;

/// Incremental sums for one W.
#[derive(Debug, Default)]
pub(super) struct Certificate {
    /// True when the sums belong to the triplets and the operator.
    pub(super) valid: bool,
    /// Updates since the sums were computed.
    pub(super) updates: u32,
    /// Squares of the values Σ₀.
    values: Vec<f64>,
    /// Gram matrices of V and of S V, each width × width, and of \[E, D\], twice as wide.
    right: Vec<f64>,
    image: Vec<f64>,
    residual: Vec<f64>,
    /// Largest traces of EᵀE and DᵀD so far.
    traces: [f64; 2],
    /// Coefficients of the Ritz vectors in the columns of V, width × width.
    pub(super) rotation: Vec<f64>,
    sums: Vec<f64>,
    symmetric: Symmetric,
    scratch: Scratch,
}

#[derive(Debug, Default)]
struct Scratch {
    /// Rows of αA that changed, and rows of E and D that change with them.
    changed: Vec<u32>,
    touched: Vec<u32>,
    /// Update in which a row was last touched.
    stamps: Vec<u32>,
    stamp: u32,
    packed: Vec<f64>,
    factor: Vec<f64>,
    inverse: Vec<f64>,
    first: Vec<f64>,
    second: Vec<f64>,
    combined: Vec<f64>,
    spread: Vec<f64>,
}

impl Certificate {
    /// Computes all sums, and the triplets from them, by a pass over all rows. `w` are the
    /// directions W that the triplets span, n × width; `vectors` receives \[E, D\], n × twice the
    /// width. False when a value is not finite.
    pub(super) fn recompute(
        &mut self,
        operator: &KatzOperator,
        parts: Parts,
        w: &[f64],
        triplets: &mut Triplets,
        vectors: &mut [f64],
    ) -> bool {
        let (n, width) = (operator.nodes(), triplets.width);
        let (square, double) = (width * width, 2 * width);
        self.values.clear();
        self.values.extend(triplets.sigma.iter().map(|sigma| sigma * sigma));
        self.values.resize(width, 0.0);
        let blocks = (Strided(&mut triplets.right, width), Strided(&mut triplets.image, width));
        parts.sum(&mut self.sums, 2 * square, blocks, |rows, (right, image), sums| {
            let (own, other) = sums.split_at_mut(square);
            operator.map_directions(rows, w, width, width, right.0, image.0, width, 0);
            for (block, sums) in [(right.0, own), (image.0, other)] {
                for chunk in block.chunks(CHUNK_ROWS * width) {
                    let chunk = BlockView::new(chunk, width, width);
                    add_gram(chunk, chunk, sums, width);
                }
            }
        });
        self.right.clear();
        self.right.extend_from_slice(&self.sums[..square]);
        self.image.clear();
        self.image.extend_from_slice(&self.sums[square..2 * square]);
        let (right, image, values) = (&*triplets.right, &*triplets.image, &*self.values);
        let out = Strided(&mut vectors[..n * double], double);
        parts.sum(&mut self.sums, double * double, out, |rows, out, sums| {
            let chunks = out.0.chunks_mut(CHUNK_ROWS * double);
            for (start, chunk) in rows.clone().step_by(CHUNK_ROWS).zip(chunks) {
                let rows = start..(start + CHUNK_ROWS).min(rows.end);
                fill_residuals(operator, rows, right, image, values, chunk);
                let chunk = BlockView::new(chunk, double, double);
                add_gram(chunk, chunk, sums, double);
            }
        });
        self.residual.clear();
        self.residual.extend_from_slice(&self.sums[..double * double]);
        self.scratch.stamps.clear();
        self.scratch.stamps.resize(n, 0);
        self.scratch.stamp = 0;
        self.updates = 0;
        self.traces = [0.0; 2];
        self.valid = self.ritz(triplets);
        self.valid
    }

    /// Brings the operator up to date with the rows `changed` of `a`, in the caller's order. The
    /// sums must follow, by [`Certificate::update`] or [`Certificate::recompute`].
    pub(super) fn replace_rows(
        &mut self,
        operator: &mut KatzOperator,
        a: &SparseMatrix,
        changed: &[usize],
    ) {
        let scratch = &mut self.scratch;
        scratch.changed.clear();
        scratch.touched.clear();
        operator.forget_growth();
        for &outer in changed {
            if operator.replace_row(a, outer, &mut scratch.touched) {
                scratch.changed.push(operator.inner()[outer]);
            }
        }
    }

    /// True when one of the rows that were last replaced has changed.
    pub(super) fn has_changes(&self) -> bool {
        !self.scratch.changed.is_empty()
    }

    /// Rows that have changed and columns in which they have or had entries, in the inner order.
    pub(super) fn touched(&self) -> impl Iterator<Item = u32> {
        self.scratch.changed.iter().chain(&self.scratch.touched).copied()
    }

    /// Updates the sums, and the triplets with them, by the replaced rows. False when V is no
    /// longer a basis: the sums are lost then.
    pub(super) fn update(
        &mut self,
        operator: &KatzOperator,
        w: &[f64],
        triplets: &mut Triplets,
        vectors: &mut [f64],
    ) -> bool {
        let width = triplets.width;
        let scratch = &mut self.scratch;
        scratch.touched.extend_from_slice(&scratch.changed);
        scratch.stamp += 1;
        let (stamps, stamp) = (&mut scratch.stamps, scratch.stamp);
        scratch.touched.retain(|i| std::mem::replace(&mut stamps[*i as usize], stamp) != stamp);
        self.updates += 1;
        let double = 2 * width;
        let (changed, touched) = (&scratch.changed, &scratch.touched);
        let packed = &mut scratch.packed;
        exchange(&mut self.right, &triplets.right, changed, width, -1.0, packed);
        exchange(&mut self.image, &triplets.image, changed, width, -1.0, packed);
        exchange(&mut self.residual, vectors, touched, double, -1.0, packed);
        let (right, image) = (&mut triplets.right, &mut triplets.image);
        for &i in changed {
            let i = i as usize;
            let own = i * width..(i + 1) * width;
            let (right, image) = (&mut right[own.clone()], &mut image[own]);
            operator.map_directions(i..i + 1, w, width, width, right, image, width, 0);
        }
        for &i in touched {
            let i = i as usize;
            let row = &mut vectors[i * double..(i + 1) * double];
            fill_residuals(operator, i..i + 1, right, image, &self.values, row);
        }
        exchange(&mut self.right, right, changed, width, 1.0, packed);
        exchange(&mut self.image, image, changed, width, 1.0, packed);
        exchange(&mut self.residual, vectors, touched, double, 1.0, packed);
        self.valid = self.ritz(triplets);
        self.valid
    }

    /// Computes values, coefficients and residuals of the Ritz vectors from the sums. False when V
    /// is no longer a basis or a value is not finite.
    fn ritz(&mut self, triplets: &mut Triplets) -> bool {
        let width = triplets.width;
        let count = triplets.sigma.len();
        let Self { values, right, image, residual, rotation, symmetric, scratch, .. } = self;
        let Scratch { factor, inverse, first, second, combined, spread, .. } = scratch;
        // Columns from `count` on are zero.
        let live = (0..count).take_while(|i| right[i * width + i] > 0.0).count();
        factor.clear();
        for row in right.chunks_exact(width).take(live) {
            factor.extend_from_slice(&row[..live]);
        }
        if live == 0 || !symmetric.cholesky(factor, live, MIN_PIVOT) {
            return false;
        }
        let inverse = zeros(inverse, width * width);
        invert_transpose(factor, live, inverse, width);
        let inverse = BlockView::new(inverse, width, width);
        let first = zeros(first, width * width);
        product(BlockView::new(image, width, width), inverse, first, width, 0);
        let second = zeros(second, width * width);
        add_gram(inverse, BlockView::new(first, width, width), second, width);
        factor.clear();
        for row in second.chunks_exact(width).take(live) {
            factor.extend_from_slice(&row[..live]);
        }
        let Some((squares, vectors)) = symmetric.eigen(factor, live) else {
            return false;
        };
        first.fill(0.0);
        for (to, from) in first.chunks_exact_mut(width).zip(vectors.chunks_exact(live)) {
            to[..live].copy_from_slice(from);
        }
        let rotation = zeros(rotation, width * width);
        product(inverse, BlockView::new(first, width, width), rotation, width, 0);
        triplets.sigma.clear();
        triplets.sigma.extend(squares.iter().map(|square| square.max(0.0).sqrt()));
        triplets.sigma.resize(count, 0.0);

        // The coefficients of each residual in the columns of E and D.
        let combined = zeros(combined, 2 * width * width);
        for (c, (upper, value)) in rotation.chunks_exact(width).zip(values.iter()).enumerate() {
            combined[c * width..(c + 1) * width].copy_from_slice(upper);
            for (j, (square, y)) in squares.iter().zip(upper).enumerate() {
                combined[(width + c) * width + j] = (square - value) * y;
            }
        }
        let double = 2 * width;
        let spread = zeros(spread, double * width);
        let gram = BlockView::new(residual, double, double);
        product(gram, BlockView::new(combined, width, width), spread, width, 0);
        self.measure_residuals(triplets)
    }

    /// Residuals from the Gram matrix of E and D and the coefficients in the scratch space. False
    /// when one is not finite.
    fn measure_residuals(&mut self, triplets: &mut Triplets) -> bool {
        let width = triplets.width;
        let double = 2 * width;
        let Self { residual, traces, scratch, .. } = self;
        let Scratch { combined, spread, .. } = scratch;
        let trace = |of: std::ops::Range<usize>| of.map(|i| residual[i * double + i]).sum::<f64>();
        for (largest, trace) in traces.iter_mut().zip([trace(0..width), trace(width..double)]) {
            *largest = trace.max(*largest);
        }
        let rounding = GRAM_ROUNDINGS * f64::from(self.updates + 1) * f64::EPSILON;
        let top = triplets.sigma[0];
        let null = NULL_VALUE_RATIO * top;
        triplets.residuals.clear();
        for (j, sigma) in triplets.sigma.iter().enumerate() {
            let mut square = 0.0;
            let mut lengths = [0.0; 2];
            for c in 0..double {
                let coefficient = combined[c * width + j];
                square += coefficient * spread[c * width + j];
                lengths[c / width] += coefficient * coefficient;
            }
            let slack = rounding * (lengths[0] * traces[0] + lengths[1] * traces[1]);
            let relative = (1.0 + top) * (square.max(0.0) + slack).sqrt() / (sigma * top);
            triplets.residuals.push(if *sigma > null { relative } else { 0.0 });
        }
        triplets.residuals.iter().all(|residual| residual.is_finite())
    }
}

/// Writes rows `rows` of \[E, D\] to `out`.
fn fill_residuals(
    operator: &KatzOperator,
    rows: std::ops::Range<usize>,
    right: &[f64],
    image: &[f64],
    values: &[f64],
    out: &mut [f64],
) {
    let width = values.len();
    let double = 2 * width;
    let backward = Orientation::Backward;
    operator.multiply(backward, rows.clone(), image, width, width, out, double, 0);
    operator.multiply(backward, rows.clone(), right, width, width, out, double, width);
    let right = right[rows.start * width..rows.end * width].chunks_exact(width);
    for (row, right) in out.chunks_exact_mut(double).zip(right) {
        let (e, d) = row.split_at_mut(width);
        for ((e, d), (right, value)) in e.iter_mut().zip(d).zip(right.iter().zip(values)) {
            *d -= right;
            *e += *d * value;
        }
    }
}

/// Adds `sign` times the Gram matrix of some rows of `block` to `gram`, width × width.
fn exchange(
    gram: &mut [f64],
    block: &[f64],
    rows: &[u32],
    width: usize,
    sign: f64,
    packed: &mut Vec<f64>,
) {
    packed.clear();
    for chunk in rows.chunks(CHUNK_ROWS) {
        packed.clear();
        for &i in chunk {
            packed.extend_from_slice(&block[i as usize * width..(i as usize + 1) * width]);
        }
        let len = packed.len();
        packed.extend_from_within(..);
        packed[len..].iter_mut().for_each(|value| *value *= sign);
        let (plain, signed) = packed.split_at(len);
        add_gram(
            BlockView::new(plain, width, width),
            BlockView::new(signed, width, width),
            gram,
            width,
        );
    }
}
