//! Locally linear embedding (Roweis and Saul, Science 290, 2000), as scikit-learn's standard method computes
//! it: each point as a combination of its nearest neighbours, and the coordinates of least weight that the
//! same combinations reproduce.

use muster_numeric::matrix::{DenseMatrix, MatrixError};
use muster_numeric::svd::{SvdError, full_svd};

/// How much is added to the diagonal of the Gram matrix of the neighbours, as a share of its trace.
const REGULARISATION: f64 = 1e-3;

/// Why there is no embedding.
#[derive(Debug, thiserror::Error)]
pub enum LleError {
    /// There are as many neighbours or coordinates as points, or more, or none.
    #[error("{neighbours} neighbours and {dimension} coordinates need more than {points} points")]
    Count {
        /// Neighbours of each point.
        neighbours: usize,
        /// Coordinates.
        dimension: usize,
        /// Points.
        points: usize,
    },
    /// The points are not finite.
    #[error(transparent)]
    Matrix(#[from] MatrixError),
    /// The decomposition fails.
    #[error(transparent)]
    Svd(#[from] SvdError),
}

/// Embeds the rows of `x`, n × features, into n × `dimension` coordinates, whose columns have length 1.
/// Equally near neighbours count by their index.
///
/// # Errors
/// [`LleError`]
pub fn locally_linear_embedding(
    x: &DenseMatrix,
    neighbours: usize,
    dimension: usize,
) -> Result<DenseMatrix, LleError> {
    let n = x.rows();
    if neighbours == 0 || dimension == 0 || neighbours >= n || dimension >= n {
        return Err(LleError::Count { neighbours, dimension, points: n });
    }
    // I − W, row by row.
    let mut rest = vec![vec![0.0; n]; n];
    for (i, row) in rest.iter_mut().enumerate() {
        row[i] = 1.0;
        let near = nearest(x, i, neighbours);
        for (j, weight) in near.iter().zip(weights(x, i, &near)) {
            row[*j] -= weight;
        }
    }
    let m = |i: usize, j: usize| -> f64 { rest.iter().map(|row| row[i] * row[j]).sum() };
    let m: Vec<Vec<f64>> = (0..n).map(|i| (0..n).map(|j| m(i, j)).collect()).collect();
    // The vectors of the smallest eigenvalues of M are those of the largest of c − M, c being above all.
    let above = m.iter().enumerate().map(|(i, row)| row[i]).sum::<f64>().max(1.0);
    let turned = |i: usize, j: usize| if i == j { above - m[i][j] } else { -m[i][j] };
    let data = (0..n * n).map(|at| turned(at / n, at % n)).collect();
    let vectors = full_svd(&DenseMatrix::new(n, n, data)?)?.truncate(dimension + 1)?.v;
    // The first one is the same for all points.
    let rows: Vec<Vec<f64>> = vectors.iter_rows().map(|row| row[1..].to_vec()).collect();
    Ok(DenseMatrix::from_rows(&rows)?)
}

fn nearest(x: &DenseMatrix, i: usize, neighbours: usize) -> Vec<usize> {
    let square =
        |j: usize| -> f64 { x.row(i).iter().zip(x.row(j)).map(|(a, b)| (a - b) * (a - b)).sum() };
    let mut others: Vec<(f64, usize)> =
        (0..x.rows()).filter(|j| *j != i).map(|j| (square(j), j)).collect();
    others.sort_by(|left, right| left.0.total_cmp(&right.0).then(left.1.cmp(&right.1)));
    others.into_iter().take(neighbours).map(|(_, j)| j).collect()
}

/// Weights of sum 1 with which the neighbours come nearest to point `i`.
fn weights(x: &DenseMatrix, i: usize, near: &[usize]) -> Vec<f64> {
    let off = |j: usize| x.row(j).iter().zip(x.row(i)).map(|(a, b)| a - b).collect::<Vec<_>>();
    let off: Vec<Vec<f64>> = near.iter().map(|j| off(*j)).collect();
    let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    let mut gram: Vec<Vec<f64>> =
        off.iter().map(|a| off.iter().map(|b| dot(a, b)).collect()).collect();
    let trace: f64 = gram.iter().enumerate().map(|(k, row)| row[k]).sum();
    let added = if trace > 0.0 { REGULARISATION * trace } else { REGULARISATION };
    for (k, row) in gram.iter_mut().enumerate() {
        row[k] += added;
    }
    let mut weights = vec![1.0; near.len()];
    solve_positive(&mut gram, &mut weights);
    let sum: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|weight| *weight /= sum);
    weights
}

/// Solves a positive definite system in place, by elimination.
fn solve_positive(matrix: &mut [Vec<f64>], right: &mut [f64]) {
    let n = right.len();
    for k in 0..n {
        let (upper, lower) = matrix.split_at_mut(k + 1);
        let pivot = &upper[k];
        for (below, row) in lower.iter_mut().enumerate() {
            let factor = row[k] / pivot[k];
            for (value, above) in row.iter_mut().zip(pivot).skip(k) {
                *value -= factor * above;
            }
            right[k + 1 + below] -= factor * right[k];
        }
    }
    for k in (0..n).rev() {
        let known: f64 = (k + 1..n).map(|j| matrix[k][j] * right[j]).sum();
        right[k] = (right[k] - known) / matrix[k][k];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_a_curve_come_in_their_order() {
        let point = |i: usize| {
            let t = i as f64 / 10.0;
            vec![t.cos(), t.sin()]
        };
        let x = DenseMatrix::from_rows(&(0..30).map(point).collect::<Vec<_>>()).unwrap();
        let found = locally_linear_embedding(&x, 2, 1).unwrap();
        let values: Vec<f64> = found.iter_rows().map(|row| row[0]).collect();
        let rises = values.windows(2).all(|pair| pair[0] < pair[1]);
        let falls = values.windows(2).all(|pair| pair[0] > pair[1]);
        assert!(rises || falls, "{values:?}");
        let length: f64 = values.iter().map(|v| v * v).sum();
        assert!((length - 1.0).abs() < 1e-12);
    }

    #[test]
    fn too_few_points_are_refused() {
        let x = DenseMatrix::zeros(3, 2).unwrap();
        assert!(locally_linear_embedding(&x, 3, 1).is_err());
        assert!(locally_linear_embedding(&x, 2, 3).is_err());
        assert!(locally_linear_embedding(&x, 0, 1).is_err());
    }
}
