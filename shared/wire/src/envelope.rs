//! The binary form of a message: magic byte, schema version, kind, and the content in bincode.
//!
//! bincode is used in this module and nowhere else, so that another codec would be one file. Its
//! standard configuration (little-endian, variable-length integers) is bounded by the limit of the
//! kind, and what it leaves unread is refused.

use std::collections::BTreeMap;

use bincode::config::{Configuration, Limit};
use bincode::error::DecodeError;
use muster_model::alert::Alerts;
use muster_model::audit::Audit;
use muster_model::command::CommandOutcome;
use muster_model::embedding::Embedding;
use muster_model::event::Event;
use muster_model::graph::GraphDelta;
use muster_model::header::Header;
use muster_model::id::ServiceName;
use muster_model::role::LeaseRenewal;
use muster_model::roster::Roster;
use muster_model::teams::{RobotTeam, Teams};
use muster_model::time::Tick;
use muster_model::wish::WishList;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// First byte of every binary message: no text and no JSON begins with it.
pub const MAGIC: u8 = 0xB7;

/// Version of the schema of all kinds. Any change of a type is a new version.
pub const VERSION: u8 = 1;

/// Magic byte, version and kind.
const HEAD: usize = 3;

/// Largest message between services in bytes: a graph of 100,000 robots with 30 edges each.
pub const MAX_SERVICE_PAYLOAD: usize = 64 * 1024 * 1024;

/// Largest event, settings, status or robot's team in bytes: some names, numbers and one
/// reason. 256 members with the longest ids take a third of it.
pub const MAX_SMALL_PAYLOAD: usize = 64 * 1024;

/// Largest frame of a recording in bytes: a few of the largest messages, which one fetch may bring.
pub const MAX_FRAME: usize = 4 * MAX_SERVICE_PAYLOAD;

/// Why bytes are not the message that they should be.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum EnvelopeError {
    /// There are more bytes than the kind may have.
    #[error("{size} bytes are more than the limit of {limit}")]
    TooLarge {
        /// How many there are.
        size: usize,
        /// How many there may be.
        limit: usize,
    },
    /// There are not even a head's bytes, or the first is not the magic byte.
    #[error("this is no binary message of Muster: it must begin with the byte 0x{MAGIC:02X}")]
    NotMuster,
    /// The schema version is another one.
    #[error("schema version {0} is not understood; this program speaks version {VERSION}")]
    Version(u8),
    /// The message is of another kind than its key demands.
    #[error("the message is of kind {got}, but its key demands kind {expected}")]
    Kind {
        /// The kind that it has.
        got: u8,
        /// The kind that it must have.
        expected: u8,
    },
    /// The content does not decode.
    #[error("the content does not decode: {0}")]
    Content(String),
    /// Bytes follow the content.
    #[error("{0} bytes follow the content")]
    Trailing(usize),
    /// The content cannot be encoded.
    #[error("the content does not encode: {0}")]
    Encode(String),
}

/// A kind of binary message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Kind {
    /// Its number; never given twice. Robots' reports have 1 to 4, and 17.
    pub number: u8,
    /// Its name in the schema of the encoding.
    pub name: &'static str,
    /// Most bytes of a message.
    pub limit_bytes: usize,
}

/// A content that has a binary form.
pub trait BinaryMessage: Serialize + DeserializeOwned {
    /// The kind of its messages.
    const KIND: Kind;
}

/// Settings as they are announced to the other services.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AnnouncedSettings {
    /// The head of the message; its revision is that of the service's last output.
    pub header: Header,
    /// Whose settings.
    pub service: ServiceName,
    /// The settings as JSON text.
    pub settings: String,
    /// When operators have changed them, by the path of each field. Of two changes of a field the later one holds.
    pub changed: BTreeMap<String, Tick>,
}

macro_rules! kinds {
    ($($number:literal $type:ty, $name:literal, $limit_bytes:expr;)*) => {
        $(impl BinaryMessage for $type {
            const KIND: Kind = Kind { number: $number, name: $name, limit_bytes: $limit_bytes };
        })*
    };
}

kinds! {
    5 GraphDelta, "GraphDelta", MAX_SERVICE_PAYLOAD;
    6 Roster, "Roster", MAX_SERVICE_PAYLOAD;
    7 Embedding, "Embedding", MAX_SERVICE_PAYLOAD;
    8 Teams, "Teams", MAX_SERVICE_PAYLOAD;
    9 RobotTeam, "RobotTeam", MAX_SMALL_PAYLOAD;
    10 Audit, "Audit", MAX_SERVICE_PAYLOAD;
    11 Event, "Event", MAX_SMALL_PAYLOAD;
    12 AnnouncedSettings, "Settings", MAX_SMALL_PAYLOAD;
    13 LeaseRenewal, "Claim", MAX_SMALL_PAYLOAD;
    14 WishList, "Wishes", MAX_SERVICE_PAYLOAD;
    16 Alerts, "Alerts", MAX_SERVICE_PAYLOAD;
    18 CommandOutcome, "CommandOutcome", MAX_SMALL_PAYLOAD;
}

/// Writes a message.
///
/// # Errors
/// [`EnvelopeError::TooLarge`] past the limit of the kind, [`EnvelopeError::Encode`] if bincode
/// refuses the content.
pub fn encode<T: BinaryMessage>(content: &T) -> Result<Vec<u8>, EnvelopeError> {
    encode_as(T::KIND, content)
}

/// Writes a message of a kind.
///
/// # Errors
/// As [`encode`].
pub(crate) fn encode_as<T: Serialize>(kind: Kind, content: &T) -> Result<Vec<u8>, EnvelopeError> {
    let mut bytes = vec![MAGIC, VERSION, kind.number];
    bincode::serde::encode_into_std_write(content, &mut bytes, bincode::config::standard())
        .map_err(|error| EnvelopeError::Encode(error.to_string()))?;
    if bytes.len() > kind.limit_bytes {
        return Err(EnvelopeError::TooLarge { size: bytes.len(), limit: kind.limit_bytes });
    }
    Ok(bytes)
}

/// Writes something that stands in no message.
///
/// # Errors
/// [`EnvelopeError::Encode`] if bincode refuses it.
pub(crate) fn pack<T: Serialize>(content: &T) -> Result<Vec<u8>, EnvelopeError> {
    bincode::serde::encode_to_vec(content, bincode::config::standard())
        .map_err(|error| EnvelopeError::Encode(error.to_string()))
}

/// Reads what [`pack`] wrote. No input makes it allocate more than [`MAX_FRAME`].
///
/// # Errors
/// [`EnvelopeError`] names what is wrong with the bytes.
pub(crate) fn unpack<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, EnvelopeError> {
    let limited = bincode::config::standard().with_limit::<MAX_FRAME>();
    let (content, read) = bincode::serde::decode_from_slice(bytes, limited)
        .map_err(|error| EnvelopeError::Content(error.to_string()))?;
    match bytes.len() - read {
        0 => Ok(content),
        trailing => Err(EnvelopeError::Trailing(trailing)),
    }
}

/// Reads what [`pack`] wrote. However much the bytes promise, what is allocated for them stays within a multiple of their own
/// number.
///
/// # Errors
/// [`EnvelopeError`] names what is wrong with the bytes.
pub(crate) fn unpack_bounded<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, EnvelopeError> {
    let (content, read) = read(bytes).map_err(|error| EnvelopeError::Content(error.to_string()))?;
    match bytes.len() - read {
        0 => Ok(content),
        trailing => Err(EnvelopeError::Trailing(trailing)),
    }
}

/// The number of the kind that a binary message says it has; none where it is too short.
pub(crate) fn kind_number(bytes: &[u8]) -> Option<u8> {
    bytes.get(HEAD - 1).copied()
}

/// Reads a message of a known kind.
///
/// # Errors
/// [`EnvelopeError`] names what is wrong with the bytes. However much they promise, what is allocated for them stays
/// within a multiple of their own number.
pub fn decode<T: BinaryMessage>(bytes: &[u8]) -> Result<T, EnvelopeError> {
    decode_as(T::KIND, bytes)
}

/// Reads a message of a kind.
///
/// # Errors
/// As [`decode`].
pub(crate) fn decode_as<T: DeserializeOwned>(kind: Kind, bytes: &[u8]) -> Result<T, EnvelopeError> {
    if bytes.len() > kind.limit_bytes {
        return Err(EnvelopeError::TooLarge { size: bytes.len(), limit: kind.limit_bytes });
    }
    let &[magic, version, number, ref content @ ..] = bytes else {
        return Err(EnvelopeError::NotMuster);
    };
    if magic != MAGIC {
        return Err(EnvelopeError::NotMuster);
    }
    if version != VERSION {
        return Err(EnvelopeError::Version(version));
    }
    if number != kind.number {
        return Err(EnvelopeError::Kind { got: number, expected: kind.number });
    }
    unpack_bounded(content)
}

/// Reads a content under the smallest limit that fits it.
///
/// bincode allocates the whole of a text before it looks whether it is there, as far as the limit
/// lets it, and a limit is a constant: one of a few is chosen by the size of the content. The limit
/// counts eight bytes for a number that takes one.
fn read<T: DeserializeOwned>(content: &[u8]) -> Result<(T, usize), DecodeError> {
    const SMALL: usize = 1 << 10;
    const MEDIUM: usize = 1 << 15;
    const LARGE: usize = 1 << 20;
    match content.len() {
        size if size <= SMALL => read_within::<T, { 8 * SMALL }>(content),
        size if size <= MEDIUM => read_within::<T, { 8 * MEDIUM }>(content),
        size if size <= LARGE => read_within::<T, { 8 * LARGE }>(content),
        _ => read_within::<T, MAX_SERVICE_PAYLOAD>(content),
    }
}

fn read_within<T: DeserializeOwned, const LIMIT: usize>(
    content: &[u8],
) -> Result<(T, usize), DecodeError> {
    let limited: Configuration<_, _, Limit<LIMIT>> = bincode::config::standard().with_limit();
    bincode::serde::decode_from_slice(content, limited)
}
