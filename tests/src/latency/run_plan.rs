//! One run with a number of robots: starts everything, waits until the fleet is divided, measures.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::Context;
use muster_model::embedding::EmbeddingMode;
use muster_model::settings::IngestSettings;
use serde_json::Value;

use super::drive::{self, Puts};
use super::follow::{Division, Ways, follow, follow_changes};
use super::listen::{Listener, Received};
use super::traffic::Traffic;
use super::{echo, now_us};
use crate::client::Client;
use crate::cluster::{Cluster, SERVICES};
use crate::neighbours::Neighbours;
use crate::process::Process;
use crate::process_stats::{ProcessStats, process_stats, quantile, slope};

/// The fleet of a run.
pub const FLEET: &str = "latency";

/// How long services may take to be there, and a fleet to be divided as a whole.
const FORMED_WITHIN: Duration = Duration::from_secs(180);

/// How long the last poses may take to become a division. They are missing after that.
const DRAINED_WITHIN: Duration = Duration::from_secs(20);

/// How long it is listened what each key carries, before anything is measured.
const TRAFFIC_LASTS: Duration = Duration::from_secs(3);

/// What services count of messages that came to an end: accepted, refused, replaced in the inbox by a
/// newer one of the same robot.
const ACCEPTED_COUNTERS: [&str; 3] = ["poses_accepted", "links_accepted", "ranks_accepted"];

/// Counters of what was lost because too much waited, which must not be.
const LOSS_COUNTERS: [&str; 2] = ["inbox_dropped", "outbox_dropped"];

/// What to run.
#[derive(Debug, Clone)]
pub struct RunPlan {
    /// How many robots.
    pub robots: usize,
    /// In how many teams they march.
    pub teams: usize,
    /// Poses per second of each.
    pub rate_hz: f64,
    /// How long the round trip is measured before there are robots, and how long the fleet is divided
    /// before it is measured: searches get their history, allocators their memory.
    pub settles: Duration,
    /// How long is measured.
    pub lasts: Duration,
    /// Changes of settings, such as `("ingest", "tick_hz=20")`.
    pub settings: Vec<(String, String)>,
    /// How many other processes compute all the time, for each processor, from before the robots join.
    pub busy: usize,
    /// How many robots wishes pin to the teams that they are in, from before anything is measured.
    pub pins: usize,
}

/// Some percentiles.
#[derive(Debug, Clone, Copy)]
pub struct Spread {
    /// The median.
    pub p50: f64,
    /// What 99 % are below.
    pub p99: f64,
    /// The greatest.
    pub most: f64,
}

impl Spread {
    /// Those of values in any order.
    #[must_use]
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_by(f64::total_cmp);
        Self {
            p50: quantile(&values, 0.5),
            p99: quantile(&values, 0.99),
            most: quantile(&values, 1.0),
        }
    }
}

/// What a process took.
#[derive(Debug, Clone)]
pub struct Taken {
    /// The process.
    pub name: &'static str,
    /// Seconds of processor time per second.
    pub processors: f64,
    /// The greatest resident memory in MiB.
    pub memory: f64,
}

/// What was measured. Durations are in milliseconds.
#[derive(Debug)]
pub struct Measured {
    /// What was run.
    pub plan: RunPlan,
    /// When it was measured, in microseconds since 1970.
    pub window: (u64, u64),
    /// How long was measured, in seconds.
    pub seconds: f64,
    /// Poses that were put.
    pub poses: usize,
    /// How they became divisions.
    pub ways: Ways,
    /// Milliseconds from a pose to the message that gives its robot another team.
    pub changes: Vec<f64>,
    /// Number of messages on `robot/*/team`.
    pub team_messages: usize,
    /// Divisions that arrived.
    pub divisions: Vec<Division>,
    /// Embeddings that arrived, by their mode.
    pub modes: BTreeMap<String, usize>,
    /// The lengths of vectors that embeddings had, least and greatest.
    pub dimensions: (u32, u32),
    /// The greatest residual.
    pub residual: f64,
    /// What the stages of an embedding that was computed took: fusing and the radius, the similarity,
    /// the decomposition.
    pub embedding: [Spread; 3],
    /// The time from a division to its audit, and that within `auditor`.
    pub audit: [Spread; 2],
    /// Audits that arrived.
    pub audits: usize,
    /// The round trip without robots, and under their load.
    pub round_trip: [Spread; 2],
    /// Pings under the load of the robots that did not come back.
    pub pings_missing: usize,
    /// Messages that were put and that `ingest` never saw.
    pub lost_on_the_way: i64,
    /// What services dropped or refused, where it is not nothing.
    pub dropped: BTreeMap<String, u64>,
    /// Messages that a newer one of the same key replaced in an inbox, by service.
    pub replaced: BTreeMap<String, u64>,
    /// What each process took.
    pub taken: Vec<Taken>,
    /// What each key carried.
    pub traffic: Traffic,
}

impl Measured {
    /// Divisions per second.
    #[must_use]
    pub fn rate(&self) -> f64 {
        self.divisions.len() as f64 / self.seconds
    }

    /// The age of the oldest pose behind each division as it was decided, with the moment in seconds
    /// since the beginning.
    #[must_use]
    pub fn ages(&self) -> Vec<(f64, f64)> {
        let begin = self.divisions.first().map_or(0, |division| division.stages[2].1);
        let age = |division: &Division| {
            let decided = division.stages[2].1;
            let at = decided.saturating_sub(begin) as f64 / 1e6;
            Some((at, decided.saturating_sub(division.oldest?) as f64 / 1e3))
        };
        self.divisions.iter().filter_map(age).collect()
    }

    /// The longest time in milliseconds without a division of newer data than those before, from the beginning of
    /// what was measured to its end.
    #[must_use]
    pub fn longest_pause(&self) -> f64 {
        let (begin, end) = self.window;
        let (mut newest, mut since, mut longest) = (0, begin, 0);
        for division in &self.divisions {
            let made = division.stages[0].1;
            if made > newest {
                longest = longest.max(division.arrived.saturating_sub(since));
                (newest, since) = (made, division.arrived);
            }
        }
        longest.max(end.saturating_sub(since)) as f64 / 1e3
    }

    /// By how many milliseconds the age grows in a minute, by the straight line that fits best.
    #[must_use]
    pub fn growth(&self) -> f64 {
        slope(&self.ages()) * 60.0
    }
}

/// Runs a plan. `progress` receives a line for each step.
///
/// # Errors
/// If a process does not start or ends, or the fleet is not divided in time.
pub async fn run(plan: &RunPlan, progress: impl Fn(String)) -> anyhow::Result<Measured> {
    let robots = plan.robots;
    let set = plan.settings.iter().map(|(service, set)| (service.as_str(), set.as_str()));
    // A fleet that is larger than one may be by default.
    let larger = (plan.robots > IngestSettings::default().max_robots as usize)
        .then(|| format!("max_robots={robots}"));
    let larger = larger.iter().map(|larger| ("ingest", larger.as_str()));
    let settings: Vec<_> = larger.chain(set).collect();
    progress(format!("{robots} robots: a router and four services start"));
    let mut cluster = Cluster::start(FLEET, &settings)?;
    let client = cluster.client().await?;
    let ours = |arguments: &[&str]| {
        Process::start(
            "latency",
            &[&["--router", &cluster.endpoint], arguments].concat(),
            &[],
            cluster.folder(),
        )
    };
    let echo = ours(&["--echo"])?;
    for service in SERVICES {
        serving(&client, service).await?;
    }
    let size = drive::pose_json([100.0; 2], 100, "0123456789abc", now_us()).len();
    let (idle, _) = echo::ping(&client, size, plan.settles).await?;
    let neighbours = Neighbours::start(plan.busy)?;

    let listener = Listener::start(&client, robots).await?;
    let folder = cluster.folder().join("robots");
    std::fs::create_dir(&folder)?;
    let (many, groups, rate) =
        (robots.to_string(), plan.teams.to_string(), plan.rate_hz.to_string());
    let place = folder.to_string_lossy();
    let mut fleet =
        ours(&["--drive", &place, "--robots", &many, "--teams", &groups, "--rate", &rate])?;
    progress(format!("{robots} robots: they join"));
    let whole = || listener.newest().is_some_and(|newest| newest.robots == robots);
    until(FORMED_WITHIN, "all robots in one division", || {
        anyhow::ensure!(fleet.is_running()?, "the robots have ended:\n{}", fleet.output());
        Ok(whole())
    })
    .await?;
    progress(format!("{robots} robots: divided; measuring for {:.0} s", plan.lasts.as_secs_f64()));
    let traffic = Traffic::listen(&cluster.client().await?, robots, TRAFFIC_LASTS).await?;
    tokio::time::sleep(plan.settles).await;
    if plan.pins > 0 {
        pin(&cluster, plan)?;
        tokio::time::sleep(plan.settles).await;
    }

    let mut processes = vec![("router", cluster.router_id()), ("robots", fleet.id())];
    for service in SERVICES {
        processes.push((service, cluster.service(service)?.id()));
    }
    processes.push(("listener", std::process::id()));
    let pinging = {
        let (client, lasts) = (cluster.client().await?, plan.lasts);
        tokio::spawn(async move { echo::ping(&client, size, lasts).await })
    };
    listener.begin();
    let window = now_us();
    let samples = watch(&processes, plan.lasts).await?;
    let window = (window, now_us());
    let (loaded, pings_missing) = pinging.await??;
    drop(neighbours);

    drive::stop(&folder)?;
    let mut puts = None;
    until(DRAINED_WITHIN, "the log of the robots", || {
        puts = Puts::read(&folder)?;
        Ok(puts.is_some())
    })
    .await?;
    let puts = puts.context("the robots have written no log")?;
    let last: Vec<_> = puts.poses.iter().map(|poses| (poses.len() as u64).checked_sub(1)).collect();
    // What is still missing then is counted.
    let drained = until(DRAINED_WITHIN, "the last poses", || Ok(listener.covered() == last)).await;
    if let Err(error) = drained {
        progress(format!("{robots} robots: {error}"));
    }
    let counters = counters(&client).await?;
    drop((fleet, echo));
    let received = listener.take();
    Ok(measured(
        plan,
        window,
        &puts,
        received,
        SideMeasurements { samples, counters, idle, loaded, pings_missing, traffic },
    ))
}

/// Pins robots to the teams that they are in, as many in each.
fn pin(cluster: &Cluster, plan: &RunPlan) -> anyhow::Result<()> {
    let (_, out, err) = cluster.muster(&["teams", "--json"])?;
    let division: Value = serde_json::from_str(&out).with_context(|| format!("no teams: {err}"))?;
    let teams = division["teams"].as_array().context("a division without teams")?;
    let each = plan.pins.div_ceil(teams.len().max(1));
    let members = |team: &Value| team["members"].as_array().cloned().unwrap_or_default();
    let all = teams.iter().flat_map(|team| {
        members(team).into_iter().take(each).map(|member| (member, team["id"].clone()))
    });
    for (robot, team) in all.take(plan.pins) {
        let (robot, team) = (robot.as_str().context("a member")?, team.as_str().context("an id")?);
        let (code, _, err) = cluster.muster(&["wish", "pin", robot, team])?;
        anyhow::ensure!(code == Some(0), "{robot} is not pinned: {err}");
    }
    Ok(())
}

/// What was measured besides the messages.
struct SideMeasurements {
    samples: Vec<(&'static str, Vec<ProcessStats>)>,
    counters: BTreeMap<&'static str, BTreeMap<String, u64>>,
    idle: Vec<f64>,
    loaded: Vec<f64>,
    pings_missing: usize,
    traffic: Traffic,
}

fn measured(
    plan: &RunPlan,
    window: (u64, u64),
    puts: &Puts,
    mut received: Received,
    side: SideMeasurements,
) -> Measured {
    let ways = follow(puts, window, &received.frames, &received.divisions);
    let changes = follow_changes(puts, &received.frames, &received.team_messages);
    let within = |moment: u64| (window.0..window.1).contains(&moment);
    let poses = puts.poses.iter().flatten().filter(|put| within(**put)).count();
    received.divisions.retain(|division| within(division.arrived));
    received.team_messages.retain(|message| within(message.arrived));
    let mut modes = BTreeMap::new();
    for embedding in &received.embeddings {
        *modes.entry(format!("{:?}", embedding.mode)).or_default() += 1;
    }
    let computed = received.embeddings.iter().filter(|e| e.mode != EmbeddingMode::Cached);
    let lengths = received.embeddings.iter().map(|embedding| embedding.dimension);
    let audits = received.audits.iter();
    let took = |from: u64, to: u64| to.saturating_sub(from) as f64 / 1e3;

    let ingest = side.counters.get("ingest");
    let count = |name: &str| ingest.and_then(|counters| counters.get(name)).copied().unwrap_or(0);
    let refused = count("messages_refused");
    let seen = ACCEPTED_COUNTERS.iter().map(|name| count(name)).sum::<u64>()
        + count("inbox_superseded")
        + refused;
    let named = |names: &[&str]| -> BTreeMap<String, u64> {
        let all = side.counters.iter().flat_map(|(service, counters)| {
            names.iter().filter_map(move |name| {
                let count = *counters.get(*name)?;
                Some((format!("{service} {name}"), count))
            })
        });
        all.filter(|(_, count)| *count > 0).collect()
    };
    let mut dropped = named(&LOSS_COUNTERS);
    dropped.extend(named(&["messages_refused", "jobs_failed"]));
    if received.lost > 0 {
        dropped.insert("listener".to_owned(), received.lost);
    }
    Measured {
        plan: plan.clone(),
        window,
        seconds: (window.1 - window.0) as f64 / 1e6,
        poses,
        ways,
        changes,
        team_messages: received.team_messages.len(),
        modes,
        dimensions: (lengths.clone().min().unwrap_or(0), lengths.max().unwrap_or(0)),
        residual: received.embeddings.iter().map(|e| e.residual).fold(0.0, f64::max),
        embedding: [0, 1, 2].map(|stage| Spread::of(computed.clone().map(|e| e.stage_ms[stage]))),
        audit: [
            Spread::of(audits.clone().map(|audit| took(audit.divided, audit.stage.1))),
            Spread::of(audits.clone().map(|audit| took(audit.stage.0, audit.stage.1))),
        ],
        audits: audits.len(),
        divisions: received.divisions,
        round_trip: [Spread::of(side.idle), Spread::of(side.loaded)],
        pings_missing: side.pings_missing,
        lost_on_the_way: puts.messages as i64 - seen as i64,
        dropped,
        replaced: named(&["inbox_superseded"]),
        taken: side.samples.iter().filter_map(|(name, samples)| taken(name, samples)).collect(),
        traffic: side.traffic,
    }
}

fn taken(name: &'static str, samples: &[ProcessStats]) -> Option<Taken> {
    let (first, last) = (samples.first()?, samples.last()?);
    Some(Taken {
        name,
        processors: (last.busy - first.busy) / (last.at - first.at),
        memory: samples.iter().map(|sample| sample.memory).fold(0.0, f64::max) / 1024.0,
    })
}

/// Looks at processes every second for a time.
async fn watch(
    processes: &[(&'static str, u32)],
    lasts: Duration,
) -> anyhow::Result<Vec<(&'static str, Vec<ProcessStats>)>> {
    let mut samples: Vec<_> = processes.iter().map(|(name, _)| (*name, Vec::new())).collect();
    let (begin, mut every) = (Instant::now(), tokio::time::interval(Duration::from_secs(1)));
    loop {
        every.tick().await;
        let at = begin.elapsed().as_secs_f64();
        for ((name, process), (_, samples)) in processes.iter().zip(&mut samples) {
            samples.push(process_stats(*process, at).with_context(|| format!("{name} has ended"))?);
        }
        if begin.elapsed() >= lasts {
            return Ok(samples);
        }
    }
}

/// The status of a service, as soon as an instance leads.
async fn serving(client: &Client, service: &str) -> anyhow::Result<Value> {
    let leads = |status: &Value| status["standing"] == "holding";
    client.until(&format!("service/{service}/status"), FORMED_WITHIN, leads).await
}

/// What each service has side.
async fn counters(
    client: &Client,
) -> anyhow::Result<BTreeMap<&'static str, BTreeMap<String, u64>>> {
    let mut counters = BTreeMap::new();
    for service in SERVICES {
        let status = serving(client, service).await?;
        let of = status["counters"].as_object().context("a status without counters")?;
        let numbers = of.iter().filter_map(|(name, count)| Some((name.clone(), count.as_u64()?)));
        counters.insert(service, numbers.collect());
    }
    Ok(counters)
}

/// Waits until something is so.
async fn until(
    within: Duration,
    what: &str,
    mut is_so: impl FnMut() -> anyhow::Result<bool>,
) -> anyhow::Result<()> {
    let begin = Instant::now();
    while !is_so()? {
        anyhow::ensure!(begin.elapsed() < within, "not within {within:?}: {what}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    Ok(())
}
