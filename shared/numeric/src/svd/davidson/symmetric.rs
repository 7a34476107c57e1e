//! Directions from the symmetric part of the graph, for searches that begin with nothing.
//!
//! Robots mostly relate to each other both ways, so that H = (αA + αAᵀ)/2 is close to αA, and products
//! with one symmetric matrix lead to most of what products with αA, αAᵀ and their inverses do. A
//! Chebyshev filter (Zhou, Saad, Tiago and Chelikowsky, J. Comput. Phys. 219, 2006) finds its leading
//! eigenvectors Z in single precision; W = Z begins the search. The correction of a triplet is then that
//! of the Jacobi–Davidson method (Sleijpen and van der Vorst, SIAM J. Matrix Anal. 17, 1996): with
//! V = M W, a residual is that of the pencil AᵀA − σ²MᵀM, for which −(σ − (1 + σ)H)(σ + (1 − σ)H) stands
//! here. On the complement of Z its inverse is a polynomial of low degree. An asymmetry decides how
//! many rounds it takes, not their result.
//!
//! What H does not show, such as a hub whose followers do not answer, must not be missed. A triplet with
//! value σ outside of Z needs a vector there that αA shortens to no less than σ/(1 + σ), as
//! S = αA + (αA)² + …; [`SymmetricPart::hides`] looks for one.
//!
//! Measured by processor time on a busy machine, against random vectors and the polynomial of
//! `polynomial`, on the fleets of `tests/peers/compare`, to 1e-6. Graphs that are symmetric: 200 nodes 1.4
//! to 1.9 times as fast, 500 nodes 2.6 to 2.8. Others: 500 nodes 1.05 to 1.35, 1,000 1.3 to 1.7, 3,000 1.15
//! to 2, 10,000 1.25 to 2.6; 200 nodes 0.85 to 1.
//!
//! Tried and left: two filters of degree 8 and 12 (where few eigenvalues stand out, columns drown in
//! roundings and the search begins again at random), projections at every fourth step of the search for
//! what is hidden (what is along Z comes back and counts as found), 30 or 40 products with H instead of 24,
//! corrections of degree 6 to 16, and a space that does not restart: it saves one round of ten, as the
//! asymmetry limits what a correction gains.

mod inverse;
mod orthonormal;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::linalg::Aligned;
use crate::linalg::backend::small_symmetric::Symmetric;
use crate::linalg::block_vectors::CHUNK_ROWS;
use crate::linalg::parallel::{Parts, Strided};
use crate::linalg::single_block::{SINGLE_COLUMN_MULTIPLE, add_gram, add_product, rotate};
use crate::svd::operator::symmetric::{Scales, SymmetricRows};
use crate::svd::operator::{KatzOperator, Orientation};
use inverse::{CORRECTION_DEGREE, Inverse, Nodes};
use orthonormal::{add_upper_gram, in_double, independent, mirror, whiten};

/// Largest degree of a filter, and the sum of all.
const MAX_FILTER_DEGREE: u32 = 10;
const FILTER_DEGREES: u32 = 24;

/// Most by which each filter amplifies the largest eigenvalue: more would drown the other vectors in
/// roundings and in what is left of the first ones, which is less from filter to filter.
const MAX_GROWTHS: [f64; 4] = [1e3, 1e4, 1e4, 1e5];

/// Filters after which the values on Z show where the unwanted part of the spectrum ends. Where it ends
/// too early, later filters amplify too much; the third one shows little more than the second.
const END_FILTERS: u32 = 2;

/// Steps of the Lanczos method that bound the spectrum of H.
const LANCZOS_STEPS: usize = 10;

/// How many times as many eigenvalues as there are wanted vectors the first filter amplifies, by the
/// weights of the Lanczos method, and where the unwanted part then ends at most, relative to the top.
const AMPLIFIED: f64 = 2.0;
const MAX_FIRST_CUT: f64 = 0.7;

/// Least part of the spectrum that is unwanted: filters of less have no degree that is worth it.
const LEAST_UNWANTED: f64 = 0.3;

/// Asymmetry from which the symmetric part says too little. That of a graph whose edges all go one way
/// is 1.4; a chain of command within a fleet leads to 0.6.
const MAX_ASYMMETRY: f64 = 0.9;

/// Largest asymmetry that counts as none: rounding.
const NO_ASYMMETRY: f64 = 1e-6;

/// Most steps of the search for what H does not show; what would need more counts as found.
const MAX_HIDDEN_STEPS: f64 = 20.0;

/// What such a vector is amplified by relative to all others, times the root of the nodes: a random
/// start holds so little of it.
const HIDDEN_GROWTH: f64 = 10.0;

/// Least end of what the search does not amplify, and what counts as found, relative to what is looked
/// for. What is found is a lower bound.
const HIDDEN_CUT: f64 = 0.8;
const HIDDEN_LIMIT: f64 = 0.98;

/// Columns of the search for what H does not show: one register of them.
const WIDTH: usize = SINGLE_COLUMN_MULTIPLE;

/// Eigenvectors of H, and what corrections need.
#[derive(Debug, Default)]
pub(super) struct SymmetricPart {
    rows: SymmetricRows,
    /// Z, n × `width`, and its eigenvalues, descending.
    vectors: Aligned<f32>,
    width: usize,
    values: Vec<f64>,
    /// The unwanted part of the spectrum.
    low: f64,
    cut: f64,
    top: f64,
    other: Aligned<f32>,
    sums: Vec<f64>,
    scratch: Vec<f32>,
    symmetric: Symmetric,
}

impl SymmetricPart {
    /// Finds about `width` leading eigenvectors. False when they are not to be had this way.
    pub(super) fn prepare(
        &mut self,
        operator: &KatzOperator,
        parts: Parts,
        width: usize,
        seed: u64,
    ) -> bool {
        let n = operator.nodes();
        self.width = width.next_multiple_of(SINGLE_COLUMN_MULTIPLE);
        self.rows.assign(operator);
        if self.rows.asymmetry() > MAX_ASYMMETRY {
            return false;
        }
        for block in [&mut self.vectors, &mut self.other] {
            block.resize(n * self.width);
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5e1f);
        if !self.bound_spectrum(n, &mut rng) {
            return false;
        }
        self.vectors.fill_with(|| rng.random::<f32>() - 0.5);
        let (mut left, mut growths) = (FILTER_DEGREES, MAX_GROWTHS.into_iter());
        let mut most = MAX_GROWTHS[0];
        let mut filters = 0;
        while left > 0 {
            most = growths.next().unwrap_or(most);
            let degree = self.degree(most).min(left);
            self.filter(parts, degree);
            left -= degree;
            filters += 1;
            let finds_end = filters <= END_FILTERS && left > 0;
            let kept = if finds_end { self.ritz(parts) } else { self.orthonormalise(parts) };
            let Some(kept) = kept else { return false };
            if finds_end {
                // No eigenvalue of H that is wanted is below the least one on Z.
                self.cut = self.cut.max(self.values[kept - 1]);
            }
            if kept < self.width && left > 0 {
                for row in self.vectors.chunks_exact_mut(self.width) {
                    row[kept..].fill_with(|| rng.random::<f32>() - 0.5);
                }
            }
        }
        if self.ritz(parts).is_none() {
            return false;
        }
        self.cut = self.unwanted_end(self.values.last().copied().unwrap_or(0.0));
        self.values[0] > self.cut
    }

    /// Where the unwanted part of the spectrum ends if nothing above `least` is unwanted.
    fn unwanted_end(&self, least: f64) -> f64 {
        least.max(self.low + LEAST_UNWANTED * (self.top - self.low))
    }

    /// Z, n × [`SymmetricPart::width`].
    pub(super) fn vectors(&self) -> &[f32] {
        &self.vectors
    }

    /// Columns of Z.
    pub(super) fn width(&self) -> usize {
        self.width
    }

    /// Bounds of the spectrum of H by the Lanczos method. False when they are not finite.
    fn bound_spectrum(&mut self, n: usize, rng: &mut ChaCha8Rng) -> bool {
        let mut now: Vec<f64> = (0..n).map(|_| rng.random::<f64>() - 0.5).collect();
        let (mut before, mut next) = (vec![0.0; n], vec![0.0; n]);
        let length = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>().sqrt();
        let mut small = vec![0.0; LANCZOS_STEPS * LANCZOS_STEPS];
        let scale = 1.0 / length(&now);
        now.iter_mut().for_each(|x| *x *= scale);
        let (mut beta, mut steps) = (0.0, 0);
        for k in 0..LANCZOS_STEPS.min(n) {
            self.rows.multiply(&now, &mut next);
            let alpha: f64 = next.iter().zip(&now).map(|(x, y)| x * y).sum();
            for ((x, now), before) in next.iter_mut().zip(&now).zip(&before) {
                *x -= alpha * now + beta * before;
            }
            small[k * LANCZOS_STEPS + k] = alpha;
            if k > 0 {
                small[k * LANCZOS_STEPS + k - 1] = beta;
                small[(k - 1) * LANCZOS_STEPS + k] = beta;
            }
            beta = length(&next);
            steps = k + 1;
            if beta.is_nan() || beta <= 1e-6 {
                break;
            }
            next.iter_mut().for_each(|x| *x /= beta);
            std::mem::swap(&mut before, &mut now);
            std::mem::swap(&mut now, &mut next);
        }
        let rows = small.chunks_exact(LANCZOS_STEPS).take(steps);
        let matrix: Vec<f64> = rows.flat_map(|row| row[..steps].iter().copied()).collect();
        let Some((values, vectors)) = self.symmetric.eigen(&matrix, steps) else { return false };
        // A value of H is no further from each of these than its residual.
        let last = steps * steps - 1;
        self.top = values[0];
        // The weight of an eigenvalue in a random vector is its share of all.
        let share = AMPLIFIED * self.width as f64 / n as f64;
        let mut weight = 0.0;
        let amplified = values.iter().zip(vectors).find(|(_, first)| {
            weight += *first * *first;
            weight >= share
        });
        let cut = amplified.map_or(self.top, |(value, _)| *value);
        self.low = values[steps - 1] - beta * vectors[last].abs();
        self.cut = self.unwanted_end(cut.min(MAX_FIRST_CUT * self.top));
        self.top > 0.0 && self.low < 0.0 && self.low.is_finite() && self.top.is_finite()
    }

    /// Degree of a filter that amplifies the largest eigenvalue by no more than `most`.
    fn degree(&self, most: f64) -> u32 {
        let (centre, half) = (0.5 * (self.cut + self.low), 0.5 * (self.cut - self.low));
        let steps = (2.0 * most).ln() / ((self.top - centre) / half).acosh();
        // NaN where the largest one is below the cut.
        if steps < f64::from(MAX_FILTER_DEGREE) { (steps as u32).max(1) } else { MAX_FILTER_DEGREE }
    }

    /// Amplifies what has eigenvalues above the cut.
    fn filter(&mut self, parts: Parts, degree: u32) {
        let (centre, half) = (0.5 * (self.cut + self.low), 0.5 * (self.cut - self.low));
        // Scaled so that the top stays near 1.
        let first = half / (self.top.max(self.cut + 0.02 * half) - centre);
        let mut sigma = first;
        for k in 0..degree {
            let next = if k == 0 { first } else { 1.0 / (2.0 / first - sigma) };
            let factor = if k == 0 { next / half } else { 2.0 * next / half };
            let before = if k == 0 { 0.0 } else { -(sigma * next) };
            let scales = Scales {
                factor: factor as f32,
                own: (-centre * factor) as f32,
                before: before as f32,
            };
            self.advance(parts, scales);
            sigma = next;
        }
    }

    /// Z ← `scales` of H Z, Z and what was there before it.
    fn advance(&mut self, parts: Parts, scales: Scales) {
        let Self { rows, vectors, other, width, .. } = self;
        let (z, width) = (&**vectors, *width);
        parts.run(Strided(&mut other[..], width), |range, to| {
            rows.step(range, scales, z, to.0, None, width);
        });
        std::mem::swap(vectors, other);
    }

    /// The Rayleigh–Ritz method for H on Z. Returns the number of independent columns; those after them
    /// are zero. `None` when there is none or values are not finite.
    fn ritz(&mut self, parts: Parts) -> Option<usize> {
        let scales = Scales { factor: 1.0, own: 0.0, before: 0.0 };
        let Self { rows, vectors, other, width, sums, symmetric, values, top, .. } = self;
        let (z, width) = (&**vectors, *width);
        let square = width * width;
        let scratch = 2 * CHUNK_ROWS * width;
        let out = Strided(&mut other[..], width);
        parts.sum(sums, 2 * square + scratch, out, |range, to, sums| {
            rows.step(range.clone(), scales, z, to.0, None, width);
            let own = &z[range.start * width..range.end * width];
            let (sums, scratch) = sums.split_at_mut(2 * square);
            let (gram, energy) = sums.split_at_mut(square);
            let (left, right) = scratch.split_at_mut(CHUNK_ROWS * width);
            let chunks = own.chunks(CHUNK_ROWS * width).zip(to.0.chunks(CHUNK_ROWS * width));
            for (own, image) in chunks {
                let own = in_double(own, left, width);
                add_upper_gram(own, own, gram);
                add_upper_gram(own, in_double(image, right, width), energy);
            }
        });
        mirror(&mut sums[..square], width);
        mirror(&mut sums[square..2 * square], width);
        let (gram, energy) = sums[..2 * square].split_at(square);
        let (change, kept) = whiten(symmetric, gram, energy, width, values)?;
        *top = top.max(values[0]);
        self.combine(parts, &change);
        Some(kept)
    }

    /// Makes the columns of Z orthonormal. Returns the number of independent ones; those after them are
    /// zero. `None` when there is none or values are not finite.
    fn orthonormalise(&mut self, parts: Parts) -> Option<usize> {
        let Self { vectors, width, sums, symmetric, .. } = self;
        let (z, width) = (&**vectors, *width);
        let square = width * width;
        parts.sum(sums, square + CHUNK_ROWS * width, (), |range, (), sums| {
            let (gram, scratch) = sums.split_at_mut(square);
            let own = &z[range.start * width..range.end * width];
            for own in own.chunks(CHUNK_ROWS * width) {
                let own = in_double(own, scratch, width);
                add_upper_gram(own, own, gram);
            }
        });
        mirror(&mut sums[..square], width);
        let (scales, basis, kept) = independent(symmetric, &sums[..square], width)?;
        let mut change = basis;
        for (row, scale) in change.chunks_exact_mut(width).zip(&scales) {
            row.iter_mut().for_each(|value| *value *= scale);
        }
        self.combine(parts, &change);
        Some(kept)
    }

    /// Replaces Z by its combinations `change`, width × width.
    fn combine(&mut self, parts: Parts, change: &[f64]) {
        let change: Vec<f32> = change.iter().map(|value| *value as f32).collect();
        let width = self.width;
        parts.run(Strided(&mut self.vectors[..], width), |_, rows| {
            rotate(rows.0, &change, width, &mut Vec::new());
        });
    }

    /// True when a triplet of value `sigma` or more may be outside of Z.
    pub(super) fn hides(
        &mut self,
        operator: &KatzOperator,
        parts: Parts,
        sigma: f64,
        seed: u64,
        [now, image, before]: &mut [Aligned<f32>; 3],
    ) -> bool {
        let least = sigma / (1.0 + sigma);
        // A negative eigenvalue λ of H has |λ|/(1 + |λ|).
        let negative = -self.low / (1.0 - self.low);
        if sigma.is_nan() || sigma <= 1.05 * negative || self.cut >= HIDDEN_LIMIT * least {
            return true;
        }
        if self.rows.asymmetry() <= NO_ASYMMETRY {
            return false;
        }
        // The largest singular values of αA on the complement of Z, by Chebyshev polynomials of its
        // square.
        let length = operator.nodes() * WIDTH;
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x41de);
        now[..length].fill_with(|| rng.random::<f32>() - 0.5);
        let cut = (self.cut * 1.01).max(HIDDEN_CUT * least);
        let half = 0.5 * cut * cut;
        let growth = (least * least / half - 1.0).acosh();
        let steps = ((HIDDEN_GROWTH * (operator.nodes() as f64).sqrt()).ln() / growth).ceil();
        // NaN counts as many.
        if !matches!(steps, steps if steps <= MAX_HIDDEN_STEPS) {
            return true;
        }
        let steps = steps as usize;
        self.project(parts, &mut now[..length], None);
        for k in 0..steps {
            self.square(operator, parts, &now[..length], &mut image[..length]);
            self.project(parts, &mut image[..length], None);
            // T₁ = x − 1 and Tₖ₊₁ = 2 (x − 1) Tₖ − Tₖ₋₁ for x = (αA)²/half.
            let (factor, own) = if k == 0 { (1.0, 1.0) } else { (2.0, 2.0) };
            let factor = (factor / half) as f32;
            let keeps = if k == 0 { 0.0 } else { 1.0 };
            let blocks = (&now[..length], &image[..length]);
            parts.run(Strided(&mut before[..length], WIDTH), |rows, to| {
                let own_rows = rows.start * WIDTH..rows.end * WIDTH;
                let values = blocks.0[own_rows.clone()].iter().zip(&blocks.1[own_rows]);
                for (to, (now, image)) in to.0.iter_mut().zip(values) {
                    let old = if keeps == 0.0 { 0.0 } else { *to };
                    *to = factor * image - own as f32 * now - old;
                }
            });
            std::mem::swap(now, before);
        }
        let (z, out) = (&now[..length], Strided(&mut image[..length], WIDTH));
        let square = WIDTH * WIDTH;
        parts.sum(&mut self.sums, 2 * square, out, |range, to, sums| {
            let forward = Orientation::Forward;
            operator.horner_step(forward, range.clone(), (0.0, 1.0), z, z, to.0, WIDTH);
            let own = &z[range.start * WIDTH..range.end * WIDTH];
            let (gram, energy) = sums.split_at_mut(square);
            add_gram(own, WIDTH, own, WIDTH, gram);
            add_gram(to.0, WIDTH, to.0, WIDTH, energy);
        });
        let (gram, energy) = self.sums[..2 * square].split_at(square);
        let mut values = Vec::new();
        let found = whiten(&mut self.symmetric, gram, energy, WIDTH, &mut values);
        found.is_none() || values[0].max(0.0).sqrt() >= HIDDEN_LIMIT * least
    }

    /// `out` = αAᵀ αA `z`, of a register of columns.
    fn square(&mut self, operator: &KatzOperator, parts: Parts, z: &[f32], out: &mut [f32]) {
        let image = &mut self.other[..z.len()];
        let steps = [(Orientation::Forward, true), (Orientation::Backward, false)];
        for (orientation, first) in steps {
            let (from, to) = if first { (z, &mut *image) } else { (&*image, &mut *out) };
            parts.run(Strided(to, WIDTH), |rows, to| {
                operator.horner_step(orientation, rows, (0.0, 1.0), from, from, to.0, WIDTH);
            });
        }
    }

    /// Subtracts from `block` what is along Z, and leaves the coefficients in `self.sums`, width × `wide`.
    /// With `shares` for each of them, so much of it is added instead.
    fn project(&mut self, parts: Parts, block: &mut [f32], shares: Option<&[f32]>) {
        let Self { vectors, width, sums, scratch, .. } = self;
        let (z, width) = (&**vectors, *width);
        let wide = block.len() / (z.len() / width);
        let shared = &*block;
        parts.sum(sums, width * wide, (), |range, (), sums| {
            let own = &z[range.start * width..range.end * width];
            add_gram(own, width, &shared[range.start * wide..range.end * wide], wide, sums);
        });
        scratch.clear();
        let along = sums[..width * wide].iter();
        match shares {
            Some(shares) => {
                scratch.extend(along.zip(shares).map(|(along, share)| share - *along as f32));
            }
            None => scratch.extend(along.map(|along| -*along as f32)),
        }
        let scratch = &*scratch;
        parts.run(Strided(block, wide), |range, rows| {
            add_product(&z[range.start * width..range.end * width], scratch, rows.0, wide);
        });
    }

    /// Writes corrections for the residuals in the first of `single`, n × `stride`, of triplets with
    /// the values `sigma`, to the last of them.
    pub(super) fn correct(
        &mut self,
        parts: Parts,
        sigma: &[f64],
        [residuals, next, out]: &mut [Aligned<f32>; 3],
        stride: usize,
    ) {
        let length = self.vectors.len() / self.width * stride;
        let (mut now, mut next, out) =
            (&mut residuals[..length], &mut next[..length], &mut out[..length]);
        self.project(parts, now, None);
        let (centre, half) = (0.5 * (self.cut + self.low), 0.5 * (self.cut - self.low));
        let mut shares = vec![0.0; self.width * stride];
        let mut coefficients = vec![0.0; (CORRECTION_DEGREE + 1) * stride];
        let nodes = Nodes::new();
        for (c, sigma) in sigma.iter().enumerate() {
            let inverse = Inverse::new(*sigma, self.low, self.cut, &nodes);
            for (j, value) in self.values.iter().enumerate() {
                let along = self.sums[j * stride + c];
                shares[j * stride + c] = (inverse.at_vector(*value) * along) as f32;
            }
            for k in 0..=CORRECTION_DEGREE {
                coefficients[k * stride + c] = inverse.coefficient(k, &nodes) as f32;
            }
        }
        let coefficient = |k: usize| &coefficients[k * stride..(k + 1) * stride];
        let start = &*now;
        parts.run(Strided(&mut *out, stride), |range, out| {
            let rows = start[range.start * stride..range.end * stride].chunks_exact(stride);
            for (out, row) in out.0.chunks_exact_mut(stride).zip(rows) {
                for ((out, value), scale) in out.iter_mut().zip(row).zip(coefficient(0)) {
                    *out = scale * value;
                }
            }
        });
        let rows = &self.rows;
        for k in 1..=CORRECTION_DEGREE {
            let twice = if k == 1 { 1.0 } else { 2.0 };
            let scales = Scales {
                factor: (twice / half) as f32,
                own: (-twice * centre / half) as f32,
                before: if k == 1 { 0.0 } else { -1.0 },
            };
            let (z, coefficients) = (&*now, coefficient(k));
            let blocks = (Strided(&mut *next, stride), Strided(&mut *out, stride));
            parts.run(blocks, |range, (to, out)| {
                rows.step(range, scales, z, to.0, Some((coefficients, out.0)), stride);
            });
            std::mem::swap(&mut now, &mut next);
        }
        self.project(parts, out, Some(&shares));
    }
}
