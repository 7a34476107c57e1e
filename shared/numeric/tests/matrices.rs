//! Construction of matrices, and fusion.
use crate::common::{directed_graphs, graph, path, star};
use muster_numeric::fuse::{FuseError, Normalization, WeightedGraph, fuse};
use muster_numeric::matrix::{DenseMatrix, MAX_ENTRY, MatrixError, SparseMatrix};
use muster_numeric::norm::spectral_norm;
use proptest::prelude::*;

#[test]
fn dense_matrices_are_checked() {
    let shape = |r, c, n| DenseMatrix::new(r, c, vec![0.0; n]);
    assert!(shape(2, 3, 6).is_ok());
    assert!(matches!(shape(2, 3, 5), Err(MatrixError::Shape { .. })));
    assert!(matches!(shape(usize::MAX, 2, 0), Err(MatrixError::TooLarge { .. })));
    assert!(matches!(shape(usize::MAX, 0, 0), Err(MatrixError::TooLarge { .. })));
    for bad in [f64::NAN, f64::INFINITY, -f64::INFINITY, 2.0 * MAX_ENTRY] {
        let found = DenseMatrix::new(2, 2, vec![0.0, 1.0, bad, 0.0]);
        assert!(matches!(found, Err(MatrixError::Entry { row: 1, col: 0, .. })));
    }
    let ragged = [vec![1.0], vec![1.0, 2.0]];
    assert!(matches!(DenseMatrix::from_rows(&ragged), Err(MatrixError::Shape { .. })));
    let m = DenseMatrix::from_rows(&[vec![1.0, 2.0], vec![3.0, 4.0]]).unwrap();
    assert_eq!((m.get(1, 0), m.get(2, 0), m.get(0, 2)), (Some(3.0), None, None));
    assert_eq!(m.transpose().row(0), [1.0, 3.0]);
    assert_eq!(m.select_rows(&[1, 7, 1]).data(), [3.0, 4.0, 3.0, 4.0]);
    assert_eq!(DenseMatrix::zeros(3, 0).unwrap().iter_rows().count(), 3);
}

#[test]
fn sparse_matrices_are_checked() {
    let build = |n, t: (usize, usize, f64)| SparseMatrix::from_triplets(n, [t]);
    assert!(matches!(build(2, (0, 2, 1.0)), Err(MatrixError::OutOfBounds { .. })));
    assert!(matches!(build(2, (0, 1, -1.0)), Err(MatrixError::Negative { .. })));
    assert!(matches!(build(2, (0, 1, f64::NAN)), Err(MatrixError::Entry { .. })));
    assert!(matches!(build(2, (0, 1, 1e200)), Err(MatrixError::Entry { .. })));
    assert!(matches!(build(usize::MAX, (0, 1, 1.0)), Err(MatrixError::TooLarge { .. })));
    let a = graph(3, &[(2, 0, 1.0), (0, 1, 2.0), (2, 0, 0.5), (1, 1, 0.0), (1, 2, -0.0)]);
    assert_eq!(a.edges(), 2);
    assert_eq!((a.weight(2, 0), a.weight(0, 2), a.weight(9, 9)), (1.5, 0.0, 0.0));
    assert_eq!(a.mat_vec(&[1.0, 10.0, 100.0]).unwrap(), [20.0, 0.0, 1.5]);
    assert!(matches!(a.mat_vec(&[1.0]), Err(MatrixError::Vector { .. })));
    assert!(!a.is_symmetric() && path(5).is_symmetric());
    assert!(build(1 << 20, (0, 1, 1.0)).unwrap().to_dense().is_err());
}

#[test]
fn fusion_weights_and_scales() {
    let (a, b) = (star(5), graph(5, &[(0, 1, 3.0), (1, 2, 3.0)]));
    let plain = fuse(&[(&a, 0.5), (&b, 0.25)], Normalization::None).unwrap();
    assert_eq!(plain.weight(0, 1), 1.25);
    assert_eq!(plain.weight(1, 0), 0.5);
    // ‖star‖ = 2, ‖directed path of weight 3‖ = 3 although its spectral radius is 0.
    let scaled = fuse(&[(&a, 0.5), (&b, 0.25)], Normalization::Spectral).unwrap();
    assert!((scaled.weight(0, 1) - 0.5).abs() < 1e-14);
    assert!((scaled.weight(0, 2) - 0.25).abs() < 1e-14);
    let zero = graph(5, &[]);
    assert_eq!(fuse(&[(&zero, 1.0)], Normalization::Spectral).unwrap(), zero);
}

#[test]
fn edges_lead_back_by_a_share_of_their_weight() {
    let reported = SparseMatrix::from_triplets(3, [(0, 1, 2.0), (1, 0, 4.0), (1, 2, 1.0)]).unwrap();
    let both = reported.with_reverse(0.5).unwrap();
    let edges: Vec<_> = both.triplets().collect();
    assert_eq!(edges, [(0, 1, 4.0), (1, 0, 5.0), (1, 2, 1.0), (2, 1, 0.5)]);
    assert_eq!(reported.with_reverse(0.0).unwrap(), reported);
    assert!(reported.with_reverse(-1.0).is_err() && reported.with_reverse(f64::NAN).is_err());
}

#[test]
fn fusion_refuses_nonsense() {
    let (a, b) = (star(5), star(4));
    let none: [WeightedGraph<'_>; 0] = [];
    assert_eq!(fuse(&none, Normalization::None), Err(FuseError::Empty));
    let sizes = fuse(&[(&a, 1.0), (&b, 1.0)], Normalization::None);
    assert!(matches!(sizes, Err(FuseError::Nodes { index: 1, .. })));
    for weight in [-1.0, f64::NAN, f64::INFINITY] {
        let found = fuse(&[(&a, weight)], Normalization::None);
        assert!(matches!(found, Err(FuseError::Weight { index: 0, .. })));
    }
    let overflow = fuse(&[(&a, 1e300)], Normalization::None);
    assert!(matches!(overflow, Err(FuseError::Matrix(_))));
}

#[test]
fn norms_in_closed_form() {
    assert_eq!(spectral_norm(&graph(3, &[])), 0.0);
    // One row of ones: ‖A‖ = √n; the same for one column.
    let fan: Vec<_> = (1..10).map(|j| (0, j, 1.0)).collect();
    assert!((spectral_norm(&graph(10, &fan)) - 3.0).abs() < 1e-13);
    assert!((spectral_norm(&graph(10, &fan).transpose()) - 3.0).abs() < 1e-13);
    // [[1, 1], [0, 1]] has the golden ratio as its norm.
    let shear = graph(2, &[(0, 0, 1.0), (0, 1, 1.0), (1, 1, 1.0)]);
    assert!((spectral_norm(&shear) - (1.0 + 5.0_f64.sqrt()) / 2.0).abs() < 1e-13);
    // Too large for AᵀA: a fan of 4000 edges.
    let wide: Vec<_> = (1..4001).map(|j| (0, j, 0.5)).collect();
    assert!((spectral_norm(&graph(4001, &wide)) - 1000.0_f64.sqrt()).abs() < 1e-10);
    assert!((spectral_norm(&graph(2, &[(0, 1, 1e-90)])) - 1e-90).abs() < 1e-103);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn norm_agrees_with_the_decomposition(a in directed_graphs(20)) {
        let svd = muster_numeric::svd::full_svd(&a.to_dense().unwrap()).unwrap();
        let expected = svd.singular_values()[0];
        prop_assert!((spectral_norm(&a) - expected).abs() <= 1e-12 * expected);
    }

    #[test]
    fn transposition_is_an_involution(a in directed_graphs(20)) {
        prop_assert_eq!(&a.transpose().transpose(), &a);
        prop_assert_eq!(a.transpose().to_dense().unwrap(), a.to_dense().unwrap().transpose());
    }
}
