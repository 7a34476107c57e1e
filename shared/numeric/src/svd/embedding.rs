//! Representation of every node as one row of X = \[U, V\] (equation 5 of the paper).

pub use muster_model::settings::{RowScaling as Rows, SingularValueScaling as Scale};

use super::rank_k::RankKSvd;
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::vector::length;

/// A node is weak when its row of \[U√Σ, V√Σ\] is at most this fraction of the longest.
pub const WEAK_ROW_RATIO: f64 = 1e-8;

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

/// Representation X from the leading singular triplets, by the power of [`Scale::power`].
#[must_use]
pub fn embed(svd: &RankKSvd, scale: Scale, rows: Rows) -> Embedding {
    embed_powers(svd, scale.power(), rows)
}

/// [`embed`] for any `power` of the singular values: column j is multiplied by σ_jᵖ, and becomes zero
/// where σ_j is zero and p is not.
#[must_use]
pub fn embed_powers(svd: &RankKSvd, power: f64, rows: Rows) -> Embedding {
    let (n, k) = (svd.u.rows(), svd.rank());
    let side = |i: usize, j: usize| if j < k { svd.u.at(i, j) } else { svd.v.at(i, j - k) };
    let scaled =
        |factors: &[f64]| DenseMatrix::from_fn(n, 2 * k, |i, j| side(i, j) * factors[j % k]);
    let roots: Vec<f64> = svd.sigma.iter().map(|sigma| sigma.sqrt()).collect();
    let by_roots = scaled(&roots);
    let lengths: Vec<f64> = by_roots.iter_rows().map(length).collect();
    let longest = lengths.iter().fold(0.0_f64, |m, &l| m.max(l));
    let weak: Vec<bool> = lengths.iter().map(|&l| l <= WEAK_ROW_RATIO * longest).collect();

    let mut x = if power == 0.0 {
        DenseMatrix::from_fn(n, 2 * k, side)
    } else if power == 0.5 {
        by_roots
    } else {
        // Roots twice the power: exact for the half powers, which are those of the settings.
        let factor = |root: &f64| match *root {
            root if root <= 0.0 => 0.0,
            root if power == -0.5 => root.recip(),
            root => root.powf(2.0 * power),
        };
        scaled(&roots.iter().map(factor).collect::<Vec<_>>())
    };
    if rows == Rows::Unit {
        for (i, &weak) in weak.iter().enumerate() {
            let row = x.row_mut(i);
            let length = length(row);
            for value in row {
                *value = if weak || length == 0.0 { 0.0 } else { *value / length };
            }
        }
    }
    Embedding { x, weak }
}
