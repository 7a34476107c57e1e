//! The preconditioner: a polynomial in αA for (I − αA)⁻¹, in single precision.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::linalg::Aligned;
use crate::linalg::block_vectors::{CHUNK_ROWS, COLUMN_MULTIPLE};
use crate::linalg::parallel::{Parts, Strided};
use crate::linalg::simd::dispatch;
use crate::svd::operator::{KatzOperator, Orientation};

/// Largest degree of the polynomial.
const MAX_DEGREE: usize = 4;

/// Least degree that is tried.
const MIN_DEGREE: usize = 2;

/// Error of a polynomial on random vectors, relative to their length, that is good enough: with
/// more, the additional rounds cost more than a higher degree. With less, the available directions
/// limit the rounds.
const MAX_FIT_ERROR: f64 = 0.005;

/// Random vectors of the fit: one register of them.
const SAMPLE_VECTORS: usize = COLUMN_MULTIPLE;

/// Powers of αA times the samples that the fit needs.
const POWERS: usize = MAX_DEGREE + 2;

/// Vectors that the fit needs room for.
pub(super) const FIT_COLUMNS: usize = POWERS * SAMPLE_VECTORS;

/// Searches that one fit serves: it only speeds up the search, and graphs change little from frame
/// to frame.
const FIT_SEARCHES: u32 = 20;

/// Relative change of α above which the polynomial is fitted again at once.
const MAX_DECAY_CHANGE: f64 = 0.05;

/// Columns of a block in single precision are a multiple of this: the floats of the widest
/// registers.
pub(super) const SINGLE_COLUMN_MULTIPLE: usize = 2 * COLUMN_MULTIPLE;

/// p(B) ≈ (I − B)⁻¹.
#[derive(Debug, Default)]
pub(super) struct Polynomial {
    /// Coefficients from the constant on.
    coefficients: [f64; MAX_DEGREE + 1],
    degree: usize,
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
        let (first, mut rest) = scratch[..n * FIT_COLUMNS].split_at_mut(n * SAMPLE_VECTORS);
        first.fill_with(|| rng.random::<f64>() - 0.5);
        let mut powers: [&[f64]; POWERS] = [first; POWERS];
        for k in 1..POWERS {
            let (next, others) = rest.split_at_mut(n * SAMPLE_VECTORS);
            parts.run(Strided(&mut *next, SAMPLE_VECTORS), |rows, next| {
                let (forward, width) = (Orientation::Forward, SAMPLE_VECTORS);
                operator.multiply(forward, rows, powers[k - 1], width, width, next.0, width, 0);
            });
            powers[k] = next;
            rest = others;
        }
        parts.sum(sums, POWERS * POWERS, (), |rows, (), sums| {
            dispatch(|| {
                let registers = powers.map(|power| power.as_chunks::<SAMPLE_VECTORS>().0);
                for row in rows.clone() {
                    for i in 0..POWERS {
                        for j in 0..=i {
                            let terms = registers[i][row].iter().zip(&registers[j][row]);
                            sums[i * POWERS + j] += terms.map(|(a, b)| a * b).sum::<f64>();
                        }
                    }
                }
            })
        });
        let p = |i: usize, j: usize| sums[i.max(j) * POWERS + i.min(j)];
        // Normal equations for the columns Bᵏ b − Bᵏ⁺¹ b.
        let mut system = [[0.0; MAX_DEGREE + 1]; MAX_DEGREE + 1];
        let mut right = [0.0; MAX_DEGREE + 1];
        for (i, (row, right)) in system.iter_mut().zip(&mut right).enumerate() {
            for (j, entry) in row.iter_mut().enumerate() {
                *entry = p(i, j) - p(i + 1, j) - p(i, j + 1) + p(i + 1, j + 1);
            }
            *right = p(i, 0) - p(i + 1, 0);
        }
        for degree in MIN_DEGREE..=MAX_DEGREE {
            self.degree = degree;
            self.coefficients = solve_small(system, right, degree + 1);
            // Squared error: ‖b‖² minus the squared length of the fit.
            let fitted: f64 =
                self.coefficients.iter().zip(&right).map(|(c, right)| c * right).sum();
            if p(0, 0) - fitted <= MAX_FIT_ERROR * MAX_FIT_ERROR * p(0, 0) {
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
