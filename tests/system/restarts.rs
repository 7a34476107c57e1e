//! Services and routers that die, and come back.

use std::time::{Duration, Instant};

use muster_tests::BUSY;
use muster_tests::client::{Client, Division, Watch, division, is_event_of_robots};
use muster_tests::cluster::{Cluster, SERVICES, start_router};
use muster_tests::ports::free_endpoint;
use muster_tests::process::{Process, run};
use serde_json::{Value, json};

use crate::pipeline::{FORMED_WITHIN, formed, truth};

/// What is promised after a service was started again, on a busy machine.
const RECOVERED_WITHIN: Duration = Duration::from_secs(5 * BUSY);

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "3", "--robots", "15"];

/// Waits for fresh teams (data of a service started after `since`) with the same members and ids.
async fn same_again(teams: &Watch, wanted: &Division, fresh: impl Fn(&Value) -> bool) -> Duration {
    let start = Instant::now();
    teams
        .until("the same teams from fresh data", RECOVERED_WITHIN, |value| {
            fresh(value) && division(value) == *wanted
        })
        .await
        .unwrap();
    start.elapsed()
}

pub(crate) fn stage(value: &Value, name: &str) -> f64 {
    let stages = value["stages"].as_array().cloned().unwrap_or_default();
    stages
        .iter()
        .find(|stage| stage["stage"] == name)
        .and_then(|stage| stage["published"].as_f64())
        .unwrap_or_default()
}

pub(crate) fn now() -> f64 {
    std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs_f64()
}

/// Waits until the auditor answers a command that is given these routers.
fn auditor_answers(routers: &str) {
    let arguments = ["status", "--json", "--fleet", "alpha", "--connect", routers];
    let start = Instant::now();
    loop {
        let (code, output, errors) = run("muster", &arguments, Duration::from_secs(20)).unwrap();
        if code == Some(0) && output.contains("auditor") {
            return;
        }
        assert!(start.elapsed() < Duration::from_secs(20), "{code:?} {output} {errors}");
        std::thread::sleep(Duration::from_millis(200));
    }
}

#[test]
fn of_several_routers_any_that_answers_is_used() {
    let folder = tempfile::tempdir().unwrap();
    // The first accepts connections and sends nothing, the second refuses.
    let silent_listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let silent = format!("tcp/{}", silent_listener.local_addr().unwrap());
    let (refusing, alive) = (free_endpoint().unwrap(), free_endpoint().unwrap());
    let routers = [silent, refusing.clone(), alive.clone()].join(",");
    let mut first = start_router(&alive, folder.path()).unwrap();
    let state = folder.path().join("state").to_string_lossy().into_owned();
    let arguments = ["--fleet", "alpha", "--connect", &routers, "--state-directory", &state];
    let _auditor = Process::start("muster-auditor", &arguments, &[], folder.path()).unwrap();
    auditor_answers(&routers);
    let _second = start_router(&refusing, folder.path()).unwrap();
    first.kill().unwrap();
    auditor_answers(&refusing);
}

#[tokio::test(flavor = "multi_thread")]
async fn each_service_dies_alone_and_the_teams_keep_their_ids() {
    let mut cluster =
        Cluster::start_drawn("each_service_dies_alone", &[("clusterer", "teams=3")], &SCENARIO)
            .unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let wanted = formed(&client, &truth(&cluster, &SCENARIO)).await;
    let teams = client.watch("json/teams").await.unwrap();
    let audits = client.watch("json/audit").await.unwrap();
    let robot_teams = client.watch("robot/*/team").await.unwrap();
    for service in SERVICES {
        cluster.service(service).unwrap().kill().unwrap();
        tokio::time::sleep(Duration::from_secs(1)).await;
        // Readers answer with the last division while the service is down, once the router knows that it is:
        // over QUIC, which has no sign of a killed process, after its lease.
        let killed = Instant::now();
        let last = loop {
            let answers = client.get("teams?format=json", None).await.unwrap();
            let last = answers.into_iter().find_map(|(_, answer)| answer.ok());
            if let Some(last) = last {
                break last;
            }
            assert!(killed.elapsed() < RECOVERED_WITHIN, "no reader answers without {service}");
        };
        assert_eq!(division(&last), wanted, "without {service}");

        let since = now();
        cluster.start_service(service).unwrap();
        teams.clear();
        audits.clear();
        let took = if service == "auditor" {
            let start = Instant::now();
            let fresh = |value: &Value| {
                stage(value, "auditor") > since && value["silhouette"]["mean"].is_number()
            };
            audits.until("a fresh audit", RECOVERED_WITHIN, fresh).await.unwrap();
            start.elapsed()
        } else {
            same_again(&teams, &wanted, |value| stage(value, service) > since).await
        };
        eprintln!("{service}: teams from fresh data after {took:?}");
        // No division in between differs.
        for (_, value) in teams.all() {
            assert_eq!(division(&value), wanted, "while {service} came back");
        }
    }
    for (key, value) in robot_teams.all() {
        let robot = value["robot"].as_str().unwrap();
        assert_eq!(value["team"].as_str().map(str::to_owned), wanted[robot], "{key}");
    }
}

/// How soon three or all services that were killed at once have made fresh teams again. Five seconds are promised; a secured
/// bus shows only after two more that a process was killed.
const SEVERAL_RECOVERED_WITHIN: Duration = Duration::from_secs(5 * BUSY + 2);

#[tokio::test(flavor = "multi_thread")]
async fn three_or_all_services_die_at_once_and_the_teams_keep_their_ids() {
    let settings = [("clusterer", "teams=3"), ("ingest", "tick_hz=50")];
    let mut cluster = Cluster::start_drawn("three_services_die", &settings, &SCENARIO).unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let wanted = formed(&client, &truth(&cluster, &SCENARIO)).await;
    // After some hundred frames an `ingest` is known as one that has lived on.
    let has_run = |status: &Value| status["revision"]["epoch"].as_u64() > Some(310);
    client.until("service/ingest/status", Duration::from_secs(60), has_run).await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    for survivor in SERVICES.map(Some).into_iter().chain([None]) {
        let dies = |name: &&str| survivor != Some(*name);
        let killed: Vec<&str> = SERVICES.into_iter().filter(dies).collect();
        for service in &killed {
            cluster.service(service).unwrap().kill().unwrap();
        }
        let since = now();
        for service in &killed {
            cluster.start_service(service).unwrap();
        }
        teams.clear();
        let fresh = |value: &Value| {
            ["ingest", "embedder", "clusterer"].iter().all(|name| stage(value, name) > since)
                && division(value) == wanted
        };
        teams.until("fresh teams", SEVERAL_RECOVERED_WITHIN, fresh).await.unwrap();
        let survivor = survivor.unwrap_or("none");
        eprintln!("all but {survivor} killed: fresh teams after {:.1} s", now() - since);
        tokio::time::sleep(Duration::from_secs(2)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn terms_rise_with_each_restart() {
    let scenario = ["--scenario", "clusters", "--robots", "6"];
    let mut cluster =
        Cluster::start_drawn("terms_rise", &[("clusterer", "teams=2")], &scenario).unwrap();
    let _robots = cluster.robots(&scenario).unwrap();
    let client = cluster.client().await.unwrap();
    let wanted = formed(&client, &truth(&cluster, &scenario)).await;
    let teams = client.watch("json/teams").await.unwrap();
    let mut last = (0, 0);
    for round in 0..3 {
        // The state of the service is lost as well: the bus remembers the term.
        std::fs::remove_dir_all(cluster.folder().join("state")).unwrap();
        cluster.service("clusterer").unwrap().kill().unwrap();
        cluster.start_service("clusterer").unwrap();
        let since = now();
        same_again(&teams, &wanted, |value| stage(value, "clusterer") > since).await;
        assert!(teams.newest().unwrap()["term"].as_u64() > Some(round + 1));
    }
    for (_, value) in teams.all() {
        let place = (value["term"].as_u64().unwrap(), value["epoch"].as_u64().unwrap());
        assert!(place > last, "{place:?} after {last:?}");
        last = place;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn teams_survive_the_death_of_a_router() {
    let mut cluster =
        Cluster::start_drawn("the_death_of_a_router", &[("clusterer", "teams=3")], &SCENARIO)
            .unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let wanted = formed(&client, &truth(&cluster, &SCENARIO)).await;
    let events = client.watch("json/event").await.unwrap();
    cluster.kill_router().unwrap();
    tokio::time::sleep(Duration::from_secs(4)).await;
    cluster.restart_router().unwrap();
    let fresh = cluster.client().await.unwrap();
    let teams = fresh.watch("json/teams").await.unwrap();
    let since = now();
    let start = Instant::now();
    teams
        .until("teams from fresh data", Duration::from_secs(10), |value| {
            ["ingest", "embedder", "clusterer"].iter().all(|name| stage(value, name) > since)
        })
        .await
        .unwrap();
    eprintln!("teams from fresh data {:?} after the router came back", start.elapsed());
    for (_, value) in teams.all() {
        assert_eq!(division(&value), wanted);
    }
    for (_, event) in events.all() {
        assert!(!is_event_of_robots(&event, "robot_left"), "{event}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn teams_survive_the_reboot_of_a_base_station() {
    for service in ["ingest", "clusterer"] {
        let name = format!("the_reboot_of_a_base_station, {service}");
        let mut cluster =
            Cluster::start_drawn(&name, &[("clusterer", "teams=3")], &SCENARIO).unwrap();
        let _robots = cluster.robots(&SCENARIO).unwrap();
        let client = cluster.client().await.unwrap();
        let wanted = formed(&client, &truth(&cluster, &SCENARIO)).await;
        tokio::time::sleep(Duration::from_secs(1)).await;
        cluster.kill_router().unwrap();
        cluster.service(service).unwrap().kill().unwrap();
        tokio::time::sleep(Duration::from_secs(3)).await;
        cluster.restart_router().unwrap();
        cluster.start_service(service).unwrap();
        let fresh = cluster.client().await.unwrap();
        let teams = fresh.watch("json/teams").await.unwrap();
        let since = now();
        teams
            .until("teams from fresh data", Duration::from_secs(15), |value| {
                ["ingest", "embedder", "clusterer"].iter().all(|name| stage(value, name) > since)
            })
            .await
            .unwrap();
        for (_, value) in teams.all() {
            assert_eq!(division(&value), wanted, "router and {service}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn services_wait_for_their_router_and_say_so() {
    let folder = tempfile::tempdir().unwrap();
    let endpoint = free_endpoint().unwrap();
    let arguments = ["--connect", endpoint.as_str(), "--state-directory", "none"];
    let mut service = Process::start("muster-ingest", &arguments, &[], folder.path()).unwrap();
    service.until_prints("muster router", Duration::from_secs(10)).unwrap();
    assert!(service.is_running().unwrap());
    let _router = start_router(&endpoint, folder.path()).unwrap();
    let client = Client::connect(&endpoint, "default").await.unwrap();
    client.until("service/ingest/status", Duration::from_secs(10), |_| true).await.unwrap();
}

/// The edges of each graph, once it has as many as wanted.
async fn edges(client: &Client, wanted: &[(&str, usize)]) -> Vec<Value> {
    let mut all = Vec::new();
    for (modality, count) in wanted {
        let tail = format!("graph/{modality}?format=json");
        let right = |graph: &Value| graph["edges"].as_array().map(Vec::len) == Some(*count);
        let graph = client.until(&tail, FORMED_WITHIN, right).await.unwrap();
        all.push(graph["edges"].clone());
    }
    all
}

#[tokio::test(flavor = "multi_thread")]
async fn reports_put_once_survive_the_death_of_ingest() {
    let mut cluster = Cluster::start(
        "alpha",
        &[("ingest", "modalities=[\"thermal\"]"), ("clusterer", "teams=2")],
    )
    .unwrap();
    let client = cluster.client().await.unwrap();
    edges(&client, &[("thermal", 0)]).await;
    let posing = client.clone();
    let poses = tokio::spawn(async move {
        loop {
            for (robot, x) in [("r1", 0.0), ("r2", 5.0), ("r3", 90.0), ("r4", 95.0)] {
                let pose = json!({"x": x, "y": 0.0});
                posing.put(&format!("robot/{robot}/pose"), &pose).await.unwrap();
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    });
    let once = [
        ("robot/r2/rank", json!({"superior": "r1", "weight": 0.5})),
        ("robot/r4/rank", json!({"superior": "r3"})),
        ("robot/r1/links", json!({"links": [{"peer": "r2", "quality": 0.75}]})),
        ("robot/r3/relation/thermal", json!({"edges": [["r3", "r4", 2.0]]})),
    ];
    for (key, value) in once {
        client.put(key, &value).await.unwrap();
    }
    let wanted = [("hierarchy", 2), ("connectivity", 1), ("thermal", 1)];
    let before = edges(&client, &wanted).await;
    assert_eq!(before[0], json!([["r1", "r2", 0.5], ["r3", "r4", 1.0]]));
    assert_eq!(before[1], json!([["r2", "r1", 0.75]]));
    // Readers must have received it before `ingest` can fetch it from them.
    tokio::time::sleep(Duration::from_secs(1)).await;
    cluster.service("ingest").unwrap().kill().unwrap();
    tokio::time::sleep(Duration::from_secs(1)).await;
    cluster.start_service("ingest").unwrap();
    let is_back = |status: &Value| status["revision"]["term"].as_u64() >= Some(2);
    client.until("service/ingest/status", RECOVERED_WITHIN, is_back).await.unwrap();
    assert_eq!(edges(&client, &wanted).await, before);
    poses.abort();
}
