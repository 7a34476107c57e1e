//! Silhouettes and margins.
use crate::common::{blobs, distance, numbers};
use muster_numeric::margins::{MarginError, margins};
use muster_numeric::matrix::DenseMatrix;
use muster_numeric::silhouette::{
    Method, SAMPLE_POINTS, SilhouetteError, SilhouetteOptions, SilhouetteOptionsError,
    estimate_silhouette, method_by_size, scores, silhouette, silhouette_squared,
};
use proptest::prelude::*;

/// Rousseeuw's definition, written down literally, with distances to the power of `power`.
fn naive(x: &DenseMatrix, labels: &[usize], i: usize, power: i32) -> f64 {
    let mean_to = |label: usize| {
        let others: Vec<usize> =
            (0..labels.len()).filter(|&j| j != i && labels[j] == label).collect();
        let sum: f64 = others.iter().map(|&j| distance(x.row(i), x.row(j)).powi(power)).sum();
        (others.len(), sum / others.len() as f64)
    };
    let (count, a) = mean_to(labels[i]);
    if count == 0 {
        return 0.0;
    }
    let b = labels
        .iter()
        .filter(|l| **l != labels[i])
        .map(|&l| mean_to(l).1)
        .fold(f64::INFINITY, f64::min);
    if a == b { 0.0 } else { (b - a) / a.max(b) }
}

#[test]
fn hand_computed_example() {
    let x = DenseMatrix::new(4, 1, vec![0.0, 1.0, 5.0, 9.0]).unwrap();
    let found = silhouette(&x, &[7, 7, 3, 40]).unwrap();
    assert_eq!(found.per_point, [0.8, 0.75, 0.0, 0.0]);
    assert_eq!(found.per_cluster, [(3, 0.0), (7, 0.775), (40, 0.0)]);
    assert_eq!(found.mean, 1.55 / 4.0);
}

#[test]
fn undefined_and_degenerate() {
    let x = DenseMatrix::zeros(4, 2).unwrap();
    assert_eq!(silhouette(&x, &[1; 4]), Err(SilhouetteError::Undefined { clusters: 1 }));
    let none = DenseMatrix::zeros(0, 2).unwrap();
    assert_eq!(silhouette(&none, &[]), Err(SilhouetteError::Undefined { clusters: 0 }));
    assert!(matches!(silhouette(&x, &[0]), Err(SilhouetteError::Labels { .. })));
    assert_eq!(silhouette(&x, &[0, 0, 1, 1]).unwrap().per_point, [0.0; 4]);
    assert_eq!(silhouette_squared(&x, &[0, 0, 1, 1]).unwrap().per_point, [0.0; 4]);
    let undefined = Err(SilhouetteError::Undefined { clusters: 1 });
    assert_eq!(silhouette_squared(&x, &[1; 4]), undefined);
    let flat = DenseMatrix::zeros(3, 0).unwrap();
    assert_eq!(silhouette(&flat, &[0, 1, 1]).unwrap().per_point, [0.0; 3]);
    let huge = DenseMatrix::new(4, 1, vec![1e100, 1e100, -1e100, -1e100]).unwrap();
    assert_eq!(silhouette(&huge, &[0, 0, 1, 1]).unwrap().mean, 1.0);
    assert_eq!(silhouette_squared(&huge, &[0, 0, 1, 1]).unwrap().mean, 1.0);
}

#[test]
fn vectors_that_are_equal_but_for_rounding_are_in_the_same_place() {
    // Three robots in one place, of which more teams were asked for than there are groups, and two in another.
    let rows = vec![0.7, 2e-16, 0.7, -1e-16, 0.7, 3e-16, -0.7, 0.0, -0.7, 1e-16];
    let x = DenseMatrix::new(5, 2, rows).unwrap();
    for found in [silhouette(&x, &[0, 0, 1, 2, 2]), silhouette_squared(&x, &[0, 0, 1, 2, 2])] {
        assert_eq!(found.unwrap().per_point, [0.0, 0.0, 0.0, 1.0, 1.0]);
    }
    // What is a millionth of the whole apart is not.
    let rows = vec![0.7, 2e-6, 0.7, -1e-6, 0.7, 3e-6, -0.7, 0.0, -0.7, 1e-6];
    let x = DenseMatrix::new(5, 2, rows).unwrap();
    let found = silhouette(&x, &[0, 0, 1, 2, 2]).unwrap().per_point;
    assert!((found[0] + 2.0 / 3.0).abs() < 1e-6 && (found[1] - 0.25).abs() < 1e-6, "{found:?}");
}

#[test]
fn methods_are_named() {
    let x = blobs(&[&[0.0, 0.0], &[1.0, 0.0]], 30, 1.0, 1);
    let labels: Vec<usize> = (0..60).map(|i| i / 30).collect();
    assert_eq!(silhouette(&x, &labels).unwrap().method, Method::Exact);
    assert_eq!(silhouette_squared(&x, &labels).unwrap().method, Method::SquaredExact);
    let all = estimate_silhouette(&x, &labels, &SilhouetteOptions::default()).unwrap();
    let exact = silhouette(&x, &labels).unwrap();
    assert_eq!((all.method, all.standard_error, all.mean), (Method::Exact, 0.0, exact.mean));
    let some = SilhouetteOptions { exact_points: 59, sample: 20, seed: 3 };
    let found = estimate_silhouette(&x, &labels, &some).unwrap();
    assert_eq!((found.method, found.per_point.len()), (Method::Sampled, 20));
    // A sample of all points is no sample.
    for sample in [0, 1] {
        let refused = SilhouetteOptions { sample, ..some }.check();
        assert_eq!(refused, Err(SilhouetteOptionsError::Sample(sample)));
    }
    let whole = SilhouetteOptions { sample: 60, ..some };
    assert_eq!(estimate_silhouette(&x, &labels, &whole).unwrap().method, Method::Exact);
}

#[test]
fn scores_of_any_size_name_their_method() {
    assert_eq!(method_by_size(7, 7), Method::Exact);
    assert_eq!(method_by_size(8, 7), Method::Sampled);
    let points = SAMPLE_POINTS + 100;
    let x = blobs(&[&[0.0, 0.0], &[1.0, 0.0]], points / 2, 1.0, 4);
    let labels: Vec<usize> = (0..points).map(|i| 5 * (2 * i / points)).collect();
    let (exact, squared) =
        (silhouette(&x, &labels).unwrap(), silhouette_squared(&x, &labels).unwrap());

    let found = scores(&x, &labels, Method::Exact, 1).unwrap();
    assert_eq!((found.mean, found.standard_error), (exact.mean, 0.0));
    assert_eq!((found.method, &found.details), (Method::Exact, &exact));
    let found = scores(&x, &labels, Method::SquaredExact, 1).unwrap();
    assert_eq!((found.mean, found.standard_error), (squared.mean, 0.0));
    assert_eq!((found.method, &found.details), (Method::SquaredExact, &squared));

    // An estimate of the mean, and every point by squared distances.
    let found = scores(&x, &labels, Method::Sampled, 1).unwrap();
    assert_eq!((found.method, &found.details), (Method::Sampled, &squared));
    assert!(found.standard_error > 0.0 && found.standard_error < 0.01);
    assert!((found.mean - exact.mean).abs() < 5.0 * found.standard_error);
    assert_ne!(found.mean, exact.mean);
    assert_eq!(scores(&x, &labels, Method::Sampled, 1), Ok(found), "by the seed alone");

    // A sample of all is none.
    let few = x.select_rows(&(0..SAMPLE_POINTS).collect::<Vec<_>>());
    let found = scores(&few, &labels[..SAMPLE_POINTS], Method::Sampled, 1).unwrap();
    assert_eq!(found.details, silhouette(&few, &labels[..SAMPLE_POINTS]).unwrap());
    assert_eq!((found.method, found.standard_error), (Method::Exact, 0.0));
    let undefined = SilhouetteError::Undefined { clusters: 1 };
    assert_eq!(scores(&x, &vec![3; points], Method::Sampled, 1), Err(undefined));
}

#[test]
fn samples_estimate_the_mean_without_bias() {
    let x = blobs(&[&[0.0, 0.0], &[1.0, 0.0], &[0.0, 3.0]], 200, 1.0, 1);
    let labels: Vec<usize> = (0..600).map(|i| i / 200).collect();
    let exact = silhouette(&x, &labels).unwrap();
    let (mut sum, mut outside) = (0.0, 0);
    for seed in 0..200 {
        let options = SilhouetteOptions { exact_points: 0, sample: 50, seed };
        let found = estimate_silhouette(&x, &labels, &options).unwrap();
        assert!(found.per_point.is_sorted_by(|a, b| a.0 < b.0));
        for &(point, value) in &found.per_point {
            assert!((value - exact.per_point[point]).abs() < 1e-12);
        }
        let error = found.mean - exact.mean;
        sum += error / found.standard_error;
        outside += usize::from(error.abs() > 2.0 * found.standard_error);
        let scored: f64 = found.per_cluster.iter().filter_map(|c| c.1).count() as f64;
        assert_eq!(scored, 3.0);
    }
    // 200 errors of mean 0 in units of their standard error, about 5 % of them above 2.
    assert!((sum / 200.0).abs() < 0.25, "{sum}");
    assert!((2..=24).contains(&outside), "{outside}");
}

#[test]
fn squared_distances_far_from_the_origin() {
    let near = blobs(&[&[0.0, 0.0], &[2.0, 0.0]], 40, 1.0, 1);
    let labels: Vec<usize> = (0..80).map(|i| i / 40).collect();
    let rows: Vec<Vec<f64>> =
        near.iter_rows().map(|r| r.iter().map(|v| v + 1e9).collect()).collect();
    let far = DenseMatrix::from_rows(&rows).unwrap();
    let found = silhouette_squared(&far, &labels).unwrap();
    for i in 0..80 {
        assert!((found.per_point[i] - naive(&far, &labels, i, 2)).abs() < 1e-12);
    }
}

#[test]
fn equals_the_definition_in_several_tiles() {
    let x = blobs(&[&[0.0; 5], &[0.5; 5]], 700, 1.0, 9);
    // Sizes 1, 2, 9 and 1388.
    let labels: Vec<usize> = (0..1400_usize)
        .map(|i| match i {
            0 => 1,
            1 | 2 => 2,
            3..12 => 3,
            _ => 0,
        })
        .collect();
    let found = silhouette(&x, &labels).unwrap();
    for i in (0..20).chain(1390..1400) {
        assert!((found.per_point[i] - naive(&x, &labels, i, 1)).abs() < 1e-12);
    }
}

#[test]
fn margins_of_a_line() {
    let x = DenseMatrix::new(3, 1, vec![0.0, 4.0, 10.0]).unwrap();
    let centroids = DenseMatrix::new(2, 1, vec![2.0, 10.0]).unwrap();
    assert_eq!(margins(&x, &[0, 0, 1], &centroids).unwrap(), [0.8, 4.0 / 6.0, 1.0]);
    assert_eq!(margins(&x, &[0, 1, 1], &centroids).unwrap()[1], -4.0 / 6.0);
    let one = DenseMatrix::new(1, 1, vec![2.0]).unwrap();
    assert_eq!(margins(&x, &[0; 3], &one).unwrap(), [1.0; 3]);
    let twins = DenseMatrix::new(2, 1, vec![0.0, 0.0]).unwrap();
    assert_eq!(margins(&x, &[0, 0, 1], &twins).unwrap()[0], 0.0);
    assert!(matches!(margins(&x, &[0], &one), Err(MarginError::Labels { .. })));
    assert!(matches!(margins(&x, &[0, 0, 1], &one), Err(MarginError::Label { .. })));
    let plane = DenseMatrix::zeros(1, 2).unwrap();
    assert!(matches!(margins(&x, &[0; 3], &plane), Err(MarginError::Dimensions { .. })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn equals_the_definition(n in 2_usize..90, k in 2_usize..12, dims in 1_usize..10, seed: u64) {
        let x = blobs(&[&vec![0.0; dims]], n, 1.0, seed);
        let mut random = numbers(seed ^ 1);
        let labels: Vec<usize> = (0..n).map(|_| 3 * (random() * k as f64) as usize).collect();
        prop_assume!(labels.iter().any(|l| *l != labels[0]));
        let found = silhouette(&x, &labels).unwrap();
        for i in 0..n {
            prop_assert!((found.per_point[i] - naive(&x, &labels, i, 1)).abs() < 1e-12);
        }
        let squared = silhouette_squared(&x, &labels).unwrap();
        for i in 0..n {
            prop_assert!((squared.per_point[i] - naive(&x, &labels, i, 2)).abs() < 1e-12);
        }
        let mean = found.per_point.iter().sum::<f64>() / n as f64;
        prop_assert!((found.mean - mean).abs() < 1e-12);
        for (label, value) in found.per_cluster {
            let own: Vec<f64> =
                (0..n).filter(|&i| labels[i] == label).map(|i| found.per_point[i]).collect();
            prop_assert!((value - own.iter().sum::<f64>() / own.len() as f64).abs() < 1e-12);
        }
    }
}
