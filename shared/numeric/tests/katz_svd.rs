//! The leading triplets against the full decomposition, from frame to frame.

use muster_numeric::katz::{KatzError, katz_similarity};
use muster_numeric::katz_svd::{KatzSvd, KatzSvdError, KatzSvdOptions, KatzSvdOptionsError};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::spectral_radius::spectral_radius;
use muster_numeric::svd::{RankKSvd, full_svd};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn options(rank: usize, tolerance: f64) -> KatzSvdOptions {
    KatzSvdOptions { exact: None, rank, tolerance, seed: 3, threads: 1 }
}

fn random_graph(n: usize, degree: usize, seed: u64) -> SparseMatrix {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let edges: Vec<_> = (0..degree * n)
        .map(|_| (rng.random_range(0..n), rng.random_range(0..n), rng.random::<f64>()))
        .collect();
    SparseMatrix::from_triplets(n, edges).unwrap()
}

/// U Uᵀ of the leading columns, whose entries do not depend on signs and rotations.
fn projector(u: &DenseMatrix) -> DenseMatrix {
    let n = u.rows();
    let rows: Vec<Vec<f64>> = (0..n)
        .map(|i| (0..n).map(|j| u.row(i).iter().zip(u.row(j)).map(|(a, b)| a * b).sum()).collect())
        .collect();
    DenseMatrix::from_rows(&rows).unwrap()
}

fn largest_difference(a: &DenseMatrix, b: &DenseMatrix) -> f64 {
    a.data().iter().zip(b.data()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// The full decomposition of the similarity of `a`.
fn whole(a: &SparseMatrix, alpha: f64, k: usize) -> RankKSvd {
    let radius = spectral_radius(a, None);
    full_svd(&katz_similarity(a, alpha, &radius).unwrap()).unwrap().truncate(k).unwrap()
}

#[test]
fn triplets_and_subspaces_equal_those_of_the_full_decomposition() {
    for (n, fraction, seed) in [(70, 0.5, 1), (130, 0.9, 2), (257, 0.5, 3), (300, 0.95, 4)] {
        let a = random_graph(n, 5, seed);
        let radius = spectral_radius(&a, None);
        let alpha = fraction / radius.upper;
        let mut solver = KatzSvd::default();
        let report = solver.solve(&a, alpha, &radius, options(6, 1e-10), None).unwrap();
        assert!(report.converged && report.residual <= 1e-10, "{report:?}");
        let (found, wanted) = (solver.truncate(6).unwrap(), whole(&a, alpha, 6));
        for (found, wanted) in found.sigma.iter().zip(&wanted.sigma) {
            assert!((found - wanted).abs() <= 1e-12 * wanted, "{found} {wanted}");
        }
        let gap = wanted.gap();
        for (found, wanted) in [(&found.u, &wanted.u), (&found.v, &wanted.v)] {
            let difference = largest_difference(&projector(found), &projector(wanted));
            assert!(difference <= 1e-8 / gap.min(1.0), "n {n}: {difference} gap {gap}");
        }
        let similarity = katz_similarity(&a, alpha, &radius).unwrap();
        assert!(found.residual(&similarity).unwrap() < 1e-8);
    }
}

#[test]
fn a_search_starts_from_the_triplets_of_the_previous_frame() {
    let n = 200;
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut places: Vec<(f64, f64)> =
        (0..n).map(|_| (14.0 * rng.random::<f64>(), 14.0 * rng.random::<f64>())).collect();
    let headings: Vec<f64> = (0..n).map(|_| 6.3 * rng.random::<f64>()).collect();
    let graph = |places: &[(f64, f64)]| {
        let mut edges = Vec::new();
        for i in 0..n {
            for j in 0..n {
                let square =
                    (places[i].0 - places[j].0).powi(2) + (places[i].1 - places[j].1).powi(2);
                if i != j && square < 9.0 {
                    // Not symmetric: a search of a symmetric graph begins with most of its answer.
                    let strength = if i < j { 1.0 } else { 0.9 };
                    edges.push((i, j, strength * (1.0 - square / 9.0).powi(3)));
                }
            }
        }
        SparseMatrix::from_triplets(n, edges).unwrap()
    };
    let first = graph(&places);
    let alpha = 0.8 / spectral_radius(&first, None).upper;
    let (mut warm, mut rounds) = (KatzSvd::default(), Vec::new());
    for frame in 0..30 {
        let a = graph(&places);
        let radius = spectral_radius(&a, None);
        let report = warm.solve(&a, alpha, &radius, options(5, 1e-7), None).unwrap();
        assert!(report.converged);
        let wanted = whole(&a, alpha, 5);
        for (found, wanted) in warm.all_singular_values().iter().zip(&wanted.sigma) {
            assert!((found - wanted).abs() <= 1e-9 * wanted, "frame {frame}");
        }
        rounds.push(report.rounds);
        for (place, heading) in places.iter_mut().zip(&headings) {
            place.0 += 0.005 * heading.cos();
            place.1 += 0.005 * heading.sin();
        }
    }
    let later: usize = rounds[2..].iter().sum();
    assert!(later * 3 <= rounds[0] * (rounds.len() - 2) * 2, "{rounds:?}");
}

#[test]
fn nodes_join_and_leave_between_frames() {
    let a = random_graph(120, 5, 7);
    let radius = spectral_radius(&a, None);
    let alpha = 0.5 / radius.upper;
    let mut solver = KatzSvd::default();
    solver.solve(&a, alpha, &radius, options(4, 1e-9), None).unwrap();
    // Node 3 leaves, and two new nodes come first.
    let kept: Vec<usize> = (0..120).filter(|i| *i != 3).collect();
    let previous: Vec<Option<usize>> =
        [None, None].into_iter().chain(kept.iter().copied().map(Some)).collect();
    let place = |old: usize| kept.iter().position(|kept| *kept == old).map(|at| at + 2);
    let edges = a.triplets().filter_map(|(i, j, w)| Some((place(i)?, place(j)?, w)));
    let b = SparseMatrix::from_triplets(121, edges.chain([(0, 5, 0.5), (7, 1, 0.3)])).unwrap();
    let radius = spectral_radius(&b, None);
    let report = solver.solve(&b, alpha, &radius, options(4, 1e-9), Some(&previous)).unwrap();
    assert!(report.converged);
    for (found, wanted) in solver.all_singular_values().iter().zip(&whole(&b, alpha, 4).sigma) {
        assert!((found - wanted).abs() <= 1e-11 * wanted);
    }
    let wrong = solver.solve(&b, alpha, &radius, options(4, 1e-9), Some(&[Some(500)]));
    assert_eq!(wrong, Err(KatzSvdError::Correspondence { nodes: 121 }));
}

#[test]
fn a_vector_missing_from_every_start_is_found_by_a_probe() {
    // Two fleets without an edge between them: the second grows while the search follows only the
    // first.
    let block = |scale: f64, offset: usize| {
        (0..60).flat_map(move |i| {
            let (from, to) = (offset + i, offset + (i + 1) % 60);
            [(from, to, scale), (to, from, scale)]
        })
    };
    let graph = |second: f64| {
        let edges = block(1.0, 0).chain(block(second, 60));
        SparseMatrix::from_triplets(120, edges).unwrap()
    };
    let mut solver = KatzSvd::default();
    let alpha = 0.1;
    let mut found = 0.0;
    for frame in 0..30 {
        let a = graph(if frame < 5 { 1e-9 } else { 4.0 });
        let radius = spectral_radius(&a, None);
        solver.solve(&a, alpha, &radius, options(3, 1e-6), None).unwrap();
        found = solver.all_singular_values()[0];
    }
    let wanted = whole(&graph(4.0), alpha, 1).sigma[0];
    assert!((found - wanted).abs() < 1e-6 * wanted, "{found} {wanted}");
}

#[test]
fn degenerate_graphs_have_answers() {
    let none = SparseMatrix::from_triplets(80, []).unwrap();
    let mut solver = KatzSvd::default();
    let report =
        solver.solve(&none, 0.5, &spectral_radius(&none, None), options(3, 1e-6), None).unwrap();
    assert!(report.converged);
    let svd = solver.truncate(3).unwrap();
    assert_eq!(svd.sigma, [0.0; 3]);
    assert!(svd.u.data().iter().chain(svd.v.data()).all(|value| *value == 0.0));
    // A chain has a nilpotent matrix, and a single edge a similarity of rank 1.
    for edges in [(0..79).map(|i| (i, i + 1, 1.0)).collect::<Vec<_>>(), vec![(5, 9, 2.0)]] {
        let a = SparseMatrix::from_triplets(80, edges).unwrap();
        let mut solver = KatzSvd::default();
        let report =
            solver.solve(&a, 0.7, &spectral_radius(&a, None), options(3, 1e-9), None).unwrap();
        assert!(report.converged, "{report:?}");
        let wanted = whole(&a, 0.7, 3);
        for (found, wanted) in solver.all_singular_values().iter().zip(&wanted.sigma) {
            assert!(
                (found - wanted).abs() <= 1e-7 * wanted.max(1.0),
                "{found} {wanted} {report:?} {:?}",
                solver.all_singular_values()
            );
        }
    }
    for n in [1, 2, 7] {
        let a = random_graph(n, 3, 1);
        let radius = spectral_radius(&a, None);
        let mut solver = KatzSvd::default();
        let report =
            solver.solve(&a, 0.3 / radius.upper.max(1.0), &radius, options(n, 1e-9), None).unwrap();
        assert!(report.converged);
    }
    // Weights beyond single precision.
    let a = SparseMatrix::from_triplets(70, (0..69).map(|i| (i, i + 1, 1e90))).unwrap();
    let radius = spectral_radius(&a, None);
    let _ = KatzSvd::default().solve(&a, 1e-90, &radius, options(2, 1e-6), None).unwrap();
    let _ = KatzSvd::default().solve(&a, 1e-40, &radius, options(2, 1e-6), None).unwrap();
}

/// A square lattice of `side` × `side` nodes, whose leading values lie close together.
fn lattice(side: usize, seed: u64) -> SparseMatrix {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut edges = Vec::new();
    for (x, y) in (0..side).flat_map(|x| (0..side).map(move |y| (x, y))) {
        let (node, mut weight) = (x * side + y, || 1.0 + 0.01 * rng.random::<f64>());
        for next in [(x + 1 < side).then_some(node + side), (y + 1 < side).then_some(node + 1)] {
            edges.extend(next.map(|next| (node, next, weight())));
            edges.extend(next.map(|next| (next, node, weight())));
        }
    }
    SparseMatrix::from_triplets(side * side, edges).unwrap()
}

#[test]
fn a_search_of_few_rounds_is_continued_in_the_next_frame() {
    const ROUNDS: usize = 5;
    let a = lattice(40, 6);
    let radius = spectral_radius(&a, None);
    let alpha = 0.6 / radius.upper;
    let mut at_once = KatzSvd::default();
    let whole = at_once.solve(&a, alpha, &radius, options(6, 1e-9), None).unwrap();
    assert!(whole.converged && whole.rounds > 2 * ROUNDS, "no close values: {whole:?}");
    let mut bit_by_bit = KatzSvd::default();
    bit_by_bit.limit_rounds(ROUNDS);
    let (mut residuals, mut last) = (Vec::new(), None);
    for _ in 0..200 {
        let report = bit_by_bit.solve(&a, alpha, &radius, options(6, 1e-9), None).unwrap();
        assert!(report.rounds <= ROUNDS && report.complete <= report.converged, "{report:?}");
        residuals.push(report.residual);
        last = Some(report);
        if report.complete {
            break;
        }
    }
    assert!(last.is_some_and(|last| last.complete), "{residuals:?}");
    assert!(residuals.len() > 2 && residuals[0] > 1e-9, "{residuals:?}");
    let (found, wanted) = (bit_by_bit.truncate(6).unwrap(), at_once.truncate(6).unwrap());
    for (found, wanted) in found.sigma.iter().zip(&wanted.sigma) {
        assert!((found - wanted).abs() <= 1e-10 * wanted, "{found} {wanted}");
    }
}

#[test]
fn invalid_input_is_refused_by_name() {
    let a = random_graph(70, 4, 1);
    let radius = spectral_radius(&a, None);
    let mut solver = KatzSvd::default();
    let mut ask = |alpha, rank, tolerance| {
        solver.solve(&a, alpha, &radius, options(rank, tolerance), None).unwrap_err()
    };
    assert!(matches!(ask(-1.0, 3, 1e-6), KatzSvdError::Katz(KatzError::Alpha(_))));
    let limit = 1.0 / radius.upper;
    assert!(matches!(ask(limit, 3, 1e-6), KatzSvdError::Katz(KatzError::Diverges { .. })));
    assert!(matches!(ask(0.1 * limit, 0, 1e-6), KatzSvdError::Options(KatzSvdOptionsError::Rank)));
    assert!(matches!(ask(0.1 * limit, 71, 1e-6), KatzSvdError::Rank(_)));
    for tolerance in [0.0, f64::NAN] {
        let refused = ask(0.1 * limit, 3, tolerance);
        assert!(matches!(refused, KatzSvdError::Options(KatzSvdOptionsError::Tolerance(_))));
    }
    let none = KatzSvdOptions { threads: 0, ..options(3, 1e-6) };
    assert_eq!(none.check(), Err(KatzSvdOptionsError::Threads));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn values_do_not_depend_on_the_order_of_the_nodes(seed in 0..1000u64, n in 65..140usize) {
        let a = random_graph(n, 4, seed);
        let radius = spectral_radius(&a, None);
        prop_assume!(radius.upper > 0.0);
        let alpha = 0.7 / radius.upper;
        let shifted = a.triplets().map(|(i, j, w)| ((i + 7) % n, (j + 7) % n, w));
        let b = SparseMatrix::from_triplets(n, shifted).unwrap();
        let (mut first, mut second) = (KatzSvd::default(), KatzSvd::default());
        let options = options(4, 1e-10);
        prop_assert!(first.solve(&a, alpha, &radius, options, None).unwrap().converged);
        prop_assert!(second.solve(&b, alpha, &radius, options, None).unwrap().converged);
        for (l, r) in first.all_singular_values().iter().zip(second.all_singular_values()).take(4) {
            prop_assert!((l - r).abs() <= 1e-11 * l);
        }
    }
}
