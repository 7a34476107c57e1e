//! One bus for the services of many fleets in one process.
//!
//! What services of one process put for each other is handed over in the process ([`routes`]), and crosses
//! the bus only where somebody else reads it. Three sessions do the rest, because Zenoh compares a message
//! under the text of a key with every key of its session (`Resource::get_matches` of 1.10.2):
//!
//! - one *receives*. It has a handful of subscriptions for all fleets together, and no other key.
//! - one *sends*. It declares every key that it puts to, so that Zenoh knows who reads it: what no one reads
//!   never leaves the process.
//! - one follows *tokens*.
//!
//! Once another process has a service of one of the fleets, everything that the fleets put is received as well, and gets and
//! lease renewals go to the bus too. Until then gets are answered in the process alone, but for those of the first seconds.

mod routes;
mod scopes;

use std::collections::{BTreeSet, HashMap};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::time::{Duration, Instant};

use muster_model::id::FleetId;
use muster_wire::key::{fleet_name, parse_any};
use muster_wire::{Attachment, FleetPattern, Key, Packet, Pattern, Source};
use tokio::sync::{mpsc, watch};
use zenoh::Wait;
use zenoh::key_expr::{KeyExpr, keyexpr};
use zenoh::pubsub::Publisher;
use zenoh::qos::Priority;
use zenoh::sample::{Sample, SampleKind};

pub(crate) use self::routes::{FleetRoutes, ParticipantId};
pub use self::scopes::MAX_SCOPES;
use self::scopes::Scopes;
use crate::bus::{Bus, ConnectTimeout, LINKS_NOT_FOLLOWED, Urgency, priority_of};
use crate::config::BusConfig;
use crate::error::OpenError;
use crate::get::{Answer, Ask};
use crate::opening::{is_repeatable, link_watch, open_session};
use crate::packet::packet;
use crate::serve::{IncomingQuery, Query, is_small_query};
use crate::zenoh_config::zenoh_config;

/// Most fleets that are kept track of, served or not: names at random must not fill the memory.
const MAX_KNOWN_FLEETS: usize = 8192;

/// Most keys of one fleet that are declared; those beyond are put by their text. 10,000 robots have one each.
const MAX_DECLARED: usize = 16_384;

/// Most fleets that have appeared and wait to be served.
const MAX_APPEARED: usize = 1024;

/// After what time a fleet that is not served is reported again.
const REPORT_AGAIN_AFTER: Duration = Duration::from_secs(10);

/// How often fleets are let go of to make room for others.
const SWEEP_INTERVAL: Duration = Duration::from_secs(1);

/// How long gets are asked on the bus whatever is known of other processes: their tokens may be under way.
const ASKS_BUS_FOR: Duration = Duration::from_secs(10);

/// How many gets may be put on the bus at the same time: each may wait for a busy link, on a thread.
const MAX_ASKING: usize = 8;

/// A bus that services of many fleets share. Clones share it.
#[derive(Clone)]
pub struct SharedBus(Arc<Hub>);

impl std::fmt::Debug for SharedBus {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("SharedBus").field("scopes", &self.0.scopes).finish_non_exhaustive()
    }
}

/// One instance of a service on a shared bus.
#[derive(Clone)]
pub(crate) struct Participant {
    pub(crate) hub: Arc<Hub>,
    pub(crate) routes: Arc<FleetRoutes>,
    pub(crate) id: ParticipantId,
    joined: Instant,
}

impl std::fmt::Debug for Participant {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Participant").field("id", &self.id).finish_non_exhaustive()
    }
}

/// A fleet that is known.
struct Known {
    routes: Arc<FleetRoutes>,
    /// The keys that were put to.
    publishers: Mutex<HashMap<String, Arc<Publisher<'static>>>>,
    /// When it was last reported that it is not served.
    reported: Mutex<Option<Instant>>,
}

/// What all participants share.
pub(crate) struct Hub {
    scopes: Scopes,
    receiving: zenoh::Session,
    sending: zenoh::Session,
    following: zenoh::Session,
    fleets: RwLock<HashMap<String, Arc<Known>>>,
    /// When fleets were last let go of because there was no room.
    swept: Mutex<Option<Instant>>,
    next_participant: AtomicU64,
    /// The texts of the tokens of services of this process.
    own_tokens: Mutex<BTreeSet<String>>,
    /// Whether another process was seen to have services of these fleets. From then on everything that the fleets put is
    /// received, and gets and lease renewals go to the bus: the other process may come back unnoticed.
    has_others: AtomicBool,
    /// When a link last came up.
    linked: Arc<Mutex<Instant>>,
    appeared: mpsc::Sender<FleetId>,
    link: watch::Receiver<bool>,
    /// Marks gets of this process, which it does not answer over the bus.
    mark: Vec<u8>,
    asking: tokio::sync::Semaphore,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // No critical section can panic half-way, so that a poisoned lock still guards a whole state.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl SharedBus {
    /// Opens the sessions for all fleets that patterns mean. Fleets that have robots and are not served are sent to the
    /// returned receiver, again and again until they are.
    ///
    /// # Errors
    /// If the configuration is wrong, or no router was found in the time that was given.
    pub async fn open(
        config: impl Into<BusConfig>,
        timeout: ConnectTimeout,
        patterns: &[FleetPattern],
    ) -> Result<(Self, mpsc::Receiver<FleetId>), OpenError> {
        let config = config.into();
        let failed = |error: anyhow::Error| OpenError::Failed(format!("{error:#}"));
        let zenoh = zenoh_config(&config)?;
        if !is_repeatable(&zenoh) {
            return Err(OpenError::Config(
                "many fleets share three sessions of one configuration, which must be that of a client that has no id, and \
                 not an address to listen at: leave mode, id and listen out, or add --router"
                    .to_owned(),
            ));
        }
        // The first waits for a router and says so; the others find the same.
        let first = Bus::open(config, timeout).await?;
        let mut sessions = vec![first.session.clone()];
        for _ in 0..2 {
            let session = open_session(zenoh.clone()).await.map_err(failed)?;
            sessions.push(session.map_err(|error| OpenError::Unreachable(error.to_string()))?);
        }
        let (Some(following), Some(sending)) = (sessions.pop(), sessions.pop()) else {
            return Err(OpenError::Failed("a session is missing".to_owned()));
        };
        let receiving = first.session.clone();
        let (sends, follow) = link_watch();
        let info = sending.info();
        let listener = info.transport_events_listener().history(true).callback(follow);
        let declared = listener.background().await;
        declared.map_err(|error| failed(anyhow::anyhow!("{LINKS_NOT_FOLLOWED}: {error}")))?;
        let (appeared, appearing) = mpsc::channel(MAX_APPEARED);
        let linked = Arc::new(Mutex::new(Instant::now()));
        let hub = Arc::new(Hub {
            scopes: Scopes::new(patterns),
            swept: Mutex::default(),
            mark: receiving.zid().to_string().into_bytes(),
            receiving,
            sending,
            following,
            fleets: RwLock::default(),
            next_participant: AtomicU64::new(0),
            own_tokens: Mutex::default(),
            has_others: AtomicBool::new(false),
            appeared,
            link: both(first.link(), sends, Arc::clone(&linked)),
            linked,
            asking: tokio::sync::Semaphore::new(MAX_ASKING),
        });
        hub.declare().await.map_err(failed)?;
        Ok((Self(hub), appearing))
    }

    /// The bus of one more instance of a service of a fleet.
    #[must_use]
    pub fn join(&self, fleet: &FleetId) -> Bus {
        let hub = Arc::clone(&self.0);
        let known = hub.serve_fleet(fleet);
        let id = hub.next_participant.fetch_add(1, Ordering::Relaxed);
        let participant =
            Participant { routes: Arc::clone(&known.routes), id, joined: Instant::now(), hub };
        let (session, link) = (self.0.sending.clone(), self.0.link.clone());
        Bus::of_participant(session, known.routes.space.clone(), link, participant)
    }

    /// How long a fleet has had no robots; zero while it has some.
    #[must_use]
    pub fn without_robots_for(&self, fleet: &FleetId) -> Duration {
        self.0
            .known(fleet.as_str())
            .map_or(Duration::ZERO, |known| known.routes.without_robots_for())
    }

    /// How many messages of a fleet's robots were dropped because it sent more than one fleet may.
    #[must_use]
    pub fn dropped(&self, fleet: &FleetId) -> u64 {
        self.0.known(fleet.as_str()).map_or(0, |known| known.routes.beyond_allowance())
    }

    /// Lets go of what is kept for a fleet, after its services have ended, however they did.
    pub fn forget(&self, fleet: &FleetId) {
        let known = self.0.known(fleet.as_str());
        if let Some(known) = &known {
            known.routes.clear();
            let all = known.routes.space.pattern(&Pattern::Everything);
            let prefix = all.trim_end_matches('*');
            lock(&self.0.own_tokens).retain(|text| !text.starts_with(prefix));
        }
        let publishers = known.map(|known| std::mem::take(&mut *lock(&known.publishers)));
        // Each is withdrawn on the bus, which may wait.
        drop(tokio::task::spawn_blocking(move || drop(publishers)));
    }

    /// Closes the sessions.
    pub async fn close(&self) {
        let hub = &self.0;
        let sessions = [&hub.following, &hub.sending, &hub.receiving].map(Clone::clone);
        crate::bus::close_sessions(sessions.to_vec()).await;
    }
}

/// Whether both links are up; `linked` is when they last were again.
fn both(
    mut first: watch::Receiver<bool>,
    mut second: watch::Receiver<bool>,
    linked: Arc<Mutex<Instant>>,
) -> watch::Receiver<bool> {
    let (sender, receiver) = watch::channel(*first.borrow() && *second.borrow());
    tokio::spawn(async move {
        loop {
            let changed = tokio::select! {
                changed = first.changed() => changed,
                changed = second.changed() => changed,
            };
            if changed.is_err() {
                return;
            }
            let up = *first.borrow_and_update() && *second.borrow_and_update();
            *lock(&linked) = Instant::now();
            sender.send_if_modified(|before| std::mem::replace(before, up) != up);
        }
    });
    receiver
}

impl Hub {
    fn known(&self, fleet: &str) -> Option<Arc<Known>> {
        self.fleets.read().unwrap_or_else(PoisonError::into_inner).get(fleet).cloned()
    }

    /// What is known of a fleet from now on.
    fn serve_fleet(&self, fleet: &FleetId) -> Arc<Known> {
        let mut fleets = self.fleets.write().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(fleets.entry(fleet.as_str().to_owned()).or_insert_with(|| Known::new(fleet)))
    }

    /// The same for a fleet that has appeared on the bus; none if it is not meant, or too many are known.
    fn notice(&self, name: &str) -> Option<Arc<Known>> {
        if let Some(known) = self.known(name) {
            return Some(known);
        }
        let fleet = FleetId::new(name).ok()?;
        (self.scopes.mean(name) && self.has_room()).then(|| self.serve_fleet(&fleet))
    }

    /// Whether one more fleet may be known, after those are let go of that no one serves and that have no robots. Looking
    /// for them takes the time of thousands of messages, so that names at random must not make it happen with each.
    fn has_room(&self) -> bool {
        let has_room = |count: usize| count < MAX_KNOWN_FLEETS;
        if has_room(self.fleets.read().unwrap_or_else(PoisonError::into_inner).len()) {
            return true;
        }
        let now = Instant::now();
        let lately = |at: Instant| now.saturating_duration_since(at) < SWEEP_INTERVAL;
        {
            let mut swept = lock(&self.swept);
            if swept.is_some_and(lately) {
                return false;
            }
            *swept = Some(now);
        }
        let mut fleets = self.fleets.write().unwrap_or_else(PoisonError::into_inner);
        let is_used = |known: &Arc<Known>| {
            Arc::strong_count(&known.routes) > 1
                || known.routes.without_robots_for() < REPORT_AGAIN_AFTER
        };
        fleets.retain(|_, known| is_used(known));
        has_room(fleets.len())
    }

    async fn declare(self: &Arc<Self>) -> anyhow::Result<()> {
        for (at, scope) in self.scopes.received().enumerate() {
            // Not what a robot misspelt: what services put for robots has keys of the same form, and would come back.
            let streams = Pattern::streams().into_iter();
            for pattern in streams.filter(|pattern| *pattern != Pattern::UnknownStreams) {
                let hub = Arc::downgrade(self);
                self.subscribe(&scope.keys(&pattern), move |sample| {
                    if let Some(hub) = hub.upgrade() {
                        hub.receive(at, &sample);
                    }
                })
                .await?;
            }
            let text = scope.keys(&Pattern::Everything);
            let hub = Arc::downgrade(self);
            let answering = self
                .receiving
                .declare_queryable(text.as_str())
                .callback(move |query| {
                    if let Some(hub) = hub.upgrade() {
                        hub.answer(at, query);
                    }
                })
                .background()
                .await;
            answering.map_err(|error| anyhow::anyhow!("cannot serve {text}: {error}"))?;
            let hub = Arc::downgrade(self);
            let following = self
                .following
                .liveliness()
                .declare_subscriber(text.as_str())
                .history(true)
                .callback(move |sample| {
                    if let Some(hub) = hub.upgrade() {
                        hub.token(at, &sample);
                    }
                })
                .background()
                .await;
            following.map_err(|error| anyhow::anyhow!("cannot follow tokens {text}: {error}"))?;
        }
        Ok(())
    }

    async fn subscribe(
        &self,
        text: &str,
        receive: impl Fn(Sample) + Send + Sync + 'static,
    ) -> anyhow::Result<()> {
        self.receiving
            .declare_subscriber(text)
            .callback(receive)
            .background()
            .await
            .map_err(|error| anyhow::anyhow!("cannot subscribe to {text}: {error}"))
    }

    /// Receives from now on all that the fleets put: a part of their services is elsewhere.
    fn receive_all(self: &Arc<Self>) {
        if self.has_others.swap(true, Ordering::Relaxed) {
            return;
        }
        let hub = Arc::downgrade(self);
        tracing::info!("another process has services of these fleets; all they put is received");
        let this = Arc::clone(self);
        let declaring = move || {
            for (at, scope) in this.scopes.received().enumerate() {
                let text = scope.keys(&Pattern::Everything);
                let hub = hub.clone();
                let declared = this
                    .receiving
                    .declare_subscriber(text.as_str())
                    .callback(move |sample| {
                        if let Some(hub) = hub.upgrade()
                            && !is_of_robot(sample.key_expr())
                        {
                            hub.receive(at, &sample);
                        }
                    })
                    .background()
                    .wait();
                if let Err(error) = declared {
                    tracing::error!("cannot subscribe to {text}: {error}");
                }
            }
        };
        // Declaring may wait for a busy link; callbacks of the bus must not.
        let started =
            std::thread::Builder::new().name("muster-declare".to_owned()).spawn(declaring);
        if let Err(error) = started {
            tracing::error!("{error}");
        }
    }

    /// A message has come over the bus.
    fn receive(&self, scope: usize, sample: &Sample) {
        let key = sample.key_expr();
        let name = fleet_name(key.as_str()).filter(|name| self.scopes.receive(scope, name));
        let Some(known) = name.and_then(|name| self.notice(name)) else { return };
        let of_robot = is_of_robot(key);
        if of_robot && !known.routes.robot_reports() {
            return;
        }
        if of_robot && !known.routes.is_served() {
            return self.report(&known);
        }
        known.routes.deliver(key, |limit| packet(sample, limit));
    }

    /// Reports a fleet that has robots and is not served.
    fn report(&self, known: &Known) {
        let now = Instant::now();
        let mut reported = lock(&known.reported);
        let lately = |at: Instant| now.saturating_duration_since(at) < REPORT_AGAIN_AFTER;
        if !reported.is_some_and(lately)
            && self.appeared.try_send(known.routes.space.fleet().clone()).is_ok()
        {
            *reported = Some(now);
        }
    }

    /// A token has appeared or is gone.
    fn token(self: &Arc<Self>, scope: usize, sample: &Sample) {
        let text = sample.key_expr().as_str();
        let Some((fleet, key)) = parse_any(text) else { return };
        if !self.scopes.receive(scope, fleet.as_str()) {
            return;
        }
        let Some(known) = self.notice(fleet.as_str()) else { return };
        let source = match sample.kind() {
            SampleKind::Put => Source::TokenAlive,
            SampleKind::Delete => Source::TokenGone,
        };
        let is_service = matches!(key, Key::ServiceToken(..)) && source == Source::TokenAlive;
        if is_service && !lock(&self.own_tokens).contains(text) {
            self.receive_all();
        }
        known.routes.token(text, source);
        let is_robot = matches!(key, Key::RobotToken(_)) && source == Source::TokenAlive;
        if is_robot && !known.routes.is_served() {
            self.report(&known);
        }
    }

    /// A token of this process is about to be declared, and is none of another process.
    pub(crate) fn owns_token(&self, text: &str) {
        lock(&self.own_tokens).insert(text.to_owned());
    }

    /// Whether another process may have services of these fleets.
    fn has_others(&self) -> bool {
        self.has_others.load(Ordering::Relaxed)
    }

    /// A get has come over the bus.
    fn answer(&self, scope: usize, mut query: zenoh::query::Query) {
        if query.attachment().is_some_and(|mark| mark.to_bytes() == self.mark) {
            return;
        }
        if !is_small_query(&query) {
            return;
        }
        let payload =
            query.payload_mut().map(std::mem::take).map(|bytes| bytes.to_bytes().into_owned());
        let selector: &keyexpr = query.key_expr();
        let asked = self.asked(selector).into_iter();
        for known in
            asked.filter(|one| self.scopes.receive(scope, one.routes.space.fleet().as_str()))
        {
            let mut servers = known.routes.servers(selector, None);
            // The leader's answer suffices for who is no service; a service wants all.
            if !self.has_others()
                && let Some(at) = servers.iter().position(|server| server.suffices(selector))
            {
                servers = vec![servers.swap_remove(at)];
            }
            for server in servers {
                let (narrowed, payload) = (server.narrowed(selector), payload.clone());
                server.ask(IncomingQuery {
                    query: Query::of_bus(query.clone()),
                    narrowed,
                    payload,
                });
            }
        }
    }

    /// The fleets that a get is about.
    fn asked(&self, selector: &keyexpr) -> Vec<Arc<Known>> {
        let name = fleet_name(selector.as_str()).filter(|name| !name.contains('*'));
        if let Some(name) = name {
            return self.known(name).into_iter().collect();
        }
        let fleets = self.fleets.read().unwrap_or_else(PoisonError::into_inner);
        fleets.values().cloned().collect()
    }

    /// Puts a packet of a fleet on the bus, where somebody may read it there.
    pub(crate) fn put(
        &self,
        routes: &FleetRoutes,
        packet: Packet,
        urgency: Urgency,
    ) -> anyhow::Result<()> {
        let Packet { key, encoding, payload, attachment, .. } = packet;
        let failed = |error: zenoh::Error| anyhow::anyhow!("cannot put to {key}: {error}");
        let priority = priority_of(urgency);
        let (payload, attachment) =
            (payload.unwrap_or_default(), attachment.map(Attachment::into_bytes));
        let publisher = self.publisher(routes, &key, priority).map_err(failed)?;
        match publisher {
            Some(publisher) => publisher
                .put(payload)
                .encoding(encoding.as_str())
                .attachment(attachment)
                .wait()
                .map_err(failed),
            None => self
                .sending
                .put(key.as_str(), payload)
                .encoding(encoding.as_str())
                .attachment(attachment)
                .priority(priority)
                .wait()
                .map_err(failed),
        }
    }

    /// The declared publisher of a key; none where a fleet has declared too many.
    fn publisher(
        &self,
        routes: &FleetRoutes,
        key: &str,
        priority: Priority,
    ) -> zenoh::Result<Option<Arc<Publisher<'static>>>> {
        let Some(known) = self.known(routes.space.fleet().as_str()) else { return Ok(None) };
        {
            let publishers = lock(&known.publishers);
            if let Some(publisher) = publishers.get(key) {
                return Ok(Some(Arc::clone(publisher)));
            }
            if publishers.len() >= MAX_DECLARED {
                return Ok(None);
            }
        }
        let publisher = self.sending.declare_publisher(key.to_owned()).priority(priority).wait()?;
        let publisher = Arc::new(publisher);
        lock(&known.publishers).insert(key.to_owned(), Arc::clone(&publisher));
        Ok(Some(publisher))
    }
}

impl Known {
    fn new(fleet: &FleetId) -> Arc<Self> {
        Arc::new(Self {
            routes: Arc::new(FleetRoutes::new(fleet.clone())),
            publishers: Mutex::default(),
            reported: Mutex::default(),
        })
    }
}

impl Participant {
    /// Whether lease renewals are of use to anyone: all others who read them are instances of the same service.
    pub(crate) fn has_rivals(&self) -> bool {
        self.hub.has_others()
    }

    /// Asks the other participants, and the bus where another process may have an answer. The answers come to `answers`,
    /// which is let go of when all have answered.
    pub(crate) async fn ask(
        &self,
        selector: &str,
        ask: Ask<'_>,
        answers: mpsc::Sender<Answer>,
    ) -> anyhow::Result<bool> {
        let parsed = KeyExpr::try_from(selector.to_owned())
            .map_err(|error| anyhow::anyhow!("{selector} is no key expression: {error}"))?;
        for server in self.routes.servers(&parsed, Some(self.id)) {
            let query = Query::of_process(selector, ask.parameters, answers.clone());
            let payload = ask.payload.map(<[u8]>::to_vec);
            server.ask(IncomingQuery { query, narrowed: server.narrowed(&parsed), payload });
        }
        let newest = self.joined.max(*lock(&self.hub.linked));
        Ok(newest.elapsed() < ASKS_BUS_FOR || self.hub.has_others())
    }

    /// What marks gets of this process.
    pub(crate) fn mark(&self) -> Vec<u8> {
        self.hub.mark.clone()
    }

    /// Leave to put a get on the bus.
    pub(crate) async fn may_ask(&self) -> Option<tokio::sync::SemaphorePermit<'_>> {
        self.hub.asking.acquire().await.ok()
    }

    /// The texts of the tokens of a kind.
    pub(crate) fn tokens(&self, pattern: &Pattern) -> Vec<String> {
        self.routes.tokens(pattern)
    }
}

/// Whether a key stands below a robot.
fn is_of_robot(key: &keyexpr) -> bool {
    key.as_str().split('/').nth(3) == Some("robot")
}
