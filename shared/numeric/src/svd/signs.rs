//! The rule that fixes the signs of singular vectors.

use crate::linalg::matrix::DenseMatrix;

/// Entries of a singular vector within this relative distance of the largest modulus count as
/// equally large when its sign is chosen, so that rounding does not decide.
pub const SIGN_TIE: f64 = 1e-8;

/// Flips each pair of columns so that the entry of u with the largest modulus is positive, the
/// first of them within [`SIGN_TIE`].
pub(crate) fn fix_signs(u: &mut DenseMatrix, v: &mut DenseMatrix) {
    for j in 0..u.cols() {
        if sign_of_column(u, j) < 0.0 {
            scale_column(u, j, -1.0);
            scale_column(v, j, -1.0);
        }
    }
}

/// Sign of the first entry of column `j` whose modulus ties with the largest one.
fn sign_of_column(u: &DenseMatrix, j: usize) -> f64 {
    let column = u.column(j);
    let top = column.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let leading = column.iter().find(|v| v.abs() >= top * (1.0 - SIGN_TIE));
    leading.map_or(1.0, |v| if *v < 0.0 { -1.0 } else { 1.0 })
}

/// Multiplies column `j` by `factor`.
pub(super) fn scale_column(m: &mut DenseMatrix, j: usize, factor: f64) {
    for i in 0..m.rows() {
        m.row_mut(i)[j] *= factor;
    }
}
