//! The paper's method to the letter on faer: all eigenvalues, the inverse, all singular triplets.

use faer::linalg::solvers::{DenseSolveCore, PartialPivLu};
use faer::{Mat, Par};
use muster_numeric::matrix::SparseMatrix;

use crate::Failure;
use crate::clock::{Seconds, timed};

/// Time of each step, and what came out.
pub(crate) struct Literal {
    pub(crate) eigenvalues: Seconds,
    pub(crate) inverse: Seconds,
    pub(crate) svd: Seconds,
    /// The spectral radius.
    pub(crate) radius: f64,
    /// All singular values, descending.
    pub(crate) sigma: Vec<f64>,
}

/// Spectral radius of `a`, then the Katz similarity for the decay `alpha` and its decomposition, on one
/// thread.
pub(crate) fn literal(a: &SparseMatrix, alpha: f64) -> Result<Literal, Failure> {
    faer::set_global_parallelism(Par::Seq);
    let n = a.nodes();
    let mut dense = Mat::<f64>::zeros(n, n);
    for (i, j, weight) in a.triplets() {
        dense[(i, j)] = weight;
    }
    let (eigenvalues, found) = timed(|| dense.eigenvalues());
    let found = found.map_err(|error| format!("eigenvalues: {error:?}"))?;
    let radius = found.iter().map(|value| value.norm()).fold(0.0, f64::max);
    let (inverse, similarity) = timed(|| {
        let system = Mat::from_fn(n, n, |i, j| f64::from(u8::from(i == j)) - alpha * dense[(i, j)]);
        let mut similarity = PartialPivLu::new(system.as_ref()).inverse();
        for i in 0..n {
            similarity[(i, i)] -= 1.0;
        }
        similarity
    });
    let (svd, found) = timed(|| similarity.thin_svd());
    let found = found.map_err(|error| format!("svd: {error:?}"))?;
    let sigma = found.S().column_vector();
    Ok(Literal { eigenvalues, inverse, svd, radius, sigma: (0..n).map(|j| sigma[j]).collect() })
}
