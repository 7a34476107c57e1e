//! Parameters of the method, and their check.
//!
//! Parameters are plain structs with public fields. [`EmbeddingParams::check`] and [`DivisionParams::check`]
//! turn them into valid ones, which is what the method takes. The defaults are those of the live fleet; the
//! fields under "computation" change how a result is computed and how exact it is, not what is defined.

use std::collections::BTreeMap;
use std::ops::Deref;

use muster_model::id::Modality;
use muster_model::settings::{
    Alpha, CentroidStart, ClustererSettings, Dimension, EmbedderSettings, MAX_DIMENSION,
    Normalization, RowScaling, TeamCount, Trusted,
};

/// Whether more frames are expected soon.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// The fleet moves: scales and decay of the frame before are kept while they fit.
    Moving,
    /// The fleet is at rest, or there is one frame only: scales and decay are those of these very graphs.
    AtRest,
}

/// When a search for triplets that has not reached its tolerance ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effort {
    /// After the rounds of one frame: the next frame begins where this one ended.
    OneFrame,
    /// When a further search no longer halves the residual.
    WhileItHelps,
}

/// From graphs to vectors.
#[derive(Debug, Clone, PartialEq)]
pub struct EmbeddingParams {
    /// Weight of each modality; empty for the default weights of `weights::weights`.
    pub weights: BTreeMap<Modality, f64>,
    /// The share of its weight by which each edge of a modality also leads back, from 0 to 1; a modality
    /// that is not named has 0.
    pub reciprocity: BTreeMap<Modality, f64>,
    /// How each graph is scaled before its weight applies.
    pub normalize: Normalization,
    /// Weight of an edge from each related robot to itself in A*.
    pub self_loops: f64,
    /// Modalities that keep their whole weight, whatever the others say.
    pub trusted: Trusted,
    /// The decay of longer walks.
    pub alpha: Alpha,
    /// Length D = 2K of the vectors.
    pub dimension: Dimension,
    /// The power of its singular value that each singular vector is multiplied by.
    pub power: f64,
    /// How the rows are scaled.
    pub rows: RowScaling,
    /// How many teams the rule for K expects; where it is no fixed number, the relations decide.
    pub teams: TeamCount,
    /// How far norms and αρ may drift from scales and decay before these are chosen again, as a fraction,
    /// from 0 to 1.
    pub hysteresis: f64,

    /// Computation: whether scales and decay of the frame before may be kept. Default: moving.
    pub pace: Pace,
    /// Computation: largest residual of the singular triplets, relative to σ₁, where they are searched for.
    /// Default: `residual_tolerance` of the settings, `idle_tolerance` at rest, and 1e-10 at least.
    pub tolerance: f64,
    /// Computation: seed of random directions. Default: 0.
    pub seed: u64,
    /// Computation: threads of the search. Default: 1, because other services run on the same host.
    pub threads: usize,
    /// Computation: largest K that the rule may choose. Default: half of [`MAX_DIMENSION`], so that an
    /// embedding fits a message.
    pub max_rank: usize,
    /// Computation: fleets of up to so many robots are decomposed whole, which is exact to rounding.
    /// Default: 64, up to which nothing is faster.
    pub dense_robots: usize,
    /// Computation: where the search does not converge, fleets of up to so many robots are decomposed whole
    /// after all. Default: 400, which takes half a second at most; a larger live fleet goes on from what was
    /// found in the next frame, and its division must not stand still meanwhile. For a single problem 2,000,
    /// which takes seconds.
    pub dense_fallback_robots: usize,
    /// Computation: the similarity of fleets of up to so many robots that are decomposed whole is kept for
    /// the next frame. Default: 2,000, all that the live fleet decomposes whole.
    pub cached_robots: usize,
    /// Computation: whenever a decay is chosen, fleets of up to so many robots have the spectral radius to
    /// the last digits; for larger ones bounds within a few percent serve. Default: 4,096, which takes tens
    /// of milliseconds.
    pub exact_radius_robots: usize,
    /// Computation: when a search that does not converge ends. Default: after one frame's rounds.
    pub effort: Effort,
}

/// Least residual that settings can ask for: below this one, rounding decides.
const LEAST_TOLERANCE: f64 = 1e-10;

impl EmbeddingParams {
    /// Those of a live fleet that is divided into so many teams.
    #[must_use]
    pub fn new(settings: &EmbedderSettings, teams: impl Into<TeamCount>, pace: Pace) -> Self {
        let tolerance = match pace {
            Pace::Moving => settings.residual_tolerance,
            Pace::AtRest => settings.idle_tolerance.min(settings.residual_tolerance),
        };
        Self {
            weights: settings.weights.clone(),
            reciprocity: settings.reciprocity.clone(),
            normalize: settings.normalize,
            self_loops: settings.self_loops,
            trusted: settings.trusted.clone(),
            alpha: settings.alpha,
            dimension: settings.dimension,
            power: settings.scale.power(),
            rows: settings.rows,
            teams: teams.into(),
            hysteresis: settings.hysteresis,
            pace,
            tolerance: tolerance.max(LEAST_TOLERANCE),
            seed: 0,
            threads: 1,
            max_rank: MAX_DIMENSION as usize / 2,
            dense_robots: 64,
            dense_fallback_robots: 400,
            cached_robots: 2000,
            exact_radius_robots: 4096,
            effort: Effort::OneFrame,
        }
    }

    /// Those of a single problem: no scale or decay is kept, and nothing for a next frame.
    #[must_use]
    pub fn once(settings: &EmbedderSettings, teams: impl Into<TeamCount>) -> Self {
        Self {
            hysteresis: 0.0,
            cached_robots: 0,
            dense_fallback_robots: 2000,
            exact_radius_robots: usize::MAX,
            effort: Effort::WhileItHelps,
            ..Self::new(settings, teams, Pace::AtRest)
        }
    }

    /// The parameters as valid ones.
    ///
    /// # Errors
    /// The first [`ParamsError`].
    pub fn check(self) -> Result<ValidEmbeddingParams, ParamsError> {
        let share = |value: &f64| (0.0..=1.0).contains(value);
        if let Some((name, weight)) =
            self.weights.iter().find(|(_, w)| !(w.is_finite() && **w >= 0.0))
        {
            return Err(ParamsError::Weight { modality: name.clone(), weight: *weight });
        }
        if let Some((name, value)) = self.reciprocity.iter().find(|(_, value)| !share(value)) {
            return Err(ParamsError::Reciprocity { modality: name.clone(), share: *value });
        }
        match self.alpha {
            Alpha::Value(alpha) if !(alpha.is_finite() && alpha > 0.0) => {
                return Err(ParamsError::Alpha(alpha));
            }
            Alpha::Fraction { fraction } if !(fraction > 0.0 && fraction < 1.0) => {
                return Err(ParamsError::Fraction(fraction));
            }
            _ => {}
        }
        if self.teams.range().is_empty() || *self.teams.range().start() == 0 {
            return Err(ParamsError::Teams(self.teams));
        }
        match self.dimension {
            Dimension::Fixed(dimension) if dimension < 2 || dimension % 2 != 0 => {
                return Err(ParamsError::Dimension(dimension));
            }
            _ => {}
        }
        if !(self.self_loops.is_finite() && self.self_loops >= 0.0) {
            return Err(ParamsError::SelfLoops(self.self_loops));
        }
        if !self.power.is_finite() {
            return Err(ParamsError::Power(self.power));
        }
        if !(0.0..1.0).contains(&self.hysteresis) {
            return Err(ParamsError::Hysteresis(self.hysteresis));
        }
        if !(self.tolerance.is_finite() && self.tolerance > 0.0) {
            return Err(ParamsError::Tolerance(self.tolerance));
        }
        if self.max_rank == 0 {
            return Err(ParamsError::MaxRank);
        }
        Ok(ValidEmbeddingParams(self))
    }
}

impl Default for EmbeddingParams {
    /// Those of a live fleet with the default settings of all services.
    fn default() -> Self {
        Self::new(&EmbedderSettings::default(), ClustererSettings::default().teams, Pace::Moving)
    }
}

/// Parameters of an embedding that have passed [`EmbeddingParams::check`].
#[derive(Debug, Clone, PartialEq)]
pub struct ValidEmbeddingParams(EmbeddingParams);

impl Deref for ValidEmbeddingParams {
    type Target = EmbeddingParams;

    fn deref(&self) -> &EmbeddingParams {
        &self.0
    }
}

/// From vectors to teams.
#[derive(Debug, Clone, PartialEq)]
pub struct DivisionParams {
    /// How many teams; fewer where fewer robots have an embedding.
    pub teams: usize,
    /// How the centroids of a start are chosen.
    pub init: CentroidStart,
    /// Starts of k-means.
    pub restarts: usize,
    /// Most iterations of one start.
    pub max_iterations: usize,
    /// Seed of the random choices.
    pub seed: u64,
    /// The previous division is kept while no start is better by more than this share of the inertia, from
    /// 0 to below 1.
    pub hysteresis: f64,

    /// Computation: threads that the starts are shared out over; they do not change the result. Default: 1,
    /// because other services run on the same host.
    pub threads: usize,
}

impl DivisionParams {
    /// Those of a live fleet that is divided into so many teams.
    #[must_use]
    pub fn new(settings: &ClustererSettings, teams: usize) -> Self {
        Self {
            teams,
            init: settings.init,
            restarts: settings.restarts as usize,
            max_iterations: settings.max_iterations as usize,
            seed: settings.seed,
            hysteresis: settings.hysteresis,
            threads: 1,
        }
    }

    /// The parameters as valid ones.
    ///
    /// # Errors
    /// The first [`ParamsError`].
    pub fn check(self) -> Result<ValidDivisionParams, ParamsError> {
        for (field, count) in [
            ("teams", self.teams),
            ("restarts", self.restarts),
            ("max_iterations", self.max_iterations),
        ] {
            if count == 0 {
                return Err(ParamsError::Count { field });
            }
        }
        if !(0.0..1.0).contains(&self.hysteresis) {
            return Err(ParamsError::Hysteresis(self.hysteresis));
        }
        Ok(ValidDivisionParams(self))
    }
}

impl Default for DivisionParams {
    /// Those of a live fleet with default settings that shows two teams.
    fn default() -> Self {
        Self::new(&ClustererSettings::default(), 2)
    }
}

/// Parameters of a division that have passed [`DivisionParams::check`].
#[derive(Debug, Clone, PartialEq)]
pub struct ValidDivisionParams(DivisionParams);

impl Deref for ValidDivisionParams {
    type Target = DivisionParams;

    fn deref(&self) -> &DivisionParams {
        &self.0
    }
}

/// Why parameters are not valid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ParamsError {
    /// A weight is negative or not finite.
    #[error("weights.{modality}: must be a number from 0, not {weight}")]
    Weight {
        /// The modality.
        modality: Modality,
        /// Its weight.
        weight: f64,
    },
    /// A share of reciprocity is outside of 0 to 1.
    #[error("reciprocity.{modality}: must be from 0 to 1, not {share}")]
    Reciprocity {
        /// The modality.
        modality: Modality,
        /// Its share.
        share: f64,
    },
    /// The decay is not positive and finite.
    #[error("alpha: must be above 0, not {0}")]
    Alpha(f64),
    /// The fraction is not between 0 and 1.
    #[error("alpha.fraction: must be above 0 and below 1, not {0}")]
    Fraction(f64),
    /// The dimension is odd or less than 2.
    #[error("dimension: must be even and at least 2, not {0}")]
    Dimension(u32),
    /// The weight of self-loops is negative or not finite.
    #[error("self_loops: must be a number from 0, not {0}")]
    SelfLoops(f64),
    /// The number of teams is 0, or its range is empty or holds 0.
    #[error("teams: must be at least 1, and a range must rise, not {0}")]
    Teams(TeamCount),
    /// The power of the singular values is not finite.
    #[error("power: must be finite, not {0}")]
    Power(f64),
    /// The hysteresis is outside of 0 to below 1.
    #[error("hysteresis: must be from 0 to below 1, not {0}")]
    Hysteresis(f64),
    /// The tolerance is not positive and finite.
    #[error("tolerance: must be above 0, not {0}")]
    Tolerance(f64),
    /// The largest K is 0.
    #[error("max_rank: must be at least 1")]
    MaxRank,
    /// A count is 0.
    #[error("{field}: must be at least 1")]
    Count {
        /// The field.
        field: &'static str,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_parameters_are_valid() {
        EmbeddingParams::default().check().unwrap();
        DivisionParams::default().check().unwrap();
        let (embedder, clusterer) = (EmbedderSettings::default(), ClustererSettings::default());
        EmbeddingParams::once(&embedder, clusterer.teams).check().unwrap();
    }

    #[test]
    fn each_wrong_field_has_an_error_of_its_own() {
        type Spoil<P> = (fn(&mut P), &'static str);
        let spoil: [Spoil<EmbeddingParams>; 11] = [
            (|p| p.self_loops = -1.0, "self_loops: "),
            (|p| _ = p.weights.insert(Modality::spatial(), -1.0), "weights.spatial: "),
            (|p| _ = p.reciprocity.insert(Modality::spatial(), 1.5), "reciprocity.spatial: "),
            (|p| p.alpha = Alpha::Value(f64::INFINITY), "alpha: "),
            (|p| p.alpha = Alpha::Fraction { fraction: 1.0 }, "alpha.fraction: "),
            (|p| p.dimension = Dimension::Fixed(3), "dimension: "),
            (|p| p.teams = TeamCount::Between { from: 3, to: 2 }, "teams: "),
            (|p| p.power = f64::NAN, "power: "),
            (|p| p.hysteresis = 1.0, "hysteresis: "),
            (|p| p.tolerance = 0.0, "tolerance: "),
            (|p| p.max_rank = 0, "max_rank: "),
        ];
        for (spoil, start) in spoil {
            let mut params = EmbeddingParams::default();
            spoil(&mut params);
            let error = params.check().unwrap_err().to_string();
            assert!(error.starts_with(start), "{error}");
        }
        let spoil: [Spoil<DivisionParams>; 4] = [
            (|p| p.teams = 0, "teams: "),
            (|p| p.restarts = 0, "restarts: "),
            (|p| p.max_iterations = 0, "max_iterations: "),
            (|p| p.hysteresis = -0.1, "hysteresis: "),
        ];
        for (spoil, start) in spoil {
            let mut params = DivisionParams::default();
            spoil(&mut params);
            let error = params.check().unwrap_err().to_string();
            assert!(error.starts_with(start), "{error}");
        }
    }
}
