//! Divisions by k-means.
use crate::common::{blobs, distance, numbers};
use muster_numeric::kmeans::{Init, KMeansError, KMeansOptions, KMeansOptionsError, kmeans, lloyd};
use muster_numeric::matrix::DenseMatrix;
use proptest::prelude::*;

const CORNERS: [&[f64]; 4] = [&[0.0, 0.0], &[4.0, 0.0], &[0.0, 4.0], &[4.0, 4.0]];

fn inertia(x: &DenseMatrix, labels: &[usize], k: usize) -> f64 {
    let mut sum = 0.0;
    for c in 0..k {
        let rows: Vec<&[f64]> =
            (0..x.rows()).filter(|&i| labels[i] == c).map(|i| x.row(i)).collect();
        let mean: Vec<f64> = (0..x.cols())
            .map(|j| rows.iter().map(|r| r[j]).sum::<f64>() / rows.len().max(1) as f64)
            .collect();
        sum += rows.iter().map(|r| distance(r, &mean).powi(2)).sum::<f64>();
    }
    sum
}

/// Smallest inertia over all labellings.
fn optimum(x: &DenseMatrix, k: usize) -> f64 {
    let n = x.rows();
    let mut best = f64::INFINITY;
    for code in 0..k.pow(n as u32) {
        let labels: Vec<usize> = (0..n).map(|i| code / k.pow(i as u32) % k).collect();
        best = best.min(inertia(x, &labels, k));
    }
    best
}

#[test]
fn finds_clear_clusters() {
    let x = blobs(&CORNERS, 20, 0.5, 3);
    for init in [Init::PlusPlus, Init::Random] {
        let found = kmeans(&x, &KMeansOptions { init, ..KMeansOptions::new(4) }).unwrap();
        let expected: Vec<usize> = (0..80).map(|i| i / 20).collect();
        assert_eq!(found.labels, expected);
        assert!(found.converged && !found.warm);
        assert!((found.inertia - inertia(&x, &expected, 4)).abs() < 1e-12);
        assert_eq!((found.centroids.rows(), found.distinct_points), (4, 4));
    }
}

#[test]
fn same_seed_same_result() {
    let x = blobs(&[&[0.0; 5]], 200, 1.0, 8);
    let options = KMeansOptions { seed: 42, restarts: 5, ..KMeansOptions::new(7) };
    assert_eq!(kmeans(&x, &options), kmeans(&x, &options));
    // More restarts can only help.
    let more = KMeansOptions { restarts: 50, ..options };
    assert!(kmeans(&x, &more).unwrap().inertia <= kmeans(&x, &options).unwrap().inertia);
}

#[test]
fn seeds_agree_on_the_best_inertia() {
    let x = blobs(&[&[0.0, 0.0], &[1.0, 0.3], &[0.2, 1.1], &[1.0, 1.4], &[2.0, 0.7]], 12, 0.6, 9);
    let best = |seed| {
        let options = KMeansOptions { seed, restarts: 100, ..KMeansOptions::new(5) };
        kmeans(&x, &options).unwrap().inertia
    };
    for seed in 1..6 {
        assert!((best(seed) - best(0)).abs() <= 1e-6 * best(0));
    }
}

#[test]
fn fewer_distinct_points_than_clusters() {
    let rows: Vec<Vec<f64>> =
        (0..9).map(|i| vec![f64::from(i % 3) + 1e-14 * f64::from(i)]).collect();
    let x = DenseMatrix::from_rows(&rows).unwrap();
    let found = kmeans(&x, &KMeansOptions::new(5)).unwrap();
    assert_eq!((found.distinct_points, found.centroids.rows()), (3, 3));
    assert_eq!(found.labels, [0, 1, 2, 0, 1, 2, 0, 1, 2]);
    let zero = DenseMatrix::zeros(6, 2).unwrap();
    let found = kmeans(&zero, &KMeansOptions::new(6)).unwrap();
    assert_eq!((found.labels, found.distinct_points), (vec![0; 6], 1));
    let flat = DenseMatrix::zeros(6, 0).unwrap();
    assert_eq!(kmeans(&flat, &KMeansOptions::new(2)).unwrap().labels, [0; 6]);
}

#[test]
fn extreme_counts() {
    let x = blobs(&[&[0.0, 0.0]], 6, 1.0, 1);
    assert_eq!(kmeans(&x, &KMeansOptions::new(1)).unwrap().labels, [0; 6]);
    let all = kmeans(&x, &KMeansOptions { restarts: 1, ..KMeansOptions::new(6) }).unwrap();
    assert_eq!(all.labels, [0, 1, 2, 3, 4, 5]);
    assert!(all.inertia < 1e-30);
    let cut = kmeans(&x, &KMeansOptions { max_iterations: 1, ..KMeansOptions::new(2) }).unwrap();
    assert_eq!(cut.centroids.rows(), 2);
    let single = DenseMatrix::new(1, 1, vec![5.0]).unwrap();
    assert_eq!(kmeans(&single, &KMeansOptions::new(1)).unwrap().inertia, 0.0);
    let huge = DenseMatrix::new(3, 1, vec![1e100, -1e100, 0.0]).unwrap();
    assert!(kmeans(&huge, &KMeansOptions::new(2)).unwrap().inertia.is_finite());
}

/// Lloyd's iteration, written down literally.
fn plain_lloyd(x: &DenseMatrix, first: &DenseMatrix, iterations: usize) -> Vec<usize> {
    let mut centroids: Vec<Vec<f64>> = first.iter_rows().map(<[f64]>::to_vec).collect();
    let mut labels = vec![0; x.rows()];
    for _ in 0..=iterations {
        for (row, label) in x.iter_rows().zip(&mut labels) {
            let better = |best: usize, c: usize| {
                let nearer = distance(row, &centroids[c]) < distance(row, &centroids[best]);
                if nearer { c } else { best }
            };
            *label = (0..centroids.len()).fold(*label, better);
        }
        for (c, centroid) in centroids.iter_mut().enumerate() {
            let rows: Vec<&[f64]> =
                (0..x.rows()).filter(|&i| labels[i] == c).map(|i| x.row(i)).collect();
            for (j, mean) in centroid.iter_mut().enumerate() {
                *mean = rows.iter().map(|r| r[j]).sum::<f64>() / rows.len() as f64;
            }
        }
    }
    labels
}

#[test]
fn lloyd_equals_the_plain_iteration() {
    // More points than one chunk holds, and sizes that fill no register.
    for (n, dims, k) in [(50, 1, 3), (999, 3, 5), (7_001, 17, 9), (13_000, 8, 20)] {
        let centre = vec![3.0; dims];
        let x = blobs(&[&centre], n, 1.0, n as u64);
        let first = x.select_rows(&(0..k).collect::<Vec<_>>());
        for iterations in [0, 1, 7, 30] {
            let found = lloyd(&x, &first, iterations, 1).unwrap();
            let wanted = plain_lloyd(&x, &first, iterations);
            // Labels are numbered by first appearance, and so are the first k points by
            // themselves, until they change places.
            let mut number = vec![usize::MAX; k];
            let mut next = 0;
            for (label, found) in wanted.iter().zip(&found.labels) {
                if number[*label] == usize::MAX {
                    number[*label] = next;
                    next += 1;
                }
                assert_eq!(number[*label], *found);
            }
            assert!((found.inertia / inertia(&x, &wanted, k) - 1.0).abs() < 1e-12);
        }
    }
}

#[test]
fn lloyd_refuses_shapes_that_do_not_fit() {
    let x = blobs(&[&[0.0, 0.0]], 5, 1.0, 1);
    let flat = DenseMatrix::zeros(2, 1).unwrap();
    let fault = KMeansError::Dimensions { points: 2, centroids: 1 };
    assert_eq!(lloyd(&x, &flat, 5, 1), Err(fault));
    let many = DenseMatrix::zeros(6, 2).unwrap();
    assert!(matches!(lloyd(&x, &many, 5, 1), Err(KMeansError::Clusters { .. })));
    // Equal first centroids: the empty clusters take points of others.
    let same = DenseMatrix::zeros(3, 2).unwrap();
    assert_eq!(lloyd(&x, &same, 5, 1).unwrap().centroids.rows(), 3);
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let small = blobs(&[&[0.0; 5]], 300, 1.0, 8);
    let options = KMeansOptions { seed: 3, restarts: 20, ..KMeansOptions::new(6) };
    let large = blobs(&[&[0.0, 0.0]], 100_001, 1.0, 5);
    let few = KMeansOptions { restarts: 2, max_iterations: 5, ..KMeansOptions::new(4) };
    let warm: Vec<Option<usize>> = (0..large.rows()).map(|i| Some(i % 4)).collect();
    let kept = KMeansOptions { restarts: 1, warm_labels: Some(&warm), ..few };
    let first = large.select_rows(&[0, 1, 2, 3, 4, 5, 6]);
    for threads in [2, 3, 7] {
        let with = |options| KMeansOptions { threads, ..options };
        assert_eq!(kmeans(&small, &options), kmeans(&small, &with(options)));
        assert_eq!(kmeans(&large, &few), kmeans(&large, &with(few)));
        assert_eq!(kmeans(&large, &kept), kmeans(&large, &with(kept)));
        assert_eq!(lloyd(&large, &first, 5, 1), lloyd(&large, &first, 5, threads));
    }
}

#[test]
fn huge_entries_stay_finite() {
    let mut random = numbers(5);
    for dims in [1, 3, 16] {
        let data = (0..60 * dims).map(|_| 1e100 * (2.0 * random() - 1.0)).collect();
        let x = DenseMatrix::new(60, dims, data).unwrap();
        for clusters in [1, 2, 7, 60] {
            let options = KMeansOptions { restarts: 3, ..KMeansOptions::new(clusters) };
            let found = kmeans(&x, &options).unwrap();
            assert!(found.inertia.is_finite() && found.converged);
            assert_eq!(found.centroids.rows(), clusters);
        }
    }
    // One point that is larger than the sum of all others leaves its cluster without a trace.
    let mut data: Vec<f64> = (0..40).map(f64::from).collect();
    data.push(1e100);
    let x = DenseMatrix::new(41, 1, data).unwrap();
    let first = DenseMatrix::new(2, 1, vec![0.0, 1e99]).unwrap();
    let found = lloyd(&x, &first, 20, 1).unwrap();
    assert_eq!(found.centroids.data(), [19.5, 1e100]);
}

#[test]
fn impossible_requests_are_refused() {
    let x = blobs(&[&[0.0]], 3, 1.0, 1);
    let none = DenseMatrix::zeros(0, 2).unwrap();
    assert_eq!(kmeans(&none, &KMeansOptions::new(1)), Err(KMeansError::NoPoints));
    for clusters in [4, usize::MAX] {
        let found = kmeans(&x, &KMeansOptions::new(clusters));
        assert!(matches!(found, Err(KMeansError::Clusters { .. })));
    }
    let short = KMeansOptions { warm_labels: Some(&[None]), ..KMeansOptions::new(2) };
    assert!(matches!(kmeans(&x, &short), Err(KMeansError::WarmLabels { .. })));
    for hysteresis in [-0.1, 1.0, f64::NAN, f64::INFINITY] {
        let options = KMeansOptions { hysteresis, ..KMeansOptions::new(2) };
        let found = kmeans(&x, &options);
        assert!(matches!(found, Err(KMeansError::Options(KMeansOptionsError::Hysteresis(_)))));
    }
    let valid = KMeansOptions::new(2);
    for (options, error) in [
        (KMeansOptions::new(0), KMeansOptionsError::Clusters),
        (KMeansOptions { restarts: 0, ..valid }, KMeansOptionsError::Restarts),
        (KMeansOptions { max_iterations: 0, ..valid }, KMeansOptionsError::MaxIterations),
        (KMeansOptions { threads: 0, ..valid }, KMeansOptionsError::Threads),
    ] {
        assert_eq!(options.check(), Err(error));
        assert_eq!(kmeans(&x, &options), Err(KMeansError::Options(error)));
    }
    assert_eq!(valid.check().unwrap().get(), &valid);
    let threads = KMeansError::Options(KMeansOptionsError::Threads);
    assert_eq!(lloyd(&x, &x, 5, 0), Err(threads));
}

#[test]
fn unchanged_points_keep_their_labels() {
    let x = blobs(&[&[0.0, 0.0, 0.0]], 60, 1.0, 4);
    let first = kmeans(&x, &KMeansOptions::new(5)).unwrap();
    let labels: Vec<Option<usize>> = first.labels.iter().map(|l| Some(100 - l)).collect();
    for hysteresis in [0.0, 0.05] {
        for seed in 0..5 {
            let options = KMeansOptions {
                seed,
                hysteresis,
                warm_labels: Some(&labels),
                ..KMeansOptions::new(5)
            };
            let next = kmeans(&x, &options).unwrap();
            assert!(next.warm);
            assert_eq!(next.labels, first.labels);
        }
    }
}

#[test]
fn noise_moves_no_point_but_real_change_does() {
    // Point 20 lies midway between two clusters, shifted a little either way.
    let base = blobs(&[&[-2.0, 0.0], &[2.0, 0.0]], 10, 0.3, 6);
    let with_last = |at: f64| {
        let mut rows: Vec<Vec<f64>> = base.iter_rows().map(<[f64]>::to_vec).collect();
        rows.push(vec![at, 0.0]);
        DenseMatrix::from_rows(&rows).unwrap()
    };
    let mut labels: Vec<Option<usize>> = (0..20).map(|i| Some(i / 10)).collect();
    labels.push(Some(0));
    let divide = |at: f64, labels: &[Option<usize>]| {
        let options =
            KMeansOptions { hysteresis: 0.2, warm_labels: Some(labels), ..KMeansOptions::new(2) };
        kmeans(&with_last(at), &options).unwrap().labels[20]
    };
    assert_eq!(divide(0.05, &labels), 0);
    assert_eq!(divide(-0.05, &labels), 0);
    assert_eq!(divide(1.5, &labels), 1);
    labels[20] = Some(1);
    assert_eq!(divide(-0.05, &labels), 1);
    assert_eq!(divide(-1.5, &labels), 0);
    // A new point goes where it belongs.
    labels[20] = None;
    assert_eq!(divide(1.0, &labels), 1);
}

#[test]
fn a_bad_previous_division_is_dropped() {
    let x = blobs(&CORNERS, 10, 0.4, 2);
    let mut random = numbers(3);
    let stale: Vec<Option<usize>> = (0..40).map(|_| Some((random() * 4.0) as usize)).collect();
    for clusters in 2..6 {
        let options = KMeansOptions {
            warm_labels: Some(&stale),
            hysteresis: 0.01,
            ..KMeansOptions::new(clusters)
        };
        let found = kmeans(&x, &options).unwrap();
        let cold = kmeans(&x, &KMeansOptions::new(clusters)).unwrap();
        assert!(found.inertia <= 1.01 * cold.inertia + 1e-9);
        assert_eq!(found.centroids.rows(), clusters);
    }
    let nothing = KMeansOptions { warm_labels: Some(&[None; 40]), ..KMeansOptions::new(4) };
    assert!(!kmeans(&x, &nothing).unwrap().warm);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn reaches_the_optimum_of_tiny_instances(n in 2_usize..9, k in 1_usize..4, seed: u64) {
        let k = k.min(n);
        let x = blobs(&[&[0.0, 0.0]], n, 1.0, seed);
        let best = optimum(&x, k);
        for init in [Init::PlusPlus, Init::Random] {
            let found = kmeans(&x, &KMeansOptions { init, seed, ..KMeansOptions::new(k) }).unwrap();
            prop_assert!(found.inertia <= best * (1.0 + 1e-9) + 1e-15);
        }
    }

    #[test]
    fn result_is_consistent(n in 1_usize..40, k in 1_usize..8, steps in 1_usize..5, seed: u64) {
        let k = k.min(n);
        // A coarse grid, so that many points coincide.
        let mut random = numbers(seed);
        let data = (0..2 * n).map(|_| (random() * steps as f64).floor()).collect();
        let x = DenseMatrix::new(n, 2, data).unwrap();
        let found = kmeans(&x, &KMeansOptions { restarts: 3, seed, ..KMeansOptions::new(k) }).unwrap();
        let used = found.centroids.rows();
        prop_assert_eq!(used, k.min(found.distinct_points));
        let mut next = 0;
        for &label in &found.labels {
            prop_assert!(label <= next);
            next = next.max(label + 1);
        }
        prop_assert_eq!(next, used);
        prop_assert!((found.inertia - inertia(&x, &found.labels, used)).abs() < 1e-9);
        // Every point is with its nearest centroid.
        for (row, &label) in x.iter_rows().zip(&found.labels) {
            let own = distance(row, found.centroids.row(label));
            prop_assert!(found.centroids.iter_rows().all(|c| own <= distance(row, c) + 1e-6));
        }
    }
}
