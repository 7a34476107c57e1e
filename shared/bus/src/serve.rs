//! Served keys, and the gets that reach them.

use muster_wire::{Packet, Pattern};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TrySendError;
use zenoh::Wait;
use zenoh::key_expr::KeyExpr;

use crate::bus::Bus;

/// Largest payload of a get that is looked at: more than any patch of settings.
const MAX_QUERY_PAYLOAD: usize = 256 * 1024;

/// Longest parameters of a get that are looked at: more than any that is understood, so that a get with a
/// parameter too many is answered with an error.
const MAX_QUERY_PARAMETERS: usize = 8 * 1024;

/// A key expression that is served for as long as this lives.
#[derive(Debug)]
pub struct Served {
    _queryable: zenoh::query::Queryable<()>,
}

/// A get that reached one server of this process.
#[derive(Debug)]
pub struct IncomingQuery {
    /// The get.
    pub query: Query,
    /// What the server serves, where the get asks for all of it and perhaps for more.
    pub narrowed: Option<String>,
    /// What the get carries.
    pub payload: Option<Vec<u8>>,
}

/// A get that waits for its answer. It is over when this is let go.
#[derive(Debug)]
pub struct Query(zenoh::query::Query);

impl Query {
    /// The key expression that it asks for.
    #[must_use]
    pub fn selector(&self) -> &str {
        self.0.key_expr().as_str()
    }

    /// What follows the `?` of its selector.
    #[must_use]
    pub fn parameters(&self) -> &str {
        self.0.parameters().as_str()
    }

    /// Answers with a message. May wait for a busy link.
    ///
    /// # Errors
    /// If the session is closed, or the get does not select the key of the message.
    pub fn reply(&self, packet: Packet) -> anyhow::Result<()> {
        let payload = packet.payload.unwrap_or_default();
        self.0
            .reply(packet.key, payload)
            .encoding(packet.encoding.as_str())
            .wait()
            .map_err(|error| anyhow::anyhow!("{error}"))
    }

    /// Answers with an error. May wait for a busy link.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn refuse(&self, problem: String) -> anyhow::Result<()> {
        self.0
            .reply_err(problem)
            .encoding(muster_wire::message::JSON)
            .wait()
            .map_err(|error| anyhow::anyhow!("{error}"))
    }
}

impl Bus {
    /// Hands gets of a pattern to a channel for as long as what is returned lives; a get that finds it
    /// full is left unanswered. A `complete` server is the one whose answer suffices.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn serve(
        &self,
        pattern: &Pattern,
        complete: bool,
        queries: mpsc::Sender<IncomingQuery>,
    ) -> anyhow::Result<Served> {
        let text = self.space.pattern(pattern);
        let served = KeyExpr::try_from(text.clone())
            .map_err(|error| anyhow::anyhow!("{text} is no key expression: {error}"))?;
        self.session
            .declare_queryable(text.as_str())
            .complete(complete)
            .callback(move |mut query| {
                let narrowed =
                    query.key_expr().includes(&served).then(|| served.as_str().to_owned());
                // What waits must be small: a larger get is left where it is, unanswered.
                let carried = [query.payload(), query.attachment()];
                let carried = carried.into_iter().flatten().map(zenoh::bytes::ZBytes::len).sum();
                if !is_small(carried, query.parameters().as_str().len()) {
                    tracing::warn!(
                        "a get is dropped: it carries more than {MAX_QUERY_PAYLOAD} bytes, or has \
                         more than {MAX_QUERY_PARAMETERS} bytes of parameters"
                    );
                    return;
                }
                let payload = query
                    .payload_mut()
                    .map(std::mem::take)
                    .map(|bytes| bytes.to_bytes().into_owned());
                // A service that has stopped answers nothing, which needs no warning.
                if let Err(TrySendError::Full(_)) =
                    queries.try_send(IncomingQuery { query: Query(query), narrowed, payload })
                {
                    tracing::warn!("a get is dropped: too many wait");
                }
            })
            .await
            .map(|queryable| Served { _queryable: queryable })
            .map_err(|error| anyhow::anyhow!("cannot serve {text}: {error}"))
    }
}

/// Whether a get is small enough to wait, by the bytes that it carries and those of its parameters.
fn is_small(carried: usize, parameters: usize) -> bool {
    carried <= MAX_QUERY_PAYLOAD && parameters <= MAX_QUERY_PARAMETERS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_get_is_small_only_with_everything_that_waits_with_it() {
        assert!(is_small(MAX_QUERY_PAYLOAD, MAX_QUERY_PARAMETERS));
        assert!(!is_small(MAX_QUERY_PAYLOAD + 1, 0));
        assert!(!is_small(0, MAX_QUERY_PARAMETERS + 1));
    }
}
