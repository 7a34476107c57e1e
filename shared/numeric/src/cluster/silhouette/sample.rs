//! The mean silhouette, from all points or from a sample of them.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::groups::Groups;
use super::pairs;
use super::types::{Method, SilhouetteError, SilhouetteOptionsError};
use crate::linalg::matrix::DenseMatrix;

/// Default of [`SilhouetteOptions::exact_points`]: up to here all pairs take about 0.1 s in 16
/// dimensions.
pub const EXACT_POINTS: usize = 20_000;

/// Default of [`SilhouetteOptions::sample`]: the standard error is then below 0.01, as the standard
/// deviation of silhouettes hardly ever exceeds 0.4.
pub const SAMPLE_POINTS: usize = 2_000;

/// Unchecked parameters: when and how to sample; [`SilhouetteOptions::check`] makes them valid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SilhouetteOptions {
    /// Largest number of points that are all scored.
    pub exact_points: usize,
    /// Number of points that are scored when there are more; at least 2, as a standard error needs.
    pub sample: usize,
    /// Seed of the choice of points.
    pub seed: u64,
}

impl Default for SilhouetteOptions {
    fn default() -> Self {
        Self { exact_points: EXACT_POINTS, sample: SAMPLE_POINTS, seed: 0 }
    }
}

impl SilhouetteOptions {
    /// The parameters with the guarantee that each is in its range.
    ///
    /// # Errors
    /// [`SilhouetteOptionsError::Sample`] for a sample of fewer than two points.
    pub fn check(self) -> Result<ValidSilhouetteOptions, SilhouetteOptionsError> {
        match self.sample {
            sample @ (0 | 1) => Err(SilhouetteOptionsError::Sample(sample)),
            _ => Ok(ValidSilhouetteOptions(self)),
        }
    }
}

/// Parameters that [`SilhouetteOptions::check`] found in their ranges.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ValidSilhouetteOptions(SilhouetteOptions);

/// The mean silhouette of a division and how well it is known.
#[derive(Debug, Clone, PartialEq)]
pub struct SilhouetteEstimate {
    /// Mean over all points, or its estimate, which is unbiased.
    pub mean: f64,
    /// Standard error of `mean`; 0 if all points were scored.
    pub standard_error: f64,
    /// Label of every cluster, ascending, and the mean over its scored points; `None` without any.
    pub per_cluster: Vec<(usize, Option<f64>)>,
    /// The scored points, ascending, and their exact silhouettes.
    pub per_point: Vec<(usize, f64)>,
    /// Method of `per_point`.
    pub method: Method,
}

/// Mean of [`silhouette`](super::silhouette) over all points; above
/// [`SilhouetteOptions::exact_points`] points estimated from a sample, drawn without replacement.
///
/// Every point of the sample is compared with all N points, in O(m N D) for m points. With the
/// standard deviation s of their silhouettes, the standard error is s √((1 − m/N)/m) (Cochran,
/// Sampling Techniques, section 2.6).
///
/// # Errors
/// As [`silhouette`](super::silhouette), and [`SilhouetteError::Options`].
pub fn estimate_silhouette(
    x: &DenseMatrix,
    labels: &[usize],
    options: &SilhouetteOptions,
) -> Result<SilhouetteEstimate, SilhouetteError> {
    options.check()?.estimate(x, labels)
}

impl ValidSilhouetteOptions {
    /// [`estimate_silhouette`] with these parameters.
    ///
    /// # Errors
    /// As [`silhouette`](super::silhouette).
    pub fn estimate(
        &self,
        x: &DenseMatrix,
        labels: &[usize],
    ) -> Result<SilhouetteEstimate, SilhouetteError> {
        let options = &self.0;
        let groups = Groups::new(x, labels)?;
        let count = options.sample;
        let method = if x.rows() <= options.exact_points || x.rows() <= count {
            Method::Exact
        } else {
            Method::Sampled
        };
        let (points, values) = match method {
            Method::Sampled => {
                let points = draw(x.rows(), count, options.seed);
                let values = pairs::some_points(x, &groups, &points);
                (points, values)
            }
            _ => ((0..x.rows()).collect(), pairs::all_pairs(x, &groups)),
        };
        let mut sums = vec![(0.0, 0_usize); groups.sizes.len()];
        for (&point, value) in points.iter().zip(&values) {
            let (sum, number) = &mut sums[groups.member[point] as usize];
            *sum += value;
            *number += 1;
        }
        let mean = |(sum, number): (f64, usize)| (number > 0).then(|| sum / number as f64);
        Ok(SilhouetteEstimate {
            mean: values.iter().sum::<f64>() / values.len() as f64,
            standard_error: standard_error(&values, x.rows()),
            per_cluster: groups.labels.into_iter().zip(sums.into_iter().map(mean)).collect(),
            per_point: points.into_iter().zip(values).collect(),
            method,
        })
    }
}

/// `count` of the numbers below `points`, each set equally likely, ascending (a partial
/// Fisher–Yates shuffle).
fn draw(points: usize, count: usize, seed: u64) -> Vec<usize> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut indices: Vec<usize> = (0..points).collect();
    for i in 0..count {
        let j = rng.random_range(i..points);
        indices.swap(i, j);
    }
    indices.truncate(count);
    indices.sort_unstable();
    indices
}

/// Standard error of the mean of `values` as an estimate of the mean of the `points` values that
/// they were drawn from.
fn standard_error(values: &[f64], points: usize) -> f64 {
    let count = values.len() as f64;
    if values.len() >= points {
        return 0.0;
    }
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / (count - 1.0);
    (variance / count * (1.0 - count / points as f64)).sqrt()
}
