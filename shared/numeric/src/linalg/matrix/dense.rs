//! Dense matrix in row-major order.

use super::error::{MAX_DENSE_ENTRIES, MAX_ENTRY, MatrixError};

/// Dense real matrix in row-major order; every entry is finite and at most [`MAX_ENTRY`] in
/// modulus.
#[derive(Debug, Clone, PartialEq)]
pub struct DenseMatrix {
    rows: usize,
    cols: usize,
    data: Vec<f64>,
}

impl DenseMatrix {
    /// Matrix of `rows` × `cols` from its entries in row-major order.
    ///
    /// # Errors
    /// [`MatrixError::Shape`] when `data` does not hold `rows · cols` values,
    /// [`MatrixError::TooLarge`] beyond [`MAX_DENSE_ENTRIES`], [`MatrixError::Entry`] for a value
    /// that is not finite or too large.
    pub fn new(rows: usize, cols: usize, data: Vec<f64>) -> Result<Self, MatrixError> {
        if check_size(rows, cols)? != data.len() {
            return Err(MatrixError::Shape { rows, cols, len: data.len() });
        }
        // Written so that NaN fails the comparison too.
        if let Some(at) = data.iter().position(|v| !matches!(v.abs(), x if x <= MAX_ENTRY)) {
            return Err(MatrixError::Entry { row: at / cols, col: at % cols, value: data[at] });
        }
        Ok(Self { rows, cols, data })
    }

    /// Matrix from rows of equal length. No rows at all give a 0 × 0 matrix.
    ///
    /// # Errors
    /// As [`DenseMatrix::new`]; rows of different lengths are a [`MatrixError::Shape`].
    pub fn from_rows(rows: &[Vec<f64>]) -> Result<Self, MatrixError> {
        let cols = rows.first().map_or(0, Vec::len);
        if let Some(odd) = rows.iter().find(|r| r.len() != cols) {
            return Err(MatrixError::Shape { rows: 1, cols, len: odd.len() });
        }
        Self::new(rows.len(), cols, rows.concat())
    }

    /// Matrix of zeros.
    ///
    /// # Errors
    /// [`MatrixError::TooLarge`] beyond [`MAX_DENSE_ENTRIES`].
    pub fn zeros(rows: usize, cols: usize) -> Result<Self, MatrixError> {
        let len = check_size(rows, cols)?;
        Ok(Self { rows, cols, data: vec![0.0; len] })
    }

    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns.
    #[must_use]
    pub fn cols(&self) -> usize {
        self.cols
    }

    /// All entries in row-major order.
    #[must_use]
    pub fn data(&self) -> &[f64] {
        &self.data
    }

    /// The entries in row-major order, without copying them.
    #[must_use]
    pub fn into_data(self) -> Vec<f64> {
        self.data
    }

    /// Entry (`i`, `j`), or `None` outside of the matrix.
    #[must_use]
    pub fn get(&self, i: usize, j: usize) -> Option<f64> {
        (i < self.rows && j < self.cols).then(|| self.data[i * self.cols + j])
    }

    /// Row `i`.
    ///
    /// # Panics
    /// When `i` is not below [`DenseMatrix::rows`], as slice indexing does.
    #[must_use]
    pub fn row(&self, i: usize) -> &[f64] {
        assert!(i < self.rows, "row {i} of a matrix of {} rows", self.rows);
        &self.data[i * self.cols..(i + 1) * self.cols]
    }

    /// All rows in order.
    pub fn iter_rows(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        (0..self.rows).map(|i| self.row(i))
    }

    /// Matrix of the given rows, in the given order; a row may appear more than once. Indices
    /// outside of the matrix are skipped.
    #[must_use]
    pub fn select_rows(&self, rows: &[usize]) -> Self {
        let kept: Vec<usize> = rows.iter().copied().filter(|&i| i < self.rows).collect();
        let mut data = Vec::with_capacity(kept.len() * self.cols);
        for &i in &kept {
            data.extend_from_slice(self.row(i));
        }
        Self { rows: kept.len(), cols: self.cols, data }
    }

    /// Transposed copy.
    #[must_use]
    pub fn transpose(&self) -> Self {
        Self::from_fn(self.cols, self.rows, |i, j| self.at(j, i))
    }

    /// Largest modulus of an entry, 0 for an empty matrix.
    #[must_use]
    pub fn max_abs(&self) -> f64 {
        self.data.iter().fold(0.0, |m, v| v.abs().max(m))
    }

    /// Entry (`i`, `j`), unchecked: callers stay within the shape.
    pub(crate) fn at(&self, i: usize, j: usize) -> f64 {
        self.data[i * self.cols + j]
    }

    /// Column `j` as a vector.
    pub(crate) fn column(&self, j: usize) -> Vec<f64> {
        (0..self.rows).map(|i| self.at(i, j)).collect()
    }

    /// Unchecked construction: callers derive shape and values from checked matrices.
    pub(crate) fn from_fn(
        rows: usize,
        cols: usize,
        mut f: impl FnMut(usize, usize) -> f64,
    ) -> Self {
        let mut data = Vec::with_capacity(rows * cols);
        for i in 0..rows {
            for j in 0..cols {
                data.push(f(i, j));
            }
        }
        Self { rows, cols, data }
    }

    /// A matrix of `rows` rows of `cols` entries, each of which `fill` writes over zeros.
    pub(crate) fn from_row_fn(
        rows: usize,
        cols: usize,
        mut fill: impl FnMut(usize, &mut [f64]),
    ) -> Self {
        let mut data = vec![0.0; rows * cols];
        for (i, row) in data.chunks_exact_mut(cols.max(1)).enumerate() {
            fill(i, row);
        }
        Self { rows, cols, data }
    }

    /// Mutable access for the algorithms of this crate, which keep the bound on the entries.
    pub(crate) fn row_mut(&mut self, i: usize) -> &mut [f64] {
        &mut self.data[i * self.cols..(i + 1) * self.cols]
    }

    /// Mutable access to all entries, see [`DenseMatrix::row_mut`].
    pub(crate) fn data_mut(&mut self) -> &mut [f64] {
        &mut self.data
    }
}

/// Number of entries of a `rows` × `cols` matrix, if it may be allocated.
fn check_size(rows: usize, cols: usize) -> Result<usize, MatrixError> {
    match rows.checked_mul(cols) {
        // The sides are bounded too: 2⁶⁰ rows of no columns would still be looped over.
        Some(len) if len <= MAX_DENSE_ENTRIES && rows.max(cols) <= MAX_DENSE_ENTRIES => Ok(len),
        _ => Err(MatrixError::TooLarge { rows, cols }),
    }
}
