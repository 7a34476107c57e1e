//! The similarity and its decomposition, by every method, against independent oracles of more
//! digits.
use crate::common::precise::{Columns, decomposed, rational, series};
use crate::common::*;
use muster_numeric::cached_katz::CachedKatz;
use muster_numeric::katz::katz_similarity;
use muster_numeric::katz_svd::{KatzSvd, KatzSvdOptions};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::spectral_radius::spectral_radius;
use muster_numeric::svd::{RankKSvd, full_svd};
use proptest::prelude::*;

/// Graphs of whole weights.
fn whole_graphs(max_nodes: usize) -> impl Strategy<Value = SparseMatrix> {
    (1..=max_nodes).prop_flat_map(|n| {
        let edge = (0..n, 0..n, 1..6_u8).prop_map(|(i, j, w)| (i, j, f64::from(w)));
        prop::collection::vec(edge, 0..=n * n / 2 + 1)
            .prop_map(move |edges| SparseMatrix::from_triplets(n, edges).unwrap())
    })
}

/// Weights within a factor of a hundred, so that the similarity is not ruled by a single edge.
fn graphs(max_nodes: usize) -> impl Strategy<Value = SparseMatrix> {
    (2..=max_nodes).prop_flat_map(|n| {
        let edge = (0..n, 0..n, 0.01..1.0_f64);
        prop::collection::vec(edge, n..=4 * n)
            .prop_map(move |edges| SparseMatrix::from_triplets(n, edges).unwrap())
    })
}

fn dense(s: &Columns) -> DenseMatrix {
    let n = s.len();
    let rows: Vec<Vec<f64>> = (0..n).map(|i| s.iter().map(|c| c[i].value()).collect()).collect();
    DenseMatrix::from_rows(&rows).unwrap()
}

/// Largest deviation relative to the largest entry of I + S.
fn deviation(found: &DenseMatrix, wanted: &DenseMatrix) -> f64 {
    let apart = found.data().iter().zip(wanted.data()).map(|(a, b)| (a - b).abs());
    apart.fold(0.0, f64::max) / (1.0 + wanted.max_abs())
}

/// S from the cache.
fn cached(a: &SparseMatrix, from: &SparseMatrix, alpha: f64) -> DenseMatrix {
    let n = a.nodes();
    let mut kept = CachedKatz::default();
    kept.set_rank_share(f64::INFINITY).unwrap();
    let radius = spectral_radius(from, None);
    kept.update(from, alpha, &radius, None).unwrap();
    kept.update(a, alpha, &spectral_radius(a, None), None).unwrap();
    let rows: Vec<Vec<f64>> =
        (0..n).map(|i| (0..n).map(|j| kept.pair(i, j).unwrap()).collect()).collect();
    DenseMatrix::from_rows(&rows).unwrap()
}

/// Largest entry of the difference between the projectors onto the first k columns.
fn projectors_apart<'a>(u: &DenseMatrix, k: usize, wanted: impl Fn(usize) -> &'a [f64]) -> f64 {
    let mut worst = 0.0_f64;
    for i in 0..u.rows() {
        for j in 0..u.rows() {
            let found: f64 = u.row(i).iter().zip(u.row(j)).take(k).map(|(x, y)| x * y).sum();
            let wanted: f64 = (0..k).map(|c| wanted(c)[i] * wanted(c)[j]).sum();
            worst = worst.max((found - wanted).abs());
        }
    }
    worst
}

fn inverse_free(a: &SparseMatrix, alpha: f64, rank: usize) -> (KatzSvd, RankKSvd) {
    let mut search = KatzSvd::default();
    let options = KatzSvdOptions { exact: None, rank, tolerance: 1e-11, seed: 1, threads: 1 };
    let report = search.solve(a, alpha, &spectral_radius(a, None), options, None).unwrap();
    assert!(report.converged, "{report:?}");
    let svd = search.truncate(rank).unwrap();
    (search, svd)
}

#[test]
fn the_oracles_agree_with_each_other_and_with_a_closed_form() {
    // A ring of three with weight 2 and the decay 1/5: 0.4 to the power of the steps, over 1 − 0.4³.
    let ring = ring(3, 2.0);
    let around = 1.0 - 0.064;
    let expected = [0.064 / around, 0.4 / around, 0.16 / around];
    for s in [rational(&ring, 5), dense(&series(&ring, 0.2))] {
        for (i, j) in [(0, 0), (1, 2), (2, 1)] {
            let steps = (3 + j - i) % 3;
            assert_close(s.get(i, j).unwrap(), expected[steps], 1e-15);
        }
    }
    let a = graph(4, &[(0, 1, 3.0), (1, 2, 1.0), (2, 0, 5.0), (2, 3, 2.0), (3, 3, 4.0)]);
    let [exact, summed] = [rational(&a, 16), dense(&series(&a, 1.0 / 16.0))];
    assert!(deviation(&summed, &exact) < 1e-16);
    // A diagonal matrix has its entries for singular values.
    let loops = graph(3, &[(0, 0, 1.0), (1, 1, 3.0), (2, 2, 2.0)]);
    let values: Vec<f64> = decomposed(&series(&loops, 0.125)).iter().map(|t| t.0).collect();
    for (found, walk) in values.iter().zip([3.0_f64, 2.0, 1.0]) {
        assert_close(*found, walk / 8.0 / (1.0 - walk / 8.0), 1e-15);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn tiny_similarities_equal_those_in_whole_numbers(
        a in whole_graphs(6), b in whole_graphs(6), more in 1..20_i128,
    ) {
        let bound = spectral_radius(&a, None).upper.max(spectral_radius(&b, None).upper);
        let inverse = bound.ceil() as i128 + more;
        let alpha = 1.0 / inverse as f64;
        let wanted = rational(&a, inverse);
        let found = katz_similarity(&a, alpha, &spectral_radius(&a, None)).unwrap();
        prop_assert!(deviation(&found, &wanted) <= 1e-13);
        // By an update from another graph of the same nodes.
        let inside = b.triplets().filter(|e| e.0 < a.nodes() && e.1 < a.nodes());
        let from = SparseMatrix::from_triplets(a.nodes(), inside).unwrap();
        prop_assert!(deviation(&cached(&a, &from, alpha), &wanted) <= 1e-12);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(30))]

    #[test]
    fn similarities_and_triplets_equal_those_of_the_series(a in graphs(24), f in 0.1..0.95_f64) {
        let radius = spectral_radius(&a, None);
        let alpha = f / radius.upper.max(a.max_weight());
        let precise = series(&a, alpha);
        let wanted = dense(&precise);
        let found = katz_similarity(&a, alpha, &radius).unwrap();
        prop_assert!(deviation(&found, &wanted) <= 1e-13);

        let triplets = decomposed(&precise);
        let top = triplets[0].0;
        let full = full_svd(&found).unwrap();
        for (found, wanted) in full.singular_values().iter().zip(&triplets) {
            prop_assert!((found - wanted.0).abs() <= 1e-13 * top);
        }
        let k = (1 + a.nodes() / 4).min(a.nodes());
        let next = triplets.get(k).map_or(0.0, |triplet| triplet.0);
        let gap = (triplets[k - 1].0 - next) / top;
        prop_assume!(gap > 1e-6);
        let (search, by_search) = inverse_free(&a, alpha, k);
        for (found, wanted) in search.all_singular_values().iter().zip(&triplets).take(k) {
            prop_assert!((found - wanted.0).abs() <= 1e-13 * top);
        }
        for (svd, exact) in [(full.truncate(k).unwrap(), 1e-13), (by_search, 1e-10)] {
            let apart = projectors_apart(&svd.u, k, |c| &triplets[c].1)
                .max(projectors_apart(&svd.v, k, |c| &triplets[c].2));
            prop_assert!(apart <= exact * (k as f64) * (1.0 + top) / gap, "{:e} {:e}", apart, gap);
        }
    }
}
