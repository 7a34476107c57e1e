//! Singular values and vectors as the choice of the rank sees them.

/// What the choice looks at: the leading singular triplets of the similarity, all of them or some.
pub trait Spectrum {
    /// Number of nodes n.
    fn nodes(&self) -> usize;

    /// Those singular values that are known, descending: all n, or the largest.
    fn singular_values(&self) -> &[f64];

    /// Values up to this one are noise.
    fn noise(&self) -> f64;

    /// Squared length that triplet `j` adds to the row of node `i` in \[U√Σ, V√Σ\].
    fn squared_share(&self, i: usize, j: usize) -> f64;
}

/// Singular values of a matrix of n rows up to this one are rounding noise: n ε σ₁.
pub(crate) fn null_threshold(sigma: &[f64], n: usize) -> f64 {
    n as f64 * f64::EPSILON * sigma.first().copied().unwrap_or(0.0)
}
