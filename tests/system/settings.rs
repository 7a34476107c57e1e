//! Settings are changed over the bus, checked as a whole, and kept.

use std::time::Duration;

use muster_tests::BUSY;
use muster_tests::client::division;
use muster_tests::cluster::{Cluster, SERVICES};
use serde_json::{Value, json};

use crate::pipeline::{FORMED_WITHIN, formed, truth};

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "4", "--robots", "16"];

fn teams(count: usize) -> impl Fn(&Value) -> bool {
    move |value| value["teams"].as_array().is_some_and(|teams| teams.len() == count)
}

#[tokio::test(flavor = "multi_thread")]
async fn settings_change_at_once_and_survive_a_restart() {
    let mut cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let watch = client.watch("json/teams").await.unwrap();
    watch.until("two teams", FORMED_WITHIN, teams(2)).await.unwrap();

    let answer =
        client.get("service/clusterer/settings", Some(&json!({"teams": 4}))).await.unwrap();
    let settings = answer[0].1.clone().unwrap();
    assert_eq!(settings["teams"], 4);
    assert_eq!(settings["restarts"], 50);
    let truth = truth(&cluster, &SCENARIO);
    let wanted = formed(&client, &truth).await;

    cluster.service("clusterer").unwrap().kill().unwrap();
    cluster.start_service("clusterer").unwrap();
    watch.clear();
    let again =
        watch.until("four teams again", Duration::from_secs(5 * BUSY), teams(4)).await.unwrap();
    assert_eq!(division(&again), wanted);
    let settings = client.get_one("service/clusterer/settings").await.unwrap();
    assert_eq!(settings["teams"], 4);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_search_proposes_settings_for_the_live_fleet_and_applies_them() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=4")]).unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let watch = client.watch("json/teams").await.unwrap();
    watch.until("four teams", FORMED_WITHIN, teams(4)).await.unwrap();
    let weak = json!({"alpha": {"fraction": 0.05}, "rows": "none"});
    client.get("service/embedder/settings", Some(&weak)).await.unwrap()[0].1.clone().unwrap();

    let (code, out, err) = cluster.muster(&["tune", "--json", "--draws", "2"]).unwrap();
    assert_eq!(code, Some(0), "{err}");
    let found: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((&found["robots"], &found["teams"]), (&json!(16), &json!(4)), "{out}");
    assert_eq!(found["present"]["settings"]["alpha"], weak["alpha"], "{out}");
    assert!(found["best"][0]["silhouette"].as_f64() > found["present"]["silhouette"].as_f64());

    let (code, out, err) = cluster.muster(&["tune", "--apply", "--draws", "2"]).unwrap();
    assert_eq!((code, err.as_str()), (Some(0), "applied\n"), "{out}");
    let settings = client.get_one("service/embedder/settings").await.unwrap();
    assert_ne!(settings["alpha"], weak["alpha"], "{out}");
    assert_eq!(settings["rows"], "none", "what is not searched for stays");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_setting_is_answered_with_its_field_and_changes_nothing() {
    let cluster = Cluster::start("alpha", &[]).unwrap();
    let client = cluster.client().await.unwrap();
    let wrong = [
        ("clusterer", json!({"teams": 0}), "teams"),
        ("clusterer", json!({"teams": 3, "restart": 9}), "restart"),
        ("clusterer", json!({"init": "best"}), "init"),
        ("embedder", json!({"weights": {"spatial": 0.7, "hierarchy": 0.7}}), "weights"),
        ("embedder", json!({"alpha": {"fraction": 1.5}}), "alpha.fraction"),
        ("embedder", json!({"dimension": 3}), "dimension"),
        ("ingest", json!({"spatial": {"width": -1.0}}), "spatial.width"),
        ("ingest", json!({"gone_after_s": 1.0}), "gone_after_s"),
        ("ingest", json!({"modalities": ["spatial"]}), "modalities"),
        ("auditor", json!({"good": 0.1, "poor": 0.5}), "good"),
        ("auditor", json!([1, 2]), "action.set"),
    ];
    for (service, patch, field) in wrong {
        let key = format!("service/{service}/settings");
        let mut before = client.get_one(&key).await;
        for _ in 0..50 {
            if before.is_ok() {
                break;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
            before = client.get_one(&key).await;
        }
        let answers = client.get(&key, Some(&patch)).await.unwrap();
        let problem = answers[0].1.clone().expect_err("a wrong patch is refused");
        let problem: Value = serde_json::from_str(&problem).unwrap();
        assert_eq!(problem["field"], field, "{patch}");
        assert_eq!(client.get_one(&key).await.unwrap(), before.unwrap(), "{patch}");
    }
    for service in SERVICES {
        let key = format!("service/{service}/settings");
        let before = client.get_one(&key).await.unwrap();
        // A change needs exactly one key.
        client.get("service/*/settings", Some(&json!({}))).await.unwrap();
        assert_eq!(client.get_one(&key).await.unwrap(), before);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_console_sets_and_shows_settings() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let watch = client.watch("json/teams").await.unwrap();
    watch.until("two teams", FORMED_WITHIN, teams(2)).await.unwrap();
    let (code, out, err) = cluster.muster(&["set", "clusterer", "teams=3", "--json"]).unwrap();
    assert_eq!(code, Some(0), "{err}");
    assert_eq!(serde_json::from_str::<Value>(&out).unwrap()["teams"], 3);
    watch.until("three teams", Duration::from_secs(5), teams(3)).await.unwrap();
    let (code, _, err) = cluster.muster(&["set", "clusterer", "teams=0"]).unwrap();
    assert_eq!(code, Some(2));
    assert!(err.contains("teams:"), "{err}");
    let (code, _, err) = cluster.muster(&["set", "clusterer", "teams"]).unwrap();
    assert_eq!(code, Some(2));
    assert!(err.contains("FIELD=VALUE"), "{err}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_decay_that_the_fleet_does_not_allow_is_refused_with_the_limit() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let watch = client.watch("json/teams").await.unwrap();
    watch.until("two teams", FORMED_WITHIN, teams(2)).await.unwrap();
    let (code, _, err) = cluster.muster(&["set", "embedder", "alpha=5"]).unwrap();
    assert_eq!(code, Some(2), "{err}");
    assert!(err.contains("alpha: 5 must be less than 1/ρ = ") && err.contains("fraction"), "{err}");
    watch.clear();
    watch.until("teams as before", Duration::from_secs(5), teams(2)).await.unwrap();
}
