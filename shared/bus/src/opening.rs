//! How a session is opened, and how its links are followed.

use std::collections::HashSet;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::{oneshot, watch};
use zenoh::Wait;
use zenoh::config::WhatAmI;
use zenoh::sample::SampleKind;
use zenoh::session::TransportEvent;

use crate::handshake::reach;
use crate::zenoh_config::{RETRY_MS, connect_endpoints, is_client};

/// How long each router of a list may take to answer before it is put behind those that do.
const REACH_TIMEOUT: Duration = Duration::from_secs(1);

/// How long each router of a list may take to open a link in the first round: a few round trips, so
/// that a console comes to the second one. Later rounds have the timeout of Zenoh's configuration.
const FIRST_OPEN_TIMEOUT_MS: u32 = 2000;

/// The key of that timeout.
const OPEN_TIMEOUT: &str = "transport/unicast/open_timeout";

/// Opens a session. A client tries its routers again and again, those that answer before those that do
/// not; for others what goes wrong is final.
pub(crate) async fn open_session(
    mut config: zenoh::Config,
) -> anyhow::Result<zenoh::Result<zenoh::Session>> {
    if !is_client(&config) {
        return attempt(config).await;
    }
    let failed = |error: zenoh::Error| anyhow::anyhow!("{error}");
    let (mut pause, longest_pause) = RETRY_MS;
    let timeout = config.get_json(OPEN_TIMEOUT).map_err(failed)?;
    let mut first = true;
    loop {
        if let Some(endpoints) = connect_endpoints(&config).filter(|list| list.len() > 1) {
            let ordered = serde_json::json!(answering_first(endpoints).await).to_string();
            config.insert_json5("connect/endpoints", &ordered).map_err(failed)?;
            let timeout_ms =
                if first { FIRST_OPEN_TIMEOUT_MS.to_string() } else { timeout.clone() };
            config.insert_json5(OPEN_TIMEOUT, &timeout_ms).map_err(failed)?;
            first = false;
        }
        match attempt(config.clone()).await? {
            Ok(session) => return Ok(Ok(session)),
            Err(error) => tracing::debug!("no session: {error}"),
        }
        tokio::time::sleep(Duration::from_millis(pause)).await;
        pause = (pause * 2).min(longest_pause);
    }
}

/// Opens a session once, on a thread of its own: Zenoh opens on the thread that asks. A plain thread
/// can be left behind when it is time to stop; a runtime would wait for one of its own as it ends.
async fn attempt(config: zenoh::Config) -> anyhow::Result<zenoh::Result<zenoh::Session>> {
    let (sender, opened) = oneshot::channel();
    std::thread::Builder::new()
        .name("muster-open".to_owned())
        .spawn(move || drop(sender.send(zenoh::open(config).wait())))?;
    Ok(opened.await?)
}

/// The routers of a list with those first that answer now: one that is silent costs Zenoh seconds.
async fn answering_first(endpoints: Vec<String>) -> Vec<String> {
    let looking: Vec<_> = endpoints
        .into_iter()
        .map(|endpoint| {
            tokio::spawn(async move { (reach(&endpoint, REACH_TIMEOUT).await.answers(), endpoint) })
        })
        .collect();
    let (mut there, mut gone) = (Vec::new(), Vec::new());
    for look in looking {
        if let Ok((answers, endpoint)) = look.await {
            if answers { &mut there } else { &mut gone }.push(endpoint);
        }
    }
    there.append(&mut gone);
    there
}

/// Whether a second session may be opened by the same configuration: one of a client that listens at no address, and that has
/// no id of its own.
pub(crate) fn is_repeatable(config: &zenoh::Config) -> bool {
    let listens = config.get_json("listen/endpoints").is_ok_and(|endpoints| {
        serde_json::from_str::<Vec<String>>(&endpoints).is_ok_and(|list| !list.is_empty())
    });
    is_client(config) && !listens && config.get_json("id").is_ok_and(|id| id == "null")
}

/// Whether a router is linked, and the listener for each change of a link. A process that never had a
/// router (a router, a peer) counts as linked.
pub(crate) fn link_watch()
-> (watch::Receiver<bool>, impl Fn(TransportEvent) + Send + Sync + 'static) {
    let (sender, receiver) = watch::channel(true);
    let linked = Mutex::new(HashSet::new());
    let follow = move |event: TransportEvent| {
        if event.transport().whatami() != WhatAmI::Router {
            return;
        }
        let mut linked = linked.lock().unwrap_or_else(PoisonError::into_inner);
        match event.kind() {
            SampleKind::Put => linked.insert(*event.transport().zid()),
            SampleKind::Delete => linked.remove(event.transport().zid()),
        };
        sender.send_if_modified(|up| {
            let changed = *up == linked.is_empty();
            *up = !linked.is_empty();
            changed
        });
    };
    (receiver, follow)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_client_without_a_given_identity_opens_a_second_session() {
        let config = |settings: &[(&str, &str)]| {
            let mut config = zenoh::Config::default();
            for (key, value) in settings {
                config.insert_json5(key, value).unwrap();
            }
            config
        };
        assert!(is_repeatable(&config(&[("mode", "\"client\"")])));
        assert!(!is_repeatable(&config(&[("mode", "\"peer\"")])));
        assert!(!is_repeatable(&config(&[("mode", "\"client\""), ("id", "\"a1\"")])));
    }
}
