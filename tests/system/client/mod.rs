//! Robots and consoles by the client crate, against real services and a real router.

mod alone;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use futures_util::StreamExt as _;
use muster_client::model::audit::Quality;
use muster_client::model::event::EventKind;
use muster_client::model::id::{OperatorId, RobotId, ServiceName};
use muster_client::model::teams::RobotTeam;
use muster_client::{Change, Client, Config, Error, Events, Latest, Pose, Robot, Staleness, Watch};
use muster_tests::client::division;
use muster_tests::cluster::Cluster;
use muster_tests::process::Process;
use serde_json::{Value, json};
use tokio::task::JoinHandle;
use tokio::time::{sleep, timeout};

use crate::pipeline::FORMED_WITHIN;

/// When the newest team of a robot is stale in these tests.
const STALE_AFTER: Duration = Duration::from_secs(4);

/// How soon a message of a running service arrives, on a busy machine.
const RECEIVED_WITHIN: Duration = Duration::from_secs(10);

/// Two groups of three, far apart.
const PLACES: [(&str, f64); 6] =
    [("a1", 0.0), ("a2", 3.0), ("a3", 6.0), ("b1", 90.0), ("b2", 93.0), ("b3", 96.0)];

fn config(cluster: &Cluster) -> Config {
    Config {
        fleet: cluster.fleet.clone(),
        routers: Some(vec![cluster.endpoint.clone()]),
        connect_timeout: Some(Duration::from_secs(10)),
        stale_after: STALE_AFTER,
        republish_every: Duration::from_secs(2),
        ..Config::default()
    }
}

/// Robots that put their poses until they are dropped.
struct Driving {
    robots: BTreeMap<&'static str, Arc<Robot>>,
    driver: JoinHandle<()>,
}

impl Drop for Driving {
    fn drop(&mut self) {
        self.driver.abort();
    }
}

/// Joins the robots of both groups, all but one, and has them put poses.
async fn drive(client: &Client, without: &str) -> Driving {
    let mut robots = BTreeMap::new();
    for (name, _) in PLACES.into_iter().filter(|(name, _)| *name != without) {
        robots.insert(name, Arc::new(client.join(name).await.unwrap()));
    }
    let driven = robots.clone();
    let driver = tokio::spawn(async move {
        loop {
            for (name, x) in PLACES {
                if let Some(robot) = driven.get(name) {
                    robot.put_pose(Pose::at(x, 0.0)).unwrap();
                }
            }
            sleep(Duration::from_millis(100)).await;
        }
    });
    Driving { robots, driver }
}

/// Waits until the team of a robot is right, and returns how long that took.
async fn until(
    team: &mut Watch<RobotTeam>,
    within: Duration,
    what: &str,
    right: impl Fn(&Latest<RobotTeam>) -> bool,
) -> (Latest<RobotTeam>, Duration) {
    let start = Instant::now();
    let waiting = async {
        if let Some(latest) = team.latest().filter(&right) {
            return latest;
        }
        loop {
            let latest = team.changed().await.unwrap();
            if right(&latest) {
                return latest;
            }
        }
    };
    match timeout(within, waiting).await {
        Ok(latest) => (latest, start.elapsed()),
        Err(_) => panic!("not within {within:?}: {what}; the newest is {:?}", team.latest()),
    }
}

fn members(team: &RobotTeam) -> Vec<&str> {
    team.members.iter().flatten().map(|member| member.as_str()).collect()
}

fn with_group(group: &'static [&'static str]) -> impl Fn(&Latest<RobotTeam>) -> bool {
    move |latest| members(latest) == group && !latest.is_stale()
}

async fn event(events: &mut Events, what: &str, right: impl Fn(&EventKind) -> bool) {
    let waiting = async { while !right(&events.next().await.unwrap().kind) {} };
    timeout(RECEIVED_WITHIN, waiting).await.unwrap_or_else(|_| panic!("no such event: {what}"));
}

/// The edges of a graph, in an order of their own: a graph has them by the time at which its robots came.
fn sorted(edges: &Value) -> Vec<String> {
    let mut edges: Vec<_> = edges.as_array().unwrap().iter().map(Value::to_string).collect();
    edges.sort();
    edges
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_in_ten_lines_gets_its_team_and_consoles_see_it() {
    let cluster = Cluster::start(
        "alpha",
        &[("ingest", "modalities=[\"thermal\"]"), ("clusterer", "teams=2")],
    )
    .unwrap();
    let console = Client::open(&config(&cluster)).await.unwrap();
    let mut events = console.events().await.unwrap();
    let others = drive(&console, "b2").await;
    let robot = Robot::join(&config(&cluster), "b2").await.unwrap();
    let mut team = robot.team();
    assert!(team.latest().is_none());
    robot.put_rank(Some("b1")).unwrap();
    robot.put_links([("b1", 0.9), ("b3", 0.8)]).unwrap();
    robot.put_relation("thermal", [("b3", 1.0)]).unwrap();
    let moving = async {
        loop {
            robot.put_pose(Pose::at(93.0, 0.0)).unwrap();
            sleep(Duration::from_millis(100)).await;
        }
    };
    let right = with_group(&["b1", "b2", "b3"]);
    let (latest, took) = tokio::select! {
        formed = until(&mut team, FORMED_WITHIN, "b2 is in its group", right) => formed,
        () = moving => unreachable!(),
    };
    eprintln!("formed after {took:?}");
    assert_eq!(latest.robot.as_str(), "b2");
    // It alone reports rank and links, which sets it apart from the others of its group a little.
    assert!(latest.confidence > 0.25, "{}", latest.confidence);
    assert!(team.data_age_s().unwrap() < 30.0);
    event(
        &mut events,
        "b2 joins",
        |kind| matches!(kind, EventKind::RobotJoined { robot } if robot.as_str() == "b2"),
    )
    .await;

    // What the services made of it: every report has arrived.
    let outside = cluster.client().await.unwrap();
    let wanted = [
        ("hierarchy", json!([["b1", "b2", 1.0]])),
        ("connectivity", json!([["b1", "b2", 0.9], ["b3", "b2", 0.8]])),
        ("thermal", json!([["b2", "b3", 1.0]])),
    ];
    for (modality, edges) in wanted {
        let graph = outside.get_one(&format!("graph/{modality}?format=json")).await.unwrap();
        assert_eq!(sorted(&graph["edges"]), sorted(&edges), "{modality}");
    }
    // A late console receives it at once, without a change.
    let late = Client::open(&config(&cluster)).await.unwrap();
    let mut teams = late.teams().await.unwrap();
    let division = timeout(RECEIVED_WITHIN, teams.changed()).await.unwrap().unwrap();
    assert_eq!(division.teams.len(), 2);
    assert!(!division.is_stale());
    let mut audits = late.audits().await.unwrap();
    let audited = async { while audits.changed().await.unwrap().quality == Quality::Undefined {} };
    timeout(RECEIVED_WITHIN, audited).await.expect("an audit with a verdict");
    let settings = late.get_settings(ServiceName::Clusterer).await.unwrap();
    assert_eq!(settings["teams"], 2);
    late.close().await;
    assert!(
        matches!(teams.changed().await, Err(Error::Closed)),
        "a closed client ends its watches"
    );
    drop(others);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_examples_run_as_they_are_shown() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let environment =
        [("MUSTER_FLEET", cluster.fleet.as_str()), ("MUSTER_CONNECT", cluster.endpoint.as_str())];
    let start = |name: &str, arguments: &[&str]| {
        Process::start(name, arguments, &environment, cluster.folder()).unwrap()
    };
    let places = [["a1", "0"], ["a2", "5"], ["b1", "90"], ["b2", "95"]];
    let mut robots: Vec<_> =
        places.iter().map(|[name, x]| start("examples/robot", &[*name, *x, "0"])).collect();
    // The console asks for the settings once, and fails where no instance leads yet.
    let outside = cluster.client().await.unwrap();
    outside.until("service/clusterer/settings", FORMED_WITHIN, |_| true).await.unwrap();
    let console = start("examples/console", &[]);
    let began = Instant::now();
    let shown = |process: &Process, words: &[&str]| {
        let output = process.output();
        words.iter().all(|word| output.contains(word))
    };
    while !(shown(&robots[0], &["led by", "a1 a2"])
        && shown(&robots[3], &["led by", "b1 b2"])
        && shown(&console, &["settings of clusterer", "\"teams\":2", "led by", "verdict: Good"]))
    {
        let printed = (robots[0].output(), robots[3].output(), console.output());
        assert!(began.elapsed() < FORMED_WITHIN, "{printed:?}");
        sleep(Duration::from_millis(50)).await;
    }
    // Ctrl-C is a goodbye.
    robots[3].signal("INT").unwrap();
    assert_eq!(robots[3].wait(RECEIVED_WITHIN).unwrap().code(), Some(0));
    for wrong in [&["R 1"][..], &["r1", "x", "y"], &["--help"]] {
        let mut process = start("examples/robot", wrong);
        assert_ne!(process.wait(RECEIVED_WITHIN).unwrap().code(), Some(0));
        assert!(shown(&process, &["usage"]) || shown(&process, &["error: robot: "]));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_loses_its_router_keeps_its_team_and_marks_it_stale() {
    let mut cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let client = Client::open(&config(&cluster)).await.unwrap();
    let fleet = drive(&client, "").await;
    let robot = &fleet.robots["a2"];
    robot.put_rank(Some("a1")).unwrap();
    let mut team = robot.team();
    let group = ["a1", "a2", "a3"];
    let right = with_group(&["a1", "a2", "a3"]);
    let (before, _) = until(&mut team, FORMED_WITHIN, "a2 is in its group", &right).await;

    cluster.kill_router().unwrap();
    let lost = |latest: &Latest<RobotTeam>| latest.stale == Some(Staleness::LinkLost);
    let (kept, took) = until(&mut team, Duration::from_secs(5), "stale", lost).await;
    eprintln!("stale {took:?} after the router was killed");
    assert_eq!((members(&kept), &kept.team), (group.to_vec(), &before.team));
    // The robot continues: it puts what it wants, and never waits for the bus.
    let start = Instant::now();
    for _ in 0..10_000 {
        robot.put_pose(Pose::at(3.0, 0.0)).unwrap();
    }
    assert!(start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
    sleep(Duration::from_secs(3)).await;
    assert!(team.latest().is_some_and(|latest| lost(&latest) && members(&latest) == group));

    // A report that it puts once while the link is lost is republished, and received then.
    robot.put_rank(Some("a3")).unwrap();
    // So is a robot that joins meanwhile.
    let _late = timeout(RECEIVED_WITHIN, client.join("late")).await.unwrap().unwrap();
    sleep(Duration::from_millis(500)).await;
    let back = Instant::now();
    cluster.restart_router().unwrap();
    let (fresh, _) = until(&mut team, FORMED_WITHIN, "fresh again", &right).await;
    eprintln!("fresh {:?} after the router was started", back.elapsed());
    assert_eq!(fresh.team, before.team, "the team is the same");
    assert!(fresh.header.revision > before.header.revision);
    let outside = cluster.client().await.unwrap();
    answers_to(&outside, "a3").await;
    let teams = outside.watch("json/teams").await.unwrap();
    let joined = |value: &Value| division(value).contains_key("late");
    teams.until("the late robot is known", RECEIVED_WITHIN, joined).await.unwrap();

    // The same when the link is there and only the service is not.
    cluster.service("ingest").unwrap().kill().unwrap();
    robot.put_rank(Some("a1")).unwrap();
    sleep(Duration::from_millis(500)).await;
    cluster.start_service("ingest").unwrap();
    answers_to(&outside, "a1").await;
}

/// Waits until the services know that a2 answers to another robot.
async fn answers_to(outside: &muster_tests::client::Client, superior: &str) {
    let start = Instant::now();
    let right = |graph: &Value| graph["edges"] == json!([[superior, "a2", 1.0]]);
    outside.until("graph/hierarchy?format=json", RECEIVED_WITHIN, right).await.unwrap();
    eprintln!("known after {:?}", start.elapsed());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_clusterer_that_dies_leaves_teams_that_turn_stale_and_fresh() {
    let mut cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let client = Client::open(&config(&cluster)).await.unwrap();
    let fleet = drive(&client, "").await;
    let mut team = fleet.robots["b3"].team();
    let mut teams = client.teams().await.unwrap();
    let right = with_group(&["b1", "b2", "b3"]);
    let (before, _) = until(&mut team, FORMED_WITHIN, "b3 is in its group", &right).await;
    // Running services keep a team fresh for longer than it takes to become stale.
    let quiet = async {
        loop {
            assert!(!team.changed().await.unwrap().is_stale(), "the services live");
        }
    };
    let _ = timeout(2 * STALE_AFTER, quiet).await;

    cluster.service("clusterer").unwrap().kill().unwrap();
    let silent = |latest: &Latest<RobotTeam>| latest.stale == Some(Staleness::Silent);
    let (kept, took) = until(&mut team, 3 * STALE_AFTER, "stale", silent).await;
    eprintln!("stale {took:?} after the clusterer was killed");
    assert!(took > STALE_AFTER / 2, "{took:?}");
    assert_eq!((members(&kept), &kept.team), (members(&before), &before.team));
    let division = async { while !teams.changed().await.unwrap().is_stale() {} };
    timeout(STALE_AFTER, division).await.expect("a console sees it as well");
    // Caches answer in its place with the last message: that freshens nothing.
    sleep(STALE_AFTER).await;
    assert!(team.latest().is_some_and(|latest| silent(&latest)));

    let back = Instant::now();
    cluster.start_service("clusterer").unwrap();
    let (fresh, _) = until(&mut team, FORMED_WITHIN, "fresh again", &right).await;
    eprintln!("fresh {:?} after the clusterer was started", back.elapsed());
    assert_eq!(fresh.team, before.team);
    assert!(fresh.header.revision.term > before.header.revision.term);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_leaves_is_gone_and_may_come_back() {
    let cluster =
        Cluster::start("alpha", &[("ingest", "gone_after_s=3"), ("clusterer", "teams=2")]).unwrap();
    let client = Client::open(&config(&cluster)).await.unwrap();
    let fleet = drive(&client, "a3").await;
    let outside = cluster.client().await.unwrap();
    let teams = outside.watch("json/teams").await.unwrap();
    for round in 0..2 {
        let robot = Robot::join(&config(&cluster), "a3").await.unwrap();
        let mut team = robot.team();
        let right = with_group(&["a1", "a2", "a3"]);
        let moving = async {
            loop {
                robot.put_pose(Pose::at(6.0, 0.0)).unwrap();
                sleep(Duration::from_millis(100)).await;
            }
        };
        tokio::select! {
            _ = until(&mut team, FORMED_WITHIN, "a3 is in its group", right) => {}
            () = moving => unreachable!(),
        }
        // Once it leaves, once it is only dropped.
        if round == 0 {
            robot.leave().await;
        } else {
            drop(robot);
        }
        assert!(matches!(team.changed().await, Err(Error::Closed)));
        teams.clear();
        let without = |value: &Value| !division(value).contains_key("a3");
        teams.until("teams without a3", RECEIVED_WITHIN, without).await.unwrap();
    }
    assert_eq!(fleet.robots.len(), 5);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_on_the_callers_session_leaves_it_open() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let outside = cluster.client().await.unwrap();
    let config = Config { fleet: cluster.fleet.clone(), ..Config::default() };
    let client = Client::on_session(outside.session().clone(), &config).await.unwrap();
    let [one, other] = ["r1", "r2"].map(|name| RobotId::new(name).unwrap());
    let robots = [client.join("r1").await.unwrap(), client.join("r2").await.unwrap()];
    let mut changes = client.changes().await.unwrap();
    let teams = async {
        loop {
            for (robot, x) in robots.iter().zip([0.0, 3.0]) {
                robot.put_pose(Pose::at(x, 0.0)).unwrap();
            }
            let next = timeout(Duration::from_millis(200), changes.next()).await;
            if let Ok(Some(Change::Teams(teams))) = next
                && teams.assignments().count() == 2
            {
                return teams;
            }
        }
    };
    let teams = timeout(FORMED_WITHIN, teams).await.expect("a division of both");
    assert!(!teams.is_stale());

    // What a console asks for once.
    assert_eq!(client.get_joined_robots().await.unwrap(), [one.clone(), other.clone()].into());
    assert_eq!(client.get_teams().await.unwrap().assignments().count(), 2);
    assert_eq!(client.get_roster().await.unwrap().robots.len(), 2);
    assert_eq!(client.get_graphs(None).await.unwrap().len(), 3);
    let statuses = client.get_statuses(None).await.unwrap();
    assert_eq!((statuses.len(), client.get_instances().await.unwrap().len()), (4, 4));
    assert!(client.get_similarity(&one, &other).await.unwrap().similarity > 0.0);
    let stranger = RobotId::new("stranger").unwrap();
    let refused = client.get_similarity(&one, &stranger).await.unwrap_err();
    assert!(matches!(refused, Error::Refused { service: ServiceName::Embedder, .. }), "{refused}");
    let kim = OperatorId::new("kim").unwrap();
    let settings = client.change_settings(&kim, ServiceName::Clusterer, &json!({"teams": 1})).await;
    let why = client.get_reason(&one).await.unwrap();
    assert_eq!((&why.reason.robot, why.reason.wishes.len()), (&one, 0));
    let refused = client.get_reason(&stranger).await.unwrap_err();
    assert!(matches!(refused, Error::Refused { service: ServiceName::Embedder, .. }), "{refused}");
    assert_eq!(settings.unwrap()["teams"], 1);
    let refused = client.change_settings(&kim, ServiceName::Clusterer, &json!({"teams": 0})).await;
    assert!(matches!(refused, Err(Error::Refused { .. })), "{refused:?}");

    // The session of the caller outlives the client.
    let mut team = robots[0].team();
    client.close().await;
    let closed = async { while team.changed().await.is_ok() {} };
    timeout(RECEIVED_WITHIN, closed).await.expect("a closed client ends its watches");
    assert!(matches!(robots[0].put_pose(Pose::at(0.0, 0.0)), Err(Error::Closed)));
    assert!(outside.get_one("teams?format=json").await.is_ok(), "the session is open");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_learns_what_services_refuse_of_it() {
    let cluster = Cluster::start("alpha", &[]).unwrap();
    let robot = Robot::join(&config(&cluster), "r1").await.unwrap();
    let (mut first, mut second) = (robot.refusals(), robot.refusals());
    let frame = Some("mars".to_owned());
    let learned = async {
        loop {
            let _ = robot.put_pose(Pose { frame: frame.clone(), ..Pose::at(0.0, 0.0) });
            if let Ok(refused) = timeout(Duration::from_millis(100), first.next()).await {
                return refused.unwrap();
            }
        }
    };
    let refused = timeout(FORMED_WITHIN, learned).await.expect("a refusal");
    assert!(refused.reason.starts_with("frame: \"mars\" is not known"), "{}", refused.reason);
    assert_eq!(refused.key, "muster/v1/alpha/robot/r1/pose");
    let other = timeout(RECEIVED_WITHIN, second.next()).await.expect("the same refusal").unwrap();
    assert_eq!(other, refused);

    // A stream that there is not, by another program and another robot.
    let outside = cluster.client().await.unwrap();
    let mut stray = robot.client().refusals(&RobotId::new("r2").unwrap()).await.unwrap();
    let named = async {
        loop {
            outside.put("robot/r2/poze", &json!({"x": 0.0, "y": 0.0})).await.unwrap();
            if let Ok(refused) = timeout(Duration::from_millis(100), stray.next()).await {
                return refused.unwrap();
            }
        }
    };
    let refused = timeout(RECEIVED_WITHIN, named).await.expect("a refusal of r2");
    assert!(refused.reason.contains("\"poze\" is unknown"), "{}", refused.reason);
    let putting = async {
        loop {
            outside.put("robot/r2/poze", &json!({})).await.unwrap();
            sleep(Duration::from_millis(100)).await;
        }
    };
    let look = tokio::task::spawn_blocking({
        let (fleet, endpoint) = (cluster.fleet.clone(), cluster.endpoint.clone());
        move || {
            let flags = ["--fleet", &fleet, "--connect", &endpoint, "--json"];
            let command = ["doctor", "--listen-for", "3"];
            muster_tests::process::run("muster", &[&command[..], &flags].concat(), FORMED_WITHIN)
        }
    });
    let (_, report, _) = tokio::select! {
        look = look => look.unwrap().unwrap(),
        () = putting => unreachable!(),
    };
    let report: Value = serde_json::from_str(&report).unwrap();
    let findings = report["findings"].as_array().unwrap();
    let refused = findings.iter().find(|finding| finding["id"] == "refused").expect("a finding");
    assert!(refused["seen"].as_str().unwrap().contains("poze"), "{refused}");
}
