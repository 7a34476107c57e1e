//! The core: what comes of samples of ROS and of messages of the fleet, without bus and clock.

mod extract;
pub mod frames;
pub mod geometry;
mod intake;
mod outgoing;
mod phase;
mod publishers;
mod refusals;
mod robots;

use std::sync::Arc;
use std::time::Duration;

use muster_model::audit::Audit;
use muster_model::bridge::{BridgeState, MAX_REFUSED_TOPICS, RefusedTopic, TopicFault};
use muster_model::id::{InstanceId, RobotId};
use muster_model::observation::{Rank, Report};
use muster_model::roster::Roster;
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_wire::{Attachment, Packet};

use self::intake::Intake;
use self::outgoing::Outgoing;
use self::phase::Phase;
use self::publishers::Publishers;
pub use self::refusals::Refusal;
use self::refusals::Refusals;
pub use self::robots::Robots;
use crate::config::Setup;

/// How often superiors that never change are put, and what robots have said once and holds, so that services that lost it have it
/// again. An `ingest` that starts waits for about as long until it leads: what comes later would be taken for new orders.
const REPEAT_EVERY: Duration = Duration::from_secs(2);

/// How old the last report of a robot may be whose superior is put: what is put makes the robot present, which transforms
/// and refused poses do not.
const REPORTED_WITHIN: Duration = Duration::from_secs(10);

/// What happens.
#[derive(Debug)]
pub enum Input {
    /// A sample of a source, by its number in the setup.
    Sample(usize, Packet),
    /// What a publisher of a source keeps for those that come late, as it was asked for.
    Kept(usize, Packet),
    /// Time passes. It comes as often as the newest of each robot is put.
    Tick,
    /// The newest division, and whether it may not be valid any more.
    Teams(Arc<Teams>, bool),
    /// The newest audit.
    Audit(Arc<Audit>),
    /// The newest roster.
    Roster(Arc<Roster>),
}

/// What is to be done.
#[derive(Debug, Clone, PartialEq)]
pub enum Output {
    /// Put what a robot reports. Boot and sequence are those of the robot's publisher.
    Report(RobotId, Report),
    /// Put a message of ROS.
    Publish {
        /// The key.
        key: String,
        /// The message in CDR.
        payload: Vec<u8>,
        /// Its number; none with `ros2dds`.
        attachment: Option<Attachment>,
    },
    /// Declare a liveliness token.
    Declare(String),
    /// Withdraw a liveliness token.
    Withdraw(String),
    /// Say why something of ROS is not taken.
    Refused(Refusal),
    /// Let the next tick come so many seconds later, or sooner if that is negative, and those after it from there.
    Shift(f64),
}

/// What has been counted since the start.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Samples that arrived.
    pub received: u64,
    /// Reports that were put.
    pub reported: u64,
    /// Samples that were refused.
    pub refused: u64,
}

/// What is held in memory, in numbers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct MemoryUse {
    /// Robots with a topic that has data.
    pub robots: usize,
    /// Topics of robots.
    pub topics: usize,
    /// Frames with a transform.
    pub frames: usize,
    /// Topics with a reason that applies now.
    pub refusals: usize,
}

/// The bridge between ROS and a fleet.
#[derive(Debug)]
pub struct Bridge {
    setup: Arc<Setup>,
    intake: Intake,
    refusals: Refusals,
    publishers: Publishers,
    outgoing: Outgoing,
    phase: Phase,
    /// Names this run, also in reports that have no publisher's number.
    instance: InstanceId,
    ranks_due: Tick,
    counts: Counts,
}

impl Bridge {
    /// A bridge to which nothing has happened. `session` is the id of the session in ROS, `instance` names this run.
    #[must_use]
    pub fn new(setup: Arc<Setup>, session: &str, instance: &InstanceId) -> Self {
        Self {
            intake: Intake::new(Arc::clone(&setup), instance.to_string()),
            refusals: Refusals::default(),
            publishers: Publishers::new(&setup, session),
            outgoing: Outgoing::default(),
            phase: Phase::default(),
            instance: instance.clone(),
            ranks_due: Tick::default(),
            counts: Counts::default(),
            setup,
        }
    }

    /// What is to be done before anything happens: the tokens of the node and of its publishers.
    #[must_use]
    pub fn start(&self) -> Vec<Output> {
        self.publishers.start()
    }

    /// Handles what happens. `now` is the moment by the clock of this host.
    #[must_use]
    pub fn handle(&mut self, now: Tick, input: Input) -> Vec<Output> {
        match input {
            Input::Sample(source, packet) => self.receive(now, source, packet, false),
            Input::Kept(source, packet) => self.receive(now, source, packet, true),
            Input::Tick => self.tick(now),
            Input::Teams(teams, is_stale) => {
                self.outgoing.set_teams(teams, is_stale);
                self.publish(now, false)
            }
            Input::Audit(audit) => {
                self.outgoing.set_audit(audit);
                Vec::new()
            }
            Input::Roster(roster) => {
                let shift = self.phase.shift(self.setup.every, &roster, self.intake.robots());
                self.outgoing.set_roster(roster);
                shift.map(Output::Shift).into_iter().collect()
            }
        }
    }

    /// What has been counted.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// What this bridge says of itself.
    #[must_use]
    pub fn state(&self) -> BridgeState {
        let topic = |(topic, fault, reason): (&str, TopicFault, &str)| RefusedTopic {
            topic: topic.to_owned(),
            fault,
            reason: reason.to_owned(),
        };
        BridgeState {
            instance: self.instance.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            robots: self.intake.robots().len() as u64,
            received: self.counts.received,
            reported: self.counts.reported,
            refused_topics: self.refusals.len() as u64,
            refused: self.refusals.iter().take(MAX_REFUSED_TOPICS).map(topic).collect(),
        }
    }

    /// What is held in memory.
    #[must_use]
    pub fn memory_use(&self) -> MemoryUse {
        MemoryUse {
            robots: self.intake.robots().len(),
            topics: self.intake.topics(),
            frames: self.intake.frames(),
            refusals: self.refusals.len(),
        }
    }

    /// Robots that ROS has brought lately.
    #[must_use]
    pub fn robots(&self) -> &Robots {
        self.intake.robots()
    }

    /// Takes a sample of a source, as it was put or as its publisher kept it.
    fn receive(&mut self, now: Tick, source: usize, packet: Packet, is_kept: bool) -> Vec<Output> {
        self.counts.received += 1;
        match self.intake.receive(now, source, packet, is_kept) {
            Ok(()) => Vec::new(),
            Err(refused) => self.refuse(now, refused),
        }
    }

    fn tick(&mut self, now: Tick) -> Vec<Output> {
        let mut outputs = Vec::new();
        let (reports, refused) = self.intake.take(now);
        self.counts.reported += reports.len() as u64;
        outputs.extend(reports.into_iter().map(|(robot, report)| Output::Report(robot, report)));
        for refused in refused {
            outputs.extend(self.refuse(now, refused));
        }
        for reading in self.intake.take_readings() {
            outputs.extend(self.publishers.show(reading));
        }
        let mut again = self.intake.repeat(now, REPEAT_EVERY, REPORTED_WITHIN);
        if now >= self.ranks_due && !self.setup.ranks.is_empty() {
            self.ranks_due = now.after(REPEAT_EVERY);
            again.extend(self.ranks(now));
        }
        outputs.extend(again.into_iter().map(|(robot, report)| Output::Report(robot, report)));
        outputs.extend(self.publish(now, true));
        self.refusals.forget(now);
        outputs
    }

    /// Superiors that never change, of the robots that report and do not name theirs themselves.
    fn ranks(&mut self, now: Tick) -> Vec<(RobotId, Report)> {
        let (boot, seq) = (Some(self.instance.to_string()), Some(self.intake.number()));
        let robots = self.intake.robots();
        let there = self.setup.ranks.iter().filter(|(robot, _)| {
            robots.has_reported(now, robot, REPORTED_WITHIN) && !robots.has_rank(robot)
        });
        let rank = |(robot, superior): (&RobotId, &Option<RobotId>)| {
            let rank = Rank { boot: boot.clone(), seq, ..Rank::under(superior.clone()) };
            (robot.clone(), Report::Rank(rank))
        };
        there.map(rank).collect()
    }

    fn publish(&mut self, now: Tick, is_tick: bool) -> Vec<Output> {
        self.outgoing.publish(
            now,
            is_tick,
            &self.setup,
            &mut self.publishers,
            self.intake.robots(),
            &self.refusals,
        )
    }

    fn refuse(&mut self, now: Tick, refused: intake::Refused) -> Vec<Output> {
        self.counts.refused += 1;
        self.refusals.add(now, refused).map(Output::Refused).into_iter().collect()
    }
}
