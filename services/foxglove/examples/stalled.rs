//! What a viewer that reads nothing costs: a server as this program runs it, scenes of 10,000 robots ten times a second, one
//! viewer that follows everything and then stops, and the memory of the process before and after.
//!
//! `cargo run --release --package muster-foxglove --no-default-features --features messages --example stalled`

#![allow(clippy::unwrap_used, reason = "a measurement fails by panicking")]

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use foxglove::{ChannelBuilder, Context, PartialMetadata, RawChannel, WebSocketServer};
use futures_util::{SinkExt as _, StreamExt as _};
use muster_foxglove::limits::MAX_WAITING_MESSAGES;
use muster_foxglove::messages::{bytes, form, nanoseconds};
use muster_foxglove::{Access, Bridge, Input, Output, Topic};
use muster_model::id::{FleetId, Modality};
use muster_model::time::Tick;
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::http::HeaderValue;

#[path = "../tests/fleet/mod.rs"]
mod fleet;

const ROBOTS: u32 = 10_000;
const TEAMS: u32 = 50;
const TURNS: u64 = 200;
const TURN: Duration = Duration::from_millis(100);

/// Kilobytes of memory that this process has.
fn resident_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or_default()
}

/// Follows all channels, and then reads nothing any more: what it returns holds the connection.
async fn stall(port: u16, channels: usize) -> anyhow::Result<impl Sized> {
    let stream = TcpStream::connect(("127.0.0.1", port)).await?;
    let mut request = format!("ws://127.0.0.1:{port}").into_client_request()?;
    let protocol = HeaderValue::from_static("foxglove.sdk.v1");
    request.headers_mut().insert("Sec-WebSocket-Protocol", protocol);
    let (mut socket, _) = tokio_tungstenite::client_async(request, stream).await?;
    let mut ids: Vec<u64> = Vec::new();
    while ids.len() < channels {
        let Some(Ok(Message::Text(text))) = socket.next().await else { continue };
        let message: serde_json::Value = serde_json::from_str(&text)?;
        let advertised = message["channels"].as_array().into_iter().flatten();
        ids.extend(advertised.filter_map(|channel| channel["id"].as_u64()));
    }
    let subscriptions: Vec<_> =
        ids.iter().map(|id| serde_json::json!({"id": id, "channelId": id})).collect();
    let subscribe = serde_json::json!({"op": "subscribe", "subscriptions": subscriptions});
    socket.send(Message::text(subscribe.to_string())).await?;
    Ok(socket)
}

/// Sends scenes for a while, and returns the slowest turn.
async fn send(
    bridge: &mut Bridge,
    channels: &BTreeMap<Topic, Arc<RawChannel>>,
    turns: std::ops::Range<u64>,
) -> Duration {
    let mut slowest = Duration::ZERO;
    let mut ticks = tokio::time::interval(TURN);
    for turn in turns {
        ticks.tick().await;
        let now = Tick(1_000_000_000 + turn * 100_000);
        let roster = Arc::new(fleet::roster(ROBOTS, turn));
        let start = Instant::now();
        bridge.handle(now, Input::Roster(roster, None));
        for output in bridge.handle(now, Input::Tick) {
            if let Output::Send(topic, message) = output
                && let (Some(channel), Some(bytes)) = (channels.get(&topic), bytes(message, now))
            {
                channel.log_with_meta(&bytes, PartialMetadata::with_log_time(nanoseconds(now)));
            }
        }
        slowest = slowest.max(start.elapsed());
    }
    slowest
}

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let context = Context::new();
    let server = WebSocketServer::new()
        .bind("127.0.0.1", 0)
        .message_backlog_size(MAX_WAITING_MESSAGES)
        .context(&context)
        .start()
        .await?;
    let all = [Topic::Transforms, Topic::Teams, Topic::Links(Modality::spatial())];
    let mut channels = BTreeMap::new();
    for topic in all.clone() {
        let form = form(&topic);
        let builder = ChannelBuilder::new(topic.name()).context(&context).schema(form.schema);
        channels.insert(topic, builder.message_encoding(form.encoding).build_raw()?);
    }
    let mut bridge = Bridge::new(FleetId::new("grid")?, Access::ReadOnly);
    let begin = Tick(1_000_000_000);
    bridge.handle(begin, Input::Link(true));
    bridge.handle(begin, Input::Teams(fleet::teams(ROBOTS, TEAMS), None));
    bridge.handle(begin, Input::Watched(BTreeSet::from(all)));
    bridge.handle(begin, Input::Graph(fleet::graph(ROBOTS, 1)));
    send(&mut bridge, &channels, 1..TURNS).await;
    let alone = resident_kb();
    let stalled = stall(server.port(), channels.len()).await?;
    let slowest = send(&mut bridge, &channels, TURNS..3 * TURNS).await;
    let with = resident_kb();
    println!(
        "without a viewer {alone} kB, with one that reads nothing {with} kB: {:.1} MiB; slowest turn {slowest:?}",
        with.saturating_sub(alone) as f64 / 1024.0
    );
    drop(stalled);
    Ok(())
}
