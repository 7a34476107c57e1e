//! What happens to robots, teams and services.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::header::Header;
use crate::id::{RobotId, ServiceName};
use crate::teams::TeamChange;

/// How much an event matters to an operator.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Part of normal life.
    Info,
    /// Worth a look.
    Warning,
    /// Something does not work.
    Error,
}

/// What happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// A message was refused. What had been accepted before stands.
    Quarantined {
        /// Whom the message spoke for, if its key says so.
        robot: Option<RobotId>,
        /// The key, cut short and without control characters.
        key: String,
        /// What is wrong and what would be right.
        reason: String,
        /// How many messages were refused for this robot and key since the last such event.
        count: u64,
    },
    /// A robot is known from now on.
    RobotJoined {
        /// The robot.
        robot: RobotId,
    },
    /// A robot has been silent for longer than it should.
    RobotStale {
        /// The robot.
        robot: RobotId,
    },
    /// A stale robot is heard again.
    RobotRecovered {
        /// The robot.
        robot: RobotId,
    },
    /// A robot is not part of the fleet any more.
    RobotLeft {
        /// The robot.
        robot: RobotId,
    },
    /// The division changed.
    TeamChanged(TeamChange),
    /// There are fewer teams than asked for.
    FewerTeams {
        /// How many were asked for.
        requested: u32,
        /// How many there are.
        formed: u32,
        /// Why.
        reason: String,
    },
    /// An operator changed settings.
    SettingsChanged {
        /// The new settings, as JSON.
        settings: String,
    },
    /// A computation failed; the last good result stands.
    JobFailed {
        /// What it said.
        reason: String,
    },
    /// The mean silhouette has stayed below the threshold.
    QualityLow {
        /// Mean silhouette in the embedding.
        mean: f64,
    },
    /// The mean silhouette has risen above the threshold again.
    QualityRecovered {
        /// Mean silhouette in the embedding.
        mean: f64,
    },
    /// A service has begun a term.
    ServiceStarted {
        /// Its term.
        term: u64,
    },
    /// A setting of an earlier run does not fit any more; what file and flags say holds.
    SettingDropped {
        /// The field.
        field: String,
    },
    /// The link to the router was lost and has come back; robots were not judged meanwhile.
    LinkRestored {
        /// Seconds without it.
        outage_s: f64,
    },
}

/// One event of one service.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// The head of the message.
    pub header: Header,
    /// Who tells it.
    pub source: ServiceName,
    /// How much it matters.
    pub severity: Severity,
    /// What happened.
    pub kind: EventKind,
}
