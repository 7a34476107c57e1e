//! Runs Muster's clustering and linfa's on the points of a file, one job per line of standard
//! input, and answers each with a line: seconds, and what was found.
//!
//! `muster-peers FILE POINTS DIMS CLUSTERS ITERATIONS`, where FILE holds POINTS × DIMS numbers of
//! eight bytes, low byte first. The first CLUSTERS points are the first centroids. The jobs are
//! `muster` and `linfa` for k-means, and `exact`, `squared` and `sampled` for silhouettes of the
//! labels that the first k-means found.

use std::io::BufRead;
use std::time::Instant;

use linfa::DatasetBase;
use linfa::traits::{Fit, Predict};
use linfa_clustering::{KMeans, KMeansInit};
use linfa_nn::distance::L2Dist;
use muster_numeric::kmeans::lloyd;
use muster_numeric::matrix::DenseMatrix;
use muster_numeric::silhouette::{
    SilhouetteOptions, estimate_silhouette, silhouette, silhouette_squared,
};
use ndarray::{Array2, s};
use rand_xoshiro::Xoshiro256Plus;
use rand_xoshiro::rand_core::SeedableRng;

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [file, numbers @ ..] = arguments.as_slice() else { return Err("no file".into()) };
    let numbers: Vec<usize> = numbers.iter().map(|n| n.parse()).collect::<Result<_, _>>()?;
    let [points, dims, clusters, iterations] = numbers[..] else {
        return Err("FILE POINTS DIMS CLUSTERS ITERATIONS".into());
    };
    let bytes = std::fs::read(file)?;
    let (values, _) = bytes.as_chunks::<8>();
    let data: Vec<f64> = values.iter().map(|b| f64::from_le_bytes(*b)).collect();
    let array = Array2::from_shape_vec((points, dims), data.clone())?;
    let first_array = array.slice(s![..clusters, ..]).to_owned();
    let dataset = DatasetBase::from(array);
    let x = DenseMatrix::new(points, dims, data)?;
    let first = x.select_rows(&(0..clusters).collect::<Vec<_>>());
    let labels = lloyd(&x, &first, iterations, 1)?.labels;

    for job in std::io::stdin().lock().lines() {
        let start = Instant::now();
        let (seconds, result, error) = match job?.as_str() {
            "muster" => {
                let found = lloyd(&x, &first, iterations, 1)?;
                let seconds = start.elapsed();
                (seconds, inertia(&x, &found.labels, clusters), 0.0)
            }
            "linfa" => {
                let random = Xoshiro256Plus::seed_from_u64(0);
                let init = KMeansInit::Precomputed(first_array.clone());
                let start = Instant::now();
                let model = KMeans::params_with(clusters, random, L2Dist)
                    .init_method(init)
                    .n_runs(1)
                    .max_n_iterations(iterations as u64)
                    .tolerance(f64::MIN_POSITIVE)
                    .fit(&dataset)?;
                let found = model.predict(dataset.records());
                let seconds = start.elapsed();
                (seconds, inertia(&x, &found.to_vec(), clusters), 0.0)
            }
            "exact" => {
                let mean = silhouette(&x, &labels)?.mean;
                (start.elapsed(), mean, 0.0)
            }
            "squared" => {
                let mean = silhouette_squared(&x, &labels)?.mean;
                (start.elapsed(), mean, 0.0)
            }
            "sampled" => {
                let options = SilhouetteOptions { exact_points: 0, ..Default::default() };
                let found = estimate_silhouette(&x, &labels, &options)?;
                (start.elapsed(), found.mean, found.standard_error)
            }
            other => return Err(format!("no job {other}").into()),
        };
        println!("{} {result:?} {error:?}", seconds.as_secs_f64());
    }
    Ok(())
}

/// Sum of squared distances to the means of the clusters that the labels make, the same for all.
fn inertia(x: &DenseMatrix, labels: &[usize], clusters: usize) -> f64 {
    let mut means = vec![vec![0.0; x.cols()]; clusters];
    let mut sizes = vec![0.0; clusters];
    for (row, &label) in x.iter_rows().zip(labels) {
        sizes[label] += 1.0;
        for (mean, value) in means[label].iter_mut().zip(row) {
            *mean += value;
        }
    }
    for (mean, size) in means.iter_mut().zip(&sizes) {
        for value in mean {
            *value /= f64::max(*size, 1.0);
        }
    }
    let square = |(row, &label): (&[f64], &usize)| -> f64 {
        row.iter().zip(&means[label]).map(|(v, m)| (v - m) * (v - m)).sum()
    };
    x.iter_rows().zip(labels).map(square).sum()
}
