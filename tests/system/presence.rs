//! Robots that come, fall silent and leave.

use std::time::{Duration, Instant};

use muster_tests::client::division;
use muster_tests::cluster::Cluster;
use serde_json::{Value, json};

use crate::pipeline::{FORMED_WITHIN, formed, truth};

/// How long a change of two to five seconds is waited for: a pause of `ingest` begins its times again.
const NOTICED_WITHIN: Duration = Duration::from_secs(20);

fn event<'a>(name: &'a str, robot: &'a str) -> impl Fn(&Value) -> bool + 'a {
    move |value| value["event"] == name && value["robot"] == robot
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_dies_is_marked_stale_and_then_leaves() {
    let cluster =
        Cluster::start("alpha", &[("ingest", "gone_after_s=5"), ("clusterer", "teams=2")]).unwrap();
    let scenario = ["--scenario", "clusters", "--robots", "8"];
    let truth = truth(&cluster, &scenario);
    let names: Vec<_> = truth.keys().cloned().collect();
    let (last, others) = names.split_last().unwrap();
    let _others =
        cluster.robots(&[&scenario[..], &["--only", &others.join(",")]].concat()).unwrap();
    let mut doomed = cluster.robots(&[&scenario[..], &["--only", last]].concat()).unwrap();
    let client = cluster.client().await.unwrap();
    let events = client.watch("json/event").await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let before = formed(&client, &truth).await;

    events.clear();
    doomed.kill().unwrap();
    let died = Instant::now();
    let stale = events.until("a stale robot", NOTICED_WITHIN, event("robot_stale", last));
    stale.await.unwrap();
    let stale_after = died.elapsed();
    let marked = |value: &Value| value["stale"] == json!([last]) && division(value) == before;
    teams.until("the stale robot keeps its team", NOTICED_WITHIN, marked).await.unwrap();
    let left = events.until("a robot leaves", NOTICED_WITHIN, event("robot_left", last));
    left.await.unwrap();
    let left_after = died.elapsed();
    let without = |value: &Value| {
        let division = division(value);
        !division.contains_key(last) && division.len() == 7
    };
    let after = teams.until("teams without it", NOTICED_WITHIN, without).await.unwrap();
    for (robot, team) in division(&after) {
        assert_eq!(team, before[&robot], "{robot} stays where it was");
    }
    eprintln!("stale after {stale_after:?}, gone after {left_after:?}");
    assert!(stale_after > Duration::from_millis(1500), "{stale_after:?}");
    assert!(left_after > Duration::from_millis(4500), "{left_after:?}");

    let _again = cluster.robots(&[&scenario[..], &["--only", last]].concat()).unwrap();
    let back = |value: &Value| division(value) == before;
    teams.clear();
    teams.until("it comes back", FORMED_WITHIN, back).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_without_a_pose_is_known_and_unplaced() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let client = cluster.client().await.unwrap();
    let token = client.token("robot/quiet").await.unwrap();
    let is_known = |roster: &Value| roster["robots"][0]["robot"] == "quiet";
    let roster = client.until("roster?format=json", FORMED_WITHIN, is_known).await.unwrap();
    assert_eq!(roster["robots"][0]["position"], Value::Null);
    let teams = client.watch("json/teams").await.unwrap();
    let right = |value: &Value| value["unassigned"] == json!(["quiet"]);
    teams.until("it has no team", FORMED_WITHIN, right).await.unwrap();
    // A put on the key of the token is no token.
    client.put("robot/imposter", &json!({})).await.unwrap();
    tokio::time::sleep(Duration::from_millis(500)).await;
    let roster = client.get_one("roster?format=json").await.unwrap();
    assert_eq!(roster["robots"].as_array().unwrap().len(), 1);
    drop(token);
}
