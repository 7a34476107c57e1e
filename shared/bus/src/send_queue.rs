//! One bounded send queue: a thread sends what waits, so that no caller ever waits for the bus.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

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
}

#[derive(Debug, Default)]
struct State<W> {
    waiting: W,
    sending: bool,
    closed: bool,
    counts: SendCounts,
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
        drop(state);
        self.0.changed.notify_all();
        Ok(())
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
                let mut state = queue.state();
                state.sending = false;
                state.counts.sent += 1;
                drop(state);
                queue.0.changed.notify_all();
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
        let is_busy = |state: &mut State<W>| state.sending || !state.waiting.is_empty();
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
