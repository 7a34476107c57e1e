//! The method itself, in all forms that are compared: from graphs to vectors, from vectors to teams.

use muster_numeric::dimension::choose_covering_dimension;
use muster_numeric::embedding::{Rows, Scale, embed};
use muster_numeric::fuse::{FuseError, Normalization, fuse};
use muster_numeric::katz::{Alpha, KatzError, katz_similarity};
use muster_numeric::kmeans::{Init, KMeansError, KMeansOptions, kmeans};
use muster_numeric::matrix::{DenseMatrix, MatrixError, SparseMatrix};
use muster_numeric::spectral_radius::spectral_radius;
use muster_numeric::svd::{RankKSvd, SvdError, full_svd};

/// How K, half of the length of a vector, is chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rank {
    /// This one, or the number of robots if that is less.
    Fixed(usize),
    /// The live system's rule: the last large ratio of neighbouring singular values from 2 to the number of
    /// teams, and more where a robot with relations would not be seen otherwise.
    Ratio,
    /// The number of teams.
    Teams,
    /// So many more than teams.
    More(usize),
}

/// From graphs to vectors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Form {
    /// How each graph is scaled before it is weighted.
    pub normalization: Normalization,
    /// α as a share of what is admissible.
    pub fraction: f64,
    /// How K is chosen.
    pub rank: Rank,
    /// Power of the singular values by which their vectors are scaled: 0 in the paper, 1/2 in HOPE, −1/2 in the
    /// live system.
    pub power: f64,
    /// How the vectors of robots are.
    pub rows: Rows,
}

/// From vectors to teams.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clustering {
    /// Where centroids start.
    pub init: Init,
    /// How often.
    pub starts: usize,
}

/// Why there is no division.
#[derive(Debug, thiserror::Error)]
pub enum MethodError {
    /// The graphs cannot be fused.
    #[error(transparent)]
    Fuse(#[from] FuseError),
    /// There is no similarity.
    #[error(transparent)]
    Katz(#[from] KatzError),
    /// It cannot be decomposed.
    #[error(transparent)]
    Svd(#[from] SvdError),
    /// The vectors cannot be divided.
    #[error(transparent)]
    KMeans(#[from] KMeansError),
    /// The vectors are none.
    #[error(transparent)]
    Matrix(#[from] MatrixError),
}

impl Form {
    /// The vectors of robots, N × 2K, from graphs and their weights, for a division into `teams`.
    ///
    /// # Errors
    /// [`MethodError`]
    pub fn vectors(
        &self,
        graphs: &[(&SparseMatrix, f64)],
        teams: usize,
    ) -> Result<DenseMatrix, MethodError> {
        let fused = fuse(graphs, self.normalization)?;
        let radius = spectral_radius(&fused, None);
        let alpha = Alpha::Fraction(self.fraction).resolve(&fused, &radius)?;
        let full = full_svd(&katz_similarity(&fused, alpha, &radius)?)?;
        let rank = match self.rank {
            Rank::Fixed(rank) => rank,
            Rank::Teams => teams,
            Rank::More(more) => teams + more,
            Rank::Ratio => {
                let mut related = vec![false; fused.nodes()];
                fused.triplets().for_each(|(i, j, _)| (related[i], related[j]) = (true, true));
                choose_covering_dimension(&full, &related, teams, None).dimension
            }
        };
        let svd = full.truncate(rank.clamp(1, fused.nodes()))?;
        Ok(self.rows_of(&svd)?)
    }
}

impl Form {
    /// [`embed`] for any power of the singular values.
    fn rows_of(&self, svd: &RankKSvd) -> Result<DenseMatrix, MatrixError> {
        let weak = embed(svd, Scale::SqrtSigma, Rows::None).weak;
        // What vanishes has no direction that could be made longer.
        let scale = |sigma: f64| if sigma > 0.0 { sigma.powf(self.power) } else { 0.0 };
        let scales: Vec<f64> = svd.sigma.iter().map(|sigma| scale(*sigma)).collect();
        let row = |(i, weak): (usize, &bool)| -> Vec<f64> {
            let sides = svd.u.row(i).iter().zip(&scales).chain(svd.v.row(i).iter().zip(&scales));
            let mut row: Vec<f64> = sides.map(|(value, scale)| value * scale).collect();
            if self.rows == Rows::Unit {
                let length = row.iter().map(|value| value * value).sum::<f64>().sqrt();
                row.iter_mut()
                    .for_each(|v| *v = if *weak || length == 0.0 { 0.0 } else { *v / length });
            }
            row
        };
        DenseMatrix::from_rows(&weak.iter().enumerate().map(row).collect::<Vec<_>>())
    }
}

impl Clustering {
    /// The team of each row of `x`, numbered from 0 in order of first appearance.
    ///
    /// # Errors
    /// [`MethodError::KMeans`] for more teams than robots.
    pub fn divide(
        &self,
        x: &DenseMatrix,
        teams: usize,
        seed: u64,
    ) -> Result<Vec<usize>, MethodError> {
        let options = KMeansOptions {
            init: self.init,
            restarts: self.starts,
            seed,
            ..KMeansOptions::new(teams)
        };
        Ok(kmeans(x, &options)?.labels)
    }
}

/// Vectors of several embeddings, one behind the other.
///
/// # Errors
/// [`MethodError::Matrix`] where they are not of the same robots.
pub fn concatenated(parts: &[DenseMatrix]) -> Result<DenseMatrix, MethodError> {
    let robots = parts.first().map_or(0, DenseMatrix::rows);
    let columns = parts.iter().map(DenseMatrix::cols).sum();
    let rows = (0..robots)
        .flat_map(|i| parts.iter().filter(move |p| i < p.rows()).flat_map(move |p| p.row(i)));
    Ok(DenseMatrix::new(robots, columns, rows.copied().collect())?)
}
