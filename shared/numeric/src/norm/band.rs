//! The spectral norm that scales a graph, from frame to frame.
//!
//! Dividing by the norm makes weights comparable between graphs; a few percent do not matter for
//! that. But the norm of a moving fleet changes a little in every frame, and with it every entry of
//! the scaled graph, so that no method that relies on unchanged entries, such as an update of the
//! Katz similarity by the changed rows, could apply. So a norm is kept while the true one is near
//! it. A few steps of the power method on AᵀA per frame, continued from the previous frame,
//! estimate the true one. Nothing depends on an exact norm: any scale is admissible.

use crate::linalg::matrix::SparseMatrix;
use thiserror::Error;

use super::spectral::spectral_norm;

/// Steps of the power method per frame.
const FRAME_STEPS: usize = 4;

/// Most steps after a new norm, for the estimate to converge to it.
const FIRST_STEPS: usize = 200;

/// Part of each vector that is spread evenly over all nodes, so that the estimate follows when
/// another part of the graph becomes the heaviest.
const EVEN_PART: f64 = 1e-3;

/// The hysteresis of a [`NormBand`] is not a number from 0 to below 1.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error("hysteresis {0} is not a number from 0 to below 1")]
pub struct HysteresisError(pub f64);

/// Keeps the norm of a graph while ‖A‖₂ stays near it. By default every graph has its own norm.
#[derive(Debug, Default)]
pub struct NormBand {
    hysteresis: f64,
    kept: Option<f64>,
    /// An estimate of the right singular vector, of length 1.
    vector: Vec<f64>,
    image: Vec<f64>,
}

impl NormBand {
    /// Keeps a norm s while ‖A‖₂ is estimated to be within s(1 − h) and s(1 + h) for the relative
    /// `hysteresis` h. With h = 0 every frame has its own norm.
    ///
    /// # Errors
    /// [`HysteresisError`] unless 0 ≤ h < 1.
    pub fn new(hysteresis: f64) -> Result<Self, HysteresisError> {
        if !(0.0..1.0).contains(&hysteresis) {
            return Err(HysteresisError(hysteresis));
        }
        Ok(Self { hysteresis, ..Self::default() })
    }

    /// Discards the norm: the next graph gets its own.
    pub fn reset(&mut self) {
        self.kept = None;
    }

    /// The norm for `a`, in the unit of its weights: the kept one, or [`spectral_norm`] of `a`.
    pub fn choose(&mut self, a: &SparseMatrix) -> f64 {
        let h = self.hysteresis;
        if h == 0.0 || a.is_zero() {
            return spectral_norm(a);
        }
        if let Some(kept) = self.kept
            && (kept * (1.0 - h)..=kept * (1.0 + h)).contains(&self.estimate(
                a,
                FRAME_STEPS,
                f64::INFINITY,
            ))
        {
            return kept;
        }
        let norm = spectral_norm(a);
        self.kept = Some(norm);
        self.estimate(a, FIRST_STEPS, norm * (1.0 - 0.25 * h));
        norm
    }

    /// A lower bound of ‖A‖₂: ‖Av‖ for the unit vector v after `steps` steps, or as soon as it
    /// reaches `enough`.
    fn estimate(&mut self, a: &SparseMatrix, steps: usize, enough: f64) -> f64 {
        let n = a.nodes();
        let even = (n as f64).sqrt().recip();
        if self.vector.len() != n {
            self.vector.clear();
            self.vector.resize(n, even);
        }
        let top = a.max_weight();
        let mut norm = 0.0;
        for _ in 0..steps {
            self.image.clear();
            self.image.resize(n, 0.0);
            let mut squares = 0.0;
            for i in 0..n {
                let sum: f64 = a.row(i).map(|(j, w)| w / top * self.vector[j]).sum();
                squares += sum * sum;
                for (j, w) in a.row(i) {
                    self.image[j] += w / top * sum;
                }
            }
            norm = top * squares.sqrt();
            let length = self.image.iter().map(|value| value * value).sum::<f64>().sqrt();
            for (value, image) in self.vector.iter_mut().zip(&self.image) {
                *value = image / length.max(f64::MIN_POSITIVE) + EVEN_PART * even;
            }
            let length = self.vector.iter().map(|value| value * value).sum::<f64>().sqrt();
            self.vector.iter_mut().for_each(|value| *value /= length);
            if norm >= enough {
                break;
            }
        }
        norm
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
        assert_eq!(NormBand::new(1.0).err(), Some(HysteresisError(1.0)));
    }
}
