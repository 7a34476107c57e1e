//! Wishes of operators over the bus and from the command line, and that they outlive every service.

use std::time::Duration;

use muster_tests::client::division;
use muster_tests::cluster::{Cluster, SERVICES};
use serde_json::{Value, json};

use crate::pipeline::{formed, truth};

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "3", "--robots", "12"];

/// One line of JSON for each wish.
fn listed(cluster: &Cluster) -> Vec<Value> {
    let (code, out, err) = cluster.muster(&["wish", "list", "--json"]).unwrap();
    assert_eq!(code, Some(0), "{err}");
    out.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn wishes_are_granted_refused_and_outlive_kills_of_every_service() {
    let mut cluster = Cluster::start("alpha", &[("clusterer", "teams=3")]).unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let free = formed(&client, &truth(&cluster, &SCENARIO)).await;
    let of_team = |team: &str| -> Vec<String> {
        free.iter().filter(|(_, at)| at.as_deref() == Some(team)).map(|(r, _)| r.clone()).collect()
    };
    let robot = of_team("t1").swap_remove(0);
    let other = of_team("t2").swap_remove(0);
    let watch = client.watch("json/teams").await.unwrap();
    let wishes = client.watch("json/wishes").await.unwrap();

    let pin = ["wish", "pin", &robot, "t2", "--note", "carries the relay", "--json"];
    let (code, out, err) = cluster.muster(&pin).unwrap();
    assert_eq!(code, Some(0), "{err}");
    let put: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((&put["operator"], &put["wish"]["kind"]), (&json!("operator"), &json!("pin")));
    let is_pinned = |value: &Value| division(value).get(&robot) == Some(&Some("t2".to_owned()));
    watch.until("the pinned robot", Duration::from_secs(5), is_pinned).await.unwrap();
    let active = |value: &Value| value["wishes"][0]["state"] == "active";
    wishes.until("an active wish", Duration::from_secs(5), active).await.unwrap();

    let (code, out, err) = cluster.muster(&["why", &robot]).unwrap();
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains(&format!("The wish operator/pin-{robot}-t2 holds it in t2.")), "{out}");

    // What contradicts it is refused, and what is wrong as well.
    let (code, _, err) = cluster.muster(&["wish", "pin", &robot, "t1"]).unwrap();
    assert_eq!(code, Some(2), "{err}");
    assert!(err.contains(&format!("operator/pin-{robot}-t1")), "{err}");
    let (code, _, err) = cluster.muster(&["wish", "together", &robot]).unwrap();
    assert!(code == Some(2) && err.contains("2 robots"), "{err}");
    let reserve = ["wish", "reserve", &other, "--operator", "alice", "--id", "spare"];
    let (code, out, err) = cluster.muster(&reserve).unwrap();
    assert!(code == Some(0) && out.contains("alice/spare"), "{out}{err}");
    let (code, _, err) = cluster.muster(&["wish", "ban", "nobody", "t1"]).unwrap();
    assert_eq!(code, Some(0), "{err}");
    let granted = |value: &Value| is_pinned(value) && value["unassigned"] == json!([other]);
    watch.until("both wishes", Duration::from_secs(5), granted).await.unwrap();
    let (code, _, err) = cluster.muster(&["why", &other]).unwrap();
    let reserved = format!("{other} is in no team: the wish alice/spare keeps it in reserve");
    assert!(code == Some(2) && err.contains(&reserved), "{err}");
    let states: Vec<Value> = listed(&cluster).iter().map(|one| one["state"].clone()).collect();
    assert_eq!(states, [json!("active"), json!("waiting"), json!("active")]);

    // All services are killed at once.
    for service in SERVICES {
        cluster.service(service).unwrap().kill().unwrap();
    }
    for service in SERVICES {
        cluster.start_service(service).unwrap();
    }
    watch.clear();
    watch.until("both wishes again", Duration::from_secs(20), granted).await.unwrap();
    for (_, value) in watch.all() {
        assert!(granted(&value), "after the restart: {value}");
    }
    assert_eq!(listed(&cluster).len(), 3);

    let name = format!("pin-{robot}-t2");
    let (code, out, err) = cluster.muster(&["wish", "withdraw", &name]).unwrap();
    assert!(code == Some(0) && out.contains("withdrawn"), "{out}{err}");
    let (code, _, err) = cluster.muster(&["wish", "withdraw", &name]).unwrap();
    assert!(code == Some(2) && err.contains("is not there"), "{err}");
    assert_eq!(listed(&cluster).len(), 2);
    let is_free = |value: &Value| division(value).get(&robot) == free.get(&robot);
    watch.until("the robot is free", Duration::from_secs(5), is_free).await.unwrap();
}
