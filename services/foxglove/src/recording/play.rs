//! What of a recording is put when: poses, links, ranks and relations of its robots, at the pace that was asked for.

use std::collections::BTreeMap;
use std::io::Read;
use std::ops::ControlFlow;
use std::time::Duration;

use mcap::McapError;
use muster_model::id::{FleetId, RobotId};
use muster_model::limits::MAX_ROBOTS;
use muster_model::observation::{Provenance, Report};
use muster_wire::packet::JSON;
use muster_wire::{KeySpace, Message, Packet};

use super::Entry;
use super::reading::{End, Item, read};

/// How long after its last message a robot leaves, in the time of the recording: about as long as `ingest` takes to notice
/// that one is silent.
const LEAVES_AFTER: Duration = Duration::from_secs(2);

/// What a recording is, known before it is played.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Overview {
    /// The fleet that was recorded, if the file says so.
    pub fleet: Option<FleetId>,
    /// The first and the last moment of a robot, in nanoseconds since 1970.
    pub span: Option<(u64, u64)>,
    /// When each robot was last there.
    pub robots: BTreeMap<RobotId, u64>,
    /// How the file ended.
    pub end: End,
}

/// Reads the keys and reports of a recording.
#[derive(Debug)]
pub struct Reports(KeySpace);

impl Reports {
    /// Reads keys as those of a fleet; recordings have them without one.
    #[must_use]
    pub fn new(fleet: FleetId) -> Self {
        Self(KeySpace::new(fleet))
    }

    /// The report in an entry; none for what is none of a robot, and for what no robot may say.
    #[must_use]
    pub fn of(&self, entry: &Entry<'_>) -> Option<(RobotId, Report)> {
        if !entry.topic.starts_with("/robot/") {
            return None;
        }
        let key = format!("muster/v1/{}{}", self.0.fleet(), entry.topic);
        let packet = Packet::put(key, JSON, entry.bytes);
        let Ok(Message::Report(report)) = Message::decode(&self.0, &packet) else { return None };
        let (robot, report) = report.into_parts();
        // It is said now, whenever it was recorded.
        let provenance = Provenance { stamp: None, boot: None, seq: None };
        Some((robot, report.with_provenance(provenance)))
    }
}

/// Reads a recording once, without playing it.
///
/// # Errors
/// If a file is no recording.
pub fn overview(file: impl Read, reports: &Reports) -> Result<Overview, McapError> {
    let mut overview =
        Overview { fleet: None, span: None, robots: BTreeMap::new(), end: End::Whole };
    overview.end = read(file, |item| {
        match item {
            Item::Facts(facts) => {
                let fleet = facts.get("fleet").and_then(|name| FleetId::new(name).ok());
                overview.fleet = overview.fleet.take().or(fleet);
            }
            Item::Message(entry) => {
                if let Some((robot, _)) = reports.of(&entry)
                    && (overview.robots.len() < MAX_ROBOTS || overview.robots.contains_key(&robot))
                {
                    let (first, last) = overview.span.unwrap_or((entry.at, entry.at));
                    overview.span = Some((first.min(entry.at), last.max(entry.at)));
                    let seen = overview.robots.entry(robot).or_default();
                    *seen = entry.at.max(*seen);
                }
            }
        }
        ControlFlow::Continue(())
    })?;
    Ok(overview)
}

/// One thing that is done.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// A robot says something.
    Put(RobotId, Report),
    /// A robot leaves.
    Leave(RobotId),
}

/// Orders the steps of a recording, each with how long after the begin it is done.
#[derive(Debug)]
pub struct Pace {
    first: u64,
    speed: f64,
    /// Who leaves when, in the time of the recording; the soonest first.
    leaving: BTreeMap<(u64, RobotId), ()>,
    robots: BTreeMap<RobotId, u64>,
}

impl Pace {
    /// The pace of a recording at a speed above 0.
    #[must_use]
    pub fn new(overview: &Overview, speed: f64) -> Self {
        let (first, last) = overview.span.unwrap_or_default();
        let after = u64::try_from(LEAVES_AFTER.as_nanos()).unwrap_or(u64::MAX);
        let leaves = |(robot, seen): (&RobotId, &u64)| {
            let at = seen.saturating_add(after);
            // Who is there to the end stays to the end.
            (at <= last).then(|| ((at, robot.clone()), ()))
        };
        let leaving = overview.robots.iter().filter_map(leaves).collect();
        Self { first, speed, leaving, robots: overview.robots.clone() }
    }

    /// How long after the begin a moment of the recording comes.
    #[must_use]
    pub fn after(&self, at: u64) -> Duration {
        let recorded = Duration::from_nanos(at.saturating_sub(self.first)).as_secs_f64();
        Duration::try_from_secs_f64(recorded / self.speed).unwrap_or(Duration::MAX)
    }

    /// The steps up to a report, in their order: who leaves before it, and the report.
    pub fn steps(&mut self, at: u64, robot: RobotId, report: Report) -> Vec<(Duration, Step)> {
        let mut steps = Vec::new();
        while let Some(entry) = self.leaving.first_entry() {
            if entry.key().0 > at {
                break;
            }
            let ((left, gone), ()) = entry.remove_entry();
            steps.push((self.after(left), Step::Leave(gone)));
        }
        // What is beyond the limit of a fleet was not counted.
        if self.robots.contains_key(&robot) {
            steps.push((self.after(at), Step::Put(robot, report)));
        }
        steps
    }
}

#[cfg(test)]
mod tests {
    use muster_model::observation::Pose;

    use super::*;

    const SECOND: u64 = 1_000_000_000;

    fn robot(name: &str) -> RobotId {
        RobotId::new(name).unwrap()
    }

    #[test]
    fn reports_are_read_as_of_now_and_nothing_else_is() {
        let reports = Reports::new(FleetId::new("f").unwrap());
        let read = |topic: &str, bytes: &[u8]| reports.of(&Entry { topic, at: 0, bytes });
        let pose = br#"{"x": 1.5, "y": 2.0, "stamp": 17.0, "boot": "b", "seq": 4}"#;
        let expected = (robot("r1"), Report::Pose(Pose::at(1.5, 2.0)));
        assert_eq!(read("/robot/r1/pose", pose), Some(expected));
        let links = br#"{"links": [{"peer": "r2", "quality": 0.5}]}"#;
        assert!(matches!(read("/robot/r1/links", links), Some((_, Report::Links(_)))));
        assert!(matches!(
            read("/robot/r1/rank", br#"{"superior": null}"#),
            Some((_, Report::Rank(_)))
        ));
        for (topic, bytes) in [
            ("/robot/r1/pose", &b"{"[..]),
            ("/robot/r1/pose", br#"{"x": 1e300, "y": 0.0}"#),
            ("/robot/R 1/pose", pose),
            ("/robot/r1/team", pose),
            ("/json/teams", pose),
            ("/tf", pose),
            ("", pose),
        ] {
            assert_eq!(read(topic, bytes), None, "{topic}");
        }
    }

    #[test]
    fn robots_leave_after_their_last_message_and_speed_divides_time() {
        let robots = BTreeMap::from([(robot("r1"), SECOND), (robot("r2"), 10 * SECOND)]);
        let overview =
            Overview { fleet: None, span: Some((0, 10 * SECOND)), robots, end: End::Whole };
        let mut pace = Pace::new(&overview, 2.0);
        let pose = || Report::Pose(Pose::at(0.0, 0.0));
        let first = pace.steps(SECOND, robot("r1"), pose());
        assert_eq!(first, [(Duration::from_millis(500), Step::Put(robot("r1"), pose()))]);
        let later = pace.steps(10 * SECOND, robot("r2"), pose());
        assert_eq!(later[0], (Duration::from_millis(1_500), Step::Leave(robot("r1"))));
        assert_eq!(later[1], (Duration::from_secs(5), Step::Put(robot("r2"), pose())));
        assert_eq!(later.len(), 2, "r2 is there to the end");
        assert!(pace.steps(10 * SECOND, robot("r3"), pose()).is_empty(), "it was not counted");
    }
}
