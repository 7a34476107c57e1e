//! What a stranger puts on the bus: garbage, tokens and poses.

use std::time::Duration;

use serde_json::json;
use tokio::time::sleep;

use super::plan::Kind;
use crate::client::Client;
use crate::simulation::chance::{Chance, Purpose};

/// What every garbage ends with, by which observers know that no service has put it.
const GARBAGE_MARK: &[u8] = b"~garbage~";

/// How long a stranger waits between two puts: some hundreds a second.
const PUT_EVERY: Duration = Duration::from_millis(3);

/// Sizes of garbage in bytes, small ones more often: the last is more than any report may have.
const GARBAGE_BYTES: [usize; 8] = [0, 1, 20, 200, 200, 2000, 20_000, 400_000];

/// Whether a payload is garbage of this module.
pub(super) fn is_garbage(payload: &[u8]) -> bool {
    payload.ends_with(GARBAGE_MARK)
}

/// Keys of a fleet, and of a robot of it.
fn keys(robot: &str) -> Vec<String> {
    let mut keys: Vec<String> = [
        "roster",
        "embedding",
        "teams",
        "audit",
        "event",
        "json/teams",
        "json/audit",
        "json/event",
        "graph/spatial",
        "graph/nonsense",
        "service/clusterer/settings",
        "service/ingest/status",
        "service/embedder/holder",
        "x/y/z",
    ]
    .map(str::to_owned)
    .to_vec();
    for stream in ["pose", "links", "rank", "relation/thermal", "poze", "team"] {
        keys.push(format!("robot/{robot}/{stream}"));
        keys.push(format!("robot/ghost/{stream}"));
    }
    keys
}

/// Floods the bus until it is aborted. `robot` is one of the fleet, `place` where it is.
///
/// # Errors
/// If the session is closed.
pub(super) async fn flood(
    client: Client,
    kind: Kind,
    seed: u64,
    robot: String,
    place: [f64; 3],
) -> anyhow::Result<()> {
    let mut chance = Chance::new(seed, Purpose::Soak, 2);
    match kind {
        Kind::Tokens { robots } => {
            let mut tokens = Vec::new();
            for number in 0..robots {
                tokens.push(client.token(&format!("robot/stranger-{number}")).await?);
            }
            // They are dropped with this future.
            std::future::pending::<()>().await;
            drop(tokens);
            Ok(())
        }
        Kind::Poses { robots } => loop {
            for number in 0..robots {
                let (x, y) = (place[0] + chance.real(-1.0, 1.0), place[1] + chance.real(-1.0, 1.0));
                let pose = json!({"x": x, "y": y});
                client.put(&format!("robot/stranger-{number}/pose"), &pose).await?;
                sleep(PUT_EVERY).await;
            }
        },
        _ => loop {
            for key in keys(&robot) {
                let size = GARBAGE_BYTES[chance.below(GARBAGE_BYTES.len())];
                let mut payload = chance.bytes(size);
                if chance.percent(50) {
                    // What begins like a binary message of some kind.
                    payload.splice(0..0, [0xB7, 1, chance.bytes(1)[0] % 16]);
                }
                payload.extend(GARBAGE_MARK);
                let encodings = ["application/json", "application/octet-stream;bincode", "", "x"];
                let encoding = encodings[chance.below(encodings.len())];
                client.put_bytes(&key, payload, encoding).await?;
                sleep(PUT_EVERY).await;
            }
        },
    }
}
