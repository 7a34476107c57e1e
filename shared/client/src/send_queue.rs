//! The bounded send queue: the newest message of each key waits, and one thread sends, so that no
//! caller ever waits for the bus.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use muster_wire::{Key, Outbound};

use crate::error::Error;

/// How long a robot that leaves waits until its last messages are sent.
const FLUSH_WITHIN: Duration = Duration::from_millis(500);

/// The bounded send queue. It holds one message per robot and stream at most.
#[derive(Debug, Clone, Default)]
pub(crate) struct SendQueue(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    order: VecDeque<Key>,
    waiting: HashMap<Key, Outbound>,
    sending: bool,
    closed: bool,
    superseded: u64,
}

impl SendQueue {
    /// No critical section can panic half-way: the state behind a poisoned lock is whole.
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Queues a message, in the place of an older one of its key. Never waits.
    ///
    /// # Errors
    /// [`Error::Closed`] after the queue was closed.
    pub(crate) fn push(&self, message: Outbound) -> Result<(), Error> {
        let mut state = self.state();
        if state.closed {
            return Err(Error::Closed);
        }
        let key = message.key.clone();
        if state.waiting.insert(key.clone(), message).is_some() {
            state.superseded += 1;
        } else {
            state.order.push_back(key);
        }
        drop(state);
        self.0.changed.notify_all();
        Ok(())
    }

    /// How many messages were replaced by newer ones before they were sent.
    pub(crate) fn superseded(&self) -> u64 {
        self.state().superseded
    }

    /// Starts the thread that sends; it ends when the queue is closed.
    pub(crate) fn start(
        &self,
        mut send: impl FnMut(Outbound) + Send + 'static,
    ) -> std::io::Result<()> {
        let queue = self.clone();
        let thread = std::thread::Builder::new().name("muster-client".to_owned());
        thread.spawn(move || {
            while let Some(message) = queue.next() {
                send(message);
            }
        })?;
        Ok(())
    }

    fn next(&self) -> Option<Outbound> {
        let mut state = self.state();
        state.sending = false;
        self.0.changed.notify_all();
        loop {
            if state.closed {
                return None;
            }
            let key = state.order.pop_front();
            if let Some(message) = key.and_then(|key| state.waiting.remove(&key)) {
                state.sending = true;
                return Some(message);
            }
            state = self.0.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Waits until everything is sent, for [`FLUSH_WITHIN`] at most. Blocks.
    pub(crate) fn flush(&self) {
        let busy =
            |state: &mut State| !state.closed && (state.sending || !state.waiting.is_empty());
        let _ = self.0.changed.wait_timeout_while(self.state(), FLUSH_WITHIN, busy);
    }

    /// Drops what waits and ends the thread. Never waits.
    pub(crate) fn close(&self) {
        let mut state = self.state();
        state.closed = true;
        state.order.clear();
        state.waiting.clear();
        drop(state);
        self.0.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use std::borrow::Cow;
    use std::sync::mpsc;

    use muster_model::id::RobotId;
    use muster_model::observation::Stream;

    use super::*;

    fn pose(robot: usize, byte: u8) -> Outbound {
        let robot = RobotId::new(format!("r{robot}")).unwrap();
        Outbound {
            key: Key::Stream(robot, Stream::Pose),
            encoding: Cow::Borrowed(""),
            payload: vec![byte],
            attachment: None,
        }
    }

    #[test]
    fn the_newest_of_each_key_leaves_in_the_order_of_the_first() {
        let queue = SendQueue::default();
        for (robot, byte) in [(1, 1), (2, 2), (1, 3)] {
            queue.push(pose(robot, byte)).unwrap();
        }
        let (sender, receiver) = mpsc::channel();
        queue.start(move |message| sender.send(message.payload[0]).unwrap()).unwrap();
        queue.flush();
        assert_eq!(receiver.try_iter().collect::<Vec<_>>(), [3, 2]);
        assert_eq!(queue.superseded(), 1);
        queue.close();
        assert!(matches!(queue.push(pose(1, 4)), Err(Error::Closed)));
        assert_eq!(receiver.recv(), Err(mpsc::RecvError), "the thread has ended");
    }

    #[test]
    fn a_bus_that_hangs_costs_no_caller_its_time_and_no_memory() {
        let queue = SendQueue::default();
        let (release, held) = mpsc::channel::<()>();
        let send = move |_| {
            let _ = held.recv();
        };
        queue.start(send).unwrap();
        for number in 0..100_000 {
            queue.push(pose(number % 4, 0)).unwrap();
        }
        let state = queue.state();
        assert!(state.waiting.len() <= 4 && state.order.len() <= 4);
        drop(state);
        drop(release);
        queue.close();
    }
}
