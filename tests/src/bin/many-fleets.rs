//! Measures what `muster up --fleets` takes for many fleets on one host. `many-fleets --help` has the flags;
//! `tests/peers/many-fleets` builds and runs it in release.
//!
//! It ends with 1 if a goal is missed.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::Parser;
use muster_tests::cluster::start_router;
use muster_tests::many_fleets::{Load, Received, drive, fleet_name, listen, sum_of};
use muster_tests::ports::{free_address, free_endpoint};
use muster_tests::process::Process;
use muster_tests::process_stats::{memory_of, process_stats, quantile, threads_of};

/// How long all fleets may take until all of them are ready.
const READY_WITHIN: Duration = Duration::from_secs(480);

/// How long they settle before they are measured.
const SETTLING_TIME: Duration = Duration::from_secs(10);

/// Goals for router and services together: shares of one core, and MiB.
struct Goal {
    load: Load,
    cores: f64,
    memory_mib: f64,
    threads: u64,
    /// Embeddings, and so divisions, a second of each fleet, as a share of the rate of its robots.
    divisions: f64,
}

/// Half of what as many processes took before, in a tenth of the threads; and the fleets that two processors are to serve.
const GOALS: [Goal; 3] = [
    Goal {
        load: Load { fleets: 100, robots: 0, rate_hz: 0.0 },
        cores: 0.23,
        memory_mib: 300.0,
        threads: 270,
        divisions: 0.0,
    },
    Goal {
        load: Load { fleets: 60, robots: 10, rate_hz: 5.0 },
        cores: 0.7,
        memory_mib: 300.0,
        threads: 270,
        divisions: 0.9,
    },
    Goal {
        load: Load { fleets: 1000, robots: 20, rate_hz: 1.0 },
        cores: 2.0,
        memory_mib: 2048.0,
        threads: 270,
        divisions: 0.9,
    },
];

/// Many fleets at one `muster up --fleets` and one router.
#[derive(Debug, Parser)]
#[command(
    after_help = "Examples:\n  tests/peers/many-fleets                       100 idle fleets, 60 of 10 robots, 1,000 of 20\n  \
tests/peers/many-fleets --run 200x20@1 --seconds 120"
)]
struct Options {
    /// What is run, one after another: FLEETSxROBOTS@HZ, where HZ is poses per second of each robot
    #[arg(long, value_delimiter = ',', default_values = ["100x0@0", "60x10@5", "1000x20@1"])]
    run: Vec<Load>,
    /// Seconds that are measured in each run
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=3600))]
    seconds: u64,
    /// Robots that join a second, over all fleets. The router works some ms for each, once there are thousands
    #[arg(long, default_value_t = 100.0)]
    join: f64,
    /// Frames a second of ingest; the rate of the robots if it is not given
    #[arg(long)]
    tick: Option<f64>,
}

/// What was measured.
struct Measured {
    seconds: f64,
    /// Name, share of a core, resident and proportional MiB, threads.
    processes: Vec<(&'static str, f64, f64, f64, u64)>,
    divisions: f64,
    ages: Vec<f64>,
    ready_after: f64,
    metrics_bytes: usize,
    load: [String; 2],
}

fn system_load() -> String {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split(' ').next().unwrap_or_default().to_owned()
}

/// The answer of a port of the host, its head left out.
fn ask(address: SocketAddr, path: &str) -> anyhow::Result<(bool, String)> {
    let mut stream = TcpStream::connect(address)?;
    stream.set_read_timeout(Some(Duration::from_secs(10)))?;
    write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer)?;
    let (head, body) = answer.split_once("\r\n\r\n").context("this is no answer")?;
    Ok((head.starts_with("HTTP/1.1 200"), body.to_owned()))
}

async fn run(options: &Options, load: Load) -> anyhow::Result<Measured> {
    let folder = tempfile::tempdir()?;
    let endpoint = free_endpoint()?;
    let router = start_router(&endpoint, folder.path())?;
    let http: SocketAddr = free_address()?.parse()?;
    let (http_text, state) = (http.to_string(), folder.path().join("state"));
    let state = state.to_string_lossy();
    let names: Vec<String> = (0..load.fleets).map(fleet_name).collect();
    // Idle fleets have no robots that they could appear by.
    let fleets = if load.robots == 0 { names.join(",") } else { "load-*".to_owned() };
    let tick = options.tick.unwrap_or(if load.robots == 0 { 10.0 } else { load.rate_hz });
    let (tick, most) = (format!("ingest.tick_hz={tick}"), load.fleets.to_string());
    let arguments = [
        "up",
        "--connect",
        &endpoint,
        "--state-directory",
        &state,
        "--http",
        &http_text,
        "--fleets",
        &fleets,
        "--max-fleets",
        &most,
        "--set",
        &tick,
        "--set",
        "clusterer.teams=2",
    ];
    let host = Process::start("muster", &arguments, &[], folder.path())?;
    let received = Arc::new(Received::default());
    let (begin, clients) = (Instant::now(), listen(&endpoint, load, &received).await?);
    let robots = drive(&endpoint, load, options.join).await?;
    let all_are_ready = || -> anyhow::Result<bool> {
        let Ok((ready, answer)) = ask(http, "/readyz") else { return Ok(false) };
        let answer: serde_json::Value = serde_json::from_str(&answer)?;
        Ok(ready && answer["fleets"] == load.fleets)
    };
    while !all_are_ready()? {
        if begin.elapsed() > READY_WITHIN {
            let answer = ask(http, "/readyz").map(|(_, answer)| answer).unwrap_or_default();
            let some: String = answer.chars().take(1000).collect();
            println!("not all are ready: {some}");
            break;
        }
        tokio::time::sleep(Duration::from_millis(500)).await;
    }
    let ready_after = begin.elapsed().as_secs_f64();
    tokio::time::sleep(SETTLING_TIME).await;
    let processes =
        [("router", router.id()), ("services", host.id()), ("robots", std::process::id())];
    let sample = || -> anyhow::Result<Vec<_>> {
        processes.iter().map(|(_, process)| process_stats(*process, 0.0)).collect()
    };
    let epochs = || -> anyhow::Result<(f64, usize)> {
        let (_, metrics) = ask(http, "/metrics")?;
        Ok((sum_of(&metrics, "muster_embeddings_published_total", "embedder"), metrics.len()))
    };
    let first_load = system_load();
    let (first, _) = epochs()?;
    received.begin();
    let (start, before) = (Instant::now(), sample()?);
    tokio::time::sleep(Duration::from_secs(options.seconds)).await;
    let (after, seconds) = (sample()?, start.elapsed().as_secs_f64());
    let (last, metrics_bytes) = epochs()?;
    let counted = start.elapsed().as_secs_f64();
    let mut measured = Vec::new();
    for (at, (name, process)) in processes.iter().enumerate() {
        let share = (after[at].busy - before[at].busy) / seconds;
        let memory = after[at].memory / 1024.0;
        measured.push((*name, share, memory, memory_of(*process)? / 1024.0, threads_of(*process)?));
    }
    let ages = received.ages();
    tokio::task::spawn_blocking(move || robots.stop()).await??;
    drop(clients);
    Ok(Measured {
        seconds,
        processes: measured,
        divisions: (last - first) / counted / load.fleets as f64,
        ages,
        ready_after,
        metrics_bytes,
        load: [first_load, system_load()],
    })
}

/// The lines of a run, and the goals that it misses.
fn report(measured: &mut Measured, load: Load) -> (String, Vec<String>) {
    measured.ages.sort_by(f64::total_cmp);
    let at = |share| quantile(&measured.ages, share);
    let mut text = format!(
        "{} fleets of {} robots at {} Hz, {:.0} s, load of the machine {} to {}; all ready after {:.0} s\n",
        load.fleets,
        load.robots,
        load.rate_hz,
        measured.seconds,
        measured.load[0],
        measured.load[1],
        measured.ready_after,
    );
    for (name, share, resident, proportional, threads) in &measured.processes {
        text.push_str(&format!(
            "  {name}: {:.1} % of a core, {resident:.0} MiB resident, {proportional:.0} MiB proportional, {threads} threads\n",
            share * 100.0
        ));
    }
    text.push_str(&format!(
        "  {:.2} embeddings a second of each fleet; data age p50 {:.2} s, p99 {:.2} s of {} divisions; {} KiB of metrics\n",
        measured.divisions,
        at(0.5),
        at(0.99),
        measured.ages.len(),
        measured.metrics_bytes / 1024,
    ));
    let mut missed = Vec::new();
    if let Some(goal) = GOALS.iter().find(|goal| goal.load == load) {
        let of_host = &measured.processes[..2];
        let cores: f64 = of_host.iter().map(|process| process.1).sum();
        let memory: f64 = of_host.iter().map(|process| process.3).sum();
        let threads: u64 = of_host.iter().map(|process| process.4).sum();
        for (is_met, what) in [
            (cores <= goal.cores, format!("router and services take at most {} cores", goal.cores)),
            (memory <= goal.memory_mib, format!("they take at most {} MiB", goal.memory_mib)),
            (threads <= goal.threads, format!("they have at most {} threads", goal.threads)),
            (
                measured.divisions >= goal.divisions * load.rate_hz,
                format!("each is divided {} times a second", goal.divisions * load.rate_hz),
            ),
        ] {
            text.push_str(&format!("  {}: {what}\n", if is_met { "met" } else { "missed" }));
            if !is_met {
                missed.push(what);
            }
        }
    }
    (text, missed)
}

#[tokio::main]
async fn main() -> anyhow::Result<ExitCode> {
    let options = Options::parse();
    let mut is_missed = false;
    for load in &options.run {
        let mut measured = run(&options, *load).await?;
        let (text, missed) = report(&mut measured, *load);
        write!(std::io::stdout(), "{text}")?;
        is_missed |= !missed.is_empty();
    }
    Ok(if is_missed { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}
