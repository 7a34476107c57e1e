//! Following a stream of a service: a task keeps the newest message, sends gets while nothing
//! arrives, and marks the message stale in time.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use futures_util::{Stream, StreamExt as _, stream};
use muster_bus::{Answer, Ask, Bus, Subscription, Target};
use muster_wire::message::quoted;
use muster_wire::{Key, KeySpace, Packet, Pattern, Rejection};
use tokio::sync::watch;
use tokio::task::{AbortHandle, JoinSet};

use crate::error::Error;
use crate::freshness::{Freshness, GETS_BEFORE_STALE, Latest, Publication, Via};

/// After a refused message was logged, others are only counted for so long: an offender must not flood
/// the log of a robot.
const REFUSED_LOG_INTERVAL: Duration = Duration::from_secs(10);

/// The newest message of a stream, and whether it is still valid.
///
/// A clone follows by itself. The subscription lasts as long as one of them.
#[derive(Debug)]
pub struct Watch<T> {
    receiver: watch::Receiver<Option<Latest<T>>>,
    follower: Arc<Follower>,
}

impl<T> Clone for Watch<T> {
    fn clone(&self) -> Self {
        Self { receiver: self.receiver.clone(), follower: Arc::clone(&self.follower) }
    }
}

/// Ends the task and the subscription with the last clone.
#[derive(Debug)]
struct Follower {
    task: AbortHandle,
    _subscription: Subscription,
}

impl Drop for Follower {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// What the threads of the bus and the task share. A lock is held for a moment only.
#[derive(Debug)]
struct Shared<T> {
    state: Mutex<State<T>>,
    sender: watch::Sender<Option<Latest<T>>>,
}

#[derive(Debug)]
struct State<T> {
    freshness: Freshness<T>,
    refused: u64,
    logged: Option<Instant>,
}

type Decode<T> = fn(&KeySpace, &Packet) -> Result<T, Rejection>;

impl<T: Publication> Shared<T> {
    /// No critical section can panic half-way: the state behind a poisoned lock is whole.
    fn state(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the state. Readers are notified if `change` returns true, and see it in any case.
    fn change(&self, change: impl FnOnce(&mut Freshness<T>) -> bool) {
        let mut state = self.state();
        let changed = change(&mut state.freshness);
        self.sender.send_if_modified(|latest| {
            *latest = state.freshness.latest().cloned();
            changed
        });
    }

    fn receive(&self, decoded: Result<T, Rejection>, via: Via) {
        match decoded {
            Ok(value) => self.change(|freshness| freshness.receive(Instant::now(), value, via)),
            Err(rejection) => self.refuse(&rejection),
        }
    }

    fn refuse(&self, rejection: &Rejection) {
        let mut state = self.state();
        state.refused += 1;
        let now = Instant::now();
        let due = |logged| now.duration_since(logged) >= REFUSED_LOG_INTERVAL;
        if state.logged.is_none_or(due) {
            state.logged = Some(now);
            let count = std::mem::take(&mut state.refused);
            drop(state);
            let Rejection { key, reason, .. } = rejection;
            tracing::warn!("refused on {key}: {reason} ({count} since the last warning)");
        }
    }
}

impl<T> Watch<T> {
    /// The newest message; none before the first one. It may become stale later.
    #[must_use]
    pub fn latest(&self) -> Option<Latest<T>> {
        self.receiver.borrow().clone()
    }

    /// Waits for the next change, and returns the newest message then: other content, or whether it is
    /// stale. If several changes happen between two calls, the last one is returned. The first call
    /// returns at once if a message has arrived already. It may be cancelled at any time, as in
    /// `select!` or with a timeout, without losing anything.
    ///
    /// # Errors
    /// [`Error::Closed`] once the client is closed or the robot has left.
    pub async fn changed(&mut self) -> Result<Latest<T>, Error> {
        loop {
            self.receiver.changed().await.map_err(|_| Error::Closed)?;
            if let Some(latest) = self.receiver.borrow_and_update().clone() {
                return Ok(latest);
            }
        }
    }
}

impl<T: Publication> Watch<T> {
    /// The same changes as a stream, which ends when the client is closed.
    pub fn into_stream(self) -> impl Stream<Item = Latest<T>> + Send + Unpin + 'static {
        let next = async |mut watch: Self| watch.changed().await.ok().map(|latest| (latest, watch));
        stream::unfold(self, next).boxed()
    }

    /// Age in seconds of the oldest robot data behind the newest message, by the clock of this host;
    /// none if there is no such data.
    #[must_use]
    pub fn data_age_s(&self) -> Option<f64> {
        self.latest()?.value.header().data_age_s(crate::reporter::wall_clock())
    }

    /// Follows a key until the last clone is dropped, or the bus is closed.
    pub(crate) async fn follow(
        bus: &Bus,
        key: Key,
        stale_after: Duration,
        decode: Decode<T>,
    ) -> Result<Self, Error> {
        let link = bus.link();
        let freshness = Freshness::new(Instant::now(), stale_after, *link.borrow());
        let state = Mutex::new(State { freshness, refused: 0, logged: None });
        let (sender, receiver) = watch::channel(None);
        let shared = Arc::new(Shared { state, sender });
        // Only the task owns the sender: readers see its end.
        let (receiving, space) = (Arc::downgrade(&shared), bus.space().clone());
        let pattern = Pattern::One(key);
        let subscription = bus
            .listen(&pattern, move |packet| {
                if let Some(shared) = receiving.upgrade() {
                    shared.receive(decode(&space, &packet), Via::Put);
                }
            })
            .await
            .map_err(Error::bus)?;
        let within = stale_after / GETS_BEFORE_STALE;
        let source = Arc::new(Source { bus: bus.clone(), pattern, within, decode });
        let task = tokio::spawn(drive(shared, link, source)).abort_handle();
        Ok(Self { receiver, follower: Arc::new(Follower { task, _subscription: subscription }) })
    }

    /// Ends the following for all clones.
    pub(crate) fn end(&self) {
        self.follower.task.abort();
    }
}

/// Where gets go.
struct Source<T> {
    bus: Bus,
    pattern: Pattern,
    within: Duration,
    decode: Decode<T>,
}

async fn drive<T: Publication>(
    shared: Arc<Shared<T>>,
    mut link: watch::Receiver<bool>,
    source: Arc<Source<T>>,
) {
    // One get at a time; it ends with this task.
    let mut gets = JoinSet::new();
    loop {
        let deadline = shared.state().freshness.deadline();
        let due = async {
            match deadline {
                Some(deadline) => tokio::time::sleep_until(deadline.into()).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            () = due => {}
            changed = link.changed() => {
                if changed.is_err() {
                    return;
                }
                let linked = *link.borrow_and_update();
                shared.change(|freshness| freshness.set_link(Instant::now(), linked));
            }
            Some(_) = gets.join_next() => {}
        }
        let now = Instant::now();
        shared.change(|freshness| freshness.advance(now));
        if shared.state().freshness.take_get(now) && gets.is_empty() {
            gets.spawn(get(Arc::clone(&shared), Arc::clone(&source)));
        }
    }
}

async fn get<T: Publication>(shared: Arc<Shared<T>>, source: Arc<Source<T>>) {
    let Source { bus, pattern, within, decode } = &*source;
    // The service itself serves the key completely; without it every cache replies.
    let ask = Ask {
        parameters: "format=bincode",
        payload: None,
        within: *within,
        further_within: None,
        target: Target::Complete,
    };
    match bus.get(pattern, ask).await {
        Ok(answers) => {
            for answer in answers {
                match answer {
                    Answer::Packet(packet) => {
                        shared.receive(decode(bus.space(), &packet), Via::Reply);
                    }
                    Answer::Error(error) => tracing::debug!("answered with {}", quoted(&error)),
                }
            }
        }
        Err(error) => tracing::debug!("{error:#}"),
    }
}
