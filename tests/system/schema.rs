//! Messages of the services are valid by the JSON Schema, for a validator that is not Muster's.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write as _;
use std::process::{Command, Stdio};
use std::time::Duration;

use muster_tests::client::{Client, is_event_of_robots};
use muster_tests::cluster::{Cluster, SERVICES};
use muster_tests::process::{python, run};
use serde_json::{Map, Value, json};

use crate::languages::blocks;
use crate::pipeline::{FORMED_WITHIN, formed, truth};

/// The validator's error for each message: none if its schema accepts it.
pub(crate) fn validated(
    document: &Value,
    alone: &[Value],
    cases: &[(String, String)],
) -> Vec<Option<String>> {
    let task = json!({ "document": document, "alone": alone, "cases": cases });
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/peers/check_schema.py");
    let mut child = Command::new(python().unwrap())
        .arg(script)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(task.to_string().as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "the validator failed");
    let problems: Vec<Option<String>> = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(problems.len(), cases.len());
    problems
}

fn muster(arguments: &[&str]) -> String {
    let (code, out, err) = run("muster", arguments, Duration::from_secs(20)).unwrap();
    assert_eq!(code, Some(0), "{err}");
    out
}

fn offline() -> Value {
    serde_json::from_str(&muster(&["schema"])).unwrap()
}

pub(crate) async fn answered(client: &Client, tail: &str) -> Value {
    client.until(tail, FORMED_WITHIN, |_| true).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn every_service_serves_the_schema_that_the_command_prints() {
    let mut cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let client = cluster.client().await.unwrap();
    for service in SERVICES {
        answered(&client, &format!("service/{service}/status")).await;
    }
    let printed = offline();
    // One after the other is the last that is left.
    for service in SERVICES.iter().rev() {
        let served = answered(&client, "schema").await;
        assert_eq!(served["$schema"], "https://json-schema.org/draft/2020-12/schema");
        for (name, part) in served["$defs"].as_object().unwrap() {
            assert_eq!(printed["$defs"][name], *part, "{name}");
        }
        let wild = client.get("**", None).await.unwrap();
        assert!(wild.iter().any(|(key, answer)| key == "schema" && answer.as_ref() == Ok(&served)));
        cluster.service(service).unwrap().kill().unwrap();
    }
    let names: Vec<String> = muster(&["schema", "--list"]).lines().map(str::to_owned).collect();
    assert!(
        names.contains(&"pose".to_owned()) && names.contains(&"ingest_settings_patch".to_owned())
    );
    let alone: Vec<Value> = names
        .iter()
        .map(|name| serde_json::from_str(&muster(&["schema", name])).unwrap())
        .collect();
    validated(&printed, &alone, &[]);
    let (code, _, err) = run("muster", &["schema", "poses"], Duration::from_secs(20)).unwrap();
    assert_eq!(code, Some(2));
    assert!(err.contains("there are alert"), "{err}");
}

#[test]
fn the_messages_of_the_document_are_valid() {
    let mut cases = Vec::new();
    for block in blocks("shared/wire/README.md", "messages") {
        let starts: Vec<&str> = block.split_inclusive('\n').collect();
        let mut entries: Vec<String> = Vec::new();
        for line in starts {
            if line.starts_with(' ') {
                entries.last_mut().unwrap().push_str(line);
            } else {
                entries.push(line.to_owned());
            }
        }
        for entry in entries {
            let (name, rest) = entry.split_once(' ').unwrap();
            let message: Value =
                serde_json::Deserializer::from_str(rest).into_iter().next().unwrap().unwrap();
            let name = match name {
                "robot/r1/team" => "robot_team",
                "robot/r1/refused" => "refused",
                name => name.trim_start_matches("json/"),
            };
            cases.push((name.to_owned(), message.to_string()));
        }
    }
    let names: BTreeSet<&str> = cases.iter().map(|(name, _)| name.as_str()).collect();
    let mut wanted = BTreeSet::from(["audit", "event", "links", "pose", "rank", "relation"]);
    wanted.extend(["alerts", "refused", "robot_team", "teams", "wishes"]);
    assert_eq!(names, wanted);
    for (problem, case) in validated(&offline(), &[], &cases).iter().zip(&cases) {
        assert_eq!(*problem, None, "{case:?}");
    }
}

/// The name of the schema of a key's messages.
fn schema_of(key: &str) -> String {
    match key.split('/').collect::<Vec<_>>()[..] {
        ["json", name] => name.to_owned(),
        ["robot", _, "team"] => "robot_team".to_owned(),
        ["robot", _, "refused"] => "refused".to_owned(),
        ["graph", _] => "graph".to_owned(),
        ["service", service, "settings"] => format!("{service}_settings"),
        ["service", _, "status"] => "status".to_owned(),
        ["service", _, "holder"] => "claim".to_owned(),
        [name] => name.to_owned(),
        _ => panic!("{key} has no schema"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn everything_that_a_live_fleet_says_in_json_is_valid() {
    let settings = [
        ("ingest", "modalities=[\"thermal\"]"),
        ("ingest", "gone_after_s=6.0"),
        ("clusterer", "teams=2"),
    ];
    let mut cluster = Cluster::start("alpha", &settings).unwrap();
    cluster.start_service("planner").unwrap();
    let client = cluster.client().await.unwrap();
    let mut watched = Vec::new();
    for keys in ["json/*", "robot/*/team", "robot/*/refused"] {
        watched.push(client.watch(keys).await.unwrap());
    }
    let scenario = ["--scenario", "clusters", "--robots", "8"];
    let mut robots = cluster.robots(&scenario).unwrap();
    formed(&client, &truth(&cluster, &scenario)).await;

    let mut got: Vec<(String, Value)> = Vec::new();
    let gets = [
        "json/*",
        "graph/*?format=json",
        "roster?format=json",
        "embedding?format=json",
        "teams?format=json",
        "audit?format=json",
        "robot/*/team",
        "service/*/settings",
        "service/*/status",
        "service/ingest/holder?format=json",
    ];
    let get_all = async || {
        let mut got = Vec::new();
        for get in gets {
            for (key, answer) in client.get(get, None).await.unwrap() {
                got.push((key, answer.unwrap()));
            }
        }
        got
    };
    got.extend(get_all().await);
    for (_, answer) in client.get("embedding?katz=c1-r1,c1-r2", None).await.unwrap() {
        got.push(("katz".to_owned(), answer.unwrap()));
    }

    for (_, answer) in client.get("why?robot=c1-r1", None).await.unwrap() {
        got.push(("why".to_owned(), answer.unwrap()));
    }
    let asked = json!({"teams": 3, "size": {"min": 1}, "without": ["c1-r1"]});
    let proposed = client.get_within("propose/alice/p1", Some(&asked), Duration::from_secs(10));
    for (_, answer) in proposed.await.unwrap() {
        got.push(("proposal".to_owned(), answer.unwrap()));
    }
    got.push(("proposal_request".to_owned(), asked));

    // What happens, one kind after another.
    client.put("robot/r1/pose", &json!({"x": "east", "y": 0})).await.unwrap();
    let patch = json!({"teams": 3});
    client.get("service/clusterer/settings", Some(&patch)).await.unwrap();
    let patch = json!({"teams": 40});
    tokio::time::sleep(Duration::from_millis(500)).await;
    client.get("service/clusterer/settings", Some(&patch)).await.unwrap();
    cluster.service("auditor").unwrap().kill().unwrap();
    cluster.start_service("auditor").unwrap();
    robots.signal("STOP").unwrap();
    let events = &watched[0];
    let happened = async |kind: &str| {
        let right = |value: &Value| is_event_of_robots(value, kind);
        events.until(kind, Duration::from_secs(20), right).await.unwrap();
    };
    happened("robot_stale").await;
    robots.signal("CONT").unwrap();
    happened("robot_recovered").await;
    robots.kill().unwrap();
    happened("robot_left").await;
    for kind in
        ["quarantined", "settings_changed", "fewer_teams", "service_started", "team_changed"]
    {
        happened(kind).await;
    }
    got.extend(get_all().await);
    got.extend(watched.iter().flat_map(muster_tests::client::Watch::all));

    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    for (key, value) in &got {
        *seen.entry(schema_of(key)).or_default() += 1;
        if let Some(kind) = value["event"].as_str() {
            *seen.entry(format!("event {kind}")).or_default() += 1;
        }
    }
    let mut wanted = vec!["audit", "claim", "embedding", "event", "graph", "robot_team", "roster"];
    wanted.extend([
        "katz",
        "why",
        "proposal",
        "status",
        "teams",
        "event robot_joined",
        "event robots_left",
        "refused",
    ]);
    for name in wanted {
        assert!(seen.contains_key(name), "no message of {name}: {seen:?}");
    }
    for service in SERVICES {
        assert!(seen.contains_key(&format!("{service}_settings")), "{seen:?}");
    }
    let mut cases: Vec<(String, String)> =
        got.iter().map(|(key, value)| (schema_of(key), value.to_string())).collect();
    for (get, payload) in [
        ("service/clusterer/settings", Some(json!({"teams": 0}))),
        ("service/*/settings", Some(json!({}))),
        ("json/teams?format=xml", None),
    ] {
        let answers = client.get(get, payload.as_ref()).await.unwrap();
        let errors = answers.into_iter().filter_map(|(_, answer)| answer.err());
        let before = cases.len();
        cases.extend(errors.map(|error| ("error".to_owned(), error)));
        assert!(cases.len() > before, "{get} was not refused");
    }
    let document = answered(&client, "schema").await;
    for (problem, case) in validated(&document, &[], &cases).iter().zip(&cases) {
        assert_eq!(*problem, None, "{case:?}");
    }
    // The same check finds a field that is not described, and one that is missing.
    for case in cases.iter().step_by(cases.len() / 40 + 1) {
        let mut message: Map<String, Value> = serde_json::from_str(&case.1).unwrap();
        let (first, value) = message.clone().into_iter().next().unwrap();
        message.remove(&first);
        let less = (case.0.clone(), json!(message).to_string());
        message.extend([(first, value), ("undescribed".to_owned(), json!(1))]);
        let more = (case.0.clone(), json!(message).to_string());
        for problem in validated(&document, &[], &[less, more]) {
            assert!(problem.is_some(), "{case:?}");
        }
    }
    eprintln!("valid: {seen:?}");
}
