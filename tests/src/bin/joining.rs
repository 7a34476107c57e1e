//! Measures how long robots that have a session each take to join, all at once, until all are in one division.
//! `joining --help` has the flags; `tests/peers/joining` builds and runs it in release.
//!
//! It ends with 1 if a goal is missed.

use std::io::Write as _;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use clap::Parser;
use muster_client::Config;
use muster_tests::client::{Client, division};
use muster_tests::cluster::start_router;
use muster_tests::joining::{Progress, join_all};
use muster_tests::ports::free_endpoint;
use muster_tests::process::Process;
use muster_tests::process_stats::process_stats;

/// The fleet that is measured.
const FLEET: &str = "joining";

/// How long a fleet of 2,000 robots may take, in seconds, and how many those are.
const GOAL: (usize, f64) = (2000, 5.0);

/// How long a fleet is waited for.
const GIVE_UP_AFTER: Duration = Duration::from_secs(300);

/// How often it is said how far they are.
const SAY_EVERY: Duration = Duration::from_secs(5);

/// How often it is looked how far all are.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// How long the services run before robots come.
const SERVICES_BEGIN: Duration = Duration::from_secs(3);

/// Robots with a session each, all at once, and a router with all services.
#[derive(Debug, Parser)]
#[command(after_help = "Example:\n  tests/peers/joining --robots 500,2000")]
struct Options {
    /// How many robots join, one run after another
    #[arg(long, value_delimiter = ',', default_values = ["500", "1000", "2000"], value_parser = clap::value_parser!(u32).range(1..=9000))]
    robots: Vec<u32>,
    /// Seconds that the processes run on after all have joined, so that they can be looked at
    #[arg(long, default_value_t = 0)]
    stay: u64,
}

async fn run(options: &Options, robots: usize) -> anyhow::Result<bool> {
    let folder = tempfile::tempdir()?;
    let endpoint = free_endpoint()?;
    let router = start_router(&endpoint, folder.path())?;
    let state = folder.path().join("state");
    let state = state.to_string_lossy();
    let arguments = [
        "up",
        "--connect",
        &endpoint,
        "--fleet",
        FLEET,
        "--state-directory",
        &state,
        "--http",
        "none",
        "--no-console",
    ];
    let services = Process::start("muster", &arguments, &[], folder.path())?;
    let console = Client::connect(&endpoint, FLEET).await?;
    let divided = Arc::new(AtomicUsize::new(0));
    let seen = Arc::clone(&divided);
    console
        .listen("json/teams", move |_, teams| {
            let assigned = division(&teams).values().filter(|team| team.is_some()).count();
            seen.store(assigned, Ordering::Relaxed);
        })
        .await?;
    tokio::time::sleep(SERVICES_BEGIN).await;
    let processes = [router.id(), services.id(), std::process::id()];
    let busy = || -> anyhow::Result<Vec<f64>> {
        processes.iter().map(|process| Ok(process_stats(*process, 0.0)?.busy)).collect()
    };
    let (before, begin) = (busy()?, Instant::now());
    let config = Config {
        fleet: FLEET.to_owned(),
        routers: Some(vec![endpoint.clone()]),
        ..Config::default()
    };
    let progress = Arc::new(Progress::default());
    let all = join_all(&config, robots, &progress);
    let (mut joined_after, mut said) = (None, Instant::now());
    while divided.load(Ordering::Relaxed) < robots {
        let so_far = || {
            let divided = divided.load(Ordering::Relaxed);
            format!("{} of {robots} have joined, {divided} are divided", progress.joined())
        };
        if said.elapsed() >= SAY_EVERY {
            said = Instant::now();
            eprintln!("{}", so_far());
        }
        if progress.joined() == robots {
            joined_after.get_or_insert(begin.elapsed().as_secs_f64());
        }
        if let Some(error) = progress.failed() {
            anyhow::bail!("a robot cannot join: {error}");
        }
        anyhow::ensure!(begin.elapsed() < GIVE_UP_AFTER, so_far());
        tokio::time::sleep(LOOK_EVERY).await;
    }
    let (divided_after, after) = (begin.elapsed().as_secs_f64(), busy()?);
    let computed: Vec<f64> =
        after.iter().zip(&before).map(|(after, before)| after - before).collect();
    let goal = (robots == GOAL.0).then_some(GOAL.1);
    let verdict = goal.map_or(String::new(), |goal| {
        format!("; {}: at most {goal} s", if divided_after <= goal { "met" } else { "missed" })
    });
    writeln!(
        std::io::stdout(),
        "{robots} robots: all have joined after {:.1} s, all are divided after {divided_after:.1} s; computed \
         by the router {:.1} s ({:.1} ms a robot), services {:.1} s, robots {:.1} s{verdict}",
        joined_after.unwrap_or(divided_after),
        computed[0],
        computed[0] / robots as f64 * 1000.0,
        computed[1],
        computed[2],
    )?;
    tokio::time::sleep(Duration::from_secs(options.stay)).await;
    drop(all);
    Ok(goal.is_none_or(|goal| divided_after <= goal))
}

#[tokio::main]
async fn main() -> anyhow::Result<ExitCode> {
    let options = Options::parse();
    let mut is_met = true;
    for robots in &options.robots {
        is_met &= run(&options, *robots as usize).await?;
    }
    Ok(if is_met { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
