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

/// What stands among the counters of a status and says how things are, so that it may fall. Where it is zero, it is
/// not there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StatusGauge {
    /// 1 if the instance began without the state that it had stored.
    StateLost,
    /// 1 if nothing was stored when the instance started: a first start, or the loss of a whole directory.
    StateEmpty,
    /// 1 while state cannot be stored.
    StateUnwritable,
    /// 1 while a historian keeps less than it should.
    HistoryDegraded,
    /// The moment up to which a history is on the disk, in microseconds since 1970.
    RecordedThrough,
    /// How many bytes the records of a history take.
    HistoryBytes,
}

impl StatusGauge {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::StateLost,
        Self::StateEmpty,
        Self::StateUnwritable,
        Self::HistoryDegraded,
        Self::RecordedThrough,
        Self::HistoryBytes,
    ];

    /// Its name among the counters.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::StateLost => "state_lost",
            Self::StateEmpty => "state_empty",
            Self::StateUnwritable => "state_unwritable",
            Self::HistoryDegraded => "history_degraded",
            Self::RecordedThrough => "recorded_through",
            Self::HistoryBytes => "history_bytes",
        }
    }
}

impl ServiceStatus {
    /// How things are.
    #[must_use]
    pub fn gauge(&self, gauge: StatusGauge) -> u64 {
        self.counters.get(gauge.as_str()).copied().unwrap_or_default()
    }

    /// What is counted, with its name, and only grows.
    pub fn counted(&self) -> impl Iterator<Item = (&String, &u64)> {
        let is_gauge = |name: &str| StatusGauge::ALL.iter().any(|gauge| gauge.as_str() == name);
        self.counters.iter().filter(move |(name, _)| !is_gauge(name))
    }
}

/// A robot that has left.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Departure {
    /// The robot.
    pub robot: RobotId,
    /// When it left, some seconds after its last sign of life.
    pub left: Tick,
}
