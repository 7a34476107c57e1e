//! The status of a service.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::header::Revision;
use crate::id::{FleetId, InstanceId, RobotId, ServiceName};
use crate::limits::MAX_DEPARTED_ROBOTS;
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
    /// Its state in the election of its service.
    pub standing: ReplicaState,
    /// Its last output; of a standby, the last output that it received from the leader.
    pub revision: Revision,
    /// What it is doing, in words.
    pub state: String,
    /// Its counters since it started, by name.
    pub counters: BTreeMap<String, u64>,
    /// Robots that have left within the last hour and have not returned, the last one first. Only `ingest`
    /// has them, of its own run.
    #[serde(default)]
    #[schemars(length(max = MAX_DEPARTED_ROBOTS))]
    pub departed: Vec<Departure>,
}

/// A robot that has left.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Departure {
    /// The robot.
    pub robot: RobotId,
    /// When it left, some seconds after its last sign of life.
    pub left: Tick,
}
