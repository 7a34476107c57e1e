//! Hosts that are busy with other work: divisions become rarer, and never stop.

use std::time::{Duration, Instant};

use muster_tests::client::division;
use muster_tests::cluster::Cluster;
use muster_tests::neighbours::Neighbours;
use serde_json::Value;

use crate::pipeline::FORMED_WITHIN;
use crate::restarts::{now, stage};

/// Processes that do nothing but compute, for each processor.
const BUSY_PER_PROCESSOR: usize = 2;

/// For how long the hosts are busy.
const BUSY_FOR: Duration = Duration::from_secs(25);

/// The longest time without a new division from fresh data. It is a bound for a machine that runs other tests as
/// well; where divisions stop they stop for as long as the machine is busy.
const LONGEST_PAUSE_S: f64 = 12.0;

/// How many robots there are, as the scenario has them.
const ROBOTS: usize = 200;

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "4", "--robots", "200"];

#[tokio::test(flavor = "multi_thread")]
async fn divisions_go_on_while_every_processor_is_busy() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=4")]).unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let has_all = |value: &Value| division(value).len() == ROBOTS;
    teams.until("a division of the fleet", 3 * FORMED_WITHIN, has_all).await.unwrap();
    let neighbours = Neighbours::start(BUSY_PER_PROCESSOR).unwrap();
    let start = Instant::now();
    // When the data of the newest division left `ingest`, and the longest time without newer data.
    let (mut newest, mut since, mut longest, mut divisions) = (now(), now(), 0.0_f64, 0);
    while start.elapsed() < BUSY_FOR {
        for (at, value) in teams.take() {
            let data = stage(&value, "ingest");
            if data > newest {
                longest = longest.max(at - since);
                (newest, since) = (data, at);
                divisions += 1;
            }
        }
        longest = longest.max(now() - since);
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    drop(neighbours);
    eprintln!(
        "{divisions} divisions of fresh data on a busy machine, longest pause {longest:.1} s"
    );
    assert!(longest < LONGEST_PAUSE_S, "no fresh division for {longest:.1} s");
}
