//! Plays a seeded plan of faults on a fleet of real processes, and reports what broke.

use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use clap::{Parser, ValueEnum};
use muster_tests::access::Security;
use muster_tests::soak::steady::{self, SteadyOptions};
use muster_tests::soak::{RunOptions, plan, run};
use tokio::signal::unix::{SignalKind, signal};

/// Longest run in minutes: a week.
const MAX_MINUTES: f64 = 10_080.0;

/// Most times that the promised times may be stretched.
const MAX_PATIENCE: f64 = 100.0;

/// Runs a router, all services and a fleet of robots as processes on a real bus, lets faults happen to them that
/// follow from a seed, and judges all that is published meanwhile.
///
/// The faults: services are killed (SIGKILL, SIGTERM) or stopped (SIGSTOP), one or all; the router is killed or
/// stopped; links of robots or services are cut or go silent; robots are killed; the disk is full; a stranger floods
/// the bus with garbage, robot tokens or poses; everything is restarted with its disks. Some come two at a time.
///
/// The promises: no robot is told a wrong team, or none; what is published keeps the rules of the simulation's
/// oracle; ids of teams are never used again; the division is whole and fresh within 5 s after a fault of services,
/// 10 s after one of links or router, 15 s after a restart of everything; it pauses for at most 5 s where router and
/// services are not touched, or a standby takes over; no process ends by itself or panics; memory is flat.
///
/// Programs must be built (cargo build --workspace). Only root can make a disk full; without, that is left out and
/// said so. Exit codes: 0 every promise held, 1 one was broken or the fleet did not start, 2 wrong flag.
#[derive(Debug, Parser)]
#[command(name = "soak", after_help = EXAMPLES)]
struct Args {
    /// What the fleet and its faults are drawn from; the seconds since 1970 if left out
    #[arg(long, conflicts_with = "steady")]
    seed: Option<u64>,
    /// How long faults happen, or how long the steady run is; the run takes somewhat longer
    #[arg(long, default_value_t = 10.0, value_parser = minutes)]
    minutes: f64,
    /// The bus, instead of the one that the seed chooses
    #[arg(long, conflicts_with = "steady")]
    bus: Option<Bus>,
    /// Print the plan, and run nothing
    #[arg(long, conflicts_with = "steady")]
    plan: bool,
    /// How many times longer than promised everything may take, for a machine that is busy with other work
    #[arg(long, default_value_t = 1.0, value_parser = patience, conflicts_with = "steady")]
    patience: f64,
    /// Copy the logs of all processes to this folder
    #[arg(long, value_name = "FOLDER", conflicts_with = "steady")]
    logs: Option<PathBuf>,
    /// No faults: many robots, to see that memory stays flat and nothing is lost
    #[arg(long)]
    steady: bool,
    /// With --steady: how many robots
    #[arg(long, default_value_t = 200, requires = "steady", value_parser = clap::value_parser!(u16).range(2..=10_000))]
    robots: u16,
    /// With --steady: how many groups of robots, and teams
    #[arg(long, default_value_t = 8, requires = "steady", value_parser = clap::value_parser!(u16).range(1..=1000))]
    teams: u16,
    /// With --steady: write the memory of all processes over time to this file
    #[arg(long, value_name = "FILE.svg", requires = "steady")]
    plot: Option<PathBuf>,
}

const EXAMPLES: &str = "Examples:
  soak                              ten minutes of a fresh seed, which is printed
  soak --seed 7 --minutes 60        the same faults each time
  soak --seed 7 --plan              what they are
  soak --steady --robots 200        no faults";

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Bus {
    /// Whoever reaches the router may do everything
    Plain,
    /// Certificates on both sides, and access control
    Secured,
}

fn minutes(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(minutes) if (0.01..=MAX_MINUTES).contains(&minutes) => Ok(minutes),
        _ => Err(format!("must be a number from 0.01 to {MAX_MINUTES}")),
    }
}

fn patience(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(patience) if (1.0..=MAX_PATIENCE).contains(&patience) => Ok(patience),
        _ => Err(format!("must be a number from 1 to {MAX_PATIENCE}")),
    }
}

#[tokio::main]
async fn main() -> anyhow::Result<ExitCode> {
    let args = Args::parse();
    let mut out = std::io::stdout();
    if args.steady {
        let (robots, teams) = (usize::from(args.robots), usize::from(args.teams));
        let options = SteadyOptions { robots, teams, minutes: args.minutes, plot: args.plot };
        let kept = steady::run(&options, &mut out).await?;
        return Ok(if kept { ExitCode::SUCCESS } else { ExitCode::FAILURE });
    }
    let fresh = || SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let seed = args.seed.unwrap_or_else(fresh);
    let security = args.bus.map(|bus| match bus {
        Bus::Plain => Security::Plain,
        Bus::Secured => Security::Secured,
    });
    let plan = plan(seed, Duration::from_secs_f64(args.minutes * 60.0), security);
    write!(out, "{plan}")?;
    if args.plan {
        return Ok(ExitCode::SUCCESS);
    }
    writeln!(out)?;
    let options = RunOptions { logs: args.logs, patience: args.patience };
    let say = |line: &str| {
        let _ = writeln!(std::io::stdout(), "{line}");
    };
    let mut ends = signal(SignalKind::terminate())?;
    let outcome = tokio::select! {
        outcome = run(&plan, &options, say) => outcome?,
        // All processes end with the run.
        _ = tokio::signal::ctrl_c() => anyhow::bail!("ended by SIGINT"),
        _ = ends.recv() => anyhow::bail!("ended by SIGTERM"),
    };
    writeln!(out, "\n{}", outcome.report)?;
    if outcome.broken.is_empty() {
        writeln!(out, "seed {seed}: {} faults, every promise held", outcome.faults)?;
        return Ok(ExitCode::SUCCESS);
    }
    for broken in &outcome.broken {
        writeln!(out, "BROKEN {broken}")?;
    }
    let broken = outcome.broken.len();
    writeln!(out, "seed {seed}: {} faults, {broken} promises BROKEN", outcome.faults)?;
    Ok(ExitCode::FAILURE)
}
