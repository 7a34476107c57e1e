//! The bounded way in: what arrives waits here for the host, the newest of each key.
//!
//! An item of a latest-wins key replaces the one that waits; a queue drops its oldest; the whole inbox
//! drops its oldest when it is full. Items leave in the order of arrival.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use muster_model::limits::MAX_ROBOT_PAYLOAD;
use muster_wire::{KeySpace, Packet, Pattern};
use smallvec::SmallVec;

use crate::io::Arrival;
use crate::wiring::Delivery;

/// Most items that wait: four streams of 25,000 robots.
const MAX_ITEMS: usize = 100_000;

/// Most bytes that wait, as they came: a few of the largest messages between services.
const MAX_BYTES: usize = 256 * 1024 * 1024;

/// A packet ready for the inbox.
#[derive(Debug)]
pub struct Parcel {
    slot: String,
    arrival: Arrival,
    size: usize,
    delivery: Delivery,
}

impl Parcel {
    /// A packet of a subscription. What robots send is decoded at once, and a refused packet waits in
    /// a slot of its own: it must not take that of a good message of the same key. Services
    /// republish, and their messages may be large: they are decoded as they are handled.
    ///
    /// None if the packet is not meant for a reader of the pattern.
    #[must_use]
    pub fn new(
        space: &KeySpace,
        packet: Packet,
        pattern: &Pattern,
        delivery: Delivery,
    ) -> Option<Self> {
        pattern
            .is_meant_for_reader(&packet.key)
            .then(|| Self::of_reader(space, packet, pattern, delivery))
    }

    fn of_reader(space: &KeySpace, packet: Packet, pattern: &Pattern, delivery: Delivery) -> Self {
        let size = packet.key.len() + packet.size();
        let slot = packet.key.clone();
        if matches!(pattern, Pattern::Foreign(_)) {
            return Self { slot, arrival: Arrival::foreign(packet), size, delivery };
        }
        if pattern.payload_limit() != MAX_ROBOT_PAYLOAD {
            return Self { slot, arrival: Arrival::encoded(packet), size, delivery };
        }
        let arrival = Arrival::decoded(space, packet);
        if arrival.is_refused() {
            let slot = format!("{slot} refused");
            return Self { slot, arrival, size, delivery: Delivery::Latest };
        }
        Self { slot, arrival, size, delivery }
    }

    /// A change of a liveliness token.
    #[must_use]
    pub fn token(space: &KeySpace, packet: Packet) -> Self {
        let (slot, size) = (packet.key.clone(), packet.key.len());
        let arrival = Arrival::decoded(space, packet);
        Self { slot, arrival, size, delivery: Delivery::Latest }
    }

    /// How many bytes it came in.
    #[must_use]
    pub fn size(&self) -> usize {
        self.size
    }
}

/// What an inbox has counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct InboxCounts {
    /// Items that a newer one of the same key replaced.
    pub superseded: u64,
    /// Items that were dropped because too many waited.
    pub dropped: u64,
    /// Items that wait.
    pub waiting_items: usize,
    /// Bytes that wait.
    pub waiting_bytes: usize,
}

#[derive(Debug)]
struct Waiting {
    slot: Arc<str>,
    arrival: Arrival,
    size: usize,
}

/// How much may wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InboxLimits {
    /// Most items.
    pub items: usize,
    /// Most bytes, as they came.
    pub bytes: usize,
}

impl Default for InboxLimits {
    fn default() -> Self {
        Self { items: MAX_ITEMS, bytes: MAX_BYTES }
    }
}

/// The bounded way in.
#[derive(Debug, Default)]
pub struct Inbox {
    limits: InboxLimits,
    next: u64,
    waiting: BTreeMap<u64, Waiting>,
    /// The numbers of what waits for each slot, the oldest first. Nearly always that is one.
    slots: HashMap<Arc<str>, SmallVec<[u64; 1]>>,
    bytes: usize,
    superseded: u64,
    dropped: u64,
}

impl Inbox {
    /// An empty inbox with other limits.
    #[must_use]
    pub fn bounded(limits: InboxLimits) -> Self {
        Self { limits, ..Self::default() }
    }

    /// Adds a packet.
    pub fn push(&mut self, parcel: Parcel) {
        let Parcel { slot, arrival, size, delivery } = parcel;
        let slot: Arc<str> = slot.into();
        let room = match delivery {
            Delivery::Latest => 1,
            Delivery::Queue(length) => length.max(1),
        };
        while let Some(oldest) = self
            .slots
            .get(&slot)
            .filter(|numbers| numbers.len() >= room)
            .and_then(|numbers| numbers.first().copied())
        {
            self.remove(oldest);
            self.superseded += 1;
        }
        let number = self.next;
        self.next += 1;
        self.bytes += size;
        self.slots.entry(Arc::clone(&slot)).or_default().push(number);
        self.waiting.insert(number, Waiting { slot, arrival, size });
        while self.waiting.len() > self.limits.items || self.bytes > self.limits.bytes {
            let Some(oldest) = self.waiting.keys().next().copied() else { break };
            self.remove(oldest);
            self.dropped += 1;
        }
    }

    /// The oldest packet that waits.
    pub fn pop(&mut self) -> Option<Arrival> {
        let oldest = self.waiting.keys().next().copied()?;
        self.remove(oldest)
    }

    /// Whether nothing waits.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// What was counted so far.
    #[must_use]
    pub fn counts(&self) -> InboxCounts {
        InboxCounts {
            superseded: self.superseded,
            dropped: self.dropped,
            waiting_items: self.waiting.len(),
            waiting_bytes: self.bytes,
        }
    }

    fn remove(&mut self, number: u64) -> Option<Arrival> {
        let waiting = self.waiting.remove(&number)?;
        self.bytes -= waiting.size;
        if let Some(numbers) = self.slots.get_mut(&waiting.slot) {
            numbers.retain(|other| *other != number);
            if numbers.is_empty() {
                self.slots.remove(&waiting.slot);
            }
        }
        Some(waiting.arrival)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parcel(slot: &str, content: u8, size: usize, delivery: Delivery) -> Parcel {
        let packet = Packet::put(slot.to_owned(), String::new(), vec![content]);
        Parcel { slot: slot.to_owned(), arrival: Arrival::encoded(packet), size, delivery }
    }

    fn drain(inbox: &mut Inbox) -> Vec<u8> {
        let arrivals = std::iter::from_fn(|| inbox.pop());
        arrivals.map(|arrival| arrival.packet().payload.as_ref().unwrap()[0]).collect()
    }

    #[test]
    fn the_newest_of_a_key_waits_in_order_of_arrival() {
        let mut inbox = Inbox::default();
        for (slot, content) in [("a", 1), ("b", 2), ("a", 3)] {
            inbox.push(parcel(slot, content, 1, Delivery::Latest));
        }
        assert_eq!(inbox.counts().superseded, 1);
        assert_eq!(drain(&mut inbox), [2, 3]);
    }

    #[test]
    fn a_queue_drops_its_oldest() {
        let mut inbox = Inbox::default();
        for content in 0..5 {
            inbox.push(parcel("a", content, 1, Delivery::Queue(3)));
        }
        assert_eq!(drain(&mut inbox), [2, 3, 4]);
    }

    #[test]
    fn a_flood_of_keys_stays_bounded() {
        let mut inbox = Inbox::default();
        for number in 0..MAX_ITEMS + 10 {
            inbox.push(parcel(&number.to_string(), 0, 1, Delivery::Latest));
        }
        assert_eq!(inbox.counts().dropped, 10);
        assert_eq!((inbox.waiting.len(), inbox.slots.len()), (MAX_ITEMS, MAX_ITEMS));
    }

    #[test]
    fn an_inbox_among_many_keeps_less() {
        let mut inbox = Inbox::bounded(InboxLimits { items: 3, bytes: 10 });
        for number in 0..5 {
            inbox.push(parcel(&number.to_string(), number, 1, Delivery::Latest));
        }
        assert_eq!(drain(&mut inbox), [2, 3, 4]);
        for number in 0..5 {
            inbox.push(parcel(&number.to_string(), number, 5, Delivery::Latest));
        }
        assert_eq!(drain(&mut inbox), [3, 4]);
    }

    #[test]
    fn a_flood_of_bytes_stays_bounded() {
        let mut inbox = Inbox::default();
        for number in 0..40 {
            inbox.push(parcel(&number.to_string(), 0, 8 << 20, Delivery::Latest));
        }
        assert!(inbox.counts().waiting_bytes <= MAX_BYTES);
        assert_eq!(drain(&mut inbox).len(), 32);
        assert_eq!(inbox.counts().waiting_bytes, 0);
    }
}
