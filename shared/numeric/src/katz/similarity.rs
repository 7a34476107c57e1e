//! Katz similarity of all pairs of nodes, and a probe of its accuracy.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::alpha::check_alpha;
use super::error::KatzError;
use super::scaling::{katz_scales, powers_of_two};
use super::walks::sum_of_walks;
use crate::linalg::backend::dense::solve_lu;
use crate::linalg::matrix::{DenseMatrix, MAX_ENTRY, MatrixError, SparseMatrix};
use crate::linalg::vector::dot;
use crate::radius::exact::SpectralRadius;

/// Largest [`katz_probe`] of a similarity that counts as right. Elimination on a well scaled system
/// leaves 1e-15 or less; a wrong similarity is off by 1e-6 and more.
pub const MAX_KATZ_PROBE: f64 = 1e-11;

/// Seed of the probe of each solution.
const PROBE_SEED: u64 = 0x6b61_747a;

/// Katz similarity S of the n × n graph `a`, a dense non-negative n × n matrix.
///
/// `radius` must be the spectral radius of the same graph. S solves (I − αA) S = αA, by LU with
/// partial pivoting: subtracting I from the inverse would cancel ten digits where αρ is small. The
/// system is scaled first, so that strong chains next to weak cycles lose no digits. Rounding
/// errors below zero are set to zero, since S ≥ 0.
///
/// [`katz_probe`] looks at the solution. Where weights span so many orders of magnitude that
/// elimination loses all digits, S is the sum of all walks instead, without any subtraction; that
/// takes about ten times as long.
///
/// # Errors
/// [`KatzError::Alpha`] and [`KatzError::Diverges`] for an inadmissible α, [`KatzError::Matrix`]
/// when n² entries are too many, [`KatzError::Overflow`] when S is out of range,
/// [`KatzError::Inexact`] when the probe of neither is below [`MAX_KATZ_PROBE`].
pub fn katz_similarity(
    a: &SparseMatrix,
    alpha: f64,
    radius: &SpectralRadius,
) -> Result<DenseMatrix, KatzError> {
    check_alpha(alpha, radius.upper)?;
    // Only an acyclic graph admits an α so large that even αA is out of range.
    if alpha * a.max_weight() > MAX_ENTRY {
        return Err(KatzError::Overflow { alpha });
    }
    if let Some(s) = eliminate(a, alpha, radius)?
        && katz_probe(a, alpha, &s, PROBE_SEED)? <= MAX_KATZ_PROBE
    {
        return Ok(s);
    }
    let s = sum_of_walks(a, alpha)?.ok_or(KatzError::Overflow { alpha })?;
    match katz_probe(a, alpha, &s, PROBE_SEED)? {
        probe if probe <= MAX_KATZ_PROBE => Ok(s),
        probe => Err(KatzError::Inexact { alpha, probe }),
    }
}

/// S by elimination; `None` when an entry is not finite.
fn eliminate(
    a: &SparseMatrix,
    alpha: f64,
    radius: &SpectralRadius,
) -> Result<Option<DenseMatrix>, KatzError> {
    let n = a.nodes();
    let mut scales = katz_scales(a, alpha, &radius.vector);
    let (left, _) = scaled_system(a, alpha, &scales)?;
    // Katz centrality, the solution of (I − αA) x = 1, gives tighter scales than any bound.
    let ones = DenseMatrix::from_fn(n, 1, |i, _| 1.0 / scales[i]);
    if let Some(z) = solve_lu(&left, &ones) {
        let centrality = (0..n).map(|i| z.at(i, 0) * scales[i]).collect();
        scales = powers_of_two(centrality).unwrap_or(scales);
    }
    let (left, right) = scaled_system(a, alpha, &scales)?;
    let Some(scaled) = solve_lu(&left, &right) else {
        return Ok(None);
    };
    let unscaled = |(at, value): (usize, f64)| {
        if value > 0.0 { value * (scales[at / n] / scales[at % n]) } else { 0.0 }
    };
    let data = scaled.into_data().into_iter().enumerate().map(unscaled).collect();
    Ok(DenseMatrix::new(n, n, data).ok())
}

/// The two sides I − B and B of the system for B = αD⁻¹AD with D = diag(`scales`).
fn scaled_system(
    a: &SparseMatrix,
    alpha: f64,
    scales: &[f64],
) -> Result<(DenseMatrix, DenseMatrix), MatrixError> {
    let n = a.nodes();
    let mut right = DenseMatrix::zeros(n, n)?;
    for (i, j, weight) in a.triplets() {
        right.row_mut(i)[j] = alpha * weight * (scales[j] / scales[i]);
    }
    let left = DenseMatrix::from_fn(n, n, |i, j| f64::from(u8::from(i == j)) - right.at(i, j));
    Ok((left, right))
}

/// Accuracy of `s` as the Katz similarity of `a`, from a random vector z of ±1 drawn from `seed`: the
/// largest entry of |S z − B z − B S z| with B = αA, relative to what rounding is relative to, the
/// same entry of S1 + B1 + BS1 (Oettli and Prager, Numer. Math. 6, 1964), where rows that are small
/// next to the largest count as m/(1 + m) with its sum m. About 1e-16 when `s` is right, however
/// ill-conditioned I − B is; since its inverse is not negative, sums of rows of S are then off by
/// hardly more, times the mean length of the walks. Costs O(n²). It samples the error and does not
/// bound it. 0 for an empty graph, infinite where an entry is.
///
/// # Errors
/// [`KatzError::Shape`] when `s` is not n × n.
pub fn katz_probe(
    a: &SparseMatrix,
    alpha: f64,
    s: &DenseMatrix,
    seed: u64,
) -> Result<f64, KatzError> {
    let n = a.nodes();
    if s.rows() != n || s.cols() != n {
        return Err(KatzError::Shape { rows: s.rows(), cols: s.cols(), nodes: n });
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let sign = |_| if rng.random::<bool>() { 1.0 } else { -1.0 };
    let z: Vec<f64> = (0..n).map(sign).collect();
    let ones = vec![1.0; n];
    let image = |x: &[f64]| s.iter_rows().map(|row| dot(row, x)).collect::<Vec<_>>();
    let (signed, whole) = (image(&z), image(&ones));
    let largest = whole.iter().fold(0.0_f64, |top, sum| sum.max(top));
    let least = largest / (1.0 + largest);
    let mut worst = 0.0_f64;
    for i in 0..n {
        let (mut off, mut size) = (signed[i], whole[i] + least);
        for (j, w) in a.row(i) {
            off -= alpha * w * (z[j] + signed[j]);
            size += alpha * w * (1.0 + whole[j]);
        }
        let relative = if off == 0.0 { 0.0 } else { off.abs() / size };
        // NaN is no accuracy.
        worst = if relative.is_nan() { f64::INFINITY } else { worst.max(relative) };
    }
    Ok(worst)
}
