//! Lower bounds of the spectral radius from a small part of the graph.
//!
//! Where a graph is sparse and uneven, its Perron vector is almost confined to the densest part.
//! The spectral radius of that part alone, a principal submatrix, is a lower bound of the whole and
//! close to it.

use std::collections::BinaryHeap;

use crate::linalg::matrix::SparseMatrix;

/// Index in the patch of a node outside of it.
const OUTSIDE: u32 = u32::MAX;

/// Most rounds of the power method: a limit for patches with nearly equal eigenvalues.
const MAX_ROUNDS: usize = 200;

/// Least rounds of a large patch, however few edges the graph has.
const MIN_ROUNDS: usize = 8;

/// Cost limit of a patch in sweeps over the whole graph; its products are dense but much faster.
const MAX_PATCH_SWEEPS: usize = 4;

/// Rounds before progress is checked.
const SETTLING_ROUNDS: usize = 4;

/// Scratch space for patches of one graph after the other.
#[derive(Debug, Default)]
pub(crate) struct Patches {
    /// Index of each node in the patch, [`OUTSIDE`] between calls.
    place: Vec<u32>,
    nodes: Vec<usize>,
    heap: BinaryHeap<(u64, usize)>,
    /// √(a_ij a_ji) within the patch, m × m.
    means: Vec<f64>,
    vector: Vec<f64>,
    product: Vec<f64>,
}

impl Patches {
    /// A lower bound of ρ(A) from at most `size` nodes around `seed`, added in the order of the
    /// positive `x`, one entry per node of `a`. The power method stops when a round raises the
    /// bound by less than the fraction `progress`, or costs too much. 0 when no edge of the patch
    /// goes both ways.
    ///
    /// The matrix G of the geometric means g_ij = √(a_ij a_ji) has ρ(G) ≤ ρ(A) (Schwenk, Linear
    /// Algebra Appl. 75, 1986; Elsner, Johnson and Dias da Silva, Linear Multilinear Algebra 24,
    /// 1988). G is symmetric, so *every* Rayleigh quotient of it is a lower bound, with an error of
    /// second order in the error of its vector.
    pub(crate) fn lower_bound(
        &mut self,
        a: &SparseMatrix,
        x: &[f64],
        seed: usize,
        size: usize,
        progress: f64,
    ) -> f64 {
        self.gather(a, x, seed, size);
        let m = self.nodes.len();
        self.vector.clear();
        self.vector.extend(self.nodes.iter().map(|&i| x[i]));
        let top = self.vector.iter().fold(f64::MIN_POSITIVE, |top, v| v.max(top));
        for v in &mut self.vector {
            *v /= top;
        }
        let mut best = 0.0_f64;
        let rounds = (MAX_PATCH_SWEEPS * a.edges() / (m * m)).clamp(MIN_ROUNDS, MAX_ROUNDS);
        for round in 0..rounds {
            let (norm, quotient) = self.multiply(m);
            if norm.is_nan() || norm <= 0.0 || quotient <= 0.0 {
                break;
            }
            let gained = quotient > best * (1.0 + progress);
            best = best.max(quotient);
            if !gained && round >= SETTLING_ROUNDS {
                break;
            }
            // A shift by half the quotient makes patches with eigenvalues ±λ converge too.
            for (v, p) in self.vector.iter_mut().zip(&self.product) {
                *v = (0.5 * *v + p / quotient) / 1.5;
            }
            rescale(&mut self.vector);
        }
        for &node in &self.nodes {
            self.place[node] = OUTSIDE;
        }
        // Rounding of two sums of m positive terms, each with a root and three products.
        best * (1.0 - (2 * m + 16) as f64 * f64::EPSILON)
    }

    /// Chooses the nodes and fills [`Patches::means`].
    fn gather(&mut self, a: &SparseMatrix, x: &[f64], seed: usize, size: usize) {
        self.place.resize(a.nodes(), OUTSIDE);
        self.nodes.clear();
        self.heap.clear();
        self.heap.push((x[seed].to_bits(), seed));
        // Positive numbers are ordered like their bits.
        while let Some((_, node)) = self.heap.pop() {
            if self.place[node] != OUTSIDE {
                continue;
            }
            self.place[node] = self.nodes.len() as u32;
            self.nodes.push(node);
            if self.nodes.len() == size {
                break;
            }
            let open = a.row(node).filter(|(j, _)| self.place[*j] == OUTSIDE);
            self.heap.extend(open.map(|(j, _)| (x[j].to_bits(), j)));
        }
        let m = self.nodes.len();
        self.means.clear();
        self.means.resize(m * m, 0.0);
        for (i, &node) in self.nodes.iter().enumerate() {
            for (j, w) in a.row(node) {
                let j = self.place[j];
                if j != OUTSIDE {
                    self.means[i * m + j as usize] = w;
                }
            }
        }
        for i in 0..m {
            for j in 0..i {
                let mean = (self.means[i * m + j] * self.means[j * m + i]).sqrt();
                self.means[i * m + j] = mean;
                self.means[j * m + i] = mean;
            }
        }
    }

    /// Computes G v; returns vᵀv and the Rayleigh quotient vᵀGv / vᵀv.
    fn multiply(&mut self, m: usize) -> (f64, f64) {
        self.product.clear();
        let rows = self.means.chunks_exact(m);
        let dot = |row: &[f64]| dot(row, &self.vector);
        self.product.extend(rows.map(dot));
        let norm: f64 = self.vector.iter().map(|v| v * v).sum();
        let energy: f64 = self.vector.iter().zip(&self.product).map(|(v, p)| v * p).sum();
        (norm, energy / norm)
    }
}

/// Scales to largest entry 1; negligible entries become 0.
fn rescale(vector: &mut [f64]) {
    const MIN_ITERATE: f64 = 1e-150;
    let top = vector.iter().fold(0.0_f64, |top, v| v.max(top));
    for v in vector {
        *v /= top;
        if *v < MIN_ITERATE {
            *v = 0.0;
        }
    }
}

/// Sum of products in eight independent strands, which the compiler vectorises.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    let (mut a, mut b) = (a.chunks_exact(8), b.chunks_exact(8));
    for (a, b) in a.by_ref().zip(b.by_ref()) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    let rest: f64 = a.remainder().iter().zip(b.remainder()).map(|(a, b)| a * b).sum();
    rest + sums.iter().sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clique_in_a_long_path_is_found_whole() {
        let path = (1..200).map(|i| (i - 1, i));
        let clique = (90..100).flat_map(|i| (i + 2..100).map(move |j| (i, j)));
        let both = path.chain(clique).flat_map(|(i, j)| [(i, j, 1.0), (j, i, 1.0)]);
        let a = SparseMatrix::from_triplets(200, both).unwrap();
        let x: Vec<f64> = (0..200).map(|i| 1.0 + a.row(i).len() as f64).collect();
        let mut patches = Patches::default();
        for _ in 0..2 {
            let found = patches.lower_bound(&a, &x, 95, 32, 1e-6);
            assert!(found > 9.0 && found < 9.03, "{found}");
        }
    }

    #[test]
    fn edges_one_way_bound_nothing() {
        let a = SparseMatrix::from_triplets(3, [(0, 1, 1.0), (1, 2, 1.0), (2, 0, 1.0)]).unwrap();
        assert_eq!(Patches::default().lower_bound(&a, &[1.0; 3], 0, 3, 1e-3), 0.0);
    }
}
