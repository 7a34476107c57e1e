//! Spectral radii: closed forms, bounds, invariances.
use crate::common::*;
use muster_numeric::spectral_radius::{SpectralRadius, spectral_radius};
use proptest::prelude::*;
use std::f64::consts::PI;

fn check(found: &SpectralRadius, expected: f64) {
    assert!(
        found.lower <= expected * (1.0 + 1e-15) && found.upper >= expected * (1.0 - 1e-15),
        "{found:?} does not enclose {expected}"
    );
    assert_close(found.value, expected, 5e-13);
    assert!(found.upper - found.lower <= 2e-12 * expected, "{found:?}");
}

#[test]
fn closed_forms() {
    for n in [2, 3, 7, 64] {
        check(&spectral_radius(&ring(n, 0.3), None), 0.3);
        check(&spectral_radius(&cliques(&[n]), None), (n - 1) as f64);
        check(&spectral_radius(&star(n), None), ((n - 1) as f64).sqrt());
    }
    for n in [2, 5, 50, 500] {
        check(&spectral_radius(&path(n), None), 2.0 * (PI / (n + 1) as f64).cos());
    }
    check(&spectral_radius(&graph(2, &[(0, 1, 4.0), (1, 0, 9.0)]), None), 6.0);
    check(&spectral_radius(&graph(3, &[(1, 1, 2.5), (0, 1, 7.0)]), None), 2.5);
}

#[test]
fn grids_of_thousands_of_robots() {
    for (rows, columns) in [(1, 5000), (60, 100)] {
        let at = |row: usize, column: usize| row * columns + column;
        let mut edges = Vec::new();
        for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |c| (row, c))) {
            if row + 1 < rows {
                edges.push((at(row, column), at(row + 1, column), 1.0));
            }
            if column + 1 < columns {
                edges.push((at(row, column), at(row, column + 1), 1.0));
            }
        }
        edges.extend(edges.clone().into_iter().map(|(i, j, w)| (j, i, w)));
        let part = |n: usize| if n > 1 { 2.0 * (PI / (n + 1) as f64).cos() } else { 0.0 };
        let found = spectral_radius(&graph(rows * columns, &edges), None);
        check(&found, part(rows) + part(columns));
    }
}

#[test]
fn acyclic_graphs_have_radius_zero() {
    let tree: Vec<_> = (1..200).map(|i| ((i - 1) / 3, i, 1e3)).collect();
    for a in [graph(200, &tree), directed_path(300, 5.0), graph(0, &[]), graph(4, &[])] {
        let found = spectral_radius(&a, None);
        assert_eq!((found.lower, found.upper, found.value), (0.0, 0.0, 0.0));
        assert!(found.acyclic);
        assert_eq!(found.vector.len(), a.nodes());
    }
}

#[test]
fn periodic_and_graded_rings() {
    // Product of the weights is 1 although they span 60 orders of magnitude.
    let weights = [1e30, 1e-30, 1e15, 1e-15, 1.0];
    let edges: Vec<_> = (0..5).map(|i| (i, (i + 1) % 5, weights[i])).collect();
    check(&spectral_radius(&graph(5, &edges), None), 1.0);
    // A weak bridge back: ρ = (ε)^(1/4).
    let edges = [(0, 1, 1.0), (1, 2, 1.0), (2, 3, 1.0), (3, 0, 1e-16)];
    check(&spectral_radius(&graph(4, &edges), None), 1e-4);
}

#[test]
fn nearly_equal_components() {
    let mut edges = Vec::new();
    for (block, w) in [1.0, 1.0 + 1e-9, 1.0 - 1e-9].into_iter().enumerate() {
        let at = 10 * block;
        for i in 0..10 {
            edges.extend((0..10).filter(|&j| j != i).map(|j| (at + i, at + j, w)));
        }
    }
    edges.push((0, 10, 5.0));
    check(&spectral_radius(&graph(30, &edges), None), 9.0 * (1.0 + 1e-9));
    // Two cliques with a bridge of 1e-8: eigenvalues 9 ± 1e-9.
    let mut edges: Vec<_> = cliques(&[10, 10]).triplets().collect();
    edges.extend([(0, 10, 1e-8), (10, 0, 1e-8)]);
    check(&spectral_radius(&graph(20, &edges), None), 9.000000001);
}

#[test]
fn large_blocks_keep_honest_bounds() {
    let n = 5000;
    let expected = 2.0 * (PI / (n + 1) as f64).cos();
    let found = spectral_radius(&path(n), None);
    assert!(found.lower <= expected && expected <= found.upper);
    assert!(found.upper <= 2.0 * (1.0 + 1e-12));
}

#[test]
fn warm_start_is_optional_and_harmless() {
    let a = path(50);
    let cold = spectral_radius(&a, None);
    let expected = 2.0 * (PI / 51.0).cos();
    check(&spectral_radius(&a, Some(&cold.vector)), expected);
    for bad in [vec![], vec![f64::NAN; 50], vec![0.0; 50], vec![-1.0; 50], vec![1e300; 50]] {
        check(&spectral_radius(&a, Some(&bad)), expected);
    }
    let mut tiny = vec![1.0; 50];
    tiny[7] = 5e-324;
    check(&spectral_radius(&a, Some(&tiny)), expected);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn bounds_are_tight_and_invariant(a in directed_graphs(25), seed: u64) {
        let found = spectral_radius(&a, None);
        prop_assert!(found.lower <= found.upper && found.upper.is_finite());
        prop_assert!(found.upper - found.lower <= 1e-12 * found.upper);
        prop_assert_eq!(found.acyclic, found.upper == 0.0);
        let order = permutation(a.nodes(), seed);
        for other in [permuted(&a, &order), a.transpose()] {
            let other = spectral_radius(&other, Some(&found.vector));
            prop_assert!((other.value - found.value).abs() <= 2e-12 * found.value);
        }
        // Gelfand: ρ ≤ ‖Aᵐ‖^(1/m), and the growth of Aᵐ1 does not stay below ρ.
        let norm = muster_numeric::norm::spectral_norm(&a);
        prop_assert!(found.lower <= norm * (1.0 + 1e-12));
    }

    #[test]
    fn radius_of_symmetric_graphs_is_the_norm(a in directed_graphs(20)) {
        let a = symmetric(&a);
        let svd = muster_numeric::svd::full_svd(&a.to_dense().unwrap()).unwrap();
        let norm = svd.singular_values()[0];
        prop_assert!((spectral_radius(&a, None).value - norm).abs() <= 1e-12 * norm);
    }
}

#[test]
fn hopelessly_graded_rings_end_with_honest_bounds() {
    let mut random = numbers(5);
    let edges: Vec<_> =
        (0..64).map(|i| (i, (i + 1) % 64, 10.0_f64.powf(200.0 * random() - 100.0))).collect();
    let logs: f64 = edges.iter().map(|e| e.2.ln()).sum();
    let expected = (logs / 64.0).exp();
    let found = spectral_radius(&graph(64, &edges), None);
    assert!(found.lower <= expected * (1.0 + 1e-12) && found.upper >= expected * (1.0 - 1e-12));
    assert!(found.upper.is_finite());
}
