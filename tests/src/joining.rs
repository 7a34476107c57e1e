//! A fleet whose robots have a session each, as real ones do, and all join at once: how long until all are divided, and
//! what router and services compute for it.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use muster_client::{Config, Pose, Robot};
use tokio::task::JoinSet;

use crate::latency::robot_name;
use crate::latency::squads::Squads;

/// In how many teams the robots march.
const TEAMS: usize = 4;

/// How often each robot reports where it is, once it has joined.
const REPORT_EVERY: Duration = Duration::from_secs(1);

/// Every so many poses a robot repeats its links and its superior.
const LINKS_EVERY: u64 = 5;

/// How far the robots are.
#[derive(Debug, Default)]
pub struct Progress {
    joined: AtomicUsize,
    failed: Mutex<Option<String>>,
}

impl Progress {
    /// How many robots have joined.
    #[must_use]
    pub fn joined(&self) -> usize {
        self.joined.load(Ordering::Relaxed)
    }

    /// Why the first robot that could not join did not; nothing if all can.
    #[must_use]
    pub fn failed(&self) -> Option<String> {
        self.failed.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Has so many robots join at once, each with a session of its own, and report until the set is dropped.
#[must_use]
pub fn join_all(config: &Config, robots: usize, progress: &Arc<Progress>) -> JoinSet<()> {
    let squads = Arc::new(Squads::new(robots, TEAMS));
    let begin = Instant::now();
    let mut all = JoinSet::new();
    for robot in 0..robots {
        let (config, squads) = (config.clone(), Arc::clone(&squads));
        let progress = Arc::clone(progress);
        all.spawn(async move {
            if let Err(error) = report(&config, robot, &squads, &progress, begin).await {
                let mut failed = progress.failed.lock().unwrap_or_else(PoisonError::into_inner);
                failed.get_or_insert(format!("{}: {error}", robot_name(robot)));
            }
        });
    }
    all
}

async fn report(
    config: &Config,
    number: usize,
    squads: &Squads,
    progress: &Progress,
    begin: Instant,
) -> Result<(), muster_client::Error> {
    let robot = Robot::join(config, &robot_name(number)).await?;
    progress.joined.fetch_add(1, Ordering::Relaxed);
    for turn in 0_u64.. {
        let t = begin.elapsed().as_secs_f64();
        if turn % LINKS_EVERY == 0 {
            let links: Vec<_> = squads
                .links(number, t)
                .into_iter()
                .map(|(peer, quality)| (robot_name(peer), quality))
                .collect();
            robot.put_links(links.iter().map(|(peer, quality)| (peer.as_str(), *quality)))?;
            robot.put_rank(squads.superior(number, t).map(robot_name).as_deref())?;
        }
        let [x, y] = squads.place(number, t);
        robot.put_pose(Pose::at(x, y))?;
        tokio::time::sleep(REPORT_EVERY).await;
    }
    Ok(())
}
