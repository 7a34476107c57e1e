//! What a robot learns of its messages that were refused.

use crate::header::Header;
use crate::id::RobotId;

/// A message of a robot was refused. What was accepted before stays.
#[derive(Debug, Clone, PartialEq)]
pub struct Refused {
    /// The head of the message. Its epoch counts events and refusals of one leader of `ingest`.
    pub header: Header,
    /// The robot that the key names.
    pub robot: RobotId,
    /// The key, cut short and without control characters.
    pub key: String,
    /// What is wrong and the remedy, without control characters.
    pub reason: String,
    /// How many messages were refused on this key since the last such message.
    pub count: u64,
}
