//! What is said about a decomposition against exact references, on graphs that are hard for it.
use crate::common::*;
use muster_numeric::katz::{MAX_KATZ_PROBE, katz_probe, katz_similarity};
use muster_numeric::katz_column::katz_column;
use muster_numeric::katz_svd::{KatzSvd, KatzSvdOptions};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::spectral_radius::{SpectralRadius, spectral_radius};
use muster_numeric::svd::{RankKSvd, full_svd};

fn options(rank: usize, tolerance: f64) -> KatzSvdOptions {
    KatzSvdOptions { exact: None, rank, tolerance, seed: 3, threads: 1 }
}

/// A graph of three edges per node, whose weights spread evenly over so many orders of magnitude.
fn spread(n: usize, orders: f64, seed: u64) -> SparseMatrix {
    let mut random = numbers(seed);
    let mut node = || (random() * n as f64) as usize;
    let ends: Vec<_> = (0..3 * n).map(|_| (node(), node())).collect();
    let edge = |(i, j)| (i, j, 10_f64.powf(orders * (random() - 0.5)));
    graph(n, &ends.into_iter().map(edge).collect::<Vec<_>>())
}

/// S by columns, each a sum without subtraction.
fn exact_similarity(a: &SparseMatrix, alpha: f64, radius: f64) -> DenseMatrix {
    let columns = (0..a.nodes()).map(|j| katz_column(a, alpha, radius, j).unwrap().values);
    DenseMatrix::from_rows(&columns.collect::<Vec<_>>()).unwrap().transpose()
}

#[test]
fn weights_over_many_orders_of_magnitude_leave_the_similarity_right() {
    for (seed, orders) in [(38, 8.0), (39, 16.0), (40, 16.0), (41, 24.0)] {
        let a = spread(120, orders, seed);
        let radius = spectral_radius(&a, None);
        let alpha = 0.9 / radius.upper;
        let s = katz_similarity(&a, alpha, &radius).unwrap();
        assert!(katz_probe(&a, alpha, &s, seed).unwrap() <= MAX_KATZ_PROBE);
        let exact = exact_similarity(&a, alpha, radius.upper);
        for (found, wanted) in s.iter_rows().zip(exact.iter_rows()) {
            let sum = 1.0 + wanted.iter().sum::<f64>();
            for (found, wanted) in found.iter().zip(wanted) {
                assert!((found - wanted).abs() <= 1e-9 * sum, "{found} {wanted} of {sum}");
            }
        }
        let sigma = |s: &DenseMatrix| full_svd(s).unwrap().singular_values()[0];
        assert_close(sigma(&s), sigma(&exact), 1e-9);
    }
}

#[test]
fn a_search_that_says_it_has_converged_has_converged() {
    let (rank, tolerance) = (4, 1e-6);
    let mut converged = 0;
    for seed in 0..24 {
        let a = spread(120, 2.0 + (seed % 4) as f64, seed);
        let radius = spectral_radius(&a, None);
        let alpha = 0.9 / radius.upper;
        let mut search = KatzSvd::default();
        let report = search.solve(&a, alpha, &radius, options(rank, tolerance), None).unwrap();
        let exact = exact_similarity(&a, alpha, radius.upper);
        let residual = search.truncate(rank).unwrap().residual(&exact).unwrap();
        assert!(residual <= report.residual * (1.0 + 1e-6) + 1e-12, "{residual:e} {report:?}");
        if report.converged {
            converged += 1;
            assert!(report.residual <= tolerance);
            let wanted = full_svd(&exact).unwrap();
            for (found, wanted) in
                search.all_singular_values()[..rank].iter().zip(wanted.singular_values())
            {
                assert!((found - wanted).abs() <= tolerance * search.all_singular_values()[0]);
            }
        }
    }
    assert!(converged >= 12, "{converged} of 24");
}

/// The decomposition of a diagonal matrix, cut after `k` values.
fn diagonal(values: &[f64], k: usize) -> RankKSvd {
    let entry = |i: usize, j: usize| if i == j { values[i] } else { 0.0 };
    let n = values.len();
    let rows: Vec<Vec<f64>> = (0..n).map(|i| (0..n).map(|j| entry(i, j)).collect()).collect();
    full_svd(&DenseMatrix::from_rows(&rows).unwrap()).unwrap().truncate(k).unwrap()
}

#[test]
fn weak_values_are_ambiguous_only_beside_their_like() {
    assert!(!diagonal(&[1.0, 1e-10, 5e-11], 2).ambiguous());
    assert!(diagonal(&[1.0, 0.5, 0.5 * (1.0 - 1e-10)], 2).ambiguous());
    assert!(diagonal(&[1.0, 1e-4, 1e-4 * (1.0 - 1e-10)], 2).ambiguous());
    // Closer than rounding can tell.
    assert!(diagonal(&[1.0, 1e-13, 1e-13 * (1.0 - 1e-4)], 2).ambiguous());
}

#[test]
fn no_angle_is_bounded_by_a_gap_that_residuals_may_have_opened() {
    let svd = diagonal(&[1.0, 0.9], 1);
    assert_close(svd.angle_bound(0.01), 0.01 / 0.09, 1e-12);
    assert_eq!((svd.angle_bound(0.0), svd.angle_bound(0.06)), (0.0, 1.0));
    let rough = RankKSvd { next_residual: 0.05, ..svd.clone() };
    assert!(rough.angle_bound(0.01) > 1.5 * svd.angle_bound(0.01));
    assert_eq!(RankKSvd { next_residual: 0.1, ..svd }.angle_bound(0.01), 1.0);
}

/// Graphs side by side without an edge between them.
fn side_by_side(parts: &[SparseMatrix]) -> SparseMatrix {
    let mut edges = Vec::new();
    let mut first = 0;
    for part in parts {
        edges.extend(part.triplets().map(|(i, j, w)| (first + i, first + j, w)));
        first += part.nodes();
    }
    graph(first, &edges)
}

/// The singular values of graphs side by side, descending: those of each of them, decomposed whole.
fn exact_values(parts: &[SparseMatrix], alpha: f64, radius: &SpectralRadius) -> Vec<f64> {
    let mut values = Vec::new();
    for part in parts {
        let exact = exact_similarity(part, alpha, radius.upper);
        values.extend_from_slice(full_svd(&exact).unwrap().singular_values());
    }
    values.sort_unstable_by(|a, b| b.total_cmp(a));
    values
}

/// A command tree of 31 robots with links back that are so weak.
fn command_tree(back: f64) -> SparseMatrix {
    let edges = (1..31).flat_map(|i| [((i - 1) / 2, i, 1.0), (i, (i - 1) / 2, back)]);
    graph(31, &edges.collect::<Vec<_>>())
}

#[test]
fn command_trees_with_weak_links_back_have_their_values() {
    for back in [0.1, 0.03, 0.01, 0.001, 1e-4] {
        let tree = command_tree(back);
        let a = side_by_side(&vec![tree.clone(); 200]);
        let radius = spectral_radius(&tree, None);
        let alpha = 0.9 / radius.upper;
        let wanted = exact_values(&[tree], alpha, &radius)[0];
        let mut search = KatzSvd::default();
        let report = search.solve(&a, alpha, &radius, options(4, 1e-6), None).unwrap();
        assert!(report.converged, "{back}: {report:?}");
        // σ₁ of each of the trees.
        for found in &search.all_singular_values()[..4] {
            assert_close(*found, wanted, 1e-6);
        }
    }
}

#[test]
fn close_neighbours_in_sigma_are_told_apart() {
    // 5,000 robots in a hundred groups that differ by 1e-7, and their values by about 1e-6.
    let group = |g: usize| {
        let strength = 1.0 - 1e-7 * g as f64;
        let links = (0..50).flat_map(move |i| {
            let (next, far) = ((i + 1) % 50, (7 * i + 3) % 50);
            [(i, next, 1.0), (next, i, 0.7), (i, far, 0.5)].map(|(i, j, w)| (i, j, strength * w))
        });
        graph(50, &links.collect::<Vec<_>>())
    };
    let groups: Vec<_> = (0..100).map(group).collect();
    let a = side_by_side(&groups);
    let radius = spectral_radius(&groups[0], None);
    let alpha = 0.9 / radius.upper;
    let wanted = exact_values(&groups, alpha, &radius);
    let mut search = KatzSvd::default();
    let report = search.solve(&a, alpha, &radius, options(8, 1e-6), None).unwrap();
    assert!(report.converged && report.rounds <= 100, "{report:?}");
    for (found, wanted) in search.all_singular_values()[..8].iter().zip(&wanted) {
        assert_close(*found, *wanted, 1e-9);
    }
}
