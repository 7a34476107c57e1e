//! Every kernel gives the same result with registers of any width.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::kmeans::{Init, KMeansOptions, kmeans};
use super::silhouette::{SilhouetteOptions, estimate_silhouette, silhouette, silhouette_squared};
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::simd::narrow::with_lanes;

#[test]
fn results_are_the_same_with_registers_of_any_width() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for (n, dims, clusters) in [(7, 1, 2), (61, 3, 5), (500, 9, 7), (333, 17, 19)] {
        let x = DenseMatrix::from_fn(n, dims, |_, _| rng.random::<f64>());
        let options =
            KMeansOptions { init: Init::Random, restarts: 3, ..KMeansOptions::new(clusters) };
        let sampling = SilhouetteOptions { exact_points: 0, sample: n / 2, seed: 1 };
        let run = |lanes| {
            with_lanes(lanes, || {
                let found = kmeans(&x, &options).unwrap();
                let drawn = kmeans(&x, &KMeansOptions { init: Init::PlusPlus, ..options });
                let scores = [silhouette(&x, &found.labels), silhouette_squared(&x, &found.labels)];
                let sampled = estimate_silhouette(&x, &found.labels, &sampling).unwrap().mean;
                (found, drawn.unwrap().inertia, scores.map(Result::unwrap), sampled)
            })
        };
        let wide = run(8);
        for lanes in [1, 4] {
            let narrow = run(lanes);
            assert_eq!(narrow.0.labels, wide.0.labels);
            assert!((narrow.0.inertia / wide.0.inertia - 1.0).abs() < 1e-12);
            assert!((narrow.1 / wide.1 - 1.0).abs() < 1e-9);
            assert!((narrow.3 - wide.3).abs() < 1e-12);
            for (narrow, wide) in narrow.2.iter().zip(&wide.2) {
                for (a, b) in narrow.per_point.iter().zip(&wide.per_point) {
                    assert!((a - b).abs() < 1e-12);
                }
            }
        }
    }
}
