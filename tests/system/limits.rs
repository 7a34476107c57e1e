//! Limits on the robots of teams, over the bus: they hold, or the division and an event say why not.

use std::time::Duration;

use muster_tests::cluster::Cluster;
use serde_json::{Value, json};

use crate::pipeline::FORMED_WITHIN;

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "3", "--robots", "12"];

/// Robots per team, in the order of the teams.
fn sizes(teams: &Value) -> Vec<usize> {
    let members = |team: &Value| team["members"].as_array().map_or(0, Vec::len);
    teams["teams"].as_array().into_iter().flatten().map(members).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn limits_hold_are_refused_where_they_cannot_and_say_when_they_no_longer_do() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let truth = muster_tests::cluster::robots_of(&SCENARIO).unwrap();
    let names: Vec<&str> = truth.keys().map(String::as_str).take(10).collect();
    let first = names.join(",");
    let some = ["--only", &first];
    let _robots = cluster.robots(&[&SCENARIO[..], &some].concat()).unwrap();
    let client = cluster.client().await.unwrap();
    let watch = client.watch("json/teams").await.unwrap();
    let events = client.watch("json/event").await.unwrap();
    let has = |count: usize| move |value: &Value| sizes(value).iter().sum::<usize>() == count;
    let free = watch.until("ten robots", FORMED_WITHIN, has(10)).await.unwrap();
    assert!(free["optimal"].is_null() && free["gap"].is_null() && free["conflict"].is_null());

    let (code, _, err) = cluster.muster(&["set", "clusterer", r#"size={"max":4}"#]).unwrap();
    assert_eq!(code, Some(2), "{err}");
    assert!(err.contains("10 robots may only be in t1 and t2, which hold 8"), "{err}");
    let (code, _, err) = cluster.muster(&["set", "clusterer", r#"size={"max":5}"#]).unwrap();
    assert_eq!(code, Some(0), "{err}");
    let even = |value: &Value| sizes(value) == [5, 5] && !value["optimal"].is_null();
    let divided = watch.until("two teams of five", Duration::from_secs(5), even).await.unwrap();
    assert!(divided["conflict"].is_null(), "{divided}");

    let prices = divided["teams"].as_array().into_iter().flatten().map(|team| &team["price"]);
    assert!(prices.into_iter().all(Value::is_number), "{divided}");
    let (code, out, err) = cluster.muster(&["why", names[0], "--json"]).unwrap();
    assert_eq!(code, Some(0), "{err}");
    let reason: Value = serde_json::from_str(&out).unwrap();
    let limited =
        |team: &Value| team["max"] == 5 && team["robots"] == 5 && team["price"].is_number();
    assert!(reason["teams"].as_array().is_some_and(|teams| teams.iter().all(limited)), "{reason}");

    // Two more than there are places.
    let late: Vec<&str> = truth.keys().map(String::as_str).skip(10).collect();
    let others = cluster.robots(&[&SCENARIO[..], &["--only", &late.join(",")]].concat()).unwrap();
    let stands = |value: &Value| {
        sizes(value) == [5, 5] && value["unassigned"].as_array().is_some_and(|all| all.len() == 2)
    };
    let stood = watch.until("two without a place", Duration::from_secs(10), stands).await.unwrap();
    let reason = "12 robots may only be in t1 and t2, which hold 10";
    assert_eq!(stood["conflict"], reason);
    let is = |name: &'static str| move |value: &Value| value["event"] == name;
    let event = events.until("an event", Duration::from_secs(5), is("infeasible")).await.unwrap();
    assert!(event["reason"].as_str().is_some_and(|text| text.contains("which hold 10")), "{event}");
    drop(others);
    events.until("the end", Duration::from_secs(20), is("feasible_again")).await.unwrap();
    for (key, value) in watch.all().iter().skip_while(|(_, value)| value["optimal"].is_null()) {
        assert!(sizes(value).iter().all(|robots| *robots <= 5), "{key}: {value}");
    }
    let settings = client.get_one("service/clusterer/settings").await.unwrap();
    assert_eq!(settings["size"], json!({"min": null, "max": 5}));
}
