//! The bounded way out: the newest of each key waits, and one thread sends, so that no caller ever
//! waits for the bus.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use muster_wire::{Key, Outbound};

/// How long a robot that leaves waits for what it said last to be sent.
const FLUSH_WITHIN: Duration = Duration::from_millis(500);

/// The bounded way out. It holds one message per robot and stream at most.
#[derive(Debug, Clone, Default)]
pub(crate) struct Outgoing(Arc<Shared>);

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

impl Outgoing {
    /// No critical section can panic half-way, so that a poisoned lock still guards a whole state.
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Hands a message to the sender, in the place of an older one that waits. Never waits. False if
    /// nothing is sent any more.
    pub(crate) fn push(&self, message: Outbound) -> bool {
        let mut state = self.state();
        if state.closed {
            return false;
        }
        let key = message.key.clone();
        if state.waiting.insert(key.clone(), message).is_some() {
            state.superseded += 1;
        } else {
            state.order.push_back(key);
        }
        drop(state);
        self.0.changed.notify_all();
        true
    }

    /// How many messages gave way to newer ones before they were sent.
    pub(crate) fn superseded(&self) -> u64 {
        self.state().superseded
    }

    /// Starts the thread that sends; it ends when this is closed.
    pub(crate) fn start(
        &self,
        mut send: impl FnMut(Outbound) + Send + 'static,
    ) -> std::io::Result<()> {
        let outgoing = self.clone();
        let thread = std::thread::Builder::new().name("muster-client".to_owned());
        thread.spawn(move || {
            while let Some(message) = outgoing.next() {
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

    /// Waits a moment until everything is sent. Blocks.
    pub(crate) fn flush(&self) {
        let busy =
            |state: &mut State| !state.closed && (state.sending || !state.waiting.is_empty());
        let _ = self.0.changed.wait_timeout_while(self.state(), FLUSH_WITHIN, busy);
    }

    /// Sends nothing any more. Never waits.
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
        let outgoing = Outgoing::default();
        for (robot, byte) in [(1, 1), (2, 2), (1, 3)] {
            assert!(outgoing.push(pose(robot, byte)));
        }
        let (sender, receiver) = mpsc::channel();
        outgoing.start(move |message| sender.send(message.payload[0]).unwrap()).unwrap();
        outgoing.flush();
        assert_eq!(receiver.try_iter().collect::<Vec<_>>(), [3, 2]);
        assert_eq!(outgoing.superseded(), 1);
        outgoing.close();
        assert!(!outgoing.push(pose(1, 4)));
        assert_eq!(receiver.recv(), Err(mpsc::RecvError), "the thread has ended");
    }

    #[test]
    fn a_bus_that_hangs_costs_no_caller_its_time_and_no_memory() {
        let outgoing = Outgoing::default();
        let (release, held) = mpsc::channel::<()>();
        let send = move |_| {
            let _ = held.recv();
        };
        outgoing.start(send).unwrap();
        for number in 0..100_000 {
            outgoing.push(pose(number % 4, 0));
        }
        let state = outgoing.state();
        assert!(state.waiting.len() <= 4 && state.order.len() <= 4);
        drop(state);
        drop(release);
        outgoing.close();
    }
}
