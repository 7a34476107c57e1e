//! A host that serves several fleets of one secured bus: each works as if it were alone, and its members have no rights in
//! another.

use std::time::Duration;

use muster_tests::client::{Client, division};
use muster_tests::process::{Process, run};
use serde_json::json;

use super::{ROBOTS, SOON, Secured, fleet_file, form, open_in, text};

/// Another fleet, whose robots have the same names, and a host that serves both.
const MORE: &str = r#"
[[fleets]]
fleet = "site-2"
robots = ["a1", "a2", "b1", "b2"]
operators = ["op"]

[[hosts]]
name = "base"
fleets = ["alpha", "site-*"]
"#;

const FLEETS: [&str; 2] = ["alpha", "site-2"];

impl Secured {
    /// Two fleets, and one process for the services of both.
    fn start_two_fleets() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = fleet_file(folder.path(), r#""a1", "a2", "b1", "b2""#, &["base"]);
        let members = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, members + MORE).unwrap();
        let mut secured = Self::start_routers(folder, &path, &["base"]);
        secured.start_host("first");
        secured
    }

    /// Starts one more process for the services of both fleets.
    fn start_host(&mut self, name: &str) {
        let (config, state) = (self.identity("host.base"), self.folder.path().join(name));
        let arguments = [
            "up",
            "--fleets",
            "alpha,site-*",
            "--zenoh-config",
            text(&config),
            "--state-directory",
            text(&state),
        ];
        let process = Process::start("muster", &arguments, &[], self.folder.path()).unwrap();
        self.services.push((name.to_owned(), process));
    }

    /// A member of one of the fleets.
    async fn member(&self, fleet: &str, name: &str) -> Client {
        let identity = match fleet {
            "alpha" => self.identity(name),
            other => self.identity(&format!("{name}.{other}")),
        };
        open_in(fleet, &identity, &[]).await.unwrap()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_host_serves_fleets_of_a_secured_bus_apart() {
    let mut secured = Secured::start_two_fleets();
    let (mut operators, mut robots, mut formed) = (Vec::new(), Vec::new(), Vec::new());
    for fleet in FLEETS {
        let operator = secured.member(fleet, "operator.op").await;
        let teams = operator.watch("json/teams").await.unwrap();
        let mut of_fleet = Vec::new();
        for (name, x) in ROBOTS {
            of_fleet.push((secured.member(fleet, &format!("robot.{name}")).await, x));
        }
        // A robot of a fleet that appears is served once it has a token or reports.
        formed.push(division(&form(&of_fleet, &teams).await));
        operators.push((operator, teams));
        robots.push(of_fleet);
    }

    // An operator commands its own fleet, under its own name.
    let config = secured.identity("operator.op.site-2");
    let common = ["--fleet", "site-2", "--zenoh-config", text(&config)];
    let set = [&["set", "clusterer", "hysteresis=0.06"][..], &common].concat();
    let (code, out, err) = run("muster", &set, SOON).unwrap();
    assert_eq!(code, Some(0), "{out}{err}");
    let settings = "service/clusterer/settings";
    assert_eq!(operators[1].0.get_one(settings).await.unwrap()["hysteresis"], 0.06);
    assert_eq!(operators[0].0.get_one(settings).await.unwrap()["hysteresis"], 0.05);

    // Members of the first have no rights in the second.
    let foreign = open_in("site-2", &secured.identity("operator.op"), &[]).await.unwrap();
    assert!(foreign.get("json/teams", None).await.unwrap().is_empty());
    let change = json!({"hysteresis": 0.5});
    assert!(foreign.get(settings, Some(&change)).await.unwrap().is_empty());
    let all = operators[1].0.watch("robot/a1/pose").await.unwrap();
    let seen = operators[0].0.watch("robot/a1/pose").await.unwrap();
    let (robot, _) = &robots[0][0];
    let intruder = robot.session();
    for _ in 0..5 {
        let pose = json!({"x": 7.0, "y": 7.0}).to_string();
        intruder.put("muster/v1/site-2/robot/a1/pose", pose.clone()).await.unwrap();
        intruder.put(robot.key("robot/a1/pose"), pose).await.unwrap();
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    seen.until("the same is allowed in the own fleet", SOON, |pose| pose["x"] == 7.0)
        .await
        .unwrap();
    assert!(all.all().is_empty(), "{:?}", all.all());

    // A robot learns what is refused of it, and of no other.
    let mine = robot.watch("robot/a1/refused").await.unwrap();
    let others = robots[0][1].0.watch("robot/a1/refused").await.unwrap();
    robot.put("robot/a1/pose", &json!({"x": "far", "y": 0.0})).await.unwrap();
    mine.until("the robot learns what is refused", SOON, |refused| refused["robot"] == "a1")
        .await
        .unwrap();
    assert!(others.all().is_empty(), "{:?}", others.all());

    // Another process with the same identity is a standby for both fleets.
    secured.start_host("second");
    let start = std::time::Instant::now();
    for (operator, _) in &operators {
        loop {
            let key = operator.key("service/clusterer/*");
            let found = operator.session().liveliness().get(key).await.unwrap();
            let mut instances = 0;
            while found.recv_async().await.is_ok() {
                instances += 1;
            }
            if instances == 2 {
                break;
            }
            assert!(start.elapsed() < SOON, "there are {instances} instances of the clusterer");
            super::put_poses(&robots[0]).await;
            super::put_poses(&robots[1]).await;
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }
    for _ in 0..30 {
        super::put_poses(&robots[0]).await;
        super::put_poses(&robots[1]).await;
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    secured.services.remove(0);
    for (at, (_, teams)) in operators.iter().enumerate() {
        teams.clear();
        let again = form(&robots[at], teams).await;
        assert_eq!(division(&again), formed[at], "{} after the first host died", FLEETS[at]);
    }
}
