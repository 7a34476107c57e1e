//! A robot that holds its team together: it is named as the worst loss, and when it falls silent the team is cut off, which an
//! operator sees, acknowledges and sees end.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use muster_client::model::alert::{Alert, AlertKind, Alerts};
use muster_client::model::id::OperatorId;
use muster_client::{Client, Config, Error, Pose, Robot};
use muster_tests::cluster::Cluster;
use serde_json::Value;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep};

/// The robots of two camps, and where they stand.
const PLACES: [(&str, f64, f64); 9] = [
    ("a1", 0.0, 0.0),
    ("a2", 2.0, 0.0),
    ("a3", 4.0, 0.0),
    ("a4", 6.0, 0.0),
    ("a5", 8.0, 0.0),
    ("b1", 90.0, 0.0),
    ("b2", 92.0, 0.0),
    ("b3", 90.0, 2.0),
    ("b4", 92.0, 2.0),
];

/// The robot without which the first camp falls apart.
const CUT: &str = "a3";

/// Who hears whom: the first camp is two pairs that are joined by one robot, the second a ring.
const LINKS: [(&str, &str); 10] = [
    ("a1", "a2"),
    ("a1", CUT),
    ("a2", CUT),
    (CUT, "a4"),
    (CUT, "a5"),
    ("a4", "a5"),
    ("b1", "b2"),
    ("b2", "b4"),
    ("b4", "b3"),
    ("b3", "b1"),
];

/// How soon something is seen, on a busy machine.
const SEEN_WITHIN: Duration = Duration::from_secs(30);

type Heard = Arc<Mutex<Vec<(&'static str, &'static str)>>>;

fn config(cluster: &Cluster) -> Config {
    Config {
        fleet: cluster.fleet.clone(),
        routers: Some(vec![cluster.endpoint.clone()]),
        connect_timeout: Some(Duration::from_secs(10)),
        ..Config::default()
    }
}

/// Has some robots report until the task is aborted.
async fn drive(client: &Client, names: &[&'static str], heard: Heard) -> JoinHandle<()> {
    let mut robots: BTreeMap<&'static str, Robot> = BTreeMap::new();
    for name in names {
        robots.insert(name, client.join(name).await.unwrap());
    }
    tokio::spawn(async move {
        loop {
            let links = heard.lock().unwrap().clone();
            for (name, x, y) in PLACES {
                let Some(robot) = robots.get(name) else { continue };
                robot.put_pose(Pose::at(x, y)).unwrap();
                robot
                    .put_rank((!name.ends_with('1')).then_some(if name.starts_with('a') {
                        "a1"
                    } else {
                        "b1"
                    }))
                    .unwrap();
                let peers = links.iter().filter_map(|(one, other)| match name {
                    _ if *one == name => Some((*other, 0.9)),
                    _ if *other == name => Some((*one, 0.9)),
                    _ => None,
                });
                robot.put_links(peers).unwrap();
            }
            sleep(Duration::from_millis(200)).await;
        }
    })
}

/// Asks until the list of alerts is right.
async fn until(client: &Client, what: &str, right: impl Fn(&Alerts) -> bool) -> Arc<Alerts> {
    let start = Instant::now();
    let mut last = None;
    while start.elapsed() < SEEN_WITHIN {
        match client.get_alerts().await {
            Ok(alerts) if right(&alerts) => return alerts,
            Ok(alerts) => last = Some(alerts),
            Err(Error::Unanswered { .. }) => {}
            Err(error) => panic!("{error}"),
        }
        sleep(Duration::from_millis(200)).await;
    }
    panic!("{what}: {last:?}");
}

fn cut_off(alerts: &Alerts) -> Option<&Alert> {
    alerts.open.iter().find(|alert| alert.kind == AlertKind::CutOff)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_whose_loss_cuts_its_team_is_named_and_its_loss_is_an_alert_until_it_is_over() {
    let cluster = Cluster::start(
        "alpha",
        &[
            ("clusterer", "teams=2"),
            ("ingest", "stale_after_s=2.0"),
            ("auditor", "alert_after_s=1.0"),
            ("auditor", "alert_clear_s=1.0"),
        ],
    )
    .unwrap();
    let client = Client::open(&config(&cluster)).await.unwrap();
    let heard: Heard = Arc::new(Mutex::new(LINKS.to_vec()));
    let others: Vec<_> = PLACES.iter().map(|place| place.0).filter(|name| *name != CUT).collect();
    let driver = drive(&client, &others, Arc::clone(&heard)).await;
    let doomed = Client::open(&config(&cluster)).await.unwrap();
    let doomed_driver = drive(&doomed, &[CUT], Arc::clone(&heard)).await;

    // The audit names it, to people as well.
    let start = Instant::now();
    loop {
        let audit = client.get_audit().await.ok();
        let worst = audit.as_ref().and_then(|audit| audit.losses.first());
        if worst.is_some_and(|worst| {
            worst.robot.as_str() == CUT
                && worst.describe().ends_with("falls into 2 parts of 2 and 2")
        }) {
            break;
        }
        assert!(start.elapsed() < SEEN_WITHIN, "{audit:?}");
        sleep(Duration::from_millis(200)).await;
    }
    let (code, out, err) = cluster.muster(&["audit"]).unwrap();
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("a3: t") && out.contains("falls into 2 parts of 2 and 2"), "{out}");
    assert!(cut_off(&*until(&client, "the list", |_| true).await).is_none());

    // It is killed.
    doomed_driver.abort();
    doomed.close().await;
    let alerts = until(&client, "the team is cut off", |alerts| cut_off(alerts).is_some()).await;
    let id = cut_off(&alerts).unwrap().id;

    // A reader that comes late has the list, and an operator acknowledges the alert.
    let late = Client::open(&config(&cluster)).await.unwrap();
    assert_eq!(cut_off(&late.get_alerts().await.unwrap()).unwrap().id, id);
    let mut watch = late.alerts().await.unwrap();
    let newest = tokio::time::timeout(SEEN_WITHIN, watch.changed()).await.unwrap().unwrap();
    assert_eq!(cut_off(&newest.value).unwrap().id, id);
    let id_text = id.to_string();
    let ack = ["alerts", "ack", &id_text, "--operator", "kim", "--json"];
    let (code, out, err) = cluster.muster(&ack).unwrap();
    assert_eq!(code, Some(0), "{err}");
    let listed: Value = serde_json::from_str(&out).unwrap();
    let seen_by = |value: &Value| {
        let open = value["open"].as_array().unwrap().iter();
        open.clone().find(|alert| alert["id"] == id).unwrap()["acknowledged"]["operator"].clone()
    };
    assert_eq!(seen_by(&listed), "kim");
    let unknown = late.acknowledge_alert(&OperatorId::new("kim").unwrap(), 999_999).await;
    assert!(
        matches!(&unknown, Err(Error::Refused { reason, .. }) if reason.contains("999999")),
        "{unknown:?}"
    );
    let (code, out, _) = cluster.muster(&["alerts"]).unwrap();
    assert!(code == Some(0) && out.contains("cut_off") && out.contains("kim"), "{out}");

    // Others hear each other now.
    heard.lock().unwrap().push(("a2", "a4"));
    until(&client, "the alert ends", |alerts| cut_off(alerts).is_none()).await;
    driver.abort();
}
