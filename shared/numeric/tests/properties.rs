//! Properties of all graphs on the way to singular vectors, for every method.
use crate::common::fleet::Fleet;
use crate::common::*;
use muster_numeric::embedding::{Rows, Scale, embed};
use muster_numeric::fuse::{Normalization, fuse};
use muster_numeric::katz::katz_similarity;
use muster_numeric::katz_svd::{KatzSvd, KatzSvdOptions};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::spectral_radius::spectral_radius;
use muster_numeric::svd::{RankKSvd, full_svd};
use proptest::prelude::*;

const RANK: usize = 4;

/// A random directed graph of some edges for each node.
fn random_graph(n: usize, seed: u64) -> SparseMatrix {
    let mut random = numbers(seed);
    let mut node = || ((random)() * n as f64) as usize;
    let pairs: Vec<(usize, usize)> = (0..5 * n).map(|_| (node(), node())).collect();
    let mut random = numbers(seed ^ 77);
    let edges = pairs.into_iter().map(|(i, j)| (i, j, 0.05 + random()));
    SparseMatrix::from_triplets(n, edges).unwrap()
}

/// The leading triplets by both methods.
fn both(a: &SparseMatrix, alpha: f64) -> [RankKSvd; 2] {
    let radius = spectral_radius(a, None);
    let dense = full_svd(&katz_similarity(a, alpha, &radius).unwrap()).unwrap();
    let mut search = KatzSvd::default();
    let options = KatzSvdOptions { exact: None, rank: RANK, tolerance: 1e-11, seed: 8, threads: 1 };
    assert!(search.solve(a, alpha, &radius, options, None).unwrap().converged);
    [dense.truncate(RANK).unwrap(), search.truncate(RANK).unwrap()]
}

/// An entry of U Uᵀ or V Vᵀ.
fn projector(u: &DenseMatrix, i: usize, j: usize) -> f64 {
    u.row(i).iter().zip(u.row(j)).map(|(x, y)| x * y).sum()
}

fn decay(a: &SparseMatrix, fraction: f64) -> f64 {
    fraction / spectral_radius(a, None).upper.max(1e-3)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn triplets_go_along_with_their_nodes(seed in 0..10_000_u64, n in 66..130_usize) {
        let a = random_graph(n, seed);
        let alpha = decay(&a, 0.8);
        let order = permutation(n, seed ^ 5);
        for (one, two) in both(&a, alpha).into_iter().zip(both(&permuted(&a, &order), alpha)) {
            for (x, y) in one.sigma.iter().zip(&two.sigma) {
                prop_assert!((x - y).abs() <= 1e-12 * one.sigma[0]);
            }
            prop_assume!(one.gap() > 1e-5);
            for (u, t) in [(&one.u, &two.u), (&one.v, &two.v)] {
                for i in 0..n {
                    for j in 0..n {
                        let moved = projector(t, order[i], order[j]);
                        let apart = (projector(u, i, j) - moved).abs();
                        prop_assert!(apart <= 1e-10 / one.gap(), "{:e}", apart);
                    }
                }
            }
        }
    }

    #[test]
    fn isolated_nodes_change_nothing_and_have_rows_of_zero(
        seed in 0..10_000_u64, n in 66..110_usize, alone in 1..5_usize,
    ) {
        let a = random_graph(n, seed);
        let wider = SparseMatrix::from_triplets(n + alone, a.triplets()).unwrap();
        let alpha = decay(&a, 0.6);
        for (one, two) in both(&a, alpha).into_iter().zip(both(&wider, alpha)) {
            for (x, y) in one.sigma.iter().zip(&two.sigma) {
                prop_assert!((x - y).abs() <= 1e-12 * one.sigma[0]);
            }
            for u in [&two.u, &two.v] {
                for i in n..n + alone {
                    prop_assert!(u.row(i).iter().all(|value| value.abs() < 1e-13));
                }
            }
        }
        // Also for a rough search.
        let mut search = KatzSvd::default();
        let options = KatzSvdOptions { exact: None, rank: RANK, tolerance: 1e-2, seed: 8, threads: 1 };
        search.solve(&wider, alpha, &spectral_radius(&wider, None), options, None).unwrap();
        let embedded = embed(&search.truncate(RANK).unwrap(), Scale::SqrtSigma, Rows::Unit);
        prop_assert!(embedded.weak[n..].iter().all(|weak| *weak));
    }

    #[test]
    fn symmetric_graphs_have_one_space_and_the_values_of_their_eigenvalues(
        seed in 0..10_000_u64, n in 66..110_usize,
    ) {
        let a = symmetric(&random_graph(n, seed));
        let alpha = decay(&a, 0.7);
        // σ = |αλ/(1 − αλ)| over the eigenvalues λ, whose moduli are the singular values of A.
        let moduli = full_svd(&a.to_dense().unwrap()).unwrap();
        for svd in both(&a, alpha) {
            let first = alpha * moduli.singular_values()[0];
            prop_assert!((svd.sigma[0] - first / (1.0 - first)).abs() <= 1e-12 * svd.sigma[0]);
            for sigma in &svd.sigma {
                let is_of = |l: &f64| {
                    let walks = alpha * l;
                    let both = [walks / (1.0 - walks), walks / (1.0 + walks)];
                    both.iter().any(|value| (value - sigma).abs() <= 1e-11 * svd.sigma[0])
                };
                prop_assert!(moduli.singular_values().iter().any(is_of));
            }
            prop_assume!(svd.gap() > 1e-5);
            for i in 0..n {
                let apart = (projector(&svd.u, i, 0) - projector(&svd.v, i, 0)).abs();
                prop_assert!(apart <= 1e-10 / svd.gap());
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn all_weight_on_one_graph_is_that_graph_alone(
        a in directed_graphs(12), other in directed_graphs(12), place in 0..3_usize,
    ) {
        let n = a.nodes();
        let inside = other.triplets().filter(|e| e.0 < n && e.1 < n);
        let other = SparseMatrix::from_triplets(n, inside).unwrap();
        for scale in [Normalization::None, Normalization::Spectral] {
            let alone = fuse(&[(&a, 1.0)], scale).unwrap();
            let mut graphs = vec![(&other, 0.0), (&other, 0.0)];
            graphs.insert(place, (&a, 1.0));
            prop_assert_eq!(&fuse(&graphs, scale).unwrap(), &alone);
            if scale == Normalization::None {
                prop_assert_eq!(&alone, &a);
            }
        }
    }
}

#[test]
fn ten_thousand_changes_leave_the_triplets_of_scratch() {
    // Twenty-five changes between two frames, robots that join and leave among them.
    const CHANGES: usize = 25;
    const TOLERANCE: f64 = 1e-9;
    let mut fleet = Fleet::new(90, 21);
    let mut search = KatzSvd::default();
    let (mut known, mut checked, mut joined) = (0, 0, 0);
    for frame in 0..10_000 / CHANGES {
        // The present index of each robot of the last frame, and the previous index of each present
        // one.
        let mut places: Vec<Option<usize>> = (0..known).map(Some).collect();
        for _ in 0..CHANGES {
            let moved = fleet.change();
            for place in &mut places {
                *place = place.and_then(|at| moved.get(at).copied().flatten());
            }
        }
        let a = fleet.graph();
        let mut before = vec![None; a.nodes()];
        for (old, new) in places.iter().enumerate() {
            if let Some(new) = new {
                before[*new] = Some(old);
            }
        }
        joined += before.iter().filter(|old| old.is_none()).count();
        let radius = spectral_radius(&a, None);
        let alpha = 0.8 / radius.upper;
        let options =
            KatzSvdOptions { exact: None, rank: RANK, tolerance: TOLERANCE, seed: 2, threads: 1 };
        let previous = (frame > 0).then_some(before.as_slice());
        let report = search.solve(&a, alpha, &radius, options, previous).unwrap();
        assert!(report.converged && report.residual <= TOLERANCE, "frame {frame}: {report:?}");
        known = a.nodes();
        if frame % 8 != 7 {
            continue;
        }
        let scratch = full_svd(&katz_similarity(&a, alpha, &radius).unwrap()).unwrap();
        let wanted = scratch.truncate(RANK).unwrap();
        let found = search.truncate(RANK).unwrap();
        let top = wanted.sigma[0];
        for (found, wanted) in found.sigma.iter().zip(&wanted.sigma) {
            assert!((found - wanted).abs() <= 1e-10 * top, "frame {frame}: {found} {wanted}");
        }
        let bound = 2.0 * (1.0 + top) * TOLERANCE * (RANK as f64).sqrt() / wanted.gap();
        for (u, t) in [(&found.u, &wanted.u), (&found.v, &wanted.v)] {
            for i in 0..known {
                for j in 0..known {
                    let apart = (projector(u, i, j) - projector(t, i, j)).abs();
                    assert!(apart <= bound, "frame {frame}: {apart:e}, {bound:e} allowed");
                }
            }
        }
        checked += 1;
    }
    assert!(checked == 50 && joined > 200, "{checked} {joined}");
}
