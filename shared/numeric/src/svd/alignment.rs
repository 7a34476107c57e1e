//! Alignment of a representation with that of the previous frame.
//!
//! Singular vectors may change their sign, and rotate within nearly equal singular values, although
//! the graph has hardly changed. Undoing this makes X move only as the nodes move. The correction
//! is an orthogonal Procrustes problem (Schönemann, Psychometrika 31, 1966) within each group of
//! close singular values. Columns are only rotated among themselves, so distances between rows, and
//! with them clusters and silhouettes, do not change.

use thiserror::Error;

use crate::linalg::backend::dense::{multiply, thin_svd};
use crate::linalg::matrix::DenseMatrix;

/// Neighbouring singular values belong to one group when they differ by less than this fraction
/// of the larger one: such vectors mix under small perturbations.
pub const GROUP_GAP: f64 = 0.1;

/// Rows of two representations that belong to the same node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RowPair {
    /// Row of the new representation.
    pub new: usize,
    /// Row of the previous one.
    pub old: usize,
}

impl From<(usize, usize)> for RowPair {
    fn from((new, old): (usize, usize)) -> Self {
        Self { new, old }
    }
}

/// Why two representations could not be aligned.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum AlignError {
    /// X does not have two columns per singular value.
    #[error("{cols} columns do not fit {values} singular values")]
    Columns {
        /// Columns of the new representation.
        cols: usize,
        /// Singular values given.
        values: usize,
    },
    /// The previous X has an odd number of columns.
    #[error("the previous representation has an odd number of columns, {cols}")]
    OddColumns {
        /// Its columns.
        cols: usize,
    },
    /// A pair names a row that does not exist.
    #[error("pair ({new}, {old}) lies outside of {new_rows} new and {old_rows} old rows")]
    Pair {
        /// New row of the pair.
        new: usize,
        /// Old row of the pair.
        old: usize,
        /// Rows of the new representation.
        new_rows: usize,
        /// Rows of the previous representation.
        old_rows: usize,
    },
}

/// The representation `x` with its columns rotated onto those of `previous`.
///
/// `x` is n × 2K' (U columns, then V columns, with any scaling of rows or columns), `sigma` its K'
/// singular values, `previous` the aligned n' × 2K representation of the last frame, `pairs` the
/// rows that belong to the same node. U and V columns of a group get the same
/// rotation. Where K and K' differ, the common columns are aligned and the others left alone.
/// Distances between rows of the result equal those of `x`.
///
/// # Errors
/// [`AlignError`] when shapes or pairs do not fit.
pub fn align(
    x: &DenseMatrix,
    sigma: &[f64],
    previous: &DenseMatrix,
    pairs: &[impl Into<RowPair> + Copy],
) -> Result<DenseMatrix, AlignError> {
    let k = sigma.len();
    if x.cols() != 2 * k {
        let (cols, values) = (x.cols(), k);
        return Err(AlignError::Columns { cols, values });
    }
    if !previous.cols().is_multiple_of(2) {
        let cols = previous.cols();
        return Err(AlignError::OddColumns { cols });
    }
    let (new_rows, old_rows) = (x.rows(), previous.rows());
    let pairs: Vec<RowPair> = pairs.iter().map(|pair| (*pair).into()).collect();
    let outside = |pair: &&RowPair| pair.new >= new_rows || pair.old >= old_rows;
    if let Some(&RowPair { new, old }) = pairs.iter().find(outside) {
        return Err(AlignError::Pair { new, old, new_rows, old_rows });
    }
    let old_k = previous.cols() / 2;
    let mut aligned = x.clone();
    for group in groups(&sigma[..k.min(old_k)]) {
        let cross = cross_product(x, k, previous, old_k, &pairs, &group);
        if let Some(rotation) = procrustes(&cross) {
            rotate(&mut aligned, x, &group, 0, &rotation);
            rotate(&mut aligned, x, &group, k, &rotation);
        }
    }
    Ok(aligned)
}

/// Runs of columns whose neighbouring singular values are close, as ranges.
fn groups(sigma: &[f64]) -> Vec<std::ops::Range<usize>> {
    let mut groups = Vec::new();
    let mut start = 0;
    for j in 1..=sigma.len() {
        let closed = j == sigma.len() || sigma[j - 1] - sigma[j] > GROUP_GAP * sigma[j - 1];
        if closed {
            groups.push(start..j);
            start = j;
        }
    }
    groups
}

/// Σ over all pairs and both halves of (new columns)ᵀ (old columns), square in the group size.
fn cross_product(
    x: &DenseMatrix,
    k: usize,
    previous: &DenseMatrix,
    old_k: usize,
    pairs: &[RowPair],
    group: &std::ops::Range<usize>,
) -> DenseMatrix {
    DenseMatrix::from_fn(group.len(), group.len(), |a, b| {
        let (a, b) = (group.start + a, group.start + b);
        let both = |&RowPair { new, old }: &RowPair| {
            x.at(new, a) * previous.at(old, b) + x.at(new, k + a) * previous.at(old, old_k + b)
        };
        pairs.iter().map(both).sum()
    })
}

/// The orthogonal R that maximises trace(Rᵀ C): P Qᵀ for C = P D Qᵀ. `None` when C is zero, so that
/// every rotation is equally good.
fn procrustes(cross: &DenseMatrix) -> Option<DenseMatrix> {
    let top = cross.max_abs();
    if top == 0.0 {
        return None;
    }
    // Only the direction of C matters, and the library prefers moderate numbers.
    let scaled = DenseMatrix::from_fn(cross.rows(), cross.cols(), |i, j| cross.at(i, j) / top);
    let factors = thin_svd(&scaled)?;
    Some(multiply(&factors.u, &factors.v.transpose()))
}

/// Columns `offset + group` of `target` = the same columns of `source` times `rotation`.
fn rotate(
    target: &mut DenseMatrix,
    source: &DenseMatrix,
    group: &std::ops::Range<usize>,
    offset: usize,
    rotation: &DenseMatrix,
) {
    let columns = offset + group.start..offset + group.end;
    for i in 0..source.rows() {
        let from = &source.row(i)[columns.clone()];
        for (b, out) in target.row_mut(i)[columns.clone()].iter_mut().enumerate() {
            let term = |(a, value): (usize, &f64)| value * rotation.at(a, b);
            *out = from.iter().enumerate().map(term).sum();
        }
    }
}
