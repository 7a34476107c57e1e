//! The rule that fixes the signs of singular vectors.

use crate::linalg::matrix::DenseMatrix;

/// Entries of a singular vector within this relative distance of the largest modulus count as
/// equally large when its sign is chosen, so that rounding does not decide.
pub const SIGN_TIE: f64 = 1e-8;

/// Flips each pair of columns so that the entry of u with the largest modulus is positive, the
/// first of them within [`SIGN_TIE`].
pub(crate) fn fix_signs(u: &mut DenseMatrix, v: &mut DenseMatrix) {
    // Row by row, as columns are far apart in memory.
    let mut least = vec![0.0_f64; u.cols()];
    for row in u.iter_rows() {
        for (least, value) in least.iter_mut().zip(row) {
            *least = value.abs().max(*least);
        }
    }
    least.iter_mut().for_each(|top| *top *= 1.0 - SIGN_TIE);
    let mut factors = vec![0.0; u.cols()];
    let mut missing = u.cols();
    for row in u.iter_rows() {
        for ((factor, value), least) in factors.iter_mut().zip(row).zip(&least) {
            if *factor == 0.0 && value.abs() >= *least {
                *factor = if *value < 0.0 { -1.0 } else { 1.0 };
                missing -= 1;
            }
        }
        if missing == 0 {
            break;
        }
    }
    // A column that is not a number has no largest entry.
    let negative = |factor: &f64| *factor < 0.0;
    if factors.iter().any(negative) {
        factors.iter_mut().filter(|factor| **factor == 0.0).for_each(|factor| *factor = 1.0);
        for matrix in [u, v] {
            for row in matrix.data_mut().chunks_exact_mut(factors.len()) {
                row.iter_mut().zip(&factors).for_each(|(value, factor)| *value *= factor);
            }
        }
    }
}

/// Multiplies column `j` by `factor`.
pub(super) fn scale_column(m: &mut DenseMatrix, j: usize, factor: f64) {
    for i in 0..m.rows() {
        m.row_mut(i)[j] *= factor;
    }
}
