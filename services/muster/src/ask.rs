//! Questions to the live fleet, as a console asks them.

use std::sync::Arc;
use std::time::Duration;

use muster_machine::Delivery;
use muster_model::header::Revision;
use muster_runtime::bus::{Answer, Ask, Bus, Patience};
use muster_runtime::config::ProcessConfig;
use muster_runtime::exit::ExitError;
use muster_runtime::inbox::Inbox;
use muster_wire::message::quoted;
use muster_wire::{Key, Message, Pattern};

/// How long a console waits for a router.
const CONNECT_WITHIN: Duration = Duration::from_secs(5);

/// How long a console waits for answers.
pub(crate) const ANSWER_WITHIN: Duration = Duration::from_secs(3);

/// Opens the bus for a console: it does not wait for ever.
///
/// # Errors
/// If no router answers; the text names the remedy.
pub(crate) async fn open(config: &ProcessConfig) -> anyhow::Result<Bus> {
    Ok(Bus::open(config, Patience::AtMost(CONNECT_WITHIN)).await?)
}

/// All answers to a get, understood; answers that are not are told of and left out.
///
/// # Errors
/// If the session is closed.
pub(crate) async fn messages(bus: &Bus, pattern: &Pattern) -> anyhow::Result<Vec<Message>> {
    let ask =
        Ask { parameters: "format=bincode", payload: None, within: ANSWER_WITHIN, everybody: true };
    let mut messages = Vec::new();
    for answer in bus.get(pattern, ask).await? {
        match answer {
            Answer::Packet(packet) => match Message::decode(bus.space(), &packet) {
                Ok(message) => messages.push(message),
                Err(refused) => {
                    eprintln!("warning: {} is refused: {}", refused.key, refused.reason)
                }
            },
            Answer::Error(error) => eprintln!("warning: {}", quoted(&error)),
        }
    }
    Ok(messages)
}

/// Where a message stands among the outputs of its role.
pub(crate) fn revision(message: &Message) -> Revision {
    message.header().map_or_else(Revision::default, |header| header.revision)
}

/// The newest answer to a get.
///
/// # Errors
/// If nobody answers; the text names the remedy.
pub(crate) async fn newest(bus: &Bus, key: Key) -> anyhow::Result<Message> {
    let what = key.to_string();
    let all = messages(bus, &Pattern::One(key)).await?;
    all.into_iter().max_by_key(revision).ok_or_else(|| {
        ExitError::unreachable(format!(
            "nobody answers for {what} of fleet {}; see `muster status` for what runs",
            bus.space().fleet()
        ))
        .into()
    })
}

/// Follows one key: the newest message first, then every newer one.
///
/// # Errors
/// If the session is closed.
pub(crate) async fn follow(bus: &Bus, key: Key) -> anyhow::Result<Follow> {
    let inbox = Arc::new(Inbox::default());
    let (space, taking) = (bus.space().clone(), Arc::clone(&inbox));
    bus.subscribe(&Pattern::One(key.clone()), move |packet| {
        // What is refused is left to the services to tell of.
        if let Ok(message) = Message::decode(&space, &packet) {
            let size = packet.payload.as_ref().map_or(0, Vec::len);
            taking.push(packet.key, message, size, Delivery::Latest);
        }
    })
    .await?;
    let first = messages(bus, &Pattern::One(key)).await?.into_iter().max_by_key(revision);
    Ok(Follow { inbox, first, seen: Revision::default() })
}

/// The messages of one key.
#[derive(Debug)]
pub(crate) struct Follow {
    inbox: Arc<Inbox<Message>>,
    first: Option<Message>,
    seen: Revision,
}

impl Follow {
    /// The next message that is newer than the one before.
    pub(crate) async fn next(&mut self) -> Message {
        if let Some(first) = self.first.take() {
            self.seen = revision(&first);
            return first;
        }
        loop {
            while let Some(message) = self.inbox.pop() {
                if revision(&message) > self.seen {
                    self.seen = revision(&message);
                    return message;
                }
            }
            self.inbox.arrived().await;
        }
    }
}
