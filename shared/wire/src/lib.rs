//! Everything that crosses the bus: where it stands, and how it is written.
//!
//! [`key`] is the key space in one typed place; [`envelope`] the binary form (magic byte, schema
//! version, kind, bincode); [`json`] the form at the edge; [`message`] ties a key to a content and
//! both forms; [`request`] reads gets; [`told`] is what robots read, [`katz`] what consoles read of a pair; [`recording`] is how the life of a
//! service is written to a file; [`schema`] describes the JSON. Nothing outside of this crate handles
//! bytes, and nothing in it knows the bus.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

pub mod envelope;
pub mod json;
pub mod katz;
pub mod key;
pub mod message;
pub mod recording;
pub mod request;
pub mod schema;
pub mod told;

pub use key::{Key, KeySpace, Pattern};
pub use message::{Message, Outbound, Packet, Rejection, Source};
pub use request::{Format, Request};
