//! What a robot or console receives of a fleet, with the moment of its arrival.
//!
//! The callbacks of the bus only note the moment and pass the bytes on; a thread of its own reads them
//! and keeps what the measurement needs, so that the listener neither holds up the bus nor grows with
//! the fleet's messages.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};

use muster_model::audit::Audit;
use muster_model::embedding::{Embedding, EmbeddingMode};
use muster_model::header::Header;
use muster_model::id::ServiceName;
use muster_model::roster::Roster;
use muster_model::teams::Teams;
use muster_wire::envelope;
use serde_json::Value;
use zenoh::bytes::ZBytes;

use super::follow::{Division, Frames, Stage, TeamMessage};
use super::{now_us, robot_of};
use crate::client::Client;

/// Messages that wait to be read: seconds of the busiest fleet.
const MAX_WAITING_MESSAGES: usize = 1 << 17;

/// An embedding that was received.
#[derive(Debug, Clone)]
pub struct Embedded {
    /// Which way it was computed.
    pub mode: EmbeddingMode,
    /// The length of a robot's vector.
    pub dimension: u32,
    /// Milliseconds for fusing and the spectral radius, the similarity, and the decomposition.
    pub stage_ms: [f64; 3],
    /// How exact it is.
    pub residual: f64,
}

/// A received audit: when its division was published, and its own stage.
#[derive(Debug, Clone, Copy)]
pub struct AuditTimes {
    /// When the division was published.
    pub divided: u64,
    /// That of `auditor`.
    pub stage: Stage,
}

/// All that was received since [`Listener::begin`].
#[derive(Debug, Default)]
pub struct Received {
    /// What each frame holds.
    pub frames: Frames,
    /// In the order of arrival.
    pub divisions: Vec<Division>,
    /// In the order of arrival.
    pub embeddings: Vec<Embedded>,
    /// In the order of arrival.
    pub audits: Vec<AuditTimes>,
    /// In the order of arrival.
    pub team_messages: Vec<TeamMessage>,
    /// Messages that could not be decoded, or found a full queue.
    pub lost: u64,
}

/// Listens to one fleet.
#[derive(Debug)]
pub struct Listener(Arc<Mutex<Received>>);

/// What a message is.
#[derive(Debug, Clone, Copy)]
enum Kind {
    Roster,
    Embedding,
    Teams,
    Audit,
    TeamMessage,
}

const KINDS: [(&str, Kind); 5] = [
    ("roster", Kind::Roster),
    ("embedding", Kind::Embedding),
    ("teams", Kind::Teams),
    ("audit", Kind::Audit),
    ("robot/*/team", Kind::TeamMessage),
];

fn lock(received: &Mutex<Received>) -> MutexGuard<'_, Received> {
    received.lock().unwrap_or_else(PoisonError::into_inner)
}

fn stage(header: &Header, of: ServiceName) -> Option<Stage> {
    let stage = header.stages.iter().find(|stage| stage.stage == of)?;
    Some((stage.received.0, stage.published.0))
}

impl Listener {
    /// Listens to a fleet of so many robots.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn start(client: &Client, robots: usize) -> anyhow::Result<Self> {
        let received = Arc::new(Mutex::new(Received::default()));
        let (sender, receiver) = mpsc::sync_channel::<(u64, Kind, ZBytes)>(MAX_WAITING_MESSAGES);
        for (tail, kind) in KINDS {
            let (sender, received) = (sender.clone(), Arc::clone(&received));
            client
                .session()
                .declare_subscriber(client.key(tail))
                .callback(move |sample| {
                    if sender.try_send((now_us(), kind, sample.payload().clone())).is_err() {
                        lock(&received).lost += 1;
                    }
                })
                .background()
                .await
                .map_err(|error| anyhow::anyhow!("{tail}: {error}"))?;
        }
        let reading = Arc::clone(&received);
        std::thread::Builder::new().name("reader".to_owned()).spawn(move || {
            for (arrived, kind, payload) in receiver {
                let taken = take(&reading, arrived, kind, &payload.to_bytes(), robots);
                lock(&reading).lost += u64::from(taken.is_none());
            }
        })?;
        Ok(Self(received))
    }

    /// Forgets everything but the frames, which later divisions may name.
    pub fn begin(&self) {
        let mut received = lock(&self.0);
        let frames = std::mem::take(&mut received.frames);
        *received = Received { frames, ..Received::default() };
    }

    /// The newest division.
    #[must_use]
    pub fn newest(&self) -> Option<Division> {
        lock(&self.0).divisions.last().cloned()
    }

    /// The number of the last pose of each robot that the newest division contains.
    #[must_use]
    pub fn covered(&self) -> Vec<Option<u64>> {
        let received = lock(&self.0);
        let frame =
            received.divisions.last().and_then(|last| received.frames.get(&last.stages[0].1));
        frame.into_iter().flatten().map(|newest| newest.map(|(number, _)| number)).collect()
    }

    /// Hands over all that was received, and forgets it.
    #[must_use]
    pub fn take(&self) -> Received {
        std::mem::take(&mut *lock(&self.0))
    }
}

/// Reads a message; none if it is not what it should be.
fn take(
    received: &Mutex<Received>,
    arrived: u64,
    kind: Kind,
    bytes: &[u8],
    robots: usize,
) -> Option<()> {
    match kind {
        Kind::Roster => {
            let roster: Roster = envelope::decode(bytes).ok()?;
            let made = stage(&roster.header, ServiceName::Ingest)?.1;
            let mut newest = vec![None; robots];
            for entry in &roster.robots {
                // The heading of a pose is its number.
                let number = entry.heading.filter(|number| *number >= 0.0);
                if let Some(place) = newest.get_mut(robot_of(entry.robot.as_str())?) {
                    *place = number.map(|number| (number as u64, entry.last_seen.0));
                }
            }
            lock(received).frames.insert(made, newest);
        }
        Kind::Embedding => {
            let embedding: Embedding = envelope::decode(bytes).ok()?;
            let quality = embedding.quality;
            lock(received).embeddings.push(Embedded {
                mode: quality.mode,
                dimension: embedding.dimension,
                stage_ms: quality.stage_us.map(|us| us as f64 / 1e3),
                residual: quality.residual,
            });
        }
        Kind::Teams => {
            let teams: Teams = envelope::decode(bytes).ok()?;
            let stages = [ServiceName::Ingest, ServiceName::Embedder, ServiceName::Clusterer];
            let [Some(ingest), Some(embedder), Some(clusterer)] =
                stages.map(|service| stage(&teams.header, service))
            else {
                return None;
            };
            lock(received).divisions.push(Division {
                arrived,
                stages: [ingest, embedder, clusterer],
                oldest: teams.header.oldest.map(|oldest| oldest.0),
                robots: teams.assignments().count() + teams.unassigned.len(),
                unassigned: teams.unassigned.len(),
                stale: teams.stale.len(),
            });
        }
        Kind::Audit => {
            let audit: Audit = envelope::decode(bytes).ok()?;
            let divided = stage(&audit.header, ServiceName::Clusterer)?.1;
            let stage = stage(&audit.header, ServiceName::Auditor)?;
            lock(received).audits.push(AuditTimes { divided, stage });
        }
        Kind::TeamMessage => {
            let value: Value = serde_json::from_slice(bytes).ok()?;
            let stages = value["stages"].as_array()?;
            let ingest = stages.iter().find(|stage| stage["stage"] == "ingest")?;
            // Seconds since 1970 as a double resolve microseconds until the year 2255.
            let frame = (ingest["published"].as_f64()? * 1e6).round() as u64;
            lock(received).team_messages.push(TeamMessage {
                arrived,
                robot: robot_of(value["robot"].as_str()?)?,
                frame,
                team: value["team"].as_str().map(str::to_owned),
            });
        }
    }
    Some(())
}
