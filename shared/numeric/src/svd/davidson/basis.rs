//! The search space: directions, their images under S, and the matrices of the Rayleigh–Ritz
//! method.
//!
//! Directions stay as computed, V = W − αA W and S V = αA W; making them orthonormal in place would
//! take two more passes over all of them in each round. Instead a small matrix T is kept for which
//! V T is orthonormal, from measured Gram matrices (a block Cholesky factorisation). Directions
//! that are too dependent for that are made independent in place.

use std::ops::Range;

use crate::linalg::Aligned;
use crate::linalg::backend::small_symmetric::{Symmetric, invert_transpose};
use crate::linalg::block_vectors::{
    BlockView, CHUNK_ROWS, add_gram, product, transform, transform_scratch,
};
use crate::linalg::parallel::{Parts, Strided};
use crate::linalg::vector::zeros;

/// Squared length that must be left of a unit direction, orthogonal to the space and to the other
/// ones. It is scaled up to length 1 again, and the rounding of S V with it.
const DEPENDENT_SQUARE: f64 = 1e-12;

/// The same for directions that were made independent before. What becomes short again consists of
/// rounding errors, and S V would no longer belong to V once it is scaled up.
const SPENT_SQUARE: f64 = 1e-2;

/// Most attempts to make directions independent. Twice is enough (Kahan and Parlett).
const MAX_ATTEMPTS: usize = 3;

/// Directions V, n × [`Basis::size`], and S V.
#[derive(Debug, Default)]
pub(super) struct Basis {
    nodes: usize,
    /// V in rows of `stride` values, with unused memory after it.
    pub(super) space: Aligned<f64>,
    /// S V likewise.
    image: Aligned<f64>,
    pub(super) stride: usize,
    /// Number of directions in use.
    pub(super) size: usize,
    /// About how far S V is from the image of V, relative to σ₁: what is left of a direction is scaled
    /// up to length 1, and the errors of all that was subtracted with it.
    pub(super) error: f64,
    /// T, size × size in rows of `stride` values, upper triangular.
    change: Aligned<f64>,
    /// (S V T)ᵀ S V T, likewise.
    energy: Aligned<f64>,
    /// Sums over all parts; the first ones are the Gram matrices of the new directions with all.
    sums: Vec<f64>,
    small: Small,
    symmetric: Symmetric,
    /// Coefficients of the Ritz vectors, size × width.
    pub(super) coefficients: Vec<f64>,
    pub(super) values: Vec<f64>,
}

/// Small matrices of one step.
#[derive(Debug, Default)]
struct Small {
    lengths: Vec<f64>,
    overlap: Vec<f64>,
    crossed: Vec<f64>,
    spread: Vec<f64>,
    inner: Vec<f64>,
    other: Vec<f64>,
    factor: Vec<f64>,
    inverse: Vec<f64>,
    combined: Vec<f64>,
}

impl Basis {
    /// Makes room for `capacity` directions of length `n`, and discards the present ones. `space`
    /// has room for at least `least` vectors.
    pub(super) fn prepare(&mut self, n: usize, capacity: usize, least: usize) {
        self.nodes = n;
        self.stride = capacity;
        self.discard();
        self.space.resize(n * capacity.max(least));
        self.image.resize(n * capacity);
        self.change.resize(capacity * capacity);
        self.energy.resize(capacity * capacity);
    }

    /// Discards the present directions.
    pub(super) fn discard(&mut self) {
        (self.size, self.error) = (0, f64::EPSILON);
    }

    /// V and S V, in rows of `stride` values.
    pub(super) fn vectors(&self) -> (&[f64], &[f64]) {
        let length = self.nodes * self.stride;
        (&self.space[..length], &self.image[..length])
    }

    /// Adds the first `columns` of the `width` directions that `fill` writes, a multiple of the
    /// largest register; those from `columns` on are zero. `fill` receives rows, these rows of V
    /// and of S V, their stride and the first column. `least_length` must be left of each
    /// direction. Returns the number of independent ones.
    pub(super) fn add(
        &mut self,
        parts: Parts,
        columns: usize,
        width: usize,
        least_length: f64,
        fill: impl Fn(Range<usize>, &mut [f64], &mut [f64], usize, usize) + Sync,
    ) -> usize {
        let (stride, first) = (self.stride, self.size);
        self.measure(parts, width, |rows, space, image, _| fill(rows, space, image, stride, first));
        let mut columns = columns;
        for attempt in 1..=MAX_ATTEMPTS {
            let last = attempt == MAX_ATTEMPTS;
            let least_square = if attempt == 1 { DEPENDENT_SQUARE } else { SPENT_SQUARE };
            let least_length = if last { 0.0 } else { least_length };
            match self.factorise(columns, width, least_square, least_length) {
                Factor::Independent => {
                    self.admit(columns, width);
                    return columns;
                }
                _ if last => return 0,
                Factor::Combined { kept, left } => {
                    columns = kept;
                    self.error /= left;
                }
                Factor::None => return 0,
            }
            let all = first + width;
            let combined = std::mem::take(&mut self.small.combined);
            let t = BlockView::new(&combined[..all * width], width, width);
            self.measure(parts, width, |_, space, image, scratch| {
                transform(space, stride, t, first, scratch);
                transform(image, stride, t, first, scratch);
            });
            self.small.combined = combined;
        }
        0
    }

    /// Lets `fill` write new directions, and computes the Gram matrices of all directions with
    /// them.
    fn measure(
        &mut self,
        parts: Parts,
        width: usize,
        fill: impl Fn(Range<usize>, &mut [f64], &mut [f64], &mut [f64]) + Sync,
    ) {
        let (stride, first) = (self.stride, self.size);
        let all = first + width;
        let length = 2 * all * width;
        let space = &mut self.space[..self.nodes * stride];
        let blocks = (Strided(space, stride), Strided(&mut self.image, stride));
        let scratch = transform_scratch(all);
        parts.sum(&mut self.sums, length + scratch, blocks, |rows, (space, image), sums| {
            let (sums, scratch) = sums.split_at_mut(length);
            let (gram, energy) = sums.split_at_mut(all * width);
            let chunks = space
                .0
                .chunks_mut(CHUNK_ROWS * stride)
                .zip(image.0.chunks_mut(CHUNK_ROWS * stride));
            for (start, (space, image)) in rows.clone().step_by(CHUNK_ROWS).zip(chunks) {
                fill(start..(start + CHUNK_ROWS).min(rows.end), space, image, scratch);
                for (block, sums) in [(space, &mut *gram), (image, &mut *energy)] {
                    let block = BlockView::new(block, stride, all);
                    add_gram(block, block.from(first), sums, width);
                }
            }
        });
    }

    /// Scales the Gram matrices of the new directions to length 1. False when a length is not finite.
    fn scale_gram(&mut self, columns: usize, width: usize) -> bool {
        let first = self.size;
        let all = first + width;
        let (gram, energy) = self.sums[..2 * all * width].split_at_mut(all * width);
        let small = &mut self.small;
        small.lengths.clear();
        small.lengths.extend((0..width).map(|j| {
            let square = gram[(first + j) * width + j];
            if j < columns && square > 0.0 { 1.0 / square.sqrt() } else { 0.0 }
        }));
        if !small.lengths.iter().all(|length| length.is_finite()) {
            return false;
        }
        for matrix in [&mut *gram, energy] {
            for (i, row) in matrix.chunks_exact_mut(width).enumerate() {
                let own = if i < first { 1.0 } else { small.lengths[i - first] };
                for (value, length) in row.iter_mut().zip(&small.lengths) {
                    *value *= own * length;
                }
            }
        }
        true
    }

    /// Decomposes the Schur complement of the space in the Gram matrix of the new directions,
    /// scaled to length 1. Leaves the inverse factor, or the combination of all directions that
    /// replaces the new ones: those of which more than `least_square` is left.
    fn factorise(
        &mut self,
        columns: usize,
        width: usize,
        least_square: f64,
        least_length: f64,
    ) -> Factor {
        let (stride, first) = (self.stride, self.size);
        let all = first + width;
        if !self.scale_gram(columns, width) {
            return Factor::None;
        }
        let gram = &self.sums[..all * width];
        let small = &mut self.small;
        // Minus the components of the new directions along the orthonormal ones.
        let overlap = zeros(&mut small.overlap, first * width);
        let change = BlockView::new(&self.change[..first * stride], stride, first);
        add_gram(change, BlockView::new(&gram[..first * width], width, width), overlap, width);
        overlap.iter_mut().for_each(|value| *value = -*value);
        let overlap = BlockView::new(overlap, width, width);
        let inner = zeros(&mut small.inner, width * width);
        add_gram(overlap, overlap, inner, width);
        small.factor.clear();
        for i in 0..columns {
            let rows = gram[(first + i) * width..][..columns].iter().zip(&inner[i * width..]);
            small.factor.extend(rows.map(|(gram, taken)| gram - taken));
        }
        let schur = zeros(&mut small.other, columns * columns);
        schur.copy_from_slice(&small.factor);
        let inverse = zeros(&mut small.inverse, width * width);
        let mut kept = columns;
        let mut left = 0.0;
        let shortest;
        if self.symmetric.cholesky(&mut small.factor, columns, least_square) {
            let factor = &small.factor;
            left = (0..columns).map(|i| factor[i * columns + i]).fold(1.0, f64::min);
            shortest = left;
            invert_transpose(factor, columns, inverse, width);
        } else {
            // Some directions are dependent: keep the principal ones.
            let Some((values, vectors)) = self.symmetric.eigen(schur, columns) else {
                return Factor::None;
            };
            kept = values.iter().filter(|value| **value > least_square).count();
            shortest = values[..kept].last().map_or(1.0, |value| value.sqrt());
            for i in 0..columns {
                for j in 0..kept {
                    inverse[i * width + j] = vectors[i * columns + j] / values[j].sqrt();
                }
            }
        }
        if kept == 0 {
            return Factor::None;
        }
        let inverse = BlockView::new(inverse, width, width);
        let spread = zeros(&mut small.spread, first * width);
        product(change, overlap, spread, width, 0);
        let combined = zeros(&mut small.combined, all * width);
        product(BlockView::new(spread, width, width), inverse, combined, width, 0);
        for i in 0..columns {
            let row = &mut combined[(first + i) * width..][..width];
            for (value, inverse) in row.iter_mut().zip(&inverse.data[i * width..]) {
                *value = small.lengths[i] * inverse;
            }
        }
        if left > 0.0 && left >= least_length {
            Factor::Independent
        } else {
            Factor::Combined { kept, left: shortest }
        }
    }

    /// Adds the new directions to the space, after [`Basis::factorise`] found them independent.
    fn admit(&mut self, columns: usize, width: usize) {
        let (stride, first) = (self.stride, self.size);
        let all = first + width;
        let small = &mut self.small;
        let energy = &self.sums[all * width..2 * all * width];
        for (i, combined) in small.combined.chunks_exact(width).enumerate().take(first + columns) {
            self.change[i * stride + first..][..width].copy_from_slice(combined);
            if i >= first {
                self.change[i * stride..i * stride + first].fill(0.0);
            }
        }
        // With C the overlap, E = Tᵀ(SV)ᵀ S W and F = (SV T)ᵀ SV T C, the products of the old
        // directions T with the new ones T C + W are E + F; those of the new ones follow.
        let change = BlockView::new(&self.change[..first * stride], stride, first);
        let overlap = BlockView::new(&small.overlap, width, width);
        let old_energy = BlockView::new(&self.energy[..first * stride], stride, first);
        let crossed = zeros(&mut small.crossed, first * width);
        add_gram(change, BlockView::new(&energy[..first * width], width, width), crossed, width);
        let spread = zeros(&mut small.spread, first * width);
        product(old_energy, overlap, spread, width, 0);
        let inner = zeros(&mut small.inner, width * width);
        add_gram(overlap, BlockView::new(crossed, width, width), inner, width);
        let own = zeros(&mut small.other, width * width);
        add_gram(overlap, BlockView::new(spread, width, width), own, width);
        for i in 0..width {
            for j in 0..width {
                own[i * width + j] +=
                    energy[(first + i) * width + j] + inner[i * width + j] + inner[j * width + i];
            }
        }
        let inverse = BlockView::new(&small.inverse, width, width);
        product(BlockView::new(own, width, width), inverse, inner, width, 0);
        own.fill(0.0);
        add_gram(inverse, BlockView::new(inner, width, width), own, width);
        for (crossed, spread) in crossed.iter_mut().zip(&*spread) {
            *crossed += spread;
        }
        product(BlockView::new(crossed, width, width), inverse, spread, width, 0);
        for i in 0..first {
            for j in 0..columns {
                let value = spread[i * width + j];
                self.energy[i * stride + first + j] = value;
                self.energy[(first + j) * stride + i] = value;
            }
        }
        for i in 0..columns {
            for j in 0..columns {
                let value = 0.5 * (own[i * width + j] + own[j * width + i]);
                self.energy[(first + i) * stride + first + j] = value;
            }
        }
        self.size += columns;
    }

    /// Computes the coefficients of the `count` best Ritz vectors, size × `width`, and their values
    /// σ². False when they are not finite.
    pub(super) fn ritz(&mut self, count: usize, width: usize) -> bool {
        let (stride, size) = (self.stride, self.size);
        let small = &mut self.small;
        small.factor.clear();
        for row in self.energy.chunks_exact(stride).take(size) {
            small.factor.extend_from_slice(&row[..size]);
        }
        let Some((values, vectors)) = self.symmetric.eigen(&small.factor, size) else {
            return false;
        };
        self.values.clear();
        self.values.extend_from_slice(&values[..count]);
        let chosen = zeros(&mut small.other, size * width);
        for (to, from) in chosen.chunks_exact_mut(width).zip(vectors.chunks_exact(size)) {
            to[..count].copy_from_slice(&from[..count]);
        }
        let coefficients = zeros(&mut self.coefficients, size * width);
        let change = BlockView::new(&self.change[..size * stride], stride, size);
        product(change, BlockView::new(chosen, width, width), coefficients, width, 0);
        true
    }
}

/// Result of a factorisation.
enum Factor {
    /// All directions are independent.
    Independent,
    /// This many are, after they are combined; the length that is left of the shortest one.
    Combined { kept: usize, left: f64 },
    /// None is independent.
    None,
}
