//! What a service tells of itself.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::header::Revision;
use crate::id::{FleetId, InstanceId, ServiceName};
use crate::role::ReplicaState;
use crate::time::Tick;

/// The answer to a get on `service/{service}/status`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ServiceStatus {
    /// Which fleet it serves.
    pub fleet: FleetId,
    /// Which service it is.
    pub service: ServiceName,
    /// Which process.
    pub instance: InstanceId,
    /// The version of the program.
    pub version: String,
    /// When it started.
    pub started: Tick,
    /// When this was written.
    pub now: Tick,
    /// Where it stands towards the role of its service.
    pub standing: ReplicaState,
    /// Its last output; of an instance that stands by, that of the holder as it was last heard.
    pub revision: Revision,
    /// What it is doing, in a few words.
    pub state: String,
    /// What it has counted since it started, by name.
    pub counters: BTreeMap<String, u64>,
}
