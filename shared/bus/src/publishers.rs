//! Puts by declared publishers, for those who put to the same keys again and again.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use muster_wire::{Attachment, Key, Outbound, Packet};
use zenoh::Wait;
use zenoh::pubsub::Publisher;

use crate::bus::Bus;

/// Most keys that one session declares; those beyond are put by their text. A program that plays 10,000 robots has 40,000.
const MAX_DECLARED: usize = 65_536;

/// Most keys that one session declares a second. A robot has three or four. For a program that plays thousands, each
/// declaration costs a router as much as the messages of many robots, and 15,000 at once kept it from everything else.
const MAX_DECLARED_PER_SECOND: u32 = 100;

/// Puts to keys that are declared one after the other, and until then by their text.
///
/// A router that receives a message under the text of a key compares it with the keys of every robot, for each message
/// again (`Resource::get_matches` of Zenoh 1.10.2). A declared one it has compared once.
#[derive(Debug)]
pub struct Publishers {
    bus: Bus,
    declared: HashMap<Key, Publisher<'static>>,
    /// When the second began in which so many were declared.
    second: (Instant, u32),
}

impl Publishers {
    /// No key is declared.
    #[must_use]
    pub fn new(bus: Bus) -> Self {
        Self { bus, declared: HashMap::new(), second: (Instant::now(), 0) }
    }

    /// Puts a message. May wait for a busy link, as long as the configuration allows.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn put(&mut self, message: Outbound) -> anyhow::Result<()> {
        let key = message.key.clone();
        if !self.declared.contains_key(&key) {
            if !self.may_declare(Instant::now()) {
                return self.bus.put(message);
            }
            let text = self.bus.space.format(&key);
            let publisher = self.bus.session.declare_publisher(text).wait();
            let publisher = publisher.map_err(|error| failed(&key, &error))?;
            self.declared.insert(key.clone(), publisher);
        }
        let Some(publisher) = self.declared.get(&key) else { return Ok(()) };
        let Packet { encoding, payload, attachment, .. } = message.into_packet(&self.bus.space);
        publisher
            .put(payload.unwrap_or_default())
            .encoding(encoding.as_str())
            .attachment(attachment.map(Attachment::into_bytes))
            .wait()
            .map_err(|error| failed(&key, &error))
    }

    fn may_declare(&mut self, now: Instant) -> bool {
        let (began, count) = &mut self.second;
        if now.duration_since(*began) >= Duration::from_secs(1) {
            (*began, *count) = (now, 0);
        }
        let may = *count < MAX_DECLARED_PER_SECOND && self.declared.len() < MAX_DECLARED;
        *count += u32::from(may);
        may
    }
}

fn failed(key: &Key, error: &zenoh::Error) -> anyhow::Error {
    anyhow::anyhow!("cannot put to {key}: {error}")
}
