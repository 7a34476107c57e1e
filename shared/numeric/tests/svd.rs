//! Singular value decompositions of similarities.
use crate::common::*;
use muster_numeric::katz::{Alpha, katz_similarity, resolve_alpha};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::spectral_radius::spectral_radius;
use muster_numeric::svd::{SvdError, full_svd};
use proptest::prelude::*;

fn similarity(a: &SparseMatrix) -> DenseMatrix {
    let radius = spectral_radius(a, None);
    let alpha = resolve_alpha(Alpha::Fraction { fraction: 0.5 }, a, &radius).unwrap();
    katz_similarity(a, alpha, &radius).unwrap()
}

#[test]
fn diagonal_matrix() {
    let diagonal = [3.0, -7.0, 0.0, 2.0];
    let rows: Vec<Vec<f64>> =
        (0..4).map(|i| (0..4).map(|j| if i == j { diagonal[i] } else { 0.0 }).collect()).collect();
    let s = DenseMatrix::from_rows(&rows).unwrap();
    let svd = rank_k_svd(&s, 4).unwrap();
    for (found, expected) in svd.sigma.iter().zip([7.0, 3.0, 2.0, 0.0]) {
        assert!((found - expected).abs() < 1e-14);
    }
    assert_eq!(svd.sigma_next, None);
    // Signs follow U; the null direction is a zero vector.
    assert!((svd.u.get(1, 0).unwrap() - 1.0).abs() < 1e-15);
    assert!((svd.v.get(1, 0).unwrap() + 1.0).abs() < 1e-15);
    assert!((0..4).all(|i| svd.u.get(i, 3) == Some(0.0) && svd.v.get(i, 3) == Some(0.0)));
    assert!(svd.residual(&s).unwrap() < 1e-15);
}

#[test]
fn gaps_and_ambiguity() {
    // Two equal cliques: singular values come in pairs.
    let svd = full_svd(&similarity(&cliques(&[5, 5]))).unwrap();
    let (one, two) = (svd.truncate(1).unwrap(), svd.truncate(2).unwrap());
    assert!(one.ambiguous() && one.gap().abs() < 1e-12);
    assert!(!two.ambiguous() && two.gap() > 0.1);
    // Nothing is ambiguous about null directions.
    let star = full_svd(&similarity(&star(6))).unwrap();
    assert!(!star.truncate(2).unwrap().ambiguous());
    assert!(!star.truncate(3).unwrap().ambiguous());
}

#[test]
fn subspaces_turn_by_no_more_than_the_bound() {
    let s = similarity(&star(6));
    let svd = rank_k_svd(&s, 2).unwrap();
    assert_eq!(svd.angle_bound(0.0), 0.0);
    // The residual of triplets of a slightly perturbed matrix.
    for size in [1e-12, 1e-6, 1e-3] {
        let n = s.rows();
        let rows: Vec<Vec<f64>> = (0..n)
            .map(|i| (0..n).map(|j| s.row(i)[j] + size * ((3 * i + 5 * j) % 7) as f64).collect())
            .collect();
        let near = DenseMatrix::from_rows(&rows).unwrap();
        let off = rank_k_svd(&near, 2).unwrap();
        let bound = off.angle_bound(off.residual(&s).unwrap());
        assert!(bound < 1.0 || size == 1e-3);
        for (found, wanted) in [(&off.u, &svd.u), (&off.v, &svd.v)] {
            for column in 0..2 {
                // The part of a vector outside of the true subspace.
                let mut rest: Vec<f64> = (0..n).map(|i| found.row(i)[column]).collect();
                for other in 0..2 {
                    let along: f64 = (0..n).map(|i| wanted.row(i)[other] * rest[i]).sum();
                    (0..n).for_each(|i| rest[i] -= along * wanted.row(i)[other]);
                }
                let sine = rest.iter().map(|r| r * r).sum::<f64>().sqrt();
                assert!(sine <= bound + 1e-14, "{sine:e} {bound:e}");
            }
        }
    }
    // No gap, no bound.
    let twins = full_svd(&similarity(&cliques(&[5, 5]))).unwrap();
    assert_eq!(twins.truncate(1).unwrap().angle_bound(1e-9), 1.0);
}

#[test]
fn unusual_input() {
    let zero = DenseMatrix::zeros(3, 3).unwrap();
    let svd = rank_k_svd(&zero, 2).unwrap();
    assert_eq!((svd.gap(), svd.residual(&zero).unwrap()), (0.0, 0.0));
    assert!(!svd.ambiguous());
    assert!(svd.u.data().iter().all(|v| *v == 0.0));
    let wide = DenseMatrix::zeros(2, 3).unwrap();
    assert!(matches!(full_svd(&wide), Err(SvdError::NotSquare { .. })));
    assert!(matches!(svd.residual(&wide), Err(SvdError::NotSquare { .. })));
    let small = DenseMatrix::zeros(2, 2).unwrap();
    assert!(matches!(svd.residual(&small), Err(SvdError::Size { .. })));
    for k in [0, 4] {
        assert!(matches!(rank_k_svd(&zero, k), Err(SvdError::Rank { .. })));
    }
    assert!(full_svd(&DenseMatrix::zeros(0, 0).unwrap()).unwrap().singular_values().is_empty());
    for scale in [1e99, 1e-99, 1e-300] {
        let s = DenseMatrix::new(2, 2, vec![2.0 * scale, 0.0, 0.0, scale]).unwrap();
        let sigma = full_svd(&s).unwrap().singular_values().to_vec();
        assert_close(sigma[0], 2.0 * scale, 1e-14);
        assert_close(sigma[1], scale, 1e-14);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn residuals_are_rounding(a in directed_graphs(25), k in 1_usize..25) {
        let s = similarity(&a);
        let svd = rank_k_svd(&s, k.min(a.nodes())).unwrap();
        prop_assert!(svd.residual(&s).unwrap() <= 1e-12);
        prop_assert!(svd.sigma.windows(2).all(|w| w[0] >= w[1]));
        prop_assert!(svd.sigma_next.is_none_or(|n| n <= *svd.sigma.last().unwrap()));
        prop_assert!(svd.gap() >= 0.0);
    }

    #[test]
    fn symmetric_graphs_have_equal_halves(a in directed_graphs(15)) {
        let svd = rank_k_svd(&similarity(&symmetric(&a)), 1).unwrap();
        // Beyond a gap, vectors are defined up to sign.
        prop_assume!(svd.gap() > 1e-3);
        for (u, v) in svd.u.data().iter().zip(svd.v.data()) {
            prop_assert!((u.abs() - v.abs()).abs() <= 1e-10);
        }
    }

    #[test]
    fn values_do_not_depend_on_the_order_of_nodes(a in directed_graphs(15), seed: u64) {
        let order = permutation(a.nodes(), seed);
        // Of the graph itself: rounding in S would dominate where I − αA is ill-conditioned.
        let one = full_svd(&a.to_dense().unwrap()).unwrap();
        let two = full_svd(&permuted(&a, &order).to_dense().unwrap()).unwrap();
        let top = one.singular_values()[0];
        for (x, y) in one.singular_values().iter().zip(two.singular_values()) {
            prop_assert!((x - y).abs() <= 1e-11 * top);
        }
    }
}
