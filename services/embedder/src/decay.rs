//! The decay α of a frame, by certified bounds of the spectral radius, and the centralities of the robots.

use muster_model::settings::Alpha;
use muster_numeric::alpha_band::AlphaBand;
use muster_numeric::katz::{self, KatzError};
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::radius_bound::{RadiusBound, RadiusTracker};
use muster_numeric::spectral_radius::{SpectralRadius, spectral_radius};

use crate::correspondence::Correspondence;

/// Fleets up to this size have their spectral radius to the last digits in every frame: it takes no longer
/// than bounds do.
const SMALL: usize = 64;

/// Fleets up to this size have it whenever a decay is chosen. It takes tens of milliseconds then, and the
/// same graphs have the same decay whatever was before. For larger ones a few percent serve.
const MEDIUM: usize = 4096;

/// Largest relative error of a centrality.
const CENTRALITY_TOLERANCE: f64 = 1e-9;

/// Bounds of the spectral radius and the decay, from frame to frame.
#[derive(Debug, Default)]
pub(crate) struct Decay {
    tracker: RadiusTracker,
    /// With the fraction and hysteresis that it has.
    band: Option<([f64; 2], AlphaBand)>,
}

/// What was found for a frame.
#[derive(Debug, Clone)]
pub(crate) struct Chosen {
    /// The decay α.
    pub(crate) alpha: f64,
    /// Bounds of ρ(A*).
    pub(crate) radius: SpectralRadius,
    /// The Katz centrality of each robot.
    pub(crate) centrality: Vec<f64>,
}

impl Decay {
    /// Takes what is known of the robots along to the next frame.
    pub(crate) fn carry(&mut self, robots: &Correspondence) {
        self.tracker.carry(robots.to_new(), robots.to_old().len());
    }

    /// The decay for A*: that of the frame before while α ρ stays within `hysteresis` of what the settings
    /// ask for, unless it is to `settle`.
    pub(crate) fn choose(
        &mut self,
        fused: &SparseMatrix,
        asked: Alpha,
        hysteresis: f64,
        settle: bool,
    ) -> Result<Chosen, KatzError> {
        let mut bounds = if fused.nodes() <= SMALL || hysteresis == 0.0 {
            Bounds::exact(&mut self.tracker, fused)
        } else {
            Bounds::near(&mut self.tracker, fused)
        };
        let alpha = match asked {
            Alpha::Value(alpha) => {
                if alpha * bounds.radius.upper >= 1.0 && !bounds.exact {
                    bounds = Bounds::exact(&mut self.tracker, fused);
                }
                katz::Alpha::Value(alpha).resolve(fused, &bounds.radius)?
            }
            Alpha::Fraction { fraction } => {
                let asked = [fraction, hysteresis];
                let kept = self.band.take().filter(|(of, _)| *of == asked && !settle);
                let mut band = match kept {
                    Some((_, band)) => band,
                    None => AlphaBand::new(fraction, hysteresis)?,
                };
                let mut chosen = band.choose(fused, &bounds.bound());
                if chosen.changed && !bounds.exact {
                    band.reset();
                    bounds = Bounds::exact(&mut self.tracker, fused);
                    chosen = band.choose(fused, &bounds.bound());
                }
                self.band = Some((asked, band));
                katz::Alpha::Value(chosen.alpha).resolve(fused, &bounds.radius)?
            }
        };
        let (bound, radius) = (bounds.bound(), bounds.radius);
        self.tracker.solve_centrality(fused, alpha, &bound, CENTRALITY_TOLERANCE)?;
        Ok(Chosen { alpha, radius, centrality: self.tracker.centralities().to_vec() })
    }
}

/// Bounds of ρ, and whether they are as narrow as a choice demands.
struct Bounds {
    radius: SpectralRadius,
    exact: bool,
}

impl Bounds {
    fn near(tracker: &mut RadiusTracker, fused: &SparseMatrix) -> Self {
        let bound = tracker.bound(fused);
        Self { radius: tracker.spectral_radius(&bound), exact: false }
    }

    fn exact(tracker: &mut RadiusTracker, fused: &SparseMatrix) -> Self {
        if fused.nodes() <= MEDIUM {
            return Self { radius: spectral_radius(fused, None), exact: true };
        }
        Self { exact: true, ..Self::near(tracker, fused) }
    }

    fn bound(&self) -> RadiusBound {
        let SpectralRadius { lower, upper, acyclic, .. } = self.radius;
        RadiusBound { lower, upper, acyclic, sweeps: 0 }
    }
}
