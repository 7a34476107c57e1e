//! Small symmetric problems of block methods, in reused memory.

use faer::diag::DiagMut;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{
    LltRegularization, cholesky_in_place, cholesky_in_place_scratch,
};
use faer::linalg::evd::{ComputeEigenvectors, self_adjoint_evd, self_adjoint_evd_scratch};
use faer::{MatMut, MatRef, Par};

/// Eigenvalues and Cholesky factors of one small matrix at a time, with scratch space.
#[derive(Default)]
pub(crate) struct Symmetric {
    memory: Option<(usize, MemBuffer)>,
    values: Vec<f64>,
    vectors: Vec<f64>,
    columns: Vec<f64>,
}

impl std::fmt::Debug for Symmetric {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Symmetric").field("values", &self.values).finish_non_exhaustive()
    }
}

impl Symmetric {
    fn memory(&mut self, n: usize) -> &mut MemStack {
        let fits = self.memory.as_ref().is_some_and(|(size, _)| *size >= n);
        if !fits {
            self.memory = None;
        }
        let yes = ComputeEigenvectors::Yes;
        let (_, buffer) = self.memory.get_or_insert_with(|| {
            let eigen = self_adjoint_evd_scratch::<f64>(n, yes, Par::Seq, Default::default());
            let cholesky = cholesky_in_place_scratch::<f64>(n, Par::Seq, Default::default());
            (n, MemBuffer::new(eigen.or(cholesky)))
        });
        MemStack::new(buffer)
    }

    /// Replaces the lower triangle of the symmetric G, n × n, by L of G = L Lᵀ (Cholesky). False,
    /// with G overwritten, when a squared pivot is at most `least`, for a G whose diagonal is 1.
    pub(crate) fn cholesky(&mut self, g: &mut [f64], n: usize, least: f64) -> bool {
        let none = LltRegularization::default();
        let stack = self.memory(n);
        let view = MatMut::from_row_major_slice_mut(g, n, n);
        let done = cholesky_in_place(view, none, Par::Seq, stack, Default::default()).is_ok();
        done && (0..n).all(|i| g[i * n + i] * g[i * n + i] > least)
    }

    /// Eigenvalues of the symmetric `g`, n × n, descending, and their vectors in the columns of a
    /// row-major n × n matrix. `None` when the library does not converge.
    pub(crate) fn eigen(&mut self, g: &[f64], n: usize) -> Option<(&[f64], &[f64])> {
        let mut values = std::mem::take(&mut self.values);
        let mut vectors = std::mem::take(&mut self.vectors);
        values.clear();
        values.resize(n, 0.0);
        vectors.clear();
        vectors.resize(n * n, 0.0);
        // The library rotates pairs of columns, which is fast where columns are contiguous.
        let mut columns = std::mem::take(&mut self.columns);
        columns.clear();
        columns.resize(n * n, 0.0);
        let u = MatMut::from_column_major_slice_mut(&mut columns, n, n);
        let stack = self.memory(n);
        let done = self_adjoint_evd(
            MatRef::from_row_major_slice(g, n, n),
            DiagMut::from_slice_mut(&mut values),
            Some(u),
            Par::Seq,
            stack,
            Default::default(),
        );
        // The library sorts ascending.
        values.reverse();
        for (i, row) in vectors.chunks_exact_mut(n).enumerate() {
            for (value, column) in row.iter_mut().zip(columns.chunks_exact(n).rev()) {
                *value = column[i];
            }
        }
        (self.values, self.vectors, self.columns) = (values, vectors, columns);
        let finite = self.values.iter().all(|value| value.is_finite());
        (done.is_ok() && finite).then_some((&self.values, &self.vectors))
    }
}

/// The transpose of the inverse of the lower triangular `factor`, n × n, in rows of `stride` values.
pub(crate) fn invert_transpose(factor: &[f64], n: usize, inverse: &mut [f64], stride: usize) {
    for j in 0..n {
        // Row j of the transpose is column j of the inverse, by substitution from its diagonal on.
        let row = &mut inverse[j * stride..j * stride + n];
        row[j] = 1.0 / factor[j * n + j];
        for i in j + 1..n {
            let known: f64 = (j..i).map(|k| factor[i * n + k] * row[k]).sum();
            row[i] = -known / factor[i * n + i];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvalues_descend_and_vectors_belong_to_them() {
        let g = [2.0, 1.0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 5.0];
        let mut symmetric = Symmetric::default();
        let (values, vectors) = symmetric.eigen(&g, 3).unwrap();
        for (j, wanted) in [5.0, 3.0, 1.0].into_iter().enumerate() {
            assert!((values[j] - wanted).abs() < 1e-14);
            for i in 0..3 {
                let product: f64 = (0..3).map(|k| g[i * 3 + k] * vectors[k * 3 + j]).sum();
                assert!((product - wanted * vectors[i * 3 + j]).abs() < 1e-14);
            }
        }
    }

    #[test]
    fn a_factor_is_refused_when_too_little_is_left() {
        let mut symmetric = Symmetric::default();
        let mut g = [4.0, 2.0, 2.0, 5.0];
        assert!(symmetric.cholesky(&mut g, 2, 1e-12));
        assert_eq!((g[0], g[2], g[3]), (2.0, 1.0, 2.0));
        assert!(!symmetric.cholesky(&mut [1.0, 1.0, 1.0, 1.0], 2, 1e-12));
    }
}
