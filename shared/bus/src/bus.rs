//! A session: puts, subscriptions, gets, liveliness tokens, and whether a router is linked.

use std::collections::HashSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::Context;
use muster_model::id::FleetId;
use muster_wire::foreign::MAX_ATTACHMENT_BYTES;
use muster_wire::{Attachment, Key, KeySpace, Outbound, Packet, Pattern, Source};
use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::{OnceCell, mpsc, oneshot, watch};
use zenoh::Wait;
use zenoh::config::WhatAmI;
use zenoh::key_expr::KeyExpr;
use zenoh::qos::Priority;
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::{Locality, Sample, SampleKind};
use zenoh::session::TransportEvent;

use crate::config::BusConfig;
use crate::handshake::reach;
use crate::zenoh_config::{RETRY_MS, connect_endpoints, is_client, zenoh_config};

/// Most answers to one get, or tokens, that are kept.
const MAX_ANSWERS: usize = 16_384;

/// Most bytes of answers to one get that are kept: a few of the largest messages.
const MAX_ANSWER_BYTES: usize = 512 * 1024 * 1024;

/// Largest payload of a get that is looked at: more than any patch of settings.
const MAX_QUERY_PAYLOAD: usize = 256 * 1024;

/// Longest parameters of a get that are looked at: more than any that is understood, so that whoever
/// asks a bit too much is told so.
const MAX_QUERY_PARAMETERS: usize = 8 * 1024;

/// Most bytes of an error that are read.
const MAX_ERROR: usize = 4096;

/// The priority of who holds a role, said or asked for: on a slow link a claim that waits behind other
/// messages would cost a living holder its role.
const CLAIMS: Priority = Priority::InteractiveHigh;

/// The priority of other gets, and so of their answers: they may be large, and come before nothing that
/// is said once.
const ANSWERS: Priority = Priority::DataLow;

/// What cannot be done on a session that is closed already.
const LINKS_NOT_FOLLOWED: &str = "cannot follow the links of the session";

/// How long closing a session may take.
const CLOSE_WITHIN: Duration = Duration::from_secs(1);

/// When waiting for a router is first told of.
const TELL_WAITING_AFTER: Duration = Duration::from_secs(1);

/// How long each router of a list may take to answer before it is put behind those that do.
const REACH_WITHIN: Duration = Duration::from_secs(1);

/// How long each router of a list may take to open a link in the first round: a few round trips, so
/// that a console comes to the second one. Later rounds have the patience of Zenoh's configuration.
const OPEN_WITHIN_MS: u32 = 2000;

/// The key of that patience.
const OPEN_TIMEOUT: &str = "transport/unicast/open_timeout";

/// How long opening the bus may wait for a router.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Patience {
    /// Until there is one: what services and robots do.
    Forever,
    /// Only so long: what a command at a console does.
    AtMost(Duration),
}

/// Why a session does not open.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// A value or a file of the configuration is wrong.
    #[error("{0}")]
    Config(String),
    /// No router answers, or the address to listen at is taken.
    #[error("{0}")]
    Unreachable(String),
    /// Something else failed.
    #[error("opening the bus failed: {0}")]
    Failed(String),
}

/// An open session with the keys of one fleet.
#[derive(Debug, Clone)]
pub struct Bus {
    session: zenoh::Session,
    /// The session that knows the tokens of robots, if that is another one, once it is open.
    tokens: Arc<OnceCell<zenoh::Session>>,
    /// How that one is opened; none where there can be only one.
    again: Option<zenoh::Config>,
    space: KeySpace,
    link: watch::Receiver<bool>,
    /// What follows the links of a session that belongs to the caller; none where the session is ours.
    borrowed: Option<Arc<Mutex<Option<LinkListener>>>>,
}

/// Follows the links of a session until it is let go.
type LinkListener = zenoh::session::TransportEventsListener<()>;

/// A liveliness token; others see it for as long as this lives.
#[derive(Debug)]
pub struct Token(zenoh::liveliness::LivelinessToken);

/// A key expression that is served for as long as this lives.
#[derive(Debug)]
pub struct Served {
    _queryable: zenoh::query::Queryable<()>,
}

impl Token {
    /// Withdraws the token, as a robot does that leaves on purpose.
    ///
    /// # Errors
    /// If the bus refuses it.
    pub async fn withdraw(self) -> anyhow::Result<()> {
        self.0.undeclare().await.map_err(|error| anyhow::anyhow!("{error}"))
    }
}

/// A subscription; packets are handed over for as long as this lives.
#[derive(Debug)]
pub struct Subscription {
    _subscriber: zenoh::pubsub::Subscriber<()>,
}

/// A get that reached one server of this process.
#[derive(Debug)]
pub struct Asked {
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

/// Whether a packet may wait behind large ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Urgency {
    /// It may.
    Normal,
    /// It may not: a living leader would lose its lease.
    LeaseRenewal,
}

/// One answer to a get.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Answer {
    /// A message on a key.
    Packet(Packet),
    /// An error, as text.
    Error(String),
}

impl Answer {
    fn size(&self) -> usize {
        match self {
            Self::Packet(packet) => packet.key.len() + packet.payload.as_ref().map_or(0, Vec::len),
            Self::Error(text) => text.len(),
        }
    }
}

impl Bus {
    /// Opens a session.
    ///
    /// # Errors
    /// If the configuration is wrong, an endpoint cannot be listened to, or no router was found in
    /// the time that was given.
    pub async fn open(config: impl Into<BusConfig>, patience: Patience) -> Result<Self, OpenError> {
        let config = config.into();
        let zenoh = zenoh_config(&config)?;
        let routers = connect_endpoints(&zenoh).unwrap_or_else(|| config.connect.value.clone());
        let routers = routers.join(", ");
        let remedy = format!(
            "no router answers at {routers}; start one with `muster router`, or name another with \
             --connect; `--log warn` tells what is wrong with a link"
        );
        let again = is_repeatable(&zenoh).then(|| zenoh.clone());
        let mut opening = std::pin::pin!(open_session(zenoh));
        let at_once = match patience {
            Patience::Forever => TELL_WAITING_AFTER,
            Patience::AtMost(limit) => limit,
        };
        let opened = match tokio::time::timeout(at_once, &mut opening).await {
            Ok(opened) => opened,
            Err(_) if patience == Patience::Forever => {
                tracing::warn!("waiting: {remedy}");
                let opened = opening.await;
                tracing::info!("a router answers now");
                opened
            }
            Err(_) => return Err(OpenError::Unreachable(remedy)),
        };
        let failed = |error: anyhow::Error| OpenError::Failed(format!("{error:#}"));
        let session = opened.map_err(failed)?.map_err(|error| {
            OpenError::Unreachable(format!(
                "the bus does not open at {}: {error}; is the address taken? Choose another with --listen",
                config.listen.value.join(", ")
            ))
        })?;
        let (link, follow) = link_watch();
        let info = session.info();
        let listener = info.transport_events_listener().history(true).callback(follow);
        let declared = listener.background().await;
        declared.map_err(|error| failed(anyhow::anyhow!("{LINKS_NOT_FOLLOWED}: {error}")))?;
        let space = KeySpace::new(config.fleet);
        Ok(Self { session, tokens: Arc::default(), again, space, link, borrowed: None })
    }

    /// The keys of a fleet on a session that belongs to the caller and that [`Bus::close`] leaves open.
    ///
    /// # Errors
    /// [`OpenError::Failed`] if the session is closed.
    pub async fn on_session(session: zenoh::Session, fleet: FleetId) -> Result<Self, OpenError> {
        let (link, follow) = link_watch();
        let info = session.info();
        let listener = info.transport_events_listener().history(true).callback(follow);
        let listener = listener
            .await
            .map_err(|error| OpenError::Failed(format!("{LINKS_NOT_FOLLOWED}: {error}")))?;
        let borrowed = Some(Arc::new(Mutex::new(Some(listener))));
        let space = KeySpace::new(fleet);
        Ok(Self { session, tokens: Arc::default(), again: None, space, link, borrowed })
    }

    /// The keys of the fleet.
    #[must_use]
    pub fn space(&self) -> &KeySpace {
        &self.space
    }

    /// Whether a router is linked, and every change of it.
    #[must_use]
    pub fn link(&self) -> watch::Receiver<bool> {
        self.link.clone()
    }

    /// The addresses that this process listens on.
    pub async fn locators(&self) -> Vec<String> {
        self.session.info().locators().await.iter().map(ToString::to_string).collect()
    }

    /// Puts a message. May wait for a busy link, as long as the configuration allows.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn put(&self, message: Outbound) -> anyhow::Result<()> {
        self.put_packet(message.into_packet(&self.space), Urgency::Normal)
    }

    /// Puts a packet on the bus. May wait for a busy link.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn put_packet(&self, packet: Packet, urgency: Urgency) -> anyhow::Result<()> {
        let Packet { key, encoding, payload, attachment, .. } = packet;
        let priority = match urgency {
            Urgency::LeaseRenewal => CLAIMS,
            Urgency::Normal => Priority::DEFAULT,
        };
        self.session
            .put(key.as_str(), payload.unwrap_or_default())
            .encoding(encoding.as_str())
            .attachment(attachment.map(Attachment::into_bytes))
            .priority(priority)
            .wait()
            .map_err(|error| anyhow::anyhow!("cannot put to {key}: {error}"))
    }

    /// Declares a liveliness token.
    ///
    /// # Errors
    /// If the bus refuses it.
    pub async fn declare_token(&self, key: &Key) -> anyhow::Result<Token> {
        let token = self.session.liveliness().declare_token(self.space.format(key)).await;
        token.map(Token).map_err(|error| anyhow::anyhow!("cannot declare {key}: {error}"))
    }

    /// The keys of the liveliness tokens that are there now.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn tokens(&self, pattern: &Pattern, within: Duration) -> anyhow::Result<Vec<Key>> {
        let texts = self.token_texts(&self.space.pattern(pattern), within).await?;
        let mut keys: Vec<_> =
            texts.iter().filter_map(|text| self.space.parse(text).ok()).collect();
        keys.sort_unstable();
        keys.dedup();
        Ok(keys)
    }

    /// The liveliness tokens of every fleet that there are now.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn tokens_of_all_fleets(
        &self,
        within: Duration,
    ) -> anyhow::Result<Vec<(FleetId, Key)>> {
        let mut tokens = self.token_texts(muster_wire::key::ANY_FLEET, within).await?;
        tokens.sort_unstable();
        tokens.dedup();
        Ok(tokens.iter().filter_map(|text| muster_wire::key::parse_any(text)).collect())
    }

    /// The texts of the liveliness tokens that are there now, not more than are kept.
    async fn token_texts(&self, pattern: &str, within: Duration) -> anyhow::Result<Vec<String>> {
        let (sender, mut receiver) = mpsc::channel(MAX_ANSWERS);
        self.session
            .liveliness()
            .get(pattern)
            .timeout(within)
            .callback(move |reply| {
                if let Ok(sample) = reply.result() {
                    let _ = sender.try_send(sample.key_expr().as_str().to_owned());
                }
            })
            .await
            .map_err(|error| anyhow::anyhow!("cannot ask for {pattern}: {error}"))?;
        let mut texts = Vec::new();
        while let Some(text) = receiver.recv().await {
            texts.push(text);
        }
        Ok(texts)
    }

    /// Hands every packet of a pattern to a function, for as long as the session lives. The function
    /// is called on threads of the bus and must not wait. Larger payloads than the keys may have are
    /// cut off.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn subscribe(
        &self,
        pattern: &Pattern,
        take: impl Fn(Packet) + Send + Sync + 'static,
    ) -> anyhow::Result<()> {
        let text = self.space.pattern(pattern);
        let limit = pattern.payload_limit();
        self.session
            .declare_subscriber(text.as_str())
            .callback(move |sample| take(packet(&sample, limit)))
            .background()
            .await
            .map_err(|error| anyhow::anyhow!("cannot subscribe to {text}: {error}"))
    }

    /// Hands every packet of a pattern that others put to a function, for as long as what is returned
    /// lives. The function is called on threads of the bus and must not wait.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn listen(
        &self,
        pattern: &Pattern,
        take: impl Fn(Packet) + Send + Sync + 'static,
    ) -> anyhow::Result<Subscription> {
        let text = self.space.pattern(pattern);
        let limit = pattern.payload_limit();
        let subscriber = self
            .session
            .declare_subscriber(text.as_str())
            .allowed_origin(Locality::Remote)
            .callback(move |sample| take(packet(&sample, limit)))
            .await
            .map_err(|error| anyhow::anyhow!("cannot subscribe to {text}: {error}"))?;
        Ok(Subscription { _subscriber: subscriber })
    }

    /// Hands liveliness tokens to a function, those that are there already as well.
    ///
    /// Those of robots are followed in a session of their own. Zenoh compares the key of a message that
    /// nobody declared with all keys that its session knows beside it, one by one
    /// (`Resource::get_matches` of 1.10.2): in the session that receives the poses of N robots, their N
    /// tokens would make each pose cost N comparisons. With 5,000 robots at 10 Hz that was more than two
    /// cores could do, and most poses were lost.
    ///
    /// # Errors
    /// If the session is closed, or cannot be opened.
    pub async fn subscribe_tokens(
        &self,
        pattern: &Pattern,
        take: impl Fn(Packet) + Send + Sync + 'static,
    ) -> anyhow::Result<()> {
        let text = self.space.pattern(pattern);
        let session = match (&self.again, pattern) {
            (Some(config), Pattern::RobotTokens) => {
                let open = || async {
                    let opened = open_session(config.clone()).await?;
                    opened.map_err(|error| anyhow::anyhow!("a session for tokens: {error}"))
                };
                self.tokens.get_or_try_init(open).await?
            }
            _ => &self.session,
        };
        session
            .liveliness()
            .declare_subscriber(text.as_str())
            .history(true)
            .callback(move |sample| {
                let source = match sample.kind() {
                    SampleKind::Put => Source::TokenAlive,
                    SampleKind::Delete => Source::TokenGone,
                };
                take(Packet { source, ..packet(&sample, 0) });
            })
            .background()
            .await
            .map_err(|error| anyhow::anyhow!("cannot subscribe to tokens {text}: {error}"))
    }

    /// Hands gets of a pattern to a channel for as long as what is returned lives; a get that finds it
    /// full is left unanswered. A `complete` server is the one whose answer suffices.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn serve(
        &self,
        pattern: &Pattern,
        complete: bool,
        queries: mpsc::Sender<Asked>,
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
                // A service that has stopped answers nothing, and need not say so.
                if let Err(TrySendError::Full(_)) =
                    queries.try_send(Asked { query: Query(query), narrowed, payload })
                {
                    tracing::warn!("a get is dropped: too many wait");
                }
            })
            .await
            .map(|queryable| Served { _queryable: queryable })
            .map_err(|error| anyhow::anyhow!("cannot serve {text}: {error}"))
    }

    /// Asks for a pattern and gathers what is answered in time, by everybody or by the best.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn get(&self, pattern: &Pattern, ask: Ask<'_>) -> anyhow::Result<Vec<Answer>> {
        let mut selector = self.space.pattern(pattern);
        if !ask.parameters.is_empty() {
            selector = format!("{selector}?{}", ask.parameters);
        }
        let target = if ask.everybody { QueryTarget::All } else { QueryTarget::BestMatching };
        let session = self.session.clone();
        let (sender, mut receiver) = mpsc::channel(MAX_ANSWERS);
        let payload = ask.payload.map(<[u8]>::to_vec);
        let (within, limit) = (ask.within, pattern.payload_limit());
        let is_claim = matches!(pattern, Pattern::One(key) if is_claim(key));
        let priority = if is_claim { CLAIMS } else { ANSWERS };
        // Asking may wait for a busy link, on the thread that asks. The answers come by a callback
        // into a bounded channel: a handler that is not drained would stall the link.
        let asking = tokio::task::spawn_blocking(move || {
            let mut get = session
                .get(selector.as_str())
                .target(target)
                .consolidation(ConsolidationMode::None)
                .priority(priority)
                .allowed_destination(Locality::Remote)
                .timeout(within);
            if let Some(payload) = payload {
                get = get.payload(payload).encoding(muster_wire::message::JSON);
            }
            let asked = get.callback(move |reply| {
                let answer = match reply.into_result() {
                    Ok(sample) => Answer::Packet(packet(&sample, limit)),
                    Err(error) => Answer::Error(error_text(error.payload())),
                };
                let _ = sender.try_send(answer);
            });
            asked.wait().map_err(|error| anyhow::anyhow!("cannot ask for {selector}: {error}"))
        });
        asking.await.context("asking failed")??;
        let (mut answers, mut bytes) = (Vec::new(), 0);
        while let Some(answer) = receiver.recv().await {
            bytes += answer.size();
            if answers.len() >= MAX_ANSWERS || bytes > MAX_ANSWER_BYTES {
                tracing::warn!("more answers came than are kept");
                break;
            }
            answers.push(answer);
        }
        Ok(answers)
    }

    /// Closes the session, both if there are two; gives up waiting after a moment. The session of a
    /// caller stays open, and its links are not followed any more.
    pub async fn close(&self) {
        if let Some(listener) = &self.borrowed {
            let listener = listener.lock().unwrap_or_else(PoisonError::into_inner).take();
            drop(listener);
            return;
        }
        let sessions = [Some(self.session.clone()), self.tokens.get().cloned()];
        let closing = tokio::task::spawn_blocking(move || {
            // The tokens first: that they are gone says nothing any more.
            let closed = sessions.into_iter().flatten().rev().map(|session| session.close().wait());
            closed.collect::<zenoh::Result<()>>()
        });
        let closed = tokio::time::timeout(CLOSE_WITHIN, closing).await;
        if !matches!(closed, Ok(Ok(Ok(())))) {
            tracing::debug!("the session did not close in time");
        }
    }
}

/// Whether a second session may be opened by the same configuration: clients share no address that they
/// listen at, and have an identity each unless they are given one.
fn is_repeatable(config: &zenoh::Config) -> bool {
    is_client(config) && config.get_json("id").is_ok_and(|id| id == "null")
}

/// Whether a message on a key says who holds a role.
fn is_claim(key: &Key) -> bool {
    matches!(key, Key::Lease(_))
}

/// Whether a get is small enough to wait, by the bytes that it carries and those of its parameters.
fn is_small(carried: usize, parameters: usize) -> bool {
    carried <= MAX_QUERY_PAYLOAD && parameters <= MAX_QUERY_PARAMETERS
}

/// How a get is asked.
#[derive(Debug, Clone, Copy)]
pub struct Ask<'a> {
    /// What follows the `?` of the selector.
    pub parameters: &'a str,
    /// What the get carries.
    pub payload: Option<&'a [u8]>,
    /// How long answers are waited for.
    pub within: Duration,
    /// Whether everybody who serves the pattern is asked, or only who serves it completely.
    pub everybody: bool,
}

fn error_text(payload: &zenoh::bytes::ZBytes) -> String {
    let mut start = vec![0; payload.len().min(MAX_ERROR)];
    let read = std::io::Read::read(&mut payload.reader(), &mut start).unwrap_or_default();
    String::from_utf8_lossy(&start[..read]).into_owned()
}

fn packet(sample: &Sample, limit: usize) -> Packet {
    let payload = sample.payload();
    Packet {
        key: sample.key_expr().as_str().to_owned(),
        encoding: sample.encoding().to_string(),
        source: match sample.kind() {
            SampleKind::Put => Source::Put,
            SampleKind::Delete => Source::Delete,
        },
        payload: if payload.len() > limit {
            Err(payload.len())
        } else {
            Ok(payload.to_bytes().into_owned())
        },
        attachment: sample.attachment().and_then(attachment),
    }
}

/// A small attachment; one that is too large belongs to no program that Muster speaks to.
fn attachment(bytes: &zenoh::bytes::ZBytes) -> Option<Attachment> {
    if bytes.len() > MAX_ATTACHMENT_BYTES {
        return None;
    }
    Attachment::new(bytes.to_bytes()).ok()
}

/// Opens a session. A client tries its routers again and again, those that answer before those that do
/// not; for others what goes wrong is final.
async fn open_session(mut config: zenoh::Config) -> anyhow::Result<zenoh::Result<zenoh::Session>> {
    if !is_client(&config) {
        return attempt(config).await;
    }
    let failed = |error: zenoh::Error| anyhow::anyhow!("{error}");
    let (mut pause, longest_pause) = RETRY_MS;
    let patience = config.get_json(OPEN_TIMEOUT).map_err(failed)?;
    let mut first = true;
    loop {
        if let Some(endpoints) = connect_endpoints(&config).filter(|list| list.len() > 1) {
            let ordered = serde_json::json!(answering_first(endpoints).await).to_string();
            config.insert_json5("connect/endpoints", &ordered).map_err(failed)?;
            let within = if first { OPEN_WITHIN_MS.to_string() } else { patience.clone() };
            config.insert_json5(OPEN_TIMEOUT, &within).map_err(failed)?;
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
            tokio::spawn(async move { (reach(&endpoint, REACH_WITHIN).await.answers(), endpoint) })
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

/// Whether a router is linked, and what must be told of each change of a link. A process that never
/// had a router (a router, a peer) counts as linked.
fn link_watch() -> (watch::Receiver<bool>, impl Fn(TransportEvent) + Send + Sync + 'static) {
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

    #[test]
    fn a_get_is_small_only_with_everything_that_waits_with_it() {
        assert!(is_small(MAX_QUERY_PAYLOAD, MAX_QUERY_PARAMETERS));
        assert!(!is_small(MAX_QUERY_PAYLOAD + 1, 0));
        assert!(!is_small(0, MAX_QUERY_PARAMETERS + 1));
    }
}
