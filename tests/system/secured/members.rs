//! Members of a secured fleet, and its routers.

use std::time::{Duration, Instant};

use muster_tests::client::{Client, Watch, division};
use muster_tests::cluster::SERVICES;
use serde_json::{Value, json};

use super::refusals::nothing_but;
use super::{ROBOTS, SOON, Secured, form, open, put_poses, robots};

#[tokio::test(flavor = "multi_thread")]
async fn members_of_a_secured_fleet_work_as_on_a_plain_bus() {
    let mut secured = Secured::start(&["base"]);
    let operator = secured.client("operator.op").await;
    let teams = operator.watch("json/teams").await.unwrap();
    let events = operator.watch("json/event").await.unwrap();
    let robots = robots(&secured).await;
    let mut tokens = Vec::new();
    for ((name, _), (robot, _)) in ROBOTS.iter().zip(&robots) {
        tokens.push(robot.token(&format!("robot/{name}")).await.unwrap());
    }
    let mine = robots[0].0.watch("robot/a1/team").await.unwrap();
    let others = robots[0].0.watch("robot/b1/team").await.unwrap();
    let all = robots[0].0.watch("**").await.unwrap();
    // A declared publisher sends nothing until it knows of a subscriber.
    let publisher =
        robots[0].0.session().declare_publisher(robots[0].0.key("robot/a1/links")).await.unwrap();
    let formed = form(&robots, &teams).await;
    let links = json!({"links": [{"peer": "a2", "quality": 0.9}]}).to_string();
    publisher.put(links).await.unwrap();

    // The robot receives its team, and nothing of others.
    let right = |team: &Value| team["members"] == json!(["a1", "a2"]);
    let received = mine.until("a1 receives its team", SOON, right).await.unwrap();
    let got = robots[0].0.get_one("robot/a1/team").await.unwrap();
    assert_eq!(got["team"], received["team"]);
    let foreign = |(key, _): &(String, Value)| !key.starts_with("robot/a1/");
    assert!(others.all().is_empty() && !all.all().iter().any(foreign), "{others:?} {all:?}");
    assert!(robots[0].0.get("robot/b1/team", None).await.unwrap().is_empty());
    assert!(robots[0].0.get("json/teams", None).await.unwrap().is_empty());
    let start = Instant::now();
    loop {
        put_poses(&robots).await;
        let graph = operator.get_one("graph/connectivity?format=json").await.unwrap();
        if graph["edges"].as_array().is_some_and(|edges| edges.len() == 1) {
            break;
        }
        assert!(start.elapsed() < SOON, "the declared publisher is not received: {graph}");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }

    // Console and viewer see everything.
    let (code, out, err) = secured.muster(&["status"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(SERVICES.iter().all(|service| out.contains(service)), "{out}");
    assert!(out.contains("4 with a token") && !out.contains("does not answer"), "{out}");
    let viewer = secured.client("viewer.wall").await;
    let seen = viewer.watch("json/teams").await.unwrap();
    seen.until("the viewer sees teams", SOON, |_| true).await.unwrap();
    assert_eq!(division(&viewer.get_one("json/teams").await.unwrap()), division(&formed));

    // Only the operator can change settings, and only under its own name.
    let settings = "service/clusterer/settings";
    for (name, client) in [("robot", &robots[0].0), ("viewer", &viewer)] {
        let answers = client.get(settings, Some(&json!({"hysteresis": 0.5}))).await.unwrap();
        assert!(answers.is_empty(), "{name}: {answers:?}");
    }
    assert_eq!(operator.get_one(settings).await.unwrap()["hysteresis"], 0.05);
    assert_eq!(viewer.get_one(settings).await.unwrap()["hysteresis"], 0.05);
    let (code, _, err) =
        secured.muster(&["set", "clusterer", "hysteresis=0.08", "--operator", "kim"]);
    assert_eq!(code, Some(1), "{err}");
    assert!(err.contains("denied: clusterer") && err.contains("--operator"), "{err}");
    let (code, _, err) = secured.muster(&["set", "clusterer", "hysteresis=0.06"]);
    assert_eq!(code, Some(0), "{err}");
    assert_eq!(operator.get_one(settings).await.unwrap()["hysteresis"], 0.06);

    // A viewer sees the services, so that its console can tell a denied change from a service that is gone.
    let (code, _, err) = secured.muster_as("viewer.wall", &["set", "clusterer", "hysteresis=0.07"]);
    assert_eq!(code, Some(1), "{err}");
    assert!(err.contains("denied: clusterer") && err.contains("operator"), "{err}");
    // The doctor looks where the identity leads, and finds the fleet well as far as it may look.
    for identity in ["operator.op", "viewer.wall"] {
        let (_, out, err) = secured.muster_as(identity, &["doctor", "--json", "--listen-for", "1"]);
        let report: Value = serde_json::from_str(&out).unwrap_or_else(|_| panic!("{out}{err}"));
        assert!(
            report["routers"][0]["endpoint"].as_str().unwrap().starts_with("quic/"),
            "{report}"
        );
        assert_eq!(report["services"].as_array().unwrap().len(), 4, "{identity}: {report}");
        let unreachable = ["no_router", "service_missing", "service_silent", "access_denied"];
        for finding in report["findings"].as_array().unwrap() {
            assert!(
                !unreachable.contains(&finding["id"].as_str().unwrap()),
                "{identity}: {report}"
            );
        }
    }

    restarted_services_fetch_their_state(&mut secured, &operator, &robots, &teams, &formed).await;
    a_second_instance_takes_over(&mut secured, &operator, &robots, &teams, &formed).await;
    for (_, event) in events.all() {
        assert_ne!(event["event"], "quarantined", "{event}");
    }
}

/// A service that restarts without state gets its last output from its readers.
async fn restarted_services_fetch_their_state(
    secured: &mut Secured,
    operator: &Client,
    robots: &[(Client, f64)],
    teams: &Watch,
    formed: &Value,
) {
    for service in ["clusterer", "embedder", "ingest"] {
        let term = |status: &Value| status["revision"]["term"].as_u64().unwrap();
        let key = format!("service/{service}/status");
        let before = term(&operator.get_one(&key).await.unwrap());
        secured.services.retain(|(name, _)| name != service);
        secured.remove_state();
        secured.start_service(service);
        let start = Instant::now();
        loop {
            put_poses(robots).await;
            tokio::time::sleep(Duration::from_millis(100)).await;
            let status = operator.get_one(&key).await;
            if status.as_ref().is_ok_and(|status| term(status) > before) {
                break;
            }
            assert!(start.elapsed() < SOON, "{service} takes no higher term: {status:?}");
        }
        teams.clear();
        let again = form(robots, teams).await;
        assert_eq!(division(&again), division(formed), "after {service}");
    }
}

/// A second instance is a standby, with the same identity, and takes over.
async fn a_second_instance_takes_over(
    secured: &mut Secured,
    operator: &Client,
    robots: &[(Client, f64)],
    teams: &Watch,
    formed: &Value,
) {
    secured.start_service("clusterer");
    let instances = || async {
        let key = operator.key("service/clusterer/*");
        let found = operator.session().liveliness().get(key).await.unwrap();
        let mut count = 0;
        while found.recv_async().await.is_ok() {
            count += 1;
        }
        count
    };
    let start = Instant::now();
    while instances().await != 2 {
        assert!(start.elapsed() < SOON, "the second instance is not there");
        put_poses(robots).await;
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    for _ in 0..20 {
        put_poses(robots).await;
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let first = secured.services.iter().position(|(name, _)| name == "clusterer").unwrap();
    secured.services.remove(first);
    teams.clear();
    let again = form(robots, teams).await;
    assert_eq!(division(&again), division(formed), "after the leader died");
}

#[tokio::test(flavor = "multi_thread")]
async fn two_secured_routers_are_one_bus_and_stand_in_for_each_other() {
    let mut secured = Secured::start(&["base", "spare"]);
    // All connect to the first router, and this operator to the second.
    let config = std::fs::read_to_string(secured.identity("operator.op")).unwrap();
    let spare = config.split("quic/").nth(2).unwrap().split('"').next().unwrap();
    let spare = format!("[\"quic/{spare}\"]");
    let changes = [("connect/endpoints", spare.as_str())];
    let operator = open(&secured.identity("operator.op"), &changes).await.unwrap();
    let teams = operator.watch("json/teams").await.unwrap();
    let robots = robots(&secured).await;
    let formed = form(&robots, &teams).await;

    secured.routers[0].kill().unwrap();
    // What was on its way does not count.
    tokio::time::sleep(Duration::from_millis(500)).await;
    teams.clear();
    let again = form(&robots, &teams).await;
    assert_eq!(division(&again), division(&formed));
    // The rules hold there as well.
    let watch = operator.watch("**").await.unwrap();
    nothing_but(&robots[0].0, &watch, &["robot/a2/pose", "teams"], "robot/a1/pose").await;
}
