//! Who holds the role of a service, of which several instances may run.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::header::Header;
use crate::id::{InstanceId, ServiceName};

/// Where an instance stands towards the role of its service.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
#[schemars(rename = "Standing")]
pub enum ReplicaState {
    /// It asks the bus what there is, and publishes nothing.
    #[default]
    Starting,
    /// Another instance holds the role; this one follows and takes over when that one is gone.
    Standby,
    /// It held the role and was cut off or stopped for a while: it publishes nothing until it knows
    /// that nobody has taken over.
    #[serde(rename = "doubtful")]
    Suspect,
    /// It holds the role: its outputs are the outputs of the service.
    #[serde(rename = "holding")]
    Leading,
}

/// What the holder of a role tells the other instances of its service several times a second.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "Claim")]
pub struct LeaseRenewal {
    /// The head of the message; its revision is that of the holder's last output.
    pub header: Header,
    /// The service.
    pub service: ServiceName,
    /// The holder.
    pub instance: InstanceId,
}
