//! The bounded way out: threads of its own send, so that no loop ever waits for the bus.
//!
//! Lease renewals have a lane of their own with one slot. The bus may take longer for a large message
//! than a leader may be silent, and a renewal that waits behind it would cost a living leader its lease.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use muster_service::Publication;
use muster_wire::Packet;

use crate::bus::Urgency;

/// Most messages that wait to be sent: the per-robot messages of a division of 10,000 robots.
const MAX_WAITING: usize = 16_384;

/// Most bytes that wait to be sent: a few of the largest messages.
const MAX_WAITING_BYTES: usize = 256 * 1024 * 1024;

/// How long a closing queue goes on sending what waits.
const FLUSH_WITHIN: Duration = Duration::from_millis(500);

/// The bounded way out. When it is full, the oldest message gives way: newer ones say more.
#[derive(Debug, Clone, Default)]
pub struct SendQueue(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    waiting: VecDeque<Packet>,
    bytes: usize,
    /// The newest lease renewal.
    renewal: Option<Packet>,
    closed: bool,
    done: bool,
    dropped: u64,
    sent: u64,
}

impl State {
    fn pop(&mut self) -> Option<Packet> {
        let message = self.waiting.pop_front()?;
        self.bytes -= message.size();
        Some(message)
    }
}

impl SendQueue {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Hands packets to the sender. Never waits.
    pub fn push(&self, publication: Publication) {
        let mut state = self.state();
        if state.closed {
            return;
        }
        for packet in publication.packets {
            if publication.is_lease_renewal {
                // An older renewal says nothing more.
                state.dropped += u64::from(state.renewal.replace(packet).is_some());
                continue;
            }
            state.bytes += packet.size();
            state.waiting.push_back(packet);
            while state.waiting.len() > MAX_WAITING
                || (state.bytes > MAX_WAITING_BYTES && state.waiting.len() > 1)
            {
                state.pop();
                state.dropped += 1;
            }
        }
        drop(state);
        self.0.changed.notify_all();
    }

    /// How many messages were sent, and how many were dropped.
    #[must_use]
    pub fn counts(&self) -> (u64, u64) {
        let state = self.state();
        (state.sent, state.dropped)
    }

    /// How many messages wait to be sent, and their bytes.
    #[must_use]
    pub fn waiting(&self) -> (usize, usize) {
        let state = self.state();
        (state.waiting.len(), state.bytes)
    }

    /// Starts the threads that send; they end when the queue is closed and empty. The returned one
    /// sends everything but lease renewals.
    ///
    /// # Errors
    /// If no thread can be started.
    pub fn start(
        &self,
        send: impl FnMut(Packet, Urgency) + Clone + Send + 'static,
    ) -> std::io::Result<JoinHandle<()>> {
        self.start_lane(
            "muster-renewals",
            |state| state.renewal.take(),
            Urgency::LeaseRenewal,
            send.clone(),
            |_| {},
        )?;
        self.start_lane("muster-sender", State::pop, Urgency::Normal, send, |state| {
            state.done = true
        })
    }

    fn start_lane(
        &self,
        name: &str,
        pop: fn(&mut State) -> Option<Packet>,
        urgency: Urgency,
        mut send: impl FnMut(Packet, Urgency) + Send + 'static,
        end: fn(&mut State),
    ) -> std::io::Result<JoinHandle<()>> {
        let queue = self.clone();
        std::thread::Builder::new().name(name.to_owned()).spawn(move || {
            while let Some(message) = queue.next(pop) {
                send(message, urgency);
                queue.state().sent += 1;
            }
            end(&mut queue.state());
            queue.0.changed.notify_all();
        })
    }

    fn next(&self, pop: fn(&mut State) -> Option<Packet>) -> Option<Packet> {
        let mut state = self.state();
        loop {
            if let Some(message) = pop(&mut state) {
                return Some(message);
            }
            if state.closed {
                return None;
            }
            state = self.0.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Takes no more messages, and waits a moment for those that wait. Blocks.
    pub fn close(&self) {
        let mut state = self.state();
        state.closed = true;
        self.0.changed.notify_all();
        let (mut state, _) = self
            .0
            .changed
            .wait_timeout_while(state, FLUSH_WITHIN, |state| !state.done)
            .unwrap_or_else(PoisonError::into_inner);
        state.waiting.clear();
        state.bytes = 0;
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use super::*;

    fn message(bytes: Vec<u8>, is_lease_renewal: bool) -> Publication {
        let packets = vec![Packet::put(String::new(), String::new(), bytes)];
        Publication { packets, is_lease_renewal, message: None }
    }

    fn first_byte(packet: &Packet) -> u8 {
        packet.payload.as_ref().unwrap()[0]
    }

    #[test]
    fn messages_leave_in_order_and_closing_flushes() {
        let queue = SendQueue::default();
        let (sender, receiver) = mpsc::channel();
        let thread =
            queue.start(move |packet, _| sender.send(first_byte(&packet)).unwrap()).unwrap();
        for byte in 0..100 {
            queue.push(message(vec![byte], false));
        }
        queue.close();
        thread.join().unwrap();
        assert!(receiver.iter().eq(0..100));
        assert_eq!(queue.counts(), (100, 0));
    }

    #[test]
    fn a_sender_that_hangs_costs_the_oldest_messages_and_never_blocks() {
        let queue = SendQueue::default();
        for _ in 0..MAX_WAITING + 7 {
            queue.push(message(vec![0], false));
        }
        assert_eq!(queue.counts(), (0, 7));
    }

    #[test]
    fn a_renewal_passes_a_message_that_takes_long_and_only_the_newest_waits() {
        let queue = SendQueue::default();
        let renewal = |byte| message(vec![byte], true);
        queue.push(renewal(1));
        queue.push(renewal(2));
        queue.push(message(vec![9], false));
        let (sender, receiver) = mpsc::channel();
        let (release, held) = mpsc::channel::<()>();
        let held = Arc::new(Mutex::new(held));
        let send = move |packet: Packet, _| {
            let byte = first_byte(&packet);
            if byte == 9 {
                let _ = held.lock().unwrap().recv();
            }
            sender.send(byte).unwrap();
        };
        let thread = queue.start(send).unwrap();
        let within = Duration::from_secs(10);
        assert_eq!(receiver.recv_timeout(within), Ok(2));
        queue.push(renewal(3));
        assert_eq!(receiver.recv_timeout(within), Ok(3), "the large one is not through yet");
        drop(release);
        assert_eq!(receiver.recv_timeout(within), Ok(9));
        queue.close();
        thread.join().unwrap();
        assert_eq!(queue.counts().1, 1);
    }

    #[test]
    fn large_messages_are_bounded_by_their_bytes() {
        let queue = SendQueue::default();
        for _ in 0..40 {
            queue.push(message(vec![0; 8 << 20], false));
        }
        assert_eq!(queue.counts(), (0, 8));
        assert!(queue.state().bytes <= MAX_WAITING_BYTES);
    }
}
