//! Robots of ROS and their bridge, with the core that ships: the bus of ROS, the process of the bridge, and the reader of
//! the fleet that its shell has.
//!
//! Seeds without them are as they would be if there were none: all of it follows from chances of its own.

pub(crate) mod cdr;
mod fault;
mod happen;
mod program;

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use muster_client::{Freshness, Via};
use muster_model::audit::Audit;
use muster_model::bridge::TopicFault;
use muster_model::id::{InstanceId, RobotId};
use muster_model::observation::{CheckedReport, Report};
use muster_model::roster::Roster;
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_ros2::config::{File, Setup};
use muster_ros2::core::{Bridge, Input, Output};
use muster_wire::{Format, Key, Message, Packet};

pub(crate) use fault::{RosFault, ros_plan, ros_robots};
pub(crate) use program::{Ground, RosRobot, RosStream, Said, Sample, WORLD, Way};

use super::chance::{Chance, Purpose};
use super::clock::{HostClock, MS, Micros, SECOND};
use super::link::{State, Way as Direction};
use super::oracle::bridged::{Bridged, Held, ROUNDING_M};
use super::oracle::{GroundTruth, RobotTruth, Verified, breach};
use super::robots::packet;
use super::router::{Answer, BusGet, Carried, LinkId};
use super::world::{Asker, Event, World};

/// How long a reader of the fleet waits for something newer: the default of clients.
const STALE_AFTER: Duration = Duration::from_secs(5);

/// How long a reader waits for the answers to a get.
const GET_TIMEOUT: Micros = SECOND;

/// How often publishers are asked for what they keep, as the shell does.
const ASK_KEPT_EVERY: Micros = 10 * SECOND;

/// How long an answer to that takes.
const KEPT_WITHIN: (Micros, Micros) = (2 * MS, 300 * MS);

/// Most that waits for a process that is stopped: what the buffers of its sockets hold.
const MAX_HELD: usize = 512;

/// Shortest time that a killed bridge is down.
const MIN_DOWN_TIME: Micros = 30 * MS;

/// How long after its begin a bridge has put every robot that nothing disturbs: the two seconds in which transforms may
/// come after odometry, and the longest pauses of both.
const BACK_WITHIN: Micros = 3 * SECOND;

/// Topics of ROS as the bridges of some seeds read them.
const TOPICS: &str = r#"
rate_hz = RATE
[frames]
tf = "TF"
tf_static = "TF_static"
[[pose]]
topic = "/{robot}/odom"
type = "nav_msgs/msg/Odometry"
[[links]]
topic = "/{robot}/neighbours"
type = "own_msgs/msg/Neighbours"
definition = """
Neighbour[] neighbours
================================================================================
MSG: own_msgs/Neighbour
string name
float64 quality
"""
list = "neighbours"
peer = "name"
quality = "quality"
[[rank]]
topic = "/{robot}/superior"
type = "std_msgs/msg/String"
superior = "data"
"#;

/// What happens to the bridge, or to a robot of ROS.
#[derive(Debug)]
pub(crate) enum RosEvent {
    /// The bridge starts.
    Starts,
    /// It is to put what is new.
    Tick { life: u32, at: Micros },
    /// It asks for what publishers keep.
    AsksKept { life: u32 },
    /// A message reaches it.
    Arrives { life: u32, sample: Arc<Sample> },
    /// It is looked at some time after its begin.
    IsLookedAt { life: u32 },
    /// The programs of a robot start.
    RobotStarts { robot: usize },
    /// A program of a robot publishes.
    Publishes { robot: usize, life: u32, stream: RosStream },
    /// So does a second one.
    Second { robot: usize, life: u32, until: Micros },
}

/// The process of the bridge.
#[derive(Debug)]
struct Process {
    core: Bridge,
    teams: Freshness<Teams>,
    audits: Freshness<Audit>,
    rosters: Freshness<Roster>,
    next_tick: Micros,
    began: Micros,
}

/// Everything of ROS.
#[derive(Debug)]
pub(crate) struct Ros {
    setup: Arc<Setup>,
    pub(crate) robots: Vec<RosRobot>,
    process: Option<Process>,
    /// Counts the processes.
    life: u32,
    down_until: Micros,
    paused_until: Micros,
    /// Until when nothing of ROS arrives.
    bus_cut_until: Micros,
    /// What waits for a process that is stopped.
    held: VecDeque<Arc<Sample>>,
    pub(crate) link: LinkId,
    clock: HostClock,
    /// The beginning of the run by a clock that only differences are taken of.
    zero: Instant,
    judge: Bridged,
    chance: Chance,
}

impl Ros {
    /// The robots of ROS of a seed, and their bridge; none if there are none. `link` is that to the fleet, and `natives`
    /// are those that need no bridge.
    pub(crate) fn new(seed: u64, link: LinkId, natives: &[RobotId]) -> Option<Self> {
        let count = ros_robots(seed);
        let mut chance = Chance::new(seed, Purpose::Ros, 1);
        let mut robots: Vec<RosRobot> =
            (0..count).filter_map(|number| RosRobot::new(seed, number)).collect();
        if robots.is_empty() {
            return None;
        }
        let mut topics = TOPICS
            .replace("RATE", if chance.percent(70) { "10.0" } else { "20.0" })
            .replace("TF", if chance.percent(50) { "/{robot}/tf" } else { "/tf" });
        topics.push_str("[ranks]\n");
        for robot in &mut robots {
            robot.superior = chance.pick(natives).filter(|_| chance.percent(50)).cloned();
            if !robot.says_rank {
                let superior = robot.superior.as_ref().map_or("", RobotId::as_str);
                topics.push_str(&format!("{} = \"{superior}\"\n", robot.id));
            }
        }
        #[expect(clippy::expect_used, reason = "a simulation without topics would prove nothing")]
        let setup = toml::from_str::<File>(&topics).expect("this is a file").check();
        #[expect(clippy::expect_used, reason = "a simulation without topics would prove nothing")]
        let setup = Arc::new(setup.expect("these are topics"));
        let offset = i64::try_from(chance.between(0, 6 * SECOND)).unwrap_or_default();
        let ahead = offset - i64::try_from(3 * SECOND).unwrap_or_default();
        Some(Self {
            setup,
            robots,
            process: None,
            life: 0,
            down_until: 0,
            paused_until: 0,
            bus_cut_until: 0,
            held: VecDeque::new(),
            link,
            clock: HostClock { ahead, drift: 0 },
            zero: Instant::now(),
            judge: Bridged::default(),
            chance,
        })
    }

    /// What is on the agenda at first.
    pub(crate) fn agenda(&mut self, storm: Micros) -> Vec<(Micros, RosEvent)> {
        let mut agenda = vec![(self.chance.between(0, SECOND), RosEvent::Starts)];
        for robot in 0..self.robots.len() {
            let late = if self.chance.percent(20) { storm / 2 } else { SECOND };
            let at = self.chance.between(0, late);
            agenda.push((at, RosEvent::RobotStarts { robot }));
        }
        agenda
    }

    fn now(&self, now: Micros) -> Tick {
        self.clock.wall(now)
    }

    fn instant(&self, now: Micros) -> Instant {
        self.zero + Duration::from_micros(now)
    }

    /// Adds the robots that have a way to the world to what is true of the fleet, and what ROS was shown of them.
    pub(crate) fn add_truth<'a>(&'a self, storm: Micros, truth: &mut GroundTruth<'a>) {
        for robot in self.robots.iter().filter(|robot| robot.is_taken()) {
            let Ground { x, y, .. } = robot.place(storm);
            let superior = robot.superior.clone();
            let position = [x, y, 0.0];
            truth.fleet.insert(&robot.id, RobotTruth { position, superior, within: ROUNDING_M });
            let topic = format!("{}/team", robot.name);
            truth.reports.insert(&robot.id, self.judge.reports.get(&topic));
        }
    }

    /// The robots that are not taken are named with their reasons, and what all agree on is what ROS was shown.
    fn check_agreement(&self, division: Option<&Teams>, is_secretive: bool) -> Verified {
        let Some(process) = &self.process else { return Ok(()) };
        let mut state = process.core.state();
        if is_secretive {
            state.refused.clear();
        }
        for robot in self.robots.iter().filter(|robot| robot.runs && !robot.is_taken()) {
            let fault = match robot.way {
                Way::Nowhere => TopicFault::NoChain,
                Way::OtherHash => TopicFault::TypeHash,
                Way::Unnumbered => TopicFault::NoAttachment,
                _ => match state.refused.iter().find(|topic| topic.topic.contains(&robot.name)) {
                    // A bridge that began after that knows of no transform at all.
                    Some(topic) if topic.fault == TopicFault::NoChain => TopicFault::NoChain,
                    _ => TopicFault::OldTransform,
                },
            };
            self.judge.check_named(&state, &robot.name, fault)?;
        }
        let Some(division) = division else { return Ok(()) };
        let shown = self.judge.reports.get("muster/teams");
        if shown.is_some_and(|shown| shown.revision > division.header.revision) {
            return breach("ROS is shown what was published", format!("{shown:?}"));
        }
        Ok(())
    }
}

impl RosRobot {
    /// Whether it belongs to the fleet while nothing changes.
    pub(crate) fn is_taken(&self) -> bool {
        // A transform that is kept does not stop.
        let is_lost = self.silent_until == Micros::MAX && self.way.moves();
        self.runs && self.way.leads() && !is_lost
    }
}

impl World {
    /// Something happens to ROS.
    pub(super) fn ros_event(&mut self, event: RosEvent) {
        let Some(mut ros) = self.ros.take() else { return };
        self.happens_in_ros(&mut ros, event);
        self.ros = Some(ros);
    }

    fn ros_later(&mut self, at: Micros, event: RosEvent) {
        self.schedule(at, Event::Ros(event));
    }

    fn happens_in_ros(&mut self, ros: &mut Ros, event: RosEvent) {
        match event {
            RosEvent::Starts => self.start_bridge(ros),
            RosEvent::Tick { life, at } => {
                let is_due = ros.process.as_ref().is_some_and(|process| process.next_tick == at);
                if ros.life != life || !is_due {
                    return;
                }
                if self.now < ros.paused_until {
                    let at = ros.paused_until;
                    ros.process.iter_mut().for_each(|process| process.next_tick = at);
                    return self.ros_later(at, RosEvent::Tick { life, at });
                }
                self.tick_bridge(ros);
            }
            RosEvent::AsksKept { life } => {
                if ros.life == life && ros.process.is_some() {
                    if self.now >= ros.paused_until {
                        self.ask_kept(ros);
                    }
                    self.ros_later(self.now + ASK_KEPT_EVERY, RosEvent::AsksKept { life });
                }
            }
            RosEvent::Arrives { life, sample } if ros.life == life => self.sample(ros, sample),
            RosEvent::Arrives { .. } => {}
            RosEvent::IsLookedAt { life } if ros.life == life => self.look_at_bridge(ros),
            RosEvent::IsLookedAt { .. } => {}
            RosEvent::RobotStarts { robot } => self.start_ros_robot(ros, robot),
            RosEvent::Publishes { robot, life, stream } => {
                self.ros_robot_publishes(ros, robot, life, stream);
            }
            RosEvent::Second { robot, life, until } => {
                if ros.robots[robot].life == life && ros.robots[robot].runs && self.now < until {
                    let moved = self.now.min(self.storm_ends());
                    self.publish_in_ros(ros, robot, moved, RosStream::Odometry, true);
                    let at = self.now + ros.robots[robot].periods[0];
                    self.ros_later(at, RosEvent::Second { robot, life, until });
                }
            }
        }
    }

    fn start_bridge(&mut self, ros: &mut Ros) {
        if ros.process.is_some() {
            return;
        }
        let wait = ros.down_until.max(self.links[ros.link].cut_until);
        if wait > self.now {
            return self.ros_later(wait, RosEvent::Starts);
        }
        ros.life += 1;
        ros.paused_until = 0;
        ros.judge = Bridged::default();
        let Ok(instance) = InstanceId::new(format!("ros2-{}", ros.life)) else { return };
        let session = format!("{:032x}", ros.life);
        let now = ros.instant(self.now);
        let process = Process {
            core: Bridge::new(Arc::clone(&ros.setup), &session, &instance),
            teams: Freshness::new(now, STALE_AFTER, true),
            audits: Freshness::new(now, STALE_AFTER, true),
            rosters: Freshness::new(now, STALE_AFTER, true),
            next_tick: self.now,
            began: self.now,
        };
        self.log.line(self.now, format_args!("the bridge to ROS starts"));
        self.links[ros.link].state = State::Up;
        let outputs = process.core.start();
        ros.process = Some(process);
        self.bridge_orders(ros, outputs);
        let (life, at) = (ros.life, self.now);
        if !self.mutator.stays_away() {
            self.ros_later(at, RosEvent::Tick { life, at });
        }
        self.ros_later(at, RosEvent::AsksKept { life });
        self.ros_later(at + BACK_WITHIN, RosEvent::IsLookedAt { life });
    }

    /// The bridge puts what is new, as its shell lets it: after it has looked at the newest division.
    fn tick_bridge(&mut self, ros: &mut Ros) {
        let (now, instant) = (ros.now(self.now), ros.instant(self.now));
        let every = Micros::try_from(ros.setup.every.as_micros()).unwrap_or(100 * MS);
        let Some(process) = &mut ros.process else { return };
        process.next_tick = self.now + every;
        let at = process.next_tick;
        let mut inputs = Vec::new();
        process.teams.advance(instant);
        if let Some(latest) = process.teams.latest() {
            inputs.push(Input::Teams(Arc::clone(&latest.value), latest.is_stale()));
        }
        process.audits.advance(instant);
        process.rosters.advance(instant);
        inputs.push(Input::Tick);
        let gets = [
            (Key::Teams, process.teams.take_get(instant)),
            (Key::Audit, process.audits.take_get(instant)),
            (Key::Roster, process.rosters.take_get(instant)),
        ];
        for input in inputs {
            let outputs = ros.process.as_mut().map(|process| process.core.handle(now, input));
            self.bridge_orders(ros, outputs.unwrap_or_default());
        }
        let life = ros.life;
        for (key, _) in gets.into_iter().filter(|(_, is_due)| *is_due) {
            let selector = self.space.format(&key);
            let asked = BusGet { selector, parameters: "format=bincode", payload: None };
            self.get(ros.link, asked, GET_TIMEOUT, Asker::RosBridge(life));
        }
        self.ros_later(at, RosEvent::Tick { life, at });
        self.check_bridge_memory(ros);
    }

    fn check_bridge_memory(&mut self, ros: &mut Ros) {
        let Some(process) = &ros.process else { return };
        let held = process.core.memory_use();
        let mut held = Held {
            robots: held.robots,
            topics: held.topics,
            frames: held.frames,
            refusals: held.refusals,
        };
        held.topics += self.mutator.hoards_topics();
        let checked = ros.judge.check_held(self.now, held);
        self.require(checked);
    }

    /// Asks for what publishers keep.
    fn ask_kept(&mut self, ros: &mut Ros) {
        let life = ros.life;
        let kept: Vec<Arc<Sample>> = ros
            .robots
            .iter()
            .filter(|robot| robot.runs)
            .flat_map(|robot| robot.kept.values().cloned())
            .collect();
        for sample in kept {
            let at = self.now + ros.chance.between(KEPT_WITHIN.0, KEPT_WITHIN.1);
            if at >= ros.bus_cut_until {
                self.ros_later(at, RosEvent::Arrives { life, sample });
            }
        }
    }

    /// A message of ROS reaches the process.
    fn sample(&mut self, ros: &mut Ros, sample: Arc<Sample>) {
        // What was put while no process ran does not wait for the next one.
        if self.now < ros.bus_cut_until || ros.process.is_none() {
            return;
        }
        if self.now < ros.paused_until {
            if ros.held.len() < MAX_HELD {
                ros.held.push_back(sample);
                let (life, at) = (ros.life, ros.paused_until);
                // What waits is taken in its order, before anything that comes later.
                if ros.held.len() == 1
                    && let Some(first) = ros.held.front().cloned()
                {
                    self.ros_later(at, RosEvent::Arrives { life, sample: first });
                }
            }
            return;
        }
        // The first of those that wait is the one that arrives again.
        let waiting = std::mem::take(&mut ros.held);
        let is_first = waiting.front().is_some_and(|first| Arc::ptr_eq(first, &sample));
        let mut all: Vec<Arc<Sample>> = waiting.into_iter().collect();
        if !is_first {
            all.push(sample);
        }
        let now = ros.now(self.now);
        for sample in all {
            ros.judge.delivered(self.now, &sample);
            let Some(process) = &mut ros.process else { return };
            let input = Input::Sample(sample.source, sample.packet.clone());
            let outputs = process.core.handle(now, input);
            self.bridge_orders(ros, outputs);
        }
    }

    /// The router passes something on that the bridge reads.
    pub(super) fn pass_to_bridge(&mut self, carried: &Carried, packet: &Packet) {
        let Some(ros) = &self.ros else { return };
        let read = [Key::Teams, Key::Audit, Key::Roster].map(|key| self.space.format(&key));
        if read.contains(&packet.key) && ros.process.is_some() {
            self.send(ros.link, Direction::Down, carried);
        }
    }

    /// Something of the fleet has reached the bridge.
    pub(super) fn bridge_receives(&mut self, packets: &[Packet], via: Via) {
        let Some(mut ros) = self.ros.take() else { return };
        let (now, instant) = (ros.now(self.now), ros.instant(self.now));
        for packet in packets {
            // The reader of a process that is stopped gets it when it continues, from its link or by its next get.
            let Some(process) = ros.process.as_mut().filter(|_| self.now >= ros.paused_until)
            else {
                break;
            };
            // No one believes what cannot be read.
            let Ok(message) = Message::decode(&self.space, packet) else { continue };
            let input = match message {
                Message::Teams { teams, .. } => {
                    ros.judge.division(self.now, teams.header.revision, via);
                    let teams = teams.as_ref().clone();
                    let is_new = process.teams.receive(instant, teams, via);
                    let latest = process.teams.latest().filter(|_| is_new);
                    latest.map(|new| Input::Teams(Arc::clone(&new.value), new.is_stale()))
                }
                Message::Audit(audit) => {
                    let is_new = process.audits.receive(instant, audit.as_ref().clone(), via);
                    let latest = process.audits.latest().filter(|_| is_new);
                    latest.map(|new| Input::Audit(Arc::clone(&new.value)))
                }
                Message::Roster(roster) => {
                    let is_new = process.rosters.receive(instant, roster.as_ref().clone(), via);
                    let latest = process.rosters.latest().filter(|_| is_new);
                    latest.map(|new| Input::Roster(Arc::clone(&new.value)))
                }
                _ => None,
            };
            let outputs = input.map(|input| process.core.handle(now, input));
            self.bridge_orders(&mut ros, outputs.unwrap_or_default());
        }
        self.ros = Some(ros);
    }

    /// A get of the bridge is answered.
    pub(super) fn bridge_answered(&mut self, life: u32, answers: &[Arc<Answer>]) {
        if self.ros.as_ref().is_some_and(|ros| ros.life == life) {
            for packets in answers.iter().filter_map(|answer| answer.packets()) {
                self.bridge_receives(packets, Via::Reply);
            }
        }
    }

    /// The link of the bridge is lost or back.
    pub(super) fn bridge_link_changed(&mut self, is_up: bool) {
        let Some(mut ros) = self.ros.take() else { return };
        let (now, instant) = (ros.now(self.now), ros.instant(self.now));
        let changed = ros.process.as_mut().and_then(|process| {
            process.audits.set_link(instant, is_up);
            process.rosters.set_link(instant, is_up);
            let is_new = process.teams.set_link(instant, is_up);
            let latest = process.teams.latest().filter(|_| is_new)?;
            let input = Input::Teams(Arc::clone(&latest.value), latest.is_stale());
            Some(process.core.handle(now, input))
        });
        self.bridge_orders(&mut ros, changed.unwrap_or_default());
        self.ros = Some(ros);
    }

    /// What the core of the bridge orders is done, and judged.
    fn bridge_orders(&mut self, ros: &mut Ros, outputs: Vec<Output>) {
        for output in outputs {
            let checked = match output {
                Output::Report(robot, report) => self.bridge_reports(ros, robot, report),
                Output::Publish { key, payload, attachment } => {
                    let payload = self.mutator.shown_to_ros(&key, payload);
                    ros.judge.showed(self.now, &key, &payload, attachment.as_ref())
                }
                Output::Declare(text) => ros.judge.token(&text, true),
                Output::Withdraw(text) => ros.judge.token(&text, false),
                Output::Refused(refusal) => {
                    let line =
                        format_args!("the bridge refuses {}: {}", refusal.key, refusal.reason);
                    self.log.line(self.now, line);
                    Ok(())
                }
                Output::Shift(seconds) => {
                    self.shift_bridge(ros, seconds);
                    Ok(())
                }
            };
            self.require(checked);
        }
    }

    fn bridge_reports(&mut self, ros: &mut Ros, robot: RobotId, report: Report) -> Verified {
        let Some(report) = self.mutator.bridged(&robot, report) else { return Ok(()) };
        self.stats.bridged += 1;
        ros.judge.reported(self.now, &robot, &report)?;
        let report = match CheckedReport::new(robot.clone(), report) {
            Ok(report) => report,
            Err(error) => return breach("a bridge puts what a fleet takes", format!("{error}")),
        };
        if let Some(packet) = packet(&self.space, &Message::Report(report), Format::Binary) {
            self.put(ros.link, packet);
        }
        Ok(())
    }

    /// The next tick comes later, or sooner.
    fn shift_bridge(&mut self, ros: &mut Ros, seconds: f64) {
        let life = ros.life;
        let Some(process) = &mut ros.process else { return };
        let shift = Duration::from_secs_f64(seconds.abs()).as_micros();
        let shift = i64::try_from(shift).unwrap_or_default();
        let shift = if seconds < 0.0 { -shift } else { shift };
        let at = process.next_tick.saturating_add_signed(shift).max(self.now);
        process.next_tick = at;
        self.ros_later(at, RosEvent::Tick { life, at });
    }

    /// Some time after its begin, a bridge has put each robot that nothing disturbs.
    fn look_at_bridge(&mut self, ros: &mut Ros) {
        let Some(process) = &ros.process else { return };
        let began = process.began;
        let is_disturbed = ros.paused_until > began || ros.bus_cut_until > began;
        let late = ros.robots.iter().filter(|robot| robot.is_taken()).find(|robot| {
            robot.disturbed_until < began
                && ros.judge.last_pose(&robot.id).is_none_or(|last| last < began)
        });
        if let (false, Some(robot)) = (is_disturbed, late) {
            let promise = "a bridge that starts again puts each robot within 3 s";
            let seen = format!("{} is not put", robot.name);
            self.require(breach(promise, seen));
        }
    }

    /// The agreement of ROS at the end of a run.
    pub(super) fn check_ros(&mut self) {
        let teams = self.oracle.divisions.last().map(|teams| &**teams);
        let is_secretive = self.mutator.is_secretive();
        let ros = self.ros.as_ref();
        let checked = ros.map_or(Ok(()), |ros| ros.check_agreement(teams, is_secretive));
        self.require(checked);
    }
}
