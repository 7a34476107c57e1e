//! The inbox of a service, shared with the threads that the bus calls back on. They never wait.

use std::sync::{Mutex, MutexGuard, PoisonError};

use muster_service::Arrival;
use muster_service::inbox::{Inbox, InboxCounts, InboxLimits, Parcel};
use tokio::sync::Notify;

/// An inbox that any thread may push to.
#[derive(Debug, Default)]
pub struct SharedInbox {
    inbox: Mutex<Inbox>,
    arrived: Notify,
}

impl SharedInbox {
    /// An empty inbox with other limits.
    #[must_use]
    pub fn bounded(limits: InboxLimits) -> Self {
        Self { inbox: Mutex::new(Inbox::bounded(limits)), arrived: Notify::new() }
    }

    /// No critical section can panic half-way, so that a poisoned lock still guards a whole state.
    fn lock(&self) -> MutexGuard<'_, Inbox> {
        self.inbox.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a packet. Never waits for the bus or the service.
    pub fn push(&self, parcel: Parcel) {
        self.lock().push(parcel);
        self.arrived.notify_one();
    }

    /// The oldest packet that waits.
    #[must_use]
    pub fn pop(&self) -> Option<Arrival> {
        self.lock().pop()
    }

    /// Returns once a packet may wait.
    pub async fn arrived(&self) {
        self.arrived.notified().await;
    }

    /// Wakes [`SharedInbox::arrived`] again, for a loop that leaves packets to look after others.
    pub fn rewake(&self) {
        self.arrived.notify_one();
    }

    /// What was counted so far.
    #[must_use]
    pub fn counts(&self) -> InboxCounts {
        self.lock().counts()
    }
}
