//! Reports of robots, checked by the schema and by ingest.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use muster_tests::cluster::Cluster;

use super::Wanted::{self, Accepted, OnlyByService, Refused};
use super::compare;
use crate::pipeline::FORMED_WITHIN;
use crate::schema::answered;

fn long(count: usize, item: impl Fn(usize) -> String) -> String {
    (0..count).map(item).collect::<Vec<_>>().join(",")
}

/// The stream and the text of reports, and what is wanted. ME is the robot itself.
fn reports() -> Vec<(&'static str, String, Wanted)> {
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
            r#"{"skills":null}"#,
            r#"{"skills":[]}"#,
            r#"{"superior":"r1","skills":["medic","relay"]}"#,
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
            r#"{"skills":"medic"}"#,
            r#"{"skills":["Medic"]}"#,
            r#"{"skills":[1]}"#,
            r#"{"skills":["a","b","c","d","e","f","g","h","i","j","k","l","m","n","o","p","q"]}"#,
        ],
    );
    add("rank", OnlyByService("a skill that is named twice"), &[r#"{"skills":["a","a"]}"#]);
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

#[tokio::test(flavor = "multi_thread")]
async fn schema_and_ingest_accept_the_same_reports() {
    let cluster = Cluster::start("alpha", &[("ingest", "modalities=[\"thermal\"]")]).unwrap();
    let client = cluster.client().await.unwrap();
    let document = answered(&client, "schema").await;
    // Before its term begins it refuses without an event.
    let start = Instant::now();
    while answered(&client, "service/ingest/status").await["revision"]["term"] == 0 {
        assert!(start.elapsed() < FORMED_WITHIN, "ingest begins no term");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let events = client.watch("json/event").await.unwrap();
    let cases = reports();
    for (number, (stream, text, _)) in cases.iter().enumerate() {
        // Each case has a robot of its own, so that events name it.
        let robot = format!("c{number}");
        let text = text.replace("ME", &robot).into_bytes();
        let key = format!("robot/{robot}/{stream}");
        client.put_bytes(&key, text, "application/json").await.unwrap();
    }
    let start = Instant::now();
    let results = loop {
        let mut results = BTreeMap::new();
        for (_, event) in events.all() {
            let result = match event["event"].as_str() {
                Some("robot_joined") => Ok(()),
                Some("quarantined") => Err(event["reason"].as_str().unwrap().to_owned()),
                _ => continue,
            };
            results.insert(event["robot"].as_str().unwrap().to_owned(), result);
        }
        let missing: Vec<_> = (0..cases.len())
            .filter(|number| !results.contains_key(&format!("c{number}")))
            .map(|number| &cases[number])
            .collect();
        if missing.is_empty() {
            break results;
        }
        assert!(start.elapsed() < FORMED_WITHIN, "no result on {missing:?}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    };
    let cases: Vec<_> = cases
        .into_iter()
        .enumerate()
        .map(|(number, (stream, text, wanted))| {
            let robot = format!("c{number}");
            let name = stream.split('/').next().unwrap().to_owned();
            (name, text.replace("ME", &robot), wanted, results[&robot].clone())
        })
        .collect();
    compare(&document, &cases);
    eprintln!("{} cases", cases.len());
}
