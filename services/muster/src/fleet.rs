//! A simulated fleet on a real bus: what robots would put there, at the rates of robots.

use std::time::Duration;

use muster_client::{Client, Error, Report, RobotPublisher};
use muster_model::id::SkillId;
use muster_model::observation::{Links, Pose, Rank};
use muster_runtime::stop::Stop;
use muster_scenario::Fleet;
use tokio::time::{Instant, MissedTickBehavior, interval};

/// How often links are reported, in seconds: radios change more slowly than positions.
const LINK_PERIOD_S: f64 = 0.5;

/// How often ranks are reported, in seconds, so that a reader that missed one soon has it.
const RANK_PERIOD_S: f64 = 1.0;

/// Some robots of a simulated fleet, joined to the bus.
pub(crate) struct SimulatedRobots {
    fleet: Fleet,
    /// Each with its index in the fleet.
    publishers: Vec<(usize, RobotPublisher)>,
    /// The skills that all of them have.
    skills: Vec<SkillId>,
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
        Ok(Self { fleet, publishers, skills: Vec::new() })
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
        let mut ticks = interval(Duration::from_secs_f64(1.0 / rate_hz));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let start = Instant::now();
        let (mut links_at, mut ranks_at) = (from, from);
        loop {
            tokio::select! {
                _ = ticks.tick() => {}
                () = stop.stopped() => break,
            }
            let elapsed = start.elapsed().as_secs_f64();
            if seconds.is_some_and(|seconds| elapsed > seconds) {
                break;
            }
            let t = from + elapsed;
            let poses: Vec<Pose> = self.fleet.poses(t);
            self.report(&poses, Report::Pose)?;
            if t >= links_at {
                links_at = t + LINK_PERIOD_S;
                let links: Vec<Links> = self.fleet.links(t);
                self.report(&links, Report::Links)?;
            }
            if t >= ranks_at {
                ranks_at = t + RANK_PERIOD_S;
                let skills = Some(self.skills.clone()).filter(|skills| !skills.is_empty());
                let ranks = self.fleet.ranks(t).into_iter();
                let ranks: Vec<Rank> =
                    ranks.map(|rank| Rank { skills: skills.clone(), ..rank }).collect();
                self.report(&ranks, Report::Rank)?;
            }
        }
        for (_, publisher) in self.publishers {
            publisher.leave().await;
        }
        Ok(())
    }

    fn report<T: Clone>(&self, all: &[T], report: fn(T) -> Report) -> Result<(), Error> {
        for (index, publisher) in &self.publishers {
            publisher.put(report(all[*index].clone()))?;
        }
        Ok(())
    }
}
