//! A robot that drives in a circle and prints its team whenever that changes.
//!
//! ```sh
//! cargo run -p muster-client --example robot -- r1
//! MUSTER_FLEET=alpha MUSTER_CONNECT=tcp/10.0.0.1:7447 cargo run -p muster-client --example robot -- r2 50 0 r1
//! ```

use std::pin::pin;
use std::time::Duration;

use muster_client::model::teams::RobotTeam;
use muster_client::{Config, Error, Latest, Pose, Robot};
use tokio::time::{Instant, interval};

const USAGE: &str = "usage: robot ID [X Y [SUPERIOR]]
  ID        the robot: a-z 0-9 _ -
  X Y       the middle of its circle in metres; 0 0 if left out
  SUPERIOR  its superior; none if left out
environment: MUSTER_FLEET, MUSTER_CONNECT, MUSTER_ZENOH_CONFIG";

/// Radius of the circle in metres.
const RADIUS_M: f64 = 1.0;

/// Time for one round in seconds.
const ROUND_S: f64 = 20.0;

fn print(latest: &Latest<RobotTeam>) {
    let stale = latest.stale.map_or(String::new(), |why| format!(" (stale: {why:?})"));
    match (&latest.team, &latest.members, &latest.leader) {
        (Some(team), Some(members), Some(leader)) => {
            let names: Vec<_> = members.iter().map(ToString::to_string).collect();
            println!("team {team}, led by {leader}: {}{stale}", names.join(" "));
        }
        (Some(team), ..) => println!("team {team}, too large to name all{stale}"),
        (None, ..) => println!("no team: nothing relates this robot to others{stale}"),
    }
}

async fn drive(id: &str, middle: (f64, f64), superior: Option<&str>) -> Result<(), Error> {
    let robot = Robot::join(&Config::from_env(), id).await?;
    println!("{id} has joined");
    robot.put_rank(superior)?;
    let mut team = robot.team();
    let mut ticks = interval(Duration::from_millis(100));
    let start = Instant::now();
    // One future for the whole loop: a signal that comes between two would be lost.
    let mut interrupted = pin!(tokio::signal::ctrl_c());
    loop {
        tokio::select! {
            _ = ticks.tick() => {
                let angle = start.elapsed().as_secs_f64() / ROUND_S * std::f64::consts::TAU;
                let (x, y) = (middle.0 + RADIUS_M * angle.cos(), middle.1 + RADIUS_M * angle.sin());
                robot.put_pose(Pose { heading: Some(angle), ..Pose::at(x, y) })?;
            }
            latest = team.changed() => print(&latest?),
            _ = &mut interrupted => break,
        }
    }
    robot.leave().await;
    Ok(())
}

#[tokio::main]
async fn main() -> std::process::ExitCode {
    let log = tracing_subscriber::fmt().with_max_level(tracing::Level::WARN);
    log.with_writer(std::io::stderr).init();
    let args: Vec<String> = std::env::args().skip(1).collect();
    let number = |at: usize| args.get(at).map_or(Ok(0.0), |text| text.parse::<f64>());
    let help = args.is_empty() || args.len() > 4 || args.iter().any(|arg| arg == "--help");
    let (Ok(x), Ok(y), false) = (number(1), number(2), help) else {
        eprintln!("{USAGE}");
        return 2.into();
    };
    match drive(&args[0], (x, y), args.get(3).map(String::as_str)).await {
        Ok(()) => 0.into(),
        Err(error) => {
            eprintln!("error: {error}");
            1.into()
        }
    }
}
