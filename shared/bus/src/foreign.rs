//! Keys of other programs on the same bus: what they put, what their publishers keep, and who this session is.

use std::time::Duration;

use muster_wire::message::quoted;
use muster_wire::{ForeignPattern, Packet};
use serde_json::Value;
use tokio::sync::mpsc;
use zenoh::query::{ConsolidationMode, QueryTarget, ReplyKeyExpr};
use zenoh::sample::Locality;

use crate::bus::{Bus, MAX_ANSWERS, Subscription};
use crate::packet::packet;

/// Below each key, where an advanced publisher of zenoh-ext serves what it keeps (`AdvancedCache` of 1.10.2).
const KEPT: &str = "@adv/**";

/// Most bytes of answers that are taken at once.
const MAX_FOREIGN_BYTES: usize = 64 * 1024 * 1024;

/// Where each router answers for itself, if its administration is open (`AdminSpace` of 1.10.2).
const ROUTERS: &str = "@/*/router";

/// Most bytes of such an answer: a link has some 300, and a router 10,000 of them at most.
const MAX_ROUTER_BYTES: usize = 4 * 1024 * 1024;

/// What a router says of itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RouterState {
    /// Its id, as Zenoh writes it.
    pub id: String,
    /// The version of Zenoh that it runs, such as `1.10.2`, and perhaps more.
    pub version: String,
    /// How many of its links lead to peers.
    pub peers: usize,
}

impl RouterState {
    fn read(bytes: &[u8]) -> Option<Self> {
        let answer: Value = serde_json::from_slice(bytes).ok()?;
        let version = answer["version"].as_str()?;
        let sessions = answer["sessions"].as_array().map_or(&[][..], Vec::as_slice);
        Some(Self {
            id: quoted(answer["zid"].as_str()?),
            version: quoted(version.strip_prefix('v').unwrap_or(version)),
            peers: sessions.iter().filter(|session| session["whatami"] == "peer").count(),
        })
    }
}

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

    /// The keys of liveliness tokens of other programs that are there now.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn foreign_tokens(
        &self,
        pattern: &ForeignPattern,
        within: Duration,
    ) -> anyhow::Result<Vec<String>> {
        let mut texts = self.token_texts(pattern.as_str(), within).await?;
        texts.sort_unstable();
        texts.dedup();
        Ok(texts)
    }

    /// What routers say of themselves. One whose administration is closed, or whose rules keep it from this session, says
    /// nothing.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn routers(&self, within: Duration) -> anyhow::Result<Vec<RouterState>> {
        let mut routers = Vec::new();
        for packet in self.get_foreign(ROUTERS.to_owned(), MAX_ROUTER_BYTES, within).await? {
            routers.extend(packet.payload.ok().and_then(|bytes| RouterState::read(&bytes)));
        }
        routers.sort_by(|left: &RouterState, right| left.id.cmp(&right.id));
        routers.dedup_by(|left, right| left.id == right.id);
        Ok(routers)
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
        self.get_foreign(format!("{pattern}/{KEPT}"), limit, within).await
    }

    /// All answers to a get of other programs, not more than are taken.
    async fn get_foreign(
        &self,
        selector: String,
        limit: usize,
        within: Duration,
    ) -> anyhow::Result<Vec<Packet>> {
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
            if bytes > MAX_FOREIGN_BYTES {
                tracing::warn!("{selector} is answered with more than is taken");
                break;
            }
            kept.push(packet);
        }
        Ok(kept)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;

    #[test]
    fn a_router_names_its_version_and_its_peers() {
        let answer = br#"{"zid":"ab","version":"v1.7.2-3-g1 built with rustc","locators":[],
            "sessions":[{"peer":"1","whatami":"peer"},{"peer":"2","whatami":"client"},{"whatami":"peer"}]}"#;
        let router = RouterState::read(answer).unwrap();
        assert_eq!((router.id.as_str(), router.peers), ("ab", 2));
        assert!(router.version.starts_with("1.7.2"), "{}", router.version);
        assert_eq!(RouterState::read(br#"{"zid":"ab"}"#), None);
        assert_eq!(RouterState::read(b"x"), None);
    }
}
