//! Everything at the base stops at once and is started again with its disks: ids and members stand.

use std::collections::BTreeSet;
use std::time::Duration;

use muster_tests::access::Security;
use muster_tests::client::{Client, Watch, division};
use muster_tests::cluster::{Cluster, ClusterOptions, SERVICES, robots_of};
use muster_tests::process::Process;
use serde_json::json;

use crate::pipeline::{FORMED_WITHIN, formed, truth};
use crate::restarts::{now, stage};

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "4", "--robots", "16"];

/// Robots that were never there, with their places along the x axis in metres.
const NEW_ROBOTS: [(&str, f64); 3] = [("n1", 3000.0), ("n2", 3002.0), ("n3", 3004.0)];

/// How soon there are teams from fresh data after the start: the robots connect again within two seconds, and
/// are awaited for three.
const BACK_WITHIN: Duration = Duration::from_secs(15);

/// The ids of all divisions that have arrived.
fn ids(teams: &Watch) -> BTreeSet<String> {
    teams.all().iter().flat_map(|(_, value)| division(value).into_values().flatten()).collect()
}

/// Stops all services and the router, and starts them again.
async fn power_cut(test: &str, is_polite: bool) {
    let new = NEW_ROBOTS.map(|(robot, _)| robot.to_owned());
    let all: Vec<String> = robots_of(&SCENARIO).unwrap().into_keys().chain(new).collect();
    let security = Security::drawn(test).unwrap();
    let options = ClusterOptions { security, robots: &all, ..ClusterOptions::default() };
    let mut cluster = Cluster::start_by(&options).unwrap();
    let camps = truth(&cluster, &SCENARIO);
    let client = cluster.client().await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let names: Vec<&String> = camps.values().collect::<BTreeSet<_>>().into_iter().collect();
    assert_eq!(names.len(), 4);
    // The camps come one after the other, so that their ids are not those of a first division.
    let mut robots = Vec::new();
    for camp in [names[2], names[3], names[0], names[1]] {
        let of_camp = camps.iter().filter(|(_, other)| *other == camp);
        let only: Vec<&str> = of_camp.map(|(robot, _)| robot.as_str()).collect();
        robots
            .push(cluster.robots(&[&SCENARIO[..], &["--only", &only.join(",")]].concat()).unwrap());
        let known =
            |value: &serde_json::Value| only.iter().all(|r| division(value).contains_key(*r));
        teams.until("the camp is there", FORMED_WITHIN, known).await.unwrap();
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
    let wanted = formed(&client, &camps).await;
    tokio::time::sleep(Duration::from_secs(3)).await;
    assert_eq!(division(&teams.newest().unwrap()), wanted);
    let used = ids(&teams);

    for service in SERVICES {
        let process: &mut Process = cluster.service(service).unwrap();
        if is_polite {
            process.signal("TERM").unwrap();
        } else {
            process.kill().unwrap();
        }
    }
    cluster.kill_router().unwrap();
    for service in SERVICES {
        cluster.service(service).unwrap().wait(Duration::from_secs(10)).unwrap();
    }
    drop(client);
    let since = now();
    cluster.restart_router().unwrap();
    for service in SERVICES {
        cluster.start_service(service).unwrap();
    }
    let client = cluster.client().await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let robot_teams = client.watch("robot/*/team").await.unwrap();
    let fresh = |value: &serde_json::Value| {
        stage(value, "ingest") > since && division(value).len() == wanted.len()
    };
    teams.until("teams from fresh data", BACK_WITHIN, fresh).await.unwrap();
    tokio::time::sleep(Duration::from_secs(2)).await;
    for (_, value) in teams.all() {
        let same = division(&value).iter().all(|(robot, team)| *team == wanted[robot]);
        assert!(same, "wanted {wanted:?}, and there is {value}");
    }
    for (_, value) in robot_teams.all() {
        let robot = value["robot"].as_str().unwrap();
        assert_eq!(value["team"].as_str(), wanted[robot].as_deref(), "{robot} is told {value}");
    }

    // A team of robots that were never there gets an id that was never used.
    let change = json!({"teams": 5});
    client.get("service/clusterer/settings", Some(&change)).await.unwrap();
    let new_team = |value: &serde_json::Value| {
        let teams = division(value);
        let new: BTreeSet<_> = NEW_ROBOTS.iter().map(|(robot, _)| teams.get(*robot)).collect();
        let id = new.first().copied().flatten().cloned().flatten();
        id.filter(|id| new.len() == 1 && !wanted.values().flatten().any(|other| other == id))
    };
    let mut found = None;
    let mut new_robots: Vec<(Client, &str, f64)> = Vec::new();
    for (robot, x) in NEW_ROBOTS {
        let member = cluster.member(&format!("robot.{robot}"), &cluster.endpoint, "10000").await;
        new_robots.push((member.unwrap(), robot, x));
    }
    for _ in 0..150 {
        for (client, robot, x) in &new_robots {
            let pose = json!({"x": x, "y": 3000.0});
            client.put(&format!("robot/{robot}/pose"), &pose).await.unwrap();
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
        found = teams.newest().as_ref().and_then(new_team);
        if found.is_some() {
            break;
        }
    }
    let id = found.expect("the new robots are a team");
    assert!(!used.contains(&id), "{id} was used before: {used:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn ids_and_members_stand_after_a_stop_of_everything() {
    power_cut("a_stop_of_everything", true).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn ids_and_members_stand_after_a_power_cut_of_everything() {
    power_cut("a_power_cut_of_everything", false).await;
}
