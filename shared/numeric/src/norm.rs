//! Spectral norm of a non-negative matrix.

use crate::matrix::SparseMatrix;
use crate::spectral_radius::spectral_radius;

/// Nodes up to which AᵀA is formed explicitly.
const MAX_GRAM: usize = 2048;

/// Spectral norm ‖A‖₂ = σ₁(A), the largest singular value, in the unit of the weights; 0 for a
/// zero matrix. Relative accuracy about 1e-13 (see [`spectral_radius`] for very large graphs).
///
/// For symmetric A this is the spectral radius; otherwise σ₁² = ρ(AᵀA). Both are spectral radii
/// of non-negative matrices, so that the certified enclosure of [`spectral_radius`] serves here
/// too, without any assumption on gaps in the spectrum.
#[must_use]
pub fn spectral_norm(a: &SparseMatrix) -> f64 {
    let top = a.max_weight();
    if top == 0.0 {
        return 0.0;
    }
    if a.is_symmetric() {
        return spectral_radius(a, None).value;
    }
    if a.nodes() <= MAX_GRAM {
        top * spectral_radius(&gram(a, top), None).value.sqrt()
    } else {
        // One row or column with many entries makes AᵀA or AAᵀ dense.
        spectral_radius(&bipartite(a), None).value
    }
}

/// \[0 A; Aᵀ 0\], 2n × 2n: its eigenvalues are ±σ_j, and it has only twice the edges.
pub(crate) fn bipartite(a: &SparseMatrix) -> SparseMatrix {
    let n = a.nodes();
    let both = a.triplets().flat_map(|(i, j, w)| [(i, n + j, w), (n + j, i, w)]);
    SparseMatrix::from_checked(2 * n, both.collect())
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
