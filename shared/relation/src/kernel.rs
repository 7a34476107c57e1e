//! How much a distance is worth.

use muster_model::settings::{SpatialKernel, SpatialSettings};

/// The largest slope of [`wendland_c2`] in modulus, which it has at 1/4: two relative distances that
/// differ by x have weights that differ by at most so many times x.
pub const WENDLAND_C2_SLOPE: f64 = 135.0 / 64.0;

/// Wendland's function of smoothness C² for up to three dimensions, (1 − r)⁴ (1 + 4r) for r below 1
/// and 0 from there on (H. Wendland, "Piecewise polynomial, positive definite and compactly supported
/// radial functions of minimal degree", Advances in Computational Mathematics 4, 1995).
///
/// r is the distance divided by the radius of the support, 0 or more. The value falls from 1 to 0 with
/// no slope at either end. At 1 the second and third derivative vanish too, which makes an edge appear
/// as if it had been there with weight 0; Wendland's function of the next lower smoothness, (1 − r)²,
/// has a kink at 0 and a jump of the second derivative at 1, and that of the next higher one,
/// (1 − r)⁶ (1 + 6r + 35r²/3), spends more of its radius on weights near 0 and thus needs more edges
/// for the same neighbourhood.
#[must_use]
pub fn wendland_c2(r: f64) -> f64 {
    if r >= 1.0 {
        return 0.0;
    }
    let squared = (1.0 - r) * (1.0 - r);
    squared * squared * (1.0 + 4.0 * r)
}

/// A kernel with its lengths in metres.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Kernel {
    form: SpatialKernel,
    /// The width w, or the radius R of the support.
    length_m: f64,
    /// No edge is longer.
    radius_m: f64,
}

impl Kernel {
    /// The kernel of the settings for a fleet of which `scale_m`, above 0, is the median distance to
    /// the nearest neighbour.
    pub(crate) fn new(settings: &SpatialSettings, scale_m: f64) -> Self {
        let radius_m = settings.radius_m.unwrap_or(f64::INFINITY);
        let form = settings.kernel;
        let length_m = match form {
            SpatialKernel::Gaussian | SpatialKernel::Exponential => settings.width * scale_m,
            // Not cut at the longest edge, but shrunk to it, so that it ends there as smoothly.
            SpatialKernel::WendlandC2 => (settings.cutoff * scale_m).min(radius_m),
        };
        Self { form, length_m, radius_m }
    }

    /// The width w, or the radius R of the support, in metres.
    pub(crate) fn length_m(&self) -> f64 {
        self.length_m
    }

    /// The same kernel of another width or radius in metres.
    pub(crate) fn with_length(self, length_m: f64) -> Self {
        Self { length_m, ..self }
    }

    /// The weight of an edge of so many metres; none if it is no edge.
    pub(crate) fn weight(&self, metres: f64) -> Option<f64> {
        let lengths = metres / self.length_m;
        let weight = match self.form {
            SpatialKernel::Gaussian => (-0.5 * lengths * lengths).exp(),
            SpatialKernel::Exponential => (-lengths).exp(),
            SpatialKernel::WendlandC2 => wendland_c2(lengths),
        };
        (metres <= self.radius_m && weight >= MIN_WEIGHT).then_some(weight)
    }
}

/// Weights below this are no edges: next to a neighbour's weight, which is near 1, they move no digit
/// that anybody reads, but they would fill the graph of a wide fleet with edges between strangers.
pub const MIN_WEIGHT: f64 = 1e-12;

#[cfg(test)]
mod tests {
    use super::*;

    /// Relative distances from 0 to beyond the support.
    fn steps() -> impl Iterator<Item = f64> {
        (0..=1200).map(|step| f64::from(step) / 1000.0)
    }

    #[test]
    fn it_falls_from_one_to_zero() {
        assert_eq!((wendland_c2(0.0), wendland_c2(0.5), wendland_c2(1.0)), (1.0, 0.1875, 0.0));
        assert_eq!([f64::MAX, f64::INFINITY].map(wendland_c2), [0.0; 2]);
        assert!(steps().zip(steps().skip(1)).all(|(near, far)| {
            let (near, far) = (wendland_c2(near), wendland_c2(far));
            (0.0..=1.0).contains(&far) && (far < near || near == 0.0)
        }));
    }

    #[test]
    fn its_slope_is_what_is_said() {
        let slope = |r: f64| 20.0 * r * (1.0 - r).max(0.0).powi(3);
        let steepest = steps().map(slope).fold(0.0, f64::max);
        assert_eq!((steepest, slope(0.25)), (WENDLAND_C2_SLOPE, WENDLAND_C2_SLOPE));
        let h = 1e-5;
        for r in steps().skip(1) {
            let found = (wendland_c2(r - h) - wendland_c2(r + h)) / (2.0 * h);
            assert!((found - slope(r)).abs() < 1e-8, "{r}: {found}");
        }
    }

    #[test]
    fn value_slope_and_curvature_end_at_the_radius() {
        // The fourth power: halving what is left of the radius leaves a sixteenth of the weight.
        for rest in [1e-1, 1e-2, 1e-3] {
            let weight = wendland_c2(1.0 - rest);
            assert!(weight <= 5.0 * rest.powi(4) * (1.0 + 1e-9), "{rest}: {weight}");
        }
    }
}
