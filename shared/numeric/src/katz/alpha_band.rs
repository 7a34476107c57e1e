//! The choice of the decay α from frame to frame.
//!
//! A cached Katz matrix is valid for one α only, while ρ changes a little in every frame. So α is
//! kept while αρ stays near the fraction asked for. It is compared with the upper bound of ρ, so no
//! α ≥ 1/ρ can be kept or chosen.

use std::ops::RangeInclusive;

use super::error::KatzError;
use crate::linalg::matrix::SparseMatrix;
use crate::norm::spectral_norm;
use crate::radius::tracker::RadiusBound;

/// Keeps α while α·ρ stays within a band around the fraction asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlphaBand {
    fraction: f64,
    hysteresis: f64,
    alpha: Option<f64>,
}

/// A decay, and whether it differs from the previous one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decay {
    /// The decay α, in the inverse unit of the weights.
    pub alpha: f64,
    /// False when α equals that of the last frame bit for bit.
    pub changed: bool,
}

impl AlphaBand {
    /// Keeps αρ near `fraction` f, strictly between 0 and 1: within f(1 − h) and f(1 + h) for the
    /// relative `hysteresis` h, but never above the middle between f and 1. With h = 0 every frame
    /// has its own α = f/ρ.
    ///
    /// # Errors
    /// [`KatzError::Fraction`] unless 0 < f < 1, [`KatzError::Hysteresis`] unless 0 ≤ h < 1.
    pub fn new(fraction: f64, hysteresis: f64) -> Result<Self, KatzError> {
        if !(fraction > 0.0 && fraction < 1.0) {
            return Err(KatzError::Fraction(fraction));
        }
        if !(0.0..1.0).contains(&hysteresis) {
            return Err(KatzError::Hysteresis(hysteresis));
        }
        Ok(Self { fraction, hysteresis, alpha: None })
    }

    /// The current α, `None` before the first frame.
    #[must_use]
    pub fn alpha(&self) -> Option<f64> {
        self.alpha
    }

    /// Discards the current α: the next frame gets its own.
    pub fn reset(&mut self) {
        self.alpha = None;
    }

    /// Range of αρ in which α stays.
    #[must_use]
    pub fn limits(&self) -> RangeInclusive<f64> {
        let (f, h) = (self.fraction, self.hysteresis);
        f * (1.0 - h)..=(f * (1.0 + h)).min(0.5 * (1.0 + f))
    }

    /// The decay for the graph `a` with the spectral radius within `bound`: the current α if α
    /// times the upper bound is within [`AlphaBand::limits`], otherwise f over the upper bound.
    ///
    /// The radius of an acyclic graph is 0 and admits every α; its norm ‖A‖₂ replaces the radius
    /// then, or 1 without any edge (see [`crate::katz::resolve_alpha`]).
    pub fn choose(&mut self, a: &SparseMatrix, bound: &RadiusBound) -> Decay {
        let scale = match bound.upper {
            upper if upper > 0.0 => upper,
            _ if a.is_zero() => 1.0,
            _ => spectral_norm(a),
        };
        let limits = self.limits();
        if let Some(alpha) = self.alpha.filter(|alpha| limits.contains(&(alpha * scale))) {
            return Decay { alpha, changed: false };
        }
        let alpha = self.fraction / scale;
        let changed = self.alpha != Some(alpha);
        self.alpha = Some(alpha);
        Decay { alpha, changed }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bound(upper: f64) -> RadiusBound {
        RadiusBound { lower: 0.97 * upper, upper, acyclic: upper == 0.0, sweeps: 1 }
    }

    fn edge(w: f64) -> SparseMatrix {
        SparseMatrix::from_triplets(2, [(0, 1, w)]).unwrap()
    }

    #[test]
    fn alpha_stays_within_the_band_and_only_there() {
        let mut band = AlphaBand::new(0.5, 0.1).unwrap();
        let first = band.choose(&edge(1.0), &bound(2.0));
        assert_eq!(first, Decay { alpha: 0.25, changed: true });
        for upper in [1.81, 2.19, 2.0] {
            assert_eq!(
                band.choose(&edge(1.0), &bound(upper)),
                Decay { alpha: 0.25, changed: false }
            );
        }
        for upper in [2.21, 1.9, 40.0, 1e-30, 1e30] {
            let decay = band.choose(&edge(1.0), &bound(upper));
            assert_eq!(decay, Decay { alpha: 0.5 / upper, changed: true });
        }
    }

    #[test]
    fn the_band_ends_below_one() {
        for (fraction, hysteresis) in [(0.9, 0.5), (0.999, 0.9), (0.5, 0.999)] {
            let mut band = AlphaBand::new(fraction, hysteresis).unwrap();
            assert!(*band.limits().end() < 1.0);
            band.choose(&edge(1.0), &bound(1.0));
            for step in 0..300 {
                let upper = 1.0 + f64::from(step) * 0.01;
                assert!(band.choose(&edge(1.0), &bound(upper)).alpha * upper < 1.0);
            }
        }
        for fraction in [0.0, 1.0, f64::NAN] {
            assert!(matches!(AlphaBand::new(fraction, 0.1), Err(KatzError::Fraction(_))));
        }
        for hysteresis in [1.0, -0.1] {
            assert!(matches!(AlphaBand::new(0.5, hysteresis), Err(KatzError::Hysteresis(_))));
        }
    }

    #[test]
    fn acyclic_graphs_are_measured_by_their_norm() {
        let mut band = AlphaBand::new(0.5, 0.1).unwrap();
        let decay = band.choose(&edge(4.0), &bound(0.0));
        assert!((decay.alpha - 0.125).abs() < 1e-12);
        assert!(!band.choose(&edge(4.1), &bound(0.0)).changed);
        assert!(band.choose(&edge(8.0), &bound(0.0)).changed);
        assert_eq!(
            band.choose(&SparseMatrix::from_triplets(2, []).unwrap(), &bound(0.0)).alpha,
            0.5
        );
    }
}
