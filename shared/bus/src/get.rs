//! Gets, and their answers.

use std::time::Duration;

use anyhow::Context;
use muster_wire::{Key, Packet, Pattern};
use tokio::sync::mpsc;
use zenoh::Wait;
use zenoh::qos::Priority;
use zenoh::query::{ConsolidationMode, QueryTarget, ReplyError};
use zenoh::sample::Locality;

use crate::bus::{Bus, LEASE_PRIORITY, MAX_ANSWERS};
use crate::packet::packet;
use crate::shared::Participant;

/// Most bytes of answers to one get that are kept: a few of the largest messages.
const MAX_ANSWER_BYTES: usize = 512 * 1024 * 1024;

/// Most bytes of an error that are read.
const MAX_ERROR_BYTES: usize = 4096;

/// The priority of gets, and so of their answers: they may be large, and must not delay what is published
/// once.
const ANSWER_PRIORITY: Priority = Priority::DataLow;

/// The text by which Zenoh reports an answer that did not come in time.
const TIMEOUT: &[u8] = b"Timeout";

/// How a get is asked.
#[derive(Debug, Clone, Copy)]
pub struct Ask<'a> {
    /// What follows the `?` of the selector.
    pub parameters: &'a str,
    /// What the get carries.
    pub payload: Option<&'a [u8]>,
    /// How long answers are waited for.
    pub within: Duration,
    /// How long after an answer a further one is waited for; none: until all who are asked have answered.
    pub further_within: Option<Duration>,
    /// Who is asked.
    pub target: Target,
}

/// Who is asked by a get.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// All who serve the pattern.
    All,
    /// Only one who serves the pattern completely, if there is one.
    Complete,
}

/// One answer to a get.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Answer {
    /// A message on a key.
    Packet(Packet),
    /// An error, as text.
    Error(String),
}

impl Answer {
    fn size(&self) -> usize {
        match self {
            Self::Packet(packet) => packet.key.len() + packet.payload.as_ref().map_or(0, Vec::len),
            Self::Error(text) => text.len(),
        }
    }
}

impl Bus {
    /// Gets a pattern and returns the answers that come in time.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn get(&self, pattern: &Pattern, ask: Ask<'_>) -> anyhow::Result<Vec<Answer>> {
        let (sender, mut receiver) = mpsc::channel(MAX_ANSWERS);
        let due = tokio::time::Instant::now() + ask.within;
        match &self.participant {
            None => self.ask_bus(pattern, ask, sender).await?,
            Some(participant) => {
                let selector = self.space.pattern(pattern);
                if participant.ask(&selector, ask, sender.clone()).await? {
                    let _leave = participant.may_ask().await;
                    self.ask_bus(pattern, ask, sender).await?;
                }
            }
        }
        let (mut answers, mut bytes) = (Vec::new(), 0);
        loop {
            let further = ask.further_within.filter(|_| !answers.is_empty());
            let answer = match further {
                // Zenoh ends a get in time; those that are asked in the process may not.
                None if self.participant.is_none() => receiver.recv().await,
                None => tokio::time::timeout_at(due, receiver.recv()).await.ok().flatten(),
                Some(time) => tokio::time::timeout(time, receiver.recv()).await.ok().flatten(),
            };
            let Some(answer) = answer else { break };
            bytes += answer.size();
            if answers.len() >= MAX_ANSWERS || bytes > MAX_ANSWER_BYTES {
                tracing::warn!("more answers came than are kept");
                break;
            }
            answers.push(answer);
        }
        Ok(answers)
    }

    /// Puts a get on the bus; the answers come to a channel, which is let go of when all have answered.
    async fn ask_bus(
        &self,
        pattern: &Pattern,
        ask: Ask<'_>,
        sender: mpsc::Sender<Answer>,
    ) -> anyhow::Result<()> {
        let mut selector = self.space.pattern(pattern);
        if !ask.parameters.is_empty() {
            selector = format!("{selector}?{}", ask.parameters);
        }
        let target = match ask.target {
            Target::All => QueryTarget::All,
            Target::Complete => QueryTarget::BestMatching,
        };
        let session = self.session.clone();
        let mark = self.participant.as_ref().map(Participant::mark);
        let payload = ask.payload.map(<[u8]>::to_vec);
        let (within, limit) = (ask.within, pattern.payload_limit());
        let asks_for_leader = matches!(pattern, Pattern::One(Key::Lease(_)));
        let priority = if asks_for_leader { LEASE_PRIORITY } else { ANSWER_PRIORITY };
        // Asking may wait for a busy link, on the thread that asks. The answers come by a callback
        // into a bounded channel: a handler that is not drained would stall the link.
        let asking = tokio::task::spawn_blocking(move || {
            let mut get = session
                .get(selector.as_str())
                .target(target)
                .consolidation(ConsolidationMode::None)
                .priority(priority)
                .allowed_destination(Locality::Remote)
                .timeout(within);
            if let Some(mark) = mark {
                get = get.attachment(mark);
            }
            if let Some(payload) = payload {
                get = get.payload(payload).encoding(muster_wire::message::JSON);
            }
            let asked = get.callback(move |reply| {
                let answer = match reply.into_result() {
                    Ok(sample) => Answer::Packet(packet(&sample, limit)),
                    Err(error) if is_timeout(&error) => return,
                    Err(error) => Answer::Error(error_text(error.payload())),
                };
                let _ = sender.try_send(answer);
            });
            asked.wait().map_err(|error| anyhow::anyhow!("cannot ask for {selector}: {error}"))
        });
        asking.await.context("asking failed")?
    }
}

/// Whether Zenoh itself says, in the place of an error reply, that an answer did not come in time. Session and router give
/// it different encodings.
fn is_timeout(error: &ReplyError) -> bool {
    error.payload().to_bytes() == TIMEOUT
}

fn error_text(payload: &zenoh::bytes::ZBytes) -> String {
    let mut start = vec![0; payload.len().min(MAX_ERROR_BYTES)];
    let read = std::io::Read::read(&mut payload.reader(), &mut start).unwrap_or_default();
    String::from_utf8_lossy(&start[..read]).into_owned()
}
