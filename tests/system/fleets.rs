//! Many fleets in one process: divided rightly and apart, served when they appear, each in peace from the others.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use muster_tests::SOON;
use muster_tests::client::{Client, Division, division};
use muster_tests::cluster::{robots_of, start_router};
use muster_tests::ports::{free_address, free_endpoint};
use muster_tests::process::{Process, run};
use serde_json::{Value, json};

use crate::observe::{get, is, samples, until, value};

/// How long a fleet is flooded.
const FLOODED_FOR: Duration = Duration::from_secs(12);

/// Messages of the flood after which it pauses, and for how long: some 10,000 a second, of which the tests that run at the same
/// time can spare the processor time.
const FLOOD: (u64, Duration) = (500, Duration::from_millis(25));

/// Two teams in each fleet, which has a hundred robots at most.
const SMALL_FLEETS: [&str; 4] = ["--set", "clusterer.teams=2", "--set", "ingest.max_robots=100"];

/// A host that serves fleets at a router, with its port.
struct Host {
    endpoint: String,
    address: String,
    folder: tempfile::TempDir,
    router: Process,
    services: Process,
    flags: Vec<String>,
}

impl Host {
    fn start(fleets: &str, flags: &[&str]) -> Self {
        Self::start_with(fleets, flags, |_| ())
    }

    fn start_with(fleets: &str, flags: &[&str], prepare: impl FnOnce(&Path)) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (endpoint, address) = (free_endpoint().unwrap(), free_address().unwrap());
        let router = start_router(&endpoint, folder.path()).unwrap();
        prepare(&folder.path().join("state"));
        let state = folder.path().join("state").to_string_lossy().into_owned();
        let own = ["--connect", &endpoint, "--http", &address, "--state-directory", &state];
        let flags: Vec<String> = [&["up", "--fleets", fleets][..], &own, flags]
            .concat()
            .into_iter()
            .map(str::to_owned)
            .collect();
        let services = up(&flags, folder.path());
        Self { endpoint, address, folder, router, services, flags }
    }

    fn restart(&mut self) {
        self.services.kill().unwrap();
        self.services = up(&self.flags, self.folder.path());
    }

    /// Robots that stand in groups.
    fn robots(&self, fleet: &str, scenario: &[&str]) -> Process {
        let own = ["robot", "--fleet", fleet, "--connect", &self.endpoint];
        Process::start("muster", &[&own[..], scenario].concat(), &[], self.folder.path()).unwrap()
    }

    async fn client(&self, fleet: &str) -> Client {
        Client::connect(&self.endpoint, fleet).await.unwrap()
    }

    fn ready(&self) -> Value {
        let (_, body) = get(&self.address, "/readyz").unwrap();
        serde_json::from_str(&body).unwrap()
    }
}

fn up(flags: &[String], folder: &Path) -> Process {
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    Process::start("muster", &flags, &[], folder).unwrap()
}

fn groups(count: &'static str, robots: &'static str, seed: &'static str) -> [&'static str; 8] {
    ["--scenario", "clusters", "--teams", count, "--robots", robots, "--seed", seed]
}

/// Whether robots are together in a division exactly where they are in the scenario.
fn is_right(division: &Division, truth: &std::collections::BTreeMap<String, String>) -> bool {
    let mut of_team = std::collections::BTreeMap::new();
    let mut of_group = std::collections::BTreeMap::new();
    division.len() == truth.len()
        && truth.iter().all(|(robot, group)| {
            let Some(Some(team)) = division.get(robot) else { return false };
            of_team.entry(team).or_insert(group) == &group
                && of_group.entry(group).or_insert(team) == &team
        })
}

async fn divided(client: &Client, scenario: &[&str]) -> Division {
    let truth = robots_of(scenario).unwrap();
    let right = |teams: &Value| is_right(&division(teams), &truth);
    division(&client.until("json/teams", SOON, right).await.unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn fleets_of_one_process_are_divided_apart_and_keep_their_teams_over_a_restart() {
    let mut host = Host::start("alpha,beta", &["--set", "clusterer.teams=3"]);
    let scenarios = [("alpha", groups("3", "12", "1")), ("beta", groups("3", "15", "2"))];
    let _robots = scenarios.map(|(fleet, scenario)| host.robots(fleet, &scenario));
    let clients = [host.client("alpha").await, host.client("beta").await];
    let mut before = Vec::new();
    for (client, (_, scenario)) in clients.iter().zip(&scenarios) {
        before.push(divided(client, scenario).await);
    }
    // Each has settings of its own.
    let changed =
        clients[1].get("service/clusterer/settings", Some(&json!({"dwell_s": 1.5}))).await;
    assert!(changed.unwrap().iter().any(|(_, answer)| answer.is_ok()));
    for (client, wanted) in clients.iter().zip([0.5, 1.5]) {
        let settings = client.get_one("service/clusterer/settings").await.unwrap();
        assert_eq!(settings["dwell_s"], wanted, "{settings}");
    }
    // Operators see each fleet as if it were alone.
    for fleet in ["alpha", "beta"] {
        let arguments = ["status", "--fleet", fleet, "--connect", &host.endpoint];
        let (code, output, errors) = run("muster", &arguments, SOON).unwrap();
        assert_eq!(code, Some(0), "{output}{errors}");
        assert!(output.contains("clusterer") && output.contains("ingest"), "{output}");
    }
    until("all are ready", || is(&host.address, "/readyz", 200));
    assert_eq!(host.ready()["fleets"], 2);
    let samples = samples(&host.address);
    for (fleet, robots) in [("alpha", 12.0), ("beta", 15.0)] {
        let labels = [("fleet", fleet), ("presence", "active")];
        assert_eq!(value(&samples, "muster_robots", &labels), Some(robots));
    }
    assert_eq!(value(&samples, "muster_fleets", &[]), Some(2.0));

    host.restart();
    let start = muster_tests::client::now();
    for (client, before) in clients.iter().zip(&before) {
        let fresh = |teams: &Value| {
            crate::restarts::stage(teams, "clusterer") > start && division(teams) == *before
        };
        client.until("json/teams", SOON, fresh).await.unwrap();
    }
    let settings = clients[1].get_one("service/clusterer/settings").await.unwrap();
    assert_eq!(settings["dwell_s"], 1.5, "what was set is kept");
}

#[tokio::test(flavor = "multi_thread")]
async fn fleets_of_a_pattern_are_served_when_they_appear_and_not_more_than_may_be() {
    let host = Host::start("site-*", &["--max-fleets", "2", "--set", "clusterer.teams=2"]);
    until("it waits", || is(&host.address, "/readyz", 200));
    assert_eq!(host.ready()["fleets"], 0);
    let scenario = groups("2", "8", "1");
    let _robots = ["site-1", "other", "site-2"].map(|fleet| host.robots(fleet, &scenario));
    for fleet in ["site-1", "site-2"] {
        divided(&host.client(fleet).await, &scenario).await;
    }
    let _third = host.robots("site-3", &scenario);
    until("the third is counted", || {
        value(&samples(&host.address), "muster_fleets_refused", &[]) == Some(1.0)
    });
    assert_eq!(host.ready()["fleets"], 2);
    for fleet in ["other", "site-3"] {
        assert!(host.client(fleet).await.get_one("json/teams").await.is_err(), "{fleet}");
    }
    assert!(host.services.output().contains("fleet site-3 is not served"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fleet_of_a_pattern_without_robots_makes_room_and_comes_back_as_it_was() {
    let limits = ["--max-fleets", "1", "--idle-after", "2", "--set", "clusterer.teams=2"];
    let host = Host::start("site-*", &limits);
    let scenario = groups("2", "8", "1");
    let series_of = |fleet: &str| {
        let of_fleet = format!("fleet=\"{fleet}\"");
        get(&host.address, "/metrics").unwrap().1.lines().any(|line| line.contains(&of_fleet))
    };
    let mut before = None;
    for fleet in ["site-1", "site-2", "site-1"] {
        let mut robots = host.robots(fleet, &scenario);
        let teams = divided(&host.client(fleet).await, &scenario).await;
        assert!(series_of(fleet), "{fleet} has metrics");
        if fleet == "site-1" {
            assert_eq!(*before.get_or_insert_with(|| teams.clone()), teams, "the teams of before");
        }
        robots.kill().unwrap();
        until("it is let go of", || host.ready()["fleets"] == 0);
        until("its metrics are gone", || !series_of(fleet));
    }
    assert!(host.services.output().contains("fleet site-1 has had no robots for long"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flooded_fleet_that_cannot_store_anything_does_not_delay_another() {
    let host = Host::start_with("alpha,beta", &SMALL_FLEETS, |state| {
        // Where the folder of the fleet is to be, there is a file.
        std::fs::create_dir_all(state).unwrap();
        std::fs::write(state.join("alpha"), "").unwrap();
    });
    let scenario = groups("2", "8", "1");
    let _robots = host.robots("beta", &scenario);
    let beta = host.client("beta").await;
    divided(&beta, &scenario).await;
    let stop = Arc::new(AtomicBool::new(false));
    let flood = {
        let (client, stop) = (host.client("alpha").await, Arc::clone(&stop));
        tokio::spawn(async move {
            let mut number = 0_u64;
            while !stop.load(Ordering::Relaxed) {
                number += 1;
                if number.is_multiple_of(FLOOD.0) {
                    tokio::time::sleep(FLOOD.1).await;
                }
                let tail = format!("robot/r{}/pose", number % 3000);
                let pose = json!({"x": number, "y": 1.0, "boot": "b", "seq": number});
                client.put(&tail, &pose).await.unwrap();
            }
            number
        })
    };
    let teams = beta.watch("json/teams").await.unwrap();
    let start = Instant::now();
    while start.elapsed() < FLOODED_FOR {
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    stop.store(true, Ordering::Relaxed);
    let flooded = flood.await.unwrap();
    let received = teams.timed();
    let ages: Vec<f64> =
        received.iter().filter_map(|(_, teams)| teams["data_age_s"].as_f64()).collect();
    let oldest = ages.iter().copied().fold(0.0, f64::max);
    let moments: Vec<f64> = received.iter().map(|(at, _)| *at).collect();
    let longest_pause = moments.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
    println!(
        "{flooded} messages in {:?}, {} divisions, the oldest {oldest} s, the longest pause {longest_pause} s",
        start.elapsed(),
        ages.len()
    );
    // Where no robot moves, a division is repeated each second; a shared queue would let none through.
    assert!(ages.len() >= 4, "{} divisions with {flooded} messages", ages.len());
    assert!(longest_pause < 10.0, "none for {longest_pause} s with {flooded} messages");
    assert!(oldest < 10.0, "data of {oldest} s with {flooded} messages");
    let samples = samples(&host.address);
    let unwritable = |fleet| {
        let labels = [("fleet", fleet), ("service", "clusterer")];
        value(&samples, "muster_state_unwritable", &labels)
    };
    assert_eq!((unwritable("alpha"), unwritable("beta")), (Some(1.0), Some(0.0)));
    assert!(is(&host.address, "/healthz", 200));
}

/// A message that came twice would be refused as a repetition, and a get answered twice.
#[tokio::test(flavor = "multi_thread")]
async fn a_fleet_that_two_patterns_mean_is_served_once() {
    let host = Host::start("site-*,site-1,*-1", &SMALL_FLEETS);
    let scenario = groups("2", "8", "1");
    let _robots = host.robots("site-1", &scenario);
    let client = host.client("site-1").await;
    divided(&client, &scenario).await;
    let all = client.get_from_all("service/ingest/status").await.unwrap();
    assert_eq!(all.len(), 1, "{all:?}");
    let samples = samples(&host.address);
    let labels = [("fleet", "site-1"), ("service", "ingest")];
    assert_eq!(value(&samples, "muster_messages_refused_total", &labels), Some(0.0));
    assert_eq!(value(&samples, "muster_fleets", &[]), Some(1.0));
}

#[tokio::test(flavor = "multi_thread")]
async fn two_hosts_serve_the_same_fleets_and_one_takes_over() {
    let mut host = Host::start("site-*", &["--set", "clusterer.teams=2"]);
    let scenario = groups("2", "8", "1");
    let _robots = host.robots("site-1", &scenario);
    let client = host.client("site-1").await;
    let before = divided(&client, &scenario).await;
    let second = [
        "up",
        "--fleets",
        "site-*",
        "--connect",
        &host.endpoint,
        "--state-directory",
        "none",
        "--set",
        "clusterer.teams=2",
    ];
    let _second = Process::start("muster", &second, &[], host.folder.path()).unwrap();
    let standby = |status: &[Value]| status.len() == 2;
    let start = Instant::now();
    loop {
        let all = client.get_from_all("service/clusterer/status").await.unwrap();
        if standby(&all) {
            break;
        }
        assert!(start.elapsed() < SOON, "{all:?}");
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    // The standby reads what the leader published for its readers.
    tokio::time::sleep(Duration::from_secs(3)).await;
    host.services.kill().unwrap();
    let killed = muster_tests::client::now();
    let fresh = |teams: &Value| {
        crate::restarts::stage(teams, "clusterer") > killed && division(teams) == before
    };
    client.until("json/teams", SOON, fresh).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn all_fleets_go_on_when_their_router_is_back() {
    let mut host = Host::start("alpha,beta", &SMALL_FLEETS);
    let scenario = groups("2", "8", "1");
    let _robots = ["alpha", "beta"].map(|fleet| host.robots(fleet, &scenario));
    let mut before = Vec::new();
    for fleet in ["alpha", "beta"] {
        before.push(divided(&host.client(fleet).await, &scenario).await);
    }
    host.router.kill().unwrap();
    until("they are not ready", || is(&host.address, "/readyz", 503));
    until("both are named", || {
        host.ready()["not_ready"].as_object().is_some_and(|fleets| fleets.len() == 2)
    });
    assert!(is(&host.address, "/healthz", 200), "an outage is no reason to restart the host");
    host.router = start_router(&host.endpoint, host.folder.path()).unwrap();
    let back = muster_tests::client::now();
    for (fleet, before) in ["alpha", "beta"].into_iter().zip(before) {
        let fresh = |teams: &Value| {
            crate::restarts::stage(teams, "clusterer") > back && division(teams) == before
        };
        host.client(fleet).await.until("json/teams", SOON, fresh).await.unwrap();
    }
    until("they are ready", || is(&host.address, "/readyz", 200));
}

#[test]
fn what_does_not_fit_together_is_refused() {
    for (flags, problem) in [
        (&["up", "--fleets", "A b"][..], "names no fleets"),
        (&["up", "--fleets", "a", "--max-fleets", "0"], "must be 1 to 5000"),
        (&["up", "--fleets", "a,b", "--max-fleets", "1"], "--max-fleets is 1"),
        (&["--fleet", "a", "up", "--fleets", "b"], "not both"),
        (&["up", "--max-fleets", "3"], "--fleets"),
        (&["up", "--fleets", "site-*", "--idle-after", "0"], "must be 2 to 604800"),
        (&["up", "--idle-after", "60"], "--fleets"),
        (&["up", "--fleets", "a", "--record", "x"], "cannot be used with"),
        (
            &["--listen", "tcp/127.0.0.1:0", "up", "--fleets", "a", "--http", "none"],
            "an address to listen at",
        ),
    ] {
        let (code, _, errors) = run("muster", flags, SOON).unwrap();
        assert_eq!(code, Some(2), "{flags:?} {errors}");
        assert!(errors.contains(problem), "{flags:?} {errors}");
    }
}
