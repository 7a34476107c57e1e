//! Recordings of fleets in MCAP, and how they are played.
//!
//! A recording has the JSON of the bus as it stood there, a topic for each key, and the scenes that viewers would have
//! been sent. `file` writes files, `reading` reads them, `record` fills one from a live fleet, `play` says what of a file is put when,
//! and `replay` puts it.

pub mod file;
mod options;
pub mod play;
pub mod reading;
mod record;
mod replay;

pub use self::options::main;
