//! Robots and consoles of ROS 2 that are none of ours, at a fleet by `muster-ros2`.
//!
//! Both are programs of `zenoh-ros2-sdk` (`tests/peers/ros_peer.py`), which writes its messages by `rosbags`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::{Duration, Instant};

use muster_tests::SOON;
use muster_tests::access::{BRIDGE, Security};
use muster_tests::client::{Client, division, is_event_of_robots, robots_of_event};
use muster_tests::cluster::{Cluster, ClusterOptions};
use muster_tests::process::{Process, python, run};
use serde_json::Value;

/// Two pairs of robots, far apart, in the frame `map`.
const PAIRS: [&str; 4] = ["r1:0:0", "r2:2:1", "s1:40:0", "s2:41:2"];

/// A cluster, and a bridge at it.
struct Fleet {
    cluster: Cluster,
    bridge: Process,
}

impl Fleet {
    fn start(topics: &str) -> Self {
        let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
        let bridge = start_bridge(&cluster, topics);
        Self { cluster, bridge }
    }

    fn peer(&self, what: &str, rest: &[&str]) -> Process {
        start_peer(self.cluster.folder(), &self.cluster.endpoint, what, rest)
    }
}

/// Starts a program of ROS at a router.
fn start_peer(folder: &Path, endpoint: &str, what: &str, rest: &[&str]) -> Process {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap();
    let script = root.join("tests/peers/ros_peer.py");
    let port = endpoint.rsplit(':').next().unwrap();
    let arguments = [&[script.to_str().unwrap(), what, port], rest].concat();
    Process::start_at(&python().unwrap(), what, &arguments, &[], folder).unwrap()
}

fn start_bridge(cluster: &Cluster, topics: &str) -> Process {
    let path = cluster.folder().join("ros2.toml");
    std::fs::write(&path, topics).unwrap();
    let mut arguments = vec![
        "--connect",
        &cluster.endpoint,
        "--fleet",
        &cluster.fleet,
        "--topics",
        path.to_str().unwrap(),
    ];
    let identity = cluster.identity(BRIDGE);
    if let Some(identity) = &identity {
        arguments.extend(["--zenoh-config", identity.to_str().unwrap()]);
    }
    Process::start("muster-ros2", &arguments, &[], cluster.folder()).unwrap()
}

/// Whether the pairs are two teams, and no other robot is there.
fn are_pairs(teams: &Value) -> bool {
    let division = division(teams);
    division.len() == 4
        && division["r1"].is_some()
        && division["r1"] == division["r2"]
        && division["s1"] == division["s2"]
        && division["r1"] != division["s1"]
}

/// Where the robots are, in the newest roster.
async fn positions(cluster: &Cluster) -> BTreeMap<String, [f64; 2]> {
    let client = cluster.client().await.unwrap();
    let roster = client.get_one("roster?format=json").await.unwrap();
    let robots = roster["robots"].as_array().unwrap().iter();
    robots
        .filter_map(|robot| {
            let at = robot["position"].as_array()?;
            let name = robot["robot"].as_str()?.to_owned();
            Some((name, [at[0].as_f64()?, at[1].as_f64()?]))
        })
        .collect()
}

fn is_near(at: [f64; 2], wanted: [f64; 2]) -> bool {
    (at[0] - wanted[0]).hypot(at[1] - wanted[1]) < 1e-6
}

/// The pairs are where the peer put them: the frame odom of each is turned and far away, so that the positions would be others
/// as they are.
async fn pairs_stand_where_they_are(cluster: &Cluster) {
    let positions = positions(cluster).await;
    for pair in PAIRS {
        let parts: Vec<&str> = pair.split(':').collect();
        let wanted = [parts[1], parts[2]].map(|number| number.parse().unwrap());
        assert!(is_near(positions[parts[0]], wanted), "{pair}: {positions:?}");
    }
}

/// Waits until a peer has printed a line of JSON that is right.
async fn printed(peer: &mut Process, what: &str, right: impl Fn(&Value) -> bool) -> Value {
    let start = Instant::now();
    loop {
        let output = peer.output();
        let values = output.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        let found = values.filter(|value| value["what"] == what || what.is_empty()).find(&right);
        if let Some(value) = found {
            return value;
        }
        assert!(peer.is_running().unwrap() || what.is_empty(), "{what}: it has ended:\n{output}");
        assert!(start.elapsed() < SOON, "{what}: it has printed only\n{output}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_of_ros_are_divided_where_they_are_and_a_console_of_ros_sees_it() {
    // The machine may be so busy that a robot's transforms come seconds after each other.
    let fleet = Fleet::start("[frames]\nmax_age_s = 10.0\n");
    let client = fleet.cluster.client().await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let mut console = fleet.peer("console", &["r1", "s1"]);
    let mut robots = fleet.peer("robots", &PAIRS);
    let formed = teams.until("two teams of robots of ROS", SOON, are_pairs).await.unwrap();

    pairs_stand_where_they_are(&fleet.cluster).await;

    // A console of ROS sees the division, the team of each robot, the diagnostics and the markers.
    let placed = division(&formed);
    let team_of = |robot: &str| placed[robot].clone().unwrap();
    printed(&mut console, "teams", |value| {
        serde_json::from_str(value["text"].as_str().unwrap()).is_ok_and(|teams| are_pairs(&teams))
    })
    .await;
    for robot in ["r1", "s1"] {
        printed(&mut console, "team", |value| {
            let text: Value = serde_json::from_str(value["text"].as_str().unwrap()).unwrap();
            value["robot"] == robot && text["team"] == team_of(robot).as_str()
        })
        .await;
    }
    let named = |robot: &str| format!("muster: team {}", team_of(robot));
    printed(&mut console, "diagnostics", |value| {
        let statuses = &value["statuses"];
        ["r1", "s1"].iter().all(|robot| statuses[named(robot)][0] == 0)
            && statuses["muster: topics"][0] == 0
    })
    .await;
    printed(&mut console, "markers", |value| {
        let count = |team: &Value| team.as_array().unwrap().len();
        let points = value["points"].as_array().unwrap();
        value["frame"] == "map" && points.len() == 2 && points.iter().all(|team| count(team) == 2)
    })
    .await;

    // Its tools see the node and its topics.
    let mut graph = fleet.peer("graph", &[]);
    let graph = printed(&mut graph, "", |value| value["nodes"].is_array()).await;
    assert!(graph["nodes"].as_array().unwrap().contains(&Value::from("muster")), "{graph}");
    let publishers = |topic: &str| graph["publishers"][topic].clone();
    let string = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
    assert_eq!(
        publishers("/muster/teams"),
        serde_json::json!([["muster", "std_msgs/msg/String", string, "::,10:,:,:,,"]])
    );
    assert_eq!(publishers("/r1/team")[0][0], "muster", "{graph}");
    assert_eq!(graph["subscriptions"]["/r1/odom"], serde_json::json!(["muster"]), "{graph}");

    assert!(!fleet.bridge.output().contains("WARN"), "{}", fleet.bridge.output());

    // Robots that restart have other publishers, and are believed at once.
    robots.kill().unwrap();
    let moved = ["r1:0:0", "r2:41:1", "s1:40:0", "s2:2:2"];
    let _robots = fleet.peer("robots", &moved);
    let swapped = |teams: &Value| {
        let division = division(teams);
        division.len() == 4 && division["r1"] == division["s2"] && division["s1"] == division["r2"]
    };
    teams.until("the teams of robots that have moved", SOON, swapped).await.unwrap();

    // A bridge that is killed and started again goes on where it was: what it relays is not refused.
    let client = fleet.cluster.client().await.unwrap();
    let refused = client.watch("robot/*/refused").await.unwrap();
    let mut bridge = fleet.bridge;
    bridge.kill().unwrap();
    let events = client.watch("json/event").await.unwrap();
    let is = |event: &Value, kind: &str| {
        is_event_of_robots(event, kind) && robots_of_event(event).contains(&"r1".to_owned())
    };
    events.until("a silent robot", SOON, |event| is(event, "robot_stale")).await.unwrap();
    let _bridge = start_bridge(&fleet.cluster, "");
    events.until("the robot again", SOON, |event| is(event, "robot_recovered")).await.unwrap();
    assert!(refused.newest().is_none(), "{:?}", refused.newest());
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_of_ros_are_read_at_routers_of_other_versions() {
    for version in ["1.7.2", "1.9.0", "1.10.2"] {
        let cluster = crate::routers::start(version);
        let bridge = start_bridge(&cluster, "");
        let fleet = Fleet { cluster, bridge };
        let client = fleet.cluster.client().await.unwrap();
        let teams = client.watch("json/teams").await.unwrap();
        let mut console = fleet.peer("console", &["r1"]);
        let _robots = fleet.peer("robots", &PAIRS);
        let all = |teams: &Value| {
            let division = division(teams);
            division.len() == 4 && division.values().all(Option::is_some)
        };
        teams.until(&format!("robots at a router of Zenoh {version}"), SOON, all).await.unwrap();
        pairs_stand_where_they_are(&fleet.cluster).await;
        printed(&mut console, "team", |value| value["robot"] == "r1").await;
        let found = doctor_finds(&fleet.cluster.endpoint);
        assert_eq!(found.contains_key("router_old"), version == "1.7.2", "{version}: {found:?}");
        assert!(found.contains_key("ros_unannounced"), "{version}: {found:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_taken_is_refused_with_its_reason() {
    let fleet = Fleet::start("");
    let client = fleet.cluster.client().await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let mut console = fleet.peer("console", &[]);
    let wrong = ["lost:7:7:none", "bare:8:8:bare", "other:9:9:other"];
    let _robots = fleet.peer("robots", &[&PAIRS[..], &wrong].concat());
    teams.until("two teams of robots of ROS", SOON, are_pairs).await.unwrap();
    let reasons = [
        ("0/lost/odom/", "no transforms lead from the frame odom to map"),
        ("0/bare/odom/", "the message has no attachment"),
        ("0/other/odom/", "another definition of nav_msgs/msg/Odometry"),
    ];
    let seen = printed(&mut console, "diagnostics", |value| {
        value["statuses"]["muster: topics"][1] == "3 topics are not taken"
    })
    .await;
    assert_eq!(seen["statuses"]["muster: topics"][0], 1);
    let output = fleet.bridge.output();
    for (topic, reason) in reasons {
        let said = |line: &&str| line.contains(topic) && line.contains(reason);
        assert!(output.lines().any(|line| said(&line)), "{reason}:\n{output}");
    }
    // None of them is in the fleet.
    let there: BTreeSet<_> = positions(&fleet.cluster).await.into_keys().collect();
    assert_eq!(there, BTreeSet::from(["r1", "r2", "s1", "s2"].map(str::to_owned)));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_late_bridge_finds_static_transforms_and_humble_is_read() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let bridge = Process::start("muster", &["--version"], &[], cluster.folder()).unwrap();
    let mut fleet = Fleet { cluster, bridge };
    let client = fleet.cluster.client().await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let robots = ["r1:0:0:static", "r2:2:1:humble", "s1:40:0:static", "s2:41:2:tf"];
    let mut robots = fleet.peer("robots", &robots);
    robots.until_prints("4 robots publish", SOON).unwrap();
    // The transforms and the superiors were put once, and no bridge was there.
    tokio::time::sleep(Duration::from_secs(1)).await;
    let ranks = "[[rank]]\ntopic = \"/{robot}/superior\"\ntype = \"std_msgs/String\"\nsuperior = \"data\"\n";
    fleet.bridge = start_bridge(&fleet.cluster, ranks);
    teams.until("two teams of robots of ROS", SOON, are_pairs).await.unwrap();
    pairs_stand_where_they_are(&fleet.cluster).await;
    let is_led = |roster: &Value, robot: &str, superior: &str| {
        let robots = roster["robots"].as_array().unwrap();
        robots.iter().any(|one| one["robot"] == robot && one["superior"] == superior)
    };
    let led = |roster: &Value| is_led(roster, "r1", "r2") && is_led(roster, "s1", "s2");
    client.until("roster?format=json", SOON, led).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_that_share_a_tree_and_robots_behind_a_bridge_of_dds_are_read() {
    let shared = "frames = { tf = \"/tf\", tf_static = \"/tf_static\" }\n";
    let fleet = Fleet::start(shared);
    let client = fleet.cluster.client().await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let mut robots = fleet.peer("robots", &[&PAIRS[..], &["--shared"]].concat());
    teams.until("two teams with one tree of frames", SOON, are_pairs).await.unwrap();
    pairs_stand_where_they_are(&fleet.cluster).await;
    robots.kill().unwrap();
    drop(fleet);

    let fleet = Fleet::start("dialect = \"ros2dds\"\n");
    let client = fleet.cluster.client().await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let pairs = PAIRS.map(|robot| format!("{robot}:dds"));
    let _robots = fleet.peer("robots", &pairs.each_ref().map(String::as_str));
    teams.until("two teams behind a bridge of DDS", SOON, are_pairs).await.unwrap();
    pairs_stand_where_they_are(&fleet.cluster).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bridge_is_a_member_of_a_secured_fleet_and_robots_of_ros_meet_at_a_router_of_their_own() {
    let settings = [("clusterer", "teams=2")];
    let options = ClusterOptions {
        security: Security::Secured,
        settings: &settings,
        ..ClusterOptions::default()
    };
    let cluster = Cluster::start_by(&options).unwrap();
    let endpoint = muster_tests::ports::free_endpoint().unwrap();
    let arguments = ["router", "--ros", "--listen", &endpoint];
    let mut router = Process::start("muster", &arguments, &[], cluster.folder()).unwrap();
    router.until_prints("router listens at", SOON).unwrap();
    let bridge = start_bridge(&cluster, &format!("connect = [\"{endpoint}\"]\n"));
    let peer = |what: &str, rest: &[&str]| start_peer(cluster.folder(), &endpoint, what, rest);
    let client = cluster.client().await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let mut console = peer("console", &["r1"]);
    let _robots = peer("robots", &[&PAIRS[..], &["lost:7:7:none"]].concat());
    teams.until("two teams of robots of ROS", SOON, are_pairs).await.unwrap();
    pairs_stand_where_they_are(&cluster).await;
    printed(&mut console, "team", |value| value["robot"] == "r1").await;
    // Its answers reach an operator, whose doctor sees nothing of the programs of ROS behind it.
    let start = Instant::now();
    loop {
        let (_, out, err) = cluster.muster(&["doctor", "--json", "--listen-for", "1"]).unwrap();
        let report: Value = serde_json::from_str(&out).unwrap_or_else(|_| panic!("{out}{err}"));
        let findings = report["findings"].as_array().unwrap();
        let has = |id: &str| findings.iter().any(|finding| finding["id"] == id);
        assert!(!has("ros_unannounced") && !has("access_denied"), "{report:#}");
        if has("ros_no_chain") {
            break;
        }
        assert!(start.elapsed() < SOON, "{report:#}{}", bridge.output());
    }
}

/// The findings of the doctor by name: what they concern, what is seen, and what to do.
fn doctor_finds(endpoint: &str) -> BTreeMap<String, (Vec<String>, String)> {
    let arguments =
        ["doctor", "--json", "--fleet", "alpha", "--connect", endpoint, "--listen-for", "1"];
    let (_, out, err) = run("muster", &arguments, SOON).unwrap();
    let report: Value = serde_json::from_str(&out).unwrap_or_else(|_| panic!("{out}{err}"));
    let findings = report["findings"].as_array().unwrap().iter();
    let finding = |finding: &Value| {
        let text = |name: &str| finding[name].as_str().unwrap().to_owned();
        let subjects = finding["subjects"].as_array().unwrap().iter();
        let subjects = subjects.map(|subject| subject.as_str().unwrap().to_owned()).collect();
        (text("id"), (subjects, format!("{} {}", text("seen"), text("remedy"))))
    };
    findings.map(finding).collect()
}

/// Waits until what the doctor finds is right.
async fn until_doctor_finds(
    endpoint: &str,
    right: impl Fn(&BTreeMap<String, (Vec<String>, String)>) -> bool,
) {
    let start = Instant::now();
    loop {
        let found = tokio::task::block_in_place(|| doctor_finds(endpoint));
        if right(&found) {
            return;
        }
        assert!(start.elapsed() < SOON, "{found:#?}");
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_doctor_says_what_does_not_suit_robots_of_ros() {
    let mut cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    cluster.kill_router().unwrap();
    let router = |arguments: &[&str]| {
        let arguments = [&["router", "--listen", &cluster.endpoint], arguments].concat();
        let mut router = Process::start("muster", &arguments, &[], cluster.folder()).unwrap();
        router.until_prints("router listens at", SOON).unwrap();
        router
    };
    let config = cluster.folder().join("router.json5");
    std::fs::write(&config, r#"{"transport": {"link": {"tx": {"lease": 60000}}}}"#).unwrap();
    let mut slow = router(&["--zenoh-config", config.to_str().unwrap()]);
    let bridge = start_bridge(&cluster, "");
    let fleet = Fleet { cluster, bridge };
    let endpoint = fleet.cluster.endpoint.clone();
    // One program of ROS is nothing that could miss another.
    let wrong = ["lost:7:7:none", "bare:8:8:bare", "other:9:9:other"];
    let mut robots = fleet.peer("robots", &[&PAIRS[..], &wrong].concat());
    let expected = [
        ("router_lease", "tcp/", "muster-ros2 goes by the age of their data"),
        ("ros_no_chain", "0/lost/odom/", "from the frame odom to map"),
        ("ros_no_attachment", "0/bare/odom/", "zenoh-bridge-ros2dds"),
        ("ros_type_hash", "0/other/odom/", "`definition`"),
    ];
    until_doctor_finds(&endpoint, |found| {
        let is_found = |(id, subject, text): &(&str, &str, &str)| {
            found.get(*id).is_some_and(|(subjects, said)| {
                subjects.len() == 1 && subjects[0].starts_with(subject) && said.contains(text)
            })
        };
        expected.iter().all(is_found) && !found.contains_key("ros_unannounced")
    })
    .await;
    let mut console = fleet.peer("console", &["r1"]);
    until_doctor_finds(&endpoint, |found| {
        let unannounced = found.get("ros_unannounced");
        unannounced.is_some_and(|(_, said)| said.contains("muster router --ros"))
    })
    .await;

    // With such a router, and robots that are right, nothing of it is left.
    robots.kill().unwrap();
    console.kill().unwrap();
    slow.kill().unwrap();
    let arguments = ["router", "--ros", "--listen", &endpoint];
    let _router = Process::start("muster", &arguments, &[], fleet.cluster.folder()).unwrap();
    let client = fleet.cluster.client().await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let _console = fleet.peer("console", &["r1"]);
    let _robots = fleet.peer("robots", &PAIRS);
    teams.until("two teams of robots of ROS", SOON, are_pairs).await.unwrap();
    until_doctor_finds(&endpoint, |found| {
        let is_of_ros = |id: &String| id.starts_with("ros_") || id.starts_with("router_");
        !found.contains_key("service_silent") && !found.keys().any(is_of_ros)
    })
    .await;
}

/// Whether a program of ROS receives another one's messages through a router, within a while. The doctor says the same of
/// the router.
async fn peers_reach_each_other(command: &[&str]) -> bool {
    let endpoint = muster_tests::ports::free_endpoint().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let arguments = [command, &["--listen", &endpoint]].concat();
    let mut router = Process::start("muster", &arguments, &[], folder.path()).unwrap();
    router.until_prints("router listens at", SOON).unwrap();
    let mut echo = start_peer(folder.path(), &endpoint, "echo", &["r1"]);
    echo.until_prints("listens", SOON).unwrap();
    let mut robots = start_peer(folder.path(), &endpoint, "robots", &["r1:0:0"]);
    robots.until_prints("1 robots publish", SOON).unwrap();
    let unannounced = doctor_finds(&endpoint).contains_key("ros_unannounced");
    let reached = is_received(&echo).await;
    assert_eq!(unannounced, !reached, "the doctor sees whether they reach each other");
    reached
}

async fn is_received(echo: &Process) -> bool {
    let begin = Instant::now();
    while begin.elapsed() < Duration::from_secs(6) {
        if echo.output().contains("received") {
            return true;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    false
}

#[tokio::test(flavor = "multi_thread")]
async fn programs_of_ros_reach_each_other_at_a_router_for_ros_alone() {
    assert!(peers_reach_each_other(&["router", "--ros"]).await);
    let up = ["up", "--router", "--with", "ros2", "--no-console", "--state-directory", "none"];
    assert!(peers_reach_each_other(&up).await);
    assert!(!peers_reach_each_other(&["router"]).await, "then the flag would be of no use");
}

/// One command is a router, the services and the bridge, for robots that are programs of ROS.
#[tokio::test(flavor = "multi_thread")]
async fn robots_of_ros_are_divided_by_one_command() {
    let endpoint = muster_tests::ports::free_endpoint().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let up = ["up", "--router", "--listen", &endpoint, "--fleet", "alpha", "--with", "ros2"];
    let quiet = ["--no-console", "--state-directory", "none", "--set", "clusterer.teams=2"];
    // The bridge takes its flags from the command, and its topics from the environment.
    std::fs::write(folder.path().join("ros2.toml"), "[frames]\nmax_age_s = 10.0\n").unwrap();
    let topics = folder.path().join("ros2.toml");
    let environment = [("MUSTER_ROS2_TOPICS", topics.to_str().unwrap())];
    let arguments = [&up[..], &quiet].concat();
    let mut up = Process::start("muster", &arguments, &environment, folder.path()).unwrap();
    up.until_prints("router listens at", SOON).unwrap();
    let client = Client::connect(&endpoint, "alpha").await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let mut console = start_peer(folder.path(), &endpoint, "console", &["r1", "s1"]);
    let _robots = start_peer(folder.path(), &endpoint, "robots", &PAIRS);
    teams.until("two teams of robots of ROS", SOON, are_pairs).await.unwrap();
    printed(&mut console, "team", |value| value["robot"] == "r1").await;
    up.signal("TERM").unwrap();
    assert!(up.wait(SOON).unwrap().success(), "{}", up.output());
}

/// Whether a bridge runs whose flags name an endpoint.
fn has_bridge(endpoint: &str) -> bool {
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    let mut lines = processes.filter_map(|entry| std::fs::read(entry.path().join("cmdline")).ok());
    lines.any(|line| {
        let line = String::from_utf8_lossy(&line);
        line.contains("muster-ros2") && line.contains(endpoint)
    })
}

#[test]
fn a_bridge_ends_with_the_command_that_is_killed() {
    let endpoint = muster_tests::ports::free_endpoint().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let up = ["up", "--router", "--listen", &endpoint, "--with", "ros2"];
    let quiet = ["--no-console", "--state-directory", "none"];
    let mut up = Process::start("muster", &[&up[..], &quiet].concat(), &[], folder.path()).unwrap();
    let until_bridge = |runs: bool| {
        let start = Instant::now();
        while has_bridge(&endpoint) != runs {
            assert!(start.elapsed() < SOON, "a bridge runs: {}", !runs);
            std::thread::sleep(Duration::from_millis(100));
        }
    };
    until_bridge(true);
    up.kill().unwrap();
    until_bridge(false);
}

#[test]
fn the_measurement_of_a_fleet_of_ros_counts_every_message_and_sees_teams() {
    let arguments = ["--robots", "4", "--rate", "10", "--seconds", "5"];
    let (code, out, err) = run("ros-load", &arguments, 4 * SOON).unwrap();
    // On a busy machine the goal for the time may be missed, which is no fault of the measurement.
    assert!(matches!(code, Some(0 | 1)), "{out}{err}");
    let number = |before: &str| -> f64 {
        let (_, rest) =
            out.split_once(before).unwrap_or_else(|| panic!("no {before:?}: {out}{err}"));
        let digits = rest.split(|c: char| !c.is_ascii_digit() && c != '.').next().unwrap();
        digits.parse().unwrap()
    };
    // Four robots put odometry and transforms ten times a second.
    let (put, received) = (number("messages put "), number("received by the bridge "));
    assert!((40.0..=90.0).contains(&put) && (received - put).abs() < 8.0, "{out}");
    assert!(number("p50 ") > 0.0 && number("p50 ") <= number("p99 "), "{out}");
    assert!(out.contains("; 0 without a team in time"), "{out}");
}
