//! What the robots of a mission report, each at its own moments.

use muster_model::id::RobotId;
use muster_model::observation::{CheckedReport, Link, Links, Pose, Rank, Report};
use muster_wire::Message;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::chance::normal_pair;
use super::faults::{Fault, LATE_S, Mask, Sense};
use super::mission::Mission;
use super::radio::Air;
use crate::formations::Radio;

/// Steps of time in a second.
pub const STEPS_HZ: u64 = 50;

/// Steps from one pose of a robot to the next: 10 times a second.
pub const POSE_STEPS: u64 = 5;

/// Steps from one report of links to the next: twice a second.
const LINK_STEPS: u64 = 25;

/// Steps from one report of a rank to the next, if it has not changed: once a second.
const RANK_STEPS: u64 = 50;

/// The robots of a mission as they report.
#[derive(Debug)]
pub struct Reports<'a> {
    mission: &'a Mission,
    radio: Radio,
    fault: Option<(Sense, Fault)>,
    mask: Mask,
    chance: ChaCha8Rng,
    /// The superior that each robot reported last.
    reported_superiors: Vec<Option<Option<usize>>>,
    /// Which robots have fallen silent, so that their tokens are gone.
    gone: Vec<bool>,
}

impl<'a> Reports<'a> {
    /// No robot has reported yet. Noise follows from the seed.
    #[must_use]
    pub fn new(
        mission: &'a Mission,
        radio: Radio,
        fault: Option<(Sense, Fault)>,
        seed: u64,
    ) -> Self {
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        chance.set_stream(1);
        let robots = mission.fleet.robots.len();
        let mask = match fault {
            Some((_, Fault::Wrong)) => Mask::shuffled(robots, &mut chance),
            _ => Mask::none(robots),
        };
        let (reported_superiors, gone) = (vec![None; robots], vec![false; robots]);
        Self { mission, radio, fault, mask, chance, reported_superiors, gone }
    }

    /// The tokens with which all robots join.
    pub fn joining(&self) -> impl Iterator<Item = Message> + '_ {
        let robots = self.mission.fleet.robots.iter();
        robots.map(|robot| Message::RobotToken { robot: robot.name.clone(), alive: true })
    }

    /// What is reported in a step, counted from the beginning.
    pub fn step(&mut self, step: u64) -> Vec<Message> {
        let t = step as f64 / STEPS_HZ as f64;
        let late = |sense| match self.fault {
            Some((delayed, Fault::Delayed)) if delayed == sense => (t - LATE_S).max(0.0),
            _ => t,
        };
        let [spatial_t, links_t, ranks_t] = Sense::ALL.map(late);
        let places = self.mission.places(spatial_t);
        let links_places = (links_t != spatial_t).then(|| self.mission.places(links_t));
        let links_places = links_places.as_deref().unwrap_or(&places);
        let air = Air::new(self.mission, self.radio, links_t, links_places);
        let mut messages = Vec::new();
        for robot in 0..places.len() {
            let name = || self.mission.fleet.robots[robot].name.clone();
            if self.mission.is_silent(robot, t) {
                if !std::mem::replace(&mut self.gone[robot], true) {
                    messages.push(Message::RobotToken { robot: name(), alive: false });
                }
                continue;
            }
            let is_due = |every: u64| (step + robot as u64).is_multiple_of(every);
            if !is_due(POSE_STEPS) {
                continue;
            }
            if let Some(of) = self.subject(Sense::Spatial, robot) {
                let error = normal_pair(&mut self.chance).map(|error| error * self.mission.noise_m);
                let at = [0, 1].map(|axis| places[of][axis] + error[axis]);
                messages.extend(report(name(), Pose::at(at[0], at[1])));
            }
            if is_due(LINK_STEPS)
                && let Some(of) = self.subject(Sense::Connectivity, robot)
            {
                let links = air.links(of, &mut self.chance);
                let link = |(peer, quality)| Link {
                    peer: self.mission.fleet.robots[self.named(Sense::Connectivity, peer)]
                        .name
                        .clone(),
                    quality,
                };
                let links = links.into_iter().map(link).collect();
                let links = Links { links, stamp: None, boot: None, seq: None };
                messages.extend(report(name(), links));
            }
            if let Some(of) = self.subject(Sense::Hierarchy, robot) {
                let superior = self.mission.superior(of, ranks_t);
                let superior = superior.map(|superior| self.named(Sense::Hierarchy, superior));
                if is_due(RANK_STEPS) || self.reported_superiors[robot] != Some(superior) {
                    self.reported_superiors[robot] = Some(superior);
                    let superior =
                        superior.map(|superior| self.mission.fleet.robots[superior].name.clone());
                    messages.extend(report(name(), Rank::under(superior)));
                }
            }
        }
        messages
    }

    /// The robot whose state a robot reports; none if the modality is lost.
    fn subject(&self, sense: Sense, robot: usize) -> Option<usize> {
        match self.fault {
            Some((lost, Fault::Lost)) if lost == sense => None,
            Some((wrong, Fault::Wrong)) if wrong == sense => Some(self.mask.of[robot]),
            _ => Some(robot),
        }
    }

    /// The robot that is named where a robot is meant.
    fn named(&self, sense: Sense, meant: usize) -> usize {
        match self.fault {
            Some((wrong, Fault::Wrong)) if wrong == sense => self.mask.named[meant],
            _ => meant,
        }
    }
}

/// The message of a report; none if its content is wrong, which a simulated robot never reports.
fn report(robot: RobotId, report: impl Into<Report>) -> Option<Message> {
    CheckedReport::new(robot, report).ok().map(Message::Report)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;
    use muster_model::observation::Stream;

    use crate::moving::fleet::Fleet;
    use crate::moving::mission::Case;

    fn counts(fault: Option<(Sense, Fault)>, seconds: u64) -> [usize; 4] {
        let mission = Mission::new(Fleet::new(48, 4).unwrap(), Case::Losses, 1);
        let mut reports = Reports::new(&mission, Radio::Range, fault, 1);
        let mut counts = [0; 4];
        for message in (0..seconds * STEPS_HZ).flat_map(|step| reports.step(step)) {
            let kind = match message {
                Message::Report(report) => match report.stream() {
                    Stream::Pose => 0,
                    Stream::Links => 1,
                    Stream::Rank => 2,
                    Stream::Relation(_) => 3,
                },
                _ => 3,
            };
            counts[kind] += 1;
        }
        counts
    }

    #[test]
    fn each_robot_reports_as_often_as_it_should() {
        let [poses, links, ranks, tokens] = counts(None, 2);
        assert_eq!((poses, links, tokens), (48 * 20, 48 * 4, 0));
        // Twice in two seconds, and once more where the first report comes before the first full second.
        assert!((48 * 2..=48 * 3).contains(&ranks), "{ranks}");
    }

    #[test]
    fn lost_modalities_are_not_reported_and_silent_robots_lose_their_tokens() {
        assert_eq!(counts(Some((Sense::Spatial, Fault::Lost)), 1)[0], 0);
        assert_eq!(counts(Some((Sense::Hierarchy, Fault::Lost)), 1)[2], 0);
        assert!(counts(None, 20)[3] > 0);
    }
}
