//! Recordings of fleets in MCAP, and how they are played.
//!
//! A recording has the JSON of the bus as it stood there, a topic for each key, and the scenes that viewers would have
//! been sent. `file` writes files, `reading` reads them behind the checks of `lengths`, `record` fills one from a live fleet,
//! `play` says what of a file is put when, and `replay` puts it.

#[cfg(feature = "binary")]
pub mod file;
mod lengths;
#[cfg(feature = "binary")]
mod options;
pub mod play;
pub mod reading;
#[cfg(feature = "binary")]
mod record;
#[cfg(feature = "binary")]
mod replay;

#[cfg(feature = "binary")]
pub use self::options::main;

/// The name of the metadata that says what was recorded.
pub const METADATA: &str = "muster";

/// Most topics of one file: MCAP numbers them with 16 bits, and some are for what comes later.
pub const MAX_TOPICS: usize = 60_000;

/// A message of a recording.
#[derive(Debug, Clone)]
pub struct Entry<'a> {
    /// Its topic.
    pub topic: &'a str,
    /// When it was there, in nanoseconds since 1970.
    pub at: u64,
    /// Its bytes.
    pub bytes: &'a [u8],
}
