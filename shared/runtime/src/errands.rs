//! What a service does beside its loop, in order, on a thread of its own: keep state, answer gets.
//!
//! Both may wait, the one for a disk and the other for a busy link. State is kept before any later
//! answer is sent, so that what an operator is told survives a crash.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Context;
use muster_machine::Stored;
use muster_wire::Outbound;
use muster_wire::json::Problem;
use tokio::sync::{mpsc, oneshot};

use crate::bus::{Bus, Query};
use crate::store::Store;

/// Most answers that wait to be sent.
const MAX_WAITING: usize = 256;

/// So many bytes of answers may wait to be sent while a further get is taken: a few of the largest
/// messages.
const MAX_WAITING_BYTES: usize = 256 * 1024 * 1024;

/// What one get may need of the queue: an answer, and states that are kept before.
const ROOM: usize = 4;

/// An answer on its way to whoever asked.
struct Answer {
    query: Query,
    answer: Result<Vec<Outbound>, String>,
    /// Whether it says that something is kept.
    kept: bool,
    size: usize,
}

/// An answer; or none, where only the state is to be kept.
type Errand = Option<Answer>;

/// Hands out errands. The thread ends when all handles are gone.
pub(crate) struct Errands {
    sender: mpsc::Sender<Errand>,
    /// The newest state that is not kept yet. It has its own place, so that it is never dropped.
    newest: Arc<Mutex<Option<Stored>>>,
    waiting_bytes: Arc<AtomicUsize>,
}

impl Errands {
    /// Starts the thread. The receiver that is returned hears of its end.
    pub(crate) fn start(bus: Bus, store: Store) -> anyhow::Result<(Self, oneshot::Receiver<()>)> {
        let (sender, mut errands) = mpsc::channel::<Errand>(MAX_WAITING);
        let (done, ended) = oneshot::channel();
        let newest = Arc::new(Mutex::new(None));
        let to_store = Arc::clone(&newest);
        let waiting_bytes = Arc::new(AtomicUsize::new(0));
        let sent_bytes = Arc::clone(&waiting_bytes);
        let span = tracing::Span::current();
        std::thread::Builder::new()
            .name("muster-errands".to_owned())
            .spawn(move || {
                let _service = span.enter();
                let mut kept = Ok(());
                while let Some(errand) = errands.blocking_recv() {
                    let stored = to_store.lock().unwrap_or_else(PoisonError::into_inner).take();
                    if let Some(stored) = stored {
                        kept = keep(&store, &stored);
                    }
                    if let Some(errand) = errand {
                        sent_bytes.fetch_sub(errand.size, Ordering::Relaxed);
                        let answer = match &kept {
                            Err(problem) if errand.kept => Err(problem.clone()),
                            _ => errand.answer,
                        };
                        send(&bus, &errand.query, answer);
                    }
                }
                let _ = done.send(());
            })
            .context("cannot start the thread that answers gets")?;
        Ok((Self { sender, newest, waiting_bytes }, ended))
    }

    /// Keeps a state over a restart. Never waits.
    pub(crate) fn store(&self, stored: Stored) {
        *self.newest.lock().unwrap_or_else(PoisonError::into_inner) = Some(stored);
        // If the queue is full, the errands in it take the state along.
        let _ = self.sender.try_send(None);
    }

    /// Whether there is room for what a further get leads to. Where there is none, gets are to wait
    /// where they are.
    pub(crate) fn has_room(&self) -> bool {
        let waiting = self.waiting_bytes.load(Ordering::Relaxed);
        self.sender.capacity() >= ROOM && waiting <= MAX_WAITING_BYTES
    }

    /// Answers a get. Never waits, given [`Errands::has_room`]. One that says that something is `kept`
    /// becomes an error if that has failed.
    pub(crate) fn reply(&self, query: Query, answer: Result<Vec<Outbound>, String>, kept: bool) {
        let size = answer.iter().flatten().map(|message| message.payload.len()).sum();
        self.waiting_bytes.fetch_add(size, Ordering::Relaxed);
        let answer = Answer { query, answer, kept, size };
        if let Err(dropped) = self.sender.try_send(Some(answer)) {
            self.waiting_bytes.fetch_sub(size, Ordering::Relaxed);
            tracing::warn!("an answer is dropped: too many wait");
            // Letting go of a get tells whoever asked, which waits for a busy link.
            tokio::task::spawn_blocking(move || drop(dropped));
        }
    }
}

fn keep(store: &Store, stored: &Stored) -> Result<(), String> {
    store.save(stored).map_err(|error| {
        tracing::error!("settings will not survive a restart: {error:#}");
        let problem = format!("hold now, but will not survive a restart: {error:#}");
        Problem::new("(settings)", &problem).to_json()
    })
}

fn send(bus: &Bus, query: &Query, answer: Result<Vec<Outbound>, String>) {
    let sent = match answer {
        Ok(messages) => {
            messages.into_iter().try_for_each(|message| query.reply(bus.space(), message))
        }
        Err(error) => query.refuse(error),
    };
    if let Err(error) = sent {
        tracing::debug!("an answer is not sent: {error}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn errands() -> (Errands, mpsc::Receiver<Errand>) {
        let (sender, receiver) = mpsc::channel(MAX_WAITING);
        (Errands { sender, newest: Arc::default(), waiting_bytes: Arc::default() }, receiver)
    }

    #[test]
    fn gets_wait_while_the_queue_is_full_and_go_on_after() {
        let (errands, mut receiver) = errands();
        for _ in 0..MAX_WAITING {
            errands.store(Stored::default());
        }
        assert!(!errands.has_room());
        for _ in 0..ROOM {
            receiver.try_recv().unwrap();
        }
        assert!(errands.has_room());
    }

    #[test]
    fn gets_wait_while_large_answers_do() {
        let (errands, _receiver) = errands();
        errands.waiting_bytes.store(MAX_WAITING_BYTES, Ordering::Relaxed);
        assert!(errands.has_room());
        errands.waiting_bytes.store(MAX_WAITING_BYTES + 1, Ordering::Relaxed);
        assert!(!errands.has_room());
    }
}
