//! Two instances of each service: one holds the role, the other takes over.

use std::time::{Duration, Instant};

use muster_tests::client::{Client, Division, Watch, division};
use muster_tests::cluster::{Cluster, SERVICES};
use serde_json::Value;

use crate::pipeline::{formed, truth};
use crate::restarts::{now, stage};

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "3", "--robots", "15"];

/// The promise: the lease of the bus and two seconds.
const LONGEST_GAP: Duration = Duration::from_secs(4);

/// How long an instance that runs again may take to see that another one holds.
const STOOD_DOWN_WITHIN: Duration = Duration::from_secs(5);

/// The name of the second instance of a service.
fn second(service: &str) -> String {
    format!("{service}-2")
}

/// A fleet with two instances of each service, and its division.
async fn doubled() -> (Cluster, muster_tests::process::Process, Client, Division) {
    let mut cluster = Cluster::start("alpha", &[("clusterer", "teams=3")]).unwrap();
    for service in SERVICES {
        cluster.start_instance(service, &second(service)).unwrap();
    }
    let robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let wanted = formed(&client, &truth(&cluster, &SCENARIO)).await;
    (cluster, robots, client, wanted)
}

/// What the instances of a service tell of themselves: process id and standing.
async fn standings(client: &Client, service: &str) -> Vec<(u32, String)> {
    let statuses = client.get_from_all(&format!("service/{service}/status")).await.unwrap();
    statuses
        .into_iter()
        .map(|status| {
            let instance = status["instance"].as_str().unwrap();
            let process = instance.rsplit('-').nth(1).unwrap().parse().unwrap();
            (process, status["standing"].as_str().unwrap().to_owned())
        })
        .collect()
}

/// Waits until one instance of a service holds and the other stands by; returns the names of both.
async fn settled(cluster: &mut Cluster, client: &Client, service: &str) -> (String, String) {
    let start = Instant::now();
    let (first, other) = (service.to_owned(), second(service));
    loop {
        let mut found = standings(client, service).await;
        found.sort_by(|left, right| left.1.cmp(&right.1));
        let words: Vec<&str> = found.iter().map(|(_, standing)| standing.as_str()).collect();
        if words == ["holding", "standby"] {
            let is_first = cluster.service(&first).unwrap().id() == found[0].0;
            return if is_first { (first, other) } else { (other, first) };
        }
        assert!(start.elapsed() < STOOD_DOWN_WITHIN, "{service}: {found:?}");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

/// Waits for an output of the service that was made after `since`; how long that took.
async fn told_anew(watch: &Watch, service: &str, since: f64) -> Duration {
    let start = Instant::now();
    let fresh = |value: &Value| stage(value, service) > since + 0.001;
    watch.until(&format!("fresh data of {service}"), LONGEST_GAP, fresh).await.unwrap();
    start.elapsed()
}

fn all_are(teams: &Watch, wanted: &Division, when: &str) {
    for (_, value) in teams.all() {
        assert_eq!(division(&value), *wanted, "{when}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_other_takes_over_from_a_holder_that_is_killed() {
    let (mut cluster, _robots, client, wanted) = doubled().await;
    let teams = client.watch("json/teams").await.unwrap();
    let audits = client.watch("json/audit").await.unwrap();
    for service in SERVICES {
        let (holder, _) = settled(&mut cluster, &client, service).await;
        let since = now();
        cluster.service(&holder).unwrap().kill().unwrap();
        let watch = if service == "auditor" { &audits } else { &teams };
        // The service says something new by its other instance, to whoever follows it.
        let gap = told_anew(watch, service, since).await;
        eprintln!("{service} killed: fresh data after {gap:?}");
        all_are(&teams, &wanted, &format!("{service} was killed"));
        cluster.start_instance(service, &holder).unwrap();
        let (still, _) = settled(&mut cluster, &client, service).await;
        assert_ne!(still, holder, "nobody takes the role of {service} from one that holds it");
    }
    in_order(&teams);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_holder_that_hangs_is_replaced_and_stands_by_when_it_goes_on() {
    let (mut cluster, _robots, client, wanted) = doubled().await;
    let teams = client.watch("json/teams").await.unwrap();
    let audits = client.watch("json/audit").await.unwrap();
    for service in SERVICES {
        let (holder, other) = settled(&mut cluster, &client, service).await;
        let since = now();
        cluster.service(&holder).unwrap().signal("STOP").unwrap();
        let watch = if service == "auditor" { &audits } else { &teams };
        let gap = told_anew(watch, service, since).await;
        eprintln!("{service} stopped: fresh data after {gap:?}");
        tokio::time::sleep(Duration::from_secs(1)).await;
        cluster.service(&holder).unwrap().signal("CONT").unwrap();
        tokio::time::sleep(Duration::from_secs(1)).await;
        // On a machine that starves its processes the role may go back again, as from any holder that
        // is silent; what counts is that one holds it, and that nobody is told another division.
        let (now_holds, _) = settled(&mut cluster, &client, service).await;
        if now_holds != other {
            eprintln!("{service}: the role went back to {holder}");
        }
        all_are(&teams, &wanted, &format!("{service} was stopped"));
    }
    in_order(&teams);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_host_takes_over_all_roles_and_the_settings() {
    let (mut cluster, _robots, client, wanted) = doubled().await;
    let mut holders = Vec::new();
    for service in SERVICES {
        holders.push(settled(&mut cluster, &client, service).await.0);
    }
    let (code, _, error) = cluster.muster(&["set", "clusterer", "hysteresis=0.3"]).unwrap();
    assert_eq!(code, Some(0), "{error}");
    let teams = client.watch("json/teams").await.unwrap();
    tokio::time::sleep(Duration::from_millis(500)).await;
    let since = now();
    for holder in &holders {
        cluster.service(holder).unwrap().kill().unwrap();
    }
    let gap = told_anew(&teams, "ingest", since).await;
    eprintln!("all holders killed: fresh data after {gap:?}");
    all_are(&teams, &wanted, "all holders were killed");
    let settings = client.get_one("service/clusterer/settings").await.unwrap();
    assert_eq!(settings["hysteresis"], 0.3, "what an operator has changed outlives the holder");
    in_order(&teams);
}

/// Whoever reads the JSON and looks at no terms is never told an older division after a newer one.
fn in_order(teams: &Watch) {
    let mut last = (0, 0);
    for (_, value) in teams.all() {
        let place = (value["term"].as_u64().unwrap(), value["epoch"].as_u64().unwrap());
        assert!(place > last, "{place:?} after {last:?}");
        last = place;
    }
}
