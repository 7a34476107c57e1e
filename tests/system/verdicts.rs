//! What the schema accepts the services accept, and what it refuses they refuse.
//!
//! Every case is judged twice: by a validator that somebody else wrote, and by a live service. Where
//! the two may differ, the schema's own description says so, in words that the case names.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use muster_tests::client::Client;
use muster_tests::cluster::{Cluster, SERVICES};
use serde_json::{Map, Value, json};

use crate::pipeline::FORMED_WITHIN;
use crate::schema::{answered, judged};

/// How a case must come out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Wanted {
    /// Both accept it.
    Accepted,
    /// Both refuse it.
    Refused,
    /// The schema accepts it, the service does not, and a description says why, in these words.
    OnlyByService(&'static str),
}
use Wanted::{Accepted, OnlyByService, Refused};

fn long(count: usize, item: impl Fn(usize) -> String) -> String {
    (0..count).map(item).collect::<Vec<_>>().join(",")
}

/// What a robot says, on which stream, and how it comes out. ME is the robot itself.
fn said_by_robots() -> Vec<(&'static str, String, Wanted)> {
    let mut cases: Vec<(&'static str, String, Wanted)> = Vec::new();
    let mut add = |stream, wanted, texts: &[&str]| {
        cases.extend(texts.iter().map(|text| (stream, (*text).to_owned(), wanted)));
    };
    add(
        "pose",
        Accepted,
        &[
            r#"{"x":1.0,"y":2.0}"#,
            r#"{"x":1,"y":-2}"#,
            r#"{"x":1.0,"y":2.0,"z":3.0,"heading":0.5,"frame":"map","stamp":1.0e9,"boot":"a","seq":1}"#,
            r#"{"x":1.0,"y":2.0,"z":null,"heading":null,"frame":null,"stamp":null,"boot":null,"seq":null}"#,
            r#"{"x":4e7,"y":-4e7,"z":4e7}"#,
            r#"{"x":-4e7,"y":4e7,"z":-4e7}"#,
            r#"{"x":0,"y":0,"heading":-1e308}"#,
            r#"{"x":0,"y":0,"stamp":0}"#,
            r#"{"x":0,"y":0,"boot":"","seq":0}"#,
            r#"{"x":0,"y":0,"seq":18446744073709551615}"#,
            r#" {"x" : 0, "y" : 0} "#,
        ],
    );
    add(
        "pose",
        Refused,
        &[
            "",
            "{",
            "null",
            "17",
            r#""text""#,
            "[]",
            "{}",
            "[1.0,2.0,null,null,null,null,null,null]",
            r#"{"x":1.0}"#,
            r#"{"y":1.0}"#,
            r#"{"x":1.0,"y":2.0,"speed":3.0}"#,
            r#"{"X":1.0,"y":2.0}"#,
            r#"{"x":"1.0","y":2.0}"#,
            r#"{"x":null,"y":2.0}"#,
            r#"{"x":true,"y":2.0}"#,
            r#"{"x":[1.0],"y":2.0}"#,
            r#"{"x":NaN,"y":2.0}"#,
            r#"{"x":Infinity,"y":2.0}"#,
            r#"{"x":1e999,"y":2.0}"#,
            r#"{"x":40000001,"y":0}"#,
            r#"{"x":-40000001,"y":0}"#,
            r#"{"x":0,"y":40000001}"#,
            r#"{"x":0,"y":-40000001}"#,
            r#"{"x":0,"y":0,"z":40000001}"#,
            r#"{"x":0,"y":0,"z":-40000001}"#,
            r#"{"x":0,"y":0,"heading":"north"}"#,
            r#"{"x":0,"y":0,"frame":7}"#,
            r#"{"x":0,"y":0,"stamp":-0.001}"#,
            r#"{"x":0,"y":0,"stamp":"now"}"#,
            r#"{"x":0,"y":0,"boot":17}"#,
            r#"{"x":0,"y":0,"boot":"a\u0007b"}"#,
            r#"{"x":0,"y":0,"boot":"a\n"}"#,
            r#"{"x":0,"y":0,"boot":"\u0085"}"#,
            r#"{"x":0,"y":0,"seq":-1}"#,
            r#"{"x":0,"y":0,"seq":1.5}"#,
            r#"{"x":0,"y":0,"seq":"1"}"#,
            r#"{"x":0,"y":0,"seq":18446744073709551616}"#,
            r#"{"x":0,"y":0} {}"#,
        ],
    );
    add("pose", OnlyByService("a frame that the settings"), &[r#"{"x":0,"y":0,"frame":"mars"}"#]);
    add("pose", OnlyByService("a frame that the settings"), &[r#"{"x":0,"y":0,"frame":""}"#]);
    add("pose", OnlyByService("17, not 17.0"), &[r#"{"x":0,"y":0,"seq":17.0}"#]);
    add("pose", OnlyByService("no key stands twice"), &[r#"{"x":0,"x":1,"y":0}"#]);
    // The validator reads it as infinity.
    add("pose", OnlyByService("within double precision"), &[r#"{"x":0,"y":0,"heading":1e999}"#]);
    add(
        "links",
        Accepted,
        &[
            r#"{"links":[]}"#,
            r#"{"links":[{"peer":"r2","quality":0.93}]}"#,
            r#"{"links":[{"peer":"r2","quality":0},{"peer":"r_3-x","quality":1}],"stamp":1,"boot":"b","seq":3}"#,
        ],
    );
    add(
        "links",
        Refused,
        &[
            "{}",
            "[]",
            r#"{"links":null}"#,
            r#"{"links":{}}"#,
            r#"{"links":["r2"]}"#,
            r#"{"links":[["r2",0.5]]}"#,
            r#"{"links":[{"peer":"r2"}]}"#,
            r#"{"links":[{"quality":0.5}]}"#,
            r#"{"links":[{"peer":"r2","quality":null}]}"#,
            r#"{"links":[{"peer":"r2","quality":"0.5"}]}"#,
            r#"{"links":[{"peer":"r2","quality":0.5,"rssi":-40}]}"#,
            r#"{"links":[{"peer":"R2","quality":0.5}]}"#,
            r#"{"links":[{"peer":"","quality":0.5}]}"#,
            r#"{"links":[{"peer":"r2\n","quality":0.5}]}"#,
            r#"{"links":[{"peer":"r/2","quality":0.5}]}"#,
            r#"{"links":[{"peer":"*","quality":0.5}]}"#,
            r#"{"links":[{"peer":2,"quality":0.5}]}"#,
            r#"{"links":[],"seq":-1}"#,
            r#"{"links":[],"extra":1}"#,
        ],
    );
    add(
        "links",
        OnlyByService("a peer that is named twice"),
        &[r#"{"links":[{"peer":"r2","quality":0.1},{"peer":"r2","quality":0.2}]}"#],
    );
    add(
        "links",
        OnlyByService("is the robot itself"),
        &[r#"{"links":[{"peer":"ME","quality":0.1}]}"#],
    );
    add(
        "links",
        OnlyByService("0 to 1 by default"),
        &[
            r#"{"links":[{"peer":"r2","quality":1.01}]}"#,
            r#"{"links":[{"peer":"r2","quality":-0.01}]}"#,
        ],
    );
    add(
        "rank",
        Accepted,
        &[
            "{}",
            r#"{"superior":null}"#,
            r#"{"superior":"r1"}"#,
            r#"{"superior":"r1","weight":0,"role":"scout"}"#,
            r#"{"superior":"r1","weight":1e6,"role":""}"#,
            r#"{"superior":"r1","weight":null,"role":null,"stamp":1,"boot":"b","seq":1}"#,
        ],
    );
    add(
        "rank",
        Refused,
        &[
            "[]",
            r#"["r1",null,null,null,null,null]"#,
            r#"{"superior":"R1"}"#,
            r#"{"superior":""}"#,
            r#"{"superior":1}"#,
            r#"{"superior":["r1"]}"#,
            r#"{"superior":"r1","weight":-0.001}"#,
            r#"{"superior":"r1","weight":1000001}"#,
            r#"{"superior":"r1","weight":"1"}"#,
            r#"{"superior":"r1","role":1}"#,
            r#"{"superior":"r1","role":"a\tb"}"#,
            r#"{"superior":"r1","rank":1}"#,
        ],
    );
    add("rank", OnlyByService("a superior that is the robot itself"), &[r#"{"superior":"ME"}"#]);
    add(
        "relation/thermal",
        Accepted,
        &[
            r#"{"edges":[]}"#,
            r#"{"edges":[["ME","r2",0.5]]}"#,
            r#"{"edges":[["ME","r2",0],["ME","r3",1e6]],"stamp":1,"boot":"b","seq":1}"#,
        ],
    );
    add(
        "relation/thermal",
        Refused,
        &[
            "{}",
            "[]",
            r#"{"edges":null}"#,
            r#"{"edges":{}}"#,
            r#"{"edges":[["ME","r2"]]}"#,
            r#"{"edges":[["ME","r2",0.5,1]]}"#,
            r#"{"edges":[["ME",0.5,"r2"]]}"#,
            r#"{"edges":[{"from":"ME","to":"r2","weight":1}]}"#,
            r#"{"edges":[["ME","R2",0.5]]}"#,
            r#"{"edges":[["ME","r2",-0.001]]}"#,
            r#"{"edges":[["ME","r2",1000001]]}"#,
            r#"{"edges":[["ME","r2","1"]]}"#,
            r#"{"edges":[["ME","r2",null]]}"#,
            r#"{"edges":[],"modality":"thermal"}"#,
        ],
    );
    add("relation/thermal", OnlyByService("edges from another"), &[r#"{"edges":[["r8","r9",1]]}"#]);
    add(
        "relation/thermal",
        OnlyByService("to the robot itself"),
        &[r#"{"edges":[["ME","ME",1]]}"#],
    );
    add(
        "relation/thermal",
        OnlyByService("named twice"),
        &[r#"{"edges":[["ME","r2",1],["ME","r2",2]]}"#],
    );
    add("relation/sonar", OnlyByService("do not declare"), &[r#"{"edges":[["ME","r2",1]]}"#]);

    // Longest and one more.
    let text = |count: usize, letter: &str| {
        let boot = letter.repeat(count);
        format!(r#"{{"x":0,"y":0,"boot":"{boot}"}}"#)
    };
    cases.push(("pose", text(64, "a"), Accepted));
    cases.push(("pose", text(65, "a"), Refused));
    cases.push(("pose", text(32, "ä"), Accepted));
    cases.push(("pose", text(33, "ä"), OnlyByService("at most 64 bytes of UTF-8")));
    let peer = |count: usize| {
        let peer = "p".repeat(count);
        format!(r#"{{"links":[{{"peer":"{peer}","quality":1}}]}}"#)
    };
    cases.push(("links", peer(64), Accepted));
    cases.push(("links", peer(65), Refused));
    for (count, wanted) in [(1024, Accepted), (1025, Refused)] {
        let links = long(count, |n| format!(r#"{{"peer":"p{n}","quality":1}}"#));
        cases.push(("links", format!(r#"{{"links":[{links}]}}"#), wanted));
        let edges = long(count, |n| format!(r#"["ME","p{n}",1]"#));
        cases.push(("relation/thermal", format!(r#"{{"edges":[{edges}]}}"#), wanted));
    }
    let blank = " ".repeat(196_608);
    cases.push(("pose", format!(r#"{{"x":0,{blank}"y":0}}"#), OnlyByService("196608 bytes")));
    cases
}

/// Checks all cases against the schema, and that what only the service refuses is documented.
fn compare(document: &Value, cases: &[(String, String, Wanted, Result<(), String>)]) {
    let texts: Vec<_> = cases.iter().map(|(name, text, ..)| (name.clone(), text.clone())).collect();
    let all = document.to_string();
    for ((name, text, wanted, service), schema) in cases.iter().zip(judged(document, &[], &texts)) {
        let text: String = text.chars().take(200).collect();
        let says =
            format!("{name} {text}: wanted {wanted:?}, schema {schema:?}, service {service:?}");
        assert_eq!(schema.is_none(), *wanted != Refused, "{says}");
        assert_eq!(service.is_ok(), *wanted == Accepted, "{says}");
        if let OnlyByService(words) = wanted {
            assert!(all.contains(words), "not documented: {says}");
        }
        if let Err(reason) = service {
            assert!(!reason.is_empty(), "{says}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_robots_say_is_judged_alike_by_the_schema_and_by_ingest() {
    let cluster = Cluster::start("alpha", &[("ingest", "modalities=[\"thermal\"]")]).unwrap();
    let client = cluster.client().await.unwrap();
    let document = answered(&client, "schema").await;
    // Before its term has begun it refuses in silence.
    let start = Instant::now();
    while answered(&client, "service/ingest/status").await["revision"]["term"] == 0 {
        assert!(start.elapsed() < FORMED_WITHIN, "ingest begins no term");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let events = client.watch("json/event").await.unwrap();
    let cases = said_by_robots();
    for (number, (stream, text, _)) in cases.iter().enumerate() {
        // Each case has a robot of its own, so that it is told of by name.
        let robot = format!("c{number}");
        let text = text.replace("ME", &robot).into_bytes();
        let key = format!("robot/{robot}/{stream}");
        client.put_bytes(&key, text, "application/json").await.unwrap();
    }
    let start = Instant::now();
    let verdicts = loop {
        let mut verdicts = BTreeMap::new();
        for (_, event) in events.all() {
            let verdict = match event["event"].as_str() {
                Some("robot_joined") => Ok(()),
                Some("quarantined") => Err(event["reason"].as_str().unwrap().to_owned()),
                _ => continue,
            };
            verdicts.insert(event["robot"].as_str().unwrap().to_owned(), verdict);
        }
        let missing: Vec<_> = (0..cases.len())
            .filter(|number| !verdicts.contains_key(&format!("c{number}")))
            .map(|number| &cases[number])
            .collect();
        if missing.is_empty() {
            break verdicts;
        }
        assert!(start.elapsed() < FORMED_WITHIN, "no verdict on {missing:?}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    };
    let cases: Vec<_> = cases
        .into_iter()
        .enumerate()
        .map(|(number, (stream, text, wanted))| {
            let robot = format!("c{number}");
            let name = stream.split('/').next().unwrap().to_owned();
            (name, text.replace("ME", &robot), wanted, verdicts[&robot].clone())
        })
        .collect();
    compare(&document, &cases);
    eprintln!("{} cases", cases.len());
}

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
            ("ingest", "spatial.neighbours", 256.0) => (json!({"max_robots": 9000}), Accepted),
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
            r#"{"spatial":["gaussian",2.0,200,16,null]}"#,
            r#"{"spatial":7}"#,
            r#"{"spatial":{"kernel":"cubic"}}"#,
            r#"{"spatial":{"kernel":7}}"#,
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
        &[r#"{"spatial":{"neighbours":200},"max_robots":100000}"#],
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
        &[r#"{"teams":3,"init":"random"}"#, r#"{"init":"kmeans++"}"#, r#"{"teams":null,"seed":7}"#],
    );
    add(
        "clusterer",
        Refused,
        &[
            r#"{"teams":"3"}"#,
            r#"{"teams":2.5}"#,
            r#"{"teams":[3]}"#,
            r#"{"init":"best"}"#,
            r#"{"seed":-1}"#,
            r#"{"team":3}"#,
            r#"{"teams":3,"restarts":0}"#,
        ],
    );
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
    let key = client.key(&format!("service/{service}/settings"));
    let get = client.session().get(key).payload(text).timeout(Duration::from_secs(5));
    let replies = get.await.unwrap();
    let reply = replies.recv_async().await.expect("every patch is answered");
    match reply.result() {
        Ok(_) => Ok(()),
        Err(error) => Err(String::from_utf8_lossy(&error.payload().to_bytes()).into_owned()),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn patches_of_settings_are_judged_alike_by_the_schema_and_by_the_services() {
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
    let mut judged = Vec::new();
    for (service, text, wanted) in cases {
        let verdict = patched(&client, service, &text).await;
        let (settings, back) = &defaults[service];
        if verdict.is_ok() {
            patched(&client, service, back).await.unwrap();
        }
        let now = client.get_one(&format!("service/{service}/settings")).await.unwrap();
        assert_eq!(now, *settings, "{service} {text}");
        judged.push((format!("{service}_settings_patch"), text, wanted, verdict));
    }
    compare(&document, &judged);
    let whole: Vec<_> = defaults
        .iter()
        .map(|(service, (settings, _))| (format!("{service}_settings"), settings.to_string()))
        .collect();
    assert_eq!(crate::schema::judged(&document, &[], &whole), vec![None; 4]);
    eprintln!("{} cases", judged.len());
}
