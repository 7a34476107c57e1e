//! A long run of many robots without a fault, to see that memory stays flat and nothing slows down.
//!
//! It starts a router, the four services and the robots, samples each process and the division every second, and
//! writes once a minute what it measured.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Context;
use serde_json::Value;

use crate::client::{Client, division, is_event_of_robots, now, robots_of_event};
use crate::cluster::{Cluster, SERVICES};
use crate::process_stats::{ProcessStats, process_stats, quantile, slope};

/// Growth of a process that counts as flat, in KiB a minute: at this rate a day costs less than 400 MiB,
/// and a run of ten minutes can distinguish it from the noise of an allocator.
const MAX_GROWTH_KIB: f64 = 256.0;

/// Longest pause of the division, in seconds: it is published once a second, and a busy machine may be late.
const MAX_PAUSE_S: f64 = 5.0;

/// How much of the run is warming up, and how many seconds at most: buffers grow to what the fleet
/// needs, and an allocator takes the memory for them in steps over the first minutes.
const WARM_UP_SHARE: f64 = 0.5;
const MAX_WARM_UP_S: f64 = 300.0;

/// How long the fleet may take to be whole.
const FORMED_WITHIN: Duration = Duration::from_secs(60);

/// Counters of what was lost because too much waited, which must not be where nothing fails.
const LOSS_COUNTERS: [&str; 2] = ["inbox_dropped", "outbox_dropped"];

/// The counter of what a newer message of the same key replaced before it was looked at, as is meant
/// for a service that is slower than its senders.
const SUPERSEDED: &str = "inbox_superseded";

/// What is asked for.
#[derive(Debug, Clone)]
pub struct SteadyOptions {
    /// How many robots.
    pub robots: usize,
    /// In how many groups, and teams.
    pub teams: usize,
    /// For how long, in minutes.
    pub minutes: f64,
    /// Where the memory of all processes over time is written to, as SVG.
    pub plot: Option<PathBuf>,
}

/// The memory of every process over time, as a picture.
fn plot(samples: &BTreeMap<&str, Vec<ProcessStats>>) -> String {
    const WIDTH: f64 = 720.0;
    const HEIGHT: f64 = 320.0;
    const COLOURS: [&str; 6] = ["#1b6", "#26c", "#c33", "#c80", "#808", "#555"];
    let all = || samples.values().flatten();
    let last = all().map(|sample| sample.at).fold(1.0, f64::max);
    let most = all().map(|sample| sample.memory).fold(1024.0, f64::max) / 1024.0;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" font-family=\"sans-serif\" \
         font-size=\"12\">\n<text x=\"4\" y=\"14\">MiB (top: {most:.0}) over {:.1} minutes</text>\n",
        WIDTH + 120.0,
        HEIGHT + 20.0,
        last / 60.0
    );
    for (number, (name, samples)) in samples.iter().enumerate() {
        let colour = COLOURS[number % COLOURS.len()];
        let place = |sample: &ProcessStats| {
            let (x, y) = (sample.at / last * WIDTH, sample.memory / 1024.0 / most * HEIGHT);
            format!("{x:.1},{:.1}", HEIGHT + 20.0 - y)
        };
        let points: Vec<_> = samples.iter().map(place).collect();
        svg += &format!(
            "<polyline fill=\"none\" stroke=\"{colour}\" points=\"{}\"/>\n<text x=\"{}\" y=\"{}\" \
             fill=\"{colour}\">{name}</text>\n",
            points.join(" "),
            WIDTH + 6.0,
            40 + 18 * number
        );
    }
    svg + "</svg>\n"
}

/// What each service counters of some names, where it is not nothing.
async fn counters(client: &Client, names: &[&str]) -> anyhow::Result<BTreeMap<String, u64>> {
    let mut counters = BTreeMap::new();
    for service in SERVICES {
        let status = client.get_one(&format!("service/{service}/status")).await?;
        for name in names {
            let count = status["counters"][name].as_u64();
            let count = count.with_context(|| format!("{service} does not count {name}"))?;
            if count > 0 {
                counters.insert(format!("{service} {name}"), count);
            }
        }
    }
    Ok(counters)
}

/// Writes what each process took; whether the memory of all is flat after so many seconds of warming up.
fn write_processes(
    out: &mut impl Write,
    processes: &[(&str, u32)],
    samples: &BTreeMap<&str, Vec<ProcessStats>>,
    warm: f64,
) -> anyhow::Result<bool> {
    let mut kept = true;
    writeln!(
        out,
        "\n| process | MiB at first | MiB at last | KiB/min after {warm:.0} s | CPU % |"
    )?;
    writeln!(out, "| --- | --- | --- | --- | --- |")?;
    for (name, _) in processes {
        let all = samples.get(name).map(Vec::as_slice).unwrap_or_default();
        let later = &all[all.partition_point(|sample| sample.at < warm)..];
        let (Some(first), Some(last)) = (later.first(), later.last()) else { continue };
        let points: Vec<_> = later.iter().map(|sample| (sample.at, sample.memory)).collect();
        // In KiB a minute.
        let growth = slope(&points) * 60.0;
        let spent = (last.busy - first.busy) / (last.at - first.at);
        writeln!(
            out,
            "| {name} | {:.1} | {:.1} | {growth:.1} | {:.1} |",
            all.first().unwrap_or(first).memory / 1024.0,
            last.memory / 1024.0,
            spent * 100.0
        )?;
        if growth > MAX_GROWTH_KIB {
            kept = false;
            writeln!(out, "{name} grows faster than {MAX_GROWTH_KIB} KiB a minute")?;
        }
    }
    Ok(kept)
}

/// Runs a fleet; whether its memory stayed flat, and nothing was lost or paused for too long.
///
/// # Errors
/// If a program is not built, does not start or ends, or the fleet forms no teams.
pub async fn run(options: &SteadyOptions, out: &mut impl Write) -> anyhow::Result<bool> {
    let teams = format!("teams={}", options.teams);
    let mut cluster = Cluster::start("soak", &[("clusterer", &teams)])?;
    let (robots, groups) = (options.robots.to_string(), options.teams.to_string());
    let scenario = ["--scenario", "clusters", "--robots", &robots, "--teams", &groups];
    let fleet = cluster.robots(&scenario)?;
    let client = cluster.client().await?;
    let divisions = client.watch("json/teams").await?;
    let events = client.watch("json/event").await?;
    let whole = |value: &Value| {
        let division = division(value);
        division.len() == options.robots && division.values().all(Option::is_some)
    };
    divisions.until("every robot in a team", FORMED_WITHIN, whole).await?;
    writeln!(
        out,
        "{} robots in {} teams; {} minutes",
        options.robots, options.teams, options.minutes
    )?;

    let mut processes = vec![("router", cluster.router_id()), ("robots", fleet.id())];
    for service in SERVICES {
        processes.push((service, cluster.service(service)?.id()));
    }
    events.clear();
    divisions.clear();
    let begin = Instant::now();
    let lasts = options.minutes * 60.0;
    let mut samples: BTreeMap<&str, Vec<ProcessStats>> = BTreeMap::new();
    let (mut ages, mut longest, mut last) = (Vec::new(), 0.0_f64, now());
    let (mut incomplete, mut left, mut minute) = (0_usize, 0_usize, 1.0);
    let mut every = tokio::time::interval(Duration::from_secs(1));
    while begin.elapsed().as_secs_f64() < lasts {
        every.tick().await;
        let at = begin.elapsed().as_secs_f64();
        for (name, process) in &processes {
            let sample =
                process_stats(*process, at).with_context(|| format!("{name} has ended"))?;
            samples.entry(name).or_default().push(sample);
        }
        for (arrived, value) in divisions.take() {
            longest = longest.max(arrived - last);
            last = arrived;
            ages.extend(value["data_age_s"].as_f64());
            incomplete += usize::from(!whole(&value));
        }
        longest = longest.max(now() - last);
        for (_, value) in events.take() {
            if is_event_of_robots(&value, "robot_left") {
                let robots = robots_of_event(&value);
                left += robots.len();
                writeln!(out, "after {at:.0} s left: {}", robots.join(" "))?;
            }
        }
        if at >= minute * 60.0 {
            let memory: Vec<_> = processes
                .iter()
                .filter_map(|(name, _)| Some((name, samples.get(name)?.last()?.memory / 1024.0)))
                .map(|(name, memory)| format!("{name} {memory:.1}"))
                .collect();
            writeln!(
                out,
                "minute {minute}: MiB {}; longest pause {longest:.2} s",
                memory.join(", ")
            )?;
            minute += 1.0;
        }
    }
    let warm = (lasts * WARM_UP_SHARE).min(MAX_WARM_UP_S);
    let mut kept = write_processes(out, &processes, &samples, warm)?;
    ages.sort_by(f64::total_cmp);
    writeln!(
        out,
        "\n{} divisions published; data age median {:.3} s, 99 % {:.3} s, greatest {:.3} s; longest pause {longest:.2} s",
        ages.len(),
        quantile(&ages, 0.5),
        quantile(&ages, 0.99),
        quantile(&ages, 1.0)
    )?;
    let lost = counters(&client, &LOSS_COUNTERS).await?;
    writeln!(
        out,
        "{left} times a robot left, {incomplete} divisions incomplete; messages lost: {lost:?}, \
         replaced by newer ones: {:?}",
        counters(&client, &[SUPERSEDED]).await?
    )?;
    kept &= lost.is_empty() && left == 0 && incomplete == 0 && longest <= MAX_PAUSE_S;
    if let Some(path) = &options.plot {
        let written = std::fs::write(path, plot(&samples));
        written.with_context(|| format!("--plot {}", path.display()))?;
    }
    writeln!(out, "{}", if kept { "flat and whole" } else { "NOT flat and whole" })?;
    Ok(kept)
}
