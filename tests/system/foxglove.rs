//! The live fleet for Foxglove, over a real router, with real services, simulated robots and a client of others.

use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use muster_tests::access::{OPERATOR, VIEWER};
use muster_tests::client::{Client, Watch};
use muster_tests::cluster::{Cluster, robots_of};
use muster_tests::ports::{free_address, free_endpoint};
use muster_tests::process::{Process, run};
use serde_json::{Value, json};

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "3", "--robots", "12"];

/// How long a program may take to serve.
const SERVES_WITHIN: Duration = Duration::from_secs(20);

/// What a fleet of robots without relations of its own offers.
const TOPICS: &str =
    "/events,/links/connectivity,/links/hierarchy,/links/spatial,/quality,/teams,/tf";

fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

/// Where the packages of `services/console/tests/package.json` are.
fn packages() -> PathBuf {
    let packages = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/web/node_modules");
    assert!(
        packages.join("@foxglove/ws-protocol").exists(),
        "@foxglove/ws-protocol is missing: tests/run installs it, or `npm install --prefix target/web` of \
         services/console/tests/package.json"
    );
    packages
}

fn node(script: &str, arguments: &[&str]) -> Command {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../services/foxglove/tests");
    let mut node = Command::new("node");
    node.arg(folder.join(script)).args(arguments).env("MUSTER_WEB_PACKAGES", packages());
    node
}

fn start_foxglove(cluster: &Cluster, identity: &str, address: &str, further: &[&str]) -> Process {
    let flags = cluster.flags_of(identity);
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    let arguments = [&flags, &["--serve", address][..], further].concat();
    let mut program = Process::start("muster-foxglove", &arguments, &[], cluster.folder()).unwrap();
    program.until_prints("serves viewers at", SERVES_WITHIN).unwrap();
    program
}

/// Where each robot has said that it is, by name.
fn poses(watch: &Watch) -> Value {
    let mut all: BTreeMap<String, Vec<Value>> = BTreeMap::new();
    for (key, pose) in watch.all() {
        let robot = key.rsplit('/').nth(1).unwrap().to_owned();
        let at = json!([pose["x"], pose["y"], pose.get("z").cloned().unwrap_or(json!(0.0))]);
        let at = if at[2].is_null() { json!([pose["x"], pose["y"], 0.0]) } else { at };
        all.entry(robot).or_default().push(at);
    }
    json!(all)
}

fn teams(client: &Watch) -> Value {
    let teams = client.newest().unwrap();
    let team = |team: &Value| json!({"id": team["id"], "members": list(&team["members"]).len()});
    list(&teams["teams"]).iter().map(team).collect()
}

/// Kilobytes of memory that a process has.
fn resident_kb(process: &Process) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", process.id())).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.split_whitespace().next().unwrap().parse().unwrap()
}

/// A viewer that reads nothing any more.
fn stall(address: &str) -> std::process::Child {
    let mut viewer = node("stalled.mjs", &[address]).stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(viewer.stdout.take().unwrap()).lines();
    assert_eq!(lines.next().unwrap().unwrap(), "follows");
    let stopped = Command::new("kill").args(["-STOP", &viewer.id().to_string()]).status().unwrap();
    assert!(stopped.success());
    viewer
}

async fn settings(client: &Client, service: &str) -> Value {
    client.get_one(&format!("service/{service}/settings")).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn foxglove_shows_and_changes_a_fleet_in_a_client_of_others() {
    let flags = [("clusterer", "teams=3"), ("ingest", "gone_after_s=4")];
    let mut cluster = Cluster::start_drawn("foxglove_shows_a_fleet", &flags, &SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let put = client.watch("robot/*/pose").await.unwrap();
    let divisions = client.watch("json/teams").await.unwrap();
    let names: Vec<String> = robots_of(&SCENARIO).unwrap().into_keys().collect();
    let (last, others) = names.split_last().unwrap();
    let mut lonely = cluster.robots(&[&SCENARIO[..], &["--only", last]].concat()).unwrap();
    let others = others.join(",");
    let _others = cluster.robots(&[&SCENARIO[..], &["--only", &others]].concat()).unwrap();
    let three = |value: &Value| list(&value["teams"]).len() == 3;
    divisions.until("three teams", SERVES_WITHIN, three).await.unwrap();

    let (address, read_only) = (free_address().unwrap(), free_address().unwrap());
    let served = start_foxglove(&cluster, OPERATOR, &address, &["--allow-changes"]);
    let _guests = start_foxglove(&cluster, VIEWER, &read_only, &[]);
    let mut stalled = None;
    let mut viewer = node("viewer.mjs", &[&address, &read_only, TOPICS])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut answers = viewer.stdin.take().unwrap();
    let mut held = false;
    for line in BufReader::new(viewer.stdout.take().unwrap()).lines() {
        let line = line.unwrap();
        println!("{line}");
        held |= line == "everything holds";
        let Some(what) = line.strip_prefix("do ") else { continue };
        let what: Vec<String> = serde_json::from_str(what).unwrap();
        let what: Vec<&str> = what.iter().map(String::as_str).collect();
        let answer = match *what {
            ["poses"] => poses(&put),
            ["teams"] => teams(&divisions),
            // Any command is an event.
            ["event", number] => {
                let change = format!("good=0.4{number}");
                let (code, _, err) = cluster.muster(&["set", "auditor", &change]).unwrap();
                assert_eq!(code, Some(0), "{err}");
                Value::Null
            }
            ["settings", service] => settings(&client, service).await,
            ["muster", ref arguments @ ..] => {
                let (code, _, err) = cluster.muster(arguments).unwrap();
                assert_eq!(code, Some(0), "{err}");
                Value::Null
            }
            ["stall"] => {
                stalled = Some(stall(&address));
                Value::Null
            }
            ["kill-robot"] => {
                lonely.kill().unwrap();
                json!(last)
            }
            ["kill-router"] => {
                cluster.kill_router().unwrap();
                Value::Null
            }
            ["start-router"] => {
                cluster.restart_router().unwrap();
                Value::Null
            }
            _ => panic!("unknown: {what:?}"),
        };
        writeln!(answers, "{answer}").unwrap();
    }
    let status = viewer.wait().unwrap();
    println!("memory with a stopped viewer: {} kB", resident_kb(&served));
    if let Some(mut stalled) = stalled {
        stalled.kill().unwrap();
        stalled.wait().unwrap();
    }
    assert!(status.success() && held, "{status}");
}

#[test]
fn foxglove_refuses_what_is_unsafe_at_the_start() {
    let within = Duration::from_secs(20);
    let far = ["--serve", "0.0.0.0:0", "--allow-changes"];
    let (code, _, err) = run("muster-foxglove", &far, within).unwrap();
    assert_eq!(code, Some(2), "{err}");
    assert!(err.contains("allow_changes: ") && err.contains("ssh -L"), "{err}");
    let print = ["--print-config", "--fleet", "alpha"];
    let (code, out, err) = run("muster-foxglove", &print, within).unwrap();
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("# serves 127.0.0.1:8765 for viewers who may only look"), "{out}");
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let (code, _, err) = run("muster-foxglove", &["--serve", &address], within).unwrap();
    assert_eq!(code, Some(1), "{err}");
    assert!(err.contains("cannot listen at"), "{err}");
}

/// The processes that a process has started, by `/proc`.
fn children(parent: u32) -> Vec<u32> {
    let all = std::fs::read_dir("/proc")
        .unwrap()
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok()?.parse().ok());
    let parent_of = |id: &u32| {
        let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
        // The name stands in brackets, and may hold anything; the state and the parent follow.
        stat.rsplit_once(')')?.1.split_whitespace().nth(1)?.parse::<u32>().ok()
    };
    all.filter(|id| parent_of(id) == Some(parent)).collect()
}

#[test]
fn foxglove_comes_along_with_up_if_it_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let (endpoint, address) = (free_endpoint().unwrap(), free_address().unwrap());
    let up = ["up", "--router", "--listen", &endpoint, "--state-directory", "none", "--no-console"];
    let with = [&up[..], &["--with", "foxglove"]].concat();
    let environment = [("MUSTER_FOXGLOVE_SERVE", address.as_str())];
    let mut up = Process::start("muster", &with, &environment, folder.path()).unwrap();
    up.until_prints(&format!("serves viewers at ws://{address}"), SERVES_WITHIN).unwrap();
    assert!(std::net::TcpStream::connect(&address).is_ok());
    // Once it has run for some seconds, its end is not that of the services: it is started again.
    std::thread::sleep(Duration::from_secs(5));
    let child = children(up.id())[0].to_string();
    assert!(Command::new("kill").args(["-KILL", &child]).status().unwrap().success());
    up.until_prints("muster-foxglove ended by itself: signal: 9", SERVES_WITHIN).unwrap();
    let begin = Instant::now();
    while std::net::TcpStream::connect(&address).is_err() {
        assert!(begin.elapsed() < SERVES_WITHIN, "{}", up.output());
        std::thread::sleep(Duration::from_millis(100));
    }
    // It ends with the services.
    up.signal("TERM").unwrap();
    assert!(up.wait(Duration::from_secs(10)).unwrap().success());
    assert!(std::net::TcpStream::connect(&address).is_err(), "it runs on");

    // One that cannot serve ends the others, and says why.
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let environment = [("MUSTER_FOXGLOVE_SERVE", address.as_str())];
    let mut up = Process::start("muster", &with, &environment, folder.path()).unwrap();
    assert_eq!(up.wait(SERVES_WITHIN).unwrap().code(), Some(1));
    assert!(up.output().contains("muster-foxglove ended by itself"), "{}", up.output());

    // A build without it says how to make it.
    let alone = folder.path().join("muster");
    std::fs::copy(muster_tests::process::program("muster").unwrap(), &alone).unwrap();
    let output = Command::new(&alone).args(&with).env("PATH", "/nowhere").output().unwrap();
    let err = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{err}");
    assert!(err.contains("cargo build --release --package muster-foxglove"), "{err}");
}
