//! What a bridge says of itself: how many robots it reads, and which topics it does not take.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::id::InstanceId;

/// Most refused topics that a bridge names. Those beyond are counted alone.
pub const MAX_REFUSED_TOPICS: usize = 64;

/// The answer to a get on `bridge/{instance}`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct BridgeState {
    /// Which process.
    pub instance: InstanceId,
    /// The version of the program.
    pub version: String,
    /// How many robots have a topic with data.
    pub robots: u64,
    /// How many messages arrived since it started.
    pub received: u64,
    /// How many reports it put.
    pub reported: u64,
    /// How many topics have been refused within the last seconds.
    pub refused_topics: u64,
    /// The first of them by name.
    #[schemars(length(max = MAX_REFUSED_TOPICS))]
    pub refused: Vec<RefusedTopic>,
}

/// A topic that is not taken.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RefusedTopic {
    /// Its key on the bus.
    pub topic: String,
    /// What is wrong, for programs.
    pub fault: TopicFault,
    /// What is wrong, and what would be right.
    pub reason: String,
}

/// What is wrong with a topic.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum TopicFault {
    /// No chain of transforms leads from the frame of a pose to the world.
    NoChain,
    /// A transform on the way to the world is older than it may be.
    OldTransform,
    /// A type that is known comes with the hash of another definition.
    TypeHash,
    /// A message has no attachment.
    NoAttachment,
    /// Anything else, which the reason says.
    #[serde(other)]
    Other,
}
