//! Why a packet is refused, and the checks that all messages share.

use muster_model::content::ContentError;
use muster_model::header::{Header, Revision, StageTime};
use muster_model::id::{FleetId, RobotId, ServiceName};
use muster_model::limits::MAX_REVISION;
use muster_model::object::Object;
use muster_model::observation::ObservationError;
use muster_model::time::{Tick, seconds};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::envelope::EnvelopeError;
use crate::key::{Key, KeyError, KeySpace};
use crate::packet::{BINARY, Format, JSON, Packet, format_of, quoted};

/// Why a packet is no message.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// The key is none of the fleet's.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// The key was deleted.
    #[error("nothing is deleted on this key")]
    Deleted,
    /// A liveliness token stands on a key of messages.
    #[error("no liveliness token belongs on this key")]
    Token,
    /// A message stands on a key of liveliness tokens.
    #[error("this key takes liveliness tokens and no messages")]
    OnlyTokens,
    /// The key is only written by services.
    #[error("no service reads this key")]
    NotRead,
    /// There are more bytes than the key may have.
    #[error("{size} bytes are more than the limit of {limit} for this key")]
    TooLarge {
        /// How many bytes there are.
        size: usize,
        /// How many bytes there may be.
        limit: usize,
    },
    /// The encoding is neither JSON nor binary.
    #[error("the encoding {0:?} is unknown; use {JSON} or {BINARY}")]
    Encoding(String),
    /// The key takes no JSON.
    #[error("this key takes binary messages between services, with an encoding of {BINARY}")]
    NotBinary,
    /// The key takes JSON only.
    #[error("this key takes JSON, with an encoding of {JSON}")]
    NotJson,
    /// The payload is not the JSON of the message.
    #[error("this is not the JSON it should be: {0}")]
    Json(#[from] serde_json::Error),
    /// The payload is not the binary form of the message.
    #[error(transparent)]
    Envelope(#[from] EnvelopeError),
    /// The report was put to the key of another robot.
    #[error("the key speaks for {key}, the message for {message}")]
    ReportRobot {
        /// The robot that the key names.
        key: RobotId,
        /// The robot that the message names.
        message: RobotId,
    },
    /// The team was put to the key of another robot.
    #[error("robot: the key speaks to {key}, the message to {message}")]
    TeamRobot {
        /// The robot that the key names.
        key: RobotId,
        /// The robot that the message names.
        message: RobotId,
    },
    /// The report has a wrong field.
    #[error(transparent)]
    Observation(#[from] ObservationError),
    /// The message of a service has a wrong field.
    #[error(transparent)]
    Content(#[from] ContentError),
    /// The key and the content differ in what they name.
    #[error("the key and the content name different {0}")]
    Mismatch(&'static str),
    /// The message is of another fleet than its key.
    #[error("the key speaks for fleet {key}, the message for {message}")]
    Fleet {
        /// The fleet that the key names.
        key: FleetId,
        /// The fleet that the message names.
        message: FleetId,
    },
    /// The term or epoch is out of range.
    #[error("term and epoch must be below {MAX_REVISION}")]
    Revision,
}

pub(crate) fn from_json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, DecodeError> {
    Ok(serde_json::from_slice::<Object<T>>(bytes)?.0)
}

/// The head of a service's message, as JSON writes it. Unknown fields are ignored.
#[derive(Deserialize)]
struct JsonHead {
    fleet: FleetId,
    term: u64,
    epoch: u64,
    data_age_s: Option<f64>,
    stages: Vec<JsonStage>,
}

/// When a service received its input and published its output, in seconds since 1970.
#[derive(Deserialize)]
struct JsonStage {
    stage: ServiceName,
    received: f64,
    published: f64,
}

/// The header of a service's message in JSON. The age of the data counts back from `now`, the moment of
/// arrival.
pub(crate) fn header_from_json(bytes: &[u8], now: Tick) -> Result<Header, DecodeError> {
    let head: JsonHead = serde_json::from_slice(bytes)?;
    let moment = |at: f64| Tick(0).after(seconds(at));
    let stages = head.stages.into_iter().map(|stage| StageTime {
        stage: stage.stage,
        received: moment(stage.received),
        published: moment(stage.published),
    });
    Ok(Header {
        fleet: head.fleet,
        revision: Revision { term: head.term, epoch: head.epoch },
        oldest: head.data_age_s.map(|age| now.before(seconds(age))),
        newest: None,
        stages: stages.collect(),
    })
}

/// The payload of a packet, if the key may have so many bytes.
pub(crate) fn payload<'a>(packet: &'a Packet, key: &Key) -> Result<&'a [u8], DecodeError> {
    let limit = key.payload_limit();
    match &packet.payload {
        Ok(bytes) if bytes.len() <= limit => Ok(bytes),
        Ok(bytes) => Err(DecodeError::TooLarge { size: bytes.len(), limit }),
        Err(size) => Err(DecodeError::TooLarge { size: *size, limit }),
    }
}

/// The form of a packet's payload.
pub(crate) fn format(packet: &Packet) -> Result<Format, DecodeError> {
    format_of(&packet.encoding).ok_or_else(|| DecodeError::Encoding(quoted(&packet.encoding)))
}

/// Checks the head of a message between services against the fleet of its key.
pub(crate) fn check_header(space: &KeySpace, header: &Header) -> Result<(), DecodeError> {
    if header.fleet != *space.fleet() {
        let (key, message) = (space.fleet().clone(), header.fleet.clone());
        return Err(DecodeError::Fleet { key, message });
    }
    if header.revision.term.max(header.revision.epoch) >= MAX_REVISION {
        return Err(DecodeError::Revision);
    }
    Ok(())
}
