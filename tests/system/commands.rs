//! What the commands of an operator say where services hang, end or cannot store, and where the link is lost.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use muster_model::header::Revision;
use muster_model::id::{FleetId, InstanceId, ServiceName};
use muster_model::role::ReplicaState;
use muster_model::status::ServiceStatus;
use muster_model::time::Tick;
use muster_tests::SOON;
use muster_tests::client::{Client, division};
use muster_tests::cluster::{Cluster, ClusterOptions, SERVICES};
use muster_tests::process::Process;
use serde_json::{Value, json};

use crate::pipeline::{formed, groups, truth};

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "3", "--robots", "12"];
/// How long a slow disk takes: longer than a reply is waited for, and shorter than two of them.
const STORES_WITHIN: Duration = Duration::from_secs(4);
/// A program that waits for a service says within this that none answers.
const GIVES_UP: Duration = Duration::from_secs(20);

/// Starts a command that goes on while a test does something else.
fn begin(cluster: &Cluster, arguments: &[&str]) -> Process {
    let flags = cluster.flags_of("operator.operator");
    let flags = flags.iter().map(String::as_str);
    let all: Vec<&str> = arguments.iter().copied().chain(flags).collect();
    Process::start("muster", &all, &[], cluster.folder()).unwrap()
}

async fn setting(client: &Client, name: &str) -> Value {
    client.get_one("service/clusterer/settings").await.unwrap()[name].clone()
}

/// Answers for the status of a clusterer that leads, and to commands only after so long, as one whose disk is slow: the
/// command that came again is answered with the others.
async fn lead_slowly(client: &Client) {
    let status = ServiceStatus {
        fleet: FleetId::new("alpha").unwrap(),
        service: ServiceName::Clusterer,
        instance: InstanceId::new("slow").unwrap(),
        version: String::new(),
        started: Tick(0),
        now: Tick(0),
        standing: ReplicaState::Leading,
        revision: Revision::default(),
        state: String::new(),
        counters: BTreeMap::new(),
        departed: Vec::new(),
    };
    let status = serde_json::to_vec(&status).unwrap();
    let outcome = json!({"answer": {"teams": 3}}).to_string().into_bytes();
    for (key, answer, takes) in [
        ("service/clusterer/status", status, Duration::ZERO),
        ("command/clusterer/**", outcome, STORES_WITHIN),
    ] {
        let gets = client.session().declare_queryable(client.key(key)).await.unwrap();
        tokio::spawn(async move {
            let mut first = None;
            while let Ok(get) = gets.recv_async().await {
                let answer = answer.clone();
                let at = *first.get_or_insert_with(Instant::now) + takes;
                tokio::spawn(async move {
                    tokio::time::sleep_until(at.into()).await;
                    let _ = get.reply(get.key_expr().clone(), answer).await;
                });
            }
        });
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_outlasts_a_slow_disk() {
    let cluster = Cluster::start_without_services(&ClusterOptions::default()).unwrap();
    let client = cluster.client().await.unwrap();
    lead_slowly(&client).await;
    let (code, out, err) = cluster.muster(&["set", "clusterer", "teams=3", "--json"]).unwrap();
    assert!(code == Some(0) && out.contains("\"teams\":3"), "{code:?}: {out}{err}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_change_that_is_stopped_before_its_answer_is_no_success() {
    let cluster = Cluster::start_without_services(&ClusterOptions::default()).unwrap();
    for arguments in [&["set", "clusterer", "teams=4"][..], &["wish", "reserve", "r1"]] {
        let client = cluster.client().await.unwrap();
        lead_slowly(&client).await;
        let mut command = begin(&cluster, arguments);
        tokio::time::sleep(STORES_WITHIN / 4).await;
        command.signal("INT").unwrap();
        let ended = command.wait(SOON).unwrap().code();
        assert_eq!(ended, Some(1), "{arguments:?}: {}", command.output());
        let said = command.output();
        assert!(said.contains("stopped before the answer came: it may be done or not"), "{said}");
    }
}

/// Lets no service store anything: its folder is no folder any more. Returns where it is meanwhile.
fn break_disk(cluster: &Cluster) -> [PathBuf; 2] {
    let folder = cluster.folder().join("state").join(&cluster.fleet);
    let aside = cluster.folder().join("aside");
    std::fs::rename(&folder, &aside).unwrap();
    std::fs::write(&folder, "no folder").unwrap();
    [folder, aside]
}

#[tokio::test(flavor = "multi_thread")]
async fn what_holds_and_is_not_stored_is_not_called_refused() {
    let mut cluster = Cluster::start("alpha", &[("clusterer", "teams=3")]).unwrap();
    cluster.start_service("planner").unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let watch = client.watch("json/teams").await.unwrap();
    let live = formed(&client, &truth(&cluster, &SCENARIO)).await;
    let robot = live.keys().next().unwrap().clone();
    let asked = ["propose", "--teams", "2", "--without", &robot, "--id", "less", "--wait", "20"];
    let (code, _, err) = cluster.muster(&asked).unwrap();
    assert_eq!(code, Some(0), "{err}");

    let [folder, aside] = break_disk(&cluster);
    let unstored = "and a restart of it may forget that";
    let (code, _, err) = cluster.muster(&["set", "clusterer", "restarts=7"]).unwrap();
    assert!(code == Some(1) && err.contains(unstored), "{code:?}: {err}");
    assert_eq!(setting(&client, "restarts").await, 7);
    let other = live.keys().nth(1).unwrap();
    let (code, _, err) = cluster.muster(&["wish", "reserve", other, "--id", "spare"]).unwrap();
    assert!(code == Some(1) && err.contains(unstored), "{code:?}: {err}");

    // The proposal is applied, both parts of it.
    let (code, _, err) = cluster.muster(&["propose", "accept", "less"]).unwrap();
    assert!(code == Some(1) && err.contains(unstored), "{code:?}: {err}");
    assert!(!err.contains("not applied"), "{err}");
    let applied = |value: &Value| {
        let division = division(value);
        let is_out = |robot: &String| division.get(robot) == Some(&None);
        let teams = division.clone().into_iter().filter(|(_, team)| team.is_some());
        is_out(&robot) && is_out(other) && groups(teams).len() == 2
    };
    watch.until("two teams without two robots", SOON, applied).await.unwrap();
    assert_eq!(setting(&client, "teams").await, 2);
    let (_, out, _) = cluster.muster(&["wish", "list"]).unwrap();
    assert!(out.contains("propose-less") && out.contains("spare"), "{out}");

    // Once the disk works, all is stored, and the same wish is confirmed.
    std::fs::remove_file(&folder).unwrap();
    std::fs::rename(&aside, &folder).unwrap();
    let start = Instant::now();
    loop {
        let again = cluster.muster(&["wish", "reserve", other, "--id", "spare"]).unwrap();
        if again.0 == Some(0) {
            break;
        }
        assert!(start.elapsed() < GIVES_UP, "{again:?}");
    }
    cluster.service("clusterer").unwrap().kill().unwrap();
    cluster.start_service("clusterer").unwrap();
    watch.clear();
    watch.until("the same after a restart", GIVES_UP, applied).await.unwrap();
    assert_eq!(setting(&client, "restarts").await, 7);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_shown_of_a_fleet_without_services_is_called_old() {
    let mut cluster = Cluster::start("alpha", &[("clusterer", "teams=3")]).unwrap();
    let (code, out, err) = cluster.muster(&["propose", "list"]).unwrap();
    assert!(code == Some(3) && err.contains("no answer for propose/"), "{out}{err}");
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    formed(&client, &truth(&cluster, &SCENARIO)).await;
    let (code, out, err) = cluster.muster(&["wish", "list"]).unwrap();
    assert!(code == Some(0) && out.contains("there are no wishes"), "{out}{err}");
    let (code, _, err) = cluster.muster(&["graph"]).unwrap();
    assert!(code == Some(0) && err.is_empty(), "{err}");

    // Whoever has received graphs answers for ingest.
    let mut graphs = begin(&cluster, &["graph", "--watch"]);
    graphs.until_prints("spatial", SOON).unwrap();
    cluster.service("ingest").unwrap().kill().unwrap();
    graphs.until_prints("STALE", GIVES_UP).unwrap();
    let (code, out, err) = cluster.muster(&["graph"]).unwrap();
    assert!(code == Some(0) && out.contains("spatial"), "{out}{err}");
    assert!(err.contains("ingest does not answer"), "{err}");

    // A link over which nothing comes counts as lost after some seconds only.
    let mut status = begin(&cluster, &["status", "--watch", "--json"]);
    status.until_prints("\n", SOON).unwrap();
    cluster.router().signal("STOP").unwrap();
    status.until_prints("STALE", GIVES_UP).unwrap();
    cluster.router().signal("CONT").unwrap();
    let lines = status.output();
    let shown = lines.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    let counts: Vec<_> = shown.map(|one| one["services"].as_array().map_or(0, Vec::len)).collect();
    assert!(!counts.is_empty() && !counts.contains(&0), "{counts:?}");

    for service in SERVICES {
        cluster.service(service).unwrap().kill().unwrap();
    }
    let (code, out, err) = cluster.muster(&["wish", "list"]).unwrap();
    assert!(code == Some(3) && out.is_empty() && err.contains("no answer for"), "{out}{err}");
}
