//! What ROS is shown of the fleet: when, and in which messages.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use muster_model::audit::{Audit, Quality};
use muster_model::id::{RobotId, TeamId};
use muster_model::roster::{Roster, RosterEntry};
use muster_model::settings::AuditorSettings;
use muster_model::team_audit::TeamAudit;
use muster_model::teams::{Team, Teams};
use muster_model::time::Tick;
use muster_ros::message::MessageError;
use muster_ros::{Catalog, Message, TopicName, Value};
use muster_wire::json::EdgeJson as _;

use super::Output;
use super::publishers::Publishers;
use super::refusals::Refusals;
use super::robots::{Robots, Stream};
use crate::config::Setup;

/// How often everything is shown although nothing has changed: for those who come late, and so that the age is right.
const SHOW_EVERY: Duration = Duration::from_secs(1);

/// Levels of a `DiagnosticStatus`.
mod level {
    pub(super) const OK: u8 = 0;
    pub(super) const WARN: u8 = 1;
    pub(super) const ERROR: u8 = 2;
    pub(super) const STALE: u8 = 3;
}

/// Types of a `Marker`.
const SPHERE_LIST: i32 = 7;
const TEXT_VIEW_FACING: i32 = 9;

/// The action of a marker that takes all away.
const DELETE_ALL: i32 = 3;

/// Diameter of the sphere at a robot in metres.
const SPHERE_M: f64 = 0.8;

/// Height of a team's name in metres, and how far above its robots it stands.
const LABEL_M: f64 = 1.0;

/// Most reasons that are shown.
const MAX_REASONS: usize = 32;

/// Colours that differ for eyes that see few of them (Okabe and Ito 2008), red, green and blue.
const COLOURS: [[f32; 3]; 7] = [
    [0.90, 0.62, 0.00],
    [0.34, 0.71, 0.91],
    [0.00, 0.62, 0.45],
    [0.94, 0.89, 0.26],
    [0.00, 0.45, 0.70],
    [0.84, 0.37, 0.00],
    [0.80, 0.47, 0.65],
];

/// The newest of the fleet, and what was shown of it.
#[derive(Debug, Default)]
pub(super) struct Outgoing {
    teams: Option<Arc<Teams>>,
    is_stale: bool,
    audit: Option<Arc<Audit>>,
    roster: Option<Arc<Roster>>,
    /// Whether the division has changed since it was shown.
    is_new: bool,
    /// The robots that have another team since: they learn it before others learn of new companions, which in a large
    /// fleet takes a while.
    moved: BTreeSet<RobotId>,
    shown: Tick,
    /// The topics of single robots that are there.
    robot_topics: BTreeMap<RobotId, TopicName>,
}

impl Outgoing {
    pub(super) fn set_teams(&mut self, teams: Arc<Teams>, is_stale: bool) {
        let same = self.teams.as_ref().is_some_and(|last| last.same_division(&teams));
        self.is_new |= !same || self.is_stale != is_stale;
        if !same {
            let before: BTreeMap<_, _> =
                self.teams.iter().flat_map(|last| last.assignments()).collect();
            let new = teams.assignments().filter(|(robot, team)| before.get(robot) != Some(team));
            let new: BTreeSet<RobotId> = new.map(|(robot, _)| robot.clone()).collect();
            self.moved.extend(new);
        }
        (self.teams, self.is_stale) = (Some(teams), is_stale);
    }

    pub(super) fn set_audit(&mut self, audit: Arc<Audit>) {
        self.audit = Some(audit);
    }

    pub(super) fn set_roster(&mut self, roster: Arc<Roster>) {
        self.roster = Some(roster);
    }

    /// What is due: all of it when the division has changed, and every second.
    pub(super) fn publish(
        &mut self,
        now: Tick,
        is_tick: bool,
        setup: &Setup,
        publishers: &mut Publishers,
        robots: &Robots,
        refusals: &Refusals,
    ) -> Vec<Output> {
        let is_due = now.since(self.shown) >= SHOW_EVERY;
        let is_repetition = is_tick && is_due;
        if !(self.is_new || is_repetition) {
            return Vec::new();
        }
        self.is_new = false;
        self.shown = now;
        let mut outputs = self.robot_teams(now, setup, publishers, robots);
        let shown = Shown { now, setup, outgoing: self, robots, refusals };
        let topics = &setup.publish;
        let messages = [
            (&topics.teams, shown.teams()),
            (&topics.typed_teams, shown.typed_teams()),
            (&topics.diagnostics, shown.diagnostics()),
            (&topics.markers, shown.markers()),
        ];
        for (topic, message) in messages {
            let (Some(topic), Ok(Some(message))) = (topic, message) else { continue };
            // Only a message that is too long has no bytes; nothing is shown of it.
            outputs.extend(publishers.publish(now, topic, &message).unwrap_or_default());
        }
        outputs
    }

    /// The team of each robot that ROS brought.
    fn robot_teams(
        &mut self,
        now: Tick,
        setup: &Setup,
        publishers: &mut Publishers,
        robots: &Robots,
    ) -> Vec<Output> {
        let (Some(template), Some(teams)) = (&setup.publish.team, &self.teams) else {
            return Vec::new();
        };
        let mut outputs = Vec::new();
        self.robot_topics.retain(|robot, topic| {
            let stays = robots.contains(robot);
            if !stays {
                outputs.extend(publishers.withdraw(topic));
            }
            stays
        });
        // A team that may not be valid any more is not published to robots.
        if self.is_stale {
            return outputs;
        }
        let moved = std::mem::take(&mut self.moved);
        let (first, others): (Vec<_>, Vec<_>) =
            robots.iter().partition(|(robot, _)| moved.contains(*robot));
        for (robot, name) in first.into_iter().chain(others) {
            let Some(team) = teams.robot_team(robot) else { continue };
            let Ok(topic) = TopicName::new(&template.with(name)) else { continue };
            let json = team.to_json(now).ok().and_then(|bytes| String::from_utf8(bytes).ok());
            let Some(json) = json else { continue };
            let message = text_message(&setup.catalog, json);
            let Ok(message) = message else { continue };
            outputs.extend(publishers.publish(now, &topic, &message).unwrap_or_default());
            self.robot_topics.insert(robot.clone(), topic);
        }
        outputs
    }
}

fn text_message(catalog: &Catalog, text: impl Into<String>) -> Result<Message, MessageError> {
    let mut message = Message::new(catalog, "std_msgs/String")?;
    message.set("data", text.into())?;
    Ok(message)
}

/// What is shown at one moment.
struct Shown<'a> {
    now: Tick,
    setup: &'a Setup,
    outgoing: &'a Outgoing,
    robots: &'a Robots,
    refusals: &'a Refusals,
}

type Made = Result<Option<Message>, MessageError>;

impl Shown<'_> {
    fn new_message(&self, type_name: &str) -> Result<Message, MessageError> {
        Message::new(&self.setup.catalog, type_name)
    }

    /// The seconds and nanoseconds of now.
    fn stamp(&self) -> Value {
        let seconds = i32::try_from(self.now.0 / 1_000_000).unwrap_or(i32::MAX);
        let nanoseconds = u32::try_from(self.now.0 % 1_000_000 * 1000).unwrap_or(0);
        Value::Struct(vec![Value::from(seconds), Value::from(nanoseconds)])
    }

    /// The division as JSON.
    fn teams(&self) -> Made {
        let Some(teams) = &self.outgoing.teams else { return Ok(None) };
        let json = teams.to_json(self.now).ok().and_then(|bytes| String::from_utf8(bytes).ok());
        json.map(|json| text_message(&self.setup.catalog, json)).transpose()
    }

    /// The division in messages of our own.
    fn typed_teams(&self) -> Made {
        let Some(teams) = &self.outgoing.teams else { return Ok(None) };
        let texts = |robots: &mut dyn Iterator<Item = &RobotId>| {
            Value::List(robots.map(|robot| Value::from(robot.as_str())).collect())
        };
        let mut message = self.new_message("muster_msgs/Teams")?;
        message.set("header.stamp", self.stamp())?;
        message.set("header.frame_id", self.setup.world.as_str())?;
        message.set("fleet", teams.header.fleet.as_str())?;
        message.set("stale", self.outgoing.is_stale)?;
        message.set("unassigned", texts(&mut teams.unassigned.iter()))?;
        message.set("silent", texts(&mut teams.stale.iter()))?;
        let mut all = Vec::new();
        for team in &teams.teams {
            let mut one = self.new_message("muster_msgs/Team")?;
            one.set("id", team.id.as_str())?;
            one.set("leader", team.leader.as_str())?;
            one.set("members", texts(&mut team.members.iter().map(|member| &member.robot)))?;
            let scores = self.outgoing.audit.iter().flat_map(|audit| &audit.per_team);
            let mut scores = scores.filter(|scores| scores.team == team.id);
            let silhouette = scores.next().and_then(|scores| scores.silhouette);
            one.set("silhouette", silhouette.unwrap_or(f64::NAN))?;
            all.push(one.into_value());
        }
        message.set("teams", Value::List(all))?;
        Ok(Some(message))
    }

    /// One status for each team, and one for what is refused of ROS.
    fn diagnostics(&self) -> Made {
        let mut array = self.new_message("diagnostic_msgs/DiagnosticArray")?;
        let mut statuses = Vec::new();
        let audit = self.outgoing.audit.as_deref();
        if let Some(teams) = self.outgoing.teams.as_deref() {
            for team in &teams.teams {
                let scores = audit
                    .and_then(|audit| audit.per_team.iter().find(|scores| scores.team == team.id));
                statuses.push(self.team_status(teams, team, audit, scores)?);
            }
        }
        statuses.push(self.intake_status()?);
        array.set("header.stamp", self.stamp())?;
        array.set("status", Value::List(statuses))?;
        Ok(Some(array))
    }

    fn status(
        &self,
        name: String,
        level: u8,
        message: String,
        values: Vec<(&str, String)>,
    ) -> Result<Value, MessageError> {
        let mut status = self.new_message("diagnostic_msgs/DiagnosticStatus")?;
        status.set("level", level)?;
        status.set("name", name)?;
        status.set("message", message)?;
        status.set("hardware_id", "muster")?;
        let pair = |(key, value): (&str, String)| {
            Value::Struct(vec![Value::from(key), Value::from(value)])
        };
        status.set("values", Value::List(values.into_iter().map(pair).collect()))?;
        Ok(status.into_value())
    }

    fn team_status(
        &self,
        teams: &Teams,
        team: &Team,
        audit: Option<&Audit>,
        scores: Option<&TeamAudit>,
    ) -> Result<Value, MessageError> {
        let is_missing = |robot: &RobotId| teams.stale.binary_search(robot).is_ok();
        let missing = team.members.iter().filter(|member| is_missing(&member.robot)).count();
        let (level, message) = self.verdict(team, missing, audit, scores);
        let mut values = vec![
            ("robots", team.members.len().to_string()),
            ("missing", missing.to_string()),
            ("leader", team.leader.to_string()),
        ];
        if let Some(silhouette) = scores.and_then(|scores| scores.silhouette) {
            values.push(("silhouette", format!("{silhouette:.3}")));
        }
        if let Some(radio) = scores.and_then(|scores| scores.radio.as_ref()) {
            values.push(("parts by radio", radio.parts.to_string()));
        }
        self.status(format!("muster: team {}", team.id), level, message, values)
    }

    /// How good a team is.
    fn verdict(
        &self,
        team: &Team,
        missing: usize,
        audit: Option<&Audit>,
        scores: Option<&TeamAudit>,
    ) -> (u8, String) {
        if self.outgoing.is_stale {
            return (level::STALE, "no service publishes the division".to_owned());
        }
        if missing == team.members.len() {
            return (level::ERROR, "all robots of the team are silent".to_owned());
        }
        let poor = AuditorSettings::default().team_poor;
        let silhouette = scores.and_then(|scores| scores.silhouette);
        if silhouette.is_some_and(|silhouette| silhouette < poor) {
            return (level::WARN, "the team is hardly apart from others".to_owned());
        }
        if scores.is_some_and(|scores| scores.radio.as_ref().is_some_and(|radio| radio.parts > 1)) {
            return (level::WARN, "the team has parts that no link joins".to_owned());
        }
        if missing > 0 {
            return (level::WARN, format!("{missing} robots of the team are silent"));
        }
        if audit.is_some_and(|audit| audit.quality == Quality::Poor) {
            return (level::WARN, "the division is poor".to_owned());
        }
        (level::OK, "good".to_owned())
    }

    fn intake_status(&self) -> Result<Value, MessageError> {
        let (level, message) = match self.refusals.len() {
            0 => (level::OK, "all topics are taken".to_owned()),
            count => (level::WARN, format!("{count} topics are not taken")),
        };
        let reasons = self.refusals.iter().take(MAX_REASONS);
        let reasons = reasons.map(|(key, _, reason)| (key, reason.to_owned())).collect();
        self.status("muster: topics".to_owned(), level, message, reasons)
    }

    /// The coordinate frame of the fleet that the world is: that of the file, or that of the robots which this bridge brings.
    /// While it brings none, that of the first robot that is anywhere.
    fn frame<'a>(&'a self, roster: &'a Roster) -> Option<&'a str> {
        let is_ours =
            |entry: &&RosterEntry| self.robots.source(&entry.robot, Stream::Pose).is_some();
        let mut placed = roster.robots.iter().filter(|entry| entry.position.is_some());
        let of_roster = || {
            let first = placed.clone().next();
            placed.find(is_ours).or(first).and_then(|entry| entry.frame.as_deref())
        };
        self.setup.frame.as_deref().or_else(of_roster)
    }

    /// Spheres at the robots of each team, and its name above them. Robots of other frames are left out, since positions in
    /// different frames are not comparable.
    fn markers(&self) -> Made {
        let (Some(teams), Some(roster)) = (&self.outgoing.teams, &self.outgoing.roster) else {
            return Ok(None);
        };
        let mut array = self.new_message("visualization_msgs/MarkerArray")?;
        // Teams that are gone leave nothing behind.
        let mut markers = vec![self.marker("", 0, 0, DELETE_ALL)?.into_value()];
        let frame = self.frame(roster);
        let position = |robot: &RobotId| {
            let at = roster.robots.binary_search_by(|entry| entry.robot.cmp(robot)).ok()?;
            let entry = &roster.robots[at];
            entry.position.filter(|_| entry.frame.as_deref() == frame)
        };
        for (number, team) in teams.teams.iter().enumerate() {
            let members = team.members.iter().filter_map(|member| position(&member.robot));
            let places: Vec<[f64; 3]> = members.collect();
            if !places.is_empty() {
                let number = i32::try_from(number).unwrap_or(i32::MAX);
                markers.push(self.spheres(team, number, &places)?);
                markers.push(self.label(team, number, &places)?);
            }
        }
        array.set("markers", Value::List(markers))?;
        Ok(Some(array))
    }

    fn marker(
        &self,
        namespace: &str,
        number: i32,
        kind: i32,
        action: i32,
    ) -> Result<Message, MessageError> {
        let mut marker = self.new_message("visualization_msgs/Marker")?;
        marker.set("header.stamp", self.stamp())?;
        marker.set("header.frame_id", self.setup.world.as_str())?;
        marker.set("ns", namespace)?;
        marker.set("id", number)?;
        marker.set("type", kind)?;
        marker.set("action", action)?;
        Ok(marker)
    }

    fn spheres(
        &self,
        team: &Team,
        number: i32,
        places: &[[f64; 3]],
    ) -> Result<Value, MessageError> {
        let mut marker = self.marker("teams", number, SPHERE_LIST, 0)?;
        for axis in ["x", "y", "z"] {
            marker.set(&format!("scale.{axis}"), SPHERE_M)?;
        }
        marker.set("color", colour(&team.id))?;
        let point = |place: &[f64; 3]| Value::Struct(place.map(Value::from).to_vec());
        marker.set("points", Value::List(places.iter().map(point).collect()))?;
        Ok(marker.into_value())
    }

    fn label(&self, team: &Team, number: i32, places: &[[f64; 3]]) -> Result<Value, MessageError> {
        let mut marker = self.marker("names", number, TEXT_VIEW_FACING, 0)?;
        #[allow(clippy::cast_precision_loss, reason = "a team has fewer robots")]
        let count = places.len() as f64;
        let mean = |axis: usize| places.iter().map(|place| place[axis]).sum::<f64>() / count;
        marker.set("pose.position.x", mean(0))?;
        marker.set("pose.position.y", mean(1))?;
        marker.set("pose.position.z", mean(2) + 2.0 * LABEL_M)?;
        marker.set("scale.z", LABEL_M)?;
        marker.set("color", colour(&team.id))?;
        marker.set("text", team.id.to_string())?;
        Ok(marker.into_value())
    }
}

/// The colour of a team, which lasts with its id.
fn colour(team: &TeamId) -> Value {
    let number: usize =
        team.as_str().trim_start_matches(|c: char| !c.is_ascii_digit()).parse().unwrap_or(0);
    let [red, green, blue] = COLOURS[number % COLOURS.len()];
    Value::Struct([red, green, blue, 1.0].map(Value::from).to_vec())
}
