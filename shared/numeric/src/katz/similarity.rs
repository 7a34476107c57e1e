//! Katz similarity of all pairs of nodes, by elimination, and a probe of its accuracy.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::alpha::check_alpha;
use super::error::KatzError;
use super::scaling::{katz_scales, powers_of_two};
use crate::linalg::backend::dense::solve_lu;
use crate::linalg::matrix::{DenseMatrix, MAX_ENTRY, MatrixError, SparseMatrix};
use crate::linalg::vector::dot;
use crate::radius::exact::SpectralRadius;

/// Katz similarity S of the n × n graph `a`, a dense non-negative n × n matrix.
///
/// `radius` must be the spectral radius of the same graph. S solves (I − αA) S = αA, by LU with
/// partial pivoting: subtracting I from the inverse would cancel ten digits where αρ is small. The
/// system is scaled first, so that strong chains next to weak cycles lose no digits. Rounding
/// errors below zero are set to zero, since S ≥ 0.
///
/// # Errors
/// [`KatzError::Alpha`] and [`KatzError::Diverges`] for an inadmissible α, [`KatzError::Matrix`]
/// when n² entries are too many, [`KatzError::Overflow`] when S is out of range.
pub fn katz_similarity(
    a: &SparseMatrix,
    alpha: f64,
    radius: &SpectralRadius,
) -> Result<DenseMatrix, KatzError> {
    check_alpha(alpha, radius.upper)?;
    let n = a.nodes();
    let overflow = KatzError::Overflow { alpha };
    // Only an acyclic graph admits an α so large that even αA is out of range.
    if alpha * a.max_weight() > MAX_ENTRY {
        return Err(overflow);
    }
    let mut scales = katz_scales(a, alpha, &radius.vector);
    let (left, _) = scaled_system(a, alpha, &scales)?;
    // Katz centrality, the solution of (I − αA) x = 1, gives tighter scales than any bound.
    let ones = DenseMatrix::from_fn(n, 1, |i, _| 1.0 / scales[i]);
    if let Some(z) = solve_lu(&left, &ones) {
        let centrality = (0..n).map(|i| z.at(i, 0) * scales[i]).collect();
        scales = powers_of_two(centrality).unwrap_or(scales);
    }
    let (left, right) = scaled_system(a, alpha, &scales)?;
    let scaled = solve_lu(&left, &right).ok_or(overflow.clone())?;
    let unscaled = |(at, value): (usize, f64)| {
        if value > 0.0 { value * (scales[at / n] / scales[at % n]) } else { 0.0 }
    };
    let data = scaled.into_data().into_iter().enumerate().map(unscaled).collect();
    DenseMatrix::new(n, n, data).map_err(|_| overflow)
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

/// Accuracy of `s` as the Katz similarity of `a`: ‖M (S + I) z − z‖ / ‖z‖ with M = I − αA and a
/// random vector z of ±1 drawn from `seed`; about 1e-16 times the condition of M when `s` is right.
/// Costs O(n²). It samples the error and does not bound it. 0 for an empty graph.
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
    if n == 0 {
        return Ok(0.0);
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let sign = |_| if rng.random::<bool>() { 1.0 } else { -1.0 };
    let z: Vec<f64> = (0..n).map(sign).collect();
    let y: Vec<f64> = (0..n).map(|i| dot(s.row(i), &z) + z[i]).collect();
    let walked = a.mat_vec(&y)?;
    let error = (0..n).map(|i| (y[i] - alpha * walked[i] - z[i]).powi(2));
    Ok((error.sum::<f64>() / n as f64).sqrt())
}
