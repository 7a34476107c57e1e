//! Katz similarity: closed forms, series, refusals.
use crate::common::*;
use muster_numeric::katz::{Alpha, KatzError, katz_probe, katz_similarity, resolve_alpha};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::spectral_radius::spectral_radius;
use proptest::prelude::*;

fn similarity(a: &SparseMatrix, alpha: Alpha) -> Result<(f64, DenseMatrix), KatzError> {
    let radius = spectral_radius(a, None);
    let alpha = resolve_alpha(alpha, a, &radius)?;
    Ok((alpha, katz_similarity(a, alpha, &radius)?))
}

#[test]
fn directed_path_has_powers() {
    let (_, s) = similarity(&directed_path(8, 1.0), Alpha::Value(0.3)).unwrap();
    for i in 0..8 {
        for j in 0..8 {
            let expected = if j > i { 0.3_f64.powi((j - i) as i32) } else { 0.0 };
            assert_close(s.get(i, j).unwrap(), expected, 1e-14);
        }
    }
}

#[test]
fn ring_and_clique() {
    let (n, alpha) = (6, 0.7_f64);
    let (_, s) = similarity(&ring(n, 1.0), Alpha::Value(alpha)).unwrap();
    let round = 1.0 - alpha.powi(6);
    for j in 0..n {
        let steps = if j == 0 { 6 } else { j as i32 };
        assert_close(s.get(0, j).unwrap(), alpha.powi(steps) / round, 1e-14);
    }
    // (I − α(J − I))⁻¹ by Sherman and Morrison.
    let (n, alpha) = (5.0, 0.1);
    let (_, s) = similarity(&cliques(&[5]), Alpha::Value(alpha)).unwrap();
    let off = alpha / ((1.0 + alpha) * (1.0 - alpha * (n - 1.0)));
    assert_close(s.get(0, 1).unwrap(), off, 1e-14);
    assert_close(s.get(2, 2).unwrap(), 1.0 / (1.0 + alpha) + off - 1.0, 1e-13);
}

#[test]
fn two_cliques_do_not_mix() {
    let (_, s) = similarity(&cliques(&[4, 3]), Alpha::Fraction { fraction: 0.9 }).unwrap();
    for i in 0..4 {
        for j in 4..7 {
            assert_eq!((s.get(i, j), s.get(j, i)), (Some(0.0), Some(0.0)));
        }
    }
}

#[test]
fn small_products_keep_their_digits() {
    // S ≈ αA here; inverting and subtracting I would leave no correct digit.
    let a = path(4);
    let (_, s) = similarity(&a, Alpha::Value(1e-14)).unwrap();
    assert_close(s.get(0, 1).unwrap(), 1e-14, 1e-12);
    assert_close(s.get(0, 2).unwrap(), 1e-28, 1e-12);
}

#[test]
fn fractions_of_the_admissible_range() {
    let radius = |a: &SparseMatrix| spectral_radius(a, None);
    let star = star(5);
    let half = Alpha::Fraction { fraction: 0.5 };
    assert_close(resolve_alpha(half, &star, &radius(&star)).unwrap(), 0.25, 1e-12);
    let chain = directed_path(4, 5.0);
    assert_close(resolve_alpha(half, &chain, &radius(&chain)).unwrap(), 0.1, 1e-12);
    let empty = graph(3, &[]);
    assert_eq!(resolve_alpha(half, &empty, &radius(&empty)).unwrap(), 0.5);
    for bad in [0.0, 1.0, -0.5, f64::NAN, f64::INFINITY] {
        let found = resolve_alpha(Alpha::Fraction { fraction: bad }, &star, &radius(&star));
        assert!(matches!(found, Err(KatzError::Fraction(_))));
    }
}

#[test]
fn inadmissible_decays_are_refused() {
    let a = star(5);
    let radius = spectral_radius(&a, None);
    for bad in [0.0, -0.1, f64::NAN, f64::INFINITY] {
        assert!(matches!(katz_similarity(&a, bad, &radius), Err(KatzError::Alpha(_))));
    }
    for bad in [0.5, 0.51, 7.0] {
        match katz_similarity(&a, bad, &radius) {
            Err(KatzError::Diverges { alpha, radius }) => {
                assert_eq!(alpha, bad);
                assert_close(radius, 2.0, 1e-12);
            }
            other => unreachable!("{other:?}"),
        }
    }
    assert!(katz_similarity(&a, 0.4999999, &radius).is_ok());
    // Any decay is admissible without a cycle, but not any number can be represented.
    let chain = directed_path(10, 1.0);
    assert!(similarity(&chain, Alpha::Value(1e3)).is_ok());
    for huge in [1e60, 1e120, 1e308] {
        let found = similarity(&chain, Alpha::Value(huge));
        assert!(matches!(found, Err(KatzError::Overflow { .. })), "{found:?}");
    }
    let large = SparseMatrix::from_triplets(1 << 20, [(0, 1, 1.0)]).unwrap();
    assert!(matches!(similarity(&large, Alpha::Value(0.5)), Err(KatzError::Matrix(_))));
}

#[test]
fn the_probe_detects_a_wrong_similarity() {
    let a = star(30);
    let (alpha, mut s) = similarity(&a, Alpha::Fraction { fraction: 0.9 }).unwrap();
    assert!(katz_probe(&a, alpha, &s, 1).unwrap() < 1e-13);
    assert!(katz_probe(&a, 0.9 * alpha, &s, 1).unwrap() > 1e-3);
    s = DenseMatrix::zeros(3, 3).unwrap();
    assert!(matches!(katz_probe(&a, alpha, &s, 1), Err(KatzError::Shape { .. })));
    let none = graph(0, &[]);
    let (alpha, s) = similarity(&none, Alpha::Fraction { fraction: 0.5 }).unwrap();
    assert_eq!(katz_probe(&none, alpha, &s, 1).unwrap(), 0.0);
}

/// Σ αˡ Aˡ for l = 1 to `terms`, column by column.
fn series(a: &SparseMatrix, alpha: f64, terms: usize) -> DenseMatrix {
    let n = a.nodes();
    let mut columns = Vec::new();
    for j in 0..n {
        let mut power: Vec<f64> = (0..n).map(|i| f64::from(u8::from(i == j))).collect();
        let mut sum = vec![0.0; n];
        for _ in 0..terms {
            power = a.mat_vec(&power).unwrap().iter().map(|v| alpha * v).collect();
            for (s, p) in sum.iter_mut().zip(&power) {
                *s += p;
            }
        }
        columns.extend(sum);
    }
    DenseMatrix::new(n, n, columns).unwrap().transpose()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn equals_the_series(a in directed_graphs(15), f in 0.05..0.6_f64) {
        let (alpha, s) = similarity(&a, Alpha::Fraction { fraction: f }).unwrap();
        let expected = series(&a, alpha, 120);
        let rounding = 1e-11 * s.max_abs();
        for (x, y) in s.data().iter().zip(expected.data()) {
            prop_assert!((x - y).abs() <= rounding);
            prop_assert!(*x >= 0.0);
        }
        let probe = katz_probe(&a, alpha, &s, 3).unwrap();
        prop_assert!(probe <= 1e-12 * (1.0 + alpha * a.max_weight()) * (1.0 + s.max_abs()));
        for (x, row) in katz_centrality(&s).iter().zip(s.iter_rows()) {
            prop_assert!(*x >= 1.0 && row.iter().all(|v| v <= x));
        }
    }

    #[test]
    fn permutes_with_the_nodes(a in directed_graphs(15), seed: u64) {
        let order = permutation(a.nodes(), seed);
        let (alpha, s) = similarity(&a, Alpha::Fraction { fraction: 0.5 }).unwrap();
        // An entry that is zero has rounding errors of the scales of its nodes, which weights over six orders
        // of magnitude spread by as much.
        let rounding = 1e-8 * s.max_abs();
        let (_, t) = similarity(&permuted(&a, &order), Alpha::Value(alpha)).unwrap();
        for i in 0..a.nodes() {
            for j in 0..a.nodes() {
                let (x, y) = (s.get(i, j).unwrap(), t.get(order[i], order[j]).unwrap());
                prop_assert!((x - y).abs() <= rounding);
            }
        }
    }

    #[test]
    fn nodes_without_edges_have_zero_rows(a in directed_graphs(12)) {
        let n = a.nodes();
        let wider = SparseMatrix::from_triplets(n + 2, a.triplets()).unwrap();
        let (_, s) = similarity(&wider, Alpha::Fraction { fraction: 0.8 }).unwrap();
        for i in n..n + 2 {
            prop_assert!(s.row(i).iter().all(|v| *v == 0.0));
            prop_assert!((0..n + 2).all(|j| s.get(j, i) == Some(0.0)));
        }
    }

    #[test]
    fn refused_from_the_radius_on(a in directed_graphs(15), f in 1.0..3.0_f64) {
        let radius = spectral_radius(&a, None);
        prop_assume!(!radius.acyclic);
        let found = katz_similarity(&a, f / radius.value * (1.0 + 1e-12), &radius);
        prop_assert!(matches!(found, Err(KatzError::Diverges { .. })), "{:?}", found);
    }
}
