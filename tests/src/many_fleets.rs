//! Many fleets on one host: what `muster up --fleets` takes for them, and how often and how late it divides each.
//!
//! The robots of fifty fleets share a session and put by declared publishers, as `muster robot` does, each in its
//! turn. A sample of the fleets is listened to; how often all of them are divided, the host itself counts.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context;
use serde_json::json;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::pubsub::Publisher;

use crate::client::Client;
use crate::latency::drive::pose_json;
use crate::latency::squads::Squads;
use crate::latency::{now_us, robot_name};

/// Fleets whose robots share a session: fewer would cost the machine more than the services do.
const FLEETS_PER_SESSION: usize = 50;

/// Fleets that are listened to.
const SAMPLED_FLEETS: usize = 20;

/// Every so many poses, and at the first, a robot reports its links.
const LINKS_EVERY: u64 = 5;

/// Every so many poses, and at the first, a robot repeats its rank.
const RANK_EVERY: u64 = 10;

/// Shortest sleep between two robots.
const MIN_SLEEP: Duration = Duration::from_micros(500);

/// In how many teams the robots of a fleet march.
const TEAMS: usize = 2;

/// What is driven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Load {
    /// How many fleets.
    pub fleets: usize,
    /// How many robots each of them has.
    pub robots: usize,
    /// Poses per second of each robot.
    pub rate_hz: f64,
}

impl std::str::FromStr for Load {
    type Err = String;

    /// Reads `FLEETSxROBOTS@HZ`.
    fn from_str(text: &str) -> Result<Self, String> {
        let read = || {
            let (fleets, rest) = text.split_once('x')?;
            let (robots, rate) = rest.split_once('@')?;
            let load = Self {
                fleets: fleets.parse().ok()?,
                robots: robots.parse().ok()?,
                rate_hz: rate.parse().ok()?,
            };
            let is_fit = (1..=5000).contains(&load.fleets)
                && load.robots <= 5000
                && (load.robots == 0 || (0.1..=50.0).contains(&load.rate_hz));
            is_fit.then_some(load)
        };
        read().ok_or_else(|| "write FLEETSxROBOTS@HZ, such as 60x10@5 or 100x0@0".to_owned())
    }
}

/// The name of a fleet.
#[must_use]
pub fn fleet_name(fleet: usize) -> String {
    format!("load-{fleet:04}")
}

/// What was received of the sampled fleets.
#[derive(Debug, Default)]
pub struct Received {
    ages: Mutex<Vec<f64>>,
    is_measured: AtomicBool,
}

impl Received {
    /// Ages count from now on.
    pub fn begin(&self) {
        self.is_measured.store(true, Ordering::Relaxed);
    }

    /// The ages of the data behind all divisions that were received, in seconds.
    #[must_use]
    pub fn ages(&self) -> Vec<f64> {
        self.ages.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Listens to the divisions of some of the fleets.
///
/// # Errors
/// If the router does not answer.
pub async fn listen(
    endpoint: &str,
    load: Load,
    received: &Arc<Received>,
) -> anyhow::Result<Vec<Client>> {
    let mut clients = Vec::new();
    let step = load.fleets.div_ceil(SAMPLED_FLEETS).max(1);
    for fleet in (0..load.fleets).step_by(step) {
        let client = Client::connect(endpoint, &fleet_name(fleet)).await?;
        let received = Arc::clone(received);
        let arrived = move |_, value: serde_json::Value| {
            if received.is_measured.load(Ordering::Relaxed)
                && let Some(age) = value["data_age_s"].as_f64()
            {
                received.ages.lock().unwrap_or_else(PoisonError::into_inner).push(age);
            }
        };
        client.listen("json/teams", arrived).await?;
        clients.push(client);
    }
    Ok(clients)
}

/// Robots that report until they are stopped.
#[derive(Debug)]
pub struct Robots {
    stop: Arc<AtomicBool>,
    threads: Vec<std::thread::JoinHandle<anyhow::Result<()>>>,
}

impl Robots {
    /// Makes the robots fall silent and leave.
    ///
    /// # Errors
    /// If they could not report.
    pub fn stop(self) -> anyhow::Result<()> {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads {
            thread.join().map_err(|_| anyhow::anyhow!("a thread of robots has panicked"))??;
        }
        Ok(())
    }
}

struct Fleet {
    /// Of each robot, by its number: pose, links and rank.
    publishers: Vec<[Publisher<'static>; 3]>,
    squads: Squads,
    phase: f64,
}

/// Starts the robots of all fleets, so many a second.
///
/// # Errors
/// If the router does not answer.
pub async fn drive(endpoint: &str, load: Load, join_hz: f64) -> anyhow::Result<Robots> {
    let stop = Arc::new(AtomicBool::new(false));
    let mut threads = Vec::new();
    if load.robots == 0 {
        return Ok(Robots { stop, threads });
    }
    let fleets: Vec<usize> = (0..load.fleets).collect();
    for some in fleets.chunks(FLEETS_PER_SESSION) {
        let first = Client::connect_for_many(endpoint, &fleet_name(0)).await?;
        let some: Vec<usize> = some.to_vec();
        let stop = Arc::clone(&stop);
        let share = join_hz * some.len() as f64 / load.fleets as f64;
        let reporting = move || report(&first, &some, load, share, &stop);
        threads.push(std::thread::Builder::new().name("robots".to_owned()).spawn(reporting)?);
    }
    Ok(Robots { stop, threads })
}

/// Reports of the robots of some fleets, each in its turn, until the stop.
fn report(
    client: &Client,
    fleets: &[usize],
    load: Load,
    join_hz: f64,
    stop: &AtomicBool,
) -> anyhow::Result<()> {
    let session = client.session();
    let period = 1.0 / load.rate_hz;
    let boot = format!("{:x}", now_us());
    let mut joined: Vec<Fleet> = Vec::new();
    let mut tokens = Vec::new();
    for fleet in fleets {
        let mut publishers = Vec::new();
        for robot in (0..load.robots).map(robot_name) {
            let begin = Instant::now();
            let key = |tail: &str| format!("muster/v1/{}/robot/{robot}{tail}", fleet_name(*fleet));
            let failed = |error: zenoh::Error| anyhow::anyhow!("{robot}: {error}");
            tokens.push(session.liveliness().declare_token(key("")).wait().map_err(failed)?);
            let declared = |tail: &str| {
                let publisher = session.declare_publisher(key(tail));
                publisher.encoding(Encoding::APPLICATION_JSON).wait().map_err(failed)
            };
            publishers.push([declared("/pose")?, declared("/links")?, declared("/rank")?]);
            if stop.load(Ordering::Relaxed) {
                return Ok(());
            }
            let rest = Duration::from_secs_f64(1.0 / join_hz).saturating_sub(begin.elapsed());
            std::thread::sleep(rest);
        }
        // As robots do, which read what team they are in.
        let teams = format!("muster/v1/{}/robot/*/team", fleet_name(*fleet));
        let read = session.declare_subscriber(teams).callback(|_| ()).background();
        read.wait().map_err(|error| anyhow::anyhow!("{error}"))?;
        // Neither all fleets nor all robots report in the same moment.
        let phase = period * (*fleet as f64 / load.fleets as f64);
        joined.push(Fleet { publishers, squads: Squads::new(load.robots, TEAMS), phase });
    }
    let mut turns: Vec<(f64, usize, usize)> = Vec::new();
    for (at, fleet) in joined.iter().enumerate() {
        for robot in 0..load.robots {
            let phase = fleet.phase + period * robot as f64 / load.robots as f64;
            turns.push((phase % period, at, robot));
        }
    }
    turns.sort_by(|left, right| left.0.total_cmp(&right.0));
    let begin = Instant::now();
    for round in 0_u64.. {
        for (phase, at, robot) in &turns {
            let due = begin + Duration::from_secs_f64(period * round as f64 + phase);
            let now = Instant::now();
            if due > now + MIN_SLEEP {
                std::thread::sleep(due - now);
            }
            if stop.load(Ordering::Relaxed) {
                return Ok(());
            }
            let fleet = joined.get(*at).context("a fleet is missing")?;
            put(fleet, *robot, round, begin.elapsed().as_secs_f64(), &boot)?;
        }
    }
    Ok(())
}

/// The reports of a robot that are due.
fn put(fleet: &Fleet, robot: usize, round: u64, t: f64, boot: &str) -> anyhow::Result<()> {
    let Some([pose, links, rank]) = fleet.publishers.get(robot) else { return Ok(()) };
    let put = |publisher: &Publisher<'static>, payload: String| {
        let put = publisher.put(payload).wait();
        put.map_err(|error| anyhow::anyhow!("{}: {error}", publisher.key_expr()))
    };
    let turn = round + robot as u64;
    if round == 0 || turn.is_multiple_of(LINKS_EVERY) {
        let all = fleet.squads.links(robot, t).into_iter();
        let all: Vec<_> = all
            .map(|(peer, quality)| json!({"peer": robot_name(peer), "quality": quality}))
            .collect();
        put(links, json!({"links": all, "boot": boot, "seq": round}).to_string())?;
    }
    if round == 0 || turn.is_multiple_of(RANK_EVERY) {
        let superior = fleet.squads.superior(robot, t).map(robot_name);
        put(rank, json!({"superior": superior, "boot": boot, "seq": round}).to_string())?;
    }
    put(pose, pose_json(fleet.squads.place(robot, t), round, boot, now_us()))
}

/// Of the text of `/metrics`: the sum of a metric of one service over all fleets.
#[must_use]
pub fn sum_of(metrics: &str, name: &str, service: &str) -> f64 {
    let label = format!("service=\"{service}\"");
    metrics
        .lines()
        .filter(|line| line.starts_with(name) && line[name.len()..].starts_with('{'))
        .filter(|line| line.contains(&label))
        .filter_map(|line| line.rsplit(' ').next()?.parse::<f64>().ok())
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_load_is_read_as_it_is_written() {
        let load: Load = "60x10@5".parse().unwrap();
        assert_eq!(load, Load { fleets: 60, robots: 10, rate_hz: 5.0 });
        assert!("100x0@0".parse::<Load>().is_ok());
        for wrong in ["", "60", "60x10", "0x10@1", "60x10@0", "60x-1@1", "9999x1@1"] {
            assert!(wrong.parse::<Load>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_metric_is_summed_over_fleets_and_not_over_its_namesakes() {
        let text = "muster_epoch{fleet=\"a\",service=\"clusterer\"} 3\n\
                    muster_epoch{fleet=\"a\",service=\"ingest\"} 9\n\
                    muster_epoch_other{fleet=\"a\",service=\"clusterer\"} 50\n\
                    muster_epoch{fleet=\"b\",service=\"clusterer\"} 4\n";
        assert_eq!(sum_of(text, "muster_epoch", "clusterer"), 7.0);
    }
}
