//! What ROS 2 puts on a Zenoh bus: keys, tokens, attachments, message layouts and CDR.
//!
//! Two programs bring ROS 2 to Zenoh, and so there are two [`Dialect`]s. With `rmw_zenoh` every ROS program is on the
//! bus itself: a [`TopicKey`] names domain, topic, type and the hash of the type, an [`Attachment`] numbers the
//! messages of a publisher, and [`token`]s describe the graph of nodes and topics. `zenoh-bridge-ros2dds` forwards topics
//! of DDS under their plain names, without any of these. Both carry the same CDR.
//!
//! Nothing of ROS is needed: [`definition`] reads the `.msg` text of any message, [`layout`] resolves it with the
//! types that it names, [`hash`] computes the hash that ROS computes, and [`cdr`] reads and writes the bytes as a
//! [`Value`]. [`standard`] has the texts of the messages that most fleets use.
//!
//! The crate knows neither the bus nor Muster: keys are text. Every length in foreign bytes and texts is checked
//! before it is believed.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

pub mod attachment;
pub mod catalog;
pub mod cdr;
pub mod definition;
pub mod hash;
pub mod key;
pub mod layout;
mod literal;
pub mod message;
pub mod name;
pub mod path;
pub mod qos;
pub mod standard;
pub mod token;
pub mod value;

pub use attachment::{Attachment, Gid};
pub use catalog::Catalog;
pub use cdr::{ByteOrder, CdrError};
pub use hash::TypeHash;
pub use key::{Dialect, TopicKey};
pub use layout::Layout;
pub use message::Message;
pub use name::{NameError, TopicName, TypeName};
pub use path::{Path, Place};
pub use qos::Qos;
pub use token::{Endpoint, EndpointKind, Node, Token};
pub use value::Value;
