//! Silhouettes and margins.
#![allow(clippy::unwrap_used)]

mod common;

use common::{blobs, distance, numbers};
use muster_numeric::margins::{MarginError, margins};
use muster_numeric::matrix::DenseMatrix;
use muster_numeric::silhouette::{SilhouetteError, silhouette};
use proptest::prelude::*;

/// Rousseeuw's definition, written down literally.
fn naive(x: &DenseMatrix, labels: &[usize], i: usize) -> f64 {
    let mean_to = |label: usize| {
        let others: Vec<usize> =
            (0..labels.len()).filter(|&j| j != i && labels[j] == label).collect();
        let sum: f64 = others.iter().map(|&j| distance(x.row(i), x.row(j))).sum();
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
    fn equals_the_definition(n in 2_usize..30, k in 2_usize..6, seed: u64) {
        let x = blobs(&[&[0.0, 0.0, 0.0]], n, 1.0, seed);
        let mut random = numbers(seed ^ 1);
        let labels: Vec<usize> = (0..n).map(|_| 3 * (random() * k as f64) as usize).collect();
        prop_assume!(labels.iter().any(|l| *l != labels[0]));
        let found = silhouette(&x, &labels).unwrap();
        for i in 0..n {
            prop_assert!((found.per_point[i] - naive(&x, &labels, i)).abs() < 1e-12);
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
