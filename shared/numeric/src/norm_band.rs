//! The spectral norm by which a graph is scaled, from frame to frame.
//!
//! Dividing by the norm makes weights mean the same for every graph, for which a few percent more or less
//! do not matter. The norm of a fleet that moves changes a little in every frame, though, and with it
//! every entry of the scaled graph: nothing that rests on entries that stay, such as an update of the
//! Katz similarity by the rows that changed, would ever apply. So a norm stays for as long as the true
//! one is certified to be near it.

use crate::katz::KatzError;
use crate::matrix::SparseMatrix;
use crate::norm::{bipartite, spectral_norm};
use crate::radius_bound::{LIVE_WIDTH, RadiusTracker};

/// Width of the bracket of the norm relative to the hysteresis: what is left of the hysteresis is for the
/// norm to drift in.
const BRACKET: f64 = 0.25;

/// Keeps the norm of a graph while ‖A‖₂ stays near it; by default, every graph has its own.
#[derive(Debug, Default)]
pub struct NormBand {
    hysteresis: f64,
    tracker: RadiusTracker,
    kept: Option<f64>,
}

impl NormBand {
    /// Keeps a norm s while ‖A‖₂ is certified to be within s(1 − h) and s(1 + h) for the relative
    /// `hysteresis` h. With h = 0 every frame has its own norm.
    ///
    /// # Errors
    /// [`KatzError::Fraction`] unless 0 ≤ h < 1.
    pub fn new(hysteresis: f64) -> Result<Self, KatzError> {
        if !(0.0..1.0).contains(&hysteresis) {
            return Err(KatzError::Fraction(hysteresis));
        }
        Ok(Self { hysteresis, tracker: RadiusTracker::default(), kept: None })
    }

    /// Lets go of the norm: the next one is that of its graph.
    pub fn reset(&mut self) {
        self.kept = None;
    }

    /// The norm for `a`, in the unit of its weights: the one that is kept, or [`spectral_norm`] of `a`.
    pub fn choose(&mut self, a: &SparseMatrix) -> f64 {
        if let Some(kept) = self.kept
            && self.hysteresis > 0.0
            && !a.is_zero()
        {
            let (lower, upper) = self.bracket(a);
            let h = self.hysteresis;
            if lower >= kept * (1.0 - h) && upper <= kept * (1.0 + h) {
                return kept;
            }
        }
        let norm = spectral_norm(a);
        self.kept = (norm > 0.0).then_some(norm);
        norm
    }

    /// Certified bounds of ‖A‖₂: the spectral radius of A if it is symmetric, and that of the bipartite
    /// graph \[0 A; Aᵀ 0\] otherwise.
    fn bracket(&mut self, a: &SparseMatrix) -> (f64, f64) {
        let width = LIVE_WIDTH.min(BRACKET * self.hysteresis);
        let bound = if a.is_symmetric() {
            self.tracker.refine(a, width)
        } else {
            self.tracker.refine(&bipartite(a), width)
        };
        (bound.lower, bound.upper)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edges(w: f64, symmetric: bool) -> SparseMatrix {
        let mut edges = vec![(0, 1, w), (1, 2, 2.0 * w), (2, 3, w)];
        if symmetric {
            edges.extend([(1, 0, w), (2, 1, 2.0 * w), (3, 2, w)]);
        }
        SparseMatrix::from_triplets(4, edges).unwrap()
    }

    #[test]
    fn a_norm_stays_while_it_is_near() {
        for symmetric in [false, true] {
            let mut band = NormBand::new(0.1).unwrap();
            let first = band.choose(&edges(1.0, symmetric));
            assert_eq!(first, spectral_norm(&edges(1.0, symmetric)));
            for w in [1.05, 0.95, 1.0] {
                assert_eq!(band.choose(&edges(w, symmetric)), first, "{w}");
            }
            for w in [1.11, 0.9, 17.0, 1e-9, 1e9] {
                let a = edges(w, symmetric);
                assert_eq!(band.choose(&a), spectral_norm(&a), "{w}");
            }
            let a = edges(1.001e9, symmetric);
            assert_eq!(band.choose(&a), spectral_norm(&edges(1e9, symmetric)));
            band.reset();
            assert_eq!(band.choose(&a), spectral_norm(&a));
        }
    }

    #[test]
    fn without_hysteresis_every_graph_has_its_own() {
        let mut band = NormBand::new(0.0).unwrap();
        for w in [1.0, 1.0001, 1.0] {
            assert_eq!(band.choose(&edges(w, true)), spectral_norm(&edges(w, true)));
        }
        assert_eq!(band.choose(&SparseMatrix::from_triplets(3, []).unwrap()), 0.0);
        assert!(matches!(NormBand::new(1.0), Err(KatzError::Fraction(_))));
    }
}
