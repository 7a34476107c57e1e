//! The programs of `shared/client/README.md`, word for word: a robot, a dashboard and a check in Python.
//!
//! They run against whole processes as a reader would run them, with the environment and the
//! arguments that the document names, on the Python that `tests/run` installs.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use muster_tests::BUSY;
use muster_tests::client::{Client, division};
use muster_tests::cluster::{Cluster, start_router};
use muster_tests::ports::free_endpoint;
use muster_tests::process::{Process, python};
use serde_json::{Value, json};

use crate::cli::FOLLOWED_WITHIN;
use crate::pipeline::FORMED_WITHIN;

/// The document with the programs for robots and consoles.
const CLIENT: &str = "shared/client/README.md";

/// The text of the fenced block after a marker, all blocks of that marker in the document in order.
pub(crate) fn blocks(document: &str, marker: &str) -> Vec<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(document);
    let text = std::fs::read_to_string(&path).expect(document);
    let start = format!("<!-- {marker} -->\n```");
    text.split(&start)
        .skip(1)
        .map(|part| {
            let (_, part) = part.split_once('\n').unwrap();
            part.split_once("\n```\n").expect("the block ends").0.to_owned() + "\n"
        })
        .collect()
}

/// Writes a program of the document into a folder, once: another process may be reading it.
fn written(name: &str, folder: &Path) -> PathBuf {
    let blocks = blocks(CLIENT, name);
    assert_eq!(blocks.len(), 1, "{CLIENT} must hold one block behind <!-- {name} -->");
    let path = folder.join(name);
    if !path.exists() {
        std::fs::write(&path, &blocks[0]).unwrap();
    }
    path
}

struct Programs<'a> {
    cluster: &'a Cluster,
    python: PathBuf,
}

impl Programs<'_> {
    fn start(&self, name: &str, arguments: &[&str]) -> Process {
        let path = written(name, self.cluster.folder());
        let path = path.to_string_lossy();
        let environment = [
            ("MUSTER_CONNECT", self.cluster.endpoint.as_str()),
            ("MUSTER_FLEET", &self.cluster.fleet),
        ];
        let arguments = [&[path.as_ref()], arguments].concat();
        Process::start_at(&self.python, name, &arguments, &environment, self.cluster.folder())
            .unwrap()
    }
}

/// Waits until a program has printed a line that is right.
async fn printed(program: &mut Process, what: &str, right: impl Fn(&str) -> bool) -> String {
    let start = Instant::now();
    loop {
        let output = program.output();
        if let Some(line) = output.lines().find(|line| right(line)) {
            return line.to_owned();
        }
        assert!(program.is_running().unwrap(), "{what}: the program has ended:\n{output}");
        assert!(start.elapsed() < FORMED_WITHIN, "{what}: it has printed only\n{output}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_robot_and_the_dashboard_of_the_document_work_as_they_stand() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let programs = Programs { cluster: &cluster, python: python().unwrap() };
    let mut dashboard = programs.start("dashboard.py", &[]);
    let mut robots = Vec::new();
    for arguments in ["r1 0 0", "r2 3 4 r1", "s1 90 0", "s2 93 4 s1"] {
        let arguments: Vec<&str> = arguments.split(' ').collect();
        robots.push(programs.start("robot.py", &arguments));
    }

    let client = cluster.client().await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let right = |value: &Value| {
        let division = division(value);
        division.len() == 4
            && division["r1"].is_some()
            && division["r1"] == division["r2"]
            && division["s1"] == division["s2"]
            && division["r1"] != division["s1"]
    };
    let formed = teams.until("two teams of Python's robots", FORMED_WITHIN, right).await.unwrap();
    let team = |robot: &str| division(&formed)[robot].clone().unwrap();

    for (robot, name, leader, members) in [
        (0, "r1", "r1", "['r1', 'r2']"),
        (1, "r2", "r1", "['r1', 'r2']"),
        (3, "s2", "s1", "['s1', 's2']"),
    ] {
        let wanted = format!("{name} is in team {}, led by {leader}: {members}", team(name));
        printed(&mut robots[robot], &wanted, |line| line == wanted).await;
    }
    // The teams are numbered, in this order.
    let mut wanted = [format!("{}: r1 r2", team("r1")), format!("{}: s1 s2", team("s1"))];
    wanted.sort();
    let wanted = format!("teams  {}", wanted.join("  "));
    printed(&mut dashboard, "the teams", |line| line == wanted).await;
    printed(&mut dashboard, "the audit", |line| {
        ["good", "fair", "poor"].iter().any(|word| line.starts_with(&format!("audit  {word}  t")))
    })
    .await;
    printed(&mut dashboard, "an event", |line| {
        line.starts_with("event  ")
            && line.contains("event: robot_joined")
            && line.contains("robot: r1")
    })
    .await;
    let graph = client.get_one("graph/hierarchy?format=json").await.unwrap();
    let edges: BTreeSet<String> = graph["edges"]
        .as_array()
        .unwrap()
        .iter()
        .map(|edge| format!("{}{}", edge[0], edge[1]))
        .collect();
    assert_eq!(edges, BTreeSet::from(["\"r1\"\"r2\"".to_owned(), "\"s1\"\"s2\"".to_owned()]));
    let graph = client.get_one("graph/connectivity?format=json").await.unwrap();
    assert_eq!(graph["edges"].as_array().unwrap().len(), 2, "{graph}");
    // Nothing that the programs put was refused.
    assert!(!dashboard.output().contains("quarantined"), "{}", dashboard.output());

    // Neither goes back to an older message, whatever repeats it.
    let old = json!({"fleet": "alpha", "term": 0, "epoch": 1, "data_age_s": null, "stages": []});
    let with = |more: Value| {
        let mut message = old.clone();
        message.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        message
    };
    let team = json!({"id": "t99", "members": ["r1"], "leader": "r1"});
    let teams = with(json!({"teams": [team], "unassigned": [], "stale": []}));
    client.put("json/teams", &teams).await.unwrap();
    let own = with(json!({"robot": "r1", "team": "t99", "members": ["r1"], "leader": "r1"}));
    client.put("robot/r1/team", &own).await.unwrap();

    // A robot that goes away is missed, and a dashboard that comes late sees what is.
    robots.pop().unwrap().kill().unwrap();
    printed(&mut dashboard, "a stale robot", |line| {
        line.contains("event: robot_stale") && line.contains("robot: s2")
    })
    .await;
    for program in [&dashboard, &robots[0]] {
        assert!(!program.output().contains("t99"), "{}", program.output());
    }
    let mut late = programs.start("dashboard.py", &[]);
    printed(&mut late, "the teams, late", |line| line.starts_with("teams  t")).await;
    printed(&mut late, "the audit, late", |line| line.starts_with("audit  ")).await;
}

/// Waits until a program has printed a text so many times.
async fn printed_times(program: &mut Process, text: &str, times: usize) {
    let start = Instant::now();
    while program.output().matches(text).count() < times {
        let output = program.output();
        assert!(program.is_running().unwrap(), "{text}: the program has ended:\n{output}");
        assert!(start.elapsed() < FORMED_WITHIN, "{text}: it has printed only\n{output}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_robot_of_the_document_says_what_it_has_lost_and_what_is_refused() {
    let mut cluster = Cluster::start("alpha", &[("clusterer", "teams=1")]).unwrap();
    let python = python().unwrap();
    let start = |cluster: &Cluster, arguments: &[&str]| {
        let programs = Programs { cluster, python: python.clone() };
        programs.start("robot.py", arguments)
    };
    let mut r1 = start(&cluster, &["r1", "0", "0"]);
    let _r2 = start(&cluster, &["r2", "3", "4", "r1"]);
    let told = "r1 is in team t1, led by r1: ['r1', 'r2']";
    printed_times(&mut r1, told, 1).await;
    assert!(!r1.output().contains("stale"), "{}", r1.output());

    cluster.kill_router().unwrap();
    printed_times(&mut r1, "r1 keeps its team, which is stale: the link is lost", 1).await;
    cluster.restart_router().unwrap();
    printed_times(&mut r1, told, 2).await;
    for service in ["clusterer", "auditor"] {
        cluster.service(service).unwrap().kill().unwrap();
    }
    printed_times(&mut r1, "which is stale: no service has told it for 4 s", 1).await;
    for service in ["clusterer", "auditor"] {
        cluster.start_service(service).unwrap();
    }
    printed_times(&mut r1, told, 3).await;
    assert!(!r1.output().contains("refused"), "{}", r1.output());

    // What is refused is told to the robot that put it, and to no other.
    let mut lost = start(&cluster, &["r3", "nan", "0"]);
    printed_times(&mut lost, "r3 is refused: this is not the JSON it should be", 1).await;
    let mut twin = start(&cluster, &["r1", "50", "0"]);
    for program in [&mut r1, &mut twin] {
        printed_times(program, "r1 is refused: two programs put as r1", 1).await;
    }
    assert!(!r1.output().contains("r3"), "{}", r1.output());
}

#[tokio::test(flavor = "multi_thread")]
async fn python_programs_follow_services_that_restarted_with_lower_terms() {
    let endpoint = free_endpoint().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let _router = start_router(&endpoint, folder.path()).unwrap();
    let environment = [("MUSTER_CONNECT", endpoint.as_str()), ("MUSTER_FLEET", "alpha")];
    let start = |name: &str, arguments: &[&str]| {
        let path = written(name, folder.path());
        let arguments = [&[path.to_str().unwrap()], arguments].concat();
        let python = python().unwrap();
        Process::start_at(&python, name, &arguments, &environment, folder.path()).unwrap()
    };
    let programs = [start("robot.py", &["r1", "0", "0"]), start("dashboard.py", &[])];
    let client = Client::connect(&endpoint, "alpha").await.unwrap();
    // The outputs of a clusterer, without one: each epoch once.
    let publish = async |term: u64, epoch: u64, team: &str| {
        let message = |more: Value| {
            let mut message = json!({
                "fleet": "alpha", "term": term, "epoch": epoch, "data_age_s": null, "stages": []
            });
            message.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
            message
        };
        let teams = [json!({"id": team, "members": ["r1"], "leader": "r1"})];
        let teams = message(json!({"teams": teams, "unassigned": [], "stale": []}));
        client.put("json/teams", &teams).await.unwrap();
        let own = json!({"robot": "r1", "team": team, "members": ["r1"], "leader": "r1"});
        client.put("robot/r1/team", &message(own)).await.unwrap();
    };
    let shown_within = async |term: u64, team: &str, limit: Duration| {
        let (start, mut epoch) = (Instant::now(), 0);
        while !programs.iter().all(|program| program.output().contains(team)) {
            let outputs = programs.each_ref().map(Process::output);
            assert!(start.elapsed() < limit, "{team}: {outputs:?}");
            epoch += 1;
            publish(term, epoch, team).await;
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
        start.elapsed()
    };
    shown_within(7, "t7", FORMED_WITHIN).await;
    let limit = Duration::from_secs(FOLLOWED_WITHIN.as_secs() * BUSY);
    let took = shown_within(1, "t1", limit).await;
    eprintln!("followed after {took:?}");
    assert!(took > Duration::from_secs(4), "the newest message was fresh: {took:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_check_of_the_document_accepts_what_is_right_and_names_what_is_wrong() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let client = cluster.client().await.unwrap();
    client.until("schema", FORMED_WITHIN, |_| true).await.unwrap();
    let path = written("check.py", cluster.folder());
    let check = |name: &str, message: &str| {
        use std::io::Write as _;
        let mut child = std::process::Command::new(python().unwrap())
            .args([path.as_os_str(), name.as_ref()])
            .env("MUSTER_CONNECT", &cluster.endpoint)
            .env("MUSTER_FLEET", &cluster.fleet)
            .stdin(std::process::Stdio::piped())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        child.stdin.take().unwrap().write_all(message.as_bytes()).unwrap();
        let output = child.wait_with_output().unwrap();
        (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (good, err) = check("pose", r#"{"x": 1.0, "y": 2.0}"#);
    assert!(good, "{err}");
    let (good, err) = check("pose", r#"{"x": 1.0}"#);
    assert!(!good && err.contains("'y' is a required property"), "{err}");
}
