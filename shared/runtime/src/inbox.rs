//! The bounded way in: packets wait here for the loop, the newest of each key.
//!
//! The bus calls back on its own threads and must never wait. A packet of a latest-wins key replaces
//! the one that waits; a queue drops its oldest; the whole inbox drops its oldest when it is full.
//! Packets leave in the order of arrival.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::{Mutex, MutexGuard, PoisonError};

use muster_machine::Delivery;
use muster_wire::Packet;
use tokio::sync::Notify;

/// Most packets that wait: four streams of 25,000 robots.
const MAX_PACKETS: usize = 100_000;

/// Most bytes that wait: a few of the largest messages between services.
const MAX_BYTES: usize = 256 * 1024 * 1024;

/// The bounded way in.
#[derive(Debug, Default)]
pub struct Inbox {
    state: Mutex<State>,
    arrived: Notify,
}

#[derive(Debug, Default)]
struct State {
    next: u64,
    packets: BTreeMap<u64, Packet>,
    places: HashMap<String, VecDeque<u64>>,
    bytes: usize,
    superseded: u64,
    dropped: u64,
}

/// What an inbox has counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InboxCounts {
    /// Packets that a newer one of the same key replaced.
    pub superseded: u64,
    /// Packets that were dropped because too many waited.
    pub dropped: u64,
}

impl State {
    fn remove(&mut self, place: u64) -> Option<Packet> {
        let packet = self.packets.remove(&place)?;
        self.bytes -= size(&packet);
        if let Some(places) = self.places.get_mut(&packet.key) {
            places.retain(|other| *other != place);
            if places.is_empty() {
                self.places.remove(&packet.key);
            }
        }
        Some(packet)
    }
}

fn size(packet: &Packet) -> usize {
    packet.key.len() + packet.payload.as_ref().map_or(0, Vec::len)
}

impl Inbox {
    /// No critical section can panic half-way, so that a poisoned lock still guards a whole state.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a packet in. Never waits.
    pub fn push(&self, packet: Packet, delivery: Delivery) {
        let mut state = self.state();
        let room = match delivery {
            Delivery::Latest => 1,
            Delivery::Queue(length) => length.max(1),
        };
        while let Some(oldest) = state
            .places
            .get(&packet.key)
            .filter(|places| places.len() >= room)
            .and_then(|places| places.front().copied())
        {
            state.remove(oldest);
            state.superseded += 1;
        }
        let place = state.next;
        state.next += 1;
        state.bytes += size(&packet);
        state.places.entry(packet.key.clone()).or_default().push_back(place);
        state.packets.insert(place, packet);
        while state.packets.len() > MAX_PACKETS || state.bytes > MAX_BYTES {
            let Some(oldest) = state.packets.keys().next().copied() else { break };
            state.remove(oldest);
            state.dropped += 1;
        }
        drop(state);
        self.arrived.notify_one();
    }

    /// Takes the packet out that has waited longest.
    #[must_use]
    pub fn pop(&self) -> Option<Packet> {
        let mut state = self.state();
        let oldest = state.packets.keys().next().copied()?;
        state.remove(oldest)
    }

    /// Returns once a packet may wait.
    pub async fn arrived(&self) {
        self.arrived.notified().await;
    }

    /// Wakes [`Inbox::arrived`] again, for a loop that leaves packets behind to look after others.
    pub fn rewake(&self) {
        self.arrived.notify_one();
    }

    /// What it has counted so far.
    #[must_use]
    pub fn counts(&self) -> InboxCounts {
        let state = self.state();
        InboxCounts { superseded: state.superseded, dropped: state.dropped }
    }
}

#[cfg(test)]
mod tests {
    use muster_wire::Source;

    use super::*;

    fn packet(key: &str, byte: u8) -> Packet {
        Packet {
            key: key.to_owned(),
            encoding: String::new(),
            source: Source::Put,
            payload: Ok(vec![byte]),
        }
    }

    fn drain(inbox: &Inbox) -> Vec<(String, u8)> {
        std::iter::from_fn(|| inbox.pop())
            .map(|packet| (packet.key, packet.payload.unwrap()[0]))
            .collect()
    }

    #[test]
    fn the_latest_of_a_key_waits_in_order_of_arrival() {
        let inbox = Inbox::default();
        inbox.push(packet("a", 1), Delivery::Latest);
        inbox.push(packet("b", 2), Delivery::Latest);
        inbox.push(packet("a", 3), Delivery::Latest);
        assert_eq!(inbox.counts().superseded, 1);
        assert_eq!(drain(&inbox), [("b".to_owned(), 2), ("a".to_owned(), 3)]);
    }

    #[test]
    fn a_queue_drops_its_oldest() {
        let inbox = Inbox::default();
        for byte in 0..5 {
            inbox.push(packet("a", byte), Delivery::Queue(3));
        }
        let bytes: Vec<u8> = drain(&inbox).into_iter().map(|(_, byte)| byte).collect();
        assert_eq!(bytes, [2, 3, 4]);
    }

    #[test]
    fn a_flood_of_keys_stays_bounded() {
        let inbox = Inbox::default();
        for number in 0..MAX_PACKETS + 10 {
            inbox.push(packet(&number.to_string(), 0), Delivery::Latest);
        }
        assert_eq!(inbox.counts().dropped, 10);
        let state = inbox.state();
        assert_eq!((state.packets.len(), state.places.len()), (MAX_PACKETS, MAX_PACKETS));
    }

    #[test]
    fn a_flood_of_bytes_stays_bounded() {
        let inbox = Inbox::default();
        for number in 0..40 {
            let big = Packet { payload: Ok(vec![0; 8 << 20]), ..packet(&number.to_string(), 0) };
            inbox.push(big, Delivery::Latest);
        }
        assert!(inbox.state().bytes <= MAX_BYTES);
        assert_eq!(drain(&inbox).len(), 31);
        assert_eq!(inbox.state().bytes, 0);
    }
}
