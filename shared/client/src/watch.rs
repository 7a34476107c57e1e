//! Following what services tell: a task that keeps the newest, asks when it is silent, and marks it
//! stale in time.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use muster_bus::{Answer, Ask, Bus, Subscription};
use muster_model::header::Header;
use muster_wire::message::quoted;
use muster_wire::{Key, KeySpace, Packet, Pattern, Rejection};
use tokio::sync::watch;
use tokio::task::{AbortHandle, JoinSet};

use crate::error::Error;
use crate::keeper::{ASKS, Keeper, Latest, Telling, Way};

/// How long refused messages are only counted after one was logged: an offender must not flood the
/// log of a robot.
const REFUSED_SILENCE: Duration = Duration::from_secs(10);

/// What a service tells on one key: the newest, and whether it still holds.
///
/// A clone follows by itself. The key is followed for as long as one of them lives.
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

/// Ends the task and the subscription when nobody follows any more.
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
    keeper: Keeper<T>,
    refused: u64,
    logged: Option<Instant>,
}

type Decode<T> = fn(&KeySpace, &Packet) -> Result<T, Rejection>;

impl<T: Telling> Shared<T> {
    /// No critical section can panic half-way, so that a poisoned lock still guards a whole state.
    fn state(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the keeper; those who follow hear of it if it says so, and see it in any case.
    fn change(&self, change: impl FnOnce(&mut Keeper<T>) -> bool) {
        let mut state = self.state();
        let changed = change(&mut state.keeper);
        self.sender.send_if_modified(|latest| {
            *latest = state.keeper.latest().cloned();
            changed
        });
    }

    fn take(&self, understood: Result<T, Rejection>, way: Way) {
        match understood {
            Ok(value) => self.change(|keeper| keeper.told(Instant::now(), value, way)),
            Err(rejection) => self.refuse(&rejection),
        }
    }

    fn refuse(&self, rejection: &Rejection) {
        let mut state = self.state();
        state.refused += 1;
        let now = Instant::now();
        if state.logged.is_none_or(|logged| now.duration_since(logged) >= REFUSED_SILENCE) {
            state.logged = Some(now);
            let count = std::mem::take(&mut state.refused);
            drop(state);
            let Rejection { key, reason, .. } = rejection;
            tracing::warn!("refused on {key}: {reason} ({count} since the last such word)");
        }
    }
}

impl<T> Watch<T> {
    /// What was told last; none if nothing was told yet. A later look may find it stale.
    #[must_use]
    pub fn latest(&self) -> Option<Latest<T>> {
        self.receiver.borrow().clone()
    }

    /// Waits for the next change, and returns what holds then: another content, or whether it is
    /// stale. Changes that come faster than they are looked at are passed over, all but the last. The
    /// first call returns at once if something was told already. It may be given up at any time, as
    /// in `select!` or with a timeout, without losing anything.
    ///
    /// # Errors
    /// [`Error::Closed`] once nothing is told any more.
    pub async fn changed(&mut self) -> Result<Latest<T>, Error> {
        loop {
            self.receiver.changed().await.map_err(|_| Error::Closed)?;
            if let Some(latest) = self.receiver.borrow_and_update().clone() {
                return Ok(latest);
            }
        }
    }
}

impl<T: Telling> Watch<T> {
    /// Age in seconds of the oldest robot data behind what was told last, by the clock of this host;
    /// none if there is no such data.
    #[must_use]
    pub fn data_age_s(&self) -> Option<f64> {
        let header: Header = self.latest()?.value.header().clone();
        header.data_age_s(crate::voice::wall_clock())
    }

    /// Follows a key until nobody holds the watch any more, or the bus is gone.
    pub(crate) async fn follow(
        bus: &Bus,
        key: Key,
        stale_after: Duration,
        decode: Decode<T>,
    ) -> Result<Self, Error> {
        let link = bus.link();
        let keeper = Keeper::new(Instant::now(), stale_after, *link.borrow());
        let state = Mutex::new(State { keeper, refused: 0, logged: None });
        let (sender, receiver) = watch::channel(None);
        let shared = Arc::new(Shared { state, sender });
        // The task alone keeps the sender: when it has ended, those who follow hear of it.
        let (taking, space) = (Arc::downgrade(&shared), bus.space().clone());
        let pattern = Pattern::One(key);
        let subscription = bus
            .listen(&pattern, move |packet| {
                if let Some(shared) = taking.upgrade() {
                    shared.take(decode(&space, &packet), Way::Put);
                }
            })
            .await
            .map_err(Error::bus)?;
        let within = stale_after / ASKS;
        let questions = Arc::new(Questions { bus: bus.clone(), pattern, within, decode });
        let task = tokio::spawn(drive(shared, link, questions)).abort_handle();
        Ok(Self { receiver, follower: Arc::new(Follower { task, _subscription: subscription }) })
    }

    /// Ends the following for all who hold it.
    pub(crate) fn end(&self) {
        self.follower.task.abort();
    }
}

/// How a key is asked for.
struct Questions<T> {
    bus: Bus,
    pattern: Pattern,
    within: Duration,
    decode: Decode<T>,
}

async fn drive<T: Telling>(
    shared: Arc<Shared<T>>,
    mut link: watch::Receiver<bool>,
    questions: Arc<Questions<T>>,
) {
    // One question at a time; it ends with the task.
    let mut asking = JoinSet::new();
    loop {
        let deadline = shared.state().keeper.deadline();
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
                shared.change(|keeper| keeper.link(Instant::now(), linked));
            }
            Some(_) = asking.join_next() => {}
        }
        let now = Instant::now();
        shared.change(|keeper| keeper.pass(now));
        if shared.state().keeper.asks(now) && asking.is_empty() {
            asking.spawn(ask(Arc::clone(&shared), Arc::clone(&questions)));
        }
    }
}

async fn ask<T: Telling>(shared: Arc<Shared<T>>, questions: Arc<Questions<T>>) {
    let Questions { bus, pattern, within, decode } = &*questions;
    // Who serves the key completely is its author; only without one are all asked who remember.
    let ask =
        Ask { parameters: "format=bincode", payload: None, within: *within, everybody: false };
    match bus.get(pattern, ask).await {
        Ok(answers) => {
            for answer in answers {
                match answer {
                    Answer::Packet(packet) => {
                        shared.take(decode(bus.space(), &packet), Way::Answer);
                    }
                    Answer::Error(error) => tracing::debug!("answered with {}", quoted(&error)),
                }
            }
        }
        Err(error) => tracing::debug!("{error:#}"),
    }
}
