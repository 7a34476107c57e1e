//! The reports of robots: their binary kinds, their JSON Schema, and how they are read and written.
//!
//! A stream has one line in [`kind`], [`json_schema`] and [`beyond_schema`]; everything else follows
//! from [`Stream`].

use muster_model::id::RobotId;
use muster_model::limits::MAX_ROBOT_PAYLOAD;
use muster_model::observation::{
    CheckedReport, Links, Observation, Pose, Rank, ReadObservation, Relation, Report, Stream,
};
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::{Deserialize, Serialize};

use crate::decode::{DecodeError, from_json};
use crate::envelope::{self, EnvelopeError, Kind};
use crate::key::Key;
use crate::packet::{Format, Outbound, binary_encoding};

/// A report in binary form. The robot is in the content as well as in the key, so that a report on another
/// robot's key is noticed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct FromRobot<R, T> {
    robot: R,
    body: T,
}

/// The binary kind of a stream's reports.
const fn kind(stream: &Stream) -> Kind {
    let (number, name) = match stream {
        Stream::Pose => (1, "Pose"),
        Stream::Links => (2, "Links"),
        Stream::Rank => (3, "Rank"),
        Stream::Relation(_) => (4, "Relation"),
    };
    Kind { number, name, limit_bytes: MAX_ROBOT_PAYLOAD }
}

/// The kind of ranks with skills. Those without have the kind and the bytes that they had before there were skills, so
/// that robots and services of all versions understand each other about them.
const SKILLED_RANK: Kind = Kind { number: 17, name: "SkilledRank", limit_bytes: MAX_ROBOT_PAYLOAD };

/// A rank without skills, as its binary form holds it.
#[derive(Deserialize)]
struct PlainRank {
    superior: Option<RobotId>,
    weight: Option<f64>,
    role: Option<String>,
    stamp: Option<f64>,
    boot: Option<String>,
    seq: Option<u64>,
}

impl From<PlainRank> for Rank {
    fn from(plain: PlainRank) -> Self {
        let PlainRank { superior, weight, role, stamp, boot, seq } = plain;
        Self { superior, weight, role, stamp, boot, seq, skills: None }
    }
}

/// The binary kind of a report.
fn kind_of(report: &Report) -> Kind {
    match report {
        Report::Rank(Rank { skills: Some(_), .. }) => SKILLED_RANK,
        _ => kind(&report.stream()),
    }
}

/// The JSON Schema of a stream's reports.
pub(crate) fn json_schema(stream: &Stream, generator: &mut SchemaGenerator) -> Schema {
    match stream {
        Stream::Pose => Pose::json_schema(generator),
        Stream::Links => Links::json_schema(generator),
        Stream::Rank => Rank::json_schema(generator),
        Stream::Relation(_) => Relation::json_schema(generator),
    }
}

/// What `ingest` refuses beyond the schema of a stream, as a list that goes on.
pub(crate) const fn beyond_schema(stream: &Stream) -> &'static str {
    match stream {
        Stream::Pose => "a frame that the settings of ingest do not name",
        Stream::Links => {
            "a peer that is named twice or is the robot itself, a quality outside of the unit that the \
             settings of ingest name (0 to 1 by default)"
        }
        Stream::Rank => "a superior that is the robot itself, a skill that is named twice",
        Stream::Relation(_) => {
            "edges from another robot, to the robot itself, or named twice, a modality that the \
             settings of ingest do not declare"
        }
    }
}

/// The payload of a packet on a stream.
struct Payload<'a> {
    kind: Kind,
    format: Format,
    bytes: &'a [u8],
    /// The robot inside a binary payload, once it was read.
    robot: Option<RobotId>,
}

impl<'a> Payload<'a> {
    const fn new(stream: &Stream, format: Format, bytes: &'a [u8]) -> Self {
        Self { kind: kind(stream), format, bytes, robot: None }
    }

    /// Reads the report of a stream.
    fn report(&mut self, stream: &Stream) -> Result<Report, DecodeError> {
        if *stream == Stream::Rank && self.format == Format::Binary {
            if envelope::kind_number(self.bytes) != Some(SKILLED_RANK.number) {
                let FromRobot { robot, body } =
                    envelope::decode_as::<FromRobot<_, PlainRank>>(self.kind, self.bytes)?;
                self.robot = Some(robot);
                return Ok(Report::Rank(body.into()));
            }
            self.kind = SKILLED_RANK;
        }
        stream.read(self)
    }
}

impl ReadObservation for Payload<'_> {
    type Error = DecodeError;

    fn read<T: Observation>(&mut self) -> Result<T, DecodeError> {
        match self.format {
            Format::Json => from_json(self.bytes),
            Format::Binary => {
                let FromRobot { robot, body } = envelope::decode_as(self.kind, self.bytes)?;
                self.robot = Some(robot);
                Ok(body)
            }
        }
    }
}

/// Reads and checks a report.
pub(crate) fn decode(
    robot: RobotId,
    stream: &Stream,
    format: Format,
    bytes: &[u8],
) -> Result<CheckedReport, DecodeError> {
    let mut payload = Payload::new(stream, format, bytes);
    let report = payload.report(stream)?;
    if let Some(message) = payload.robot.filter(|inside| *inside != robot) {
        return Err(DecodeError::ReportRobot { key: robot, message });
    }
    Ok(CheckedReport::new(robot, report)?)
}

/// Writes a report in binary form, and returns the name of its kind with it.
pub(crate) fn encode(
    robot: &RobotId,
    report: &Report,
) -> Result<(&'static str, Vec<u8>), EnvelopeError> {
    let kind = kind_of(report);
    Ok((kind.name, envelope::encode_as(kind, &FromRobot { robot, body: report })?))
}

/// Writes a report in binary form without a check, for programs that test what readers refuse.
///
/// # Errors
/// [`EnvelopeError`] if the report is larger than it may be.
pub fn encode_unchecked(robot: &RobotId, report: &Report) -> Result<Outbound, EnvelopeError> {
    let (name, payload) = encode(robot, report)?;
    let key = Key::Stream(robot.clone(), report.stream());
    Ok(Outbound { key, encoding: binary_encoding(name), payload, attachment: None })
}

/// Reads the binary form of a report without a check, for programs that test readers.
///
/// # Errors
/// [`DecodeError`] if the bytes are no report of the stream.
pub fn decode_unchecked(stream: &Stream, bytes: &[u8]) -> Result<(RobotId, Report), DecodeError> {
    let mut payload = Payload::new(stream, Format::Binary, bytes);
    let report = payload.report(stream)?;
    Ok((payload.robot.ok_or(DecodeError::NotBinary)?, report))
}
