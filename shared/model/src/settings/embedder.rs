//! Settings of `embedder`.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{Settings, SettingsError, check_range};
use crate::id::Modality;
use crate::schema::Share;

/// How far the weights of the modalities may sum from 1: rounding of a few decimal fractions.
pub const WEIGHT_SUM_TOLERANCE: f64 = 1e-9;

/// Largest dimension, asked for or chosen: beyond it k-means drowns in noise. An embedding of 30,000
/// robots, whose similarity fits few machines, still fits a message with it.
pub const MAX_DIMENSION: u32 = 256;

/// Largest weight of self-loops: beyond the weight of all other edges, nothing is left to be divided by.
pub const MAX_SELF_LOOPS: f64 = 4.0;

/// The decay of longer paths.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, deny_unknown_fields, expecting = "must be a number, or {\"fraction\": number}")]
pub enum Alpha {
    /// α itself; a frame in which α ρ ≥ 1 is refused.
    Value(#[schemars(range(min = 1e-12, max = 1e12))] f64),
    /// α as a fraction of 1/ρ.
    Fraction {
        /// Between 0 and 1.
        #[schemars(range(min = 1e-6, max = 0.999_999))]
        fraction: f64,
    },
}

/// Length D = 2K of the vectors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dimension {
    /// K by the last large ratio of neighbouring singular values, from 2 to the number of teams; more
    /// where a robot with relations would not be seen otherwise.
    Auto,
    /// D itself: even, at least 2.
    Fixed(u32),
}

impl Serialize for Dimension {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Auto => serializer.serialize_str("auto"),
            Self::Fixed(dimension) => serializer.serialize_u32(*dimension),
        }
    }
}

impl<'de> Deserialize<'de> for Dimension {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged, expecting = "must be \"auto\" or an even number from 2")]
        enum Form {
            Word(String),
            Number(u32),
        }
        match Form::deserialize(deserializer)? {
            Form::Word(word) if word == "auto" => Ok(Self::Auto),
            Form::Word(_) => Err(D::Error::custom("must be \"auto\" or an even number from 2")),
            Form::Number(dimension) => Ok(Self::Fixed(dimension)),
        }
    }
}

impl JsonSchema for Dimension {
    fn schema_name() -> Cow<'static, str> {
        "Dimension".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "Length D = 2K of the vectors; \"auto\" chooses it by the fleet.",
            "anyOf": [
                { "const": "auto" },
                { "type": "integer", "minimum": 2, "maximum": MAX_DIMENSION, "multipleOf": 2 },
            ],
        })
    }
}

/// How each graph is scaled before its weight applies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Normalization {
    /// As it is, as in the paper.
    None,
    /// By its largest singular value, so that weights mean the same for every modality.
    Spectral,
    /// Each edge by the roots of the degrees of its ends, D_out^-½ A D_in^-½: robots with many edges count no
    /// more than those with few, and the largest singular value is 1.
    Degree,
}

/// Modalities that keep their whole weight, whatever the others say.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Trusted {
    /// Every modality.
    All,
    /// These.
    Only(BTreeSet<Modality>),
}

impl Trusted {
    /// Whether a modality keeps its whole weight.
    #[must_use]
    pub fn contains(&self, modality: &Modality) -> bool {
        match self {
            Self::All => true,
            Self::Only(modalities) => modalities.contains(modality),
        }
    }
}

impl Default for Trusted {
    /// None.
    fn default() -> Self {
        Self::Only(BTreeSet::new())
    }
}

impl Serialize for Trusted {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::All => serializer.serialize_str("all"),
            Self::Only(modalities) => modalities.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Trusted {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        const EXPECTED: &str = "must be \"all\" or a list of modalities";
        #[derive(Deserialize)]
        #[serde(untagged, expecting = "must be \"all\" or a list of modalities")]
        enum Form {
            Word(String),
            List(BTreeSet<Modality>),
        }
        match Form::deserialize(deserializer)? {
            Form::Word(word) if word == "all" => Ok(Self::All),
            Form::Word(_) => Err(D::Error::custom(EXPECTED)),
            Form::List(modalities) => Ok(Self::Only(modalities)),
        }
    }
}

impl JsonSchema for Trusted {
    fn schema_name() -> Cow<'static, str> {
        "Trusted".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let modality = generator.subschema_for::<Modality>();
        json_schema!({
            "description": "Modalities that keep their whole weight, whatever the others say; \"all\" for every one.",
            "anyOf": [
                { "const": "all" },
                { "type": "array", "items": modality, "uniqueItems": true },
            ],
        })
    }
}

/// How the singular vectors are scaled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SingularValueScaling {
    /// Not at all, as in the paper.
    None,
    /// By the square root of their singular values.
    SqrtSigma,
    /// Divided by the square root of their singular values: small groups, such as a leader alone, count more.
    InverseSqrtSigma,
}

impl SingularValueScaling {
    /// The power of its singular value that each singular vector is multiplied by.
    #[must_use]
    pub fn power(self) -> f64 {
        match self {
            Self::None => 0.0,
            Self::SqrtSigma => 0.5,
            Self::InverseSqrtSigma => -0.5,
        }
    }
}

/// How the rows are scaled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RowScaling {
    /// Not at all, as in the paper.
    None,
    /// To length 1; rows of zeros stay.
    Unit,
}

/// Settings of `embedder`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EmbedderSettings {
    /// Weight of each modality; they sum to 1, and one that is not named has none. Empty: spatial 0.35,
    /// connectivity 0.05, hierarchy 0.6, and each declared modality 1/3, less where a modality relates
    /// less than half of the robots, divided by the sum of those that the fleet has.
    #[schemars(with = "BTreeMap<Modality, Share>")]
    pub weights: BTreeMap<Modality, f64>,
    /// By which share of its weight, from 0 to 1, each edge of a modality also leads back: A + r Aᵀ. A
    /// modality that is not named has none.
    #[schemars(with = "BTreeMap<Modality, Share>")]
    pub reciprocity: BTreeMap<Modality, f64>,
    /// How each graph is scaled before its weight applies.
    pub normalize: Normalization,
    /// Weight of an edge from each related robot to itself in the fused graph. Without one, the similarity of
    /// a small or bipartite fleet tells leaders from followers rather than team from team.
    #[schemars(range(min = 0, max = MAX_SELF_LOOPS))]
    pub self_loops: f64,
    /// Modalities that keep their whole weight. Any other counts less, down to not at all, where its edges
    /// join robots that are far apart in all other modalities; it takes at least three to tell.
    pub trusted: Trusted,
    /// The decay of longer paths.
    pub alpha: Alpha,
    /// Length of the vectors.
    pub dimension: Dimension,
    /// How the singular vectors are scaled.
    pub scale: SingularValueScaling,
    /// How the rows are scaled.
    pub rows: RowScaling,
    /// How far, as a fraction of itself, the norm of a modality and α ρ may drift before scale and decay
    /// are chosen again; 0: in every frame.
    #[schemars(range(min = 0, max = 0.5))]
    pub hysteresis: f64,
    /// Largest residual of the embedding of a fleet that moves.
    #[schemars(range(min = 1e-14, max = 1))]
    pub residual_tolerance: f64,
    /// Largest residual of the embedding of a fleet in which nothing has changed for a second; scales and
    /// decay are then those of its very graphs.
    #[schemars(range(min = 1e-14, max = 1))]
    pub idle_tolerance: f64,
}

impl EmbedderSettings {
    /// The method as the paper prints it (its equations 1 to 5): the graphs as they are with equal weights, no
    /// self-loops, the singular vectors as they come.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            reciprocity: BTreeMap::new(),
            normalize: Normalization::None,
            self_loops: 0.0,
            trusted: Trusted::All,
            alpha: Alpha::Fraction { fraction: 0.5 },
            scale: SingularValueScaling::None,
            rows: RowScaling::None,
            ..Self::default()
        }
    }
}

impl Default for EmbedderSettings {
    fn default() -> Self {
        Self {
            weights: BTreeMap::new(),
            // With edges that lead only down, robots without subordinates have empty rows in S, so that half
            // of their vector is zero.
            reciprocity: BTreeMap::from([(Modality::hierarchy(), 0.5)]),
            normalize: Normalization::Degree,
            self_loops: 0.5,
            trusted: Trusted::default(),
            alpha: Alpha::Fraction { fraction: 0.6 },
            dimension: Dimension::Auto,
            scale: SingularValueScaling::None,
            rows: RowScaling::Unit,
            hysteresis: 0.1,
            residual_tolerance: 1e-6,
            idle_tolerance: 1e-10,
        }
    }
}

/// A modality that relates this share of the robots has its whole default weight: half, so that the weight
/// stays the same while robots of a fleet that reports everything join and leave.
pub const WHOLE_FROM: f64 = 0.5;

/// The weight of a modality where none is set, before all are divided by their sum. Hierarchy counts most;
/// connectivity counts least, since robots also receive robots of other teams. The values won over the kinds
/// of fleets that defaults are chosen on. A declared modality gets the average of the three.
///
/// `related` is the share of the robots that have an edge of it, from 0 to 1. A modality that relates
/// fewer than half counts less in proportion: graphs are scaled by their norm, so that the first two
/// robots that report a superior would outweigh the positions of all others. A modality without an edge keeps
/// its whole weight, which has no effect.
#[must_use]
pub fn default_weight(modality: &Modality, related: f64) -> f64 {
    let built_in = [
        (Modality::spatial(), 0.35),
        (Modality::connectivity(), 0.05),
        (Modality::hierarchy(), 0.6),
    ];
    let known = built_in.iter().find(|(name, _)| name == modality);
    known.map_or(1.0 / 3.0, |(_, weight)| *weight) * coverage(related)
}

/// The share of its default weight that a modality has which relates a share of the robots, both from 0 to 1.
#[must_use]
pub fn coverage(related: f64) -> f64 {
    if related > 0.0 { (related / WHOLE_FROM).min(1.0) } else { 1.0 }
}

/// Checks that reciprocities are shares.
///
/// # Errors
/// Names the one that is wrong, as `reciprocity.{modality}`.
pub fn check_reciprocity(reciprocity: &BTreeMap<Modality, f64>) -> Result<(), SettingsError> {
    reciprocity.iter().try_for_each(|(modality, share)| {
        check_range(&format!("reciprocity.{modality}"), *share, 0.0..=1.0)
    })
}

/// Checks that weights are not negative and sum to 1.
///
/// # Errors
/// Names `weights` or the weight that is wrong.
pub fn check_weights(weights: &BTreeMap<Modality, f64>) -> Result<(), SettingsError> {
    for (modality, weight) in weights {
        check_range(&format!("weights.{modality}"), *weight, 0.0..=1.0)?;
    }
    let sum: f64 = weights.values().sum();
    if !weights.is_empty() && (sum - 1.0).abs() > WEIGHT_SUM_TOLERANCE {
        return Err(SettingsError::new("weights", format!("must sum to 1, not to {sum}")));
    }
    Ok(())
}

impl Settings for EmbedderSettings {
    fn check(&self) -> Result<(), SettingsError> {
        check_weights(&self.weights)?;
        check_reciprocity(&self.reciprocity)?;
        match self.alpha {
            Alpha::Value(alpha) => check_range("alpha", alpha, 1e-12..=1e12)?,
            Alpha::Fraction { fraction } => {
                check_range("alpha.fraction", fraction, 1e-6..=0.999_999)?;
            }
        }
        if let Dimension::Fixed(dimension) = self.dimension
            && (dimension % 2 != 0 || !(2..=MAX_DIMENSION).contains(&dimension))
        {
            return Err(SettingsError::new(
                "dimension",
                format!("must be \"auto\" or an even number from 2 to {MAX_DIMENSION}"),
            ));
        }
        check_range("self_loops", self.self_loops, 0.0..=MAX_SELF_LOOPS)?;
        check_range("hysteresis", self.hysteresis, 0.0..=0.5)?;
        check_range("residual_tolerance", self.residual_tolerance, 1e-14..=1.0)?;
        check_range("idle_tolerance", self.idle_tolerance, 1e-14..=1.0)
    }
}
