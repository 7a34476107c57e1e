//! The physical case through the real services: a router, the four services and ten robots in one process, each
//! with a session of its own over a real socket, as in `muster demo`. What counts is the teams that robots receive.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::Context as _;
use muster_auditor::Auditor;
use muster_client::{Config, Pose, Robot};
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_ingest::Ingest;
use muster_model::id::{ServiceName, TeamId};
use muster_runtime::bus::{Bus, ConnectTimeout};
use muster_runtime::clock::Clock;
use muster_runtime::config::{Mode, Origin, ProcessArgs, ProcessConfig, Sourced};
use muster_runtime::observe::Observatory;
use muster_runtime::service;
use muster_runtime::stop::{self, Stop};
use muster_wire::{Key, Message, Pattern};
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until};

use crate::physical::{Case, Recording};

/// How long a session may take to find the router.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);

/// Most queued updates: each robot receives its team once a second and after every change, for ten seconds.
const MAX_QUEUED_UPDATES: usize = 16_384;

/// Where the router listens: the system chooses a free port.
const LISTEN: &str = "tcp/127.0.0.1:0";

/// The teams that the robots received.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TeamsReceived {
    /// The team of each robot in the end, numbered from 0; none if it has none.
    pub teams: Vec<Option<usize>>,
    /// Seconds from the first picture until every robot knew its team and there were as many as asked for; none
    /// if that was never so.
    pub whole_s: Option<f64>,
    /// Seconds from the first picture until a robot last received another team.
    pub settled_s: f64,
    /// How often a robot received another team after all of them had known theirs.
    pub moves: usize,
    /// Of each division, milliseconds from the moment in which `ingest` received its newest pose until
    /// it was received at a console.
    pub newest_ms: Vec<f64>,
    /// The same from its oldest pose.
    pub oldest_ms: Vec<f64>,
}

/// A robot received its team.
struct TeamUpdate {
    at: Instant,
    robot: usize,
    team: Option<TeamId>,
}

/// Plays a recording for so many seconds, asking for `teams`.
///
/// # Errors
/// If the bus fails, or a service.
pub fn play(
    case: &Case,
    recording: &Recording,
    teams: usize,
    seconds: f64,
) -> anyhow::Result<TeamsReceived> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(play_on_bus(case, recording, teams, seconds))
}

async fn play_on_bus(
    case: &Case,
    recording: &Recording,
    teams: usize,
    seconds: f64,
) -> anyhow::Result<TeamsReceived> {
    // Neither flags nor variables nor files: a run is the same everywhere.
    let mut config = ProcessConfig::resolve(&ProcessArgs::default(), Mode::Client, &|_| None)?;
    config.state_directory = Sourced { value: None, origin: Origin::Flag };
    config.set(ServiceName::Clusterer, &[format!("teams={teams}")])?;
    let timeout = ConnectTimeout::After(CONNECT_TIMEOUT);
    let router = Bus::open(&config.as_router(vec![LISTEN.to_owned()]), timeout).await?;
    let endpoints = router.locators().await;
    let config = config.as_client(endpoints.clone());
    let (stopper, stop) = stop::channel();
    let mut services = services(&config, &stop)?;

    let console = Bus::open(&config, timeout).await?;
    let delays = follow_divisions(&console, teams).await?;
    let client = Config {
        routers: Some(endpoints),
        connect_timeout: Some(CONNECT_TIMEOUT),
        ..Config::default()
    };
    let robots = join(case, &client).await?;
    let (sender, mut receiver) = mpsc::channel(MAX_QUEUED_UPDATES);
    for (robot, joined) in robots.iter().enumerate() {
        forward_team(robot, joined, sender.clone());
    }
    let start = Instant::now();
    put_relations(case, &robots)?;
    for picture in recording.pictures.iter().take_while(|picture| picture.t < seconds) {
        sleep_until(start + Duration::from_secs_f64(picture.t)).await;
        for (robot, at) in robots.iter().zip(&picture.at) {
            if let Some([x, y]) = *at {
                robot.put_pose(Pose::at(x, y))?;
            }
        }
    }
    let mut updates = Vec::new();
    while let Ok(update) = receiver.try_recv() {
        updates.push(update);
    }
    let mut summary = summary(&updates, robots.len(), teams, start);
    let delays = std::mem::take(&mut *delays.lock().unwrap_or_else(PoisonError::into_inner));
    (summary.newest_ms, summary.oldest_ms) = delays.into_iter().unzip();
    if let Some(ended) = services.try_join_next() {
        ended?.context("a service failed")?;
        anyhow::bail!("a service ended by itself");
    }
    for robot in robots {
        robot.leave().await;
    }
    stopper.stop();
    while let Some(ended) = services.join_next().await {
        ended??;
    }
    console.close().await;
    router.close().await;
    Ok(summary)
}

/// All services, each as a task with a session of its own.
fn services(config: &ProcessConfig, stop: &Stop) -> anyhow::Result<JoinSet<anyhow::Result<()>>> {
    let observatory = Observatory::open(config, &ServiceName::PIPELINE)?;
    let mut tasks = JoinSet::new();
    for name in ServiceName::PIPELINE {
        let (config, stop, observer) = (config.clone(), stop.clone(), observatory.observer(name));
        match name {
            ServiceName::Ingest => tasks.spawn(service::run::<Ingest>(config, stop, observer)),
            ServiceName::Embedder => tasks.spawn(service::run::<Embedder>(config, stop, observer)),
            ServiceName::Clusterer => {
                tasks.spawn(service::run::<Clusterer>(config, stop, observer))
            }
            ServiceName::Auditor => tasks.spawn(service::run::<Auditor>(config, stop, observer)),
            // They are no part of the pipeline.
            ServiceName::Historian | ServiceName::Planner => continue,
        };
    }
    Ok(tasks)
}

/// All robots, each with a session of its own.
async fn join(case: &Case, config: &Config) -> anyhow::Result<Vec<Robot>> {
    let mut joining = JoinSet::new();
    for (number, robot) in case.layout.robots.iter().cloned().enumerate() {
        let config = config.clone();
        joining.spawn(async move {
            Robot::join(&config, robot.as_str()).await.map(|robot| (number, robot))
        });
    }
    let mut robots = Vec::new();
    while let Some(joined) = joining.join_next().await {
        robots.push(joined??);
    }
    robots.sort_by_key(|(number, _)| *number);
    Ok(robots.into_iter().map(|(_, robot)| robot).collect())
}

/// Queues every team that a robot receives, until the queue is full or closed, or the robot has left.
fn forward_team(robot: usize, joined: &Robot, updates: mpsc::Sender<TeamUpdate>) {
    let mut team = joined.team();
    tokio::spawn(async move {
        while let Ok(latest) = team.changed().await {
            let team = latest.value.team.clone();
            if updates.try_send(TeamUpdate { at: Instant::now(), robot, team }).is_err() {
                break;
            }
        }
    });
}

/// Puts links and ranks once; the client republishes them.
fn put_relations(case: &Case, robots: &[Robot]) -> anyhow::Result<()> {
    let named = |robot: &usize| case.layout.robots[*robot].as_str();
    for ((robot, links), superior) in robots.iter().zip(case.links()?).zip(&case.layout.superiors) {
        robot.put_links(links.links.iter().map(|link| (link.peer.as_str(), link.quality)))?;
        robot.put_rank(superior.as_ref().map(named))?;
    }
    Ok(())
}

type Delays = Arc<Mutex<Vec<(f64, f64)>>>;

/// Notes how old the newest and the oldest pose of each division are as it arrives, in milliseconds, once
/// there are as many teams as asked for.
async fn follow_divisions(console: &Bus, wanted: usize) -> anyhow::Result<Delays> {
    let (delays, clock, space) = (Delays::default(), Clock::start(), console.space().clone());
    let noted = Arc::clone(&delays);
    let take = move |packet| {
        let Ok(Message::Teams { teams, .. }) = Message::decode(&space, &packet) else { return };
        let header = &teams.header;
        if let (Some(newest), Some(oldest)) = (header.newest, header.oldest)
            && teams.teams.len() == wanted
        {
            let now = clock.now();
            let since = [newest, oldest].map(|tick| 1e3 * now.since(tick).as_secs_f64());
            noted.lock().unwrap_or_else(PoisonError::into_inner).push((since[0], since[1]));
        }
    };
    console.subscribe(&Pattern::One(Key::Teams), take).await?;
    Ok(delays)
}

/// The teams in the end, and when they changed.
fn summary(updates: &[TeamUpdate], robots: usize, wanted: usize, start: Instant) -> TeamsReceived {
    let mut received = TeamsReceived::default();
    let mut teams: Vec<Option<TeamId>> = vec![None; robots];
    let mut sorted: Vec<&TeamUpdate> = updates.iter().collect();
    sorted.sort_by_key(|update| update.at);
    for update in sorted {
        // The same team with other members is no other team.
        if teams[update.robot] == update.team {
            continue;
        }
        teams[update.robot].clone_from(&update.team);
        received.settled_s = (update.at - start).as_secs_f64();
        let different: BTreeSet<_> = teams.iter().flatten().collect();
        if received.whole_s.is_some() {
            received.moves += 1;
        } else if teams.iter().all(Option::is_some) && different.len() == wanted {
            received.whole_s = Some(received.settled_s);
        }
    }
    let different: BTreeSet<&TeamId> = teams.iter().flatten().collect();
    let numbers: BTreeMap<&TeamId, usize> = different.into_iter().zip(0..).collect();
    received.teams = teams.iter().map(|team| numbers.get(team.as_ref()?).copied()).collect();
    received
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn updates_give_a_division_and_its_changes() {
        let start = Instant::now();
        let update = |seconds: f64, robot: usize, team: &str| TeamUpdate {
            at: start + Duration::from_secs_f64(seconds),
            robot,
            team: Some(team.parse().unwrap()),
        };
        let updates = [
            update(0.3, 2, "t2"),
            update(0.1, 0, "t1"),
            update(0.2, 1, "t1"),
            update(0.5, 0, "t1"),
            update(0.7, 1, "t2"),
        ];
        let received = summary(&updates, 3, 2, start);
        assert_eq!(received.teams, [Some(0), Some(1), Some(1)]);
        assert_eq!((received.whole_s, received.settled_s, received.moves), (Some(0.3), 0.7, 1));
        assert_eq!(
            summary(&[], 1, 2, start),
            TeamsReceived { teams: vec![None], ..TeamsReceived::default() }
        );
    }
}
