//! The demo: one command, everything real.

use std::collections::BTreeSet;
use std::time::Duration;

use muster_tests::client::Client;
use muster_tests::cluster::start_router;
use muster_tests::ports::free_endpoint;
use muster_tests::process::{Process, run};
use serde_json::Value;

#[test]
fn the_demo_prints_every_change_as_json() {
    let endpoint = free_endpoint().unwrap();
    let arguments = [
        "demo",
        "--robots",
        "12",
        "--teams",
        "2",
        "--seconds",
        "25",
        "--seed",
        "3",
        "--json",
        "--listen",
        &endpoint,
    ];
    let (code, out, err) = run("muster", &arguments, Duration::from_secs(60)).unwrap();
    assert_eq!(code, Some(0), "{err}");
    let lines: Vec<Value> =
        out.lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect();
    let full: Vec<&Value> = lines
        .iter()
        .filter(|line| {
            let members: usize = line["teams"]
                .as_array()
                .unwrap()
                .iter()
                .map(|team| team["members"].as_array().unwrap().len())
                .sum();
            members == 12 && line["teams"].as_array().unwrap().len() == 2
        })
        .collect();
    let divisions: BTreeSet<String> = full.iter().map(|line| line["teams"].to_string()).collect();
    assert!(divisions.len() >= 2, "the handed-over squad changes its team:\n{out}");
    for pair in lines.windows(2) {
        assert_ne!(
            (&pair[0]["teams"], &pair[0]["unassigned"], &pair[0]["stale"]),
            (&pair[1]["teams"], &pair[1]["unassigned"], &pair[1]["stale"]),
            "a line is a change"
        );
    }
}

#[test]
fn the_demo_ends_on_a_signal_and_can_be_looked_at_meanwhile() {
    let folder = tempfile::tempdir().unwrap();
    let endpoint = free_endpoint().unwrap();
    let arguments = ["demo", "--listen", &endpoint];
    let mut demo = Process::start("muster", &arguments, &[], folder.path()).unwrap();
    demo.until_prints("t2", Duration::from_secs(20)).unwrap();
    let teams = ["teams", "--json", "--fleet", "demo", "--connect", &endpoint];
    let (code, out, err) = run("muster", &teams, Duration::from_secs(10)).unwrap();
    assert_eq!(code, Some(0), "{err}");
    assert!(serde_json::from_str::<Value>(&out).unwrap()["teams"].is_array());
    demo.signal("TERM").unwrap();
    assert_eq!(demo.wait(Duration::from_secs(5)).unwrap().code(), Some(0));
}

#[test]
fn numbers_that_make_no_demo_are_refused() {
    for arguments in [
        vec!["demo", "--robots", "0"],
        vec!["demo", "--teams", "0"],
        vec!["demo", "--seconds", "-1"],
        vec!["demo", "--seconds", "nan"],
        vec!["demo", "--listen", "nowhere"],
        vec!["demo", "--connect", "tcp/127.0.0.1:7447"],
    ] {
        let (code, _, err) = run("muster", &arguments, Duration::from_secs(10)).unwrap();
        assert_eq!(code, Some(2), "{arguments:?}: {err}");
    }
}

/// Waits until a demo has printed a table of all its robots, and returns where its router listens.
fn until_complete(demo: &mut Process) -> String {
    demo.until_prints("p2-s2-r4", Duration::from_secs(30)).unwrap();
    let output = demo.output();
    assert!(output.contains("fleet demo  term 1"), "{output}");
    let (_, rest) = output.split_once("on a router at ").unwrap();
    rest.split_once(';').unwrap().0.to_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn demos_stay_apart_from_a_live_fleet_and_from_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let live = free_endpoint().unwrap();
    let _router = start_router(&live, folder.path()).unwrap();
    let zenoh = folder.path().join("zenoh.json5");
    std::fs::write(&zenoh, format!("{{connect: {{endpoints: [\"{live}\"]}}}}")).unwrap();
    let file = folder.path().join("muster.toml");
    std::fs::write(&file, format!("fleet = \"alpha\"\nconnect = [\"{live}\"]\n")).unwrap();
    // As in the shell of an operator of the live fleet.
    let environment = [
        ("MUSTER_CONNECT", live.as_str()),
        ("MUSTER_LISTEN", &live),
        ("MUSTER_FLEET", "alpha"),
        ("MUSTER_MODE", "peer"),
        ("MUSTER_CLUSTERER", "{\"teams\": 5}"),
        ("MUSTER_ZENOH_CONFIG", zenoh.to_str().unwrap()),
        ("MUSTER_CONFIG", file.to_str().unwrap()),
    ];
    let start = || Process::start("muster", &["demo"], &environment, folder.path()).unwrap();
    let mut first = start();
    let endpoint = until_complete(&mut first);
    let mut second = start();
    let other = until_complete(&mut second);
    assert!(endpoint != other && endpoint != live && other != live, "{endpoint} {other} {live}");
    assert!(second.output().contains(&format!("--fleet demo --connect {other}")));
    let live = Client::connect(&live, "alpha").await.unwrap();
    let tokens = live.session().liveliness().get("muster/v1/**").await.unwrap();
    let mut found = Vec::new();
    while let Ok(reply) = tokens.recv_async().await {
        found.extend(reply.result().map(|token| token.key_expr().to_string()));
    }
    assert_eq!(found, Vec::<String>::new(), "the live fleet has robots of a demo");
    // A process on the router of one demo sees six services, not twelve.
    for endpoint in [&endpoint, &other] {
        let status = ["status", "--json", "--fleet", "demo", "--connect", endpoint];
        let (code, out, err) = run("muster", &status, Duration::from_secs(20)).unwrap();
        assert_eq!(code, Some(0), "{err}");
        let status: Value = serde_json::from_str(&out).unwrap();
        assert_eq!(status["services"].as_array().unwrap().len(), 6, "{status}");
    }
}
