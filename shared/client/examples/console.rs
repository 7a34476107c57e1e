//! A console: prints the settings of `clusterer`, then every change of the division and every event.
//!
//! ```sh
//! cargo run -p muster-client --example console
//! ```

use std::pin::pin;
use std::time::Duration;

use futures_util::StreamExt as _;
use muster_client::model::id::ServiceName;
use muster_client::model::teams::Teams;
use muster_client::{Change, Client, Config, Error, Latest};

const USAGE: &str = "usage: console
environment: MUSTER_FLEET, MUSTER_CONNECT, MUSTER_ZENOH_CONFIG";

fn print(division: &Latest<Teams>) {
    let stale = division.stale.map_or(String::new(), |why| format!(" (stale: {why:?})"));
    println!("division {:?}{stale}", division.header.revision);
    for team in &division.teams {
        let members: Vec<_> = team.members.iter().map(|member| member.robot.as_str()).collect();
        println!("  {} led by {}: {}", team.id, team.leader, members.join(" "));
    }
}

async fn look() -> Result<(), Error> {
    let connect_timeout = Some(Duration::from_secs(5));
    let client = Client::open(&Config { connect_timeout, ..Config::from_env() }).await?;
    match client.get_settings(ServiceName::Clusterer).await {
        Ok(settings) => println!("settings of clusterer: {settings}"),
        Err(error) => eprintln!("{error}"),
    }
    let mut changes = client.changes().await?;
    let mut verdict = None;
    // One future for the whole loop: a signal that comes between two would be lost.
    let mut interrupted = pin!(tokio::signal::ctrl_c());
    loop {
        tokio::select! {
            Some(change) = changes.next() => match change {
                Change::Teams(division) => print(&division),
                Change::Audit(audit) => if verdict.replace(audit.quality) != Some(audit.quality) {
                    println!("verdict: {:?}", audit.quality);
                }
                Change::Event(event) => println!("{:?}", event.kind),
                link => println!("{link:?}"),
            },
            _ = &mut interrupted => break,
        }
    }
    client.close().await;
    Ok(())
}

#[tokio::main]
async fn main() -> std::process::ExitCode {
    let log = tracing_subscriber::fmt().with_max_level(tracing::Level::WARN);
    log.with_writer(std::io::stderr).init();
    if std::env::args().len() > 1 {
        eprintln!("{USAGE}");
        return 2.into();
    }
    match look().await {
        Ok(()) => 0.into(),
        Err(error) => {
            eprintln!("error: {error}");
            1.into()
        }
    }
}
