//! The demo: one command, everything real.

use std::collections::BTreeSet;
use std::time::Duration;

use muster_tests::cluster::free_endpoint;
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
    let teams = ["teams", "--json", "--connect", &endpoint];
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
    ] {
        let (code, _, err) = run("muster", &arguments, Duration::from_secs(10)).unwrap();
        assert_eq!(code, Some(2), "{arguments:?}: {err}");
    }
}
