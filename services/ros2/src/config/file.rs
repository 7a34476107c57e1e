//! The file, as it is written.

use std::collections::BTreeMap;

use muster_model::id::RobotId;
use muster_ros::Dialect;
use serde::{Deserialize, Serialize};

/// The file, as it is written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct File {
    /// How ROS comes to the bus: `rmw_zenoh`, or `ros2dds` for `zenoh-bridge-ros2dds`.
    pub dialect: DialectName,
    /// The domains, `ROS_DOMAIN_ID`; `ros2dds` knows none.
    pub domains: Vec<u32>,
    /// Whether keys are written with the hashes of types; not for readers of Humble, which knows none.
    pub type_hashes: bool,
    /// The namespace of the bridge with `ros2dds`, if it has one.
    pub namespace: Option<String>,
    /// Routers of ROS, if they are others than those of the fleet.
    pub connect: Vec<String>,
    /// How often the newest of each robot is put, per second.
    pub rate_hz: f64,
    /// The frame of ROS that Muster's coordinates are in.
    pub world: String,
    /// The name of that frame in poses; the first one that `ingest` knows if left out.
    pub frame: Option<String>,
    /// Where transforms come from.
    pub frames: FramesFile,
    /// Topics with poses.
    pub pose: Vec<PoseFile>,
    /// Topics with links.
    pub links: Vec<LinksFile>,
    /// Topics with superiors.
    pub rank: Vec<RankFile>,
    /// Superiors by robot that never change; an empty text for the top.
    pub ranks: BTreeMap<RobotId, String>,
    /// What is written.
    pub publish: PublishFile,
}

/// The name of a dialect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum DialectName {
    /// Every program of ROS is on the bus itself.
    #[serde(rename = "rmw_zenoh")]
    RmwZenoh,
    /// A bridge forwards the topics of DDS.
    #[serde(rename = "ros2dds")]
    Ros2Dds,
}

impl From<DialectName> for Dialect {
    fn from(name: DialectName) -> Self {
        match name {
            DialectName::RmwZenoh => Self::RmwZenoh,
            DialectName::Ros2Dds => Self::Ros2Dds,
        }
    }
}

/// Where transforms come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FramesFile {
    /// The topic of transforms: `/{robot}/tf` where frames have no prefix, or one `/tf` of all robots.
    pub tf: String,
    /// The topic of those that never change.
    pub tf_static: String,
    /// What stands before the frames of a robot where all robots share a topic.
    pub prefix: String,
    /// How old a transform that changes may be, in seconds.
    pub max_age_s: f64,
}

/// A topic with poses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseFile {
    /// The topic, with `{robot}` for the robot.
    pub topic: String,
    /// The type of its messages.
    #[serde(rename = "type")]
    pub type_name: String,
    /// The definition of a type that is not built in.
    pub definition: Option<String>,
    /// The frame of the poses, instead of the one in the head of each message.
    pub frame: Option<String>,
    /// Which way the axes point.
    #[serde(default)]
    pub axes: Axes,
    /// Where metres are counted from, for `NavSatFix`.
    pub datum: Option<DatumFile>,
    /// Where the numbers stand in a type that is not built in.
    pub fields: Option<PoseFields>,
}

/// Which way axes point.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Axes {
    /// East, north and up: what ROS has (REP-103).
    #[default]
    EastNorthUp,
    /// North, east and down: what PX4 has. Headings are clockwise from north.
    NorthEastDown,
}

/// A place on the earth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatumFile {
    /// Degrees north.
    pub latitude: f64,
    /// Degrees east.
    pub longitude: f64,
    /// Metres above the ellipsoid.
    #[serde(default)]
    pub altitude: f64,
}

/// Where the numbers of a pose stand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseFields {
    /// The first coordinate in metres.
    pub x: String,
    /// The second one.
    pub y: String,
    /// The third one; 0 if left out.
    pub z: Option<String>,
    /// The heading in radians; none if left out.
    pub heading: Option<String>,
}

/// A topic with links.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinksFile {
    /// The topic, with `{robot}` for the robot that receives.
    pub topic: String,
    /// The type of its messages.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Its definition, if it is not built in.
    pub definition: Option<String>,
    /// The field with the list of links.
    pub list: String,
    /// The field of each with the robot that is received.
    pub peer: String,
    /// The field of each with how well it is received.
    pub quality: String,
    /// What unit that has.
    #[serde(default)]
    pub unit: Unit,
}

/// The unit of links; it must be the one that `ingest` is set to.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// From 0 to 1.
    #[default]
    Quality,
    /// Received signal strength.
    Dbm,
}

/// A topic with superiors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RankFile {
    /// The topic, with `{robot}` for the robot.
    pub topic: String,
    /// The type of its messages.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Its definition, if it is not built in.
    pub definition: Option<String>,
    /// The field with the superior; an empty text for the top.
    pub superior: String,
}

/// What is written.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PublishFile {
    /// The division as JSON, in `std_msgs/String`.
    pub teams: Option<String>,
    /// The division in `muster_msgs/Teams`, for those who have built `deploy/ros2/muster_msgs`.
    pub typed_teams: Option<String>,
    /// The team of each robot as JSON, in `std_msgs/String`.
    pub team: Option<String>,
    /// The quality of the teams, in `diagnostic_msgs/DiagnosticArray`.
    pub diagnostics: Option<String>,
    /// Where the teams are, in `visualization_msgs/MarkerArray`.
    pub markers: Option<String>,
}

impl Default for File {
    fn default() -> Self {
        Self {
            dialect: DialectName::RmwZenoh,
            domains: vec![0],
            type_hashes: true,
            namespace: None,
            connect: Vec::new(),
            rate_hz: 10.0,
            world: "map".to_owned(),
            frame: None,
            frames: FramesFile::default(),
            pose: vec![PoseFile {
                topic: "/{robot}/odom".to_owned(),
                type_name: "nav_msgs/msg/Odometry".to_owned(),
                definition: None,
                frame: None,
                axes: Axes::default(),
                datum: None,
                fields: None,
            }],
            links: Vec::new(),
            rank: Vec::new(),
            ranks: BTreeMap::new(),
            publish: PublishFile::default(),
        }
    }
}

impl Default for FramesFile {
    fn default() -> Self {
        Self {
            tf: "/{robot}/tf".to_owned(),
            tf_static: "/{robot}/tf_static".to_owned(),
            prefix: "{robot}/".to_owned(),
            max_age_s: 1.0,
        }
    }
}

impl Default for PublishFile {
    fn default() -> Self {
        Self {
            teams: Some("/muster/teams".to_owned()),
            typed_teams: None,
            team: Some("/{robot}/team".to_owned()),
            diagnostics: Some("/diagnostics".to_owned()),
            markers: Some("/muster/markers".to_owned()),
        }
    }
}
