//! Robots that run ROS 2 by hiroz: `muster-hiroz ENDPOINT NAME:X:Y …`
//!
//! Each robot publishes `nav_msgs/Odometry` on `/NAME/odom` ten times a second, in the frame `map`, and reads its team on
//! `/NAME/team`. It ends with 0 once robots whose names begin alike have one team and others another, and with 1 if that takes
//! a minute.

use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use hiroz::context::ZContextBuilder;
use hiroz::{Builder, Result};
use hiroz_msgs::nav_msgs::Odometry;
use hiroz_msgs::std_msgs::String as Text;

const WITHIN: Duration = Duration::from_secs(60);

/// Whether robots whose names begin alike, and only those, have one team.
fn is_divided(teams: &BTreeMap<String, String>, robots: usize) -> bool {
    let alike = |one: &str, other: &str| one.chars().next() == other.chars().next();
    teams.len() == robots
        && teams.iter().all(|(robot, team)| {
            teams.iter().all(|(other, its)| alike(robot, other) == (team == its))
        })
}

#[tokio::main]
async fn main() -> Result<ExitCode> {
    let mut arguments = std::env::args().skip(1);
    let endpoint = arguments.next().ok_or("name an endpoint")?;
    let context =
        ZContextBuilder::default().with_mode("peer").with_connect_endpoints([endpoint]).build()?;
    let teams = Arc::new(Mutex::new(BTreeMap::new()));
    let mut robots = Vec::new();
    for text in arguments {
        let parts: Vec<&str> = text.split(':').collect();
        let [name, x, y] = parts[..] else { return Err("a robot is NAME:X:Y".into()) };
        let node = context.create_node(format!("driver_{name}")).build()?;
        let publisher = node.create_pub::<Odometry>(&format!("/{name}/odom")).build()?;
        let subscriber = node.create_sub::<Text>(&format!("/{name}/team")).build()?;
        let (teams, name) = (Arc::clone(&teams), name.to_owned());
        tokio::spawn(async move {
            while let Ok(message) = subscriber.async_recv().await {
                let json: serde_json::Value =
                    serde_json::from_str(&message.data).unwrap_or_default();
                if let (Some(team), Ok(mut teams)) = (json["team"].as_str(), teams.lock()) {
                    teams.insert(name.clone(), team.to_owned());
                }
            }
        });
        let mut message = Odometry::default();
        message.header.frame_id = "map".into();
        message.child_frame_id = "base_link".into();
        (message.pose.pose.position.x, message.pose.pose.position.y) = (x.parse()?, y.parse()?);
        message.pose.pose.orientation.w = 1.0;
        robots.push((node, publisher, message));
    }
    let start = Instant::now();
    while start.elapsed() < WITHIN {
        for (_, publisher, message) in &robots {
            publisher.async_publish(message).await?;
        }
        if teams.lock().is_ok_and(|teams| is_divided(&teams, robots.len())) {
            println!("divided: {:?}", teams.lock());
            return Ok(ExitCode::SUCCESS);
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    println!("not divided within {WITHIN:?}: {:?}", teams.lock());
    Ok(ExitCode::FAILURE)
}
