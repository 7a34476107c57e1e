//! Time of k-means and of silhouettes, on points around random centres.

use divan::{Bencher, black_box};
use muster_numeric::kmeans::{KMeansOptions, kmeans, lloyd};
use muster_numeric::matrix::DenseMatrix;
use muster_numeric::silhouette::silhouette;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Points, dimensions and clusters, as in the comparison with other implementations.
const SIZES: [(usize, usize, usize); 4] =
    [(1_000, 16, 8), (10_000, 16, 8), (100_000, 16, 8), (100_000, 32, 50)];

/// Iterations after the first assignment.
const ITERATIONS: usize = 20;

fn main() {
    divan::main();
}

/// Points that spread about as far as their centres stand apart, so that clusters overlap.
fn points((n, dims, clusters): (usize, usize, usize)) -> DenseMatrix {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let centres: Vec<f64> = (0..clusters * dims).map(|_| rng.random::<f64>()).collect();
    let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
    let value = |at: usize| centres[at / dims % clusters * dims + at % dims] + 0.3 * normal();
    let data = (0..n * dims).map(value).collect();
    DenseMatrix::new(n, dims, data).unwrap_or_else(|error| unreachable!("{error}"))
}

#[divan::bench(args = SIZES)]
fn lloyd_iterations(bencher: Bencher<'_, '_>, size: (usize, usize, usize)) {
    let x = points(size);
    let first = x.select_rows(&(0..size.2).collect::<Vec<_>>());
    bencher.bench_local(|| lloyd(black_box(&x), &first, ITERATIONS, 1));
}

#[divan::bench(args = SIZES[..3].iter().copied())]
fn five_restarts(bencher: Bencher<'_, '_>, size: (usize, usize, usize)) {
    let x = points(size);
    let options = KMeansOptions { restarts: 5, ..KMeansOptions::new(size.2) };
    bencher.bench_local(|| kmeans(black_box(&x), &options));
}

#[divan::bench(args = SIZES[..2].iter().copied())]
fn silhouettes(bencher: Bencher<'_, '_>, size: (usize, usize, usize)) {
    let x = points(size);
    let labels: Vec<usize> = (0..size.0).map(|i| i % size.2).collect();
    bencher.bench_local(|| silhouette(black_box(&x), &labels));
}
