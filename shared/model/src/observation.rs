//! What robots say: the four streams, as they stand on the bus.
//!
//! One type serves JSON and bincode. Optional fields are plain `Option`s, which JSON may leave out.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::id::RobotId;
use crate::limits::{MAX_COORDINATE_M, MAX_LINKS, MAX_RELATION_EDGES, MAX_TEXT_LENGTH, MAX_WEIGHT};
use crate::schema::{RelationEdge, Text};

/// Why an observation is refused: the field, and what it should have been.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {problem}")]
pub struct ObservationError {
    /// The field as it stands in JSON.
    pub field: &'static str,
    /// What is wrong and what would be right.
    pub problem: String,
}

fn refuse<T>(field: &'static str, problem: impl Into<String>) -> Result<T, ObservationError> {
    Err(ObservationError { field, problem: problem.into() })
}

/// When and in which order an observation was made, by the robot's own account.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Provenance {
    /// Seconds since the Unix epoch by the robot's clock.
    pub stamp: Option<f64>,
    /// Names one run of the robot's software; the sequence starts anew with each.
    pub boot: Option<String>,
    /// Grows with each message of a stream within one boot.
    pub seq: Option<u64>,
}

/// A message of a robot about itself.
pub trait Observation {
    /// Checks every field.
    ///
    /// # Errors
    /// Names the first field that is wrong.
    fn check(&self) -> Result<(), ObservationError>;

    /// When and in which order it was made.
    fn provenance(&self) -> Provenance;
}

/// Where a robot is: metres east, north and up in a named frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Pose {
    /// Metres east.
    #[schemars(range(min = -MAX_COORDINATE_M, max = MAX_COORDINATE_M))]
    pub x: f64,
    /// Metres north.
    #[schemars(range(min = -MAX_COORDINATE_M, max = MAX_COORDINATE_M))]
    pub y: f64,
    /// Metres up; 0 if left out.
    #[schemars(range(min = -MAX_COORDINATE_M, max = MAX_COORDINATE_M))]
    pub z: Option<f64>,
    /// Radians, counter-clockwise from east.
    pub heading: Option<f64>,
    /// The coordinate frame; the first one that `ingest` knows if left out.
    #[schemars(with = "Option<Text>")]
    pub frame: Option<String>,
    /// Seconds since the Unix epoch by the robot's clock.
    #[schemars(range(min = 0))]
    pub stamp: Option<f64>,
    /// Names one run of the robot's software.
    #[schemars(with = "Option<Text>")]
    pub boot: Option<String>,
    /// Grows with each pose within one boot.
    #[schemars(range(max = u64::MAX))]
    pub seq: Option<u64>,
}

impl Pose {
    /// A pose on the ground: metres east and north; everything else is left out.
    #[must_use]
    pub const fn at(x: f64, y: f64) -> Self {
        Self { x, y, z: None, heading: None, frame: None, stamp: None, boot: None, seq: None }
    }
}

/// One robot that another one hears.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Link {
    /// The robot that is heard.
    pub peer: RobotId,
    /// How well, in the unit that `ingest` was told: quality or delivery ratio 0..1, or RSSI in dBm.
    pub quality: f64,
}

/// Whom a robot hears. The edges run from the peers to the robot that reports.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Links {
    /// All robots that are heard now; those left out are not heard any more.
    #[serde(deserialize_with = "crate::object::list")]
    #[schemars(with = "Vec<Link>", length(max = MAX_LINKS))]
    pub links: Vec<Link>,
    /// Seconds since the Unix epoch by the robot's clock.
    #[schemars(range(min = 0))]
    pub stamp: Option<f64>,
    /// Names one run of the robot's software.
    #[schemars(with = "Option<Text>")]
    pub boot: Option<String>,
    /// Grows with each report within one boot.
    #[schemars(range(max = u64::MAX))]
    pub seq: Option<u64>,
}

/// Whom a robot answers to. The edge runs from the superior to the robot that reports.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Rank {
    /// The robot's superior; null for the top.
    pub superior: Option<RobotId>,
    /// Strength of the tie; 1 if left out.
    #[schemars(range(min = 0, max = MAX_WEIGHT))]
    pub weight: Option<f64>,
    /// What the robot is within its unit.
    #[schemars(with = "Option<Text>")]
    pub role: Option<String>,
    /// Seconds since the Unix epoch by the robot's clock.
    #[schemars(range(min = 0))]
    pub stamp: Option<f64>,
    /// Names one run of the robot's software.
    #[schemars(with = "Option<Text>")]
    pub boot: Option<String>,
    /// Grows with each report within one boot.
    #[schemars(range(max = u64::MAX))]
    pub seq: Option<u64>,
}

impl Rank {
    /// A tie to a superior, or to nobody at the top; everything else is left out.
    #[must_use]
    pub const fn under(superior: Option<RobotId>) -> Self {
        Self { superior, weight: None, role: None, stamp: None, boot: None, seq: None }
    }
}

/// The edges of one further modality that leave the robot that reports.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Relation {
    /// `[from, to, weight]`; `from` is the robot that reports.
    #[schemars(with = "Vec<RelationEdge>", length(max = MAX_RELATION_EDGES))]
    pub edges: Vec<(RobotId, RobotId, f64)>,
    /// Seconds since the Unix epoch by the robot's clock.
    #[schemars(range(min = 0))]
    pub stamp: Option<f64>,
    /// Names one run of the robot's software.
    #[schemars(with = "Option<Text>")]
    pub boot: Option<String>,
    /// Grows with each report within one boot.
    #[schemars(range(max = u64::MAX))]
    pub seq: Option<u64>,
}

fn check_coordinate(field: &'static str, value: f64) -> Result<(), ObservationError> {
    if value.abs() <= MAX_COORDINATE_M {
        Ok(())
    } else {
        refuse(field, format!("must be a finite number of metres within ±{MAX_COORDINATE_M:e}"))
    }
}

fn check_text(field: &'static str, text: Option<&String>) -> Result<(), ObservationError> {
    match text {
        Some(text) if text.len() > MAX_TEXT_LENGTH => {
            refuse(field, format!("may have at most {MAX_TEXT_LENGTH} bytes"))
        }
        Some(text) if text.chars().any(char::is_control) => {
            refuse(field, "may hold no control characters")
        }
        _ => Ok(()),
    }
}

fn check_provenance(provenance: &Provenance) -> Result<(), ObservationError> {
    if provenance.stamp.is_some_and(|stamp| !stamp.is_finite() || stamp < 0.0) {
        return refuse("stamp", "must be finite seconds since the Unix epoch");
    }
    check_text("boot", provenance.boot.as_ref())
}

fn check_weight(field: &'static str, weight: f64) -> Result<(), ObservationError> {
    if (0.0..=MAX_WEIGHT).contains(&weight) {
        Ok(())
    } else {
        refuse(field, format!("must be a finite number from 0 to {MAX_WEIGHT:e}"))
    }
}

macro_rules! provenance {
    () => {
        fn provenance(&self) -> Provenance {
            Provenance { stamp: self.stamp, boot: self.boot.clone(), seq: self.seq }
        }
    };
}

impl Observation for Pose {
    fn check(&self) -> Result<(), ObservationError> {
        check_coordinate("x", self.x)?;
        check_coordinate("y", self.y)?;
        check_coordinate("z", self.z.unwrap_or(0.0))?;
        if self.heading.is_some_and(|heading| !heading.is_finite()) {
            return refuse("heading", "must be a finite number of radians");
        }
        check_text("frame", self.frame.as_ref())?;
        check_provenance(&self.provenance())
    }

    provenance!();
}

impl Observation for Links {
    fn check(&self) -> Result<(), ObservationError> {
        if self.links.len() > MAX_LINKS {
            return refuse("links", format!("may hold at most {MAX_LINKS} links"));
        }
        if self.links.iter().any(|link| !link.quality.is_finite()) {
            return refuse("links.quality", "must be a finite number");
        }
        let mut peers: Vec<_> = self.links.iter().map(|link| &link.peer).collect();
        peers.sort_unstable();
        if let Some(pair) = peers.windows(2).find(|pair| pair[0] == pair[1]) {
            return refuse("links.peer", format!("{} is named twice", pair[0]));
        }
        check_provenance(&self.provenance())
    }

    provenance!();
}

impl Observation for Rank {
    fn check(&self) -> Result<(), ObservationError> {
        check_weight("weight", self.weight.unwrap_or(1.0))?;
        check_text("role", self.role.as_ref())?;
        check_provenance(&self.provenance())
    }

    provenance!();
}

impl Observation for Relation {
    fn check(&self) -> Result<(), ObservationError> {
        if self.edges.len() > MAX_RELATION_EDGES {
            return refuse("edges", format!("may hold at most {MAX_RELATION_EDGES} edges"));
        }
        for (_, _, weight) in &self.edges {
            check_weight("edges", *weight)?;
        }
        let mut ends: Vec<_> = self.edges.iter().map(|(from, to, _)| (from, to)).collect();
        ends.sort_unstable();
        if let Some(pair) = ends.windows(2).find(|pair| pair[0] == pair[1]) {
            return refuse("edges", format!("{} to {} is named twice", pair[0].0, pair[0].1));
        }
        check_provenance(&self.provenance())
    }

    provenance!();
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(json: &str) -> Result<Pose, String> {
        let pose: Pose = serde_json::from_str(json).map_err(|error| error.to_string())?;
        pose.check().map_err(|error| error.to_string())?;
        Ok(pose)
    }

    #[test]
    fn a_pose_needs_only_x_and_y() {
        assert!(pose(r#"{"x":1.0,"y":2}"#).is_ok());
        assert!(pose(r#"{"x":1.0}"#).is_err());
    }

    #[test]
    fn unknown_keys_and_absurd_values_are_refused_by_name() {
        assert!(pose(r#"{"x":1.0,"y":2,"speed":3}"#).unwrap_err().contains("speed"));
        assert!(pose(r#"{"x":1e300,"y":2}"#).unwrap_err().contains("x:"));
        assert!(pose(r#"{"x":1,"y":2,"stamp":-1}"#).unwrap_err().contains("stamp"));
        let long = format!(r#"{{"x":1,"y":2,"frame":"{}"}}"#, "m".repeat(65));
        assert!(pose(&long).unwrap_err().contains("frame"));
        let nan = Pose { x: f64::NAN, ..pose(r#"{"x":1,"y":2}"#).unwrap() };
        assert_eq!(nan.check().unwrap_err().field, "x");
    }

    #[test]
    fn a_link_in_json_is_an_object() {
        let by_position = r#"{"links":[["a",1.0]]}"#;
        assert!(
            serde_json::from_str::<Links>(by_position).unwrap_err().to_string().contains("object")
        );
    }

    #[test]
    fn a_peer_named_twice_is_refused() {
        let links: Links = serde_json::from_str(
            r#"{"links":[{"peer":"a","quality":1},{"peer":"a","quality":0.5}]}"#,
        )
        .unwrap();
        assert_eq!(links.check().unwrap_err().field, "links.peer");
    }
}
