//! Robots by the client crate on a bus with certificates and rules.

use std::time::{Duration, Instant};

use muster_client::model::teams::RobotTeam;
use muster_client::{Config, Error, Pose, Robot, Watch};
use tokio::time::{sleep, timeout};

use super::{SOON, Secured};

/// Waits until the team of a robot has these members.
async fn formed(team: &mut Watch<RobotTeam>, wanted: &[&str]) {
    let waiting = async {
        loop {
            let latest = team.changed().await.unwrap();
            let members: Vec<_> = latest.members.iter().flatten().map(|id| id.as_str()).collect();
            if members == wanted {
                return;
            }
        }
    };
    timeout(SOON, waiting).await.unwrap_or_else(|_| panic!("{:?}", team.latest()));
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_by_the_client_crate_belong_by_their_certificates() {
    let secured = Secured::start(&["base"]);
    let config = |robot: &str| Config {
        fleet: "alpha".to_owned(),
        zenoh_config: Some(secured.identity(&format!("robot.{robot}"))),
        connect_timeout: Some(SOON),
        ..Config::default()
    };
    let mut robots = Vec::new();
    for (name, x) in [("a1", 0.0), ("a2", 3.0), ("b1", 90.0), ("b2", 93.0)] {
        robots.push((Robot::join(&config(name), name).await.unwrap(), x));
    }
    let moving = async {
        loop {
            for (robot, x) in &robots {
                robot.put_pose(Pose::at(*x, 0.0)).unwrap();
            }
            sleep(Duration::from_millis(100)).await;
        }
    };
    let (mut of_first, mut of_last) = (robots[0].0.team(), robots[3].0.team());
    let all_formed = async {
        formed(&mut of_first, &["a1", "a2"]).await;
        formed(&mut of_last, &["b1", "b2"]).await;
    };
    tokio::select! {
        () = all_formed => {}
        () = moving => {}
    }
    // A copy of a robot's certificate does not give two processes the same name unnoticed.
    let copy = Robot::join(&config("a1"), "a1").await.unwrap_err();
    assert!(matches!(copy, Error::Taken { .. }), "{copy}");
    // With the certificate of another, a robot receives nothing and is invisible.
    let posing = Robot::join(&config("b1"), "absent").await.unwrap();
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(3) {
        posing.put_pose(Pose::at(6.0, 0.0)).unwrap();
        for (robot, x) in &robots {
            robot.put_pose(Pose::at(*x, 0.0)).unwrap();
        }
        sleep(Duration::from_millis(100)).await;
    }
    assert!(posing.team().latest().is_none());
    let members = of_first.latest().unwrap().members.clone();
    assert_eq!(members.iter().flatten().count(), 2, "{members:?}");
}
