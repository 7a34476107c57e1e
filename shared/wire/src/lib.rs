#![doc = include_str!("../README.md")]
//!
//! # This crate
//!
//! [`key`] has every key, typed; [`packet`] is what crosses the bus before it is decoded; [`message`] ties a
//! key to a content and its two forms: [`envelope`] (binary) and [`json`]. [`report`] reads and writes the
//! reports of robots, [`robot_team`] the team that a robot reads, [`katz`] the similarity of a pair that a
//! console reads, [`why`] why a robot is in its team, [`history`] what is asked of a history, [`bridge`] what
//! a bridge says of itself, [`request`] gets; [`decode`] has the reasons for refusals. [`foreign`] has the keys of other
//! programs, [`recording`] the files of recordings, [`kept`] what is kept over a restart, [`schema`] the JSON Schema. Nothing outside of this crate
//! handles bytes, and nothing in it knows the bus.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

pub mod alerts;
pub mod bridge;
mod bytes;
pub mod command;
pub mod decode;
pub mod envelope;
pub mod fleets;
pub mod foreign;
pub mod history;
pub mod json;
pub mod katz;
pub mod kept;
pub mod key;
pub mod message;
pub mod packet;
pub mod proposal;
pub mod recording;
pub mod refused;
pub mod report;
pub mod request;
pub mod robot_team;
pub mod schema;
pub mod why;
pub mod wish;

pub use decode::DecodeError;
pub use fleets::{FleetPattern, FleetPatternError};
pub use foreign::{Attachment, ForeignKey, ForeignPattern};
pub use key::{Key, KeySpace, Pattern};
pub use message::Message;
pub use packet::{Format, Outbound, Packet, Rejection, Source};
pub use request::{Request, RequestError};

#[cfg(test)]
mod tests {
    use muster_model::limits;

    use crate::envelope::{MAX_SERVICE_PAYLOAD, MAX_SMALL_PAYLOAD};
    use crate::foreign::{MAX_ATTACHMENT_BYTES, MAX_FOREIGN_KEY_BYTES};

    #[test]
    fn the_readme_names_the_limits_as_they_are() {
        let readme = include_str!("../README.md");
        for row in [
            format!("| payload of a robot's report | {} bytes |", limits::MAX_ROBOT_PAYLOAD),
            format!("or a lease renewal | {MAX_SMALL_PAYLOAD} bytes |"),
            format!(
                "| payload of any other message between services | {MAX_SERVICE_PAYLOAD} bytes |"
            ),
            format!("| links in one report | {} |", limits::MAX_LINKS),
            format!("| edges in one relation | {} |", limits::MAX_RELATION_EDGES),
            format!("| declared modalities of a fleet | {} |", limits::MAX_DECLARED_MODALITIES),
            format!("| robots of a fleet | {} |", limits::MAX_ROBOTS),
            format!("| members listed in a robot's team | {} |", limits::MAX_MEMBERS_PUBLISHED),
            format!("| id | {} characters |", limits::MAX_ID_LENGTH),
            format!("`boot`) | {} bytes, no control characters |", limits::MAX_TEXT_LENGTH),
            format!("| coordinate | ±{} m |", limits::MAX_COORDINATE_M),
            format!("| weight of an edge | {} |", limits::MAX_WEIGHT),
            format!("| term and epoch | below {} |", limits::MAX_REVISION),
            format!("| parameters of a get | {} bytes |", crate::request::MAX_PARAMETERS),
            format!("| foreign key | {MAX_FOREIGN_KEY_BYTES} bytes |"),
            format!("| attachment of a foreign packet | {MAX_ATTACHMENT_BYTES} bytes |"),
        ] {
            assert!(readme.contains(&row), "{row}");
        }
    }
}
