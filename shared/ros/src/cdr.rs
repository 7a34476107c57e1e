//! CDR, the bytes of messages: the plain first version (XCDR1), in both byte orders.
//!
//! A payload begins with four bytes that name the representation; what follows is aligned to its own size, counted from
//! behind them. Strings have their length with a zero at the end before them; a wide one has the number of its UTF-16
//! units, each in four bytes, as `rosidl_typesupport_fastrtps` writes them. No crate is used for it: those that there
//! are read types that are known when they are compiled.

mod read;
mod write;

pub use read::decode;
pub use write::encode;

/// Largest message in bytes: markers of 10,000 robots take less than two million.
pub const MAX_MESSAGE_BYTES: usize = 4 * 1024 * 1024;

/// How many bytes name the representation.
const HEADER_BYTES: usize = 4;

/// Most bytes behind a message: some writers fill its length up to a multiple of four.
const MAX_PADDING: usize = 3;

/// Which byte of a number comes first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ByteOrder {
    /// The highest.
    Big,
    /// The lowest.
    Little,
}

impl ByteOrder {
    /// The four bytes of the representation: plain CDR without options.
    const fn header(self) -> [u8; HEADER_BYTES] {
        match self {
            Self::Big => [0, 0, 0, 0],
            Self::Little => [0, 1, 0, 0],
        }
    }
}

/// Why bytes are no message of a type, or a message has no bytes.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CdrError {
    /// There are more than [`MAX_MESSAGE_BYTES`].
    #[error("a message may have at most {MAX_MESSAGE_BYTES} bytes, this has {0}")]
    TooLong(usize),
    /// The first bytes name no representation that is read.
    #[error("the bytes begin with {0:?}; plain CDR begins with 0, 0 or 0, 1")]
    Header([u8; 2]),
    /// The bytes end within a field.
    #[error("{0}the bytes end before the message does")]
    Short(Place),
    /// More bytes follow than fill a multiple of four.
    #[error("{0} bytes follow the message: its type is another one")]
    Rest(usize),
    /// A sequence has more values than its type allows, or than bytes are left.
    #[error("{place}{count} values are more than there may be")]
    Count {
        /// Which field.
        place: Place,
        /// How many values it would have.
        count: usize,
    },
    /// A string is longer than its type allows, has no zero at its end, or is not UTF-8 or UTF-16.
    #[error("{0}this is no string, or is too long")]
    Text(Place),
    /// A `bool` is neither 0 nor 1.
    #[error("{0}this is no bool")]
    Bool(Place),
    /// A value is none of the type of its field.
    #[error("{0}the value is none of this field")]
    Value(Place),
}

/// A field in the text of an error; empty for none.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Place(String);

impl Place {
    /// The same place, within a field.
    fn within(self, field: &str) -> Self {
        let dot = if self.0.is_empty() || self.0.starts_with('[') { "" } else { "." };
        Self(format!("{field}{dot}{}", self.0))
    }
}

impl std::fmt::Display for Place {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.0.is_empty() { Ok(()) } else { write!(formatter, "{}: ", self.0) }
    }
}

impl CdrError {
    /// The same error, of a field within a field.
    fn within(self, field: &str) -> Self {
        match self {
            Self::Short(place) => Self::Short(place.within(field)),
            Self::Count { place, count } => Self::Count { place: place.within(field), count },
            Self::Text(place) => Self::Text(place.within(field)),
            Self::Bool(place) => Self::Bool(place.within(field)),
            Self::Value(place) => Self::Value(place.within(field)),
            Self::TooLong(_) | Self::Header(_) | Self::Rest(_) => self,
        }
    }
}

/// How many bytes fill a place up to a multiple of a size, which is a power of two.
const fn padding(at: usize, size: usize) -> usize {
    at.wrapping_neg() & (size - 1)
}
