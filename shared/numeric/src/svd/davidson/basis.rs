//! The search space: directions, their images under S, and what Rayleigh and Ritz need of them.
//!
//! Directions stay as they come, V = W − αA W beside S V = αA W; making them orthonormal in place
//! would take two more passes over all of them each round. Instead the small matrix T is kept for
//! which V T is orthonormal, from Gram matrices that are measured (a Cholesky factorisation, block by
//! block). Directions that depend too much on others for that are made independent in place.

use std::ops::Range;

use crate::linalg::Aligned;
use crate::linalg::backend::small_symmetric::{Symmetric, invert_transpose};
use crate::linalg::block_vectors::{
    BlockView, CHUNK_ROWS, add_gram, product, transform, transform_scratch,
};
use crate::linalg::parallel::{Parts, Strided};

/// Squared length that must be left of a direction of length 1 beside the space and the other ones. What
/// is left is scaled up to length 1 again, and the rounding of S V with it.
const DEPENDENT_SQUARE: f64 = 1e-12;

/// Attempts to make directions independent. Twice is enough (Kahan and Parlett).
const MAX_ATTEMPTS: usize = 3;

/// Directions V, n × [`Basis::size`], and S V.
#[derive(Debug, Default)]
pub(super) struct Basis {
    nodes: usize,
    /// V in rows of `stride` values, with what more room there is to be.
    pub(super) space: Aligned<f64>,
    /// S V likewise.
    image: Aligned<f64>,
    pub(super) stride: usize,
    /// Directions that are in use.
    pub(super) size: usize,
    /// T, size × size in rows of `stride` values, upper triangular.
    change: Aligned<f64>,
    /// (S V T)ᵀ S V T, likewise.
    energy: Aligned<f64>,
    /// Sums of all parts; the first ones are the Gram matrices of new directions with all others.
    sums: Vec<f64>,
    small: Small,
    symmetric: Symmetric,
    /// Coefficients of the Ritz vectors, size × width.
    pub(super) coefficients: Vec<f64>,
    pub(super) values: Vec<f64>,
}

/// Small matrices that only one step needs.
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

/// `matrix` as a matrix of zeros of that length.
fn zeros(matrix: &mut Vec<f64>, len: usize) -> &mut [f64] {
    matrix.clear();
    matrix.resize(len, 0.0);
    matrix
}

impl Basis {
    /// Makes room for `capacity` directions of length `n`, and forgets those that there were. In `space`
    /// there is room for `least` vectors at least.
    pub(super) fn prepare(&mut self, n: usize, capacity: usize, least: usize) {
        self.nodes = n;
        self.stride = capacity;
        self.size = 0;
        self.space.resize(n * capacity.max(least));
        self.image.resize(n * capacity);
        self.change.resize(capacity * capacity);
        self.energy.resize(capacity * capacity);
    }

    /// V and S V, in rows of `stride` values.
    pub(super) fn vectors(&self) -> (&[f64], &[f64]) {
        let length = self.nodes * self.stride;
        (&self.space[..length], &self.image[..length])
    }

    /// Adds the first `columns` of the `width` directions that `fill` writes, a multiple of the
    /// largest register, of which those from `columns` on are zero. `fill` is given rows, those rows of V
    /// and of S V, their stride and the column to begin with. How many independent ones there were is
    /// answered; `least_length` is the length that must be left of each.
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
            match self.factorise(columns, width, if last { 0.0 } else { least_length }) {
                Factor::Independent => {
                    self.admit(columns, width);
                    return columns;
                }
                _ if last => return 0,
                Factor::Combined(kept) => columns = kept,
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

    /// Lets `fill` write new directions, and takes the Gram matrices of all directions with them.
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

    /// Decomposes what the Gram matrix of the new directions, scaled to length 1, leaves beside the
    /// space. Leaves the inverse factor, or the combination of all that is to replace the new ones.
    fn factorise(&mut self, columns: usize, width: usize, least_length: f64) -> Factor {
        let (stride, first) = (self.stride, self.size);
        let all = first + width;
        let (gram, energy) = self.sums[..2 * all * width].split_at_mut(all * width);
        let small = &mut self.small;
        small.lengths.clear();
        small.lengths.extend((0..width).map(|j| {
            let square = gram[(first + j) * width + j];
            if j < columns && square > 0.0 { 1.0 / square.sqrt() } else { 0.0 }
        }));
        if !small.lengths.iter().all(|length| length.is_finite()) {
            return Factor::None;
        }
        for matrix in [&mut *gram, energy] {
            for (i, row) in matrix.chunks_exact_mut(width).enumerate() {
                let own = if i < first { 1.0 } else { small.lengths[i - first] };
                for (value, length) in row.iter_mut().zip(&small.lengths) {
                    *value *= own * length;
                }
            }
        }
        // What the new directions have in common with the orthonormal ones, with the sign of what
        // is to be added to take it away.
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
        if self.symmetric.cholesky(&mut small.factor, columns, DEPENDENT_SQUARE) {
            let factor = &small.factor;
            left = (0..columns).map(|i| factor[i * columns + i]).fold(1.0, f64::min);
            invert_transpose(factor, columns, inverse, width);
        } else {
            // Some directions depend on others: the principal ones stay.
            let Some((values, vectors)) = self.symmetric.eigen(schur, columns) else {
                return Factor::None;
            };
            kept = values.iter().filter(|value| **value > DEPENDENT_SQUARE).count();
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
            Factor::Combined(kept)
        }
    }

    /// Takes the new directions into the space after [`Basis::factorise`] has found them good.
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
        // With C the overlap, E = Tᵀ(SV)ᵀ S W and F = (SV T)ᵀ SV T C, the old directions T and the
        // new ones T C + W have E + F in common, and the new ones with one another what follows.
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

    /// The coefficients of the `count` best Ritz vectors, size × `width`, and their values, σ², of
    /// which the same number. False when there are none in floating point.
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

/// What became of a factorisation.
enum Factor {
    /// The directions are independent.
    Independent,
    /// So many are, once they are combined.
    Combined(usize),
    /// None is.
    None,
}
