//! Representation of every node as one row of X = \[U, V\] (equation 5 of the paper).

use super::rank_k::RankKSvd;
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::vector::length;

/// A node is weak when its row of \[U√Σ, V√Σ\] is at most this fraction of the longest.
pub const WEAK_ROW_RATIO: f64 = 1e-8;

/// Scaling of the columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Scale {
    /// As in the paper: columns of length 1, however little they contribute to S.
    None,
    /// Column j times √σ_j, as in the embedding of Ou et al., *Asymmetric Transitivity Preserving
    /// Graph Embedding* (KDD 2016): products of rows of the two halves approximate S.
    #[default]
    SqrtSigma,
    /// Column j divided by √σ_j, and 0 where σ_j is: this emphasises the directions of small
    /// groups, such as a single leader, which have the smaller values.
    InverseSqrtSigma,
}

/// Scaling of the rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Rows {
    /// As in the paper: rows keep their lengths.
    None,
    /// Rows of length 1, so that well connected nodes do not dominate; weak rows become zero
    /// instead of amplified noise.
    #[default]
    Unit,
}

/// The representation of n nodes.
#[derive(Debug, Clone, PartialEq)]
pub struct Embedding {
    /// n × 2K matrix: the K columns of U, then the K columns of V, scaled as asked for.
    pub x: DenseMatrix,
    /// Per node, true when its row is weak (see [`WEAK_ROW_RATIO`]): it has no edges, or its whole
    /// component weighs less than the K leading directions. Its row carries no information: a team
    /// chosen by this row would be arbitrary.
    pub weak: Vec<bool>,
}

/// Representation X from the leading singular triplets.
#[must_use]
pub fn embed(svd: &RankKSvd, scale: Scale, rows: Rows) -> Embedding {
    let (n, k) = (svd.u.rows(), svd.rank());
    let roots: Vec<f64> = svd.sigma.iter().map(|s| s.sqrt()).collect();
    let side = |i: usize, j: usize| if j < k { svd.u.at(i, j) } else { svd.v.at(i, j - k) };
    let scaled = DenseMatrix::from_fn(n, 2 * k, |i, j| side(i, j) * roots[j % k]);
    let lengths: Vec<f64> = scaled.iter_rows().map(length).collect();
    let longest = lengths.iter().fold(0.0_f64, |m, &l| m.max(l));
    let weak: Vec<bool> = lengths.iter().map(|&l| l <= WEAK_ROW_RATIO * longest).collect();

    let mut x = match scale {
        Scale::None => DenseMatrix::from_fn(n, 2 * k, side),
        Scale::SqrtSigma => scaled,
        Scale::InverseSqrtSigma => {
            let inverse = |root: f64| if root > 0.0 { root.recip() } else { 0.0 };
            DenseMatrix::from_fn(n, 2 * k, |i, j| side(i, j) * inverse(roots[j % k]))
        }
    };
    if rows == Rows::Unit {
        for (i, &weak) in weak.iter().enumerate() {
            let row = x.row_mut(i);
            let length = length(row);
            for value in row {
                *value = if weak { 0.0 } else { *value / length };
            }
        }
    }
    Embedding { x, weak }
}
