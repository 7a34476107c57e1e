//! Katz similarity of all pairs of nodes.
//!
//! S = Σ_{l ≥ 1} αˡ Aˡ = (I − αA)⁻¹ − I (Katz, Psychometrika 18, 1953; equations 1 to 3 of the
//! paper): the weight of all walks from i to j, each step damped by α. The series converges if
//! and only if α ρ(A) < 1. Slightly beyond, I − αA can still be inverted, but the result is full
//! of negative numbers and no similarity any more; it is refused.

pub use muster_model::settings::Alpha;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use thiserror::Error;

use crate::backend::solve_lu;
use crate::matrix::{DenseMatrix, MatrixError, SparseMatrix};
use crate::norm::spectral_norm;
use crate::scaling::{katz_scales, powers_of_two};
use crate::spectral_radius::SpectralRadius;

/// Why no Katz similarity could be computed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum KatzError {
    /// α is not a positive finite number.
    #[error("decay {0} is not a positive number")]
    Alpha(f64),
    /// The fraction is not strictly between 0 and 1.
    #[error("fraction {0} is not strictly between 0 and 1")]
    Fraction(f64),
    /// α ρ(A) is not certified to be below 1.
    #[error(
        "decay {alpha} is too large: with spectral radius {radius} their product must stay below 1"
    )]
    Diverges {
        /// The decay α.
        alpha: f64,
        /// Upper bound of the spectral radius ρ(A).
        radius: f64,
    },
    /// The system could not be solved in floating point (entries out of range).
    #[error("the Katz matrix for decay {alpha} leaves the range of floating point numbers")]
    Overflow {
        /// The decay α.
        alpha: f64,
    },
    /// S does not have the shape of A.
    #[error("a {rows} × {cols} similarity does not belong to a graph of {nodes} nodes")]
    Shape {
        /// Rows of S.
        rows: usize,
        /// Columns of S.
        cols: usize,
        /// Nodes of A.
        nodes: usize,
    },
    /// There is no such node.
    #[error("node {node} is not one of {nodes}")]
    Node {
        /// The node.
        node: usize,
        /// Nodes of A.
        nodes: usize,
    },
    /// The graph is too large for a dense matrix.
    #[error(transparent)]
    Matrix(#[from] MatrixError),
}

/// The decay α for the graph `a` whose spectral radius is `radius`. α has the inverse unit of the weights
/// of A.
///
/// A fraction f gives α = f/ρ, with the upper bound of ρ to stay on the safe side. Acyclic
/// graphs have ρ = 0 and admit every α; the fraction is then taken of 1/‖A‖₂, which has the
/// same unit and equals 1/ρ for symmetric graphs. Without any edge α = f.
///
/// # Errors
/// [`KatzError::Fraction`], [`KatzError::Alpha`] or [`KatzError::Diverges`].
pub fn resolve_alpha(
    alpha: Alpha,
    a: &SparseMatrix,
    radius: &SpectralRadius,
) -> Result<f64, KatzError> {
    let alpha = match alpha {
        Alpha::Value(value) => value,
        Alpha::Fraction { fraction: f } if !(f > 0.0 && f < 1.0) => {
            return Err(KatzError::Fraction(f));
        }
        Alpha::Fraction { fraction: f } if radius.upper > 0.0 => f / radius.upper,
        Alpha::Fraction { fraction: f } if a.is_zero() => f,
        Alpha::Fraction { fraction: f } => f / spectral_norm(a),
    };
    check_alpha(alpha, radius.upper)?;
    Ok(alpha)
}

/// Refuses α unless it is positive, finite and certified to let the series converge by the upper
/// bound `radius` of ρ.
pub(crate) fn check_alpha(alpha: f64, radius: f64) -> Result<(), KatzError> {
    if !(alpha.is_finite() && alpha > 0.0) {
        return Err(KatzError::Alpha(alpha));
    }
    let product = alpha * radius;
    if product.is_nan() || product >= 1.0 {
        return Err(KatzError::Diverges { alpha, radius });
    }
    Ok(())
}

/// Katz similarity S of the n × n graph `a`, a dense non-negative n × n matrix.
///
/// `radius` must be the spectral radius of the same graph. S is computed as the solution of
/// (I − αA) S = αA by LU with partial pivoting: subtracting I from the inverse would cancel ten
/// digits where αρ is small. The system is scaled first so that strong chains beside weak cycles
/// do not spoil it. Rounding errors below zero are set to zero, since S ≥ 0.
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
    if alpha * a.max_weight() > crate::matrix::MAX_ENTRY {
        return Err(overflow);
    }
    let mut scales = katz_scales(a, alpha, &radius.vector);
    let (left, _) = scaled_system(a, alpha, &scales)?;
    // Katz centrality, the solution of (I − αA) x = 1, makes for tighter scales than any bound.
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
/// random vector z of ±1 drawn from `seed`; about 1e-16 times the condition of M when `s` is
/// right. Costs O(n²); it samples the error, it does not bound it. 0 for an empty graph.
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
    let dot = |row: &[f64]| row.iter().zip(&z).map(|(x, y)| x * y).sum::<f64>();
    let y: Vec<f64> = (0..n).map(|i| dot(s.row(i)) + z[i]).collect();
    let walked = a.mat_vec(&y)?;
    let error = (0..n).map(|i| (y[i] - alpha * walked[i] - z[i]).powi(2));
    Ok((error.sum::<f64>() / n as f64).sqrt())
}

/// Katz centrality of every node: row sums of S + I, that is the solution x of (I − αA) x = 1.
///
/// Entry i weighs all walks that leave node i, the empty walk included, so that it is at least 1.
#[must_use]
pub fn katz_centrality(s: &DenseMatrix) -> Vec<f64> {
    s.iter_rows().map(|row| 1.0 + row.iter().sum::<f64>()).collect()
}
