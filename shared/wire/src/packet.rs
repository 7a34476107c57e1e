//! Packets as they are received, and as they are sent.

use std::borrow::Cow;

use muster_model::id::RobotId;
use serde::{Deserialize, Serialize};

use crate::envelope;
use crate::foreign::Attachment;
use crate::key::{Key, KeySpace};

/// The encoding of JSON.
pub const JSON: &str = "application/json";

/// What the encoding of every binary message begins with; the kind and version follow.
pub(crate) const BINARY: &str = "application/octet-stream";

/// Longest piece of foreign text that is repeated in an error, in characters.
const MAX_QUOTED: usize = 120;

/// Longest reason in characters: some whole sentences, with a few pieces of foreign text in them. Only what
/// lists many names is longer.
pub const MAX_REASON: usize = 1000;

/// The two forms of a payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Format {
    /// JSON, for the edge.
    Json,
    /// The binary envelope, between services.
    Binary,
}

/// Where a packet comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Source {
    /// A put.
    Put,
    /// A deletion of the key.
    Delete,
    /// A liveliness token appeared.
    TokenAlive,
    /// A liveliness token was lost.
    TokenGone,
}

/// A packet from the bus that is not decoded yet.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Packet {
    /// The text of its key.
    pub key: String,
    /// The text of its encoding; may be empty.
    pub encoding: String,
    /// Where it comes from.
    pub source: Source,
    /// Its bytes, or how many they were where the limit of the subscription cut them off.
    #[serde(with = "crate::bytes")]
    pub payload: Result<Vec<u8>, usize>,
    /// The attachment of a bridged program; none on Muster's own keys.
    pub attachment: Option<Attachment>,
}

impl Packet {
    /// A put, as a subscriber receives it.
    #[must_use]
    pub fn put(
        key: impl Into<String>,
        encoding: impl Into<String>,
        payload: impl Into<Vec<u8>>,
    ) -> Self {
        Self {
            key: key.into(),
            encoding: encoding.into(),
            source: Source::Put,
            payload: Ok(payload.into()),
            attachment: None,
        }
    }

    /// A liveliness token that appeared or was lost.
    #[must_use]
    pub fn token(key: impl Into<String>, alive: bool) -> Self {
        let source = if alive { Source::TokenAlive } else { Source::TokenGone };
        Self { source, ..Self::put(key, "", []) }
    }

    /// How many bytes the payload has here.
    #[must_use]
    pub fn size(&self) -> usize {
        self.payload.as_ref().map_or(0, Vec::len)
    }
}

/// A message that is encoded and ready to be sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outbound {
    /// Where to.
    pub key: Key,
    /// The text of the encoding.
    pub encoding: Cow<'static, str>,
    /// The bytes.
    pub payload: Vec<u8>,
    /// The attachment of a bridged program; none on Muster's own keys.
    pub attachment: Option<Attachment>,
}

impl Outbound {
    /// The answer to a get of the schema.
    #[must_use]
    pub fn schema(text: &[u8]) -> Self {
        let (encoding, payload) = (Cow::Borrowed(JSON), text.to_vec());
        Self { key: Key::Schema, encoding, payload, attachment: None }
    }

    /// The packet that a subscriber receives.
    #[must_use]
    pub fn into_packet(self, space: &KeySpace) -> Packet {
        let packet = Packet::put(space.format(&self.key), self.encoding, self.payload);
        Packet { attachment: self.attachment, ..packet }
    }
}

/// Why a packet is refused.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rejection {
    /// The robot in its key, if there is one.
    pub robot: Option<RobotId>,
    /// Its key, cut short, without control characters.
    pub key: String,
    /// What is wrong and what would be right, at most [`MAX_REASON`] characters, no control characters.
    pub reason: String,
}

impl Rejection {
    /// A refusal of a packet with a key.
    #[must_use]
    pub fn new(space: &KeySpace, key: &str, reason: impl AsRef<str>) -> Self {
        Self { robot: space.robot_of(key), key: quoted(key), reason: plain_reason(reason.as_ref()) }
    }
}

/// Makes foreign text fit for a log line or an event: short, and without control characters.
#[must_use]
pub fn quoted(text: &str) -> String {
    plain(text, MAX_QUOTED)
}

/// Makes the reason of a refusal or failure fit for a log line or an event: whole sentences, and no control
/// characters.
#[must_use]
pub fn plain_reason(text: &str) -> String {
    plain(text, MAX_REASON)
}

fn plain(text: &str, limit: usize) -> String {
    text.chars().take(limit).map(|c| if c.is_control() { '\u{FFFD}' } else { c }).collect()
}

/// The encoding of a binary message.
pub(crate) fn binary_encoding(kind: &str) -> Cow<'static, str> {
    Cow::Owned(format!("{BINARY};bincode;muster.{kind};{}", envelope::VERSION))
}

/// Reads an encoding. A missing one is JSON, so that the shortest client works.
pub(crate) fn format_of(encoding: &str) -> Option<Format> {
    let name = encoding.split(';').next().unwrap_or_default().trim();
    match name {
        "" | "zenoh/bytes" | "zenoh/string" | "text/plain" | "text/json" | "application/json" => {
            Some(Format::Json)
        }
        BINARY | "application/bincode" => Some(Format::Binary),
        _ => None,
    }
}
