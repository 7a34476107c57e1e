//! What a bridge to ROS makes of the messages that reach it, and what it shows to ROS, judged from outside.
//!
//! The judge follows the messages that were delivered to the process by what they say, never by their bytes, and works out
//! by itself where a robot is: on the ground, with one angle.

use std::collections::{BTreeMap, BTreeSet};

use muster_client::Via;
use muster_model::bridge::{BridgeState, TopicFault};
use muster_model::header::Revision;
use muster_model::id::RobotId;
use muster_model::observation::Report;
use muster_wire::Attachment;

use super::super::clock::{MS, Micros, SECOND};
use super::super::plan::Span;
use super::super::robots::{TeamReport, read_team_report};
use super::super::ros::cdr::read_text;
use super::super::ros::{Ground, Said, Sample, WORLD};
use super::{Verified, breach};

/// What is promised of poses.
const PLACED: &str = "a robot of ROS is where its newest transforms put it";

/// What is promised of the order of reports.
const ORDERED: &str = "what a bridge puts for a robot is in the order of its publisher";

/// What is promised of what ROS is shown.
const NEWEST: &str = "ROS is never shown an older division after a newer one";

/// What is promised of messages to ROS.
const NUMBERED: &str = "messages to ROS come from a publisher that is announced, numbered from 1";

/// What is promised of refusals.
const NAMED: &str = "a robot of ROS that is not taken is named with its reason";

/// What is promised of the memory of a bridge.
const BOUNDED: &str = "the memory of a bridge is bounded";

/// How old a transform that changes may be, as the bridge is configured.
const MAX_TRANSFORM_AGE: Micros = SECOND;

/// How long a publisher must be silent until one that it replaced counts again.
const SILENT_PUBLISHER: Micros = 3 * SECOND;

/// How long a reader stays with a division while only older ones come: the default of clients, less a tick in which they
/// look.
const STAYS: Micros = 5 * SECOND - 100 * MS;

/// How far apart two ways to work out the same place may be, in metres.
pub(crate) const ROUNDING_M: f64 = 1e-6;

/// For how long a bridge may remember a topic without data, with a look at it every ten seconds.
const TOPIC_MEMORY: Micros = 75 * SECOND;

/// Most odometry of a robot that the judge remembers: more than reach a bridge between two ticks.
const MAX_ODOMETRY: usize = 512;

/// A transform that was delivered.
#[derive(Debug, Clone)]
struct Known {
    parent: String,
    at: Ground,
    received: Micros,
    is_static: bool,
    gid: String,
    sequence: i64,
}

/// The publishers of the odometry of one robot.
#[derive(Debug, Default)]
struct Publishers {
    /// The one that counts, and when it was last there.
    current: Option<(String, Micros)>,
    replaced: BTreeSet<String>,
    /// The highest number of each, of the messages that counted.
    newest: BTreeMap<String, i64>,
    odometry: BTreeMap<(String, i64), (String, Ground)>,
}

/// What is remembered of the process that runs.
#[derive(Debug, Default)]
pub(crate) struct Bridged {
    robots: BTreeMap<RobotId, Publishers>,
    frames: BTreeMap<(String, String), Known>,
    trees: BTreeMap<RobotId, String>,
    /// The last number that was put, by robot, kind of report and boot.
    put: BTreeMap<(RobotId, &'static str, String), u64>,
    /// When a pose of each robot was last put.
    posed: BTreeMap<RobotId, Micros>,
    /// The numbers of the messages to ROS by key, and their publishers.
    numbers: BTreeMap<String, (i64, Vec<u8>)>,
    tokens: BTreeSet<String>,
    /// The highest division that ROS was shown by key.
    shown: BTreeMap<String, Revision>,
    /// When divisions reached the process that say which one is valid.
    divisions: Vec<(Micros, Revision)>,
    /// What each robot was last shown of its team.
    pub(crate) reports: BTreeMap<String, TeamReport>,
    /// When there was last data on each key.
    keys: BTreeMap<String, Micros>,
}

/// What a bridge holds.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Held {
    pub(crate) robots: usize,
    pub(crate) topics: usize,
    pub(crate) frames: usize,
    pub(crate) refusals: usize,
}

impl Bridged {
    /// A message reaches the process.
    pub(crate) fn delivered(&mut self, now: Micros, sample: &Sample) {
        self.keys.insert(sample.packet.key.clone(), now);
        let Some(robot) = &sample.robot else { return };
        match &sample.said {
            Said::Odometry { frame, at } => {
                let publishers = self.robots.entry(robot.clone()).or_default();
                // What came while another publisher counted was left out, and may come late in bad weather.
                if publishers.receive(now, &sample.gid) {
                    let newest = publishers.newest.entry(sample.gid.clone()).or_default();
                    *newest = (*newest).max(sample.sequence);
                }
                let name = (sample.gid.clone(), sample.sequence);
                publishers.odometry.insert(name, (frame.clone(), *at));
                if publishers.odometry.len() > MAX_ODOMETRY {
                    publishers.odometry.pop_first();
                }
            }
            Said::Transform { tree, parent, child, at, is_static } => {
                self.trees.insert(robot.clone(), tree.clone());
                let (gid, sequence) = (sample.gid.clone(), sample.sequence);
                let place = (tree.clone(), child.clone());
                let before = self.frames.get(&place);
                if before.is_some_and(|known| known.gid == gid && known.sequence > sequence) {
                    return;
                }
                let (parent, at, received) = (parent.clone(), *at, now);
                let known = Known { parent, at, received, is_static: *is_static, gid, sequence };
                self.frames.insert(place, known);
            }
            Said::Links | Said::Rank | Said::Rubbish => {}
        }
    }

    /// A division reaches the process. Only its publisher says that it is still valid: a reply may come from somebody who
    /// remembers it, and counts if it is the newest that has come.
    pub(crate) fn division(&mut self, now: Micros, revision: Revision, via: Via) {
        let highest = self.divisions.iter().map(|(_, revision)| *revision).max();
        self.divisions.retain(|(at, revision)| now < at + 2 * STAYS || Some(*revision) == highest);
        if via == Via::Put || self.divisions.iter().all(|(_, known)| *known < revision) {
            self.divisions.push((now, revision));
        }
    }

    /// Where a frame puts something in the world by the newest transforms.
    fn in_world(
        &self,
        now: Micros,
        robot: &RobotId,
        frame: &str,
        at: Ground,
    ) -> Result<Ground, String> {
        let (mut frame, mut at) = (frame.to_owned(), at);
        let tree = self.trees.get(robot).cloned().unwrap_or_default();
        while frame != WORLD {
            let known = self.frames.get(&(tree.clone(), frame.clone()));
            let known = known.ok_or_else(|| format!("nothing says where {frame} is"))?;
            let age = now.saturating_sub(known.received);
            if !known.is_static && age > MAX_TRANSFORM_AGE {
                return Err(format!("where {frame} is was last said {} ago", Span(age)));
            }
            at = at.seen_from(known.at);
            frame.clone_from(&known.parent);
        }
        Ok(at)
    }

    /// The process puts a report.
    pub(crate) fn reported(&mut self, now: Micros, robot: &RobotId, report: &Report) -> Verified {
        let provenance = report.provenance();
        let (Some(boot), Some(seq)) = (provenance.boot.clone(), provenance.seq) else {
            return breach(ORDERED, format!("a report of {robot} has no number: {report:?}"));
        };
        let kind = match report {
            Report::Pose(_) => "pose",
            Report::Links(_) => "links",
            Report::Rank(_) => "rank",
            Report::Relation(..) => "relation",
        };
        let last = self.put.insert((robot.clone(), kind, boot.clone()), seq);
        // A rank that holds is put again for services that may have lost it.
        let is_right =
            last.is_none_or(|last| if kind == "pose" { last < seq } else { last <= seq });
        if !is_right {
            return breach(ORDERED, format!("{kind} {seq} of {robot} comes after {last:?}"));
        }
        let Report::Pose(pose) = report else { return Ok(()) };
        self.posed.insert(robot.clone(), now);
        let Some(publishers) = self.robots.get(robot) else {
            return breach(PLACED, format!("{robot} is put, and said nothing"));
        };
        let seq = i64::try_from(seq).unwrap_or(i64::MAX);
        let Some((frame, at)) = publishers.odometry.get(&(boot.clone(), seq)) else {
            return breach(PLACED, format!("{robot} is put by a message {seq} that never came"));
        };
        if publishers.newest.get(&boot) != Some(&seq) {
            let seen = format!("{robot} is put by its message {seq}, and a newer one came");
            return breach(ORDERED, seen);
        }
        if publishers.current.as_ref().is_some_and(|(gid, _)| *gid != boot) {
            let seen = format!("{robot} is put by {boot}, and another publisher counts");
            return breach(ORDERED, seen);
        }
        match self.in_world(now, robot, frame, *at) {
            Ok(place) => {
                let off = (place.x - pose.x).hypot(place.y - pose.y);
                let turned = pose.heading.map_or(0.0, |heading| (heading - place.yaw).sin().abs());
                if off > ROUNDING_M || turned > ROUNDING_M || pose.z != Some(0.0) {
                    return breach(PLACED, format!("{robot} is at {place:?}, and is put {pose:?}"));
                }
                Ok(())
            }
            Err(why) => breach(PLACED, format!("{robot} is put {pose:?}, and {why}")),
        }
    }

    /// A token is declared or withdrawn.
    pub(crate) fn token(&mut self, text: &str, is_there: bool) -> Verified {
        let changes =
            if is_there { self.tokens.insert(text.to_owned()) } else { self.tokens.remove(text) };
        if changes {
            return Ok(());
        }
        breach("a bridge announces each of its endpoints once", text.to_owned())
    }

    /// The process shows something to ROS.
    pub(crate) fn showed(
        &mut self,
        now: Micros,
        key: &str,
        payload: &[u8],
        attachment: Option<&Attachment>,
    ) -> Verified {
        let parts: Vec<&str> = key.split('/').collect();
        let [_, topic @ .., type_name, _] = &parts[..] else {
            return breach(NUMBERED, format!("{key} is no key of ROS"));
        };
        let Some((number, gid)) = attachment.and_then(|bytes| read_attachment(bytes.as_bytes()))
        else {
            return breach(NUMBERED, format!("{key} has no number"));
        };
        // A token names the topic with percent signs in place of slashes.
        let named = format!("%{}", topic.join("%"));
        if !self.tokens.iter().any(|token| token.contains("/MP/") && token.contains(&named)) {
            return breach(NUMBERED, format!("{key} is put, and no publisher is announced"));
        }
        let (last, by) = self.numbers.entry(key.to_owned()).or_insert((0, gid.clone()));
        // A topic of a robot that comes back has another publisher.
        let follows = if *by == gid { *last + 1 } else { 1 };
        if number != follows {
            return breach(NUMBERED, format!("{key} has the number {number} after {last}"));
        }
        (*last, *by) = (number, gid);
        if *type_name != "std_msgs::msg::dds_::String_" {
            return Ok(());
        }
        let report = read_text(payload).and_then(|text| read_team_report(text.as_bytes()));
        let Some(report) = report else {
            return breach("ROS can read what it is shown", format!("{key}: {payload:?}"));
        };
        let highest = self.shown.entry(key.to_owned()).or_insert(report.revision);
        if report.revision < *highest {
            let newer = self.divisions.iter().rev().find(|(_, revision)| *revision >= *highest);
            if let Some((at, _)) = newer.filter(|(at, _)| now < at + STAYS) {
                let (shown, highest) = (report.revision, *highest);
                let seen = format!(
                    "{key} shows {shown:?} after {highest:?}, and one as new as that came {} ago",
                    Span(now - at)
                );
                return breach(NEWEST, seen);
            }
        }
        *highest = report.revision;
        self.reports.insert(topic.join("/"), report);
        Ok(())
    }

    /// When the process last put a pose of a robot.
    pub(crate) fn last_pose(&self, robot: &RobotId) -> Option<Micros> {
        self.posed.get(robot).copied()
    }

    /// A robot that publishes is not taken, and the bridge says which of the reasons that are possible holds.
    pub(crate) fn check_named(
        &self,
        state: &BridgeState,
        name: &str,
        fault: TopicFault,
    ) -> Verified {
        let chunk = format!("/{name}/");
        let named = state.refused.iter().filter(|topic| topic.topic.contains(&chunk));
        let faults: Vec<TopicFault> = named.map(|topic| topic.fault).collect();
        if faults.contains(&fault) {
            return Ok(());
        }
        breach(NAMED, format!("{name} is refused for {faults:?}, and is {fault:?}"))
    }

    /// What the process holds is what there was data of lately.
    pub(crate) fn check_held(&mut self, now: Micros, held: Held) -> Verified {
        self.keys.retain(|_, last| now < *last + TOPIC_MEMORY);
        let most = self.keys.len();
        // A message of a robot has one transform, and rubbish at most as many as the judge knows of.
        let is_bounded = held.topics <= most
            && held.robots <= most
            && held.frames <= most.max(self.frames.len());
        if is_bounded && held.refusals <= most {
            return Ok(());
        }
        breach(BOUNDED, format!("it holds {held:?}, and there was data on {most} keys"))
    }
}

impl Publishers {
    /// There is a message of a publisher. The one that appeared last counts, and one that it replaced does only when it is
    /// silent. Returns whether the message counts.
    fn receive(&mut self, now: Micros, gid: &str) -> bool {
        match &mut self.current {
            Some((current, last)) if current == gid => *last = now,
            Some((current, last)) => {
                if now.saturating_sub(*last) > SILENT_PUBLISHER {
                    self.replaced.clear();
                } else if self.replaced.contains(gid) {
                    return false;
                } else {
                    self.replaced.insert(current.clone());
                }
                self.current = Some((gid.to_owned(), now));
            }
            None => self.current = Some((gid.to_owned(), now)),
        }
        true
    }
}

/// The number of a message, and the name of its publisher.
fn read_attachment(bytes: &[u8]) -> Option<(i64, Vec<u8>)> {
    let (number, rest) = bytes.split_at_checked(8)?;
    let gid = rest.get(9..).filter(|gid| rest[8] == 16 && gid.len() == 16)?;
    Some((i64::from_le_bytes(number.try_into().ok()?), gid.to_vec()))
}

#[cfg(test)]
mod tests {
    use super::super::samples::promise;
    use super::*;

    /// The key of a text for ROS, and the token of its publisher.
    const KEY: &str = "0/robot/team/std_msgs::msg::dds_::String_/TypeHash";
    const TOKEN: &str = "@ros2_lv/0/x/1/1/MP/%/%/bridge/%robot%team/String";

    fn attachment(number: i64) -> Attachment {
        let bytes = [&number.to_le_bytes()[..], &[0; 8], &[16], &[1; 16]].concat();
        Attachment::new(bytes).unwrap()
    }

    #[test]
    fn an_endpoint_that_is_announced_twice_is_seen() {
        let mut bridged = Bridged::default();
        assert_eq!(bridged.token(TOKEN, true), Ok(()));
        let once = "a bridge announces each of its endpoints once";
        assert_eq!(promise(bridged.token(TOKEN, true)), once);
        assert_eq!(bridged.token(TOKEN, false), Ok(()));
        assert_eq!(promise(bridged.token(TOKEN, false)), once);
    }

    #[test]
    fn messages_without_a_publisher_or_in_another_order_are_seen() {
        let mut bridged = Bridged::default();
        let showed = |bridged: &mut Bridged, key: &str, number: Option<i64>| {
            let attachment = number.map(attachment);
            promise(bridged.showed(0, key, b"", attachment.as_ref()))
        };
        assert_eq!(showed(&mut bridged, KEY, Some(1)), NUMBERED, "no publisher is announced");
        bridged.token(TOKEN, true).unwrap();
        assert_eq!(showed(&mut bridged, KEY, None), NUMBERED, "no number");
        assert_eq!(showed(&mut bridged, KEY, Some(2)), NUMBERED, "the first is 1");
        assert_eq!(showed(&mut bridged, KEY, Some(1)), "ROS can read what it is shown");
    }
}
