//! What happens to robots, teams and services, one event after the other.

use muster_bus::{Bus, Subscription};
use muster_model::event::Event;
use muster_wire::{Key, Message, Pattern};
use tokio::sync::broadcast;
use tokio::sync::broadcast::error::RecvError;

use crate::error::Error;

/// Most events that wait for a console: when a whole fleet joins at once, the last of them are told,
/// and how many were missed.
const MAX_WAITING: usize = 1024;

/// The events of a fleet, from the moment of asking on.
#[derive(Debug)]
pub struct Events {
    receiver: broadcast::Receiver<Event>,
    missed: u64,
    _subscription: Subscription,
}

impl Events {
    pub(crate) async fn follow(bus: &Bus) -> Result<Self, Error> {
        let (sender, receiver) = broadcast::channel(MAX_WAITING);
        let space = bus.space().clone();
        let subscription = bus
            .listen(&Pattern::One(Key::Event), move |packet| {
                match Message::decode(&space, &packet) {
                    Ok(Message::Event(event)) => drop(sender.send(event)),
                    Ok(_) => {}
                    Err(refused) => {
                        tracing::debug!("refused on {}: {}", refused.key, refused.reason)
                    }
                }
            })
            .await
            .map_err(Error::bus)?;
        Ok(Self { receiver, missed: 0, _subscription: subscription })
    }

    /// The next event. It may be given up at any time without losing one.
    ///
    /// # Errors
    /// [`Error::Closed`] once the client is closed.
    pub async fn next(&mut self) -> Result<Event, Error> {
        loop {
            match self.receiver.recv().await {
                Ok(event) => return Ok(event),
                Err(RecvError::Lagged(many)) => self.missed += many,
                Err(RecvError::Closed) => return Err(Error::Closed),
            }
        }
    }

    /// How many events were passed over because more than 1024 waited.
    #[must_use]
    pub const fn missed(&self) -> u64 {
        self.missed
    }
}
