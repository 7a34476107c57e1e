//! Graphs with known spectra, and strategies for random ones.
pub(crate) mod fleet;
pub(crate) mod precise;
pub(crate) mod teams;

use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::radius_bound::RadiusBound;
use muster_numeric::svd::{RankKSvd, SvdError, full_svd};
use proptest::prelude::*;

/// Katz centralities by their definition: row sums of S + I.
pub(crate) fn katz_centrality(s: &DenseMatrix) -> Vec<f64> {
    s.iter_rows().map(|row| 1.0 + row.iter().sum::<f64>()).collect()
}

pub(crate) fn rank_k_svd(s: &DenseMatrix, k: usize) -> Result<RankKSvd, SvdError> {
    full_svd(s)?.truncate(k)
}

/// Width of the bracket relative to its upper end; 0 for an acyclic graph.
pub(crate) fn relative_width(bound: &RadiusBound) -> f64 {
    if bound.upper > 0.0 { (bound.upper - bound.lower) / bound.upper } else { 0.0 }
}

pub(crate) fn graph(n: usize, edges: &[(usize, usize, f64)]) -> SparseMatrix {
    SparseMatrix::from_triplets(n, edges.iter().copied()).unwrap()
}

pub(crate) fn undirected(
    n: usize,
    edges: impl IntoIterator<Item = (usize, usize)>,
) -> SparseMatrix {
    let both = edges.into_iter().flat_map(|(i, j)| [(i, j, 1.0), (j, i, 1.0)]);
    SparseMatrix::from_triplets(n, both).unwrap()
}

pub(crate) fn path(n: usize) -> SparseMatrix {
    undirected(n, (1..n).map(|i| (i - 1, i)))
}

pub(crate) fn directed_path(n: usize, w: f64) -> SparseMatrix {
    SparseMatrix::from_triplets(n, (1..n).map(|i| (i - 1, i, w))).unwrap()
}

pub(crate) fn ring(n: usize, w: f64) -> SparseMatrix {
    SparseMatrix::from_triplets(n, (0..n).map(|i| (i, (i + 1) % n, w))).unwrap()
}

pub(crate) fn star(n: usize) -> SparseMatrix {
    undirected(n, (1..n).map(|i| (0, i)))
}

pub(crate) fn cliques(sizes: &[usize]) -> SparseMatrix {
    let mut edges = Vec::new();
    let mut start = 0;
    for &size in sizes {
        for i in start..start + size {
            edges.extend((i + 1..start + size).map(|j| (i, j)));
        }
        start += size;
    }
    undirected(start, edges)
}

/// Weights spread over several orders of magnitude, about a third of the pairs linked.
pub(crate) fn directed_graphs(max_nodes: usize) -> impl Strategy<Value = SparseMatrix> {
    (1..=max_nodes).prop_flat_map(|n| {
        let edge = (0..n, 0..n, -3.0..3.0_f64).prop_map(|(i, j, e)| (i, j, 10.0_f64.powf(e)));
        prop::collection::vec(edge, 0..=n * n / 3 + 1)
            .prop_map(move |edges| SparseMatrix::from_triplets(n, edges).unwrap())
    })
}

pub(crate) fn symmetric(a: &SparseMatrix) -> SparseMatrix {
    let both = a.triplets().flat_map(|(i, j, w)| [(i, j, w), (j, i, w)]);
    SparseMatrix::from_triplets(a.nodes(), both).unwrap()
}

/// Graph whose node `order[i]` is node i of `a`.
pub(crate) fn permuted(a: &SparseMatrix, order: &[usize]) -> SparseMatrix {
    let moved = a.triplets().map(|(i, j, w)| (order[i], order[j], w));
    SparseMatrix::from_triplets(a.nodes(), moved).unwrap()
}

/// A permutation of 0..n that depends on `seed`.
pub(crate) fn permutation(n: usize, seed: u64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    let mut random = numbers(seed);
    for i in (1..n).rev() {
        order.swap(i, (random() * (i + 1) as f64) as usize);
    }
    order
}

/// Reproducible numbers in [0, 1).
pub(crate) fn numbers(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_add(0x9E37_79B9_7F4A_7C15);
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// `per` points around each of the given centres, uniform within a box of half-width `spread`.
pub(crate) fn blobs(centres: &[&[f64]], per: usize, spread: f64, seed: u64) -> DenseMatrix {
    let mut random = numbers(seed);
    let mut rows = Vec::new();
    for centre in centres {
        for _ in 0..per {
            rows.push(centre.iter().map(|c| c + spread * (2.0 * random() - 1.0)).collect());
        }
    }
    DenseMatrix::from_rows(&rows).unwrap()
}

pub(crate) fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>().sqrt()
}

pub(crate) fn assert_close(found: f64, expected: f64, tolerance: f64) {
    let scale = expected.abs().max(f64::MIN_POSITIVE);
    assert!((found - expected).abs() <= tolerance * scale, "found {found}, expected {expected}");
}
