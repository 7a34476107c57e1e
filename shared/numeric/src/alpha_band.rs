//! The choice of the decay α from frame to frame.
//!
//! A cached Katz matrix belongs to one α and is lost with it, while ρ wanders a little with every
//! frame. So α stays as long as αρ stays near the fraction asked for; and as it is held against
//! the upper bound of ρ, no α from 1/ρ on can stay or be chosen.

use crate::katz::KatzError;
use crate::matrix::SparseMatrix;
use crate::norm::spectral_norm;
use crate::radius_bound::RadiusBound;

/// Keeps α while α·ρ stays within a band around the fraction asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlphaBand {
    fraction: f64,
    hysteresis: f64,
    alpha: Option<f64>,
}

/// A decay, and whether it is another one than before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decay {
    /// The decay α, in the inverse unit of the weights.
    pub alpha: f64,
    /// False when α is the one of the last frame, bit for bit.
    pub changed: bool,
}

impl AlphaBand {
    /// Holds αρ near `fraction` f, strictly between 0 and 1: within f(1 − h) and f(1 + h) for the
    /// relative `hysteresis` h, but never above the middle between f and 1. With h = 0 every
    /// frame has its own α = f/ρ.
    ///
    /// # Errors
    /// [`KatzError::Fraction`] when f, or h from 0 up to 1, is out of its range.
    pub fn new(fraction: f64, hysteresis: f64) -> Result<Self, KatzError> {
        if !(fraction > 0.0 && fraction < 1.0) {
            return Err(KatzError::Fraction(fraction));
        }
        if !(0.0..1.0).contains(&hysteresis) {
            return Err(KatzError::Fraction(hysteresis));
        }
        Ok(Self { fraction, hysteresis, alpha: None })
    }

    /// The α in force, none before the first frame.
    #[must_use]
    pub fn alpha(&self) -> Option<f64> {
        self.alpha
    }

    /// Lets go of the α in force: the next frame gets its own.
    pub fn reset(&mut self) {
        self.alpha = None;
    }

    /// Least and largest αρ at which α stays.
    #[must_use]
    pub fn limits(&self) -> (f64, f64) {
        let (f, h) = (self.fraction, self.hysteresis);
        (f * (1.0 - h), (f * (1.0 + h)).min(0.5 * (1.0 + f)))
    }

    /// The decay for the graph `a` with the spectral radius within `bound`: the one in force if α
    /// times the upper bound is within [`AlphaBand::limits`], f over the upper bound otherwise.
    ///
    /// The radius of an acyclic graph is 0 and admits every α; its norm ‖A‖₂ takes the place of
    /// the radius then, or 1 without any edge (see [`crate::katz::resolve_alpha`]).
    pub fn choose(&mut self, a: &SparseMatrix, bound: &RadiusBound) -> Decay {
        let scale = match bound.upper {
            upper if upper > 0.0 => upper,
            _ if a.is_zero() => 1.0,
            _ => spectral_norm(a),
        };
        let (least, most) = self.limits();
        if let Some(alpha) = self.alpha.filter(|alpha| (least..=most).contains(&(alpha * scale))) {
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
            assert!(band.limits().1 < 1.0);
            band.choose(&edge(1.0), &bound(1.0));
            for step in 0..300 {
                let upper = 1.0 + f64::from(step) * 0.01;
                assert!(band.choose(&edge(1.0), &bound(upper)).alpha * upper < 1.0);
            }
        }
        for bad in [(0.0, 0.1), (1.0, 0.1), (f64::NAN, 0.1), (0.5, 1.0), (0.5, -0.1)] {
            assert!(matches!(AlphaBand::new(bad.0, bad.1), Err(KatzError::Fraction(_))));
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
