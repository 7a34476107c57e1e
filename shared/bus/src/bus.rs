//! A session: puts, subscriptions, gets, liveliness tokens, and whether a router is linked.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use muster_model::id::FleetId;
use muster_wire::{Attachment, Key, KeySpace, Outbound, Packet, Pattern, Source};
use tokio::sync::{OnceCell, mpsc, watch};
use zenoh::Wait;
use zenoh::qos::Priority;
use zenoh::sample::{Locality, SampleKind};

use crate::config::BusConfig;
use crate::error::OpenError;
use crate::opening::{is_repeatable, link_watch, open_session};
use crate::packet::packet;
use crate::shared::Participant;
use crate::zenoh_config::{connect_endpoints, zenoh_config};

/// Most answers to one get, or tokens, that are kept.
pub(crate) const MAX_ANSWERS: usize = 16_384;

/// The priority of lease renewals and of queries for the leader: on a slow link a renewal that waits behind
/// other messages would cost a living leader its lease.
pub(crate) const LEASE_PRIORITY: Priority = Priority::InteractiveHigh;

/// What cannot be done on a session that is closed already.
pub(crate) const LINKS_NOT_FOLLOWED: &str = "cannot follow the links of the session";

/// How long closing a session may take.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);

/// After what time without a router a warning is logged.
const WARN_WITHOUT_ROUTER_AFTER: Duration = Duration::from_secs(1);

/// How long opening the bus waits for a router.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ConnectTimeout {
    /// Until there is one: what services and robots do.
    Never,
    /// Only so long: what a command at a console does.
    After(Duration),
}

/// An open session with the keys of one fleet.
#[derive(Debug, Clone)]
pub struct Bus {
    pub(crate) session: zenoh::Session,
    /// The session that knows the tokens of robots, if that is another one, once it is open.
    tokens: Arc<OnceCell<zenoh::Session>>,
    /// How that one is opened; none where there can be only one.
    token_config: Option<zenoh::Config>,
    pub(crate) space: KeySpace,
    link: watch::Receiver<bool>,
    /// What follows the links of a session that belongs to the caller; none where the session is ours.
    borrowed: Option<Arc<Mutex<Option<LinkListener>>>>,
    /// Who this is on a bus that many fleets share; none on one of its own.
    pub(crate) participant: Option<Participant>,
}

/// Follows the links of a session until it is let go.
type LinkListener = zenoh::session::TransportEventsListener<()>;

/// A liveliness token; others see it for as long as this lives.
#[derive(Debug)]
pub struct Token(zenoh::liveliness::LivelinessToken);

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

impl Subscription {
    pub(crate) fn new(subscriber: zenoh::pubsub::Subscriber<()>) -> Self {
        Self { _subscriber: subscriber }
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

/// The priority on the bus.
pub(crate) fn priority_of(urgency: Urgency) -> Priority {
    match urgency {
        Urgency::LeaseRenewal => LEASE_PRIORITY,
        Urgency::Normal => Priority::DEFAULT,
    }
}

impl Bus {
    /// Opens a session.
    ///
    /// # Errors
    /// If the configuration is wrong, an endpoint cannot be listened to, or no router was found in
    /// the time that was given.
    pub async fn open(
        config: impl Into<BusConfig>,
        timeout: ConnectTimeout,
    ) -> Result<Self, OpenError> {
        let config = config.into();
        let zenoh = zenoh_config(&config)?;
        let routers = connect_endpoints(&zenoh).unwrap_or_else(|| config.connect.value.clone());
        let routers = routers.join(", ");
        let remedy = format!(
            "no router answers at {routers}; start one with `muster router`, or name another with \
             --connect; `--log warn` shows what is wrong with a link"
        );
        let token_config = is_repeatable(&zenoh).then(|| zenoh.clone());
        let mut opening = std::pin::pin!(open_session(zenoh));
        let at_once = match timeout {
            ConnectTimeout::Never => WARN_WITHOUT_ROUTER_AFTER,
            ConnectTimeout::After(limit) => limit,
        };
        let opened = match tokio::time::timeout(at_once, &mut opening).await {
            Ok(opened) => opened,
            Err(_) if timeout == ConnectTimeout::Never => {
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
        let tokens = Arc::default();
        Ok(Self { session, tokens, token_config, space, link, borrowed: None, participant: None })
    }

    /// The bus of one participant of a shared one.
    pub(crate) fn of_participant(
        session: zenoh::Session,
        space: KeySpace,
        link: watch::Receiver<bool>,
        participant: Participant,
    ) -> Self {
        let (tokens, participant) = (Arc::default(), Some(participant));
        Self { session, tokens, token_config: None, space, link, borrowed: None, participant }
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
        let (tokens, token_config) = (Arc::default(), None);
        Ok(Self { session, tokens, token_config, space, link, borrowed, participant: None })
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

    /// Hands a packet to those who read it in the same process, on a bus that many fleets share. It never waits. Elsewhere
    /// it does nothing: [`Bus::put_packet`] reaches them all.
    pub fn hand_over(&self, packet: &Packet) {
        if let Some(participant) = &self.participant {
            participant.routes.hand_over(participant.id, packet);
        }
    }

    /// Whether lease renewals are to be put: on a bus that many fleets share, only where another process has a service of
    /// the fleet.
    #[must_use]
    pub fn has_rivals(&self) -> bool {
        self.participant.as_ref().is_none_or(Participant::has_rivals)
    }

    /// Puts a packet on the bus. May wait for a busy link. On a bus that many fleets share it reaches other processes;
    /// [`Bus::hand_over`] reaches this one.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn put_packet(&self, packet: Packet, urgency: Urgency) -> anyhow::Result<()> {
        if let Some(participant) = &self.participant {
            return participant.hub.put(&participant.routes, packet, urgency);
        }
        let Packet { key, encoding, payload, attachment, .. } = packet;
        self.session
            .put(key.as_str(), payload.unwrap_or_default())
            .encoding(encoding.as_str())
            .attachment(attachment.map(Attachment::into_bytes))
            .priority(priority_of(urgency))
            .wait()
            .map_err(|error| anyhow::anyhow!("cannot put to {key}: {error}"))
    }

    /// Declares a liveliness token.
    ///
    /// # Errors
    /// If the bus refuses it.
    pub async fn declare_token(&self, key: &Key) -> anyhow::Result<Token> {
        let text = self.space.format(key);
        if let Some(participant) = &self.participant {
            participant.hub.owns_token(&text);
        }
        let token = self.session.liveliness().declare_token(text).await;
        token.map(Token).map_err(|error| anyhow::anyhow!("cannot declare {key}: {error}"))
    }

    /// The keys of the liveliness tokens that are there now.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn tokens(&self, pattern: &Pattern, within: Duration) -> anyhow::Result<Vec<Key>> {
        let texts = match &self.participant {
            Some(participant) => participant.tokens(pattern),
            None => self.token_texts(&self.space.pattern(pattern), within).await?,
        };
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
    pub(crate) async fn token_texts(
        &self,
        pattern: &str,
        within: Duration,
    ) -> anyhow::Result<Vec<String>> {
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
        receive: impl Fn(Packet) + Send + Sync + 'static,
    ) -> anyhow::Result<()> {
        if let (Some(participant), false) =
            (&self.participant, matches!(pattern, Pattern::Foreign(_)))
        {
            return participant.routes.subscribe(participant.id, pattern, receive);
        }
        let text = self.space.pattern(pattern);
        let limit = pattern.payload_limit();
        self.session
            .declare_subscriber(text.as_str())
            .callback(move |sample| receive(packet(&sample, limit)))
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
        receive: impl Fn(Packet) + Send + Sync + 'static,
    ) -> anyhow::Result<Subscription> {
        let text = self.space.pattern(pattern);
        let limit = pattern.payload_limit();
        let subscriber = self
            .session
            .declare_subscriber(text.as_str())
            .allowed_origin(Locality::Remote)
            .callback(move |sample| receive(packet(&sample, limit)))
            .await
            .map_err(|error| anyhow::anyhow!("cannot subscribe to {text}: {error}"))?;
        Ok(Subscription::new(subscriber))
    }

    /// Hands liveliness tokens to a function, those that are there already as well.
    ///
    /// Those of robots are followed in a session of their own. Zenoh compares an undeclared key of
    /// a message with all other keys of its session, one by one (`Resource::get_matches` of 1.10.2): in
    /// the session that receives the poses of N robots, their N tokens would make each pose cost N comparisons. With 5,000 robots at 10 Hz that was more than two
    /// cores could do, and most poses were lost.
    ///
    /// # Errors
    /// If the session is closed, or cannot be opened.
    pub async fn subscribe_tokens(
        &self,
        pattern: &Pattern,
        receive: impl Fn(Packet) + Send + Sync + 'static,
    ) -> anyhow::Result<()> {
        if let Some(participant) = &self.participant {
            return participant.routes.subscribe_tokens(participant.id, pattern, receive);
        }
        let text = self.space.pattern(pattern);
        let session = match (&self.token_config, pattern) {
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
                receive(Packet { source, ..packet(&sample, 0) });
            })
            .background()
            .await
            .map_err(|error| anyhow::anyhow!("cannot subscribe to tokens {text}: {error}"))
    }

    /// Closes the session, both if there are two; gives up waiting after a moment. The session of a
    /// caller stays open, and its links are not followed any more; so does one that others share.
    pub async fn close(&self) {
        if let Some(participant) = &self.participant {
            return participant.routes.leave(participant.id);
        }
        if let Some(listener) = &self.borrowed {
            let listener = listener.lock().unwrap_or_else(PoisonError::into_inner).take();
            drop(listener);
            return;
        }
        // The tokens first: by then their loss means nothing.
        let sessions = [self.tokens.get().cloned(), Some(self.session.clone())];
        close_sessions(sessions.into_iter().flatten().collect()).await;
    }
}

/// Closes sessions one after another; gives up waiting after a moment.
pub(crate) async fn close_sessions(sessions: Vec<zenoh::Session>) {
    let closing = tokio::task::spawn_blocking(move || {
        let closed = sessions.into_iter().map(|session| session.close().wait());
        closed.collect::<zenoh::Result<()>>()
    });
    let closed = tokio::time::timeout(CLOSE_TIMEOUT, closing).await;
    if !matches!(closed, Ok(Ok(Ok(())))) {
        tracing::debug!("the session did not close in time");
    }
}
