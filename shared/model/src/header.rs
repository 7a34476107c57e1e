//! The head of every message between services.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::id::{FleetId, ServiceName};
use crate::time::Tick;

/// A place in the outputs of one service: first by term, then by epoch.
///
/// The term counts the leaders of the service (each begins the highest that it has received, plus one, and
/// one without stored state not below the seconds since 1970); the epoch counts the outputs of one leader. A
/// reader never goes back to a lower revision.
#[derive(
    Debug,
    Clone,
    Copy,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Serialize,
    Deserialize,
    JsonSchema,
)]
pub struct Revision {
    /// Which leader of the service.
    pub term: u64,
    /// Which output of that leader.
    pub epoch: u64,
}

/// When one service had received what it needed, and when it published what it made of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct StageTime {
    /// The service.
    pub stage: ServiceName,
    /// By the clock of the service's host.
    pub received: Tick,
    /// By the clock of the service's host.
    pub published: Tick,
}

/// The head of every message between services.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Header {
    /// The fleet.
    pub fleet: FleetId,
    /// Its place among the outputs of its service.
    pub revision: Revision,
    /// When the oldest pose behind it was received: among the robots that are not stale, or among all
    /// where every robot is.
    pub oldest: Option<Tick>,
    /// When the newest pose behind it was received.
    pub newest: Option<Tick>,
    /// The stages that the data has passed, in order.
    pub stages: Vec<StageTime>,
}

impl Header {
    /// Age in seconds of the oldest robot data behind the message; none if there is no such data.
    #[must_use]
    pub fn data_age_s(&self, now: Tick) -> Option<f64> {
        self.oldest.map(|oldest| now.since(oldest).as_secs_f64())
    }

    /// The head of a message that is made from this one: same data, one stage further.
    #[must_use]
    pub fn next_stage(&self, revision: Revision, stage: StageTime) -> Self {
        let mut stages = self.stages.clone();
        stages.push(stage);
        Self { revision, stages, ..self.clone() }
    }
}
