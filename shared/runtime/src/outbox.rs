//! The bounded way out: threads of its own send, so that no loop ever waits for the bus.
//!
//! What a holder claims has a lane of one place. A large message may take the bus longer than a holder
//! may be silent, and a claim that waits behind it would cost a living holder its role.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use muster_wire::{Key, Outbound};

/// Most messages that wait to be sent: the per-robot messages of a division of 10,000 robots.
const MAX_WAITING: usize = 16_384;

/// Most bytes that wait to be sent: a few of the largest messages.
const MAX_WAITING_BYTES: usize = 256 * 1024 * 1024;

/// How long a closing outbox goes on sending what waits.
const FLUSH_WITHIN: Duration = Duration::from_millis(500);

/// The bounded way out. When it is full, the oldest message gives way: newer ones say more.
#[derive(Debug, Clone, Default)]
pub struct Outbox(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    waiting: VecDeque<Outbound>,
    bytes: usize,
    /// The newest claim of the role.
    claim: Option<Outbound>,
    closed: bool,
    done: bool,
    dropped: u64,
    sent: u64,
}

impl State {
    fn pop(&mut self) -> Option<Outbound> {
        let message = self.waiting.pop_front()?;
        self.bytes -= message.payload.len();
        Some(message)
    }
}

impl Outbox {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Hands a message to the sender. Never waits.
    pub fn push(&self, message: Outbound) {
        let mut state = self.state();
        if state.closed {
            return;
        }
        if matches!(message.key, Key::Holder(_)) {
            // An older claim says nothing more.
            state.dropped += u64::from(state.claim.replace(message).is_some());
            drop(state);
            return self.0.changed.notify_all();
        }
        state.bytes += message.payload.len();
        state.waiting.push_back(message);
        while state.waiting.len() > MAX_WAITING
            || (state.bytes > MAX_WAITING_BYTES && state.waiting.len() > 1)
        {
            state.pop();
            state.dropped += 1;
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

    /// Starts the threads that send; they end when the outbox is closed and empty. The one that is
    /// returned sends everything but claims.
    ///
    /// # Errors
    /// If no thread can be started.
    pub fn start(
        &self,
        send: impl FnMut(Outbound) + Clone + Send + 'static,
    ) -> std::io::Result<JoinHandle<()>> {
        self.start_lane("muster-claims", |state| state.claim.take(), send.clone(), |_| {})?;
        self.start_lane("muster-sender", State::pop, send, |state| state.done = true)
    }

    fn start_lane(
        &self,
        name: &str,
        pop: fn(&mut State) -> Option<Outbound>,
        mut send: impl FnMut(Outbound) + Send + 'static,
        end: fn(&mut State),
    ) -> std::io::Result<JoinHandle<()>> {
        let outbox = self.clone();
        std::thread::Builder::new().name(name.to_owned()).spawn(move || {
            while let Some(message) = outbox.next(pop) {
                send(message);
                outbox.state().sent += 1;
            }
            end(&mut outbox.state());
            outbox.0.changed.notify_all();
        })
    }

    fn next(&self, pop: fn(&mut State) -> Option<Outbound>) -> Option<Outbound> {
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
    use std::borrow::Cow;
    use std::sync::mpsc;

    use muster_model::id::ServiceName;

    use super::*;

    fn message(byte: u8) -> Outbound {
        Outbound {
            key: Key::Teams,
            encoding: Cow::Borrowed(""),
            payload: vec![byte],
            attachment: None,
        }
    }

    #[test]
    fn messages_leave_in_order_and_closing_flushes() {
        let outbox = Outbox::default();
        let (sender, receiver) = mpsc::channel();
        let thread = outbox.start(move |message| sender.send(message.payload[0]).unwrap()).unwrap();
        for byte in 0..100 {
            outbox.push(message(byte));
        }
        outbox.close();
        thread.join().unwrap();
        assert!(receiver.iter().eq(0..100));
        assert_eq!(outbox.counts(), (100, 0));
    }

    #[test]
    fn a_sender_that_hangs_costs_the_oldest_messages_and_never_blocks() {
        let outbox = Outbox::default();
        for _ in 0..MAX_WAITING + 7 {
            outbox.push(message(0));
        }
        assert_eq!(outbox.counts(), (0, 7));
    }

    #[test]
    fn a_claim_passes_a_message_that_takes_long_and_only_the_newest_waits() {
        let outbox = Outbox::default();
        let claim = |byte| Outbound { key: Key::Holder(ServiceName::Ingest), ..message(byte) };
        outbox.push(claim(1));
        outbox.push(claim(2));
        outbox.push(message(9));
        let (sender, receiver) = mpsc::channel();
        let (release, held) = mpsc::channel::<()>();
        let held = Arc::new(Mutex::new(held));
        let send = move |message: Outbound| {
            if message.key == Key::Teams {
                let _ = held.lock().unwrap().recv();
            }
            sender.send(message.payload[0]).unwrap();
        };
        let thread = outbox.start(send).unwrap();
        let within = Duration::from_secs(10);
        assert_eq!(receiver.recv_timeout(within), Ok(2));
        outbox.push(claim(3));
        assert_eq!(receiver.recv_timeout(within), Ok(3), "the large one is not through yet");
        drop(release);
        assert_eq!(receiver.recv_timeout(within), Ok(9));
        outbox.close();
        thread.join().unwrap();
        assert_eq!(outbox.counts().1, 1);
    }

    #[test]
    fn large_messages_are_bounded_by_their_bytes() {
        let outbox = Outbox::default();
        for _ in 0..40 {
            outbox.push(Outbound { payload: vec![0; 8 << 20], ..message(0) });
        }
        assert_eq!(outbox.counts(), (0, 8));
        assert!(outbox.state().bytes <= MAX_WAITING_BYTES);
    }
}
