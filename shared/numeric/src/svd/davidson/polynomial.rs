//! The preconditioner: a polynomial in αA for (I − αA)⁻¹, in single precision.

use std::ops::RangeInclusive;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::linalg::Aligned;
use crate::linalg::block_vectors::{CHUNK_ROWS, COLUMN_MULTIPLE};
use crate::linalg::parallel::{Parts, Strided};
use crate::linalg::simd::dispatch;
use crate::linalg::single_block::SINGLE_COLUMN_MULTIPLE;
use crate::svd::operator::{KatzOperator, Orientation};

/// Largest degree of the polynomial for most graphs.
const USUAL_DEGREE: usize = 4;

/// Largest degree where walks grow for several steps before they fade, as in command trees with weak
/// links back.
const MAX_DEGREE: usize = 14;

/// Least degree that is tried.
const MIN_DEGREE: usize = 2;

/// Error of a polynomial on random vectors, relative to their length, that is good enough: with
/// more, the additional rounds cost more than a higher degree. With less, the available directions
/// limit the rounds.
const MAX_FIT_ERROR: f64 = 0.005;

/// Error with [`USUAL_DEGREE`] from which higher degrees are tried. Below, more rounds cost less than
/// a higher degree in each of them.
const BAD_FIT_ERROR: f64 = 0.25;

/// Error with [`MAX_DEGREE`] from which the inverse itself takes the place of the polynomial.
const POOR_FIT_ERROR: f64 = 0.05;

/// Random vectors of the fit: one register of them.
const SAMPLE_VECTORS: usize = COLUMN_MULTIPLE;

/// Powers of αA times the samples that a fit of the largest degree needs.
const MAX_POWERS: usize = MAX_DEGREE + 2;

/// Powers that a fit of the usual degree needs.
const USUAL_POWERS: usize = USUAL_DEGREE + 2;

/// Vectors that the usual fit needs room for.
pub(super) const FIT_COLUMNS: usize = USUAL_POWERS * SAMPLE_VECTORS;

/// Searches that one fit serves: it only speeds up the search, and graphs change little from frame
/// to frame.
const FIT_SEARCHES: u32 = 20;

/// Relative change of α above which the polynomial is fitted again at once.
const MAX_DECAY_CHANGE: f64 = 0.05;

/// p(B) ≈ (I − B)⁻¹.
#[derive(Debug, Default)]
pub(super) struct Polynomial {
    /// Coefficients from the constant on.
    coefficients: [f64; MAX_DEGREE + 1],
    degree: usize,
    /// Error of the fit on random vectors, relative to their length.
    error: f64,
    nodes: usize,
    alpha: f64,
    /// Searches that the fit still serves.
    left: u32,
}

impl Polynomial {
    /// Fits the polynomial for which p(B) is closest to (I − B)⁻¹ on a few random vectors, B = αA:
    /// that of GMRES (Embree, Loe and Morgan, SIAM J. Sci. Comput. 43, 2021). It suits any
    /// spectrum, also those of directed graphs. Does nothing while the present one serves.
    /// `scratch` has room for [`FIT_COLUMNS`] vectors.
    pub(super) fn fit(
        &mut self,
        operator: &KatzOperator,
        parts: Parts,
        seed: u64,
        scratch: &mut [f64],
        sums: &mut Vec<f64>,
    ) {
        let (n, alpha) = (operator.nodes(), operator.alpha());
        let near = (alpha - self.alpha).abs() <= MAX_DECAY_CHANGE * self.alpha;
        if self.left > 0 && self.nodes == n && near {
            self.left -= 1;
            return;
        }
        (self.nodes, self.alpha, self.left) = (n, alpha, FIT_SEARCHES);
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x9e37);
        let block = n * SAMPLE_VECTORS;
        let usual = &mut scratch[..n * FIT_COLUMNS];
        usual[..block].fill_with(|| rng.random::<f64>() - 0.5);
        extend_powers(operator, parts, usual, 1);
        self.choose(parts, usual, sums, MIN_DEGREE..=USUAL_DEGREE);
        // Written so that NaN is bad too.
        if matches!(self.error, error if error <= BAD_FIT_ERROR) {
            return;
        }
        let mut all = vec![0.0; MAX_POWERS * block];
        all[..usual.len()].copy_from_slice(usual);
        extend_powers(operator, parts, &mut all, USUAL_POWERS);
        self.choose(parts, &all, sums, USUAL_DEGREE + 1..=MAX_DEGREE);
    }

    /// True when a polynomial was fitted to a graph of as many nodes.
    pub(super) fn serves(&self, operator: &KatzOperator) -> bool {
        self.degree > 0 && self.nodes == operator.nodes()
    }

    /// True when not even the largest degree is near (I − B)⁻¹.
    pub(super) fn is_poor(&self) -> bool {
        self.degree > USUAL_DEGREE && !matches!(self.error, error if error <= POOR_FIT_ERROR)
    }

    /// Chooses the lowest of the degrees with a good fit, or else the largest. `powers`
    /// holds the samples and as many powers of B times them as the largest degree needs.
    fn choose(
        &mut self,
        parts: Parts,
        powers: &[f64],
        sums: &mut Vec<f64>,
        degrees: RangeInclusive<usize>,
    ) {
        let count = degrees.end() + 2;
        let mut blocks: [&[[f64; SAMPLE_VECTORS]]; MAX_POWERS] = [&[]; MAX_POWERS];
        for (block, power) in blocks.iter_mut().zip(powers.chunks_exact(powers.len() / count)) {
            *block = power.as_chunks::<SAMPLE_VECTORS>().0;
        }
        parts.sum(sums, count * count, (), |rows, (), sums| {
            dispatch(|| {
                for row in rows.clone() {
                    for i in 0..count {
                        for j in 0..=i {
                            let terms = blocks[i][row].iter().zip(&blocks[j][row]);
                            sums[i * count + j] += terms.map(|(a, b)| a * b).sum::<f64>();
                        }
                    }
                }
            })
        });
        let p = |i: usize, j: usize| sums[i.max(j) * count + i.min(j)];
        // Normal equations for the columns Bᵏ b − Bᵏ⁺¹ b.
        let mut system = [[0.0; MAX_DEGREE + 1]; MAX_DEGREE + 1];
        let mut right = [0.0; MAX_DEGREE + 1];
        for (i, (row, right)) in system.iter_mut().zip(&mut right).enumerate().take(count - 1) {
            for (j, entry) in row.iter_mut().enumerate().take(count - 1) {
                *entry = p(i, j) - p(i + 1, j) - p(i, j + 1) + p(i + 1, j + 1);
            }
            *right = p(i, 0) - p(i + 1, 0);
        }
        for degree in degrees {
            let coefficients = solve_small(system, right, degree + 1);
            // Squared error: ‖b‖² minus the squared length of the fit.
            let fitted: f64 = coefficients.iter().zip(&right).map(|(c, right)| c * right).sum();
            let error = ((p(0, 0) - fitted).max(0.0) / p(0, 0)).sqrt();
            (self.degree, self.coefficients, self.error) = (degree, coefficients, error);
            if error <= MAX_FIT_ERROR {
                break;
            }
        }
    }

    /// Writes approximately (M Mᵀ)⁻¹ r to `block`, n × `width`, for the residuals r in the first of
    /// `single`, rows of `width` numbers rounded up to a multiple of [`SINGLE_COLUMN_MULTIPLE`].
    pub(super) fn apply(
        &self,
        operator: &KatzOperator,
        parts: Parts,
        single: &mut [Aligned<f32>; 3],
        block: &mut [f64],
        width: usize,
    ) {
        let n = operator.nodes();
        let stride = width.next_multiple_of(SINGLE_COLUMN_MULTIPLE);
        let [r, z, next] = single;
        let (mut r, mut z, mut next) =
            (&mut r[..n * stride], &mut z[..n * stride], &mut next[..n * stride]);
        let c = self.coefficients.map(|coefficient| coefficient as f32);
        for orientation in [Orientation::Backward, Orientation::Forward] {
            for k in (0..self.degree).rev() {
                // The first step uses the last coefficient times r.
                let first = k + 1 == self.degree;
                let last = k == 0 && orientation == Orientation::Forward;
                let (from, to) = if first { (&*r, &mut *z) } else { (&*z, &mut *next) };
                let scales = (c[k], if first { c[self.degree] } else { 1.0 });
                let out = (Strided(to, stride), Strided(&mut *block, width));
                parts.run(out, |rows, (to, block)| {
                    let chunks = to.0.chunks_mut(CHUNK_ROWS * stride);
                    let chunks = chunks.zip(block.0.chunks_mut(CHUNK_ROWS * width));
                    for (start, (to, block)) in rows.clone().step_by(CHUNK_ROWS).zip(chunks) {
                        let rows = start..(start + CHUNK_ROWS).min(rows.end);
                        operator.horner_step(orientation, rows, scales, r, from, to, stride);
                        if last {
                            to_double(to, stride, block, width);
                        }
                    }
                });
                if !first {
                    std::mem::swap(&mut z, &mut next);
                }
            }
            std::mem::swap(&mut r, &mut z);
        }
    }
}

/// Fills the powers of B times the samples from the power `from` on; those before are known.
fn extend_powers(operator: &KatzOperator, parts: Parts, powers: &mut [f64], from: usize) {
    let block = operator.nodes() * SAMPLE_VECTORS;
    let (known, new) = powers.split_at_mut(from * block);
    let mut last: &[f64] = &known[(from - 1) * block..];
    for next in new.chunks_exact_mut(block.max(1)) {
        parts.run(Strided(&mut *next, SAMPLE_VECTORS), |rows, next| {
            let (forward, width) = (Orientation::Forward, SAMPLE_VECTORS);
            operator.multiply(forward, rows, last, width, width, next.0, width, 0);
        });
        last = next;
    }
}

/// Converts the first `width` numbers of each row of `stride`.
pub(super) fn to_double(from: &[f32], stride: usize, to: &mut [f64], width: usize) {
    dispatch(|| {
        for (to, from) in to.chunks_exact_mut(width).zip(from.chunks_exact(stride)) {
            for (to, from) in to.iter_mut().zip(from) {
                *to = f64::from(*from);
            }
        }
    });
}

/// Solves the first `n` equations, for as many unknowns, of a small symmetric positive semidefinite
/// system by elimination. Other unknowns, and directions lost in rounding, are zero.
fn solve_small<const N: usize>(
    mut system: [[f64; N]; N],
    mut right: [f64; N],
    n: usize,
) -> [f64; N] {
    let top = (0..n).map(|i| system[i][i]).fold(0.0, f64::max);
    for k in 0..n {
        let pivot = system[k][k];
        // NaN counts as lost too.
        if !matches!(pivot, p if p > 1e-14 * top) {
            for i in k..n {
                right[i] = 0.0;
                system[i] = [0.0; N];
                system[i][i] = 1.0;
            }
            break;
        }
        for i in k + 1..n {
            let factor = system[i][k] / pivot;
            let upper = system[k];
            for (value, upper) in system[i].iter_mut().zip(upper).skip(k) {
                *value -= factor * upper;
            }
            right[i] -= factor * right[k];
        }
    }
    let mut solution = [0.0; N];
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|j| system[i][j] * solution[j]).sum();
        solution[i] = (right[i] - known) / system[i][i];
    }
    solution
}
