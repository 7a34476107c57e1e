//! Measures what `muster-ros2` takes for a fleet of ROS, and how long a pose takes until its robot receives its team there.
//! `ros-load --help` has the flags; `tests/peers/ros-load` builds and runs it in release.
//!
//! It ends with 1 if a goal is missed.

use std::io::Write as _;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::Parser;
use muster_tests::cluster::{Cluster, SERVICES};
use muster_tests::process::Process;
use muster_tests::process_stats::{process_stats, quantile};
use muster_tests::ros_load::{Counts, Load, drive, listen};

/// How long a fleet may take to be divided.
const FORMED_WITHIN: Duration = Duration::from_secs(180);

/// How long it settles before it is measured.
const SETTLING_TIME: Duration = Duration::from_secs(5);

/// The goal for the bridge's share of one core, from this many robots on.
const MOST_SHARE: (usize, f64) = (500, 0.4);

/// The goal for a team, up to this many robots: so many milliseconds beyond a tick at 99 %.
const MOST_BEYOND_TICK: (usize, f64) = (50, 10.0);

/// One tick of the fleet, and of the bridge, in milliseconds.
const TICK_MS: f64 = 100.0;

/// Robots of ROS in numbers at one bridge, with every service as a process, over a real router.
#[derive(Debug, Parser)]
#[command(
    after_help = "Examples:\n  tests/peers/ros-load                                50 and 500 robots\n  \
tests/peers/ros-load --robots 50 --seconds 60\n  tests/peers/ros-load --topics topics.toml           with a file of muster-ros2"
)]
struct Options {
    /// Sizes of the fleet, one run for each
    #[arg(long, value_delimiter = ',', default_values_t = [50, 500],
          value_parser = clap::value_parser!(u32).range(2..=5000))]
    robots: Vec<u32>,
    /// Odometries, and transforms, per second of each robot
    #[arg(long, default_value_t = 50.0)]
    rate: f64,
    /// Seconds that are measured in each run
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=600))]
    seconds: u64,
    /// A file of topics for muster-ros2, in place of its defaults
    #[arg(long, value_name = "FILE")]
    topics: Option<String>,
}

/// What was measured.
struct Measured {
    robots: usize,
    seconds: f64,
    put: u64,
    received: u64,
    /// Shares of one core.
    bridge: f64,
    others: Vec<(&'static str, f64)>,
    memory_mib: f64,
    took: Vec<f64>,
    missing: usize,
    load: [String; 2],
}

fn system_load() -> String {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split(' ').next().unwrap_or_default().to_owned()
}

/// How many messages the bridge has received.
async fn received(client: &muster_tests::client::Client) -> anyhow::Result<u64> {
    let state = client.get_one("bridge/*").await.context("the bridge does not answer")?;
    state["received"].as_u64().context("the bridge tells no number")
}

async fn run(options: &Options, robots: usize) -> anyhow::Result<Measured> {
    // What a team waits for on purpose is not measured.
    let settings = [("clusterer", "teams=2"), ("clusterer", "dwell_s=0")];
    let mut cluster = Cluster::start("alpha", &settings)?;
    let mut arguments = vec!["--connect", cluster.endpoint.as_str(), "--fleet", "alpha"];
    if let Some(topics) = &options.topics {
        arguments.extend(["--topics", topics]);
    }
    let bridge = Process::start("muster-ros2", &arguments, &[], cluster.folder())?;
    let (robots_of_ros, console) = (cluster.client().await?, cluster.client().await?);
    let counts = Arc::new(Counts::default());
    listen(&console, &counts).await?;
    let load = Load { robots, rate_hz: options.rate };
    let driving = {
        let counts = Arc::clone(&counts);
        std::thread::spawn(move || drive(&robots_of_ros, load, &counts))
    };
    let start = Instant::now();
    while counts.divided() < robots {
        anyhow::ensure!(
            start.elapsed() < FORMED_WITHIN && !driving.is_finished(),
            "{} of {robots} robots have a team\n{}",
            counts.divided(),
            bridge.output()
        );
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    tokio::time::sleep(SETTLING_TIME).await;
    let mut processes = vec![("muster-ros2", bridge.id()), ("router", cluster.router_id())];
    for service in SERVICES {
        processes.push((service, cluster.service(service)?.id()));
    }
    processes.push(("robots", std::process::id()));
    let sample = || -> anyhow::Result<Vec<_>> {
        processes.iter().map(|(_, process)| process_stats(*process, 0.0)).collect()
    };
    let first_load = system_load();
    counts.begin_moves();
    let (begin, put, arrived) = (Instant::now(), counts.put(), received(&console).await?);
    let before = sample()?;
    tokio::time::sleep(Duration::from_secs(options.seconds)).await;
    let after = sample()?;
    let seconds = begin.elapsed().as_secs_f64();
    let (put, arrived) = (counts.put() - put, received(&console).await? - arrived);
    counts.stop();
    let driven = tokio::task::spawn_blocking(move || driving.join()).await?;
    driven.map_err(|_| anyhow::anyhow!("the robots have panicked"))??;
    let share = |at: usize| (after[at].busy - before[at].busy) / seconds;
    let others = processes.iter().enumerate().skip(1);
    let (took, missing) = counts.took();
    Ok(Measured {
        robots,
        seconds,
        put,
        received: arrived,
        bridge: share(0),
        others: others.map(|(at, (name, _))| (*name, share(at))).collect(),
        memory_mib: after[0].memory / 1024.0,
        took,
        missing,
        load: [first_load, system_load()],
    })
}

/// The lines of a run, and the goals that it misses.
fn report(measured: &mut Measured, rate: f64) -> (String, Vec<String>) {
    measured.took.sort_by(f64::total_cmp);
    let at = |share| quantile(&measured.took, share);
    let (p50, p99, most) = (at(0.5), at(0.99), at(1.0));
    let others: Vec<_> = measured
        .others
        .iter()
        .map(|(name, share)| format!("{name} {:.0} %", share * 100.0))
        .collect();
    let text = format!(
        "{} robots, {rate} Hz of odometry and as many transforms, {:.0} s, load of the machine {} to {}\n  \
         messages put {:.0}/s, received by the bridge {:.0}/s\n  \
         muster-ros2: {:.1} % of a core, {:.0} MiB; {}\n  \
         pose → team: p50 {p50:.0} ms, p99 {p99:.0} ms, most {most:.0} ms of {} moves; {} without a team in time\n",
        measured.robots,
        measured.seconds,
        measured.load[0],
        measured.load[1],
        measured.put as f64 / measured.seconds,
        measured.received as f64 / measured.seconds,
        measured.bridge * 100.0,
        measured.memory_mib,
        others.join(", "),
        measured.took.len(),
        measured.missing,
    );
    let mut missed = Vec::new();
    if measured.robots >= MOST_SHARE.0 && measured.bridge > MOST_SHARE.1 {
        missed.push(format!("at most {:.0} % of a core", MOST_SHARE.1 * 100.0));
    }
    if measured.robots <= MOST_BEYOND_TICK.0 && p99 > TICK_MS + MOST_BEYOND_TICK.1 {
        missed.push(format!("p99 of at most {:.0} ms", TICK_MS + MOST_BEYOND_TICK.1));
    }
    (text, missed)
}

#[tokio::main]
async fn main() -> anyhow::Result<ExitCode> {
    let options = Options::parse();
    anyhow::ensure!((0.1..=200.0).contains(&options.rate), "--rate: must be 0.1 to 200 per second");
    let mut is_missed = false;
    for robots in &options.robots {
        let mut measured = run(&options, *robots as usize).await?;
        let (text, missed) = report(&mut measured, options.rate);
        write!(std::io::stdout(), "{text}")?;
        for goal in missed {
            is_missed = true;
            writeln!(std::io::stderr(), "missed: {goal}")?;
        }
    }
    Ok(if is_missed { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}
