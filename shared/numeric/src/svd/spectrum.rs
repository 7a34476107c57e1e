//! The singular triplets that the choice of the rank needs, and their noise level.

/// The leading singular triplets of the similarity, all of them or some.
pub trait Spectrum {
    /// Number of nodes n.
    fn nodes(&self) -> usize;

    /// The known singular values, descending: all n, or the largest.
    fn singular_values(&self) -> &[f64];

    /// Noise level: values up to this one count as zero.
    fn noise(&self) -> f64;

    /// Squared contribution of triplet `j` to the length of the row of node `i` in \[U√Σ, V√Σ\].
    fn squared_share(&self, i: usize, j: usize) -> f64;
}

/// Singular values of a matrix of n rows up to this one are rounding noise: n ε σ₁.
pub(crate) fn null_threshold(sigma: &[f64], n: usize) -> f64 {
    n as f64 * f64::EPSILON * sigma.first().copied().unwrap_or(0.0)
}
