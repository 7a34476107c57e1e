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

/// Most robots of a run, and most poses per second of all: more than one process can put on two cores.
const MAX_ROBOTS: u32 = 50_000;
const MAX_POSES_HZ: f64 = 200_000.0;

/// How long a fleet settles before it is measured.
const SETTLING_TIME: Duration = Duration::from_secs(5);

/// From a pose to its team, over a real router, with every service and the robots as processes.
#[derive(Debug, Parser)]
#[command(
    after_help = "Examples:\n  tests/peers/latency                                all sizes, 60 s each\n  \
tests/peers/latency --robots 500 --seconds 20\n  \
tests/peers/latency --robots 5000,20000@1,50000@1  with another rate for some sizes\n  tests/peers/latency --set embedder.dimension=8\n  \
tests/peers/latency --set clusterer.teams=5            with a number of teams that is given\n  \
tests/peers/latency --busy 1                       next to a busy process for each processor\n  \
tests/peers/latency --robots 500 --pins 20         with wishes, next to the same without"
)]
struct Options {
    /// Sizes of the fleet, one run for each; with @HZ for another rate than --rate
    #[arg(long, value_name = "ROBOTS[@HZ]", value_delimiter = ',', value_parser = Size::parse,
          default_values = ["50", "500", "5000"])]
    robots: Vec<Size>,
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

/// A size of the fleet, and its rate if it has one of its own.
#[derive(Debug, Clone, Copy)]
struct Size {
    robots: u32,
    rate_hz: Option<f64>,
}

impl Size {
    fn parse(text: &str) -> Result<Self, String> {
        let (robots, rate_hz) = match text.split_once('@') {
            Some((robots, rate)) => (robots, Some(rate)),
            None => (text, None),
        };
        let robots = robots.parse().ok().filter(|robots| (2..=MAX_ROBOTS).contains(robots));
        let robots = robots.ok_or_else(|| format!("must be 2 to {MAX_ROBOTS} robots"))?;
        let rate_hz =
            rate_hz.map(|rate| rate.parse().map_err(|_| format!("{rate} is no rate in Hz")));
        Ok(Self { robots, rate_hz: rate_hz.transpose()? })
    }
}

fn check_rate(size: Size, rate_hz: f64) -> anyhow::Result<()> {
    anyhow::ensure!(
        (0.1..=100.0).contains(&rate_hz),
        "--rate: must be 0.1 to 100 per second, not {rate_hz}"
    );
    let all = f64::from(size.robots) * rate_hz;
    anyhow::ensure!(
        all <= MAX_POSES_HZ,
        "--robots: {} robots at {rate_hz} Hz are more than the {MAX_POSES_HZ} poses per second that one process can put; \
         give a lower rate, as in {}@1",
        size.robots,
        size.robots
    );
    Ok(())
}

fn plans(options: &Options) -> anyhow::Result<Vec<RunPlan>> {
    let rate_of = |size: &Size| size.rate_hz.unwrap_or(options.rate);
    for size in &options.robots {
        check_rate(*size, rate_of(size))?;
    }
    let parted = |set: &String| {
        let (service, rest) = set
            .split_once('.')
            .with_context(|| format!("--set {set}: must be SERVICE.FIELD=VALUE"))?;
        Ok((service.to_owned(), rest.to_owned()))
    };
    let settings = options.set.iter().map(parted).collect::<anyhow::Result<Vec<_>>>()?;
    let plan = |size: &Size, busy: u8, pins: u32| RunPlan {
        robots: size.robots as usize,
        teams: options.teams as usize,
        rate_hz: rate_of(size),
        settles: SETTLING_TIME,
        lasts: Duration::from_secs(options.seconds),
        settings: settings.clone(),
        busy: busy.into(),
        pins: pins as usize,
    };
    let runs = options.robots.iter().flat_map(|size| {
        let alone = std::iter::once(plan(size, 0, 0));
        alone
            .chain((options.busy > 0).then(|| plan(size, options.busy, 0)))
            .chain((options.pins > 0).then(|| plan(size, 0, options.pins)))
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
    let (mut all, mut failed) = (Vec::new(), Vec::new());
    for plan in &plans {
        let progress = |text: String| {
            let _ = writeln!(std::io::stderr(), "{text}");
        };
        match run_plan::run(plan, progress).await {
            Ok(measured) => all.push(measured),
            // A size that is too large for the machine is a result; the others are measured all the same.
            Err(error) => {
                let reason = format!("{error:#}");
                writeln!(std::io::stderr(), "{} robots: {reason}", plan.robots)?;
                // What a program said last may follow; a table has one line.
                let reason = reason.lines().take(2).collect::<Vec<_>>().join(" ");
                failed.push(report::Failed { plan: plan.clone(), reason });
            }
        }
    }
    let picture = options.out.as_ref().map(|out| out.with_extension("svg"));
    let name = picture.as_ref().and_then(|picture| picture.file_name()?.to_str());
    let page = report::page(&all, &failed, &options.named, name)?;
    match &options.out {
        Some(out) => {
            std::fs::write(out, page).with_context(|| format!("--out {}", out.display()))?
        }
        None => write!(std::io::stdout(), "{page}")?,
    }
    if let Some(picture) = &picture {
        std::fs::write(picture, report::plot(&all))?;
    }
    let mut missed = report::goals(&all, &failed);
    missed.retain(|goal| !goal.reached);
    for goal in &missed {
        writeln!(std::io::stderr(), "missed: {}: {}", goal.wanted, goal.measured)?;
    }
    Ok(if missed.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
