//! A thread of its own that keeps state and answers gets, in order. All of it may wait, for a disk or for a busy
//! link.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Context;
use muster_service::{Input, Stored};
use muster_wire::Packet;
use tokio::sync::{mpsc, oneshot};

use crate::bus::Query;
use crate::kept::KeptStore;
use crate::pool::Pool;
use crate::store::Store;

/// Most tasks that wait.
const MAX_WAITING_TASKS: usize = 256;

/// So many bytes of answers may wait to be sent while a further get is accepted: a few of the largest
/// messages.
const MAX_WAITING_BYTES: usize = 256 * 1024 * 1024;

/// What one input may need of the queue: an answer, and states that are kept before.
const ROOM_TASKS: usize = 8;

enum Task {
    /// The newest state, which has a place of its own, so that it is never dropped.
    Store,
    /// What the core keeps, in the same way.
    Keep,
    Reply {
        query: Query,
        answer: Result<Vec<Packet>, String>,
        bytes: usize,
    },
}

/// What is not on disk yet.
struct Unwritten<T> {
    newest: Option<T>,
    /// How many inputs are owed for it.
    confirmations: u32,
}

impl<T> Default for Unwritten<T> {
    fn default() -> Self {
        Self { newest: None, confirmations: 0 }
    }
}

/// A place for the newest of its kind.
type Place<T> = Arc<Mutex<Unwritten<T>>>;

fn put<T>(place: &Mutex<Unwritten<T>>, newest: T) {
    let mut unwritten = place.lock().unwrap_or_else(PoisonError::into_inner);
    unwritten.newest = Some(newest);
    unwritten.confirmations += 1;
}

fn take<T>(place: &Mutex<Unwritten<T>>) -> Unwritten<T> {
    std::mem::take(&mut *place.lock().unwrap_or_else(PoisonError::into_inner))
}

/// The files of a service.
pub(crate) struct Files {
    pub(crate) store: Store,
    pub(crate) kept: KeptStore,
}

/// What works on the tasks, one after another.
struct Writer<Send> {
    files: Files,
    to_store: Place<Stored>,
    to_keep: Place<Vec<u8>>,
    sent_bytes: Arc<AtomicUsize>,
    span: tracing::Span,
    send: Send,
}

impl<Send: Fn(Input)> Writer<Send> {
    /// Works on a task. May wait for a disk or a busy link.
    fn work(&self, task: Task) {
        let _service = self.span.enter();
        store_newest(&self.files.store, &self.to_store, &self.send);
        match task {
            Task::Store | Task::Keep => {}
            Task::Reply { query, answer, bytes } => {
                self.sent_bytes.fetch_sub(bytes, Ordering::Relaxed);
                reply(&query, answer);
            }
        }
        // Answers wait for the state, and not for this.
        keep_newest(&self.files.kept, &self.to_keep, &self.send);
    }
}

/// Hands tasks to the thread, which ends when all handles are gone.
pub(crate) struct ReplyWorker {
    tasks: mpsc::Sender<Task>,
    unstored: Place<Stored>,
    unkept: Place<Vec<u8>>,
    waiting_bytes: Arc<AtomicUsize>,
}

impl ReplyWorker {
    /// Starts the thread, or a task that works on threads that others share. `send` brings inputs back to the loop. The
    /// returned receiver learns of the end.
    pub(crate) fn start(
        files: Files,
        pool: Option<&Pool>,
        send: impl Fn(Input) + Send + Sync + 'static,
    ) -> anyhow::Result<(Self, oneshot::Receiver<()>)> {
        let (sender, mut tasks) = mpsc::channel::<Task>(MAX_WAITING_TASKS);
        let (done, ended) = oneshot::channel();
        let (unstored, unkept) = (Place::default(), Place::default());
        let waiting_bytes = Arc::new(AtomicUsize::new(0));
        let writer = Writer {
            files,
            to_store: Arc::clone(&unstored),
            to_keep: Arc::clone(&unkept),
            sent_bytes: Arc::clone(&waiting_bytes),
            span: tracing::Span::current(),
            send,
        };
        match pool.cloned() {
            None => {
                let write = move || {
                    while let Some(task) = tasks.blocking_recv() {
                        writer.work(task);
                    }
                    let _ = done.send(());
                };
                std::thread::Builder::new()
                    .name("muster-replies".to_owned())
                    .spawn(write)
                    .context("cannot start the thread that answers gets")?;
            }
            Some(pool) => {
                let writer = Arc::new(writer);
                tokio::spawn(async move {
                    while let Some(task) = tasks.recv().await {
                        let (leave, writer) = (pool.write().await, Arc::clone(&writer));
                        let working = tokio::task::spawn_blocking(move || {
                            writer.work(task);
                            drop(leave);
                        });
                        let _ = working.await;
                    }
                    let _ = done.send(());
                });
            }
        }
        Ok((Self { tasks: sender, unstored, unkept, waiting_bytes }, ended))
    }

    /// Keeps a state over a restart; [`Input::Stored`] follows. Never waits.
    pub(crate) fn store(&self, stored: Stored) {
        put(&self.unstored, stored);
        // If the queue is full, the next task in it stores the state as well.
        let _ = self.tasks.try_send(Task::Store);
    }

    /// Keeps what the core wants kept over a restart; [`Input::Kept`] follows. Never waits.
    pub(crate) fn keep(&self, content: Vec<u8>) {
        put(&self.unkept, content);
        // If the queue is full, it is kept after the next task in it.
        let _ = self.tasks.try_send(Task::Keep);
    }

    /// Whether there is room for what a further get leads to. Where there is none, gets wait where
    /// they are.
    pub(crate) fn has_room(&self) -> bool {
        let waiting = self.waiting_bytes.load(Ordering::Relaxed);
        self.tasks.capacity() >= ROOM_TASKS && waiting <= MAX_WAITING_BYTES
    }

    /// Answers a get. Never waits, given [`ReplyWorker::has_room`].
    pub(crate) fn reply(&self, query: Query, answer: Result<Vec<Packet>, String>) {
        let bytes = answer.iter().flatten().map(Packet::size).sum();
        self.waiting_bytes.fetch_add(bytes, Ordering::Relaxed);
        if let Err(dropped) = self.tasks.try_send(Task::Reply { query, answer, bytes }) {
            self.waiting_bytes.fetch_sub(bytes, Ordering::Relaxed);
            tracing::warn!("an answer is dropped: too many wait");
            // Dropping a get ends it for its sender, which may wait for a busy link.
            tokio::task::spawn_blocking(move || drop(dropped));
        }
    }
}

fn store_newest(store: &Store, unstored: &Mutex<Unwritten<Stored>>, send: &impl Fn(Input)) {
    let unstored = take(unstored);
    let Some(stored) = unstored.newest else { return };
    let error = store.save(&stored).err().map(|error| {
        tracing::error!("settings will not survive a restart: {error:#}");
        format!("{error:#}")
    });
    for _ in 0..unstored.confirmations {
        send(Input::Stored { error: error.clone() });
    }
}

fn keep_newest(store: &KeptStore, unkept: &Mutex<Unwritten<Vec<u8>>>, send: &impl Fn(Input)) {
    let unkept = take(unkept);
    let Some(content) = unkept.newest else { return };
    let error = store.save(&content).err().map(|error| {
        tracing::error!("{error:#}");
        format!("{error:#}")
    });
    for _ in 0..unkept.confirmations {
        send(Input::Kept { error: error.clone() });
    }
}

fn reply(query: &Query, answer: Result<Vec<Packet>, String>) {
    let sent = match answer {
        Ok(packets) => packets.into_iter().try_for_each(|packet| query.reply(packet)),
        Err(error) => query.refuse(error),
    };
    if let Err(error) = sent {
        tracing::debug!("an answer is not sent: {error}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn worker() -> (ReplyWorker, mpsc::Receiver<Task>) {
        let (tasks, receiver) = mpsc::channel(MAX_WAITING_TASKS);
        let worker = ReplyWorker {
            tasks,
            unstored: Place::default(),
            unkept: Place::default(),
            waiting_bytes: Arc::default(),
        };
        (worker, receiver)
    }

    #[test]
    fn gets_wait_while_the_queue_is_full_and_go_on_after() {
        let (worker, mut receiver) = worker();
        for _ in 0..MAX_WAITING_TASKS {
            worker.store(Stored::default());
        }
        assert!(!worker.has_room());
        for _ in 0..ROOM_TASKS {
            receiver.try_recv().unwrap();
        }
        assert!(worker.has_room());
    }

    #[test]
    fn gets_wait_while_large_answers_do() {
        let (worker, _receiver) = worker();
        worker.waiting_bytes.store(MAX_WAITING_BYTES, Ordering::Relaxed);
        assert!(worker.has_room());
        worker.waiting_bytes.store(MAX_WAITING_BYTES + 1, Ordering::Relaxed);
        assert!(!worker.has_room());
    }

    #[test]
    fn every_stored_state_is_confirmed_though_only_the_newest_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let fleet = muster_model::id::FleetId::new("f").unwrap();
        let service = muster_model::id::ServiceName::Ingest;
        let store = Store::new(Some(folder.path()), &fleet, service);
        let unstored = Mutex::new(Unwritten {
            newest: Some(Stored { term: 7, ..Stored::default() }),
            confirmations: 3,
        });
        let confirmed = Mutex::new(Vec::new());
        store_newest(&store, &unstored, &|input| confirmed.lock().unwrap().push(input));
        assert_eq!(confirmed.into_inner().unwrap(), vec![Input::Stored { error: None }; 3]);
        assert_eq!(store.load().term, 7);
    }
}
