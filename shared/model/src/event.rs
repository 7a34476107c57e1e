//! What happens to robots, teams and services.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::alert::AlertKind;
use crate::header::Header;
use crate::id::{CommandId, Modality, OperatorId, RobotId, ServiceName, SkillId, TeamId, WishId};
use crate::limits::{
    MAX_ALERT_ROBOTS, MAX_DOUBTED_ROBOTS, MAX_FLAPPING_ROBOTS, MAX_ROBOTS_OF_EVENT,
};
use crate::teams::TeamChange;
use crate::wish::WishState;

/// How much an event matters to an operator.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Normal operation.
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
    /// A message was refused. What was accepted before stays.
    Quarantined {
        /// The robot that the key names, if it names one.
        robot: Option<RobotId>,
        /// The key, cut short and without control characters.
        key: String,
        /// What is wrong and the remedy, without control characters.
        reason: String,
        /// How many messages were refused for this robot and key since the last such event.
        count: u64,
    },
    /// A robot has joined the fleet.
    RobotJoined {
        /// The robot.
        robot: RobotId,
    },
    /// A robot has been silent for too long.
    RobotStale {
        /// The robot.
        robot: RobotId,
    },
    /// A stale robot reports again.
    RobotRecovered {
        /// The robot.
        robot: RobotId,
    },
    /// A robot has left the fleet.
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
        /// Its error.
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
    /// A service has begun a term, that of the message.
    ServiceStarted {
        /// Its term, which is that of the header.
        term: u64,
    },
    /// A setting of an earlier run is no longer valid; file and flags apply.
    SettingDropped {
        /// The field.
        field: String,
    },
    /// The link to the router was lost and is back; no presence changed meanwhile.
    LinkRestored {
        /// Seconds without it.
        outage_s: f64,
    },
    /// Robots change their team and change back, more often than the threshold.
    Flapping {
        /// Changes into a team that the robot had left within the last minute, per robot and minute.
        returns_per_robot_minute: f64,
        /// The robots that came back most often, most often first.
        #[schemars(length(max = MAX_FLAPPING_ROBOTS))]
        robots: Vec<RobotId>,
    },
    /// Robots change back no more than half as often as the threshold.
    FlappingEnded {
        /// Changes into a team that the robot had left within the last minute, per robot and minute.
        returns_per_robot_minute: f64,
    },
    /// The ties of a modality lie far from each other in the similarity of the other modalities, so that
    /// its weight is lowered.
    ModalityDoubted {
        /// The modality.
        modality: Modality,
        /// By how much its weight is multiplied, from 0 to 1.
        trust: f64,
        /// The robots that disagree most with the other modalities, the worst first.
        #[schemars(length(max = MAX_DOUBTED_ROBOTS))]
        robots: Vec<RobotId>,
    },
    /// A modality that was in doubt agrees with the others again.
    ModalityTrusted {
        /// The modality.
        modality: Modality,
        /// By how much its weight is multiplied, from 0 to 1.
        trust: f64,
    },
    /// Several robots became silent within a moment. One alone is `robot_stale`.
    RobotsStale {
        /// How many.
        count: u32,
        /// The first of them, ordered by name.
        #[schemars(length(max = MAX_ROBOTS_OF_EVENT))]
        robots: Vec<RobotId>,
    },
    /// Several stale robots report again since a moment. One alone is `robot_recovered`.
    RobotsRecovered {
        /// How many.
        count: u32,
        /// The first of them, ordered by name.
        #[schemars(length(max = MAX_ROBOTS_OF_EVENT))]
        robots: Vec<RobotId>,
    },
    /// Several robots have left the fleet within a moment. One alone is `robot_left`.
    RobotsLeft {
        /// How many.
        count: u32,
        /// The first of them, ordered by name.
        #[schemars(length(max = MAX_ROBOTS_OF_EVENT))]
        robots: Vec<RobotId>,
    },
    /// A service began without what it had stored, or cannot store: settings that operators changed are
    /// those of file and flags again, now or after a restart.
    StateLost {
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// The history cannot be written as it should be. Records wait, and the oldest go when too many do.
    HistoryDegraded {
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// The history is written again.
    HistoryRecovered {
        /// How many records were lost meanwhile.
        lost: u64,
    },
    /// A file of the history is damaged. It was put aside, and a new one begins.
    HistoryDamaged {
        /// Which file, and what is wrong with it.
        reason: String,
    },
    /// An alert is open from now on. The list of all that are open is on a key of its own.
    AlertRaised {
        /// Its number.
        alert: u64,
        /// What it is about.
        kind: AlertKind,
        /// The team that it concerns, if it concerns one.
        team: Option<TeamId>,
        /// The modality that it concerns, if it concerns one.
        modality: Option<Modality>,
        /// What was measured.
        value: f64,
        /// The threshold that was passed.
        threshold: f64,
        /// What is wrong, in words.
        reason: String,
        /// The robots that it is about, those that matter most first.
        #[schemars(length(max = MAX_ALERT_ROBOTS))]
        robots: Vec<RobotId>,
    },
    /// An alert has ended.
    AlertCleared {
        /// Its number.
        alert: u64,
        /// What it was about.
        kind: AlertKind,
        /// The team that it concerned, if it concerned one.
        team: Option<TeamId>,
        /// The modality that it concerned, if it concerned one.
        modality: Option<Modality>,
        /// How many seconds it was open.
        #[schemars(range(min = 0))]
        open_s: f64,
    },
    /// An operator has seen an alert.
    AlertAcknowledged {
        /// Its number.
        alert: u64,
        /// Who has seen it.
        operator: OperatorId,
    },
    /// Events of alerts were not published, because there were too many within a minute. The list of open
    /// alerts is whole.
    AlertsFolded {
        /// How many.
        count: u32,
    },
    /// Nothing satisfies the limits any more, as robots came or left: the last division stands, and robots that have no
    /// place in it have no team. Where only needs cannot be filled, the division goes on and fills as many as there can be.
    Infeasible {
        /// The limits that contradict each other, with their arithmetic.
        reason: String,
    },
    /// The limits hold again.
    FeasibleAgain {
        /// Seconds for which they did not.
        after_s: f64,
    },
    /// An operator has put or withdrawn a wish, or it has come to another state.
    WishChanged {
        /// Whose wish it is.
        operator: OperatorId,
        /// Its name.
        id: WishId,
        /// What has become of it.
        state: WishState,
    },
    /// An operator has commanded the service.
    Commanded {
        /// Who.
        operator: OperatorId,
        /// The id of the command.
        command: CommandId,
        /// What was commanded, as JSON; its name alone if it is long.
        action: String,
        /// Why it was refused; none if it was carried out.
        refused: Option<String>,
    },
    /// Robots have come to a team because it needs their skill.
    NeedFilled {
        /// The team.
        team: TeamId,
        /// The skill.
        skill: SkillId,
        /// The robots that have come, ordered by name.
        #[schemars(length(max = MAX_ROBOTS_OF_EVENT))]
        robots: Vec<RobotId>,
        /// What has become of the robots that had filled the need.
        reason: String,
    },
}

/// One event of one service.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// The head of the message.
    pub header: Header,
    /// The service that reports it.
    pub source: ServiceName,
    /// How much it matters.
    pub severity: Severity,
    /// What happened.
    pub kind: EventKind,
}
