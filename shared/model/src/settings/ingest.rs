//! Settings of `ingest`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Settings, SettingsError, check_range};
use crate::id::Modality;
use crate::limits::{MAX_DECLARED_MODALITIES, MAX_GRAPH_EDGES, MAX_ROBOTS, MAX_TEXT_LENGTH};
use crate::schema::{DeclaredModality, Name};

/// Highest rate of frames: above it a frame is shorter than the way over a radio.
pub const MAX_TICK_HZ: f64 = 100.0;

/// Lowest rate of frames: a roster is part of a frame, and who misses it for 5 s takes ingest for dead.
const MIN_TICK_HZ: f64 = 0.5;

/// Most coordinate frames that a fleet may use: positions of different frames are not comparable.
const MAX_FRAMES: usize = 8;

/// How many others a robot of a large fleet is related to at most by a kernel that ends, for each of
/// its `neighbours`. Over a disc such a kernel is 1/7 on average where the Gaussian is about 1/2, so
/// that it takes as many edges for the same sum of weights, and with fewer it divides fleets worse
/// (`cargo run -p muster-solve --example kernels`).
const WENDLAND_PER_NEIGHBOUR: u32 = 4;

/// How many others a robot is related to at most on average, for each of its `neighbours`, where these
/// are related: the relation is made symmetric.
const NEAREST_PER_NEIGHBOUR: u32 = 2;

/// How the weight of a spatial edge falls with the distance d, in units of the width w (multiples of
/// the [`SpatialScale`]) or of the radius R (multiples of the median distance to the nearest neighbour).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SpatialKernel {
    /// exp(−(d/w)²/2)
    Gaussian,
    /// exp(−d/w)
    Exponential,
    /// (1 − d/R)⁴ (1 + 4d/R) up to R and 0 beyond: small motions make small changes, in fleets of any
    /// size.
    WendlandC2,
}

/// What the width of gaussian and exponential is a multiple of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SpatialScale {
    /// The median distance to the nearest neighbour over the fleet: one width for all.
    Fleet,
    /// The geometric mean, over the two robots of an edge, of the distance to the `scale_neighbour`-th
    /// nearest robot: a dense team and a wide one are both measured by their own distances.
    Robots,
}

/// How positions become the spatial graph.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpatialSettings {
    /// How the weight falls with distance.
    pub kernel: SpatialKernel,
    /// What the width is a multiple of. Around 0.7 fits robots, and around 2 the fleet.
    pub scale: SpatialScale,
    /// By which of its nearest robots each is measured, where the scale is that of the robots; null: by
    /// the size of the fleet, from the 2nd in fleets of up to 30 robots to the 8th in those of 300.
    #[schemars(range(min = 1, max = 256))]
    pub scale_neighbour: Option<u32>,
    /// Width w of gaussian and exponential, in multiples of the scale.
    #[schemars(range(min = 0.01, max = 1000))]
    pub width: f64,
    /// Radius R of wendland-c2 in multiples of the median distance to the nearest neighbour.
    #[schemars(range(min = 1, max = 1000))]
    pub cutoff: f64,
    /// Fleets up to this size relate all pairs; larger ones the nearest neighbours.
    #[schemars(range(min = 0, max = 2000))]
    pub all_pairs_up_to: u32,
    /// How many nearest neighbours each robot of a larger fleet is related to. With wendland-c2 it is
    /// related to four times as many at most: where more are within R, its own R ends at the first of
    /// those that are left out.
    #[schemars(range(min = 1, max = 256))]
    pub neighbours: u32,
    /// No edge is longer than this, in metres; null for no limit. With wendland-c2, R is not longer.
    #[schemars(range(min = 1e-6, max = 1e9))]
    pub radius_m: Option<f64>,
}

/// In which unit robots report how well they receive each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LinkUnit {
    /// A quality from 0 to 1.
    Quality,
    /// A delivery ratio from 0 to 1.
    DeliveryRatio,
    /// A received signal strength in dBm, mapped linearly from the floor (0) to the ceiling (1).
    RssiDbm,
}

/// How link reports become the connectivity graph.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ConnectivitySettings {
    /// The unit of all reports.
    pub unit: LinkUnit,
    /// Signal strength in dBm at and below which a link is worth nothing.
    #[schemars(range(min = -200, max = 100))]
    pub rssi_floor_dbm: f64,
    /// Signal strength in dBm at and above which a link is worth 1.
    #[schemars(range(min = -200, max = 100))]
    pub rssi_ceiling_dbm: f64,
}

/// Settings of `ingest`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct IngestSettings {
    /// Frames per second; while nothing changes there is one in each second.
    #[schemars(range(min = MIN_TICK_HZ, max = MAX_TICK_HZ))]
    pub tick_hz: f64,
    /// A robot is stale this many seconds after its last pose, or after its token was lost.
    #[schemars(range(min = 0.1, max = 86_400))]
    pub stale_after_s: f64,
    /// A robot is gone this many seconds after its last sign of life.
    #[schemars(range(min = 0.1, max = 604_800))]
    pub gone_after_s: f64,
    /// Most messages per second that one robot may put on one stream; more are refused.
    #[schemars(range(min = 1, max = 10_000))]
    pub max_rate_hz: f64,
    /// Most robots of the fleet; more are refused.
    #[schemars(range(min = 1, max = MAX_ROBOTS))]
    pub max_robots: u32,
    /// Coordinate frames that poses may name. The first is meant where a pose names none.
    #[schemars(with = "Vec<Name>", length(min = 1, max = MAX_FRAMES))]
    pub frames: Vec<String>,
    /// Modalities that robots may report in addition to spatial, connectivity and hierarchy.
    #[schemars(with = "Vec<DeclaredModality>", length(max = MAX_DECLARED_MODALITIES), extend("uniqueItems" = true))]
    pub modalities: Vec<Modality>,
    /// How positions become the spatial graph.
    pub spatial: SpatialSettings,
    /// How link reports become the connectivity graph.
    pub connectivity: ConnectivitySettings,
}

impl Default for IngestSettings {
    fn default() -> Self {
        Self {
            tick_hz: 10.0,
            stale_after_s: 2.0,
            gone_after_s: 10.0,
            max_rate_hz: 100.0,
            max_robots: 10_000,
            frames: vec!["map".to_owned()],
            modalities: Vec::new(),
            spatial: SpatialSettings {
                kernel: SpatialKernel::Gaussian,
                scale: SpatialScale::Robots,
                scale_neighbour: None,
                width: 0.85,
                cutoff: 9.0,
                all_pairs_up_to: 200,
                neighbours: 16,
                radius_m: None,
            },
            connectivity: ConnectivitySettings {
                unit: LinkUnit::Quality,
                rssi_floor_dbm: -90.0,
                rssi_ceiling_dbm: -40.0,
            },
        }
    }
}

impl SpatialSettings {
    /// How many edges leave a robot of a fleet of more than `all_pairs_up_to` robots at most: each of
    /// them if the kernel ends, on average if the nearest neighbours are related.
    #[must_use]
    pub fn most_related(&self) -> u32 {
        let per_neighbour = match self.kernel {
            SpatialKernel::Gaussian | SpatialKernel::Exponential => NEAREST_PER_NEIGHBOUR,
            SpatialKernel::WendlandC2 => WENDLAND_PER_NEIGHBOUR,
        };
        self.neighbours.saturating_mul(per_neighbour)
    }

    /// Checks every field. The fields in errors begin with `spatial.`.
    ///
    /// # Errors
    /// Names the first field that is wrong.
    pub fn check(&self) -> Result<(), SettingsError> {
        if let Some(neighbour) = self.scale_neighbour {
            check_range("spatial.scale_neighbour", f64::from(neighbour), 1.0..=256.0)?;
        }
        check_range("spatial.width", self.width, 0.01..=1000.0)?;
        check_range("spatial.cutoff", self.cutoff, 1.0..=1000.0)?;
        check_range("spatial.neighbours", f64::from(self.neighbours), 1.0..=256.0)?;
        check_range("spatial.all_pairs_up_to", f64::from(self.all_pairs_up_to), 0.0..=2000.0)?;
        self.radius_m.map_or(Ok(()), |radius| check_range("spatial.radius_m", radius, 1e-6..=1e9))
    }
}

impl ConnectivitySettings {
    /// Checks every field. The fields in errors begin with `connectivity.`.
    ///
    /// # Errors
    /// Names the first field that is wrong.
    pub fn check(&self) -> Result<(), SettingsError> {
        check_range("connectivity.rssi_floor_dbm", self.rssi_floor_dbm, -200.0..=100.0)?;
        check_range("connectivity.rssi_ceiling_dbm", self.rssi_ceiling_dbm, -200.0..=100.0)?;
        if self.rssi_ceiling_dbm - self.rssi_floor_dbm < 1.0 {
            return Err(SettingsError::new(
                "connectivity.rssi_ceiling_dbm",
                "must be at least 1 dB above connectivity.rssi_floor_dbm",
            ));
        }
        Ok(())
    }
}

impl Settings for IngestSettings {
    fn check(&self) -> Result<(), SettingsError> {
        check_range("tick_hz", self.tick_hz, MIN_TICK_HZ..=MAX_TICK_HZ)?;
        check_range("stale_after_s", self.stale_after_s, 0.1..=86_400.0)?;
        check_range("gone_after_s", self.gone_after_s, 0.1..=604_800.0)?;
        if self.gone_after_s <= self.stale_after_s {
            return Err(SettingsError::new(
                "gone_after_s",
                "must be more than stale_after_s, so that a robot is marked before it is gone",
            ));
        }
        check_range("max_rate_hz", self.max_rate_hz, 1.0..=10_000.0)?;
        #[expect(clippy::cast_precision_loss, reason = "the limit is far below 2⁵³")]
        check_range("max_robots", f64::from(self.max_robots), 1.0..=MAX_ROBOTS as f64)?;
        if self.frames.is_empty() || self.frames.len() > MAX_FRAMES {
            return Err(SettingsError::new(
                "frames",
                format!("must name 1 to {MAX_FRAMES} frames"),
            ));
        }
        if self.frames.iter().any(|frame| {
            frame.is_empty() || frame.len() > MAX_TEXT_LENGTH || frame.chars().any(char::is_control)
        }) {
            return Err(SettingsError::new(
                "frames",
                format!("each must have 1 to {MAX_TEXT_LENGTH} bytes and no control characters"),
            ));
        }
        if self.modalities.len() > MAX_DECLARED_MODALITIES {
            return Err(SettingsError::new(
                "modalities",
                format!("may declare at most {MAX_DECLARED_MODALITIES}"),
            ));
        }
        if let Some(built_in) = self.modalities.iter().find(|modality| modality.is_built_in()) {
            return Err(SettingsError::new(
                "modalities",
                format!("{built_in} is built in and needs no declaration"),
            ));
        }
        let mut names = self.modalities.clone();
        names.sort_unstable();
        names.dedup();
        if names.len() != self.modalities.len() {
            return Err(SettingsError::new("modalities", "a modality is declared twice"));
        }
        self.spatial.check()?;
        let edges = u64::from(self.max_robots) * u64::from(self.spatial.most_related());
        if edges > MAX_GRAPH_EDGES {
            let most = MAX_GRAPH_EDGES / u64::from(self.max_robots);
            let most =
                u64::from(self.spatial.neighbours) * most / u64::from(self.spatial.most_related());
            return Err(SettingsError::new(
                "spatial.neighbours",
                format!(
                    "may be at most {most} for max_robots of {} and this kernel: a larger graph fits \
                     no message",
                    self.max_robots
                ),
            ));
        }
        self.connectivity.check()
    }
}
