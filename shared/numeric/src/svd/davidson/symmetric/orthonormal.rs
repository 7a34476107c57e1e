//! Gram matrices of blocks in single precision, and the combinations of columns that make them
//! orthonormal, or Ritz vectors.

use crate::linalg::backend::small_symmetric::{Symmetric, invert_transpose};
use crate::linalg::block_vectors::{self, BlockView, COLUMN_MULTIPLE, product};

/// Least square of what is left of a combination of unit columns, relative to the largest: what is
/// shorter consists of roundings in single precision.
const LEAST_SQUARE: f64 = 1e-12;

/// Rows in double precision, of `width` values: what is left of dependent columns would be lost in single.
pub(super) fn in_double<'a>(rows: &[f32], scratch: &'a mut [f64], width: usize) -> BlockView<'a> {
    let scratch = &mut scratch[..rows.len()];
    scratch.iter_mut().zip(rows).for_each(|(to, from)| *to = f64::from(*from));
    BlockView::new(scratch, width, width)
}

/// Adds the upper half of AᵀB, which is symmetric, and a little more, to `out`.
pub(super) fn add_upper_gram(a: BlockView<'_>, b: BlockView<'_>, out: &mut [f64]) {
    let width = a.columns;
    for first in (0..width).step_by(COLUMN_MULTIPLE) {
        let own = BlockView { first, columns: COLUMN_MULTIPLE, ..a };
        block_vectors::add_gram(own, b.from(first), &mut out[first * width + first..], width);
    }
}

/// Copies the upper half of a symmetric matrix of `width` rows to the lower one.
pub(super) fn mirror(matrix: &mut [f64], width: usize) {
    for i in 1..width {
        for j in 0..i {
            matrix[i * width + j] = matrix[j * width + i];
        }
    }
}

/// From the Gram matrix of a block, width × width: factors that scale its columns to length 1, the
/// orthonormal combinations of the scaled columns, width × width, and how many are independent; the others
/// are zero. `None` when nothing is left.
pub(super) fn independent(
    symmetric: &mut Symmetric,
    gram: &[f64],
    width: usize,
) -> Option<(Vec<f64>, Vec<f64>, usize)> {
    if !gram.iter().all(|value| value.is_finite()) {
        return None;
    }
    let scales: Vec<f64> = (0..width)
        .map(|i| gram[i * width + i])
        .map(|square| if square > 0.0 { 1.0 / square.sqrt() } else { 0.0 })
        .collect();
    let scaled = scaled(gram, &scales);
    let mut basis = vec![0.0; width * width];
    let mut factor = scaled.clone();
    if symmetric.cholesky(&mut factor, width, LEAST_SQUARE) {
        invert_transpose(&factor, width, &mut basis, width);
        return Some((scales, basis, width));
    }
    let (squares, vectors) = symmetric.eigen(&scaled, width)?;
    let least = LEAST_SQUARE * squares[0];
    let kept = squares.iter().filter(|square| **square > least).count();
    for (basis, vectors) in basis.chunks_exact_mut(width).zip(vectors.chunks_exact(width)) {
        for ((to, vector), square) in basis.iter_mut().zip(vectors).zip(squares).take(kept) {
            *to = vector / square.sqrt();
        }
    }
    (kept > 0).then_some((scales, basis, kept))
}

/// A symmetric matrix between columns that are scaled.
fn scaled(matrix: &[f64], scales: &[f64]) -> Vec<f64> {
    let rows = matrix.chunks_exact(scales.len()).zip(scales);
    rows.flat_map(|(row, own)| row.iter().zip(scales).map(move |(v, other)| v * own * other))
        .collect()
}

/// Rayleigh–Ritz from the Gram matrix of a block and its energy, width × width: the values,
/// descending, the combinations of the columns, and how many are independent; the others are zero.
/// `None` when nothing is left.
pub(super) fn whiten(
    symmetric: &mut Symmetric,
    gram: &[f64],
    energy: &[f64],
    width: usize,
    values: &mut Vec<f64>,
) -> Option<(Vec<f64>, usize)> {
    if !energy.iter().all(|value| value.is_finite()) {
        return None;
    }
    let (scales, basis, kept) = independent(symmetric, gram, width)?;
    let basis = BlockView::new(&basis, width, width);
    let (mut left, mut inner) = (vec![0.0; width * width], vec![0.0; width * width]);
    product(BlockView::new(&scaled(energy, &scales), width, width), basis, &mut left, width, 0);
    block_vectors::add_gram(basis, BlockView::new(&left, width, width), &mut inner, width);
    let inner: Vec<f64> =
        inner.chunks_exact(width).take(kept).flat_map(|row| row[..kept].iter().copied()).collect();
    let (found, turned) = symmetric.eigen(&inner, kept)?;
    values.clear();
    values.extend_from_slice(found);
    // Lost columns come last, with the least value.
    values.resize(width, found.last().copied()?);
    let mut all = vec![0.0; width * width];
    for (to, from) in all.chunks_exact_mut(width).zip(turned.chunks_exact(kept)) {
        to[..kept].copy_from_slice(from);
    }
    let mut change = vec![0.0; width * width];
    product(basis, BlockView::new(&all, width, width), &mut change, width, 0);
    for (row, scale) in change.chunks_exact_mut(width).zip(&scales) {
        row.iter_mut().for_each(|value| *value *= scale);
    }
    Some((change, kept))
}
