//! Measures how long a pose takes until the team computed from it is received, and what every process
//! takes for it. `latency --help` has the flags; `tests/peers/latency` builds and runs it in release.
//!
//! It ends with 1 if a goal is missed.

use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::Context;
use clap::Parser;
use muster_tests::latency::run_plan::{self, RunPlan};
use muster_tests::latency::{drive, echo, report};

/// Most robots of a run: more than one process can put for at 10 Hz on two cores.
const MAX_ROBOTS: u32 = 20_000;

/// How long a fleet settles before it is measured.
const SETTLING_TIME: Duration = Duration::from_secs(5);

/// From a pose to its team, over a real router, with every service and the robots as processes.
#[derive(Debug, Parser)]
#[command(
    after_help = "Examples:\n  tests/peers/latency                                all sizes, 60 s each\n  \
tests/peers/latency --robots 500 --seconds 20\n  tests/peers/latency --set embedder.dimension=8\n  \
tests/peers/latency --set clusterer.teams=5            with a number of teams that is given\n  \
tests/peers/latency --busy 1                       next to a busy process for each processor\n  \
tests/peers/latency --robots 500 --pins 20         with wishes, next to the same without"
)]
struct Options {
    /// Sizes of the fleet, one run for each
    #[arg(long, value_delimiter = ',', default_values_t = [50, 500, 5000],
          value_parser = clap::value_parser!(u32).range(2..=i64::from(MAX_ROBOTS)))]
    robots: Vec<u32>,
    /// Teams that the robots march in
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=64))]
    teams: u32,
    /// Poses per second of each robot
    #[arg(long, default_value_t = 10.0)]
    rate: f64,
    /// Seconds that are measured in each run
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=600))]
    seconds: u64,
    /// Change a setting of a service, such as ingest.tick_hz=20
    #[arg(long, value_name = "SERVICE.FIELD=VALUE")]
    set: Vec<String>,
    /// Measure each size a second time, while so many other processes compute for each processor
    #[arg(long, default_value_t = 0, value_name = "PROCESSES",
          value_parser = clap::value_parser!(u8).range(0..=16))]
    busy: u8,
    /// Measure each size once more, while wishes pin so many robots to their teams
    #[arg(long, default_value_t = 0, value_name = "ROBOTS",
          value_parser = clap::value_parser!(u32).range(0..=1000))]
    pins: u32,
    /// Where the page goes; standard output without it. Its picture has the same name with .svg
    #[arg(long, value_name = "FILE.md")]
    out: Option<PathBuf>,
    /// What is written as the command
    #[arg(long, hide = true, default_value = "latency")]
    named: String,
    /// The router of a run
    #[arg(long, hide = true, default_value = "")]
    router: String,
    /// Be the echo of a run
    #[arg(long, hide = true)]
    echo: bool,
    /// Be the robots of a run, with this folder
    #[arg(long, hide = true, value_name = "FOLDER")]
    drive: Option<PathBuf>,
}

fn plans(options: &Options) -> anyhow::Result<Vec<RunPlan>> {
    anyhow::ensure!(
        (0.1..=100.0).contains(&options.rate),
        "--rate: must be 0.1 to 100 per second, not {}",
        options.rate
    );
    let parted = |set: &String| {
        let (service, rest) = set
            .split_once('.')
            .with_context(|| format!("--set {set}: must be SERVICE.FIELD=VALUE"))?;
        Ok((service.to_owned(), rest.to_owned()))
    };
    let settings = options.set.iter().map(parted).collect::<anyhow::Result<Vec<_>>>()?;
    let plan = |robots: u32, busy: u8, pins: u32| RunPlan {
        robots: robots as usize,
        teams: options.teams as usize,
        rate_hz: options.rate,
        settles: SETTLING_TIME,
        lasts: Duration::from_secs(options.seconds),
        settings: settings.clone(),
        busy: busy.into(),
        pins: pins as usize,
    };
    let runs = options.robots.iter().flat_map(|robots| {
        let alone = std::iter::once(plan(*robots, 0, 0));
        alone
            .chain((options.busy > 0).then(|| plan(*robots, options.busy, 0)))
            .chain((options.pins > 0).then(|| plan(*robots, 0, options.pins)))
    });
    Ok(runs.collect())
}

#[tokio::main]
async fn main() -> anyhow::Result<ExitCode> {
    let options = Options::parse();
    let plans = plans(&options)?;
    if options.echo {
        echo::run(&options.router, run_plan::FLEET).await?;
        return Ok(ExitCode::SUCCESS);
    }
    if let (Some(folder), Some(plan)) = (&options.drive, plans.first()) {
        let drive = drive::Drive {
            endpoint: options.router.clone(),
            fleet: run_plan::FLEET.to_owned(),
            robots: plan.robots,
            teams: plan.teams,
            rate_hz: plan.rate_hz,
            folder: folder.clone(),
        };
        drive::run(&drive).await?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut all = Vec::new();
    for plan in &plans {
        let progress = |text: String| {
            let _ = writeln!(std::io::stderr(), "{text}");
        };
        all.push(run_plan::run(plan, progress).await?);
    }
    let picture = options.out.as_ref().map(|out| out.with_extension("svg"));
    let name = picture.as_ref().and_then(|picture| picture.file_name()?.to_str());
    let page = report::page(&all, &options.named, name)?;
    match &options.out {
        Some(out) => {
            std::fs::write(out, page).with_context(|| format!("--out {}", out.display()))?
        }
        None => write!(std::io::stdout(), "{page}")?,
    }
    if let Some(picture) = &picture {
        std::fs::write(picture, report::plot(&all))?;
    }
    let mut missed = report::goals(&all);
    missed.retain(|goal| !goal.reached);
    for goal in &missed {
        writeln!(std::io::stderr(), "missed: {}: {}", goal.wanted, goal.measured)?;
    }
    Ok(if missed.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
