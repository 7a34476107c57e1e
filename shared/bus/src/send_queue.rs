//! One bounded send queue: a thread sends what waits, so that no caller ever waits for the bus.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::turns::{Turn, Turns};

/// What waits in a queue, bounded: how many messages, and which one is dropped for another.
pub trait Waiting: Default + Send + 'static {
    /// What is sent.
    type Message: Send;

    /// Adds a message; returns how many others were dropped for it.
    fn push(&mut self, message: Self::Message) -> u64;

    /// Removes the message that is sent next.
    fn pop(&mut self) -> Option<Self::Message>;

    /// Whether nothing waits.
    fn is_empty(&self) -> bool;
}

/// One message, the newest.
impl<M: Send + 'static> Waiting for Option<M> {
    type Message = M;

    fn push(&mut self, message: M) -> u64 {
        u64::from(self.replace(message).is_some())
    }

    fn pop(&mut self) -> Option<M> {
        self.take()
    }

    fn is_empty(&self) -> bool {
        self.is_none()
    }
}

/// The queue was closed and accepts nothing more.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the send queue is closed")]
pub struct Closed;

/// What a queue has done so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SendCounts {
    /// Messages that were sent.
    pub sent: u64,
    /// Messages that were dropped for others before they were sent.
    pub dropped: u64,
}

/// A bounded send queue. Clones share it.
#[derive(Debug)]
pub struct SendQueue<W>(Arc<Shared<W>>);

#[derive(Debug, Default)]
struct Shared<W> {
    state: Mutex<State<W>>,
    changed: Condvar,
    /// How its messages are sent where other queues share the thread.
    sharing: OnceLock<Sharing>,
}

#[derive(Debug, Default)]
struct State<W> {
    waiting: W,
    sending: bool,
    closed: bool,
    counts: SendCounts,
    /// Whether it waits for its turn, or has it.
    has_asked: bool,
    /// Whether somebody waits until all is sent.
    is_flushed: bool,
}

/// A thread that others share, and what this queue does when it has its turn.
struct Sharing {
    turns: Turns,
    turn: Turn,
}

impl std::fmt::Debug for Sharing {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.turns.fmt(formatter)
    }
}

impl<W> Clone for SendQueue<W> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<W: Default> Default for SendQueue<W> {
    fn default() -> Self {
        Self(Arc::default())
    }
}

impl<W: Waiting> SendQueue<W> {
    fn state(&self) -> MutexGuard<'_, State<W>> {
        // No critical section can panic half-way: the state behind a poisoned lock is whole.
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Queues a message. Never waits.
    ///
    /// # Errors
    /// [`Closed`] after [`SendQueue::close`].
    pub fn push(&self, message: W::Message) -> Result<(), Closed> {
        let mut state = self.state();
        if state.closed {
            return Err(Closed);
        }
        state.counts.dropped += state.waiting.push(message);
        self.notify(state);
        Ok(())
    }

    /// Something waits: wakes the thread that sends, or asks a shared one for a turn that it was not asked for yet.
    fn notify(&self, mut state: MutexGuard<'_, State<W>>) {
        let Some(sharing) = self.0.sharing.get() else {
            drop(state);
            return self.0.changed.notify_all();
        };
        if !state.waiting.is_empty() && !std::mem::replace(&mut state.has_asked, true) {
            drop(state);
            sharing.turns.ask(Arc::clone(&sharing.turn));
        }
    }

    /// Has a thread send that other queues share: one message in each turn.
    pub fn share(&self, turns: &Turns, send: impl FnMut(W::Message) + Send + 'static) {
        let (queue, send) = (Arc::downgrade(&self.0), Mutex::new(send));
        let turn = move || {
            let Some(queue) = queue.upgrade().map(Self) else { return false };
            let mut state = queue.state();
            let Some(message) = state.waiting.pop() else {
                state.has_asked = false;
                return false;
            };
            state.sending = true;
            drop(state);
            (send.lock().unwrap_or_else(PoisonError::into_inner))(message);
            queue.sent();
            let mut state = queue.state();
            state.has_asked = !state.waiting.is_empty();
            state.has_asked
        };
        let _ = self.0.sharing.set(Sharing { turns: turns.clone(), turn: Arc::new(turn) });
        self.notify(self.state());
    }

    /// A message was sent.
    fn sent(&self) {
        let mut state = self.state();
        state.sending = false;
        state.counts.sent += 1;
        let is_flushed = std::mem::take(&mut state.is_flushed);
        drop(state);
        // Waking costs more than sending does, and most of the time no one waits.
        if is_flushed {
            self.0.changed.notify_all();
        }
    }

    /// What the queue has done so far.
    #[must_use]
    pub fn counts(&self) -> SendCounts {
        self.state().counts
    }

    /// Looks at what waits.
    pub fn inspect<T>(&self, look: impl FnOnce(&W) -> T) -> T {
        look(&self.state().waiting)
    }

    /// Starts the thread that sends; it ends when the queue is closed and nothing waits.
    ///
    /// # Errors
    /// If no thread can be started.
    pub fn start(
        &self,
        thread: &str,
        mut send: impl FnMut(W::Message) + Send + 'static,
    ) -> std::io::Result<JoinHandle<()>> {
        let queue = self.clone();
        std::thread::Builder::new().name(thread.to_owned()).spawn(move || {
            while let Some(message) = queue.next() {
                send(message);
                queue.sent();
            }
        })
    }

    fn next(&self) -> Option<W::Message> {
        let mut state = self.state();
        loop {
            if let Some(message) = state.waiting.pop() {
                state.sending = true;
                return Some(message);
            }
            if state.closed {
                return None;
            }
            state = self.0.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Waits until everything is sent, at most for a time. Blocks.
    pub fn flush(&self, timeout: Duration) {
        let is_busy = |state: &mut State<W>| {
            state.is_flushed = state.sending || !state.waiting.is_empty();
            state.is_flushed
        };
        let _ = self.0.changed.wait_timeout_while(self.state(), timeout, is_busy);
    }

    /// Accepts nothing more; what waits is still sent. Never waits.
    pub fn close(&self) {
        self.state().closed = true;
        self.0.changed.notify_all();
    }

    /// Accepts nothing more and drops what waits. Never waits.
    pub fn abandon(&self) {
        let mut state = self.state();
        state.closed = true;
        state.waiting = W::default();
        drop(state);
        self.0.changed.notify_all();
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use std::sync::mpsc;

    use super::*;

    #[test]
    fn the_newest_message_is_sent_and_a_closed_queue_ends_its_thread() {
        let queue = SendQueue::<Option<u8>>::default();
        queue.push(1).unwrap();
        queue.push(2).unwrap();
        let (sender, receiver) = mpsc::channel();
        let thread = queue.start("test", move |byte| sender.send(byte).unwrap()).unwrap();
        queue.flush(Duration::from_secs(10));
        queue.close();
        thread.join().unwrap();
        assert!(receiver.iter().eq([2]));
        assert_eq!(queue.counts(), SendCounts { sent: 1, dropped: 1 });
        assert_eq!(queue.push(3), Err(Closed));
    }

    #[test]
    fn queues_that_share_a_thread_send_all_in_their_own_order() {
        let turns = Turns::start("test").unwrap();
        let (sender, receiver) = mpsc::channel();
        let queues = [0, 1].map(|number| {
            let (queue, sender) = (SendQueue::<Queue>::default(), sender.clone());
            queue.push(0).unwrap();
            queue.share(&turns, move |byte| sender.send((number, byte)).unwrap());
            queue
        });
        for byte in 1..100 {
            for queue in &queues {
                queue.push(byte).unwrap();
            }
        }
        drop(sender);
        for queue in &queues {
            queue.flush(Duration::from_secs(10));
            assert_eq!(queue.counts(), SendCounts { sent: 100, dropped: 0 });
        }
        drop(queues);
        turns.end();
        let all: Vec<(usize, u8)> = receiver.iter().collect();
        for number in [0, 1] {
            let own = all.iter().filter(|(of, _)| *of == number).map(|(_, byte)| *byte);
            assert!(own.eq(0..100));
        }
    }

    #[derive(Debug, Default)]
    struct Queue(std::collections::VecDeque<u8>);

    impl Waiting for Queue {
        type Message = u8;

        fn push(&mut self, byte: u8) -> u64 {
            self.0.push_back(byte);
            0
        }

        fn pop(&mut self) -> Option<u8> {
            self.0.pop_front()
        }

        fn is_empty(&self) -> bool {
            self.0.is_empty()
        }
    }

    #[test]
    fn flushing_ends_though_the_bus_hangs() {
        let queue = SendQueue::<Option<u8>>::default();
        let (release, held) = mpsc::channel::<()>();
        queue.push(1).unwrap();
        let send = move |_| {
            let _ = held.recv();
        };
        queue.start("test", send).unwrap();
        queue.flush(Duration::from_millis(20));
        queue.abandon();
        assert!(queue.inspect(Option::is_none));
        drop(release);
    }
}
