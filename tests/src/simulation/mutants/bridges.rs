//! Faults of the bridges to ROS and to viewers.

use muster_foxglove::scene::Message;
use muster_model::id::RobotId;
use muster_model::limits::MAX_ROBOT_PAYLOAD;
use muster_model::observation::Report;

use super::{Mutant, Mutator};

/// How far from its place a robot is put.
const MOVED_M: f64 = 0.01;

/// A text of ROS with a higher term of as many digits.
fn with_later_term(mut payload: Vec<u8>) -> Vec<u8> {
    let name = b"\"term\":";
    let at = payload.windows(name.len()).position(|part| part == name);
    if let Some(first) = at.and_then(|at| payload.get_mut(at + name.len())) {
        *first = b'9';
    }
    payload
}

impl Mutator {
    /// What a bridge to ROS puts, as a mutant would.
    pub(crate) fn bridged(&mut self, robot: &RobotId, report: Report) -> Option<Report> {
        let Some(mutant) = self.mutant.filter(|_| self.active) else {
            return Some(report);
        };
        Some(match (mutant, report) {
            (Mutant::Unmoved, Report::Pose(mut pose)) => {
                pose.x += MOVED_M;
                Report::Pose(pose)
            }
            (Mutant::Inert, Report::Pose(pose)) => {
                let first = self.first_poses.entry(robot.clone()).or_insert_with(|| pose.clone());
                let (boot, seq) = (first.boot.clone(), first.seq);
                let mut pose = pose;
                (pose.boot, pose.seq) = (boot, seq);
                Report::Pose(pose)
            }
            (Mutant::Unmannerly, Report::Pose(mut pose)) => {
                pose.frame = Some("x".repeat(MAX_ROBOT_PAYLOAD));
                Report::Pose(pose)
            }
            (_, report) => report,
        })
    }

    /// What viewers draw, as a mutant would have it.
    pub(crate) fn drawn(&self, mut message: Message) -> Message {
        let is_garish = self.is(Mutant::Garish);
        if let Message::Scene(scene) = &mut message
            && is_garish
        {
            let missing = scene.entities.iter_mut().filter(|entity| entity.id == "missing");
            let balls = missing.flat_map(|entity| &mut entity.spheres);
            balls.for_each(|ball| ball.color.g = 0.0);
        }
        message
    }

    /// What ROS is shown, as a mutant would show it: the first division again after others.
    pub(crate) fn shown_to_ros(&mut self, key: &str, payload: Vec<u8>) -> Vec<u8> {
        if self.is(Mutant::Prophetic) {
            return with_later_term(payload);
        }
        if self.mutant != Some(Mutant::Nostalgia) || !key.contains("/team/") {
            return payload;
        }
        if !self.active {
            self.first_shown.entry(key.to_owned()).or_insert_with(|| payload.clone());
            return payload;
        }
        self.published += 1;
        let old = self.first_shown.get(key).filter(|_| self.published.is_multiple_of(3));
        old.cloned().unwrap_or(payload)
    }
}
