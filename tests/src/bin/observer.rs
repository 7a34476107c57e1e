//! What a user sees on one host: a plain Zenoh client that prints every message with the moment of
//! its arrival, one JSON object a line, for the tests with several hosts.
//!
//! `observer ENDPOINT FLEET [all]` prints the division, the events, and the teams of robots; with `all`
//! also how long each pose was on its way, and twice a second the answer to a get of the division.

use std::io::Write as _;
use std::time::Duration;

use anyhow::Context;
use muster_tests::client::{Client, now};
use serde_json::{Value, json};
use tokio::sync::mpsc;

/// How often the division is asked for.
const ASK_EVERY: Duration = Duration::from_millis(500);

/// How long an answer may take.
const ANSWER_WITHIN: Duration = Duration::from_secs(1);

/// Lines that may wait to be printed: seconds of the busiest fleet of these tests.
const MAX_WAITING_LINES: usize = 10_000;

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let endpoint = arguments.next().context("observer ENDPOINT FLEET: the endpoint is missing")?;
    let fleet = arguments.next().context("observer ENDPOINT FLEET: the fleet is missing")?;
    let client = Client::connect_for_ever(&endpoint, &fleet).await?;
    let (lines, mut waiting) = mpsc::channel::<Value>(MAX_WAITING_LINES);
    for tail in ["json/teams", "json/event", "robot/*/team"] {
        let lines = lines.clone();
        client
            .listen(tail, move |key, value| {
                let _ = lines.try_send(json!({"at": now(), "key": key, "value": value}));
            })
            .await?;
    }
    if arguments.next().is_some_and(|what| what == "all") {
        let poses = lines.clone();
        client
            .listen("robot/*/pose", move |key, value| {
                let late = value["stamp"].as_f64().map(|stamp| now() - stamp);
                let _ = poses.try_send(json!({"at": now(), "key": key, "late": late}));
            })
            .await?;
        tokio::spawn(ask(client.clone(), lines.clone()));
    }
    let mut out = std::io::stdout();
    while let Some(line) = waiting.recv().await {
        writeln!(out, "{line}")?;
    }
    Ok(())
}

/// Asks for the division again and again.
async fn ask(client: Client, lines: mpsc::Sender<Value>) {
    loop {
        let at = now();
        let answers = client.get_within("teams?format=json", None, ANSWER_WITHIN).await;
        let good = answers.unwrap_or_default().into_iter().find_map(|(_, answer)| answer.ok());
        let line = json!({"at": at, "key": "get", "took": now() - at, "value": good});
        let _ = lines.send(line).await;
        tokio::time::sleep(ASK_EVERY).await;
    }
}
