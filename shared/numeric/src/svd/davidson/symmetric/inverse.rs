//! The function of H that corrects a triplet, as a polynomial on the unwanted part of the spectrum: its
//! values at Chebyshev nodes are interpolated.

/// Degree of the polynomial that corrects a triplet.
pub(super) const CORRECTION_DEGREE: usize = 8;

/// Nodes of the interpolation of the function.
const INTERPOLATION_NODES: usize = 32;

/// Least distance of σ/(1 + σ) from the unwanted part of the spectrum, relative to that.
const LEAST_DISTANCE: f64 = 0.05;

/// The function of H that corrects a triplet: the inverse of (σ − (1 + σ) x)(σ + (1 − σ) x).
pub(super) struct Inverse {
    sigma: f64,
    /// σ/(1 + σ), or a little more than the unwanted part of the spectrum.
    pole: f64,
    /// Distance of it from there.
    distance: f64,
    low: f64,
    cut: f64,
    samples: [f64; INTERPOLATION_NODES],
}

/// Places of the interpolation within −1 and 1, and the Chebyshev polynomials there.
pub(super) struct Nodes {
    places: [f64; INTERPOLATION_NODES],
    polynomials: [[f64; INTERPOLATION_NODES]; CORRECTION_DEGREE + 1],
}

impl Nodes {
    pub(super) fn new() -> Self {
        let step = std::f64::consts::PI / INTERPOLATION_NODES as f64;
        let cosine = |k: usize, node: usize| (k as f64 * step * (node as f64 + 0.5)).cos();
        Self {
            places: std::array::from_fn(|node| cosine(1, node)),
            polynomials: std::array::from_fn(|k| std::array::from_fn(|node| cosine(k, node))),
        }
    }
}

impl Inverse {
    pub(super) fn new(sigma: f64, low: f64, cut: f64, nodes: &Nodes) -> Self {
        let distance = (sigma / (1.0 + sigma) - cut).max(LEAST_DISTANCE * (cut - low));
        let samples = [0.0; INTERPOLATION_NODES];
        let mut inverse = Self { sigma, pole: cut + distance, distance, low, cut, samples };
        inverse.samples = std::array::from_fn(|node| {
            let x = 0.5 * (cut + low) + 0.5 * (cut - low) * nodes.places[node];
            1.0 / ((inverse.pole - x) * inverse.other(x))
        });
        inverse
    }

    /// The other factor, away from zero. A factor 1 + σ of both is left out: lengths do not matter.
    fn other(&self, x: f64) -> f64 {
        let most =
            self.sigma + (1.0 - self.sigma) * if self.sigma < 1.0 { self.cut } else { self.low };
        (self.sigma + (1.0 - self.sigma) * x).max(LEAST_DISTANCE * most)
    }

    /// Coefficient of the Chebyshev polynomial of degree `k` on the unwanted part.
    pub(super) fn coefficient(&self, k: usize, nodes: &Nodes) -> f64 {
        let terms = self.samples.iter().zip(&nodes.polynomials[k]);
        let sum: f64 = terms.map(|(g, polynomial)| g * polynomial).sum();
        sum * if k == 0 { 1.0 } else { 2.0 } / INTERPOLATION_NODES as f64
    }

    /// The function at an eigenvalue of Z, where it may have its pole.
    pub(super) fn at_vector(&self, value: f64) -> f64 {
        let distance = self.pole - value;
        let distance = if distance.abs() < self.distance {
            self.distance.copysign(distance)
        } else {
            distance
        };
        1.0 / (distance * self.other(value))
    }
}
