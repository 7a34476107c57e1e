//! Notes for a service manager (systemd's `sd_notify`): that the process has started, what it is doing,
//! that its loops run, and that it stops. Without `NOTIFY_SOCKET` there are no notes.
//!
//! *Started* means that the process does its work or waits for its router: a router may be away for
//! long, and restarting its clients meanwhile would not help. Whether a service serves is in its status.
//!
//! The work loops feed the watchdog themselves: each reports a heartbeat, and the manager gets one once
//! all loops of the process have reported. One loop that hangs is enough for a restart of the process.
//! While a process waits for its router, the task that waits is its loop.

use std::collections::BTreeMap;
use std::future::Future;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use muster_wire::message::quoted;
use sd_notify::NotifyState;
use tokio::sync::oneshot;
use tokio::time::{Instant, sleep_until};

/// Most notes that wait for the manager: one heartbeat, and what a few services do at once.
const MAX_WAITING: usize = 16;

/// How many heartbeats fit into the time that the manager waits: a late one does no harm.
const HEARTBEATS_PER_TIMEOUT: u32 = 4;

/// Shortest time between two heartbeats, whatever the manager asks for: the loop has other work.
const MIN_HEARTBEAT_INTERVAL: Duration = Duration::from_millis(10);

/// How long the end of the process may wait until the manager has its last note.
const STOPPING_TIMEOUT: Duration = Duration::from_millis(200);

/// A note for the manager.
#[derive(Debug)]
enum Note {
    Ready(String),
    Status(String),
    Alive,
    /// The sender learns when the note was sent.
    Stopping(oneshot::Sender<()>),
}

/// The manager of this process.
struct Manager {
    notes: SyncSender<Note>,
    /// How often each loop reports a heartbeat; none without a watchdog.
    heartbeat_interval: Option<Duration>,
    /// Whether a heartbeat waits to be sent; a second one would add nothing.
    heartbeat_waits: Arc<AtomicBool>,
    loops: Mutex<Loops>,
}

#[derive(Default)]
struct Loops {
    ready: bool,
    next_id: u64,
    /// Whether each loop has reported since the last heartbeat of the process.
    reported: BTreeMap<u64, bool>,
}

/// The manager of this process, if it has one.
fn manager() -> Option<&'static Manager> {
    static MANAGER: OnceLock<Option<Manager>> = OnceLock::new();
    MANAGER.get_or_init(Manager::of_environment).as_ref()
}

impl Manager {
    fn of_environment() -> Option<Self> {
        std::env::var_os("NOTIFY_SOCKET").filter(|socket| !socket.is_empty())?;
        let (notes, waiting) = sync_channel(MAX_WAITING);
        let heartbeat_waits = Arc::new(AtomicBool::new(false));
        let heartbeat_sent = Arc::clone(&heartbeat_waits);
        // A thread of its own: the manager may take its time, and the loops have none.
        let thread = std::thread::Builder::new().name("muster-notify".to_owned());
        let started = thread.spawn(move || {
            while let Ok(note) = waiting.recv() {
                if let Err(error) = send(&note) {
                    tracing::debug!("a note to the service manager is lost: {error}");
                }
                match note {
                    Note::Alive => heartbeat_sent.store(false, Ordering::Relaxed),
                    Note::Stopping(sent) => drop(sent.send(())),
                    Note::Ready(_) | Note::Status(_) => {}
                }
            }
        });
        if let Err(error) = started {
            tracing::warn!("the service manager gets no notes: {error}");
            return None;
        }
        let timeout = sd_notify::watchdog_enabled().filter(|watched| !watched.is_zero());
        let heartbeat_interval =
            timeout.map(|timeout| (timeout / HEARTBEATS_PER_TIMEOUT).max(MIN_HEARTBEAT_INTERVAL));
        Some(Self { notes, heartbeat_interval, heartbeat_waits, loops: Mutex::default() })
    }

    fn loops(&self) -> MutexGuard<'_, Loops> {
        self.loops.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Never waits: a manager that does not read misses notes.
    fn note(&self, note: Note) {
        let _ = self.notes.try_send(note);
    }

    fn send_heartbeat(&self) {
        if !self.heartbeat_waits.swap(true, Ordering::Relaxed)
            && self.notes.try_send(Note::Alive).is_err()
        {
            self.heartbeat_waits.store(false, Ordering::Relaxed);
        }
    }
}

fn send(note: &Note) -> std::io::Result<()> {
    match note {
        Note::Ready(doing) => sd_notify::notify(&[NotifyState::Ready, NotifyState::Status(doing)]),
        Note::Status(doing) => sd_notify::notify(&[NotifyState::Status(doing)]),
        Note::Alive => sd_notify::notify(&[NotifyState::Watchdog]),
        Note::Stopping(_) => sd_notify::notify(&[NotifyState::Stopping]),
    }
}

/// Reports that the process has started, once, and what it does.
pub fn ready(doing: &str) {
    let Some(manager) = manager() else { return };
    let first = !std::mem::replace(&mut manager.loops().ready, true);
    // One line per note: what follows a line break would be another note.
    let doing = quoted(doing);
    manager.note(if first { Note::Ready(doing) } else { Note::Status(doing) });
}

/// Reports what the process does now.
pub fn status(doing: &str) {
    if let Some(manager) = manager() {
        manager.note(Note::Status(quoted(doing)));
    }
}

/// Reports that the process stops, and waits a moment for the note: the rest of the end may be quick.
pub async fn stopping() {
    if let Some(manager) = manager() {
        let (sender, sent) = oneshot::channel();
        manager.note(Note::Stopping(sender));
        let _ = tokio::time::timeout(STOPPING_TIMEOUT, sent).await;
    }
}

/// One loop of the process that the manager watches, for as long as this lives.
#[derive(Debug)]
pub struct Watched {
    loop_id: u64,
    interval: Option<Duration>,
    next: Instant,
}

/// Has a loop watched. It must call [`Watched::report`] whenever [`Watched::due`] returns.
#[must_use]
pub fn watch() -> Watched {
    let interval = manager().and_then(|manager| manager.heartbeat_interval);
    let mut loop_id = 0;
    if let (Some(manager), Some(_)) = (manager(), interval) {
        let mut loops = manager.loops();
        loop_id = loops.next_id;
        loops.next_id += 1;
        loops.reported.insert(loop_id, false);
    }
    Watched { loop_id, interval, next: Instant::now() }
}

impl Watched {
    /// Returns when the next heartbeat of the loop is due; never without a watchdog.
    pub async fn due(&self) {
        match self.interval {
            Some(_) => sleep_until(self.next).await,
            None => std::future::pending().await,
        }
    }

    /// Reports a heartbeat of the loop.
    pub fn report(&mut self) {
        let (Some(interval), Some(manager)) = (self.interval, manager()) else { return };
        self.next = Instant::now() + interval;
        let mut loops = manager.loops();
        loops.reported.insert(self.loop_id, true);
        if loops.reported.values().all(|reported| *reported) {
            loops.reported.values_mut().for_each(|reported| *reported = false);
            manager.send_heartbeat();
        }
    }

    /// Waits for something, with heartbeats meanwhile.
    pub async fn during<T>(&mut self, what: impl Future<Output = T>) -> T {
        let mut what = std::pin::pin!(what);
        loop {
            tokio::select! {
                result = &mut what => return result,
                () = self.due() => self.report(),
            }
        }
    }
}

impl Drop for Watched {
    fn drop(&mut self) {
        if let (Some(manager), Some(_)) = (manager(), self.interval) {
            manager.loops().reported.remove(&self.loop_id);
        }
    }
}
