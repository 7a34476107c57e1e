//! Bounds of the spectral radius for moving fleets: always true, and narrow where promised.
use crate::common::*;
use muster_numeric::alpha_band::AlphaBand;
use muster_numeric::katz::{Alpha, KatzError, katz_similarity, resolve_alpha};
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::radius_bound::{LIVE_WIDTH, RadiusBound, RadiusTracker, WidthError};
use proptest::prelude::*;
use std::f64::consts::PI;

fn check(a: &SparseMatrix, expected: f64) {
    for width in [LIVE_WIDTH, 1e-3, 1e-8, 0.0] {
        let mut tracker = RadiusTracker::default();
        // Cold, and started from its own end.
        for _ in 0..2 {
            let found = tracker.refine(a, width).unwrap();
            enclosed(&found, expected, 1e-14);
            assert!(relative_width(&found) <= width.max(3e-13), "{width}: {found:?} {expected}");
            assert!(!found.acyclic && tracker.vector().iter().all(|x| *x > 0.0));
        }
    }
}

fn enclosed(found: &RadiusBound, expected: f64, rounding: f64) {
    let (low, high) = (expected * (1.0 - rounding), expected * (1.0 + rounding));
    assert!(found.lower <= high && found.upper >= low, "{found:?} does not enclose {expected}");
}

/// ρ = lim ‖A^m‖^(1/m) (Gelfand) for m = 2⁶⁰ by squaring: nothing is subtracted, so that the error
/// is a rounding or two.
fn radius_by_squaring(a: &SparseMatrix) -> f64 {
    let n = a.nodes();
    let mut power = a.to_dense().unwrap().into_data();
    let mut log = 0.0;
    let mut part = 1.0;
    for _ in 0..60 {
        let top = power.iter().fold(0.0_f64, |m, v| v.max(m));
        if top == 0.0 {
            return 0.0;
        }
        log += part * top.ln();
        part *= 0.5;
        let scaled: Vec<f64> = power.iter().map(|v| v / top).collect();
        for i in 0..n {
            for j in 0..n {
                power[i * n + j] = (0..n).map(|k| scaled[i * n + k] * scaled[k * n + j]).sum();
            }
        }
    }
    log.exp()
}

#[test]
fn closed_forms() {
    for n in [2, 3, 7, 64, 300] {
        check(&ring(n, 0.3), 0.3);
        check(&cliques(&[n]), (n - 1) as f64);
        check(&star(n), ((n - 1) as f64).sqrt());
        check(&path(n), 2.0 * (PI / (n + 1) as f64).cos());
    }
    check(&cliques(&[10, 7, 3]), 9.0);
    check(&graph(2, &[(0, 1, 4.0), (1, 0, 9.0)]), 6.0);
    check(&graph(3, &[(1, 1, 2.5), (0, 1, 7.0)]), 2.5);
    // Two cliques with a bridge of 1e-8: eigenvalues 9 ± 1e-9.
    let mut edges: Vec<_> = cliques(&[10, 10]).triplets().collect();
    edges.extend([(0, 10, 1e-8), (10, 0, 1e-8)]);
    check(&graph(20, &edges), 9.000000001);
}

#[test]
fn acyclic_graphs_have_radius_zero() {
    let tree: Vec<_> = (1..200).map(|i| ((i - 1) / 3, i, 1e3)).collect();
    for a in [graph(200, &tree), directed_path(300, 5.0), graph(0, &[]), graph(4, &[])] {
        let mut tracker = RadiusTracker::default();
        for found in [tracker.bound(&a), tracker.refine(&a, 1e-9).unwrap()] {
            assert_eq!((found.lower, found.upper, found.acyclic), (0.0, 0.0, true));
            assert_eq!(tracker.vector(), vec![1.0; a.nodes()]);
        }
    }
}

#[test]
fn acyclic_and_isolated_parts_spoil_no_bound() {
    // A heavy chain into and out of a weak clique, a separate heavy tree, and isolated nodes.
    let mut edges: Vec<_> = cliques(&[6]).triplets().collect();
    edges.extend((6..40).map(|i| (i, i - 1, 1e3)));
    edges.extend((41..60).map(|i| (i - 1, i, 1e4)));
    edges.push((0, 70, 1e5));
    check(&graph(80, &edges), 5.0);
    // A slow ring after a fast one, joined by a heavy edge.
    let mut edges: Vec<_> = (0..9).map(|i| (i, (i + 1) % 9, 1.0)).collect();
    edges.extend((0..5).map(|i| (9 + i, 9 + (i + 1) % 5, 0.99)));
    edges.extend([(3, 9, 1e6)]);
    check(&graph(14, &edges), 1.0);
}

#[test]
fn graded_and_periodic_rings() {
    let weights = [1e30, 1e-30, 1e15, 1e-15, 1.0];
    let edges: Vec<_> = (0..5).map(|i| (i, (i + 1) % 5, weights[i])).collect();
    check(&graph(5, &edges), 1.0);
    let edges = [(0, 1, 1.0), (1, 2, 1.0), (2, 3, 1.0), (3, 0, 1e-16)];
    check(&graph(4, &edges), 1e-4);
    // Dominant eigenvalues on a circle but for a chord.
    let mut edges: Vec<_> = (0..60).map(|i| (i, (i + 1) % 60, 1.0)).collect();
    edges.push((0, 30, 1e-3));
    let found = RadiusTracker::default().refine(&graph(60, &edges), 1e-10).unwrap();
    assert!(relative_width(&found) <= 1e-10 && found.lower > 1.0);
}

#[test]
fn large_components_keep_honest_bounds() {
    let n = 6000;
    let expected = 2.0 * (PI / (n + 1) as f64).cos();
    let mut tracker = RadiusTracker::default();
    let found = tracker.bound(&path(n));
    enclosed(&found, expected, 1e-15);
    assert!(relative_width(&found) <= LIVE_WIDTH);
    let found = tracker.refine(&path(n), 1e-3).unwrap();
    enclosed(&found, expected, 1e-15);
    assert!(relative_width(&found) <= 1e-3, "{found:?}");
}

#[test]
fn invalid_widths_are_refused() {
    for width in [f64::NAN, -1e-3] {
        let found = RadiusTracker::default().refine(&star(4), width);
        assert!(matches!(found, Err(WidthError(_))));
    }
}

#[test]
fn vectors_go_along_with_their_nodes() {
    let n = 120;
    let mut edges: Vec<_> = cliques(&[9, 8]).triplets().collect();
    edges.extend((17..n).flat_map(|i| [(i, i - 1, 0.5), (i - 1, i, 0.5)]));
    let a = graph(n, &edges);
    let mut tracker = RadiusTracker::default();
    tracker.bound(&a);
    // Two nodes leave at the end, the order of the others reverses, and one joins.
    let map: Vec<Option<usize>> = (0..n).map(|i| (n - 3).checked_sub(i)).collect();
    let moved = a.triplets().filter_map(|(i, j, w)| Some((map[i]?, map[j]?, w)));
    let b = SparseMatrix::from_triplets(n - 1, moved).unwrap();
    let vector = tracker.vector().to_vec();
    tracker.carry(&map, n - 1);
    assert_eq!(tracker.vector()[n - 3], vector[0]);
    let found = tracker.bound(&b);
    assert!(found.sweeps <= 3 && relative_width(&found) <= LIVE_WIDTH, "{found:?}");
    tracker.carry(&[Some(7)], 3);
    assert_eq!(tracker.vector(), [1.0; 3]);
}

#[test]
fn decays_are_refused_by_the_bound() {
    let a = star(5);
    let mut tracker = RadiusTracker::default();
    let bound = tracker.bound(&a);
    let radius = tracker.spectral_radius(&bound);
    for alpha in [0.5, 0.500001, 9.0] {
        let refused = |found: Option<KatzError>| {
            assert!(matches!(found, Some(KatzError::Diverges { .. })), "{found:?}");
        };
        refused(resolve_alpha(Alpha::Value(alpha), &a, &radius).err());
        refused(katz_similarity(&a, alpha, &radius).err());
        refused(tracker.solve_centrality(&a, alpha, &bound, 1e-3).err());
    }
    for alpha in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let found = tracker.solve_centrality(&a, alpha, &bound, 1e-3);
        assert!(matches!(found, Err(KatzError::Alpha(_))));
    }
    assert!(tracker.solve_centrality(&a, 0.95 / bound.upper, &bound, 1e-3).is_ok());
}

#[test]
fn centralities_of_heavy_chains_overflow_with_a_message() {
    let a = directed_path(400, 1.0);
    let mut tracker = RadiusTracker::default();
    let bound = tracker.bound(&a);
    let found = tracker.solve_centrality(&a, 1e3, &bound, 1e-6);
    assert!(matches!(found, Err(KatzError::Overflow { .. })), "{found:?}");
    assert!(tracker.solve_centrality(&a, 0.5, &bound, 1e-6).is_ok());
}

#[test]
fn centralities_over_a_spectrum_that_chebyshev_steps_do_not_damp() {
    let edges = [
        (0, 0, 0.07507118638139033),
        (0, 1, 1.0),
        (0, 3, 8.150565162269658),
        (0, 5, 49.61230274380968),
        (1, 5, 34.07420654155142),
        (3, 1, 4.328640991290111),
        (3, 4, 10.686246594680219),
        (4, 0, 1.8052891488701472),
        (5, 4, 1.0),
        (5, 5, 3.158303455864465),
    ];
    let a = graph(6, &edges);
    let mut tracker = RadiusTracker::default();
    let bound = tracker.bound(&a);
    for f in [0.5, 0.8054345567053536, 0.95] {
        let found = tracker.solve_centrality(&a, f / bound.upper, &bound, 1e-8).unwrap();
        assert!(found.residual <= 1e-8 && found.sweeps < 500, "{found:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn bounds_contain_the_radius(a in directed_graphs(25), b in directed_graphs(25), w in -10.0..-1.0_f64) {
        let width = 10.0_f64.powf(w);
        let mut tracker = RadiusTracker::default();
        for a in [&a, &b, &a] {
            let expected = radius_by_squaring(a);
            for found in [tracker.bound(a), tracker.refine(a, width).unwrap()] {
                prop_assert_eq!(found.acyclic, expected == 0.0);
                prop_assert!(found.lower <= expected * (1.0 + 1e-13), "{:?} {}", found, expected);
                prop_assert!(found.upper >= expected * (1.0 - 1e-13), "{:?} {}", found, expected);
            }
            prop_assert!(relative_width(&tracker.bound(a)) <= LIVE_WIDTH);
            prop_assert!(relative_width(&tracker.refine(a, width).unwrap()) <= width);
        }
    }

    #[test]
    fn bounds_do_not_depend_on_the_numbering(a in directed_graphs(25), seed: u64) {
        let order = permutation(a.nodes(), seed);
        let found = RadiusTracker::default().refine(&a, 1e-9).unwrap();
        let other = RadiusTracker::default().refine(&permuted(&a, &order), 1e-9).unwrap();
        prop_assert!(found.lower <= other.upper && other.lower <= found.upper);
    }

    #[test]
    fn centralities_are_as_exact_as_they_say(a in directed_graphs(20), f in 0.05..0.97_f64, e in 1..10_i32) {
        let mut tracker = RadiusTracker::default();
        let bound = tracker.bound(&a);
        let radius = tracker.spectral_radius(&bound);
        let alpha = resolve_alpha(Alpha::Fraction { fraction: f }, &a, &radius).unwrap();
        let tolerance = 10.0_f64.powi(-e);
        let expected = katz_centrality(&katz_similarity(&a, alpha, &radius).unwrap());
        for _ in 0..2 {
            let found = tracker.solve_centrality(&a, alpha, &bound, tolerance).unwrap();
            let rounding = 1e-13 * expected.iter().fold(0.0_f64, |m, v| v.max(m));
            prop_assert!(found.residual <= tolerance + rounding, "{:?}", found);
            for (x, y) in tracker.centralities().iter().zip(&expected) {
                prop_assert!(*x >= 1.0);
                prop_assert!((x - y).abs() <= (found.residual + rounding) * y, "{} {} {:?}", x, y, found);
            }
        }
    }

    #[test]
    fn decays_in_force_stay_admissible(a in directed_graphs(15), b in directed_graphs(15), f in 0.1..0.99_f64) {
        let mut band = AlphaBand::new(f, 0.1).unwrap();
        let mut tracker = RadiusTracker::default();
        for a in [&a, &b, &a] {
            let bound = tracker.bound(a);
            let alpha = band.choose(a, &bound).alpha;
            prop_assert!(alpha > 0.0 && alpha * radius_by_squaring(a) < 1.0);
        }
    }
}
