//! One thread for the queues of many: each has its turn with one message, so that none keeps the others waiting.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// Something that has its turn when it asked for one; whether it wants another.
pub(crate) type Turn = Arc<dyn Fn() -> bool + Send + Sync>;

/// Who waits for a turn, in order. Each waits at most once, so that there are not more than queues. Clones share it.
#[derive(Clone, Default)]
pub struct Turns(Arc<Shared>);

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    waiting: VecDeque<Turn>,
    /// Whether the thread sleeps. One that does not looks again by itself: waking costs more than a turn.
    sleeps: bool,
    ended: bool,
}

impl std::fmt::Debug for Turns {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Turns").field("waiting", &self.state().waiting.len()).finish()
    }
}

impl Turns {
    fn state(&self) -> MutexGuard<'_, State> {
        // No critical section can panic half-way: the state behind a poisoned lock is whole.
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Starts the thread that gives turns; it ends after [`Turns::end`].
    ///
    /// # Errors
    /// If no thread can be started.
    pub fn start(thread: &str) -> std::io::Result<Self> {
        let turns = Self::default();
        let own = turns.clone();
        std::thread::Builder::new().name(thread.to_owned()).spawn(move || own.run())?;
        Ok(turns)
    }

    fn run(&self) {
        let mut state = self.state();
        loop {
            let Some(turn) = state.waiting.pop_front() else {
                if state.ended {
                    return;
                }
                state.sleeps = true;
                state = self.0.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
                state.sleeps = false;
                continue;
            };
            drop(state);
            // One that panics must not silence the others: it is not asked again.
            let again = catch_unwind(AssertUnwindSafe(|| turn())).unwrap_or_else(|_| {
                tracing::error!("a turn has panicked");
                false
            });
            state = self.state();
            if again {
                state.waiting.push_back(turn);
            }
        }
    }

    /// Asks for a turn. Never waits.
    pub(crate) fn ask(&self, turn: Turn) {
        let mut state = self.state();
        state.waiting.push_back(turn);
        let sleeps = state.sleeps;
        drop(state);
        if sleeps {
            self.0.changed.notify_one();
        }
    }

    /// Ends the thread once no one waits for a turn.
    pub fn end(&self) {
        self.state().ended = true;
        self.0.changed.notify_all();
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use std::sync::mpsc;

    use super::*;

    #[test]
    fn those_who_want_many_turns_take_them_by_turns() {
        let turns = Turns::default();
        let (sender, receiver) = mpsc::channel();
        for name in ["a", "b"] {
            let (sender, left) = (sender.clone(), Mutex::new(3));
            turns.ask(Arc::new(move || {
                sender.send(name).unwrap();
                let mut left = left.lock().unwrap();
                *left -= 1;
                *left > 0
            }));
        }
        drop(sender);
        turns.end();
        turns.run();
        assert!(receiver.iter().eq(["a", "b", "a", "b", "a", "b"]));
    }
}
