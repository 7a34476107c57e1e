//! Points to divide, with Muster's clustering and linfa's.

use linfa::DatasetBase;
use linfa::traits::{Fit, Predict};
use linfa_clustering::{KMeans, KMeansInit};
use linfa_nn::distance::L2Dist;
use muster_numeric::kmeans::lloyd;
use muster_numeric::matrix::DenseMatrix;
use muster_numeric::silhouette::{
    SilhouetteOptions, estimate_silhouette, silhouette, silhouette_squared,
};
use ndarray::{Array1, Array2, s};
use rand_xoshiro::Xoshiro256Plus;
use rand_xoshiro::rand_core::SeedableRng;
use serde::Deserialize;

use crate::Failure;
use crate::clock::{Seconds, timed};

/// Which silhouettes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Form {
    Exact,
    Squared,
    Sampled,
}

/// Points, of which the first are the first centroids, and the labels that k-means finds for them.
pub(crate) struct Points {
    x: DenseMatrix,
    dataset: DatasetBase<Array2<f64>, Array1<()>>,
    clusters: usize,
    iterations: usize,
    first: DenseMatrix,
    labels: Vec<usize>,
}

impl Points {
    /// Rows of `dims` numbers, to be divided into `clusters` by so many iterations.
    pub(crate) fn new(
        data: Vec<f64>,
        dims: usize,
        clusters: usize,
        iterations: usize,
    ) -> Result<Self, Failure> {
        let points = data.len() / dims;
        let dataset = DatasetBase::from(Array2::from_shape_vec((points, dims), data.clone())?);
        let x = DenseMatrix::new(points, dims, data)?;
        let first = x.select_rows(&(0..clusters).collect::<Vec<_>>());
        let labels = lloyd(&x, &first, iterations, 1)?.labels;
        Ok(Self { x, dataset, clusters, iterations, first, labels })
    }

    /// Muster's k-means, and its inertia.
    pub(crate) fn kmeans(&self) -> Result<(Seconds, f64), Failure> {
        let (seconds, found) = timed(|| lloyd(&self.x, &self.first, self.iterations, 1));
        Ok((seconds, self.inertia(&found?.labels)))
    }

    /// The same by linfa, which stops when centroids move no more.
    pub(crate) fn linfa(&self) -> Result<(Seconds, f64), Failure> {
        let random = Xoshiro256Plus::seed_from_u64(0);
        let first = self.dataset.records().slice(s![..self.clusters, ..]).to_owned();
        let (seconds, labels) = timed(|| {
            let model = KMeans::params_with(self.clusters, random, L2Dist)
                .init_method(KMeansInit::Precomputed(first))
                .n_runs(1)
                .max_n_iterations(self.iterations as u64)
                .tolerance(f64::MIN_POSITIVE)
                .fit(&self.dataset)?;
            Ok::<_, Failure>(model.predict(self.dataset.records()))
        });
        Ok((seconds, self.inertia(&labels?.to_vec())))
    }

    /// Mean silhouette of the labels that k-means found, and its standard error if it is an estimate.
    pub(crate) fn silhouette(&self, form: Form) -> Result<(Seconds, f64, f64), Failure> {
        let (x, labels) = (&self.x, &self.labels);
        let (seconds, found) = timed(|| match form {
            Form::Exact => Ok((silhouette(x, labels)?.mean, 0.0)),
            Form::Squared => Ok((silhouette_squared(x, labels)?.mean, 0.0)),
            Form::Sampled => {
                let options = SilhouetteOptions { exact_points: 0, ..Default::default() };
                let found = estimate_silhouette(x, labels, &options)?;
                Ok::<_, Failure>((found.mean, found.standard_error))
            }
        });
        let (mean, error) = found?;
        Ok((seconds, mean, error))
    }

    /// The labels that silhouettes are of.
    pub(crate) fn labels(&self) -> &[usize] {
        &self.labels
    }

    /// Sum of squared distances to the means of the clusters that the labels make, the same for all.
    fn inertia(&self, labels: &[usize]) -> f64 {
        let mut means = vec![vec![0.0; self.x.cols()]; self.clusters];
        let mut sizes = vec![0.0; self.clusters];
        for (row, &label) in self.x.iter_rows().zip(labels) {
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
        self.x.iter_rows().zip(labels).map(square).sum()
    }
}
