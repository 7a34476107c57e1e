//! The decay α of a frame, by certified bounds of the spectral radius, and the centralities of the robots.

use muster_model::settings::Alpha;
use muster_numeric::alpha_band::AlphaBand;
use muster_numeric::katz::{KatzError, resolve_alpha};
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::radius_bound::{RadiusBound, RadiusTracker};
use muster_numeric::spectral_radius::{SpectralRadius, spectral_radius};

use crate::correspondence::Correspondence;
use crate::params::{EmbeddingParams, Pace};

/// Fleets of up to so many robots have their spectral radius to the last digits in every frame: it takes no
/// longer than bounds do.
const EXACT_EACH_FRAME_ROBOTS: usize = 64;

/// Largest relative error of a centrality.
const CENTRALITY_TOLERANCE: f64 = 1e-9;

/// The decay of a frame.
#[derive(Debug, Clone)]
pub struct Decay {
    /// The decay α.
    pub alpha: f64,
    /// Bounds of ρ(A*).
    pub radius: SpectralRadius,
}

/// Bounds of the spectral radius, the decay and the centralities, from frame to frame.
#[derive(Debug, Default)]
pub(crate) struct DecayTracker {
    tracker: RadiusTracker,
    /// With the fraction and hysteresis that it has.
    band: Option<([f64; 2], AlphaBand)>,
}

impl DecayTracker {
    /// Takes what is known of the robots along to the next frame.
    pub(crate) fn carry(&mut self, robots: &Correspondence) {
        self.tracker.carry(robots.to_new(), robots.to_old().len());
    }

    /// The decay for A*: that of the frame before while α ρ stays within the hysteresis of what the
    /// parameters ask for, unless the fleet is at rest.
    pub(crate) fn choose(
        &mut self,
        fused: &SparseMatrix,
        params: &EmbeddingParams,
    ) -> Result<Decay, KatzError> {
        let most = params.exact_radius_robots;
        let hysteresis = params.hysteresis;
        let mut bounds = if fused.nodes() <= EXACT_EACH_FRAME_ROBOTS || hysteresis == 0.0 {
            Bounds::exact(&mut self.tracker, fused, most)
        } else {
            Bounds::near(&mut self.tracker, fused)
        };
        let alpha = match params.alpha {
            Alpha::Value(alpha) => {
                if alpha * bounds.radius.upper >= 1.0 && !bounds.exact {
                    bounds = Bounds::exact(&mut self.tracker, fused, most);
                }
                alpha
            }
            Alpha::Fraction { fraction } => {
                let wanted = [fraction, hysteresis];
                let is_kept = params.pace == Pace::Moving;
                let kept = self.band.take().filter(|(of, _)| *of == wanted && is_kept);
                let mut band = match kept {
                    Some((_, band)) => band,
                    None => AlphaBand::new(fraction, hysteresis)?,
                };
                let mut chosen = band.choose(fused, &bounds.bound());
                if chosen.changed && !bounds.exact {
                    band.reset();
                    bounds = Bounds::exact(&mut self.tracker, fused, most);
                    chosen = band.choose(fused, &bounds.bound());
                }
                self.band = Some((wanted, band));
                chosen.alpha
            }
        };
        let alpha = resolve_alpha(Alpha::Value(alpha), fused, &bounds.radius)?;
        Ok(Decay { alpha, radius: bounds.radius })
    }

    /// The Katz centrality of each robot, beginning with those of the frame before.
    pub(crate) fn centralities(
        &mut self,
        fused: &SparseMatrix,
        decay: &Decay,
    ) -> Result<&[f64], KatzError> {
        let bound = bound(&decay.radius);
        self.tracker.solve_centrality(fused, decay.alpha, &bound, CENTRALITY_TOLERANCE)?;
        Ok(self.tracker.centralities())
    }
}

fn bound(radius: &SpectralRadius) -> RadiusBound {
    let SpectralRadius { lower, upper, acyclic, .. } = *radius;
    RadiusBound { lower, upper, acyclic, sweeps: 0 }
}

/// Bounds of ρ, and whether they are as narrow as a choice of the decay demands.
struct Bounds {
    radius: SpectralRadius,
    exact: bool,
}

impl Bounds {
    fn near(tracker: &mut RadiusTracker, fused: &SparseMatrix) -> Self {
        let bound = tracker.bound(fused);
        Self { radius: tracker.spectral_radius(&bound), exact: false }
    }

    /// To the last digits for up to `most` robots.
    fn exact(tracker: &mut RadiusTracker, fused: &SparseMatrix, most: usize) -> Self {
        if fused.nodes() <= most {
            return Self { radius: spectral_radius(fused, None), exact: true };
        }
        Self { exact: true, ..Self::near(tracker, fused) }
    }

    fn bound(&self) -> RadiusBound {
        bound(&self.radius)
    }
}
