//! Products, LU solutions and singular value decompositions of dense matrices.

use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::lu::partial_pivoting::{factor, solve};
use faer::linalg::svd::{ComputeSvdVectors, svd as faer_svd, svd_scratch};
use faer::{Accum, Mat, MatRef, Par};

use crate::linalg::matrix::DenseMatrix;

/// All operations run on the calling thread.
const PAR: Par = Par::Seq;

/// Thin singular value decomposition A = U diag(σ) Vᵀ with σ descending.
pub(crate) struct Factors {
    pub(crate) u: DenseMatrix,
    pub(crate) sigma: Vec<f64>,
    pub(crate) v: DenseMatrix,
}

fn view(a: &DenseMatrix) -> MatRef<'_, f64> {
    MatRef::from_row_major_slice(a.data(), a.rows(), a.cols())
}

fn copy(a: MatRef<'_, f64>) -> DenseMatrix {
    DenseMatrix::from_fn(a.nrows(), a.ncols(), |i, j| a[(i, j)])
}

/// Product A B of an m × p and a p × n matrix. Callers guarantee the shapes.
pub(crate) fn multiply(a: &DenseMatrix, b: &DenseMatrix) -> DenseMatrix {
    let mut out = Mat::<f64>::zeros(a.rows(), b.cols());
    faer::linalg::matmul::matmul(&mut out, Accum::Replace, view(a), view(b), 1.0, PAR);
    copy(out.as_ref())
}

/// Solution X of A X = B by LU with partial pivoting; `None` when the shapes do not fit or the
/// result is not finite (A singular).
pub(crate) fn solve_lu(a: &DenseMatrix, b: &DenseMatrix) -> Option<DenseMatrix> {
    let n = a.rows();
    if a.cols() != n || b.rows() != n {
        return None;
    }
    let mut lu = view(a).to_owned();
    let (mut forward, mut backward) = (vec![0_usize; n], vec![0_usize; n]);
    let params = Default::default();
    let scratch = factor::lu_in_place_scratch::<usize, f64>(n, n, PAR, params);
    let (_, permutation) = factor::lu_in_place(
        lu.as_mut(),
        &mut forward,
        &mut backward,
        PAR,
        MemStack::new(&mut MemBuffer::new(scratch)),
        params,
    );
    let mut x = view(b).to_owned();
    let scratch = solve::solve_in_place_scratch::<usize, f64>(n, b.cols(), PAR);
    // Both factors share one matrix: L is read strictly below the diagonal, U on and above it.
    solve::solve_in_place(
        lu.as_ref(),
        lu.as_ref(),
        permutation,
        x.as_mut(),
        PAR,
        MemStack::new(&mut MemBuffer::new(scratch)),
    );
    DenseMatrix::new(n, b.cols(), copy(x.as_ref()).into_data()).ok()
}

/// Thin singular value decomposition; `None` when the library does not converge or a value is not
/// finite.
pub(crate) fn thin_svd(a: &DenseMatrix) -> Option<Factors> {
    let (m, n) = (a.rows(), a.cols());
    let size = m.min(n);
    let mut u = Mat::<f64>::zeros(m, size);
    let mut v = Mat::<f64>::zeros(n, size);
    let mut s = Diag::<f64>::zeros(size);
    let thin = ComputeSvdVectors::Thin;
    let scratch = svd_scratch::<f64>(m, n, thin, thin, PAR, Default::default());
    faer_svd(
        view(a),
        s.as_mut(),
        Some(u.as_mut()),
        Some(v.as_mut()),
        PAR,
        MemStack::new(&mut MemBuffer::new(scratch)),
        Default::default(),
    )
    .ok()?;
    let sigma: Vec<f64> = (0..size).map(|j| s.column_vector()[j]).collect();
    let u = DenseMatrix::new(m, size, copy(u.as_ref()).into_data()).ok()?;
    let v = DenseMatrix::new(n, size, copy(v.as_ref()).into_data()).ok()?;
    let descending = sigma.windows(2).all(|w| w[0] >= w[1]);
    let finite = sigma.iter().all(|s| s.is_finite() && *s >= 0.0);
    (descending && finite).then_some(Factors { u, sigma, v })
}
