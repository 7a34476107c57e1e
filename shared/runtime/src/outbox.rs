//! The bounded way out: one thread sends, so that no loop ever waits for the bus.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use muster_wire::Outbound;

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

    /// Starts the thread that sends; it ends when the outbox is closed and empty.
    ///
    /// # Errors
    /// If no thread can be started.
    pub fn start(
        &self,
        mut send: impl FnMut(Outbound) + Send + 'static,
    ) -> std::io::Result<JoinHandle<()>> {
        let outbox = self.clone();
        std::thread::Builder::new().name("muster-sender".to_owned()).spawn(move || {
            while let Some(message) = outbox.next() {
                send(message);
                outbox.state().sent += 1;
            }
            outbox.state().done = true;
            outbox.0.changed.notify_all();
        })
    }

    fn next(&self) -> Option<Outbound> {
        let mut state = self.state();
        loop {
            if let Some(message) = state.pop() {
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

    use muster_wire::Key;

    use super::*;

    fn message(byte: u8) -> Outbound {
        Outbound { key: Key::Teams, encoding: Cow::Borrowed(""), payload: vec![byte] }
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
    fn large_messages_are_bounded_by_their_bytes() {
        let outbox = Outbox::default();
        for _ in 0..40 {
            outbox.push(Outbound { payload: vec![0; 8 << 20], ..message(0) });
        }
        assert_eq!(outbox.counts(), (0, 8));
        assert!(outbox.state().bytes <= MAX_WAITING_BYTES);
    }
}
