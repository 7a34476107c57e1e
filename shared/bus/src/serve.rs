//! Served keys, and the gets that reach them.

use muster_wire::{Packet, Pattern};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TrySendError;
use zenoh::Wait;
use zenoh::key_expr::KeyExpr;

use crate::bus::Bus;
use crate::get::Answer;
use crate::shared::Participant;

/// Largest payload of a get that is looked at: more than any patch of settings.
const MAX_QUERY_PAYLOAD: usize = 256 * 1024;

/// Longest parameters of a get that are looked at: more than any that is understood, so that a get with a
/// parameter too many is answered with an error.
const MAX_QUERY_PARAMETERS: usize = 8 * 1024;

/// A key expression that is served for as long as this lives.
#[derive(Debug)]
pub struct Served(Serving);

#[derive(Debug)]
enum Serving {
    /// On the bus, until it is let go of.
    OnBus { _queryable: zenoh::query::Queryable<()> },
    /// In the process, under a number.
    InProcess(Participant, u64),
}

impl Drop for Served {
    fn drop(&mut self) {
        if let Serving::InProcess(participant, id) = &self.0 {
            participant.routes.unserve(*id);
        }
    }
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
pub struct Query(Asked);

#[derive(Debug)]
enum Asked {
    OnBus(zenoh::query::Query),
    /// By another service of the same process, which gets the answers from the channel.
    InProcess {
        selector: String,
        parameters: String,
        answers: mpsc::Sender<Answer>,
    },
}

impl Query {
    pub(crate) fn of_bus(query: zenoh::query::Query) -> Self {
        Self(Asked::OnBus(query))
    }

    pub(crate) fn of_process(
        selector: &str,
        parameters: &str,
        answers: mpsc::Sender<Answer>,
    ) -> Self {
        let (selector, parameters) = (selector.to_owned(), parameters.to_owned());
        Self(Asked::InProcess { selector, parameters, answers })
    }

    /// The key expression that it asks for.
    #[must_use]
    pub fn selector(&self) -> &str {
        match &self.0 {
            Asked::OnBus(query) => query.key_expr().as_str(),
            Asked::InProcess { selector, .. } => selector,
        }
    }

    /// What follows the `?` of its selector.
    #[must_use]
    pub fn parameters(&self) -> &str {
        match &self.0 {
            Asked::OnBus(query) => query.parameters().as_str(),
            Asked::InProcess { parameters, .. } => parameters,
        }
    }

    /// Answers with a message. May wait for a busy link.
    ///
    /// # Errors
    /// If the session is closed, the get does not select the key of the message, or who asked has enough answers.
    pub fn reply(&self, packet: Packet) -> anyhow::Result<()> {
        match &self.0 {
            Asked::OnBus(query) => {
                let payload = packet.payload.unwrap_or_default();
                let reply = query.reply(packet.key, payload).encoding(packet.encoding.as_str());
                reply.wait().map_err(|error| anyhow::anyhow!("{error}"))
            }
            Asked::InProcess { answers, .. } => Ok(answers.try_send(Answer::Packet(packet))?),
        }
    }

    /// Answers with an error. May wait for a busy link.
    ///
    /// # Errors
    /// If the session is closed, or who asked has enough answers.
    pub fn refuse(&self, problem: String) -> anyhow::Result<()> {
        match &self.0 {
            Asked::OnBus(query) => {
                let reply = query.reply_err(problem).encoding(muster_wire::message::JSON);
                reply.wait().map_err(|error| anyhow::anyhow!("{error}"))
            }
            Asked::InProcess { answers, .. } => Ok(answers.try_send(Answer::Error(problem))?),
        }
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
        if let Some(participant) = &self.participant {
            let id = participant.routes.serve(participant.id, pattern, complete, queries)?;
            return Ok(Served(Serving::InProcess(participant.clone(), id)));
        }
        let text = self.space.pattern(pattern);
        let served = KeyExpr::try_from(text.clone())
            .map_err(|error| anyhow::anyhow!("{text} is no key expression: {error}"))?;
        self.session
            .declare_queryable(text.as_str())
            .complete(complete)
            .callback(move |mut query| {
                let narrowed =
                    query.key_expr().includes(&served).then(|| served.as_str().to_owned());
                if !is_small_query(&query) {
                    return;
                }
                let payload = query
                    .payload_mut()
                    .map(std::mem::take)
                    .map(|bytes| bytes.to_bytes().into_owned());
                // A service that has stopped answers nothing, which needs no warning.
                if let Err(TrySendError::Full(_)) = queries.try_send(IncomingQuery {
                    query: Query::of_bus(query),
                    narrowed,
                    payload,
                }) {
                    tracing::warn!("a get is dropped: too many wait");
                }
            })
            .await
            .map(|queryable| Served(Serving::OnBus { _queryable: queryable }))
            .map_err(|error| anyhow::anyhow!("cannot serve {text}: {error}"))
    }
}

/// Whether a get is small enough to wait. A larger one is left where it is, unanswered.
pub(crate) fn is_small_query(query: &zenoh::query::Query) -> bool {
    let carried = [query.payload(), query.attachment()];
    let carried = carried.into_iter().flatten().map(zenoh::bytes::ZBytes::len).sum();
    let is_small = is_small(carried, query.parameters().as_str().len());
    if !is_small {
        tracing::warn!(
            "a get is dropped: it carries more than {MAX_QUERY_PAYLOAD} bytes, or has more than \
             {MAX_QUERY_PARAMETERS} bytes of parameters"
        );
    }
    is_small
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
