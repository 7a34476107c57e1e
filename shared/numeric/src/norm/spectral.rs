//! Spectral norm of a non-negative matrix.

use super::golub_kahan::largest_singular_value;
use crate::linalg::matrix::SparseMatrix;
use crate::radius::exact::spectral_radius;

/// Most nodes for which AᵀA is formed explicitly, and its spectral radius enclosed.
const MAX_GRAM: usize = 2048;

/// Spectral norm ‖A‖₂ = σ₁(A), the largest singular value, in the unit of the weights; 0 for a zero
/// matrix. Relative accuracy about 1e-13.
///
/// For symmetric A this is the spectral radius; otherwise σ₁² = ρ(AᵀA). Both are spectral radii of
/// non-negative matrices, so the certified enclosure of [`spectral_radius`] applies without any
/// assumption on gaps in the spectrum. For large graphs, where it is too wide, Golub–Kahan
/// bidiagonalisation computes the norm.
#[must_use]
pub fn spectral_norm(a: &SparseMatrix) -> f64 {
    let top = a.max_weight();
    if top == 0.0 {
        return 0.0;
    }
    if a.nodes() > MAX_GRAM {
        return top * largest_singular_value(a, top);
    }
    if a.is_symmetric() {
        return spectral_radius(a, None).value;
    }
    top * spectral_radius(&gram(a, top), None).value.sqrt()
}

/// AᵀA of the matrix divided by its largest weight `top`.
fn gram(a: &SparseMatrix, top: f64) -> SparseMatrix {
    let n = a.nodes();
    let transposed = a.transpose();
    let mut entries = Vec::new();
    let mut sums = vec![0.0; n];
    for i in 0..n {
        let mut touched = Vec::new();
        for (k, w) in transposed.row(i) {
            for (j, v) in a.row(k) {
                if sums[j] == 0.0 {
                    touched.push(j);
                }
                sums[j] += (w / top) * (v / top);
            }
        }
        touched.sort_unstable();
        // A product that underflowed to zero can put a column on the list twice.
        touched.dedup();
        for j in touched {
            if sums[j] > 0.0 {
                entries.push((i, j, sums[j]));
            }
            sums[j] = 0.0;
        }
    }
    SparseMatrix::from_checked(n, entries)
}
