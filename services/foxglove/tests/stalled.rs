//! What a viewer that reads nothing costs: a server as this program runs it, scenes of 10,000 robots, one viewer that
//! follows everything and then stops, and the memory of the process before and after.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

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

mod fleet;

const ROBOTS: u32 = 10_000;
const TEAMS: u32 = 50;

/// Turns without a viewer, after which the process has all that it needs for itself.
const TURNS_ALONE: u64 = 20;

/// Turns with the viewer.
const TURNS: u64 = 60;

/// What a viewer may cost in kilobytes: 32 MiB.
const MOST_KB: u64 = 32 * 1024;

/// What must have been sent for more than that to wait if nothing were left out: the sockets take up to 10 MB of it.
const LEAST_SENT: usize = 96 * 1024 * 1024;

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

/// Sends scenes, and returns how many bytes they have.
async fn send(
    bridge: &mut Bridge,
    channels: &BTreeMap<Topic, Arc<RawChannel>>,
    turns: std::ops::Range<u64>,
) -> usize {
    let mut sent = 0;
    for turn in turns {
        let now = Tick(1_000_000_000 + turn * 100_000);
        let roster = Arc::new(fleet::roster(ROBOTS, turn));
        bridge.handle(now, Input::Roster(roster, None));
        for output in bridge.handle(now, Input::Tick) {
            if let Output::Send(topic, message) = output
                && let (Some(channel), Some(bytes)) = (channels.get(&topic), bytes(message, now))
            {
                sent += bytes.len();
                channel.log_with_meta(&bytes, PartialMetadata::with_log_time(nanoseconds(now)));
            }
        }
        // The server sends while this one waits.
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    sent
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_that_reads_nothing_costs_no_more_than_its_queue() {
    let context = Context::new();
    let server = WebSocketServer::new()
        .bind("127.0.0.1", 0)
        .message_backlog_size(MAX_WAITING_MESSAGES)
        .context(&context)
        .start()
        .await
        .unwrap();
    let all = [Topic::Transforms, Topic::Teams, Topic::Links(Modality::spatial())];
    let mut channels = BTreeMap::new();
    for topic in all.clone() {
        let form = form(&topic);
        let builder = ChannelBuilder::new(topic.name()).context(&context).schema(form.schema);
        channels.insert(topic, builder.message_encoding(form.encoding).build_raw().unwrap());
    }
    let mut bridge = Bridge::new(FleetId::new("grid").unwrap(), Access::ReadOnly);
    let begin = Tick(1_000_000_000);
    bridge.handle(begin, Input::Link(true));
    bridge.handle(begin, Input::Teams(fleet::teams(ROBOTS, TEAMS), None));
    bridge.handle(begin, Input::Watched(BTreeSet::from(all)));
    bridge.handle(begin, Input::Graph(fleet::graph(ROBOTS, 1)));
    send(&mut bridge, &channels, 1..TURNS_ALONE).await;
    let alone = resident_kb();
    let stalled = stall(server.port(), channels.len()).await.unwrap();
    while !channels.values().all(|channel| channel.has_sinks()) {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    let sent = send(&mut bridge, &channels, TURNS_ALONE..TURNS_ALONE + TURNS).await;
    let with = resident_kb();
    let cost = with.saturating_sub(alone);
    println!(
        "{sent} bytes sent; without a viewer {alone} kB, with one that reads nothing {cost} kB more"
    );
    assert!(sent > LEAST_SENT, "{sent} bytes would fit into the sockets");
    assert!(cost < MOST_KB, "{cost} kB");
    drop(stalled);
}
