//! Sparse square non-negative matrix in compressed rows: the adjacency matrix of a graph.

use super::dense::DenseMatrix;
use super::error::{MAX_ENTRY, MAX_NODES, MIN_WEIGHT, MatrixError};

/// Rows that are compared in one branch-free pass.
const COMPARED_ROWS: usize = 64;

/// True when all items pass. Tests all of them without a branch, so that the loop vectorises.
#[inline(always)]
fn all<T>(items: impl Iterator<Item = T>, test: impl Fn(T) -> bool) -> bool {
    items.fold(true, |all, item| all & test(item))
}

/// Adjacency matrix of a weighted directed graph, n × n, in compressed sparse rows.
///
/// Entry (i, j) is the weight of the edge from node i to node j: finite, positive, between
/// [`MIN_WEIGHT`] and [`MAX_ENTRY`]; everything else is zero. Columns ascend within a row.
#[derive(Debug, Clone, PartialEq)]
pub struct SparseMatrix {
    nodes: usize,
    starts: Vec<usize>,
    /// 32 bits suffice for every index below [`MAX_NODES`].
    columns: Vec<u32>,
    weights: Vec<f64>,
}

/// A matrix of no nodes.
impl Default for SparseMatrix {
    fn default() -> Self {
        Self::from_sorted(0, &[])
    }
}

impl SparseMatrix {
    /// Matrix of `nodes` nodes from triplets (row, column, weight) in any order. Triplets at the
    /// same position are summed; weights below [`MIN_WEIGHT`] are dropped.
    ///
    /// # Errors
    /// [`MatrixError::OutOfBounds`] for a position beyond `nodes`, [`MatrixError::Entry`] for a
    /// weight (or sum of weights) that is not finite or above [`MAX_ENTRY`],
    /// [`MatrixError::Negative`], and [`MatrixError::TooLarge`] beyond [`MAX_NODES`] nodes.
    pub fn from_triplets(
        nodes: usize,
        triplets: impl IntoIterator<Item = (usize, usize, f64)>,
    ) -> Result<Self, MatrixError> {
        if nodes > MAX_NODES {
            return Err(MatrixError::TooLarge { rows: nodes, cols: nodes });
        }
        let mut entries: Vec<(usize, usize, f64)> = Vec::new();
        for (row, col, value) in triplets {
            if row >= nodes || col >= nodes {
                return Err(MatrixError::OutOfBounds { row, col, nodes });
            }
            if !value.is_finite() {
                return Err(MatrixError::Entry { row, col, value });
            }
            if value < 0.0 {
                return Err(MatrixError::Negative { row, col, value });
            }
            entries.push((row, col, value));
        }
        // Stable, so that duplicates are summed in the order in which they were given.
        entries.sort_by_key(|&(row, col, _)| (row, col));
        entries.dedup_by(|next, kept| {
            let same = (next.0, next.1) == (kept.0, kept.1);
            if same {
                kept.2 += next.2;
            }
            same
        });
        entries.retain(|&(_, _, value)| value >= MIN_WEIGHT);
        if let Some(&(row, col, value)) = entries.iter().find(|e| e.2 > MAX_ENTRY) {
            return Err(MatrixError::Entry { row, col, value });
        }
        Ok(Self::from_sorted(nodes, &entries))
    }

    /// Compresses checked entries that are sorted by (row, column) and free of duplicates.
    fn from_sorted(nodes: usize, entries: &[(usize, usize, f64)]) -> Self {
        let mut starts = vec![0; nodes + 1];
        for &(row, _, _) in entries {
            starts[row + 1] += 1;
        }
        for i in 0..nodes {
            starts[i + 1] += starts[i];
        }
        Self {
            nodes,
            starts,
            columns: entries.iter().map(|e| e.1 as u32).collect(),
            weights: entries.iter().map(|e| e.2).collect(),
        }
    }

    /// Matrix of `nodes` nodes, row by row: `fill` gets each row and a function that adds a weight at a column
    /// of it. Sums are formed in the order of the calls; weights below [`MIN_WEIGHT`] are dropped.
    ///
    /// # Errors
    /// As [`SparseMatrix::from_triplets`].
    pub(crate) fn from_row_sums(
        nodes: usize,
        fill: impl Fn(usize, &mut dyn FnMut(usize, f64)),
    ) -> Result<Self, MatrixError> {
        if nodes > MAX_NODES {
            return Err(MatrixError::TooLarge { rows: nodes, cols: nodes });
        }
        let mut matrix = Self { nodes, ..Self::default() };
        let mut sums = vec![0.0; nodes];
        let mut is_touched = vec![false; nodes];
        let mut touched: Vec<u32> = Vec::new();
        for row in 0..nodes {
            fill(row, &mut |col, weight| {
                if !is_touched[col] {
                    is_touched[col] = true;
                    touched.push(col as u32);
                }
                sums[col] += weight;
            });
            touched.sort_unstable();
            for col in touched.drain(..) {
                let value = std::mem::take(&mut sums[col as usize]);
                is_touched[col as usize] = false;
                if !value.is_finite() || value > MAX_ENTRY {
                    return Err(MatrixError::Entry { row, col: col as usize, value });
                }
                if value >= MIN_WEIGHT {
                    matrix.columns.push(col);
                    matrix.weights.push(value);
                }
            }
            matrix.starts.push(matrix.weights.len());
        }
        Ok(matrix)
    }

    /// Matrix from entries that come from checked matrices and are free of duplicates.
    pub(crate) fn from_checked(nodes: usize, mut entries: Vec<(usize, usize, f64)>) -> Self {
        entries.sort_by_key(|e| (e.0, e.1));
        Self::from_sorted(nodes, &entries)
    }

    /// Number of nodes n.
    #[must_use]
    pub fn nodes(&self) -> usize {
        self.nodes
    }

    /// Number of stored edges.
    #[must_use]
    pub fn edges(&self) -> usize {
        self.weights.len()
    }

    /// True when no edge is stored.
    #[must_use]
    pub fn is_zero(&self) -> bool {
        self.weights.is_empty()
    }

    /// Edges that leave node `i` as (column, weight), columns ascending; none beyond the matrix.
    pub fn row(&self, i: usize) -> impl ExactSizeIterator<Item = (usize, f64)> {
        let range = if i < self.nodes { self.starts[i]..self.starts[i + 1] } else { 0..0 };
        let columns = self.columns[range.clone()].iter();
        columns.zip(&self.weights[range]).map(|(&j, &w)| (j as usize, w))
    }

    /// All edges as (row, column, weight), sorted by row and column.
    pub fn triplets(&self) -> impl Iterator<Item = (usize, usize, f64)> {
        (0..self.nodes).flat_map(move |i| self.row(i).map(move |(j, w)| (i, j, w)))
    }

    /// Weight of the edge from `i` to `j`, 0 when there is none.
    #[must_use]
    pub fn weight(&self, i: usize, j: usize) -> f64 {
        self.row(i).find(|e| e.0 == j).map_or(0.0, |e| e.1)
    }

    /// Largest weight, 0 without edges.
    #[must_use]
    pub fn max_weight(&self) -> f64 {
        self.weights.iter().fold(0.0, |m, &w| w.max(m))
    }

    /// The compressed rows: starts of the rows (and the end of the last), columns, weights. For
    /// inner loops, which a bounds check per row would slow down.
    pub(crate) fn parts(&self) -> (&[usize], &[u32], &[f64]) {
        (&self.starts, &self.columns, &self.weights)
    }

    /// Makes this matrix equal to `other`, in its own memory.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.nodes = other.nodes;
        self.starts.clone_from(&other.starts);
        self.columns.clone_from(&other.columns);
        self.weights.clone_from(&other.weights);
    }

    /// Appends to `rows`, ascending, the indices of the rows that differ bit for bit from those of
    /// `other`, which has as many nodes. Stops after more than `most`. O(edges), at the speed of
    /// memory.
    pub fn differing_rows(&self, other: &Self, most: usize, rows: &mut Vec<usize>) {
        let nodes = self.nodes.min(other.nodes);
        let before = rows.len();
        for first in (0..nodes).step_by(COMPARED_ROWS) {
            let last = (first + COMPARED_ROWS).min(nodes);
            if self.same_rows(other, first, last) {
                continue;
            }
            rows.extend((first..last).filter(|&i| !self.same_rows(other, i, i + 1)));
            if rows.len() - before > most {
                return;
            }
        }
    }

    /// Copies row `i` of `other`, which has as many nodes, if it has as many entries as the row
    /// here; otherwise returns false.
    pub(crate) fn copy_row(&mut self, other: &Self, i: usize) -> bool {
        let (own, from) =
            (self.starts[i]..self.starts[i + 1], other.starts[i]..other.starts[i + 1]);
        let fits = own.len() == from.len();
        if fits {
            self.columns[own.clone()].copy_from_slice(&other.columns[from.clone()]);
            self.weights[own].copy_from_slice(&other.weights[from]);
        }
        fits
    }

    /// Sum of row `i`.
    pub(crate) fn row_sum(&self, i: usize) -> f64 {
        self.weights[self.starts[i]..self.starts[i + 1]].iter().sum()
    }

    /// By how much the entries of row `i` of `scale` times this matrix exceed those of `old_scale` times
    /// `old`, which has as many nodes: the sum of what exceeds.
    pub(crate) fn row_growth(&self, i: usize, scale: f64, old: &Self, old_scale: f64) -> f64 {
        let (own, from) = (self.starts[i]..self.starts[i + 1], old.starts[i]..old.starts[i + 1]);
        let (columns, weights) = (&self.columns[own.clone()], &self.weights[own]);
        let (old_columns, old_weights) = (&old.columns[from.clone()], &old.weights[from]);
        let growth = |weight: f64, before: f64| (scale * weight - old_scale * before).max(0.0);
        if columns == old_columns {
            return weights.iter().zip(old_weights).map(|(w, before)| growth(*w, *before)).sum();
        }
        let mut before = old_columns.iter().zip(old_weights).peekable();
        let grown = |(column, weight): (&u32, &f64)| {
            while before.next_if(|(other, _)| *other < column).is_some() {}
            let old = before.next_if(|(other, _)| *other == column).map_or(0.0, |(_, w)| *w);
            growth(*weight, old)
        };
        columns.iter().zip(weights).map(grown).sum()
    }

    /// True when the rows from `first` to before `last` equal those of `other` bit for bit.
    fn same_rows(&self, other: &Self, first: usize, last: usize) -> bool {
        let (from, to) = (self.starts[first], self.starts[last]);
        let (start, end) = (other.starts[first], other.starts[last]);
        let lengths = self.starts[first..last].iter().zip(&other.starts[first..last]);
        if to - from != end - start || !all(lengths, |(a, b)| a - from == b - start) {
            return false;
        }
        let weights = self.weights[from..to].iter().zip(&other.weights[start..end]);
        self.columns[from..to] == other.columns[start..end]
            && all(weights, |(a, b)| a.to_bits() == b.to_bits())
    }

    /// Largest number of edges that leave one node.
    pub(crate) fn max_degree(&self) -> usize {
        let degrees = self.starts.windows(2).map(|w| w[1] - w[0]);
        degrees.max().unwrap_or(0)
    }

    /// Dense copy, n × n.
    ///
    /// # Errors
    /// [`MatrixError::TooLarge`] when n² exceeds [`MAX_DENSE_ENTRIES`](super::MAX_DENSE_ENTRIES).
    pub fn to_dense(&self) -> Result<DenseMatrix, MatrixError> {
        let mut dense = DenseMatrix::zeros(self.nodes, self.nodes)?;
        for i in 0..self.nodes {
            let out = dense.row_mut(i);
            for (j, w) in self.row(i) {
                out[j] = w;
            }
        }
        Ok(dense)
    }

    /// Transposed copy: every edge reversed.
    #[must_use]
    pub fn transpose(&self) -> Self {
        let entries = self.triplets().map(|(i, j, w)| (j, i, w)).collect();
        Self::from_checked(self.nodes, entries)
    }

    /// Fraction of the nodes that have an edge, in either direction; 0 without nodes.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "there are fewer nodes than 2⁵³")]
    pub fn related_share(&self) -> f64 {
        let related = self.related();
        let count = related.iter().filter(|related| **related).count();
        count as f64 / self.nodes().max(1) as f64
    }

    /// A + `share` · Aᵀ: adds the reverse of every edge with a share of its weight (0 or more; the
    /// reciprocity of the graph).
    ///
    /// # Errors
    /// [`MatrixError::Entry`] for a sum beyond [`MAX_ENTRY`], or a share that is not finite;
    /// [`MatrixError::Negative`] for one below 0.
    pub fn with_reverse(&self, share: f64) -> Result<Self, MatrixError> {
        let back = self.triplets().map(|(row, col, weight)| (col, row, share * weight));
        Self::from_triplets(self.nodes(), self.triplets().chain(back))
    }

    /// Sums of the weights of the edges that leave each node, and of those that end at it.
    #[must_use]
    pub fn degrees(&self) -> (Vec<f64>, Vec<f64>) {
        let (mut outgoing, mut incoming) = (vec![0.0; self.nodes], vec![0.0; self.nodes]);
        for (row, col, weight) in self.triplets() {
            outgoing[row] += weight;
            incoming[col] += weight;
        }
        (outgoing, incoming)
    }

    /// The matrix with each weight replaced by what `weight_of` makes of (row, column, weight). Results below
    /// [`MIN_WEIGHT`] are dropped.
    ///
    /// # Errors
    /// [`MatrixError::Entry`] for a result that is not finite or above [`MAX_ENTRY`], and
    /// [`MatrixError::Negative`].
    pub fn map_weights(
        &self,
        weight_of: impl Fn(usize, usize, f64) -> f64,
    ) -> Result<Self, MatrixError> {
        let mut mapped = Self { nodes: self.nodes, ..Self::default() };
        mapped.starts.reserve(self.nodes);
        mapped.columns.reserve(self.edges());
        mapped.weights.reserve(self.edges());
        for row in 0..self.nodes {
            for (col, weight) in self.row(row) {
                let value = weight_of(row, col, weight);
                if !value.is_finite() || value > MAX_ENTRY {
                    return Err(MatrixError::Entry { row, col, value });
                }
                if value < 0.0 {
                    return Err(MatrixError::Negative { row, col, value });
                }
                if value >= MIN_WEIGHT {
                    mapped.columns.push(col as u32);
                    mapped.weights.push(value);
                }
            }
            mapped.starts.push(mapped.weights.len());
        }
        Ok(mapped)
    }

    /// Per node, whether it has an edge, in either direction.
    #[must_use]
    pub fn related(&self) -> Vec<bool> {
        let mut related = vec![false; self.nodes];
        for (row, col, _) in self.triplets() {
            (related[row], related[col]) = (true, true);
        }
        related
    }

    /// True when the matrix equals its transpose exactly.
    #[must_use]
    pub fn is_symmetric(&self) -> bool {
        *self == self.transpose()
    }

    /// Product A x.
    ///
    /// # Errors
    /// [`MatrixError::Vector`] when `x` does not have one entry per node.
    pub fn mat_vec(&self, x: &[f64]) -> Result<Vec<f64>, MatrixError> {
        if x.len() != self.nodes {
            return Err(MatrixError::Vector { cols: self.nodes, len: x.len() });
        }
        let product = |i| self.row(i).map(|(j, w)| w * x[j]).sum();
        Ok((0..self.nodes).map(product).collect())
    }
}
