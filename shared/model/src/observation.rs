//! What robots report: the streams of a robot, what each carries, and its checks.
//!
//! [`Stream`] names the streams once, for keys, messages, services and clients; [`Report`] is what a
//! robot reports on one of them; [`CheckedReport`] is a report whose content was checked, with the robot
//! that made it. One type serves JSON and bincode. Optional fields are plain `Option`s, which JSON may
//! leave out.

use std::fmt;

use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::id::{Modality, RobotId, SkillId};
use crate::limits::{
    MAX_COORDINATE_M, MAX_LINKS, MAX_RELATION_EDGES, MAX_SKILLS, MAX_TEXT_LENGTH, MAX_WEIGHT,
};
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
    /// Names one run of the robot's software; each run has its own sequence.
    pub boot: Option<String>,
    /// Grows with each message of a stream within one boot.
    pub seq: Option<u64>,
}

/// What one stream of a robot carries.
pub trait Observation: Serialize + DeserializeOwned {
    /// Checks every field by itself.
    ///
    /// # Errors
    /// Names the first field that is wrong.
    fn check(&self) -> Result<(), ObservationError>;

    /// Checks the fields that name robots against the robot that reports.
    ///
    /// # Errors
    /// Names the first field that is wrong.
    fn check_reporter(&self, robot: &RobotId) -> Result<(), ObservationError>;

    /// When and in which order it was made.
    fn provenance(&self) -> Provenance;

    /// The same content, made at another moment or with another number.
    #[must_use]
    fn with_provenance(self, provenance: Provenance) -> Self;
}

/// One stream of a robot. Each is the source of one graph.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Stream {
    /// Poses, for the spatial graph.
    Pose,
    /// Which robots it receives, for the connectivity graph.
    Links,
    /// Its superior, for the hierarchy graph.
    Rank,
    /// Edges of a declared modality.
    Relation(Modality),
}

/// Reads the content of a stream, whichever type it has.
pub trait ReadObservation {
    /// Why the content cannot be read.
    type Error;

    /// Reads the content.
    ///
    /// # Errors
    /// If the content cannot be read.
    fn read<T: Observation>(&mut self) -> Result<T, Self::Error>;
}

impl Stream {
    /// The streams that every robot has. A robot has one more for each declared modality.
    pub const BUILT_IN: [Self; 3] = [Self::Pose, Self::Links, Self::Rank];

    /// The name of the stream in keys and in the JSON Schema.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Pose => "pose",
            Self::Links => "links",
            Self::Rank => "rank",
            Self::Relation(_) => "relation",
        }
    }

    /// The built-in stream of a name.
    #[must_use]
    pub fn built_in(name: &str) -> Option<Self> {
        Self::BUILT_IN.into_iter().find(|stream| stream.name() == name)
    }

    /// The modality of the graph that is made from the stream.
    #[must_use]
    pub fn modality(&self) -> Modality {
        match self {
            Self::Pose => Modality::spatial(),
            Self::Links => Modality::connectivity(),
            Self::Rank => Modality::hierarchy(),
            Self::Relation(modality) => modality.clone(),
        }
    }

    /// What errors about the size of a report name: its list, or the stream where it has none.
    #[must_use]
    pub const fn list_field(&self) -> &'static str {
        match self {
            Self::Pose | Self::Links | Self::Rank => self.name(),
            Self::Relation(_) => "edges",
        }
    }

    /// Reads a report of the stream.
    ///
    /// # Errors
    /// Those of the reader.
    pub fn read<R: ReadObservation>(&self, reader: &mut R) -> Result<Report, R::Error> {
        Ok(match self {
            Self::Pose => Report::Pose(reader.read()?),
            Self::Links => Report::Links(reader.read()?),
            Self::Rank => Report::Rank(reader.read()?),
            Self::Relation(modality) => Report::Relation(modality.clone(), reader.read()?),
        })
    }
}

/// The key of the stream below the robot's.
impl fmt::Display for Stream {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Relation(modality) => write!(formatter, "{}/{modality}", self.name()),
            built_in => formatter.write_str(built_in.name()),
        }
    }
}

/// What a robot reports on one of its streams.
#[derive(Debug, Clone, PartialEq)]
pub enum Report {
    /// Where it is at one moment.
    Pose(Pose),
    /// Which robots it receives, until the next report.
    Links(Links),
    /// Its superior, until the next report.
    Rank(Rank),
    /// Its edges of a declared modality, until the next report.
    Relation(Modality, Relation),
}

/// Evaluates an expression with the content of a report, whichever type it has.
macro_rules! with_content {
    ($report:expr, $content:ident => $value:expr) => {
        match $report {
            Report::Pose($content) => $value,
            Report::Links($content) => $value,
            Report::Rank($content) => $value,
            Report::Relation(_, $content) => $value,
        }
    };
}

impl Report {
    /// The stream of the report.
    #[must_use]
    pub fn stream(&self) -> Stream {
        match self {
            Self::Pose(_) => Stream::Pose,
            Self::Links(_) => Stream::Links,
            Self::Rank(_) => Stream::Rank,
            Self::Relation(modality, _) => Stream::Relation(modality.clone()),
        }
    }

    /// When and in which order it was made.
    #[must_use]
    pub fn provenance(&self) -> Provenance {
        with_content!(self, content => content.provenance())
    }

    /// The same report, made at another moment or with another number.
    #[must_use]
    pub fn with_provenance(self, provenance: Provenance) -> Self {
        match self {
            Self::Pose(content) => Self::Pose(content.with_provenance(provenance)),
            Self::Links(content) => Self::Links(content.with_provenance(provenance)),
            Self::Rank(content) => Self::Rank(content.with_provenance(provenance)),
            Self::Relation(modality, content) => {
                Self::Relation(modality, content.with_provenance(provenance))
            }
        }
    }
}

/// The content alone: the modality of a relation stands in its key.
impl Serialize for Report {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        with_content!(self, content => content.serialize(serializer))
    }
}

impl From<Pose> for Report {
    fn from(pose: Pose) -> Self {
        Self::Pose(pose)
    }
}

impl From<Links> for Report {
    fn from(links: Links) -> Self {
        Self::Links(links)
    }
}

impl From<Rank> for Report {
    fn from(rank: Rank) -> Self {
        Self::Rank(rank)
    }
}

impl From<(Modality, Relation)> for Report {
    fn from((modality, relation): (Modality, Relation)) -> Self {
        Self::Relation(modality, relation)
    }
}

/// A report whose content was checked, and the robot that made it.
#[derive(Debug, Clone, PartialEq)]
pub struct CheckedReport {
    robot: RobotId,
    report: Report,
}

impl CheckedReport {
    /// Checks a report of a robot: every field, that it has only the robot's own relations, and none to
    /// the robot itself. What depends on the settings of a fleet is not checked here: its frames, its
    /// modalities and the unit of links.
    ///
    /// # Errors
    /// Names the first field that is wrong.
    pub fn new(robot: RobotId, report: impl Into<Report>) -> Result<Self, ObservationError> {
        let report = report.into();
        with_content!(&report, content => {
            content.check()?;
            content.check_reporter(&robot)?;
        });
        Ok(Self { robot, report })
    }

    /// The robot.
    #[must_use]
    pub const fn robot(&self) -> &RobotId {
        &self.robot
    }

    /// Its report.
    #[must_use]
    pub const fn report(&self) -> &Report {
        &self.report
    }

    /// The stream of the report.
    #[must_use]
    pub fn stream(&self) -> Stream {
        self.report.stream()
    }

    /// The robot and its report.
    #[must_use]
    pub fn into_parts(self) -> (RobotId, Report) {
        (self.robot, self.report)
    }

    /// The same report, made at another moment or with another number.
    ///
    /// # Errors
    /// Names the field of the provenance that is wrong.
    pub fn with_provenance(self, provenance: Provenance) -> Result<Self, ObservationError> {
        check_provenance(&provenance)?;
        Ok(Self { report: self.report.with_provenance(provenance), ..self })
    }
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

/// A robot that another one receives.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Link {
    /// The robot that is received.
    pub peer: RobotId,
    /// How well, in the unit that the settings of `ingest` name: quality or delivery ratio 0..1, or RSSI in dBm.
    pub quality: f64,
}

/// The robots that a robot receives. The edges run from the peers to the robot that reports.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Links {
    /// All robots that are received now; those left out are no longer received.
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

/// The superior of a robot. The edge runs from the superior to the robot that reports.
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
    /// What the robot can do that not every robot can, each once; nothing if left out.
    // The last field, and absent where there is none: the binary form of a rank without skills is that of every version.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(length(max = MAX_SKILLS))]
    pub skills: Option<Vec<SkillId>>,
}

impl Rank {
    /// A tie to a superior, none at the top; everything else is left out.
    #[must_use]
    pub const fn under(superior: Option<RobotId>) -> Self {
        Self {
            superior,
            weight: None,
            role: None,
            stamp: None,
            boot: None,
            seq: None,
            skills: None,
        }
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

        fn with_provenance(self, provenance: Provenance) -> Self {
            let Provenance { stamp, boot, seq } = provenance;
            Self { stamp, boot, seq, ..self }
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

    fn check_reporter(&self, _: &RobotId) -> Result<(), ObservationError> {
        Ok(())
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

    fn check_reporter(&self, robot: &RobotId) -> Result<(), ObservationError> {
        if self.links.iter().any(|link| link.peer == *robot) {
            return refuse("links.peer", "a robot does not report a link to itself");
        }
        Ok(())
    }

    provenance!();
}

impl Observation for Rank {
    fn check(&self) -> Result<(), ObservationError> {
        check_weight("weight", self.weight.unwrap_or(1.0))?;
        check_text("role", self.role.as_ref())?;
        let skills = self.skills.as_deref().unwrap_or_default();
        if skills.len() > MAX_SKILLS {
            return refuse("skills", format!("may hold at most {MAX_SKILLS} skills"));
        }
        let named_before = |at: &usize| skills[..*at].contains(&skills[*at]);
        if let Some(twice) = (0..skills.len()).find(named_before) {
            return refuse("skills", format!("{} is named twice", skills[twice]));
        }
        check_provenance(&self.provenance())
    }

    fn check_reporter(&self, robot: &RobotId) -> Result<(), ObservationError> {
        if self.superior.as_ref() == Some(robot) {
            return refuse("superior", "a robot is not its own superior; null is the top");
        }
        Ok(())
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

    fn check_reporter(&self, robot: &RobotId) -> Result<(), ObservationError> {
        if let Some((from, ..)) = self.edges.iter().find(|(from, ..)| from != robot) {
            return refuse("edges", format!("the key speaks for {robot}, an edge for {from}"));
        }
        if self.edges.iter().any(|(_, to, _)| to == robot) {
            return refuse("edges", "a robot has no edge to itself");
        }
        Ok(())
    }

    provenance!();
}
