//! Products of blocks of vectors, n × a few, and the small symmetric problems that come out of them.
//! Everything works in rows, in memory of the caller, on the calling thread.

use faer::diag::DiagMut;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{
    LltRegularization, cholesky_in_place, cholesky_in_place_scratch,
};
use faer::linalg::evd::{ComputeEigenvectors, self_adjoint_evd, self_adjoint_evd_scratch};
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, MatMut, MatRef, Par};

/// A block of `columns` vectors in rows that start `stride` values apart.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Block<'a> {
    data: &'a [f64],
    columns: usize,
    stride: usize,
}

/// The same to be written.
#[derive(Debug)]
pub(crate) struct BlockMut<'a> {
    data: &'a mut [f64],
    columns: usize,
    stride: usize,
}

impl<'a> Block<'a> {
    /// The first `columns` values of rows of `stride` values.
    pub(crate) fn new(data: &'a [f64], columns: usize, stride: usize) -> Self {
        Self { data, columns, stride }
    }

    fn view(&self) -> MatRef<'a, f64> {
        let rows = self.data.len() / self.stride;
        MatRef::from_row_major_slice(self.data, rows, self.stride).subcols(0, self.columns)
    }
}

impl<'a> BlockMut<'a> {
    /// The first `columns` values of rows of `stride` values.
    pub(crate) fn new(data: &'a mut [f64], columns: usize, stride: usize) -> Self {
        Self { data, columns, stride }
    }

    fn view(self) -> MatMut<'a, f64> {
        let rows = self.data.len() / self.stride;
        MatMut::from_row_major_slice_mut(self.data, rows, self.stride).subcols_mut(0, self.columns)
    }
}

/// Aᵀ B.
pub(crate) fn gram(a: Block<'_>, b: Block<'_>, out: BlockMut<'_>) {
    matmul(out.view(), Accum::Replace, a.view().transpose(), b.view(), 1.0, Par::Seq);
}

/// A B.
pub(crate) fn product(a: Block<'_>, b: Block<'_>, out: BlockMut<'_>) {
    matmul(out.view(), Accum::Replace, a.view(), b.view(), 1.0, Par::Seq);
}

/// `out` − A B.
pub(crate) fn subtract_product(a: Block<'_>, b: Block<'_>, out: BlockMut<'_>) {
    matmul(out.view(), Accum::Add, a.view(), b.view(), -1.0, Par::Seq);
}

/// `block` R⁻¹ for the upper triangular R whose transpose the rows of `factor` hold, n × n.
pub(crate) fn divide_by_factor(factor: &[f64], n: usize, block: BlockMut<'_>) {
    let lower = MatRef::from_row_major_slice(factor, n, n);
    solve_lower_triangular_in_place(lower, block.view().transpose_mut(), Par::Seq);
}

/// The small symmetric problems, with their scratch space.
#[derive(Default)]
pub(crate) struct Symmetric {
    memory: Option<(usize, MemBuffer)>,
    values: Vec<f64>,
    vectors: Vec<f64>,
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

    /// Replaces the lower triangle of the symmetric G, n × n, by L of G = L Lᵀ (Cholesky). False, with
    /// G spoiled, when it is not positive definite by far: when a pivot is below `least` for a diagonal
    /// of ones.
    pub(crate) fn cholesky(&mut self, g: &mut [f64], n: usize, least: f64) -> bool {
        let none = LltRegularization::default();
        let stack = self.memory(n);
        let view = MatMut::from_row_major_slice_mut(g, n, n);
        let done = cholesky_in_place(view, none, Par::Seq, stack, Default::default()).is_ok();
        done && (0..n).all(|i| g[i * n + i] * g[i * n + i] > least)
    }

    /// Eigenvalues of the symmetric `g`, n × n, descending, and their vectors in the columns of rows of n.
    /// `None` when the library does not converge.
    pub(crate) fn eigen(&mut self, g: &[f64], n: usize) -> Option<(&[f64], &[f64])> {
        let mut values = std::mem::take(&mut self.values);
        let mut vectors = std::mem::take(&mut self.vectors);
        values.clear();
        values.resize(n, 0.0);
        vectors.clear();
        vectors.resize(n * n, 0.0);
        let stack = self.memory(n);
        // Columns in reverse order, as the library sorts ascending.
        let u = MatMut::from_row_major_slice_mut(&mut vectors, n, n).reverse_cols_mut();
        let done = self_adjoint_evd(
            MatRef::from_row_major_slice(g, n, n),
            DiagMut::from_slice_mut(&mut values),
            Some(u),
            Par::Seq,
            stack,
            Default::default(),
        );
        values.reverse();
        (self.values, self.vectors) = (values, vectors);
        let finite = self.values.iter().all(|value| value.is_finite());
        (done.is_ok() && finite).then_some((&self.values, &self.vectors))
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
    fn a_block_is_made_orthonormal_by_the_factor_of_its_gram_matrix() {
        let mut block: Vec<f64> = (0..40).map(|i| f64::from(i * i % 17)).collect();
        let mut g = vec![0.0; 16];
        let view = Block::new(&block, 4, 4);
        gram(view, view, BlockMut::new(&mut g, 4, 4));
        let mut symmetric = Symmetric::default();
        assert!(symmetric.cholesky(&mut g, 4, 1e-12));
        divide_by_factor(&g, 4, BlockMut::new(&mut block, 4, 4));
        let view = Block::new(&block, 4, 4);
        gram(view, view, BlockMut::new(&mut g, 4, 4));
        for i in 0..4 {
            for j in 0..4 {
                assert!((g[i * 4 + j] - f64::from(u8::from(i == j))).abs() < 1e-12);
            }
        }
        assert!(!symmetric.cholesky(&mut [1.0, 1.0, 1.0, 1.0], 2, 1e-12));
    }
}
