//! A simulated fleet on a real bus: what robots would put there, at the rates of robots.

use std::time::Duration;

use muster_client::{Client, Error, Report, RobotPublisher};
use muster_model::id::SkillId;
use muster_model::observation::{Links, Rank};
use muster_runtime::stop::Stop;
use muster_scenario::Fleet;
use tokio::time::{Instant, MissedTickBehavior, interval};

/// How often links are reported, in seconds: radios change more slowly than positions.
const LINK_PERIOD_S: f64 = 0.5;

/// How often ranks are reported, in seconds, so that a reader that missed one soon has it.
const RANK_PERIOD_S: f64 = 1.0;

/// Most robots that report in the same moment, as long as there are few groups: their reports fit one batch of the bus.
const GROUP_SIZE: usize = 100;

/// Most groups: where all robots are is computed for each of them.
const MAX_GROUPS: u32 = 10;

/// Some robots of a simulated fleet, joined to the bus.
pub(crate) struct SimulatedRobots {
    fleet: Fleet,
    /// Each with its index in the fleet.
    publishers: Vec<(usize, RobotPublisher)>,
    /// The skills that all of them have.
    skills: Vec<SkillId>,
    /// Robots of a large fleet do not all report in the same moment: those of one group do.
    groups: u32,
}

/// What robots report less often than their poses, and when they do so next, in seconds of the scenario.
struct Slow {
    /// What every robot reports in this turn of all groups; empty if nothing is due.
    links: Vec<Links>,
    ranks: Vec<Rank>,
    links_at: f64,
    ranks_at: f64,
}

impl Slow {
    fn new(from: f64) -> Self {
        Self { links: Vec::new(), ranks: Vec::new(), links_at: from, ranks_at: from }
    }

    /// A turn of all groups begins.
    fn renew(&mut self, fleet: &Fleet, skills: &[SkillId], t: f64) {
        (self.links, self.ranks) = (Vec::new(), Vec::new());
        if t >= self.links_at {
            self.links_at = t + LINK_PERIOD_S;
            self.links = fleet.links(t);
        }
        if t >= self.ranks_at {
            self.ranks_at = t + RANK_PERIOD_S;
            let skills = Some(skills.to_vec()).filter(|skills| !skills.is_empty());
            let ranks = fleet.ranks(t).into_iter();
            self.ranks = ranks.map(|rank| Rank { skills: skills.clone(), ..rank }).collect();
        }
    }
}

impl SimulatedRobots {
    /// Joins robots of a fleet, by their indices.
    ///
    /// # Errors
    /// If the bus refuses a token.
    pub(crate) async fn join(
        client: &Client,
        fleet: Fleet,
        robots: Vec<usize>,
    ) -> Result<Self, Error> {
        let mut publishers = Vec::with_capacity(robots.len());
        for index in robots {
            let robot = fleet.robots()[index].clone();
            publishers.push((index, client.join_as_publisher(robot).await?));
        }
        let wanted = publishers.len().div_ceil(GROUP_SIZE).max(1);
        let groups = u32::try_from(wanted).map_or(MAX_GROUPS, |wanted| wanted.min(MAX_GROUPS));
        Ok(Self { fleet, publishers, skills: Vec::new(), groups })
    }

    /// The same robots with some skills.
    pub(crate) fn with_skills(self, skills: Vec<SkillId>) -> Self {
        Self { skills, ..self }
    }

    /// Reports until it is time to stop, or for some seconds; then leaves. The story of the scenario
    /// starts at `from`, in its seconds.
    ///
    /// # Errors
    /// If a report is too large, or the client was closed.
    pub(crate) async fn run(
        self,
        rate_hz: f64,
        from: f64,
        seconds: Option<f64>,
        mut stop: Stop,
    ) -> Result<(), Error> {
        let mut ticks = interval(Duration::from_secs_f64(1.0 / rate_hz) / self.groups);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let start = Instant::now();
        let mut slow = Slow::new(from);
        for group in (0..self.groups).cycle() {
            tokio::select! {
                _ = ticks.tick() => {}
                () = stop.stopped() => break,
            }
            let elapsed = start.elapsed().as_secs_f64();
            if seconds.is_some_and(|seconds| elapsed > seconds) {
                break;
            }
            let t = from + elapsed;
            if group == 0 {
                slow.renew(&self.fleet, &self.skills, t);
            }
            self.report(group, &self.fleet.poses(t), Report::Pose)?;
            self.report(group, &slow.links, Report::Links)?;
            self.report(group, &slow.ranks, Report::Rank)?;
        }
        for (_, publisher) in self.publishers {
            publisher.leave().await;
        }
        Ok(())
    }

    /// Reports of the robots of a group, if there are any reports.
    fn report<T: Clone>(
        &self,
        group: u32,
        all: &[T],
        report: fn(T) -> Report,
    ) -> Result<(), Error> {
        let of_group = self.publishers.iter().skip(group as usize).step_by(self.groups as usize);
        for (index, publisher) in of_group {
            if let Some(one) = all.get(*index) {
                publisher.put(report(one.clone()))?;
            }
        }
        Ok(())
    }
}
