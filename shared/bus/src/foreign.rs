//! Keys of other programs on the same bus: what they put, what their publishers keep, and who this session is.

use std::time::Duration;

use muster_wire::{ForeignPattern, Packet};
use tokio::sync::mpsc;
use zenoh::query::{ConsolidationMode, QueryTarget, ReplyKeyExpr};
use zenoh::sample::Locality;

use crate::bus::{Bus, MAX_ANSWERS, Subscription};
use crate::packet::packet;

/// Below each key, where an advanced publisher of zenoh-ext serves what it keeps (`AdvancedCache` of 1.10.2).
const KEPT: &str = "@adv/**";

/// Most bytes of kept messages that are taken at once.
const MAX_KEPT_BYTES: usize = 64 * 1024 * 1024;

impl Bus {
    /// The id of the session, in hexadecimal digits as Zenoh writes it.
    #[must_use]
    pub fn session_id(&self) -> String {
        self.session.zid().to_string()
    }

    /// Hands every packet of a pattern of other programs to a function, for as long as what is returned lives. The
    /// function is called on threads of the bus and must not wait. Larger payloads than the limit are cut off.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn listen_foreign(
        &self,
        pattern: &ForeignPattern,
        limit: usize,
        receive: impl Fn(Packet) + Send + Sync + 'static,
    ) -> anyhow::Result<Subscription> {
        let subscriber = self
            .session
            .declare_subscriber(pattern.as_str())
            .allowed_origin(Locality::Remote)
            .callback(move |sample| receive(packet(&sample, limit)))
            .await
            .map_err(|error| anyhow::anyhow!("cannot subscribe to {pattern}: {error}"))?;
        Ok(Subscription::new(subscriber))
    }

    /// What publishers keep for those that come late: the last messages on a pattern.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn get_kept(
        &self,
        pattern: &ForeignPattern,
        limit: usize,
        within: Duration,
    ) -> anyhow::Result<Vec<Packet>> {
        let selector = format!("{pattern}/{KEPT}");
        let (sender, mut receiver) = mpsc::channel(MAX_ANSWERS);
        self.session
            .get(selector.as_str())
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .accept_replies(ReplyKeyExpr::Any)
            .allowed_destination(Locality::Remote)
            .timeout(within)
            .callback(move |reply| {
                if let Ok(sample) = reply.result() {
                    let _ = sender.try_send(packet(sample, limit));
                }
            })
            .await
            .map_err(|error| anyhow::anyhow!("cannot ask for {selector}: {error}"))?;
        let (mut kept, mut bytes) = (Vec::new(), 0);
        while let Some(packet) = receiver.recv().await {
            bytes += packet.size();
            if bytes > MAX_KEPT_BYTES {
                tracing::warn!("more is kept on {pattern} than is taken");
                break;
            }
            kept.push(packet);
        }
        Ok(kept)
    }
}
