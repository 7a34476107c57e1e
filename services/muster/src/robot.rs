//! `muster robot`: one or many simulated robots as a process.

use std::collections::BTreeSet;
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};

use muster_client::{Client, Config, Format};
use muster_model::id::{RobotId, SkillId};
use muster_model::limits::MAX_SKILLS;
use muster_runtime::clock::Clock;
use muster_runtime::config::ProcessConfig;
use muster_runtime::exit::ExitError;
use muster_runtime::observe::Observatory;
use muster_runtime::stop::Stop;
use muster_scenario::{Fleet, FleetOptions, Layout, MAX_FILE_BYTES, ScenarioKind};

use crate::console::{client_config, exit_error};
use crate::fleet::SimulatedRobots;

/// Lowest and highest rate of poses that make sense: one in a quarter of an hour, and faster than any
/// controller that positions robots.
const RATES_HZ: std::ops::RangeInclusive<f64> = 0.001..=1000.0;

/// Longest run in seconds.
const MAX_SECONDS: f64 = 1e9;

/// Arguments of `muster robot`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Robots of one scenario or file and seed belong together, however many processes they are \
spread over with --only.\n\nExamples:\n  muster robot                                  a fleet that marches\n  \
muster robot --scenario clusters --teams 3 --robots 30\n  muster robot --scenario clusters --list\n  \
muster robot --scenario clusters --only r3,r4   two of them; others in other processes\n  \
muster robot --file tests/experiments/formations/platoon-wedge.json"
)]
pub(crate) struct RobotArgs {
    /// What the robots do: crossing (march, split, rejoin), clusters (stand in groups), random
    #[arg(long, default_value_t = ScenarioKind::Crossing)]
    scenario: ScenarioKind,
    /// A fleet in a file instead: robots with places and superiors, and the teams that they truly form
    #[arg(long, value_name = "FILE.json", conflicts_with_all = ["scenario", "robots", "teams"])]
    file: Option<PathBuf>,
    /// How many robots the scenario has
    #[arg(long, default_value_t = 18)]
    robots: usize,
    /// How many groups the scenario has
    #[arg(long, default_value_t = 2)]
    teams: usize,
    /// Seed of the scenario
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Only these robots of the scenario, by name, with commas
    #[arg(long, value_delimiter = ',', value_name = "ROBOT")]
    only: Vec<RobotId>,
    /// What these robots can do, by name, with commas
    #[arg(long, value_delimiter = ',', value_name = "SKILL")]
    skills: Vec<SkillId>,
    /// Print the robots of the scenario, each with its group, and end
    #[arg(long)]
    list: bool,
    /// Poses per second
    #[arg(long, default_value_t = 10.0)]
    rate: f64,
    /// Put bincode instead of JSON
    #[arg(long)]
    bincode: bool,
    /// End after so many seconds; without it, run until stopped
    #[arg(long)]
    seconds: Option<f64>,
}

/// A fleet by the numbers of a user.
///
/// # Errors
/// Names what makes no fleet.
pub(crate) fn simulate(kind: ScenarioKind, options: &FleetOptions) -> anyhow::Result<Fleet> {
    Fleet::new(kind, options.clone()).map_err(|error| ExitError::usage(error.to_string()).into())
}

/// The fleet of a user's file.
///
/// # Errors
/// Names the file, and what in it makes no fleet.
pub(crate) fn of_file(path: &Path, options: &FleetOptions) -> anyhow::Result<Fleet> {
    let wrong =
        |problem: String| ExitError::usage(format!("--file: {}: {problem}", path.display()));
    let mut text = String::new();
    // With one byte more than is allowed, a file that is too long is not read as one that just fits.
    let file = std::fs::File::open(path).map_err(|error| wrong(error.to_string()))?;
    let read = file.take(MAX_FILE_BYTES as u64 + 1).read_to_string(&mut text);
    read.map_err(|error| wrong(error.to_string()))?;
    let layout = Layout::read(&text).map_err(|error| wrong(error.to_string()))?;
    let fleet = Fleet::of_layout(&layout, options.clone());
    fleet.map_err(|error| ExitError::usage(error.to_string()).into())
}

/// Checks a duration of a user.
///
/// # Errors
/// Names the flag.
pub(crate) fn check_seconds(seconds: Option<f64>) -> anyhow::Result<Option<f64>> {
    match seconds {
        Some(seconds) if !(0.0..=MAX_SECONDS).contains(&seconds) => {
            Err(ExitError::usage(format!("--seconds: must be 0 to {MAX_SECONDS:e}")).into())
        }
        seconds => Ok(seconds),
    }
}

/// Runs robots until it is time to stop.
///
/// # Errors
/// If a flag is wrong, or the bus fails.
pub(crate) async fn run(
    args: &RobotArgs,
    config: &ProcessConfig,
    mut stop: Stop,
) -> anyhow::Result<()> {
    let options = FleetOptions {
        robots: args.robots,
        seed: args.seed,
        teams: args.teams,
        ..FleetOptions::default()
    };
    let fleet = match &args.file {
        Some(path) => of_file(path, &options)?,
        None => simulate(args.scenario, &options)?,
    };
    let seconds = check_seconds(args.seconds)?;
    if !RATES_HZ.contains(&args.rate) {
        let (least, most) = (RATES_HZ.start(), RATES_HZ.end());
        return Err(
            ExitError::usage(format!("--rate: must be {least} to {most} per second")).into()
        );
    }
    if args.list {
        for (robot, team) in fleet.robots().iter().zip(fleet.truth(0.0)) {
            writeln!(std::io::stdout(), "{robot} {team}")?;
        }
        return Ok(());
    }
    let chosen = chosen(&fleet, &args.only)?;
    let skills = skills(&args.skills)?;
    let _port = Observatory::open(config, &[])?;
    let format = if args.bincode { Format::Binary } else { Format::Json };
    let client_config = Config { format, ..client_config(config)? };
    let client = tokio::select! {
        client = Client::open(&client_config) => client.map_err(exit_error)?,
        () = stop.stopped() => return Ok(()),
    };
    tracing::info!("{} robots report to fleet {}", chosen.len(), config.fleet.value);
    let robots = SimulatedRobots::join(&client, fleet, chosen).await.map_err(exit_error)?;
    // All processes of a scenario play the same moment of its story, whenever they were started.
    let from = Clock::start().now().as_seconds();
    let result = robots.with_skills(skills).run(args.rate, from, seconds, stop).await;
    client.close().await;
    Ok(result.map_err(exit_error)?)
}

/// The indices of the robots of a fleet that are named; of all if none is.
fn chosen(fleet: &Fleet, only: &[RobotId]) -> anyhow::Result<Vec<usize>> {
    if only.is_empty() {
        return Ok((0..fleet.robots().len()).collect());
    }
    only.iter()
        .map(|name| {
            fleet.robots().iter().position(|robot| robot == name).ok_or_else(|| {
                let problem = format!("--only: the scenario has no robot {name}; --list names all");
                ExitError::usage(problem).into()
            })
        })
        .collect()
}

/// Skills of a user, each once.
fn skills(given: &[SkillId]) -> anyhow::Result<Vec<SkillId>> {
    let skills: BTreeSet<&SkillId> = given.iter().collect();
    if skills.len() > MAX_SKILLS {
        let problem = format!("--skills: a robot has at most {MAX_SKILLS}, not {}", skills.len());
        return Err(ExitError::usage(problem).into());
    }
    Ok(skills.into_iter().cloned().collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn skills_stand_once_and_are_few() {
        let skill = |name: &str| SkillId::new(name).unwrap();
        assert_eq!(
            skills(&[skill("b"), skill("a"), skill("b")]).unwrap(),
            [skill("a"), skill("b")]
        );
        let many: Vec<SkillId> = (0..17).map(|at| skill(&format!("s{at}"))).collect();
        assert!(skills(&many).unwrap_err().to_string().contains("at most 16"));
    }

    #[test]
    fn a_refused_duration_names_both_bounds() {
        for seconds in [None, Some(0.0), Some(MAX_SECONDS)] {
            assert_eq!(check_seconds(seconds).unwrap(), seconds);
        }
        for seconds in [-1.0, 2.0 * MAX_SECONDS, f64::NAN] {
            let error = check_seconds(Some(seconds)).unwrap_err().to_string();
            assert!(error.contains("0 to 1e9"), "{error}");
        }
    }
}
