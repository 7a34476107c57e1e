//! Everything that crosses the bus: where it stands, and how it is written.
//!
//! [`key`] is the key space in one typed place; [`envelope`] the binary form (magic byte, schema
//! version, kind, bincode); [`json`] the form at the edge; [`message`] ties a key to a content and
//! both forms; [`packet`] is what crosses the bus; [`foreign`] has the keys of other programs; [`request`] reads gets; [`told`] is what robots read; [`recording`] is how the life of a
//! service is written to a file; [`schema`] describes the JSON. Nothing outside of this crate handles
//! bytes, and nothing in it knows the bus.

pub mod decode;
pub mod envelope;
pub mod foreign;
pub mod json;
pub mod key;
pub mod message;
pub mod packet;
pub mod recording;
pub mod report;
pub mod request;
pub mod schema;
pub mod told;

pub use decode::DecodeError;
pub use foreign::{Attachment, ForeignKey, ForeignPattern};
pub use key::{Key, KeySpace, Pattern};
pub use message::Message;
pub use packet::{Format, Outbound, Packet, Rejection, Source};
pub use request::{Request, RequestError};
