//! Patches of settings, checked by the schema and by the services, at every bound too.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_tests::client::Client;
use muster_tests::cluster::{Cluster, SERVICES};
use serde_json::{Map, Value, json};

use super::Wanted::{self, Accepted, OnlyByService, Refused};
use super::compare;
use crate::schema::answered;

/// The bounds of every number in the schema of a patch, as patches: at the bound and just beyond it.
fn at_the_bounds(service: &str, schema: &Value) -> Vec<(String, Wanted)> {
    fn look(path: &[&str], schema: &Value, found: &mut Vec<(Vec<String>, Value, f64)>) {
        for (name, field) in schema["properties"].as_object().unwrap() {
            let path = [path, &[name.as_str()]].concat();
            if field.get("properties").is_some() {
                look(&path, field, found);
            }
            let whole = field["type"].to_string().contains("integer");
            for (bound, outward) in [("minimum", -1.0), ("maximum", 1.0)] {
                let Some(bound) = field.get(bound) else { continue };
                let value = bound.as_f64().unwrap();
                let step = if whole { 1.0 } else { (value.abs() * 1e-6).max(1e-15) };
                let path = path.iter().map(|name| (*name).to_owned()).collect();
                found.push((path, bound.clone(), value + outward * step));
            }
        }
    }
    fn patch(path: &[String], value: &Value) -> Value {
        path.iter().rev().fold(value.clone(), |inner, name| json!({ name: inner }))
    }
    let mut found = Vec::new();
    look(&[], schema, &mut found);
    let mut cases = Vec::new();
    for (path, bound, beyond) in found {
        // Some bounds hold only together with another field, and some of those never.
        let (with, wanted) = match (service, path.join(".").as_str(), bound.as_f64().unwrap()) {
            ("ingest", "gone_after_s", 0.1) => {
                (json!({}), OnlyByService("not above stale_after_s"))
            }
            ("ingest", "stale_after_s", 86_400.0) => (json!({"gone_after_s": 604_800}), Accepted),
            ("ingest", "spatial.neighbours", 256.0) => (json!({"max_robots": 8700}), Accepted),
            ("ingest", "connectivity.rssi_floor_dbm", 100.0)
            | ("ingest", "connectivity.rssi_ceiling_dbm", -200.0) => {
                (json!({}), OnlyByService("less than 1 dB above"))
            }
            ("auditor", "good", -1.0) => (json!({"poor": -1}), Accepted),
            ("auditor", "poor", 1.0) => (json!({"good": 1}), Accepted),
            _ => (json!({}), Accepted),
        };
        let mut at = patch(&path, &bound);
        at.as_object_mut().unwrap().extend(with.as_object().unwrap().clone());
        cases.push((at.to_string(), wanted));
        let beyond = if bound.is_f64() || beyond.abs() > 1e15 || beyond.fract() != 0.0 {
            json!(beyond)
        } else {
            json!(beyond as i64)
        };
        cases.push((patch(&path, &beyond).to_string(), Refused));
    }
    cases
}

/// Patches of settings by service, and how they come out.
fn patches() -> Vec<(&'static str, String, Wanted)> {
    let mut cases: Vec<(&'static str, String, Wanted)> = Vec::new();
    let mut add = |service, wanted, texts: &[&str]| {
        cases.extend(texts.iter().map(|text| (service, (*text).to_owned(), wanted)));
    };
    for service in SERVICES {
        add(service, Accepted, &["{}"]);
        add(service, Refused, &["[]", "null", "{", "7", r#""teams""#, r#"{"nonsense":1}"#]);
    }
    add(
        "ingest",
        Accepted,
        &[
            r#"{"tick_hz":null,"spatial":null,"frames":null}"#,
            r#"{"spatial":{"kernel":"exponential","radius_m":12.5}}"#,
            r#"{"spatial":{"radius_m":null,"width":null}}"#,
            r#"{"spatial":{"kernel":"wendland-c2","cutoff":3}}"#,
            r#"{"spatial":{"kernel":null,"cutoff":null}}"#,
            r#"{"connectivity":{"unit":"rssi_dbm"}}"#,
            r#"{"frames":["map","odom"]}"#,
            r#"{"modalities":["thermal","sonar"]}"#,
            r#"{"modalities":[]}"#,
        ],
    );
    add(
        "ingest",
        Refused,
        &[
            r#"{"tick_hz":"10"}"#,
            r#"{"tick_hz":true}"#,
            r#"{"max_robots":10.5}"#,
            r#"{"spatial":["gaussian",2.0,9.0,200,16,null]}"#,
            r#"{"spatial":7}"#,
            r#"{"spatial":{"kernel":"cubic"}}"#,
            r#"{"spatial":{"kernel":7}}"#,
            r#"{"spatial":{"cutoff":"far"}}"#,
            r#"{"spatial":{"radius":1}}"#,
            r#"{"connectivity":{"unit":"volts"}}"#,
            r#"{"frames":[]}"#,
            r#"{"frames":[""]}"#,
            r#"{"frames":["a","b","c","d","e","f","g","h","i"]}"#,
            r#"{"frames":["a\u0000"]}"#,
            r#"{"frames":"map"}"#,
            r#"{"frames":[1]}"#,
            r#"{"modalities":["thermal","thermal"]}"#,
            r#"{"modalities":["spatial"]}"#,
            r#"{"modalities":["Thermal"]}"#,
            r#"{"modalities":["a","b","c","d","e","f","g","h","i","j","k","l","m","n","o","p","q"]}"#,
        ],
    );
    add("ingest", OnlyByService("17, not 17.0"), &[r#"{"max_robots":100.0}"#]);
    add(
        "ingest",
        OnlyByService("spatial.neighbours times max_robots"),
        &[
            r#"{"spatial":{"neighbours":200},"max_robots":100000}"#,
            r#"{"spatial":{"kernel":"wendland-c2","neighbours":13},"max_robots":100000}"#,
        ],
    );
    add(
        "embedder",
        Accepted,
        &[
            r#"{"weights":{"spatial":0.5,"thermal":0.5}}"#,
            r#"{"weights":{}}"#,
            r#"{"alpha":0.25}"#,
            r#"{"alpha":1e-12}"#,
            r#"{"alpha":1e12}"#,
            r#"{"alpha":{"fraction":1e-6}}"#,
            r#"{"alpha":{"fraction":0.999999}}"#,
            r#"{"dimension":"auto"}"#,
            r#"{"dimension":2}"#,
            r#"{"dimension":256}"#,
            r#"{"normalize":"none","scale":"none","rows":"none"}"#,
            r#"{"normalize":"spectral","scale":"sqrt-sigma","rows":"unit"}"#,
            r#"{"weights":null,"alpha":null,"dimension":null,"normalize":null}"#,
        ],
    );
    add(
        "embedder",
        Refused,
        &[
            r#"{"weights":[["spatial",1.0]]}"#,
            r#"{"weights":{"spatial":1.5}}"#,
            r#"{"weights":{"spatial":-0.5,"thermal":1.5}}"#,
            r#"{"weights":{"Spatial":1}}"#,
            r#"{"weights":{"spatial":"1"}}"#,
            r#"{"weights":{"spatial":null}}"#,
            r#"{"alpha":0}"#,
            r#"{"alpha":-1}"#,
            r#"{"alpha":1.1e12}"#,
            r#"{"alpha":"0.5"}"#,
            r#"{"alpha":[0.5]}"#,
            r#"{"alpha":{}}"#,
            r#"{"alpha":{"fraction":0}}"#,
            r#"{"alpha":{"fraction":1}}"#,
            r#"{"alpha":{"fraction":null}}"#,
            r#"{"alpha":{"fraction":0.5,"x":1}}"#,
            r#"{"dimension":0}"#,
            r#"{"dimension":3}"#,
            r#"{"dimension":-2}"#,
            r#"{"dimension":258}"#,
            r#"{"dimension":"best"}"#,
            r#"{"dimension":[2]}"#,
            r#"{"normalize":"l2"}"#,
            r#"{"scale":"sigma"}"#,
            r#"{"rows":"None"}"#,
        ],
    );
    add("embedder", OnlyByService("do not sum to 1"), &[r#"{"weights":{"spatial":0.7}}"#]);
    add("embedder", OnlyByService("17, not 17.0"), &[r#"{"dimension":4.0}"#]);
    add(
        "clusterer",
        Accepted,
        &[
            r#"{"teams":3,"init":"random"}"#,
            r#"{"init":"kmeans++"}"#,
            r#"{"teams":null,"seed":7}"#,
            r#"{"teams":"auto"}"#,
            r#"{"teams":1}"#,
            r#"{"teams":1024}"#,
            r#"{"teams":{"from":1,"to":128}}"#,
            r#"{"teams":{"from":3,"to":3}}"#,
            r#"{"needs":[{"skill":"medic","per_team":{"min":1}}]}"#,
            r#"{"needs":[{"skill":"medic","per_team":{"min":1,"max":null}},{"skill":"medic","team":"t2","per_team":{"min":0,"max":2},"soft":true}]}"#,
            r#"{"needs":null}"#,
            r#"{"size":{"min":2}}"#,
            r#"{"team_size":{"t1":{"min":2}}}"#,
            r#"{"team_size":{"t1":{"max":3},"t2":{"min":1,"max":null},"t3":{}}}"#,
            r#"{"team_size":{}}"#,
            r#"{"team_size":null}"#,
        ],
    );
    add(
        "clusterer",
        Refused,
        &[
            r#"{"teams":"3"}"#,
            r#"{"teams":2.5}"#,
            r#"{"teams":[3]}"#,
            r#"{"teams":"many"}"#,
            r#"{"teams":0}"#,
            r#"{"teams":1025}"#,
            r#"{"teams":{"from":0,"to":3}}"#,
            r#"{"teams":{"from":3,"to":129}}"#,
            r#"{"teams":{"from":3}}"#,
            r#"{"teams":{"from":1,"to":3,"step":2}}"#,
            r#"{"init":"best"}"#,
            r#"{"seed":-1}"#,
            r#"{"team":3}"#,
            r#"{"team_size":{"t1":3}}"#,
            r#"{"team_size":{"t1":null}}"#,
            r#"{"team_size":{"t1":{"most":3}}}"#,
            r#"{"team_size":{"t1":{"max":0}}}"#,
            r#"{"team_size":{"t1":{"min":100001}}}"#,
            r#"{"team_size":{"T 1":{"min":1}}}"#,
            r#"{"team_size":[["t1",{"min":1}]]}"#,
            r#"{"teams":3,"restarts":0}"#,
            r#"{"needs":{"skill":"medic","per_team":{"min":1}}}"#,
            r#"{"needs":[["medic",null,{"min":1},false]]}"#,
            r#"{"needs":[{"skill":"Medic","per_team":{"min":1}}]}"#,
            r#"{"needs":[{"skill":"medic","per_team":[1,2]}]}"#,
            r#"{"needs":[{"skill":"medic","per_team":{"max":1}}]}"#,
            r#"{"needs":[{"skill":"medic","per_team":{"min":100001}}]}"#,
            r#"{"needs":[{"skill":"medic","per_team":{"min":1},"hard":true}]}"#,
        ],
    );
    add("clusterer", OnlyByService("at least `from`"), &[r#"{"teams":{"from":3,"to":2}}"#]);
    add(
        "clusterer",
        OnlyByService("a need that stands twice"),
        &[r#"{"needs":[{"skill":"a","per_team":{"min":1}},{"skill":"a","per_team":{"min":2}}]}"#],
    );
    let contrary = r#"{"needs":[{"skill":"a","per_team":{"min":2,"max":1}}]}"#;
    add("clusterer", OnlyByService("need whose max is below its min"), &[contrary]);
    add(
        "clusterer",
        OnlyByService("size, team_size or need whose max is below its min"),
        &[
            r#"{"team_size":{"t1":{"min":3,"max":2}}}"#,
            r#"{"size":{"min":3},"team_size":{"t1":{"max":2}}}"#,
        ],
    );
    let many: Vec<String> = (0..257).map(|team| format!(r#""t{team}":{{}}"#)).collect();
    cases.push(("clusterer", format!(r#"{{"team_size":{{{}}}}}"#, many.join(",")), Refused));
    let mut add = |service, wanted, texts: &[&str]| {
        cases.extend(texts.iter().map(|text| (service, (*text).to_owned(), wanted)));
    };
    add("clusterer", OnlyByService("17, not 17.0"), &[r#"{"teams":3.0}"#]);
    add("auditor", Accepted, &[r#"{"good":0.9,"poor":0.1}"#, r#"{"good":null}"#]);
    add("auditor", Refused, &[r#"{"good":"high"}"#, r#"{"goods":0.5}"#]);
    add("auditor", OnlyByService("good that is less than poor"), &[r#"{"good":0.1,"poor":0.5}"#]);
    let frame = "f".repeat(64);
    cases.push(("ingest", format!(r#"{{"frames":["{frame}"]}}"#), Accepted));
    cases.push(("ingest", format!(r#"{{"frames":["{frame}f"]}}"#), Refused));
    let blank = " ".repeat(65_536);
    cases.push(("auditor", format!("{{{blank}}}"), OnlyByService("more than 65536 bytes")));
    cases
}

/// Whether a service takes a patch; the error if not.
async fn patched(client: &Client, service: &str, text: &str) -> Result<(), String> {
    let now = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap().as_secs_f64();
    let id = format!("p{}", (now * 1e6) as u64);
    // The patch as it is written: JSON that is read and written again would hide what is wrong with it.
    let command = format!(r#"{{"sent":{now},"expires":{},"action":{{"set":{text}}}}}"#, now + 60.0);
    let key = format!("command/{service}/operator/{id}");
    for _ in 0..50 {
        let within = Duration::from_secs(5);
        let answers = client.get_raw(&key, Some(command.clone()), within).await.unwrap();
        let (_, answer) = answers.into_iter().next().expect("every patch is answered");
        match answer {
            Err(error) if error.contains("the service is starting") => {
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
            answer => return answer.map(|_| ()),
        }
    }
    panic!("{service} does not begin");
}

#[tokio::test(flavor = "multi_thread")]
async fn schema_and_services_accept_the_same_patches_of_settings() {
    let cluster = Cluster::start("alpha", &[]).unwrap();
    let client = cluster.client().await.unwrap();
    let document = answered(&client, "schema").await;
    let mut cases = patches();
    let mut defaults = BTreeMap::new();
    for service in SERVICES {
        let settings = answered(&client, &format!("service/{service}/settings")).await;
        let schema = &document["$defs"][format!("{service}_settings_patch")];
        let fields = settings.as_object().unwrap().keys();
        assert!(fields.eq(schema["properties"].as_object().unwrap().keys()), "{service}");
        let back: Map<String, Value> =
            settings.as_object().unwrap().keys().map(|name| (name.clone(), Value::Null)).collect();
        defaults.insert(service, (settings, json!(back).to_string()));
        let bounds = at_the_bounds(service, schema);
        cases.extend(bounds.into_iter().map(|(text, wanted)| (service, text, wanted)));
    }
    let mut checked = Vec::new();
    for (service, text, wanted) in cases {
        let result = patched(&client, service, &text).await;
        let (settings, back) = &defaults[service];
        if result.is_ok() {
            patched(&client, service, back).await.unwrap();
        }
        let now = client.get_one(&format!("service/{service}/settings")).await.unwrap();
        assert_eq!(now, *settings, "{service} {text}");
        checked.push((format!("{service}_settings_patch"), text, wanted, result));
    }
    compare(&document, &checked);
    let whole: Vec<_> = defaults
        .iter()
        .map(|(service, (settings, _))| (format!("{service}_settings"), settings.to_string()))
        .collect();
    assert_eq!(crate::schema::validated(&document, &[], &whole), vec![None; 4]);
    eprintln!("{} cases", checked.len());
}
