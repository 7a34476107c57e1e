//! What bridges say of themselves, and what is seen of other programs on the bus and of its routers.

use std::sync::Arc;

use muster_bus::{Answer, IncomingQuery, RouterState, Served, Target};
use muster_model::bridge::BridgeState;
use muster_model::id::InstanceId;
use muster_wire::{ForeignPattern, Key, KeySpace, Pattern};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};

use crate::client::Client;
use crate::error::Error;
use crate::get::{REPLY_TIMEOUT, ask_for};

/// Most gets that wait for a bridge, and as many whose answers wait for a busy link: only an operator's tools ask.
const MAX_WAITING_GETS: usize = 16;

/// Gets of what a bridge says of itself, for as long as this lives.
#[derive(Debug)]
pub struct BridgeGets {
    receiver: mpsc::Receiver<IncomingQuery>,
    space: KeySpace,
    answering: Arc<Semaphore>,
    _served: Served,
}

/// One get, which waits for its answer.
#[derive(Debug)]
pub struct BridgeGet {
    query: IncomingQuery,
    space: KeySpace,
    permit: OwnedSemaphorePermit,
}

impl BridgeGets {
    /// The next get. It may be cancelled at any time, as in `select!`, without losing one. While too many answers wait for the
    /// link, it waits as well.
    pub async fn next(&mut self) -> BridgeGet {
        let permit = Arc::clone(&self.answering).acquire_owned().await;
        match (permit, self.receiver.recv().await) {
            (Ok(permit), Some(query)) => BridgeGet { query, space: self.space.clone(), permit },
            // The session is closed: no get comes any more.
            _ => std::future::pending().await,
        }
    }
}

impl BridgeGet {
    /// Answers it, without waiting for a busy link.
    pub fn answer(self, state: BridgeState) {
        let packet = muster_wire::bridge::encode(&self.space, state);
        tokio::task::spawn_blocking(move || {
            if let Err(error) = self.query.query.reply(packet) {
                tracing::debug!("{error:#}");
            }
            drop(self.permit);
        });
    }
}

impl Client {
    /// Serves what a bridge says of itself.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn serve_bridge(&self, instance: &InstanceId) -> Result<BridgeGets, Error> {
        let (sender, receiver) = mpsc::channel(MAX_WAITING_GETS);
        let pattern = Pattern::One(Key::Bridge(instance.clone()));
        let served = self.bus().serve(&pattern, true, sender).await.map_err(Error::bus)?;
        let answering = Arc::new(Semaphore::new(MAX_WAITING_GETS));
        Ok(BridgeGets { receiver, space: self.bus().space().clone(), answering, _served: served })
    }

    /// What the bridges of the fleet say of themselves, by their names. Empty if none replies.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn get_bridges(&self) -> Result<Vec<BridgeState>, Error> {
        let mut bridges = Vec::new();
        for answer in self.get(&Pattern::Bridges, ask_for("format=json", Target::All)).await? {
            let Answer::Packet(packet) = answer else { continue };
            match muster_wire::bridge::decode(self.bus().space(), &packet) {
                Ok(state) => bridges.push(state),
                Err(refused) => tracing::warn!("refused on {}: {}", refused.key, refused.reason),
            }
        }
        bridges.sort_by(|left, right| left.instance.cmp(&right.instance));
        bridges.dedup_by(|left, right| left.instance == right.instance);
        Ok(bridges)
    }

    /// The keys of liveliness tokens that other programs have on this bus.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn get_foreign_tokens(&self, pattern: &ForeignPattern) -> Result<Vec<String>, Error> {
        self.bus().foreign_tokens(pattern, REPLY_TIMEOUT).await.map_err(Error::bus)
    }

    /// What the routers of this bus say of themselves: those of Zenoh and of ROS do by default, `muster router` does not,
    /// and rules of access may keep it from a client.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn get_routers(&self) -> Result<Vec<RouterState>, Error> {
        self.bus().routers(REPLY_TIMEOUT).await.map_err(Error::bus)
    }
}
