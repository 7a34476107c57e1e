//! What robots of ROS do, and what goes wrong with them and with their bridge.

use std::sync::Arc;

use super::fault::RosRubbish;
use super::program::{attachment, key};
use super::*;
use crate::simulation::link::Storm;

/// Between two messages with links; superiors are said once, and kept.
const LINKS_EVERY: Micros = SECOND;

/// For how long after a fault a robot may still be late: what is under way, the next message, and one that was asked for.
const AFTERWARDS: Micros = SECOND;

impl World {
    pub(super) fn start_ros_robot(&mut self, ros: &mut Ros, index: usize) {
        let robot = &mut ros.robots[index];
        if robot.runs {
            return;
        }
        robot.start();
        robot.disturbed_until = robot.disturbed_until.max(self.now + AFTERWARDS);
        let (life, leads) = (robot.life, robot.way.leads());
        let (has_links, says_rank) = (robot.has_links && leads, robot.says_rank && leads);
        let line = format_args!("{} of ROS starts, {:?}", robot.name, robot.way);
        self.log.line(self.now, line);
        let streams = [
            (RosStream::Odometry, true),
            (RosStream::Transforms, true),
            (RosStream::Static, true),
            (RosStream::Links, has_links),
            (RosStream::Rank, says_rank),
        ];
        for (stream, _) in streams.into_iter().filter(|(_, is_said)| *is_said) {
            let at = self.now + ros.chance.between(MS, 200 * MS);
            self.ros_later(at, RosEvent::Publishes { robot: index, life, stream });
        }
    }

    pub(super) fn ros_robot_publishes(
        &mut self,
        ros: &mut Ros,
        index: usize,
        life: u32,
        stream: RosStream,
    ) {
        let robot = &ros.robots[index];
        if robot.life != life || !robot.runs {
            return;
        }
        let is_silent = stream == RosStream::Transforms && self.now < robot.silent_until;
        // A robot without a localisation says nothing else either: that would make it present.
        let is_over = stream == RosStream::Links && !robot.has_links;
        if !is_silent && !is_over {
            let moved = self.now.min(self.storm_ends());
            self.publish_in_ros(ros, index, moved, stream, false);
        }
        let every = match stream {
            RosStream::Odometry => ros.robots[index].periods[0],
            RosStream::Transforms => ros.robots[index].periods[1],
            RosStream::Links => LINKS_EVERY,
            RosStream::Static | RosStream::Rank => return,
        };
        let event = RosEvent::Publishes { robot: index, life, stream };
        self.ros_later(self.now + every, event);
    }

    /// A program publishes something, which crosses the bus of ROS as well as its link does.
    pub(super) fn publish_in_ros(
        &mut self,
        ros: &mut Ros,
        index: usize,
        moved: Micros,
        stream: RosStream,
        is_second: bool,
    ) {
        let setup = Arc::clone(&ros.setup);
        let robot = &mut ros.robots[index];
        if let Some(sample) = robot.publish(&setup, self.now, moved, stream, is_second) {
            self.cross_ros(ros, index, &sample);
        }
    }

    fn cross_ros(&mut self, ros: &mut Ros, index: usize, sample: &Arc<Sample>) {
        let carried = Carried::Put(Arc::new(Packet::put("", "", Vec::new())));
        let link = &mut ros.robots[index].link;
        let arrivals = link.send(self.now, Direction::Up, &carried, &mut self.damage);
        // Only whoever is there when it is put receives it.
        let life = ros.life;
        for at in arrivals {
            self.ros_later(at, RosEvent::Arrives { life, sample: Arc::clone(sample) });
        }
    }

    /// A fault of ROS happens.
    pub(in crate::simulation) fn inject_ros(&mut self, fault: RosFault, chance: &mut Chance) {
        let Some(ros) = &mut self.ros else { return };
        let link = ros.link;
        match fault {
            // The end of a session is reported to the bridge.
            RosFault::Cut { lasts, clean } => self.cut(link, self.now + lasts, clean),
            RosFault::Hang { lasts } => {
                ros.paused_until = ros.paused_until.max(self.now + lasts);
                self.cut(link, self.now + lasts, false);
            }
            _ => {
                let Some(mut ros) = self.ros.take() else { return };
                self.inject_into_ros(&mut ros, fault, chance);
                self.ros = Some(ros);
            }
        }
    }

    fn inject_into_ros(&mut self, ros: &mut Ros, fault: RosFault, chance: &mut Chance) {
        let now = self.now;
        match fault {
            RosFault::Kill { lasts } => {
                ros.down_until = ros.down_until.max(now + lasts.max(MIN_DOWN_TIME));
                if ros.process.take().is_some() {
                    ros.held.clear();
                    // The session ends with the process; the link itself stays as it is.
                    let state = self.links[ros.link].state;
                    self.links[ros.link].end_session();
                    self.links[ros.link].state = state;
                    self.ros_later(ros.down_until, RosEvent::Starts);
                }
            }
            RosFault::Hang { .. } | RosFault::Cut { .. } => {}
            RosFault::Storm { lasts, loss, copies, delay } => {
                self.links[ros.link].storm(bad_weather(now + lasts, loss, copies, delay));
            }
            RosFault::BusCut { lasts } => {
                ros.bus_cut_until = ros.bus_cut_until.max(now + lasts);
                // Once the bus is back, publishers are asked again.
                let life = ros.life;
                let at = now + lasts + chance.between(MS, SECOND / 2);
                self.ros_later(at, RosEvent::AsksKept { life });
            }
            RosFault::Weather { robot, lasts, loss, copies, delay } => {
                let robot = &mut ros.robots[robot];
                robot.link.storm(bad_weather(now + lasts, loss, copies, delay));
                robot.disturb(now + lasts + delay);
            }
            RosFault::Restart { robot: index, lasts } => {
                let robot = &mut ros.robots[index];
                if robot.runs {
                    robot.runs = false;
                    robot.disturb(now + lasts);
                    self.ros_later(now + lasts, RosEvent::RobotStarts { robot: index });
                }
            }
            RosFault::Leave { robot } => {
                let robot = &mut ros.robots[robot];
                robot.runs = false;
                robot.life += 1;
            }
            RosFault::Lost { robot, lasts } => {
                let robot = &mut ros.robots[robot];
                let until = lasts.map_or(Micros::MAX, |lasts| now + lasts);
                robot.silent_until = robot.silent_until.max(until);
                robot.has_links &= until < Micros::MAX || !robot.way.moves();
                robot.disturb(until);
            }
            RosFault::Second { robot: index, lasts } => {
                let robot = &mut ros.robots[index];
                let (life, until) = (robot.life, now + lasts);
                robot.disturb(until + 4 * SECOND);
                self.ros_later(now, RosEvent::Second { robot: index, life, until });
            }
            RosFault::Clock { robot, by } => {
                let clock = &mut ros.robots[robot].clock;
                clock.ahead = clock.ahead.saturating_add(by);
            }
            RosFault::Promote { robot: index, superior } => {
                let superior = superior.and_then(|number| self.robots.all.get(number));
                let superior = superior.map(|robot| robot.name.clone());
                let robot = &mut ros.robots[index];
                // What stands in the file of the bridge does not change.
                if robot.says_rank && robot.runs && robot.way.leads() {
                    robot.superior = superior;
                    self.publish_in_ros(ros, index, now, RosStream::Rank, false);
                }
            }
            RosFault::Rubbish { robot, kind, count } => {
                for number in 0..count {
                    if let Some(sample) = rubbish(ros, chance, robot, kind, number) {
                        let at = now + chance.between(MS, SECOND);
                        let life = ros.life;
                        self.ros_later(at, RosEvent::Arrives { life, sample: Arc::new(sample) });
                    }
                }
            }
        }
    }

    /// All faults of ROS end.
    pub(in crate::simulation) fn calm_ros(&mut self) {
        let Some(mut ros) = self.ros.take() else { return };
        ros.down_until = self.now;
        ros.paused_until = ros.paused_until.min(self.now);
        ros.bus_cut_until = ros.bus_cut_until.min(self.now);
        for robot in &mut ros.robots {
            robot.link.calm();
            if robot.silent_until < Micros::MAX {
                robot.silent_until = robot.silent_until.min(self.now);
            }
        }
        self.start_bridge(&mut ros);
        let life = ros.life;
        self.ros_later(self.now, RosEvent::AsksKept { life });
        self.ros = Some(ros);
    }
}

impl RosRobot {
    /// It is late until a moment, and a little longer.
    fn disturb(&mut self, until: Micros) {
        self.disturbed_until = self.disturbed_until.max(until.saturating_add(AFTERWARDS));
    }
}

impl Way {
    /// Whether it leads by a transform that changes, and so may grow old.
    pub(crate) const fn moves(self) -> bool {
        matches!(self, Self::Localised | Self::OfSite)
    }
}

fn bad_weather(until: Micros, loss: u64, copies: u64, delay: Micros) -> Storm {
    Storm { until, loss, loses_gets: false, copies, delay, reorders: true }
}

/// A message that no bridge may take.
fn rubbish(
    ros: &Ros,
    chance: &mut Chance,
    robot: usize,
    kind: RosRubbish,
    number: usize,
) -> Option<Sample> {
    let name = format!("ghost{robot}x{number}");
    let own = &ros.robots.get(robot)?.name;
    let of = if kind == RosRubbish::Noise { own } else { &name };
    let (source, key) = key(&ros.setup, RosStream::Odometry, of)?;
    let key = match kind {
        RosRubbish::OtherHash => {
            format!("{}RIHS01_{}", &key[..key.rfind("RIHS01_")?], "7".repeat(64))
        }
        _ => key,
    };
    let bytes = match kind {
        RosRubbish::Noise => chance.bytes(number * 5),
        _ => {
            let mut writer = cdr::Writer::new(false);
            writer.header(0, "odom");
            writer.text("base_link");
            writer.doubles(&[1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
            writer.doubles(&[0.0; 36 + 6 + 36]);
            writer.into_bytes()
        }
    };
    let gid = [0x33; 16];
    // On the topic of a robot it has no number, or it would be a second publisher.
    let is_numbered = !matches!(kind, RosRubbish::Unnumbered | RosRubbish::Noise);
    let packet = Packet::put(key, "", bytes);
    let attachment = if is_numbered { attachment(1, 0, gid) } else { None };
    let packet = Packet { attachment, ..packet };
    let gid = "33".repeat(16);
    Some(Sample { robot: None, said: Said::Rubbish, gid, sequence: 1, source, packet })
}
