//! Elimination without subtraction: solutions of (σI − A) y = x for A ≥ 0 and σ close to ρ(A).
//!
//! σI − A is an M-matrix that becomes singular as σ → ρ. Its columns scaled by x have row sums
//! r = σx − Ax ≥ 0, so elimination can carry the row sums along and recover every pivot as a sum
//! of non-negative numbers (Grassmann, Taksar and Heyman 1985; for M-matrices Alfa, Xue and Ye,
//! Math. Comp. 71, 2002). Nothing is ever subtracted: no pivoting is needed, and the solution
//! keeps its relative accuracy in every entry, however near to singular the matrix is.
//!
//! Nodes are eliminated in the order of the approximate minimum degree, row by row along the
//! elimination tree of the symmetric pattern.

use crate::graph::elimination::elimination_tree;
use crate::linalg::backend::sparse_order::least_degree_order;
use crate::linalg::matrix::SparseMatrix;
use crate::linalg::simd::dispatch;

/// Pattern of the factors of matrices σI − A with the edges of one graph.
pub(crate) struct Elimination {
    /// The node that is eliminated at each place, and the place of each node.
    order: Vec<u32>,
    place: Vec<u32>,
    /// Columns of each row of the factor beyond its diagonal, ascending.
    starts: Vec<usize>,
    columns: Vec<u32>,
    /// Where the columns of each row go on one after the other to its end: mostly those of the last nodes,
    /// which are all joined.
    runs: Vec<usize>,
    /// Rows that have each place among their columns, ascending.
    row_starts: Vec<usize>,
    rows: Vec<u32>,
}

impl Elimination {
    /// The pattern for the edges of `a`. `None` where the factor has more than `most` entries.
    pub(crate) fn new(a: &SparseMatrix, most: usize) -> Option<Self> {
        let n = a.nodes();
        let (starts, columns, _) = a.parts();
        let order = least_degree_order(n, |i| &columns[starts[i]..starts[i + 1]])?;
        let mut place = vec![0_u32; n];
        for (k, node) in order.iter().enumerate() {
            place[*node as usize] = k as u32;
        }
        // The symmetric pattern in the order of the elimination, edges both ways doubled.
        let ends = |(i, j, _): (usize, usize, f64)| (place[i] as usize, place[j] as usize);
        let mut firsts = vec![0_usize; n + 1];
        for (i, j) in a.triplets().map(ends) {
            firsts[i.max(j) + 1] += 1;
        }
        for k in 0..n {
            firsts[k + 1] += firsts[k];
        }
        let (mut before, mut filled) = (vec![0_u32; firsts[n]], firsts.clone());
        for (i, j) in a.triplets().map(ends) {
            before[filled[i.max(j)]] = i.min(j) as u32;
            filled[i.max(j)] += 1;
        }
        let neighbours = |k: usize| before[firsts[k]..firsts[k + 1]].iter().map(|j| *j as usize);
        let (parents, starts) = elimination_tree(n, most, neighbours)?;
        let mut columns = vec![0_u32; starts[n]];
        let (mut filled, mut seen) = (starts.clone(), vec![u32::MAX; n]);
        let mut row_starts = vec![0; n + 1];
        for k in 0..n {
            seen[k] = k as u32;
            for mut j in neighbours(k) {
                while seen[j] != k as u32 {
                    seen[j] = k as u32;
                    columns[filled[j]] = k as u32;
                    filled[j] += 1;
                    row_starts[k + 1] += 1;
                    j = parents[j] as usize;
                }
            }
        }
        for k in 0..n {
            row_starts[k + 1] += row_starts[k];
        }
        let runs = starts.windows(2).map(|ends| {
            let own = &columns[ends[0]..ends[1]];
            let steps = own.windows(2).rev().take_while(|pair| pair[0] + 1 == pair[1]).count();
            ends[1] - (steps + 1).min(own.len())
        });
        let runs = runs.collect();
        let (mut rows, mut filled) = (vec![0_u32; starts[n]], row_starts.clone());
        for j in 0..n {
            for k in &columns[starts[j]..starts[j + 1]] {
                rows[filled[*k as usize]] = j as u32;
                filled[*k as usize] += 1;
            }
        }
        Some(Self { order, place, starts, columns, runs, row_starts, rows })
    }

    /// Multiply-adds of one elimination.
    pub(crate) fn work(&self) -> usize {
        self.starts.windows(2).map(|ends| (ends[1] - ends[0]).pow(2)).sum()
    }

    /// Solves (σI − A)ˢ y = c x for a matrix with the edges of the pattern, a positive x, its product
    /// A x, σ = max_i (Ax)_i/x_i, s = `solves`, and any c > 0.
    ///
    /// `None` when every row sum is zero (x is the Perron vector to the last bit) or the result leaves
    /// the range of `f64`.
    pub(crate) fn solve(
        &self,
        a: &SparseMatrix,
        x: &[f64],
        product: &[f64],
        sigma: f64,
        solves: usize,
    ) -> Option<Vec<f64>> {
        dispatch(|| {
            let factors = self.factorise(a, x, product, sigma)?;
            let mut y = x.to_vec();
            for solve in 0..solves {
                if solve > 0 {
                    let top = y.iter().fold(0.0_f64, |top, value| value.max(top));
                    y.iter_mut().for_each(|value| *value /= top);
                }
                self.apply(&factors, x, &mut y);
            }
            let usable = y.iter().all(|v| v.is_finite()) && y.iter().any(|v| *v > 0.0);
            usable.then_some(y)
        })
    }

    /// The factors. Inlined into its dispatch to the vector instructions of the machine.
    #[inline(always)]
    fn factorise(
        &self,
        a: &SparseMatrix,
        x: &[f64],
        product: &[f64],
        sigma: f64,
    ) -> Option<Factors> {
        let n = self.order.len();
        let mut links = vec![0.0; self.columns.len()];
        let mut factors = vec![0.0; self.rows.len()];
        let mut slack = Vec::with_capacity(n);
        let mut pivots = Vec::with_capacity(n);
        let mut row = vec![0.0; n];
        for k in 0..n {
            let node = self.order[k] as usize;
            let mut own_slack = (sigma * x[node] - product[node]).max(0.0);
            for (j, weight) in a.row(node) {
                row[self.place[j] as usize] = weight * x[j];
            }
            let range = self.row_starts[k]..self.row_starts[k + 1];
            for (j, factor) in self.rows[range.clone()].iter().zip(&mut factors[range]) {
                let j = *j as usize;
                let link = std::mem::take(&mut row[j]);
                if link == 0.0 {
                    continue;
                }
                *factor = link / pivots[j];
                let range = self.starts[j]..self.runs[j];
                for (column, link) in self.columns[range.clone()].iter().zip(&links[range]) {
                    row[*column as usize] += *factor * link;
                }
                let run = &links[self.runs[j]..self.starts[j + 1]];
                if let Some(first) = self.columns.get(self.runs[j]).filter(|_| !run.is_empty()) {
                    let row = &mut row[*first as usize..][..run.len()];
                    row.iter_mut().zip(run).for_each(|(to, link)| *to += *factor * link);
                }
                own_slack += *factor * slack[j];
            }
            // The diagonal is implied by the sum of the row.
            row[k] = 0.0;
            let mut pivot = own_slack;
            let range = self.starts[k]..self.starts[k + 1];
            for (column, link) in self.columns[range.clone()].iter().zip(&mut links[range]) {
                *link = std::mem::take(&mut row[*column as usize]);
                pivot += *link;
            }
            if pivot <= 0.0 {
                return None;
            }
            slack.push(own_slack);
            pivots.push(pivot);
        }
        Some(Factors { links, factors, pivots })
    }

    /// Replaces y by (σI − A)⁻¹ y.
    fn apply(&self, factors: &Factors, x: &[f64], y: &mut [f64]) {
        let Factors { links, factors, pivots } = factors;
        let n = self.order.len();
        let mut right = Vec::with_capacity(n);
        for k in 0..n {
            let range = self.row_starts[k]..self.row_starts[k + 1];
            let entries = self.rows[range.clone()].iter().zip(&factors[range]);
            let known: f64 = entries.map(|(j, factor)| factor * right[*j as usize]).sum();
            right.push(y[self.order[k] as usize] + known);
        }
        for k in (0..n).rev() {
            let range = self.starts[k]..self.starts[k + 1];
            let entries = self.columns[range.clone()].iter().zip(&links[range]);
            let known: f64 = entries.map(|(column, link)| link * right[*column as usize]).sum();
            right[k] = (right[k] + known) / pivots[k];
        }
        for (scaled, node) in right.iter().zip(&self.order) {
            y[*node as usize] = scaled * x[*node as usize];
        }
    }
}

/// Factors of σI − A with its columns scaled by x, without the signs of what is off the diagonal.
struct Factors {
    /// Entries of the upper factor, and of the lower one by rows.
    links: Vec<f64>,
    factors: Vec<f64>,
    /// The diagonal of the upper factor.
    pivots: Vec<f64>,
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn solutions_solve_the_system() {
        for (n, degree, seed) in [(1, 1, 1), (9, 9, 2), (150, 3, 3), (400, 4, 4), (60, 60, 5)] {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let edges: Vec<_> = (0..degree * n)
                .map(|_| (rng.random_range(0..n), rng.random_range(0..n), rng.random::<f64>()))
                .collect();
            let a = SparseMatrix::from_triplets(n, edges).unwrap();
            let multiply = |x: &[f64]| -> Vec<f64> {
                (0..n).map(|i| a.row(i).map(|(j, w)| w * x[j]).sum()).collect()
            };
            let x: Vec<f64> = (0..n).map(|_| 0.5 + rng.random::<f64>()).collect();
            let product = multiply(&x);
            let top = x.iter().zip(&product).map(|(x, y)| y / x).fold(0.0, f64::max);
            let sigma = 1.01 * top;
            let elimination = Elimination::new(&a, n * n).unwrap();
            let solve = |solves| elimination.solve(&a, &x, &product, sigma, solves).unwrap();
            let (once, twice) = (solve(1), solve(2));
            let top = once.iter().copied().fold(0.0, f64::max);
            let scaled: Vec<f64> = once.iter().map(|value| value / top).collect();
            for (y, right) in [(&once, &x), (&twice, &scaled)] {
                for (i, product) in multiply(y).iter().enumerate() {
                    let (found, wanted) = (sigma * y[i] - product, right[i]);
                    assert!(
                        (found - wanted).abs() <= 1e-11 * sigma * y[i],
                        "{n}: {found} {wanted}"
                    );
                }
            }
        }
        let path = SparseMatrix::from_triplets(3, [(0, 1, 1.0), (1, 2, 1.0)]).unwrap();
        assert!(Elimination::new(&path, 1).is_none());
    }
}
