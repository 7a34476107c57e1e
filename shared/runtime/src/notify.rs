//! What a service manager is told (systemd's `sd_notify`): that the process has started, what it is
//! doing, that its loops turn, and that it stops. Without `NOTIFY_SOCKET` nothing is told to anybody.
//!
//! *Started* means that the process does its work or waits for its router. A router may be away for
//! long, and a service manager that starts its clients anew all the while would help nobody; whether
//! a service serves is told by its status, and by what it publishes.
//!
//! The watchdog is fed by the work loops themselves: each says at every beat that it has turned, and
//! the manager hears of it only once all loops of the process have. One that hangs is enough for the
//! process to be started anew. While a process waits for its router, the task that waits is its loop.

use std::collections::BTreeMap;
use std::future::Future;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use muster_wire::message::quoted;
use sd_notify::NotifyState;
use tokio::sync::oneshot;
use tokio::time::{Instant, sleep_until};

/// Most notes that wait for the manager: one that the loops turn, and what a few services do at once.
const MAX_WAITING: usize = 16;

/// How often a loop says so within the time that the manager waits: one late beat is forgiven.
const BEATS: u32 = 4;

/// Shortest time between two beats, whatever the manager asks for: the loop has other work.
const SHORTEST_BEAT: Duration = Duration::from_millis(10);

/// How long the end of the process may wait for the manager to hear of it.
const STOPPING_WITHIN: Duration = Duration::from_millis(200);

/// What the manager is told.
#[derive(Debug)]
enum Note {
    Ready(String),
    Status(String),
    Alive,
    /// With whom it is to be told once the manager knows.
    Stopping(oneshot::Sender<()>),
}

/// The manager of this process.
struct Manager {
    notes: SyncSender<Note>,
    /// How often each loop has to say that it turns; nothing if nobody watches.
    beat: Option<Duration>,
    /// Whether a note waits that the loops turn; a second one would say nothing more.
    alive_waits: Arc<AtomicBool>,
    told: Mutex<Told>,
}

#[derive(Default)]
struct Told {
    ready: bool,
    next: u64,
    /// Which loops there are, and whether each has turned since the manager heard of all.
    turned: BTreeMap<u64, bool>,
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
        let alive_waits = Arc::new(AtomicBool::new(false));
        let alive_taken = Arc::clone(&alive_waits);
        // A thread of its own: the manager may take its time, and the loops have none.
        let thread = std::thread::Builder::new().name("muster-notify".to_owned());
        let started = thread.spawn(move || {
            while let Ok(note) = waiting.recv() {
                if let Err(error) = send(&note) {
                    tracing::debug!("the service manager is not told: {error}");
                }
                match note {
                    Note::Alive => alive_taken.store(false, Ordering::Relaxed),
                    Note::Stopping(told) => drop(told.send(())),
                    Note::Ready(_) | Note::Status(_) => {}
                }
            }
        });
        if let Err(error) = started {
            tracing::warn!("the service manager will not be told anything: {error}");
            return None;
        }
        let beat = sd_notify::watchdog_enabled().filter(|watched| !watched.is_zero());
        let beat = beat.map(|watched| (watched / BEATS).max(SHORTEST_BEAT));
        Some(Self { notes, beat, alive_waits, told: Mutex::default() })
    }

    /// Never waits: a manager that does not listen misses notes.
    fn tell(&self, note: Note) {
        let _ = self.notes.try_send(note);
    }

    fn tell_alive(&self) {
        if !self.alive_waits.swap(true, Ordering::Relaxed)
            && self.notes.try_send(Note::Alive).is_err()
        {
            self.alive_waits.store(false, Ordering::Relaxed);
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

/// Tells that the process has started, once, and what it does.
pub fn ready(doing: &str) {
    let Some(manager) = manager() else { return };
    let mut told = manager.told.lock().unwrap_or_else(PoisonError::into_inner);
    let first = !std::mem::replace(&mut told.ready, true);
    // One line per note: what follows a line break would be another note.
    let doing = quoted(doing);
    manager.tell(if first { Note::Ready(doing) } else { Note::Status(doing) });
}

/// Tells what the process does now.
pub fn status(doing: &str) {
    if let Some(manager) = manager() {
        manager.tell(Note::Status(quoted(doing)));
    }
}

/// Tells that the process stops, and waits a moment for that: what is left to do may be quick.
pub async fn stopping() {
    if let Some(manager) = manager() {
        let (sender, told) = oneshot::channel();
        manager.tell(Note::Stopping(sender));
        let _ = tokio::time::timeout(STOPPING_WITHIN, told).await;
    }
}

/// One loop of the process that the manager watches, for as long as this lives.
#[derive(Debug)]
pub struct Watched {
    loop_id: u64,
    every: Option<Duration>,
    next: Instant,
}

/// Has a loop watched. It must call [`Watched::beat`] whenever [`Watched::due`] returns.
#[must_use]
pub fn watch() -> Watched {
    let every = manager().and_then(|manager| manager.beat);
    let mut loop_id = 0;
    if let (Some(manager), Some(_)) = (manager(), every) {
        let mut told = manager.told.lock().unwrap_or_else(PoisonError::into_inner);
        loop_id = told.next;
        told.next += 1;
        told.turned.insert(loop_id, false);
    }
    Watched { loop_id, every, next: Instant::now() }
}

impl Watched {
    /// Returns when the loop has to say again that it turns; never if nobody watches.
    pub async fn due(&self) {
        match self.every {
            Some(_) => sleep_until(self.next).await,
            None => std::future::pending().await,
        }
    }

    /// Says that the loop has turned.
    pub fn beat(&mut self) {
        let (Some(every), Some(manager)) = (self.every, manager()) else { return };
        self.next = Instant::now() + every;
        let mut told = manager.told.lock().unwrap_or_else(PoisonError::into_inner);
        told.turned.insert(self.loop_id, true);
        if told.turned.values().all(|turned| *turned) {
            told.turned.values_mut().for_each(|turned| *turned = false);
            manager.tell_alive();
        }
    }

    /// Waits for something, as a loop that turns meanwhile.
    pub async fn during<T>(&mut self, what: impl Future<Output = T>) -> T {
        let mut what = std::pin::pin!(what);
        loop {
            tokio::select! {
                result = &mut what => return result,
                () = self.due() => self.beat(),
            }
        }
    }
}

impl Drop for Watched {
    fn drop(&mut self) {
        if let (Some(manager), Some(_)) = (manager(), self.every) {
            let mut told = manager.told.lock().unwrap_or_else(PoisonError::into_inner);
            told.turned.remove(&self.loop_id);
        }
    }
}
