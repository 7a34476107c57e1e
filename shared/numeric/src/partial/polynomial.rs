//! The preconditioner: a polynomial in αA for (I − αA)⁻¹, in single precision.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::aligned::Aligned;
use crate::operator::{KatzOperator, Orientation};
use crate::panels::dispatch;
use crate::share::{Parts, Strided};
use crate::tall::{CHUNK, REGISTER};

/// Degree of the polynomial: with a lower one, rounds get more, with a higher one, dearer.
const DEGREE: usize = 3;

/// Random vectors that it is fitted to: a register of them.
const SAMPLES: usize = REGISTER;

/// Powers of αA times the samples that the fit needs.
const POWERS: usize = DEGREE + 2;

/// Vectors that the fit needs room for.
pub(super) const FIT_COLUMNS: usize = POWERS * SAMPLES;

/// Searches after which the polynomial is fitted anew: it is a help only, and graphs change little
/// from frame to frame.
const LASTS: u32 = 20;

/// Change of α, relative, from which it is fitted anew at once.
const OTHER_DECAY: f64 = 0.05;

/// Columns of a block in single precision are a multiple of this: the numbers in a largest register.
pub(super) const SINGLE_REGISTER: usize = 2 * REGISTER;

/// p(B) ≈ (I − B)⁻¹.
#[derive(Debug, Default)]
pub(super) struct Polynomial {
    /// From the constant on.
    coefficients: [f64; DEGREE + 1],
    nodes: usize,
    alpha: f64,
    /// Searches that it is still to serve.
    left: u32,
}

impl Polynomial {
    /// Fits the polynomial for which p(B) comes nearest to (I − B)⁻¹ on a few random vectors, B = αA:
    /// that of GMRES (Embree, Loe and Morgan, SIAM J. Sci. Comput. 43, 2021). It fits any spectrum, also
    /// that of directed graphs. Does nothing while the one that is there will do. `scratch` has room for
    /// [`FIT_COLUMNS`] vectors.
    pub(super) fn fit(
        &mut self,
        operator: &KatzOperator,
        parts: Parts,
        seed: u64,
        scratch: &mut [f64],
        sums: &mut Vec<f64>,
    ) {
        let (n, alpha) = (operator.nodes(), operator.alpha());
        let near = (alpha - self.alpha).abs() <= OTHER_DECAY * self.alpha;
        if self.left > 0 && self.nodes == n && near {
            self.left -= 1;
            return;
        }
        (self.nodes, self.alpha, self.left) = (n, alpha, LASTS);
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x9e37);
        let (first, mut rest) = scratch[..n * FIT_COLUMNS].split_at_mut(n * SAMPLES);
        first.fill_with(|| rng.random::<f64>() - 0.5);
        let mut powers: [&[f64]; POWERS] = [first; POWERS];
        for k in 1..POWERS {
            let (next, others) = rest.split_at_mut(n * SAMPLES);
            parts.run(Strided(&mut *next, SAMPLES), |rows, next| {
                let (forward, width) = (Orientation::Forward, SAMPLES);
                operator.multiply(forward, rows, powers[k - 1], width, width, next.0, width, 0);
            });
            powers[k] = next;
            rest = others;
        }
        parts.sum(sums, POWERS * POWERS, (), |rows, (), sums| {
            dispatch(|| {
                let registers = powers.map(|power| power.as_chunks::<SAMPLES>().0);
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
        let mut system = [[0.0; DEGREE + 1]; DEGREE + 1];
        let mut right = [0.0; DEGREE + 1];
        for (i, (row, right)) in system.iter_mut().zip(&mut right).enumerate() {
            for (j, entry) in row.iter_mut().enumerate() {
                *entry = p(i, j) - p(i + 1, j) - p(i, j + 1) + p(i + 1, j + 1);
            }
            *right = p(i, 0) - p(i + 1, 0);
        }
        self.coefficients = solve_small(system, right);
    }

    /// Writes to `block`, n × `width`, about (M Mᵀ)⁻¹ r for the residuals r in the first of `single`,
    /// rows of `width` numbers rounded up to a multiple of [`SINGLE_REGISTER`].
    pub(super) fn apply(
        &self,
        operator: &KatzOperator,
        parts: Parts,
        single: &mut [Aligned<f32>; 3],
        block: &mut [f64],
        width: usize,
    ) {
        let n = operator.nodes();
        let stride = width.next_multiple_of(SINGLE_REGISTER);
        let [r, z, next] = single;
        let (mut r, mut z, mut next) =
            (&mut r[..n * stride], &mut z[..n * stride], &mut next[..n * stride]);
        let c = self.coefficients.map(|coefficient| coefficient as f32);
        for orientation in [Orientation::Backward, Orientation::Forward] {
            for k in (0..DEGREE).rev() {
                // The first step begins with the last coefficient times r.
                let first = k == DEGREE - 1;
                let last = k == 0 && orientation == Orientation::Forward;
                let (from, to) = if first { (&*r, &mut *z) } else { (&*z, &mut *next) };
                let scales = (c[k], if first { c[DEGREE] } else { 1.0 });
                let out = (Strided(to, stride), Strided(&mut *block, width));
                parts.run(out, |rows, (to, block)| {
                    let chunks = to.0.chunks_mut(CHUNK * stride);
                    let chunks = chunks.zip(block.0.chunks_mut(CHUNK * width));
                    for (start, (to, block)) in rows.clone().step_by(CHUNK).zip(chunks) {
                        let rows = start..(start + CHUNK).min(rows.end);
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

/// The first `width` of each row of `stride` numbers.
pub(super) fn to_double(from: &[f32], stride: usize, to: &mut [f64], width: usize) {
    dispatch(|| {
        for (to, from) in to.chunks_exact_mut(width).zip(from.chunks_exact(stride)) {
            for (to, from) in to.iter_mut().zip(from) {
                *to = f64::from(*from);
            }
        }
    });
}

/// Solves a small symmetric positive semidefinite system by elimination; directions that are lost in
/// rounding get nothing.
fn solve_small<const N: usize>(mut system: [[f64; N]; N], mut right: [f64; N]) -> [f64; N] {
    let top = (0..N).map(|i| system[i][i]).fold(0.0, f64::max);
    for k in 0..N {
        let pivot = system[k][k];
        // Written so that a pivot that is no number counts as lost too.
        if !matches!(pivot, p if p > 1e-14 * top) {
            for i in k..N {
                right[i] = 0.0;
                system[i] = [0.0; N];
                system[i][i] = 1.0;
            }
            break;
        }
        for i in k + 1..N {
            let factor = system[i][k] / pivot;
            let upper = system[k];
            for (value, upper) in system[i].iter_mut().zip(upper).skip(k) {
                *value -= factor * upper;
            }
            right[i] -= factor * right[k];
        }
    }
    let mut solution = [0.0; N];
    for i in (0..N).rev() {
        let known: f64 = (i + 1..N).map(|j| system[i][j] * solution[j]).sum();
        solution[i] = (right[i] - known) / system[i][i];
    }
    solution
}
