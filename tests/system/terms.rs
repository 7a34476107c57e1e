//! Terms after a loss of state, and terms that were forged.

use std::time::{Duration, Instant};

use muster_tests::SOON;
use muster_tests::cluster::{Cluster, SERVICES};
use muster_wire::Outbound;
use serde_json::Value;

use crate::cli::division;
use crate::pipeline::{formed, truth};
use crate::restarts::{now, stage};

const SCENARIO: [&str; 4] = ["--scenario", "clusters", "--robots", "6"];

/// The highest term that the protocol can carry.
const LARGEST: u64 = (1 << 48) - 1;

fn place(value: &Value) -> (u64, u64) {
    (value["term"].as_u64().unwrap(), value["epoch"].as_u64().unwrap())
}

fn kill_all(cluster: &mut Cluster) {
    for service in SERVICES {
        cluster.service(service).unwrap().kill().unwrap();
    }
}

fn start_all(cluster: &mut Cluster) {
    for service in SERVICES {
        cluster.start_service(service).unwrap();
    }
}

/// Waits until `muster doctor` finds or notes one of these about a service.
fn doctor_finds(cluster: &Cluster, ids: &[&str], service: &str) {
    let start = Instant::now();
    loop {
        let (_, out, err) = cluster.muster(&["doctor", "--json", "--listen-for", "1"]).unwrap();
        let report: Value = serde_json::from_str(&out).unwrap_or_else(|_| panic!("{out}{err}"));
        let [findings, notes] =
            ["findings", "notes"].map(|name| report[name].as_array().unwrap().iter());
        let is_it = |finding: &Value| {
            ids.contains(&finding["id"].as_str().unwrap())
                && finding["seen"].as_str().unwrap().contains(service)
        };
        if findings.chain(notes).any(is_it) {
            return;
        }
        assert!(start.elapsed() < SOON, "{ids:?} are not found: {report:#}");
    }
}

/// Robots and consoles drop what is below the last (term, epoch) that they have.
#[tokio::test(flavor = "multi_thread")]
async fn services_that_have_lost_all_state_are_believed_at_once() {
    let mut cluster =
        Cluster::start_drawn("lost_all_state", &[("clusterer", "teams=2")], &SCENARIO).unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    formed(&client, &truth(&cluster, &SCENARIO)).await;
    let teams = client.watch("json/teams").await.unwrap();
    let own = client.watch("robot/*/team").await.unwrap();
    teams.until("a division", SOON, |value| place(value).1 > 3).await.unwrap();
    own.until("a team of a robot", SOON, |_| true).await.unwrap();
    kill_all(&mut cluster);
    std::fs::remove_dir_all(cluster.folder().join("state")).unwrap();
    let since = now();
    start_all(&mut cluster);
    let is_new = |value: &Value| stage(value, "clusterer") > since;
    for watch in [&teams, &own] {
        watch.until("an output of the restarted clusterer", SOON, is_new).await.unwrap();
        let all: Vec<Value> = watch.all().into_iter().map(|(_, value)| value).collect();
        let before = all.iter().filter(|value| !is_new(value)).map(place).max().unwrap();
        let after = all.iter().filter(|value| is_new(value)).map(place).min().unwrap();
        assert!(after > before, "{after:?} after {before:?}");
    }
    // It is found where another service or a reader remembers an output, and looks like a first start elsewhere.
    for service in SERVICES {
        doctor_finds(&cluster, &["state_lost", "state_empty"], service);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_forged_term_or_a_damaged_file_stops_nobody() {
    let mut cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    formed(&client, &truth(&cluster, &SCENARIO)).await;
    let teams = client.watch("json/teams").await.unwrap();
    let audits = client.watch("json/audit").await.unwrap();
    for _ in 0..3 {
        let Outbound { payload, encoding, .. } = division(LARGEST, 1, 9);
        client.put_bytes("teams", payload, &encoding).await.unwrap();
        // Time for the leader to ask its readers twice.
        tokio::time::sleep(Duration::from_secs(3)).await;
    }
    let works = async |since: f64| {
        let fresh = |name: &'static str| {
            move |value: &Value| stage(value, name) > since && place(value).0 < LARGEST >> 8
        };
        teams.until("a division", SOON, fresh("clusterer")).await.unwrap();
        audits.until("an audit of a division", SOON, fresh("auditor")).await.unwrap();
    };
    works(now()).await;
    kill_all(&mut cluster);
    let since = now();
    start_all(&mut cluster);
    works(since).await;

    // A file that says the same: it is damage.
    let state = cluster.folder().join("state/alpha");
    cluster.service("clusterer").unwrap().kill().unwrap();
    let damaged = format!("{{\"term\":{LARGEST},\"patch\":{{}}}}");
    std::fs::write(state.join("clusterer.json"), damaged).unwrap();
    let since = now();
    cluster.start_service("clusterer").unwrap();
    works(since).await;
    doctor_finds(&cluster, &["state_lost"], "clusterer");

    // A folder that cannot be written.
    cluster.service("clusterer").unwrap().kill().unwrap();
    std::fs::remove_dir_all(&state).unwrap();
    std::fs::write(&state, "no folder").unwrap();
    let since = now();
    cluster.start_service("clusterer").unwrap();
    works(since).await;
    doctor_finds(&cluster, &["state_unwritable"], "clusterer");
}
