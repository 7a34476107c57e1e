//! Representations and their alignment from frame to frame.
use crate::common::*;
use muster_numeric::alignment::{AlignError, align};
use muster_numeric::embedding::{Embedding, Rows, Scale, embed};
use muster_numeric::katz::{Alpha, katz_similarity, resolve_alpha};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::spectral_radius::spectral_radius;
use muster_numeric::svd::RankKSvd;
use proptest::prelude::*;

fn decompose(a: &SparseMatrix, k: usize) -> RankKSvd {
    let radius = spectral_radius(a, None);
    let alpha = resolve_alpha(Alpha::Fraction { fraction: 0.5 }, a, &radius).unwrap();
    rank_k_svd(&katz_similarity(a, alpha, &radius).unwrap(), k).unwrap()
}

fn frame(a: &SparseMatrix, k: usize) -> (RankKSvd, Embedding) {
    let svd = decompose(a, k);
    let embedding = embed(&svd, Scale::SqrtSigma, Rows::Unit);
    (svd, embedding)
}

fn same(n: usize) -> Vec<(usize, usize)> {
    (0..n).map(|i| (i, i)).collect()
}

fn assert_same_distances(x: &DenseMatrix, y: &DenseMatrix) {
    for i in 0..x.rows() {
        for j in 0..i {
            let (a, b) = (distance(x.row(i), x.row(j)), distance(y.row(i), y.row(j)));
            assert!((a - b).abs() < 1e-12 * (1.0 + x.max_abs()), "({i}, {j}): {a} and {b}");
        }
    }
}

fn largest_move(x: &DenseMatrix, y: &DenseMatrix) -> f64 {
    x.iter_rows().zip(y.iter_rows()).map(|(a, b)| distance(a, b)).fold(0.0, f64::max)
}

#[test]
fn weak_components_are_marked() {
    // Cliques of 6, 5, 4, 3 and two isolated nodes: two triplets embed 11 of 20 nodes.
    let mut edges: Vec<_> = cliques(&[6, 5, 4, 3]).triplets().collect();
    edges.push((18, 18, 0.0));
    let a = graph(20, &edges);
    let (_, e) = frame(&a, 2);
    let expected: Vec<bool> = (0..20).map(|i| i >= 11).collect();
    assert_eq!(e.weak, expected);
    for (row, weak) in e.x.iter_rows().zip(&e.weak) {
        let length = distance(row, &[0.0; 4]);
        assert!((length - f64::from(u8::from(!weak))).abs() < 1e-14);
    }
    assert!(embed(&decompose(&graph(3, &[]), 2), Scale::None, Rows::Unit).weak.iter().all(|w| *w));
}

#[test]
fn plain_representation_is_u_and_v() {
    let svd = decompose(&directed_path(6, 1.0), 3);
    let x = embed(&svd, Scale::None, Rows::None).x;
    for i in 0..6 {
        assert_eq!(&x.row(i)[..3], svd.u.row(i));
        assert_eq!(&x.row(i)[3..], svd.v.row(i));
    }
    let scaled = embed(&svd, Scale::SqrtSigma, Rows::None).x;
    assert_close(scaled.get(0, 1).unwrap(), x.get(0, 1).unwrap() * svd.sigma[1].sqrt(), 1e-15);
    let inverse = embed(&svd, Scale::InverseSqrtSigma, Rows::None).x;
    assert_close(inverse.get(0, 1).unwrap(), x.get(0, 1).unwrap() / svd.sigma[1].sqrt(), 1e-15);
}

#[test]
fn zero_columns_stay_zero() {
    let nothing = decompose(&graph(3, &[]), 2);
    let x = embed(&nothing, Scale::InverseSqrtSigma, Rows::None).x;
    assert!(x.data().iter().all(|value| *value == 0.0));
    // One edge has one triplet; ask for three.
    let edge = decompose(&graph(4, &[(0, 1, 1.0)]), 3);
    let x = embed(&edge, Scale::InverseSqrtSigma, Rows::Unit).x;
    assert!(x.data().iter().all(|value| value.is_finite()));
    assert_eq!(x.row(2), [0.0; 6]);
}

#[test]
fn rotations_within_equal_values_are_undone() {
    // Three equal cliques: the leading three values coincide, their vectors are arbitrary.
    let a = cliques(&[5, 5, 5]);
    let (svd, e) = frame(&a, 3);
    let (c, s) = (0.6, 0.8);
    let rotated: Vec<f64> =
        e.x.iter_rows()
            .flat_map(|r| {
                let turn = |h: &[f64]| [c * h[0] - s * h[1], s * h[0] + c * h[1], -h[2]];
                [turn(&r[..3]), turn(&r[3..])].concat()
            })
            .collect();
    let rotated = DenseMatrix::new(15, 6, rotated).unwrap();
    let back = align(&rotated, &svd.sigma, &e.x, &same(15)).unwrap();
    assert!(largest_move(&back, &e.x) < 1e-13);
}

#[test]
fn small_changes_move_rows_a_little() {
    let base = cliques(&[6, 6, 5, 5]);
    let mut random = numbers(11);
    let nudged = |size: f64, random: &mut dyn FnMut() -> f64| {
        let edges = base.triplets().filter(|e| e.0 < e.1).flat_map(|(i, j, w)| {
            let w = w + size * random();
            [(i, j, w), (j, i, w)]
        });
        SparseMatrix::from_triplets(22, edges.collect::<Vec<_>>()).unwrap()
    };
    let mut previous = frame(&base, 4).1.x;
    for _ in 0..20 {
        let (svd, e) = frame(&nudged(1e-6, &mut random), 4);
        let aligned = align(&e.x, &svd.sigma, &previous, &same(22)).unwrap();
        assert!(largest_move(&aligned, &previous) < 1e-4);
        assert_same_distances(&aligned, &e.x);
        previous = aligned;
    }
}

#[test]
fn dimension_and_roster_may_change() {
    let a = cliques(&[7, 6, 4]);
    let (_, old) = frame(&a, 2);
    let (svd, new) = frame(&a, 3);
    // Old rows 1.. are new rows 0..; one old node is gone.
    let aligned = align(&new.x, &svd.sigma, &old.x, &same(17)).unwrap();
    assert_same_distances(&aligned, &new.x);
    let fewer = align(&old.x, &svd.sigma[..2], &new.x, &same(17)).unwrap();
    assert_same_distances(&fewer, &old.x);
    assert_eq!(align(&new.x, &svd.sigma, &old.x, &same(0)).unwrap(), new.x);
    let none = DenseMatrix::zeros(0, 0).unwrap();
    assert_eq!(align(&new.x, &svd.sigma, &none, &same(0)).unwrap(), new.x);
}

#[test]
fn misfits_are_refused() {
    let x = DenseMatrix::zeros(3, 4).unwrap();
    let odd = DenseMatrix::zeros(3, 3).unwrap();
    let sigma = [2.0, 1.0];
    assert!(matches!(align(&x, &[1.0], &x, &[(0, 0)]), Err(AlignError::Columns { .. })));
    assert!(matches!(align(&x, &sigma, &odd, &same(0)), Err(AlignError::OddColumns { cols: 3 })));
    for pair in [(3, 0), (0, 3)] {
        assert!(matches!(align(&x, &sigma, &x, &[pair]), Err(AlignError::Pair { .. })));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn alignment_keeps_all_distances(
        a in directed_graphs(14), b in directed_graphs(14), k in 1_usize..6, l in 1_usize..6,
    ) {
        let (_, old) = frame(&a, k.min(a.nodes()));
        let (svd, new) = frame(&b, l.min(b.nodes()));
        let pairs = same(a.nodes().min(b.nodes()));
        let aligned = align(&new.x, &svd.sigma, &old.x, &pairs).unwrap();
        assert_same_distances(&aligned, &new.x);
    }

    #[test]
    fn rows_have_length_one_or_zero(a in directed_graphs(20), k in 1_usize..6) {
        let (_, e) = frame(&a, k.min(a.nodes()));
        for (row, weak) in e.x.iter_rows().zip(&e.weak) {
            let length = row.iter().map(|v| v * v).sum::<f64>().sqrt();
            prop_assert!((length - f64::from(u8::from(!weak))).abs() < 1e-12);
        }
    }
}
