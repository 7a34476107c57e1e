//! Plays a recording into a fleet of its own.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::Write as _;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Duration;

use mcap::McapError;
use muster_client::{Client, Config, Error, RobotPublisher};
use muster_model::id::{FleetId, RobotId};
use muster_model::observation::Pose;
use muster_model::replay::{REPLAY_PREFIX, is_replay};
use muster_model::roster::Presence;
use muster_runtime::config::{Origin, ProcessConfig};
use muster_runtime::exit::{Exit, ExitError};
use muster_runtime::stop::Stop;
use tokio::sync::mpsc;
use tokio::time::Instant;

use super::options::ReplayArgs;
use super::play::{Overview, Pace, Reports, Step, overview};
use super::reading::{End, Item, read};
use crate::shell::fleet::client_config;

/// Most steps that are read ahead.
const MAX_AHEAD: usize = 4096;

/// How often is looked whether live robots have come into the fleet of the replay.
const LOOK_EVERY: Duration = Duration::from_secs(2);

/// Longest name of a fleet.
const MAX_NAME: usize = muster_model::limits::MAX_ID_LENGTH;

/// The fleet in which a recording is played.
///
/// # Errors
/// If a flag names one that is not for recordings.
fn fleet_of(config: &ProcessConfig, recorded: Option<&FleetId>) -> Result<FleetId, ExitError> {
    let named = &config.fleet.value;
    if is_replay(named) {
        return Ok(named.clone());
    }
    if config.fleet.origin == Origin::Flag {
        return Err(ExitError::usage(format!(
            "fleet: a recording is never played into {named}: robots that are not there would be taken for live ones. \
             Name a fleet that begins with {REPLAY_PREFIX}, or none"
        )));
    }
    let recorded = recorded.unwrap_or(named).as_str();
    // The recording of a replay has the name already.
    let recorded = recorded.strip_prefix(REPLAY_PREFIX).unwrap_or(recorded);
    let name: String = format!("{REPLAY_PREFIX}{recorded}").chars().take(MAX_NAME).collect();
    FleetId::new(&name).map_err(|error| ExitError::usage(error.to_string()))
}

/// Why a recording is not played among live robots.
fn refused(robot: &RobotId) -> anyhow::Error {
    ExitError::usage(format!(
        "there are live robots in this fleet, such as {robot}: a recording is not played among them. Name another \
         fleet with --fleet {REPLAY_PREFIX}NAME, or end what plays there"
    ))
    .into()
}

/// Refuses a fleet in which there are robots before the begin.
///
/// # Errors
/// Names the first of them.
async fn refuse_live(client: &Client) -> anyhow::Result<()> {
    let mut live = client.get_joined_robots().await?;
    match client.get_roster().await {
        Ok(roster) => {
            let active = roster.robots.iter().filter(|entry| entry.presence == Presence::Active);
            live.extend(active.map(|entry| entry.robot.clone()));
        }
        Err(Error::Unanswered { .. }) => {}
        Err(error) => return Err(error.into()),
    }
    live.first().map_or(Ok(()), |robot| Err(refused(robot)))
}

/// Refuses robots that have joined since, and that this replay has not put there.
///
/// # Errors
/// Names the first of them.
async fn refuse_joined(client: &Client, own: &Own) -> anyhow::Result<()> {
    let joined = client.get_joined_robots().await?;
    let stranger = joined.iter().find(|robot| !own.robots.contains(robot));
    stranger.map_or(Ok(()), |robot| Err(refused(robot)))
}

/// Who this replay has put into the fleet: robots that have just left are there for a moment longer.
#[derive(Debug, Default)]
struct Own {
    robots: BTreeSet<RobotId>,
    boots: BTreeSet<String>,
}

impl Own {
    /// Whether a pose is one of this replay; that of a live robot of the same id is not.
    fn has(&self, pose: &Pose) -> bool {
        pose.boot.as_ref().is_some_and(|boot| self.boots.contains(boot))
    }
}

/// One recording of all its parts.
fn overview_of(files: &[PathBuf], reports: &Reports) -> Result<Overview, ExitError> {
    let mut whole: Option<Overview> = None;
    for path in files {
        let file = File::open(path).map_err(McapError::from);
        let part = file.and_then(|file| overview(file, reports)).map_err(|error| {
            ExitError::usage(format!(
                "{}: is no recording that can be read: {error}",
                path.display()
            ))
        })?;
        let path = path.display();
        match &part.end {
            End::Cut => {
                eprintln!("{path}: ends in the middle; what was recorded until then is played");
            }
            End::Damaged(why) => {
                eprintln!("{path}: is damaged, and only what came before is played: {why}")
            }
            End::Whole | End::Stopped => {}
        }
        whole = Some(match whole {
            None => part,
            Some(before) => {
                let mut robots = before.robots;
                for (robot, at) in part.robots {
                    let seen = robots.entry(robot).or_default();
                    *seen = at.max(*seen);
                }
                let spans = before.span.into_iter().chain(part.span);
                let span = spans.reduce(|all, one| (all.0.min(one.0), all.1.max(one.1)));
                Overview { fleet: before.fleet.or(part.fleet), span, robots, end: part.end }
            }
        });
    }
    let whole = whole.filter(|whole| whole.span.is_some());
    whole.ok_or_else(|| ExitError::usage("the recording has no robots: there is nothing to play"))
}

/// Reads the steps of all parts, as fast as they are taken.
fn read_ahead(
    files: &[PathBuf],
    reports: &Reports,
    mut pace: Pace,
    steps: &mpsc::Sender<(Duration, Step)>,
) -> Result<(), McapError> {
    for path in files {
        let end = read(File::open(path)?, |item| {
            let Item::Message(entry) = item else { return ControlFlow::Continue(()) };
            let Some((robot, report)) = reports.of(&entry) else {
                return ControlFlow::Continue(());
            };
            for step in pace.steps(entry.at, robot, report) {
                if steps.blocking_send(step).is_err() {
                    return ControlFlow::Break(());
                }
            }
            ControlFlow::Continue(())
        })?;
        if end == End::Stopped {
            break;
        }
    }
    Ok(())
}

/// Plays a recording until it ends, or it is time to stop.
///
/// # Errors
/// If a file is none, no router answers, or there are live robots in the fleet.
pub(super) async fn run(
    args: &ReplayArgs,
    config: ProcessConfig,
    mut stop: Stop,
) -> anyhow::Result<()> {
    let (files, of) = (args.files.clone(), config.fleet.value.clone());
    let overview = tokio::task::spawn_blocking(move || {
        let reports = Reports::new(of);
        overview_of(&files, &reports).map(|overview| (overview, reports))
    });
    let (overview, reports) = tokio::select! {
        // Who reads is left behind: the process ends.
        () = stop.stopped() => return Ok(()),
        overview = overview => overview??,
    };
    let fleet = fleet_of(&config, overview.fleet.as_ref())?;
    let client_config = Config { fleet: fleet.to_string(), ..client_config(&config) };
    let unreachable = |error: Error| ExitError::unreachable(error.to_string());
    let client = Client::open(&client_config).await.map_err(unreachable)?;
    // From now on, so that none is missed between the look and the begin.
    let mut poses = client.all_poses().await?;
    refuse_live(&client).await?;
    if client.get_instances().await?.is_empty() {
        eprintln!("no service serves {fleet} yet: start some with `muster up --fleet {fleet}`");
    }
    let pace = Pace::new(&overview, args.speed);
    let seconds = overview.span.map_or(0.0, |(_, last)| pace.after(last).as_secs_f64());
    writeln!(
        std::io::stdout(),
        "REPLAY: {} robots for {seconds:.0} s in fleet {fleet}, at {} times their speed; Ctrl-C ends it",
        overview.robots.len(),
        args.speed
    )?;
    let (steps, mut ahead) = mpsc::channel(MAX_AHEAD);
    let files = args.files.clone();
    let reading = tokio::task::spawn_blocking(move || read_ahead(&files, &reports, pace, &steps));
    let mut robots: BTreeMap<RobotId, RobotPublisher> = BTreeMap::new();
    let mut own = Own::default();
    let start = Instant::now();
    let mut looks = tokio::time::interval_at(start + LOOK_EVERY, LOOK_EVERY);
    looks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    let mut next: Option<(Instant, Step)> = None;
    let ended = loop {
        let due = next.as_ref().map(|(at, _)| *at);
        let arrives = async {
            match due {
                Some(at) => tokio::time::sleep_until(at).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            () = stop.stopped() => break Ok(()),
            _ = looks.tick() => {
                if let Err(problem) = refuse_joined(&client, &own).await {
                    break Err(problem);
                }
            }
            received = poses.next() => match received {
                Ok(received) if own.has(&received.pose) => {}
                Ok(received) => break Err(refused(&received.robot)),
                Err(error) => break Err(error.into()),
            },
            step = ahead.recv(), if due.is_none() => match step {
                Some((after, step)) => next = Some((start + after, step)),
                None => break Ok(()),
            },
            () = arrives => {
                let Some((_, step)) = next.take() else { continue };
                if let Err(problem) = perform(&client, step, &mut robots, &mut own).await {
                    break Err(problem);
                }
            }
        }
    };
    drop(ahead);
    for (_, robot) in robots {
        robot.leave().await;
    }
    client.close().await;
    ended?;
    reading.await?.map_err(|error| ExitError {
        exit: Exit::Failure,
        message: format!("the recording cannot be read any further: {error}"),
    })?;
    Ok(())
}

async fn perform(
    client: &Client,
    step: Step,
    robots: &mut BTreeMap<RobotId, RobotPublisher>,
    own: &mut Own,
) -> anyhow::Result<()> {
    match step {
        Step::Leave(robot) => {
            if let Some(publisher) = robots.remove(&robot) {
                publisher.leave().await;
            }
        }
        Step::Put(robot, report) => {
            if !robots.contains_key(&robot) {
                own.robots.insert(robot.clone());
                let publisher = client.join_as_replay(robot.clone()).await?;
                own.boots.insert(publisher.boot());
                robots.insert(robot.clone(), publisher);
            }
            if let Some(publisher) = robots.get(&robot) {
                publisher.put(report)?;
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use muster_runtime::config::{Mode, ProcessArgs};

    use super::*;

    fn fleet(
        flag: Option<&str>,
        variable: Option<&str>,
        recorded: Option<&str>,
    ) -> Result<String, String> {
        let args = ProcessArgs { fleet: flag.map(str::to_owned), ..ProcessArgs::default() };
        let environment =
            |name: &str| variable.filter(|_| name == "MUSTER_FLEET").map(str::to_owned);
        let config = ProcessConfig::resolve(&args, Mode::Client, &environment);
        let recorded = recorded.map(|name| FleetId::new(name).unwrap());
        let fleet = fleet_of(&config.map_err(|error| error.message)?, recorded.as_ref());
        fleet.map(|fleet| fleet.to_string()).map_err(|error| error.message)
    }

    #[test]
    fn a_recording_is_played_in_a_fleet_that_says_so_and_in_no_other() {
        let played = |name: &str| Ok(name.to_owned());
        assert_eq!(fleet(None, None, Some("alpha")), played("replay-alpha"));
        assert_eq!(fleet(None, None, Some("replay-alpha")), played("replay-alpha"));
        assert_eq!(fleet(None, None, None), played("replay-default"));
        // The environment of a live fleet does not lead there.
        assert_eq!(fleet(None, Some("beta"), Some("alpha")), played("replay-alpha"));
        assert_eq!(fleet(Some("replay-b"), Some("beta"), Some("alpha")), played("replay-b"));
        let long = "a".repeat(MAX_NAME);
        assert_eq!(fleet(None, None, Some(&long)).unwrap().len(), MAX_NAME);
        let refused = fleet(Some("alpha"), None, Some("alpha")).unwrap_err();
        assert!(
            refused.contains("never played into alpha") && refused.contains("replay-"),
            "{refused}"
        );
    }

    #[test]
    fn only_poses_of_the_replay_itself_are_its_own() {
        let own = Own { boots: BTreeSet::from(["replay-1".to_owned()]), ..Own::default() };
        let of = |boot: Option<&str>| Pose { boot: boot.map(str::to_owned), ..Pose::at(0.0, 0.0) };
        assert!(own.has(&of(Some("replay-1"))));
        // A live robot of a recorded id, one that is relayed, and one of another replay.
        assert!(!own.has(&of(Some("1"))) && !own.has(&of(None)) && !own.has(&of(Some("replay-2"))));
    }
}
