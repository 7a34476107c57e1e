//! What a fleet was: the records of which a history is made, what is asked of it, and its answers.
//!
//! Records hold what changed. A division is recorded when a robot's place or a team's leader is another than
//! before, and from time to time as a whole, so that a moment is found without reading everything before it.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::audit::Quality;
use crate::event::Severity;
use crate::header::Revision;
use crate::id::{FleetId, InstanceId, RobotId, ServiceName, TeamId};
use crate::limits::MAX_HISTORY_ROWS;
use crate::time::Tick;

/// Why a division is recorded as a whole.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SnapshotCause {
    /// The recording began: what was before is not known to it.
    Start,
    /// Records before it were lost.
    Gap,
    /// Time has passed. It is the division before, once more.
    Periodic,
}

/// Where a robot was, from a division on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Place {
    /// The robot.
    pub robot: RobotId,
    /// Whether the division contains it.
    pub present: bool,
    /// Its team; none if it belongs to none.
    pub team: Option<TeamId>,
    /// Whether it was stale.
    pub stale: bool,
    /// Its team in the division before; none if it had none, or in a snapshot.
    pub was: Option<TeamId>,
}

/// A team, from a division on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TeamLine {
    /// The team.
    pub team: TeamId,
    /// Who leads it; none once it has ended.
    pub leader: Option<RobotId>,
    /// How many robots it has; 0 once it has ended.
    pub members: u32,
}

/// A division that differs from the one before, or a whole one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DivisionRecord {
    /// Which output of `clusterer` it is.
    pub revision: Revision,
    /// How many teams were asked for, or chosen.
    pub requested: u32,
    /// How many teams there are.
    pub teams: u32,
    /// How many robots it contains.
    pub robots: u32,
    /// Why it is recorded as a whole; none if only what changed is recorded.
    pub snapshot: Option<SnapshotCause>,
    /// Where robots are: all of a snapshot, otherwise those whose place is another.
    pub places: Vec<Place>,
    /// The teams: all of a snapshot, otherwise those whose leader or members are others.
    pub lines: Vec<TeamLine>,
}

/// The scores of a division.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AuditRecord {
    /// Which output of `auditor` it is.
    pub revision: Revision,
    /// The division that was scored.
    pub division: Revision,
    /// Mean silhouette in the embedding; none with fewer than two teams.
    pub mean: Option<f64>,
    /// Mean silhouette among the positions; none where it is not defined.
    pub physical_mean: Option<f64>,
    /// The quality in one word.
    pub verdict: Quality,
    /// Mean silhouette of each team in the embedding.
    pub per_team: Vec<(TeamId, f64)>,
}

/// Where robots were, in centimetres east and north of the origin of their frame.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PositionsRecord {
    /// Whether these are all robots with a position; otherwise they are those that were elsewhere than in the last whole
    /// record.
    pub is_whole: bool,
    /// The robots, ordered by name.
    pub robots: Vec<(RobotId, [i64; 2])>,
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EventRecord {
    /// The service that reported it.
    pub source: ServiceName,
    /// Its place among the outputs of that service.
    pub revision: Revision,
    /// How much it matters.
    pub severity: Severity,
    /// Its kind, as `event` of `json/event`.
    pub kind: String,
    /// The fields of its kind, as a JSON object.
    pub detail: String,
}

/// Why a robot left the fleet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LeaveReason {
    /// Its liveliness token was gone: its program ended, or lost its link.
    Disconnected,
    /// Its liveliness token was there, and nothing came from it.
    Silent,
    /// It was gone when the recording began again; nobody recorded when it left.
    Unrecorded,
}

/// One thing to record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Record {
    /// The division changed, or is recorded as a whole.
    Division(DivisionRecord),
    /// The division was scored.
    Audit(AuditRecord),
    /// Something happened.
    Event(EventRecord),
    /// All robots of the fleet, as the recording begins. Others have left meanwhile.
    Present(Vec<RobotId>),
    /// A robot has joined.
    Joined(RobotId),
    /// A robot has left.
    Left {
        /// The robot.
        robot: RobotId,
        /// When anything was last received from it.
        last_seen: Tick,
        /// Why.
        reason: LeaveReason,
    },
    /// The settings of a service are others than before.
    Settings {
        /// The service.
        service: ServiceName,
        /// Which output of it announced them.
        revision: Revision,
        /// All of them, as JSON.
        settings: String,
    },
    /// Records were lost here.
    Gap {
        /// The moment of the first.
        from: Tick,
        /// The moment of the last.
        until: Tick,
        /// How many of them are sure to be lost; divisions that rested on them are lost as well.
        records: u64,
    },
    /// Robots are elsewhere than before.
    Positions(PositionsRecord),
}

/// A record with its moment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// When it was made, by the clock of the recording host.
    pub at: Tick,
    /// What is recorded.
    pub record: Record,
}

/// How long records are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Retention {
    /// Whole minutes before this moment go.
    pub before: Tick,
    /// Above so many bytes, the oldest whole minutes go.
    pub max_bytes: u64,
}

/// What is on the disk.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Coverage {
    /// The moment of the oldest record, in microseconds since the Unix epoch; null if there is none.
    pub recorded_from: Option<Tick>,
    /// The moment of the newest record, in microseconds since the Unix epoch; null if there is none.
    pub recorded_through: Option<Tick>,
    /// The number of the newest record; numbers are never given twice.
    pub sequence: u64,
    /// The newest recorded division.
    pub division: Option<Revision>,
    /// The newest recorded audit.
    pub audit: Option<Revision>,
    /// The newest recorded event of each service.
    pub events: Vec<EventCoverage>,
    /// How many bytes the records take.
    pub bytes: u64,
}

/// The newest recorded event of a service.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct EventCoverage {
    /// The service.
    pub source: ServiceName,
    /// Its event.
    pub revision: Revision,
}

/// What became of records that were to be written.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordingReport {
    /// What is on the disk.
    pub coverage: Coverage,
    /// Why recording is degraded; none if it is not.
    pub problem: Option<String>,
    /// How many records were lost since the report before.
    pub lost: u64,
    /// Which file was damaged and put aside since the report before.
    pub damaged: Option<String>,
}

/// How far a recording goes: what `historian` publishes about each instance.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RecordingState {
    /// The fleet.
    pub fleet: FleetId,
    /// The instance that records.
    pub instance: InstanceId,
    /// What is on the disk. Only this is promised to survive.
    #[serde(flatten)]
    pub coverage: Coverage,
    /// How many records were lost since the instance started.
    pub lost: u64,
    /// Why recording is degraded; null if it is not.
    pub degraded: Option<String>,
}

/// What is asked of a history.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Subject {
    /// The division and its audit at a moment: the last that were recorded until then.
    AsOf(Tick),
    /// The divisions that changed something.
    Divisions,
    /// Where a robot was.
    Robot(RobotId),
    /// Who was in a team, and who led it.
    Team(TeamId),
    /// What happened; of one kind, if one is named.
    Events(Option<String>),
    /// Which robots joined and left; one, if it is named.
    Robots(Option<RobotId>),
}

/// A question to a history. Rows come newest first.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Query {
    /// What is asked for.
    pub subject: Subject,
    /// No rows before this moment.
    pub since: Option<Tick>,
    /// No rows after this moment.
    pub until: Option<Tick>,
    /// Only rows with lower numbers, to go on behind an answer.
    pub before: Option<u64>,
    /// Most rows, up to [`MAX_HISTORY_ROWS`].
    pub limit: u32,
}

impl Query {
    /// A question for as many rows as there may be.
    #[must_use]
    pub const fn of(subject: Subject) -> Self {
        Self { subject, since: None, until: None, before: None, limit: MAX_HISTORY_ROWS }
    }

    /// Whether a row with this number and moment is asked for.
    #[must_use]
    pub fn selects(&self, sequence: u64, at: Tick) -> bool {
        self.before.is_none_or(|before| sequence < before)
            && self.since.is_none_or(|since| at >= since)
            && self.until.is_none_or(|until| at <= until)
    }

    /// How many rows are answered at most.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.limit.min(MAX_HISTORY_ROWS) as usize
    }
}

/// A team as it was.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct PastTeam {
    /// The team.
    pub id: TeamId,
    /// Its robots, ordered by name.
    pub members: Vec<RobotId>,
    /// Who led it.
    pub leader: Option<RobotId>,
}

/// The scores of a division as they were.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PastAudit {
    /// Its number.
    pub sequence: u64,
    /// When it was recorded, in microseconds since the Unix epoch.
    pub at: Tick,
    /// The division that was scored.
    pub division: Revision,
    /// Mean silhouette in the embedding; null with fewer than two teams.
    pub mean: Option<f64>,
    /// Mean silhouette among the positions; null where it is not defined.
    pub physical_mean: Option<f64>,
    /// The quality in one word.
    pub verdict: Quality,
    /// Mean silhouette of each team in the embedding.
    pub per_team: Vec<TeamMean>,
}

/// The mean silhouette of a team.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TeamMean {
    /// The team.
    pub team: TeamId,
    /// Its mean.
    pub mean: f64,
}

/// The fleet as it was at a moment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PastDivision {
    /// Its number.
    pub sequence: u64,
    /// When it was recorded, in microseconds since the Unix epoch.
    pub at: Tick,
    /// Which output of `clusterer` it was.
    pub revision: Revision,
    /// How many teams were asked for, or chosen.
    pub requested: u32,
    /// The teams, ordered by name.
    pub teams: Vec<PastTeam>,
    /// Robots without a team, ordered by name.
    pub unassigned: Vec<RobotId>,
    /// Stale robots, ordered by name.
    pub stale: Vec<RobotId>,
    /// The last scores that were recorded until then; null if there are none.
    pub audit: Option<PastAudit>,
    /// When the last positions until then were recorded, in microseconds since the Unix epoch; null if there are none.
    pub positions_at: Option<Tick>,
    /// Where its robots and the stale ones were then: metres east and north, by robot.
    pub positions: BTreeMap<RobotId, [f64; 2]>,
}

/// A division that changed something.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DivisionRow {
    /// Its number.
    pub sequence: u64,
    /// When it was recorded, in microseconds since the Unix epoch.
    pub at: Tick,
    /// Which output of `clusterer` it was.
    pub revision: Revision,
    /// How many teams were asked for, or chosen.
    pub requested: u32,
    /// How many teams there were.
    pub teams: u32,
    /// How many robots it contained.
    pub robots: u32,
    /// How many robots had another place than before; 0 where the recording began.
    pub changed: u32,
    /// Why it was recorded as a whole; null if only what changed was recorded.
    pub snapshot: Option<SnapshotCause>,
}

/// Where a robot was from a moment on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct PlaceRow {
    /// The number of the division.
    pub sequence: u64,
    /// When it was recorded, in microseconds since the Unix epoch.
    pub at: Tick,
    /// Its team; null if it belonged to none.
    pub team: Option<TeamId>,
    /// Its team before; null if it had none, or where the recording began.
    pub was: Option<TeamId>,
    /// Whether the division contained it.
    pub present: bool,
    /// Whether it was stale.
    pub stale: bool,
    /// Why all places were recorded; null if the place changed.
    pub snapshot: Option<SnapshotCause>,
}

/// A team from a moment on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TeamRow {
    /// The number of the division.
    pub sequence: u64,
    /// When it was recorded, in microseconds since the Unix epoch.
    pub at: Tick,
    /// Who led it; null once it had ended.
    pub leader: Option<RobotId>,
    /// How many robots it had; 0 once it had ended.
    pub members: u32,
    /// Who came into it, ordered by name.
    pub came: Vec<RobotId>,
    /// Who went out of it, ordered by name.
    pub went: Vec<RobotId>,
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct EventRow {
    /// Its number.
    pub sequence: u64,
    /// When it was recorded, in microseconds since the Unix epoch.
    pub at: Tick,
    /// The service that reported it.
    pub source: ServiceName,
    /// Its place among the outputs of that service.
    pub revision: Revision,
    /// How much it mattered.
    pub severity: Severity,
    /// What happened.
    pub event: String,
    /// The fields of the event, as `json/event` has them.
    #[serde(with = "json_text")]
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    pub detail: String,
}

impl EventRow {
    /// About how many bytes it takes in an answer.
    #[must_use]
    pub fn weight(&self) -> usize {
        200 + self.detail.len()
    }
}

impl TeamRow {
    /// About how many bytes it takes in an answer.
    #[must_use]
    pub fn weight(&self) -> usize {
        200 + 24 * (self.came.len() + self.went.len())
    }
}

/// A stay of a robot in the fleet.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct StayRow {
    /// Its number among the stays; those have numbers of their own.
    pub sequence: u64,
    /// The robot.
    pub robot: RobotId,
    /// When it joined, in microseconds since the Unix epoch; null if it was there when the recording began.
    pub joined: Option<Tick>,
    /// When it was first recorded, in microseconds since the Unix epoch.
    pub recorded: Tick,
    /// When it left, in microseconds since the Unix epoch; null if it is there.
    pub left: Option<Tick>,
    /// When anything was last received from it before it left; null if that is not known.
    pub last_seen: Option<Tick>,
    /// Why it left; null if it is there.
    pub reason: Option<LeaveReason>,
}

/// The rows that answer a question.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Rows {
    /// The division at a moment; null if none was recorded until then.
    AsOf(Option<Box<PastDivision>>),
    /// The divisions that changed something.
    Divisions(Vec<DivisionRow>),
    /// Where a robot was.
    Robot(Vec<PlaceRow>),
    /// Who was in a team.
    Team(Vec<TeamRow>),
    /// What happened.
    Events(Vec<EventRow>),
    /// Which robots joined and left.
    Robots(Vec<StayRow>),
}

/// A part of an answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Page {
    /// The rows, newest first.
    pub rows: Rows,
    /// The number before which there are further rows; none if these are the last.
    pub before: Option<u64>,
}

/// What a history answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HistoryAnswer {
    /// The fleet.
    pub fleet: FleetId,
    /// The instance that answers.
    pub instance: InstanceId,
    /// The moment of its oldest record, in microseconds since the Unix epoch; null if there is none.
    pub recorded_from: Option<Tick>,
    /// The moment of its newest record on the disk, in microseconds since the Unix epoch.
    pub recorded_through: Option<Tick>,
    /// The number before which there are further rows, for the parameter `before` of the next get; null if
    /// these are the last.
    pub before: Option<u64>,
    /// The rows, newest first.
    pub rows: Rows,
}

/// A text that is JSON: an object in JSON, a text in other forms.
mod json_text {
    use serde::de::Error as _;
    use serde::ser::Error as _;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use serde_json::Value;

    pub(super) fn serialize<S: Serializer>(text: &str, to: S) -> Result<S::Ok, S::Error> {
        if !to.is_human_readable() {
            return text.serialize(to);
        }
        serde_json::from_str::<Value>(text).map_err(S::Error::custom)?.serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<String, D::Error> {
        if !from.is_human_readable() {
            return String::deserialize(from);
        }
        serde_json::to_string(&Value::deserialize(from)?).map_err(D::Error::custom)
    }
}
