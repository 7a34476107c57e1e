//! The leader among the instances of a service.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::header::Header;
use crate::id::{InstanceId, ServiceName};

/// The state of an instance in the election of its service.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
#[schemars(rename = "Standing")]
pub enum ReplicaState {
    /// It fetches the last outputs, and publishes nothing.
    #[default]
    Starting,
    /// Another instance leads; this one follows and takes over when that one is gone.
    Standby,
    /// It led and was cut off or paused: it publishes nothing until it knows that no other instance has
    /// taken over.
    #[serde(rename = "doubtful")]
    Suspect,
    /// It leads: its outputs are the outputs of the service.
    #[serde(rename = "holding")]
    Leading,
}

/// What the leader of a service sends to the other instances several times a second.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "Claim")]
pub struct LeaseRenewal {
    /// The head of the message; its revision is that of the leader's last output.
    pub header: Header,
    /// The service.
    pub service: ServiceName,
    /// The leader.
    pub instance: InstanceId,
}
