//! The bounded way in: what arrives waits here for the loop, the newest of each key.
//!
//! The bus calls back on its own threads and must never wait. An item of a latest-wins key replaces
//! the one that waits; a queue drops its oldest; the whole inbox drops its oldest when it is full.
//! Items leave in the order of arrival.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::{Mutex, MutexGuard, PoisonError};

use muster_machine::Delivery;
use tokio::sync::Notify;

/// Most items that wait: four streams of 25,000 robots.
const MAX_ITEMS: usize = 100_000;

/// Most bytes that wait, as they came: a few of the largest messages between services.
const MAX_BYTES: usize = 256 * 1024 * 1024;

/// The bounded way in.
#[derive(Debug)]
pub struct Inbox<T> {
    state: Mutex<State<T>>,
    arrived: Notify,
}

impl<T> Default for Inbox<T> {
    fn default() -> Self {
        Self { state: Mutex::new(State::default()), arrived: Notify::new() }
    }
}

#[derive(Debug)]
struct Waiting<T> {
    key: String,
    item: T,
    size: usize,
}

#[derive(Debug)]
struct State<T> {
    next: u64,
    waiting: BTreeMap<u64, Waiting<T>>,
    places: HashMap<String, VecDeque<u64>>,
    bytes: usize,
    superseded: u64,
    dropped: u64,
}

impl<T> Default for State<T> {
    fn default() -> Self {
        Self {
            next: 0,
            waiting: BTreeMap::new(),
            places: HashMap::new(),
            bytes: 0,
            superseded: 0,
            dropped: 0,
        }
    }
}

/// What an inbox has counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InboxCounts {
    /// Items that a newer one of the same key replaced.
    pub superseded: u64,
    /// Items that were dropped because too many waited.
    pub dropped: u64,
    /// Items that wait, and their bytes.
    pub waiting: (usize, usize),
}

impl<T> State<T> {
    fn remove(&mut self, place: u64) -> Option<T> {
        let waiting = self.waiting.remove(&place)?;
        self.bytes -= waiting.size;
        if let Some(places) = self.places.get_mut(&waiting.key) {
            places.retain(|other| *other != place);
            if places.is_empty() {
                self.places.remove(&waiting.key);
            }
        }
        Some(waiting.item)
    }
}

impl<T> Inbox<T> {
    /// No critical section can panic half-way, so that a poisoned lock still guards a whole state.
    fn state(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes an item in that had a size in bytes as it came. Never waits.
    pub fn push(&self, key: String, item: T, size: usize, delivery: Delivery) {
        let mut state = self.state();
        let room = match delivery {
            Delivery::Latest => 1,
            Delivery::Queue(length) => length.max(1),
        };
        while let Some(oldest) = state
            .places
            .get(&key)
            .filter(|places| places.len() >= room)
            .and_then(|places| places.front().copied())
        {
            state.remove(oldest);
            state.superseded += 1;
        }
        let place = state.next;
        state.next += 1;
        state.bytes += size;
        state.places.entry(key.clone()).or_default().push_back(place);
        state.waiting.insert(place, Waiting { key, item, size });
        while state.waiting.len() > MAX_ITEMS || state.bytes > MAX_BYTES {
            let Some(oldest) = state.waiting.keys().next().copied() else { break };
            state.remove(oldest);
            state.dropped += 1;
        }
        drop(state);
        self.arrived.notify_one();
    }

    /// Takes the item out that has waited longest.
    #[must_use]
    pub fn pop(&self) -> Option<T> {
        let mut state = self.state();
        let oldest = state.waiting.keys().next().copied()?;
        state.remove(oldest)
    }

    /// Returns once an item may wait.
    pub async fn arrived(&self) {
        self.arrived.notified().await;
    }

    /// Wakes [`Inbox::arrived`] again, for a loop that leaves items behind to look after others.
    pub fn rewake(&self) {
        self.arrived.notify_one();
    }

    /// What it has counted so far.
    #[must_use]
    pub fn counts(&self) -> InboxCounts {
        let state = self.state();
        InboxCounts {
            superseded: state.superseded,
            dropped: state.dropped,
            waiting: (state.waiting.len(), state.bytes),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drain(inbox: &Inbox<u8>) -> Vec<u8> {
        std::iter::from_fn(|| inbox.pop()).collect()
    }

    #[test]
    fn the_latest_of_a_key_waits_in_order_of_arrival() {
        let inbox = Inbox::default();
        for (key, item) in [("a", 1), ("b", 2), ("a", 3)] {
            inbox.push(key.to_owned(), item, 1, Delivery::Latest);
        }
        assert_eq!(inbox.counts().superseded, 1);
        assert_eq!(drain(&inbox), [2, 3]);
    }

    #[test]
    fn a_queue_drops_its_oldest() {
        let inbox = Inbox::default();
        for item in 0..5 {
            inbox.push("a".to_owned(), item, 1, Delivery::Queue(3));
        }
        assert_eq!(drain(&inbox), [2, 3, 4]);
    }

    #[test]
    fn a_flood_of_keys_stays_bounded() {
        let inbox = Inbox::default();
        for number in 0..MAX_ITEMS + 10 {
            inbox.push(number.to_string(), 0, 1, Delivery::Latest);
        }
        assert_eq!(inbox.counts().dropped, 10);
        let state = inbox.state();
        assert_eq!((state.waiting.len(), state.places.len()), (MAX_ITEMS, MAX_ITEMS));
    }

    #[test]
    fn a_flood_of_bytes_stays_bounded() {
        let inbox = Inbox::default();
        for number in 0..40 {
            inbox.push(number.to_string(), 0, 8 << 20, Delivery::Latest);
        }
        assert!(inbox.state().bytes <= MAX_BYTES);
        assert_eq!(drain(&inbox).len(), 32);
        assert_eq!(inbox.state().bytes, 0);
    }
}
