//! Hostile messages on any key change nothing but counters and events.

use std::collections::BTreeSet;
use std::time::Duration;

use muster_tests::client::{Client, Division, division, now};
use muster_tests::cluster::{Cluster, SERVICES};
use muster_tests::{BUSY, SOON};
use serde_json::{Value, json};

use crate::pipeline::{FORMED_WITHIN, formed, truth};
use crate::restarts::stage;

const SCENARIO: [&str; 4] = ["--scenario", "clusters", "--robots", "8"];

/// Tokens of a stranger, under a name each.
const STRANGERS: usize = 5_000;

/// How long teams may pause meanwhile: 2.7 s were measured, and 10.6 s when each name cost as much as a robot.
const MOST_PAUSE_S: f64 = 4.0 * BUSY as f64;

const BINARY: &str = "application/octet-stream;bincode";

/// Every key of the fleet that a client could put to, with a known and an unknown robot.
fn keys(robot: &str) -> Vec<String> {
    let mut keys: Vec<String> = [
        "roster",
        "embedding",
        "teams",
        "audit",
        "event",
        "json/teams",
        "json/audit",
        "json/event",
        "graph/spatial",
        "graph/hierarchy",
        "graph/nonsense",
        "x/y/z",
    ]
    .map(str::to_owned)
    .to_vec();
    for robot in [robot, "ghost", "*", "BAD"] {
        keys.push(format!("robot/{robot}"));
        for stream in ["pose", "links", "rank", "relation/thermal", "relation/unknown", "team"] {
            keys.push(format!("robot/{robot}/{stream}"));
        }
    }
    for service in SERVICES {
        keys.push(format!("service/{service}/settings"));
        keys.push(format!("service/{service}/status"));
        keys.push(format!("service/{service}/imposter"));
    }
    keys
}

fn payloads() -> Vec<(Vec<u8>, &'static str)> {
    let mut all: Vec<(Vec<u8>, &'static str)> = Vec::new();
    let json = [
        "",
        "{",
        "null",
        "[]",
        "\"text\"",
        "{\"x\":NaN,\"y\":0}",
        "{\"x\":1e999,\"y\":0}",
        "{\"x\":1,\"y\":0,\"frame\":\"mars\"}",
        "{\"x\":1,\"y\":2,\"extra\":3}",
        "{\"links\":[{\"peer\":\"r2\",\"quality\":7}]}",
        "{\"superior\":\"../../etc\"}",
        "{\"edges\":[[\"other\",\"r1\",1.0]]}",
        "{\"teams\":99}",
        "\u{0}\u{1}\u{1b}[2J",
    ];
    for text in json {
        all.push((text.as_bytes().to_vec(), "application/json"));
    }
    all.push(("[".repeat(200_000).into_bytes(), "application/json"));
    all.push((vec![b' '; 2 << 20], "application/json"));
    all.push((vec![0xB7; 2 << 20], BINARY));
    all.push((vec![0x80, 0xFF, 0xFE], ""));
    for kind in 0..14 {
        let mut bytes = vec![0xB7, 1, kind];
        bytes.extend([253, 255, 255, 255, 255, 255, 255, 255, 255]);
        all.push((bytes, BINARY));
        all.push((vec![0xB7, 1, kind], BINARY));
    }
    all.push((b"{\"x\":1,\"y\":2}".to_vec(), "image/png"));
    all
}

async fn refused(client: &Client) -> u64 {
    let mut sum = 0;
    for service in SERVICES {
        let status = client.get_one(&format!("service/{service}/status")).await.unwrap();
        sum += status["counters"]["messages_refused"].as_u64().unwrap_or_default();
    }
    sum
}

async fn robots(client: &Client) -> BTreeSet<String> {
    let roster = client.get_one("roster?format=json").await.unwrap();
    let entries = roster["robots"].as_array().unwrap().clone();
    entries.iter().map(|entry| entry["robot"].as_str().unwrap().to_owned()).collect()
}

async fn nothing_has_changed(client: &Client, wanted: &Division) {
    let names: BTreeSet<String> = wanted.keys().cloned().collect();
    assert_eq!(robots(client).await, names);
    assert_eq!(division(&client.get_one("json/teams").await.unwrap()), *wanted);
    for (service, field, value) in
        [("clusterer", "teams", json!(2)), ("ingest", "tick_hz", json!(10.0))]
    {
        let settings = client.get_one(&format!("service/{service}/settings")).await.unwrap();
        assert_eq!(settings[field], value);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn garbage_on_every_key_changes_nothing_but_counters_and_events() {
    let mut cluster = Cluster::start(
        "alpha",
        &[("ingest", "modalities=[\"thermal\"]"), ("clusterer", "teams=2")],
    )
    .unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let wanted = formed(&client, &truth(&cluster, &SCENARIO)).await;
    let victim = wanted.keys().next().unwrap().clone();
    let watch = client.watch("json/teams").await.unwrap();
    let events = client.watch("json/event").await.unwrap();
    let before = refused(&client).await;

    let attacker = cluster.client().await.unwrap();
    for key in keys(&victim) {
        for (payload, encoding) in payloads() {
            // Some keys are no key expressions at all; then the bus refuses them.
            let _ = attacker.put_bytes(&key, payload, encoding).await;
        }
        let _ = attacker.session().delete(attacker.key(&key)).await;
        // Newer packets replace older ones that wait: give each key its time.
        tokio::time::sleep(Duration::from_millis(30)).await;
    }
    tokio::time::sleep(Duration::from_secs(1)).await;

    nothing_has_changed(&client, &wanted).await;
    assert!(refused(&client).await > before);
    let events = events.all();
    let named = events.iter().any(|(_, event)| {
        event["event"] == "quarantined"
            && event["robot"] == victim.as_str()
            && event["reason"].as_str().is_some_and(|reason| !reason.is_empty())
    });
    assert!(named, "an event names the robot and the reason");
    for (_, value) in watch.all().iter().filter(|(key, _)| key == "json/teams") {
        // Subscribers also receive the attacker's own puts on the mirror; those of the services are true.
        if value.get("stages").is_some() {
            assert_eq!(division(value), wanted);
        }
    }
    for service in SERVICES {
        assert!(cluster.service(service).unwrap().is_running().unwrap(), "{service} has died");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_replayed_pose_or_one_of_another_frame_moves_no_robot() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let client = cluster.client().await.unwrap();
    let events = client.watch("json/event").await.unwrap();
    let put = async |x: f64, seq: u64, boot: &str, frame: &str| {
        let pose = json!({"x": x, "y": 0.0, "seq": seq, "boot": boot, "frame": frame});
        client.put("robot/r1/pose", &pose).await.unwrap();
        tokio::time::sleep(Duration::from_millis(150)).await;
    };
    let place = async || {
        let roster = client.get_one("roster?format=json").await.unwrap();
        roster["robots"][0]["position"][0].as_f64()
    };
    let start = std::time::Instant::now();
    let mut seq = 10;
    while client.get_one("roster?format=json").await.is_err() {
        put(1.0, seq, "a", "map").await;
        seq += 1;
        assert!(start.elapsed() < FORMED_WITHIN);
    }
    let is_at = async |wanted: f64, why: &str| {
        let right = |roster: &Value| roster["robots"][0]["position"][0] == wanted;
        let found = client.until("roster?format=json", Duration::from_secs(10), right).await;
        assert!(found.is_ok(), "{why}: {found:?}");
    };
    put(2.0, 1000, "a", "map").await;
    is_at(2.0, "a later number").await;
    let refusals = [
        (3.0, 1000, "a", "map"), // the same again
        (3.0, 999, "a", "map"),  // an older one
        (3.0, 1001, "a", "mars"),
    ];
    for (x, seq, boot, frame) in refusals {
        put(x, seq, boot, frame).await;
        assert_eq!(place().await, Some(2.0), "{seq} {boot} {frame}");
    }
    put(4.0, 1, "b", "map").await;
    is_at(4.0, "a new boot starts a new sequence").await;
    put(5.0, 2000, "a", "map").await;
    assert_eq!(place().await, Some(4.0), "an old boot does not come back");
    let reasons: Vec<String> = events
        .all()
        .iter()
        .filter(|(_, event)| event["event"] == "quarantined" && event["robot"] == "r1")
        .filter_map(|(_, event): &(String, Value)| event["reason"].as_str().map(str::to_owned))
        .collect();
    assert!(!reasons.is_empty());
}

/// A message of the wire's golden bytes: well-formed, of this fleet, and of a term to come.
fn forged(name: &str) -> Vec<u8> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/wire/tests/golden");
    let hex = std::fs::read_to_string(format!("{folder}/{name}.hex")).unwrap();
    let digits: Vec<u8> = hex
        .chars()
        .filter_map(|digit| digit.to_digit(16))
        .map(|d| u8::try_from(d).unwrap())
        .collect();
    digits.chunks(2).map(|pair| pair[0] * 16 + pair[1]).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_forged_message_of_a_later_term_does_not_last() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let wanted = formed(&client, &truth(&cluster, &SCENARIO)).await;
    let watch = client.watch("json/teams").await.unwrap();
    for name in ["roster", "embedding", "teams", "audit", "graph"] {
        let key = if name == "graph" { "graph/hierarchy" } else { name };
        client.put_bytes(key, forged(name), BINARY).await.unwrap();
        // Long enough for it to do what harm it can.
        tokio::time::sleep(Duration::from_millis(500)).await;
        watch.clear();
        let right = |value: &Value| {
            division(value) == wanted && value["data_age_s"].as_f64().is_some_and(|age| age < 1.0)
        };
        watch
            .until("the right teams from fresh data", Duration::from_secs(15), right)
            .await
            .unwrap();
        eprintln!("{name}: repaired");
    }
    tokio::time::sleep(Duration::from_secs(7)).await;
    watch.clear();
    let right = |value: &Value| division(value) == wanted;
    watch.until("the right teams", Duration::from_secs(5), right).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn garbage_right_behind_a_good_message_does_not_displace_it() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let client = cluster.client().await.unwrap();
    // A single put is lost without a subscriber.
    client.until("service/ingest/status", Duration::from_secs(10), |_| true).await.unwrap();
    for robot in 1..=20 {
        let key = format!("robot/r{robot}/rank");
        client.put(&key, &json!({"superior": "r0"})).await.unwrap();
        client.put_bytes(&key, b"garbage".to_vec(), "application/json").await.unwrap();
    }
    client.put("robot/r0/pose", &json!({"x": 0.0, "y": 0.0})).await.unwrap();
    let has_all = |graph: &Value| graph["edges"].as_array().is_some_and(|edges| edges.len() == 20);
    client.until("graph/hierarchy?format=json", Duration::from_secs(8), has_all).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn tokens_of_a_stranger_under_many_names_do_not_stop_the_fleet() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let wanted = formed(&client, &truth(&cluster, &SCENARIO)).await;
    let stranger = cluster.client().await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();

    let since = now();
    let mut tokens = Vec::new();
    for number in 0..STRANGERS {
        tokens.push(stranger.token(&format!("robot/x{number}")).await.unwrap());
    }
    for token in tokens {
        token.undeclare().await.unwrap();
    }
    // The fleet has seen all of them once it divides robots by what came after them.
    let last = now();
    let is_later = |value: &Value| stage(value, "ingest") > last;
    teams.until("teams of later reports", FORMED_WITHIN, is_later).await.unwrap();
    // When each division of fresher data came.
    let (mut newest, mut pause, mut before) = (since, 0.0_f64, since);
    for (at, value) in teams.timed() {
        let data = stage(&value, "ingest");
        if data > newest {
            pause = pause.max(at - before);
            (newest, before) = (data, at);
        }
    }
    println!("{pause:.1} s without teams");
    assert!(pause < MOST_PAUSE_S, "{pause} s without teams");
    let gone = || async { robots(&client).await.len() == wanted.len() };
    while !gone().await {
        assert!(now() - last < SOON.as_secs_f64(), "names of a stranger stay in the roster");
        tokio::time::sleep(Duration::from_millis(500)).await;
    }
    nothing_has_changed(&client, &wanted).await;
}
