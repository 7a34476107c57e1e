//! The kept similarity against one that is solved from scratch.
use crate::common::fleet::Fleet;
use crate::common::*;
use muster_numeric::cached_katz::{CachedKatz, MAX_CACHED_NODES, MAX_PROBE, Method, Update};
use muster_numeric::fuse::{Normalization, fuse};
use muster_numeric::katz::{Alpha, KatzError, katz_similarity, resolve_alpha};
use muster_numeric::matrix::{DenseMatrix, MatrixError, SparseMatrix};
use muster_numeric::radius_bound::RadiusTracker;
use muster_numeric::spectral_radius::{SpectralRadius, spectral_radius};
use proptest::prelude::*;

fn cached(a: &SparseMatrix, alpha: Alpha) -> (CachedKatz, f64, SpectralRadius) {
    let radius = spectral_radius(a, None);
    let alpha = resolve_alpha(alpha, a, &radius).unwrap();
    let mut kept = CachedKatz::default();
    let update = kept.update(a, alpha, &radius, None).unwrap();
    assert_eq!(update.method, Method::Started);
    (kept, alpha, radius)
}

/// Largest deviation of the kept similarity relative to the largest entry of I + S.
fn deviation(kept: &CachedKatz, s: &DenseMatrix) -> f64 {
    let n = s.rows();
    assert_eq!(kept.nodes(), n);
    let mut top = 0.0_f64;
    for i in 0..n {
        for j in 0..n {
            let found = kept.pair(i, j).unwrap();
            assert!(found >= 0.0);
            top = top.max((found - s.get(i, j).unwrap()).abs());
        }
    }
    top / (1.0 + s.max_abs())
}

#[test]
fn closed_forms_after_updates() {
    // Edges close a ring, a star loses a ray, a clique and a path change into others.
    let alpha = 0.4;
    let (mut kept, ..) = cached(&directed_path(6, 1.0), Alpha::Value(alpha));
    kept.set_rank_share(1.0).unwrap();
    let ring = ring(6, 1.0);
    let found = kept.update(&ring, alpha, &spectral_radius(&ring, None), None).unwrap();
    assert_eq!((found.method, found.rank), (Method::Updated, 1));
    for j in 0..6 {
        let steps = if j == 0 { 6 } else { j as i32 };
        let expected = alpha.powi(steps) / (1.0 - alpha.powi(6));
        assert_close(kept.pair(0, j).unwrap(), expected, 1e-13);
    }

    let (mut kept, ..) = cached(&star(6), Alpha::Value(0.3));
    kept.set_rank_share(1.0).unwrap();
    let smaller = star(5);
    let map: Vec<Option<usize>> = (0..6).map(|i| (i < 5).then_some(i)).collect();
    let found = kept.update(&smaller, 0.3, &spectral_radius(&smaller, None), Some(&map)).unwrap();
    // Only the row of the removed node changes.
    assert_eq!((found.method, found.rank), (Method::Updated, 1));
    let hub = 1.0 / (1.0 - 4.0 * 0.09);
    assert_close(kept.pair(0, 0).unwrap(), hub - 1.0, 1e-13);
    assert_close(kept.pair(0, 3).unwrap(), 0.3 * hub, 1e-13);
    assert_close(kept.pair(1, 3).unwrap(), 0.09 * hub, 1e-13);
    assert_eq!(kept.pair(5, 0), None);

    let (mut kept, ..) = cached(&cliques(&[4, 5]), Alpha::Value(0.1));
    kept.set_rank_share(1.0).unwrap();
    let joined = cliques(&[5, 5]);
    let map: Vec<Option<usize>> = (0..9).map(|i| Some(if i < 4 { i } else { i + 1 })).collect();
    let found = kept.update(&joined, 0.1, &spectral_radius(&joined, None), Some(&map)).unwrap();
    assert_eq!((found.method, found.rank), (Method::Updated, 2));
    let off = 0.1 / ((1.0 + 0.1) * (1.0 - 0.1 * 4.0));
    for (i, j) in [(0, 1), (0, 4), (4, 2), (7, 9)] {
        assert_close(kept.pair(i, j).unwrap(), off, 1e-13);
    }
    assert!(kept.pair(0, 7).unwrap() < 1e-16);

    let (mut kept, ..) = cached(&directed_path(8, 1.0), Alpha::Value(0.3));
    kept.set_rank_share(1.0).unwrap();
    let reversed: Vec<Option<usize>> = (0..8).map(|i| Some(7 - i)).collect();
    let back = directed_path(8, 1.0).transpose();
    let found = kept.update(&back, 0.3, &spectral_radius(&back, None), Some(&reversed)).unwrap();
    assert_eq!((found.method, found.rank), (Method::Kept, 0));
    assert_close(kept.pair(7, 2).unwrap(), 0.3_f64.powi(5), 1e-14);
}

fn check_against_scratch(kept: &CachedKatz, a: &SparseMatrix, radius: &SpectralRadius) {
    let scratch = katz_similarity(a, kept.alpha(), radius).unwrap();
    let off = deviation(kept, &scratch);
    assert!(off <= 1e-10, "{off:e}");
}

#[test]
fn ten_thousand_changes_leave_the_similarity_of_scratch() {
    let mut fleet = Fleet::new(90, 4);
    let mut tracker = RadiusTracker::default();
    let mut kept = CachedKatz::default();
    let mut updated = 0;
    let mut worst = 0.0_f64;
    let mut alpha = 0.0;
    let mut gathered: Option<Vec<Option<usize>>> = None;
    for step in 0..10_000 {
        let map = fleet.change();
        let a = fleet.graph();
        if gathered.is_none() {
            alpha = 0.6 / tracker.bound(&a).upper;
        }
        tracker.carry(&map, a.nodes());
        let bound = tracker.bound(&a);
        let radius = tracker.spectral_radius(&bound);
        if alpha * bound.upper >= 0.95 {
            alpha = 0.6 / bound.upper;
        }
        let map = gathered.is_some().then_some(map);
        gathered = Some(Vec::new());
        // Some changes are collected.
        if step % 7 < 3 && step % 500 != 499 {
            kept.defer(&a, alpha, &radius, map.as_deref()).unwrap();
            assert!(step == 0 || kept.pair(0, 0).is_none());
            continue;
        }
        let found = kept.update(&a, alpha, &radius, map.as_deref()).unwrap();
        assert!(found.probe <= MAX_PROBE, "{found:?}");
        worst = worst.max(found.probe);
        updated += usize::from(found.method == Method::Updated);
        if step % 500 == 499 {
            check_against_scratch(&kept, &a, &radius);
        }
    }
    assert!(updated > 5000, "{updated}");
    assert!(worst < 1e-12, "{worst:e}");
}

#[test]
fn reasons_to_solve_from_scratch() {
    let a = Fleet::new(60, 1).graph();
    let (mut kept, alpha, radius) = cached(&a, Alpha::Fraction { fraction: 0.5 });
    let mut method = |a: &SparseMatrix, alpha, map: Option<&[Option<usize>]>| {
        let Update { method, .. } = kept.update(a, alpha, &radius, map).unwrap();
        check_against_scratch(&kept, a, &radius);
        method
    };
    assert_eq!(method(&a, alpha, None), Method::Kept);
    assert_eq!(method(&a, 0.9 * alpha, None), Method::Started);
    let weaker = |part: f64| {
        SparseMatrix::from_triplets(60, a.triplets().map(|(i, j, w)| (i, j, w * part))).unwrap()
    };
    assert_eq!(method(&weaker(0.5), 0.9 * alpha, None), Method::TooMany);
    let third: Vec<Option<usize>> = (0..60).map(|i| (i < 20).then_some(i)).collect();
    let few = SparseMatrix::from_triplets(20, a.triplets().filter(|e| e.0.max(e.1) < 20)).unwrap();
    assert_eq!(method(&few, 0.9 * alpha, Some(&third)), Method::Compacted);
    assert_eq!(method(&a, 0.9 * alpha, None), Method::Started);
    assert_eq!(method(&few, 0.9 * alpha, Some(&third[1..])), Method::Started);
    assert_eq!(method(&few, 0.9 * alpha, Some(&[Some(0); 20])), Method::Started);
}

#[test]
fn decays_from_the_bound_on_are_refused_and_change_nothing() {
    let a = star(5);
    let (mut kept, alpha, radius) = cached(&a, Alpha::Fraction { fraction: 0.5 });
    for bad in [0.5, 0.6, 1e9] {
        let found = kept.update(&a, bad, &radius, None);
        assert!(matches!(found, Err(KatzError::Diverges { .. })));
    }
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(kept.defer(&a, bad, &radius, None), Err(KatzError::Alpha(_))));
    }
    let large = graph(MAX_CACHED_NODES + 1, &[]);
    let zero = spectral_radius(&large, None);
    let found = kept.update(&large, 0.5, &zero, None);
    assert!(matches!(found, Err(KatzError::Matrix(MatrixError::TooLarge { .. }))));
    assert_eq!(kept.alpha(), alpha);
    check_against_scratch(&kept, &a, &radius);
}

#[test]
fn empty_fleets_and_out_of_range() {
    let none = graph(0, &[]);
    let zero = spectral_radius(&none, None);
    let mut kept = CachedKatz::default();
    assert_eq!(kept.pair(0, 0), None);
    for _ in 0..2 {
        assert_eq!(kept.update(&none, 0.5, &zero, None).unwrap().probe, 0.0);
    }
    // Robots join an empty fleet, and all leave again.
    let two = graph(2, &[(0, 1, 1.0)]);
    kept.update(&two, 0.5, &spectral_radius(&two, None), Some(&[])).unwrap();
    assert_eq!((kept.pair(0, 1), kept.pair(1, 0)), (Some(0.5), Some(0.0)));
    kept.update(&none, 0.5, &zero, Some(&[None, None])).unwrap();
    assert_eq!((kept.nodes(), kept.pair(0, 0)), (0, None));
    let chain = directed_path(10, 1.0);
    let radius = spectral_radius(&chain, None);
    let found = kept.update(&chain, 1e60, &radius, None);
    assert!(matches!(found, Err(KatzError::Overflow { .. })));
    assert_eq!(kept.pair(0, 1), None);
    assert!(kept.update(&chain, 0.5, &radius, None).is_ok());
    assert_eq!(kept.pair(0, 1), Some(0.5));
}

#[test]
fn shares_sum_to_the_whole() {
    let (a, b) = (Fleet::new(40, 2).graph(), Fleet::new(40, 3).graph());
    let graphs = [(&a, 0.3), (&b, 0.7)];
    let fused = fuse(&graphs, Normalization::None).unwrap();
    let (kept, ..) = cached(&fused, Alpha::Fraction { fraction: 0.7 });
    for (i, j) in [(0, 0), (3, 17), (39, 1)] {
        let shares = kept.shares(i, j, &graphs).unwrap();
        assert!(shares.iter().all(|s| *s >= 0.0));
        assert_close(shares.iter().sum(), kept.pair(i, j).unwrap(), 1e-13);
    }
    assert_eq!(kept.shares(0, 40, &graphs), None);
    // Over a path that changes graphs only the first step counts.
    let (first, second) = (graph(3, &[(0, 1, 1.0)]), graph(3, &[(1, 2, 1.0)]));
    let graphs = [(&first, 1.0), (&second, 1.0)];
    let (kept, ..) = cached(&fuse(&graphs, Normalization::None).unwrap(), Alpha::Value(0.5));
    assert_eq!(kept.shares(0, 2, &graphs).unwrap(), [0.25, 0.0]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn updates_equal_scratch(a in directed_graphs(20), b in directed_graphs(20), f in 0.1..0.7_f64, seed: u64) {
        // From a to b by any partial map: from scratch, and by an update.
        let (ra, rb) = (spectral_radius(&a, None), spectral_radius(&b, None));
        let limit = ra.upper.max(rb.upper).max(a.max_weight()).max(b.max_weight());
        prop_assume!(limit > 0.0);
        let alpha = f / limit;
        let (n, m) = (a.nodes(), b.nodes());
        let order = permutation(n.max(m), seed);
        let map: Vec<Option<usize>> = (0..n).map(|i| Some(order[i]).filter(|k| *k < m)).collect();
        let mut kept = CachedKatz::default();
        kept.set_rank_share(f64::INFINITY).unwrap();
        kept.update(&a, alpha, &ra, None).unwrap();
        let found = kept.update(&b, alpha, &rb, Some(&map)).unwrap();
        prop_assert!(found.probe <= MAX_PROBE);
        let scratch = katz_similarity(&b, alpha, &rb).unwrap();
        let off = deviation(&kept, &scratch);
        prop_assert!(off <= 1e-10, "{} {:?}", off, found);
    }
}
