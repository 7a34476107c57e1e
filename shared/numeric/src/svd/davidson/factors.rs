//! The exact preconditioner: a sparse LU factorisation of M = I − αA.
//!
//! M is an M-matrix: its factors exist without any exchange of rows, for every order of the nodes
//! (Fiedler and Pták, Czechoslovak Math. J. 12, 1962), and only their diagonal subtracts. The order
//! is that of the approximate minimum degree (Amestoy, Davis and Duff, SIAM J. Matrix Anal. 17,
//! 1996). Rows and columns are eliminated in one pass along the elimination tree of the symmetric
//! pattern (Davis, ACM Trans. Math. Softw. 31, 2005), so that both factors share one pattern.

use crate::graph::elimination::{NONE, elimination_tree};
use crate::linalg::backend::sparse_order::least_degree_order;
use crate::svd::operator::{KatzOperator, Orientation};

/// Most entries of one factor: 20 bytes each, 640 MiB. Fleets of 100,000 robots have a quarter of
/// that.
const MAX_ENTRIES: usize = 1 << 25;

/// Factors of P M Pᵀ = L U.
#[derive(Debug, Default)]
pub(super) struct Factors {
    /// The inner index of each node in the order of the elimination.
    order: Vec<u32>,
    /// Starts of the columns of L, and the end of the last.
    starts: Vec<usize>,
    /// Row of each entry of L below the diagonal of 1; column of each entry of U in the rows of U.
    nodes: Vec<u32>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    /// The diagonal of U.
    diagonal: Vec<f64>,
    /// A block in the order of the elimination.
    block: Vec<f64>,
}

impl Factors {
    /// Factorises M. `None` where the factors would have more than [`MAX_ENTRIES`], or M is singular
    /// in rounding.
    pub(super) fn new(operator: &KatzOperator) -> Option<Self> {
        let n = operator.nodes();
        let forward = |i: usize| operator.row(Orientation::Forward, i);
        let backward = |i: usize| operator.row(Orientation::Backward, i);
        let order = least_degree_order(n, |i| forward(i).0)?;
        let mut place = vec![0_u32; n];
        for (k, i) in order.iter().enumerate() {
            place[*i as usize] = k as u32;
        }
        let neighbours = |k: usize| {
            let i = order[k] as usize;
            forward(i).0.iter().chain(backward(i).0).map(|j| place[*j as usize] as usize)
        };
        let (parents, starts) = elimination_tree(n, MAX_ENTRIES, neighbours)?;
        let entries = starts[n];
        let (mut nodes, mut lower, mut upper) =
            (vec![0_u32; entries], vec![0.0; entries], vec![0.0; entries]);
        let mut ends = starts[..n].to_vec();
        let mut diagonal = Vec::with_capacity(n);
        let mut seen = vec![NONE; n];
        // Column k of M above its diagonal, and row k before it.
        let (mut column, mut row) = (vec![0.0; n], vec![0.0; n]);
        let (mut path, mut pattern) = (Vec::<usize>::new(), Vec::<usize>::new());
        for k in 0..n {
            let i = order[k] as usize;
            let mut pivot = 1.0;
            for (values, (neighbours, weights)) in
                [(&mut column, backward(i)), (&mut row, forward(i))]
            {
                for (j, weight) in neighbours.iter().zip(weights) {
                    match place[*j as usize] as usize {
                        j if j < k => values[j] = -weight,
                        _ => {}
                    }
                }
            }
            if let Ok(at) = forward(i).0.binary_search(&(i as u32)) {
                pivot -= forward(i).1[at];
            }
            // The nodes on the paths up the tree, each before those that it leads to.
            pattern.clear();
            seen[k] = k as u32;
            for j in neighbours(k).filter(|j| *j < k) {
                let mut j = j;
                path.clear();
                while seen[j] != k as u32 {
                    seen[j] = k as u32;
                    path.push(j);
                    j = parents[j] as usize;
                }
                pattern.extend(path.iter().rev());
            }
            for &j in pattern.iter().rev() {
                let u = std::mem::take(&mut column[j]);
                let l = std::mem::take(&mut row[j]) / diagonal[j];
                for at in starts[j]..ends[j] {
                    let below = nodes[at] as usize;
                    column[below] -= lower[at] * u;
                    row[below] -= upper[at] * l;
                }
                pivot -= l * u;
                (nodes[ends[j]], lower[ends[j]], upper[ends[j]]) = (k as u32, l, u);
                ends[j] += 1;
            }
            if !(pivot.is_finite() && pivot > 0.0) {
                return None;
            }
            diagonal.push(pivot);
        }
        Some(Self { order, starts, nodes, lower, upper, diagonal, block: Vec::new() })
    }

    /// Writes M⁻¹ M⁻ᵀ r to `out`, n × `width`, for the first `width` numbers of each of the rows of
    /// `stride` numbers of r.
    pub(super) fn apply(&mut self, r: &[f32], stride: usize, out: &mut [f64], width: usize) {
        let Self { order, starts, nodes, lower, upper, diagonal, block } = self;
        let n = order.len();
        block.clear();
        for i in &*order {
            let row = &r[*i as usize * stride..][..width];
            block.extend(row.iter().map(|value| f64::from(*value)));
        }
        let (lower, upper) =
            (Entries { starts, nodes, values: lower }, Entries { starts, nodes, values: upper });
        // Uᵀ and Lᵀ, then L and U.
        for i in 0..n {
            let (own, below) = block[i * width..].split_at_mut(width);
            own.iter_mut().for_each(|value| *value /= diagonal[i]);
            for (k, u) in upper.of(i) {
                subtract(&mut below[(k - i - 1) * width..][..width], u, own);
            }
        }
        for i in (0..n).rev() {
            let (own, below) = block[i * width..].split_at_mut(width);
            for (k, l) in lower.of(i) {
                subtract(own, l, &below[(k - i - 1) * width..][..width]);
            }
        }
        for i in 0..n {
            let (own, below) = block[i * width..].split_at_mut(width);
            for (k, l) in lower.of(i) {
                subtract(&mut below[(k - i - 1) * width..][..width], l, own);
            }
        }
        for i in (0..n).rev() {
            let (own, below) = block[i * width..].split_at_mut(width);
            for (k, u) in upper.of(i) {
                subtract(own, u, &below[(k - i - 1) * width..][..width]);
            }
            own.iter_mut().for_each(|value| *value /= diagonal[i]);
        }
        for (i, row) in order.iter().zip(block.chunks_exact(width)) {
            out[*i as usize * width..][..width].copy_from_slice(row);
        }
    }
}

/// One of the factors without its diagonal.
struct Entries<'a> {
    starts: &'a [usize],
    nodes: &'a [u32],
    values: &'a [f64],
}

impl Entries<'_> {
    /// Place and value of each entry of column or row `i`.
    fn of(&self, i: usize) -> impl Iterator<Item = (usize, f64)> {
        let range = self.starts[i]..self.starts[i + 1];
        let places = self.nodes[range.clone()].iter().map(|k| *k as usize);
        places.zip(self.values[range].iter().copied())
    }
}

/// `to` ← `to` − `factor` `from`.
fn subtract(to: &mut [f64], factor: f64, from: &[f64]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to -= factor * from;
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::linalg::matrix::SparseMatrix;
    use crate::radius::exact::spectral_radius;

    #[test]
    fn solutions_solve_the_system() {
        for (n, seed) in [(1, 1), (7, 2), (150, 3), (400, 4)] {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let edges: Vec<_> = (0..3 * n)
                .map(|_| (rng.random_range(0..n), rng.random_range(0..n), rng.random::<f64>()))
                .collect();
            let a = SparseMatrix::from_triplets(n, edges).unwrap();
            let alpha = 0.9 / spectral_radius(&a, None).upper.max(1.0);
            let mut operator = KatzOperator::default();
            operator.assign(&a, alpha, false, 1);
            let (width, stride) = (8, 16);
            let r: Vec<f32> = (0..n * stride).map(|_| rng.random::<f32>() - 0.5).collect();
            let mut x = vec![0.0; n * width];
            Factors::new(&operator).unwrap().apply(&r, stride, &mut x, width);
            // Mᵀ M x is r.
            let times = |orientation, x: &[f64]| {
                let mut y = vec![0.0; n * width];
                operator.multiply(orientation, 0..n, x, width, width, &mut y, width, 0);
                x.iter().zip(y).map(|(x, y)| x - y).collect::<Vec<_>>()
            };
            let back = times(Orientation::Backward, &times(Orientation::Forward, &x));
            for (i, value) in back.iter().enumerate() {
                let wanted = f64::from(r[i / width * stride + i % width]);
                assert!((value - wanted).abs() < 1e-11, "{value} {wanted}");
            }
        }
    }
}
