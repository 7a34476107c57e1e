//! Who in this process reads and serves what of one fleet: a table that decides where a packet or a get goes.
//!
//! It knows no session. What is handed over is a function call or a place in a channel: nothing here waits.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::time::{Duration, Instant};

use muster_model::id::FleetId;
use muster_wire::{KeySpace, Packet, Pattern, Source};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TrySendError;
use zenoh::key_expr::{OwnedKeyExpr, keyexpr};

use crate::bus::MAX_ANSWERS;
use crate::serve::IncomingQuery;

/// Most messages of robots a second that are taken of one fleet on average, and at once: four streams of
/// 5,000 robots. A fleet beyond it would take the thread that all fleets are received on for itself.
const MAX_ROBOT_MESSAGES_PER_SECOND: f64 = 20_000.0;

/// Names one user of a bus that several share: an instance of a service.
pub(crate) type ParticipantId = u64;

type Receive = Arc<dyn Fn(Packet) + Send + Sync>;

/// A subscription of a participant.
struct Reader {
    participant: ParticipantId,
    kind: Pattern,
    pattern: OwnedKeyExpr,
    /// How many bytes of the pattern stand before its first star; all of it has no star where that is its length.
    plain: usize,
    limit: usize,
    receive: Receive,
}

impl Reader {
    /// Whether it reads a key, which has no stars. Most patterns begin otherwise, and Zenoh's comparison takes longer.
    fn reads(&self, key: &keyexpr) -> bool {
        key.as_bytes().starts_with(&self.pattern.as_bytes()[..self.plain])
            && self.pattern.intersects(key)
            && self.kind.is_meant_for_reader(key.as_str())
    }
}

/// Keys that a participant serves.
pub(super) struct Server {
    participant: ParticipantId,
    id: u64,
    pub(super) pattern: OwnedKeyExpr,
    complete: bool,
    queries: mpsc::Sender<IncomingQuery>,
}

#[derive(Default)]
struct Table {
    readers: Vec<Reader>,
    token_readers: Vec<Reader>,
    servers: Vec<Arc<Server>>,
    /// The texts of the tokens that are there.
    tokens: BTreeSet<String>,
}

/// How many messages of robots may still be taken.
#[derive(Debug)]
struct Allowance {
    left: f64,
    at: Instant,
}

impl Allowance {
    /// Takes one message, if it may be taken.
    fn take(&mut self, now: Instant) -> bool {
        let since = now.saturating_duration_since(self.at).as_secs_f64();
        let refilled = self.left + since * MAX_ROBOT_MESSAGES_PER_SECOND;
        self.left = refilled.min(MAX_ROBOT_MESSAGES_PER_SECOND);
        self.at = now;
        let may = self.left >= 1.0;
        self.left -= f64::from(u8::from(may));
        may
    }
}

/// Everyone in this process who takes part in one fleet.
pub(crate) struct FleetRoutes {
    pub(super) space: KeySpace,
    table: RwLock<Table>,
    next_id: AtomicU64,
    allowance: Mutex<Allowance>,
    beyond_allowance: AtomicU64,
    began: Instant,
    /// When a robot last sent something, in milliseconds since it began.
    last_report: AtomicU64,
}

impl FleetRoutes {
    pub(super) fn new(fleet: FleetId) -> Self {
        let now = Instant::now();
        Self {
            space: KeySpace::new(fleet),
            table: RwLock::default(),
            next_id: AtomicU64::new(0),
            allowance: Mutex::new(Allowance { left: MAX_ROBOT_MESSAGES_PER_SECOND, at: now }),
            beyond_allowance: AtomicU64::new(0),
            began: now,
            last_report: AtomicU64::new(0),
        }
    }

    /// No critical section can panic half-way, so that a poisoned lock still guards a whole table.
    fn read(&self) -> RwLockReadGuard<'_, Table> {
        self.table.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, Table> {
        self.table.write().unwrap_or_else(PoisonError::into_inner)
    }

    fn key_expression(&self, pattern: &Pattern) -> anyhow::Result<OwnedKeyExpr> {
        let text = self.space.pattern(pattern);
        OwnedKeyExpr::new(text.as_str())
            .map_err(|error| anyhow::anyhow!("{text} is no key expression: {error}"))
    }

    fn reader(
        &self,
        participant: ParticipantId,
        pattern: &Pattern,
        receive: Receive,
    ) -> anyhow::Result<Reader> {
        let (limit, kind) = (pattern.payload_limit(), pattern.clone());
        let pattern = self.key_expression(pattern)?;
        let plain = pattern.find('*').unwrap_or(pattern.len());
        Ok(Reader { participant, kind, pattern, plain, limit, receive })
    }

    /// A participant reads a pattern from now on.
    pub(crate) fn subscribe(
        &self,
        participant: ParticipantId,
        pattern: &Pattern,
        receive: impl Fn(Packet) + Send + Sync + 'static,
    ) -> anyhow::Result<()> {
        let reader = self.reader(participant, pattern, Arc::new(receive))?;
        self.write().readers.push(reader);
        Ok(())
    }

    /// A participant follows tokens from now on, and receives those that are there already.
    pub(crate) fn subscribe_tokens(
        &self,
        participant: ParticipantId,
        pattern: &Pattern,
        receive: impl Fn(Packet) + Send + Sync + 'static,
    ) -> anyhow::Result<()> {
        let reader = self.reader(participant, pattern, Arc::new(receive))?;
        // Under one lock, so that no change falls between what is there and what follows.
        let mut table = self.write();
        for text in &table.tokens {
            if matches(&reader.pattern, text) {
                (reader.receive)(token(text, Source::TokenAlive));
            }
        }
        table.token_readers.push(reader);
        Ok(())
    }

    /// A participant serves a pattern until [`FleetRoutes::unserve`].
    pub(crate) fn serve(
        &self,
        participant: ParticipantId,
        pattern: &Pattern,
        complete: bool,
        queries: mpsc::Sender<IncomingQuery>,
    ) -> anyhow::Result<u64> {
        let id = self.next_id.fetch_add(1, Ordering::Relaxed);
        let pattern = self.key_expression(pattern)?;
        let server = Server { participant, id, pattern, complete, queries };
        self.write().servers.push(Arc::new(server));
        Ok(id)
    }

    pub(crate) fn unserve(&self, id: u64) {
        self.write().servers.retain(|server| server.id != id);
    }

    /// A participant has ended.
    pub(crate) fn leave(&self, participant: ParticipantId) {
        let mut table = self.write();
        table.readers.retain(|reader| reader.participant != participant);
        table.token_readers.retain(|reader| reader.participant != participant);
        table.servers.retain(|server| server.participant != participant);
    }

    /// All participants have ended.
    pub(super) fn clear(&self) {
        let mut table = self.write();
        *table = Table { tokens: std::mem::take(&mut table.tokens), ..Table::default() };
    }

    /// Hands what one participant puts to the others that read it.
    pub(crate) fn hand_over(&self, from: ParticipantId, packet: &Packet) {
        let Ok(key) = keyexpr::new(packet.key.as_str()) else { return };
        for reader in &self.read().readers {
            if reader.participant != from && reader.reads(key) {
                (reader.receive)(limited(packet, reader.limit));
            }
        }
    }

    /// Hands what came over the bus to those who read it. `packet` makes the packet with at most so many bytes.
    pub(super) fn deliver(&self, key: &keyexpr, packet: impl Fn(usize) -> Packet) {
        for reader in &self.read().readers {
            if reader.reads(key) {
                (reader.receive)(packet(reader.limit));
            }
        }
    }

    /// A robot has sent a message; whether it may be taken.
    pub(super) fn robot_reports(&self) -> bool {
        let now = Instant::now();
        let since = now.saturating_duration_since(self.began).as_millis();
        self.last_report.store(u64::try_from(since).unwrap_or(u64::MAX), Ordering::Relaxed);
        let mut allowance = self.allowance.lock().unwrap_or_else(PoisonError::into_inner);
        let may = allowance.take(now);
        if !may {
            self.beyond_allowance.fetch_add(1, Ordering::Relaxed);
        }
        may
    }

    /// How many messages of robots were dropped because the fleet sent too many.
    pub(super) fn beyond_allowance(&self) -> u64 {
        self.beyond_allowance.load(Ordering::Relaxed)
    }

    /// How long no robot has been there; zero while one is.
    pub(super) fn without_robots_for(&self) -> Duration {
        let robots = self.space.pattern(&Pattern::RobotTokens);
        let robots = robots.trim_end_matches('*');
        let table = self.read();
        if table
            .tokens
            .range(robots.to_owned()..)
            .next()
            .is_some_and(|text| text.starts_with(robots))
        {
            return Duration::ZERO;
        }
        let last = Duration::from_millis(self.last_report.load(Ordering::Relaxed));
        self.began.elapsed().saturating_sub(last)
    }

    /// A token has appeared or is gone.
    pub(super) fn token(&self, text: &str, source: Source) {
        let mut table = self.write();
        match source {
            Source::TokenGone => {
                table.tokens.remove(text);
            }
            // More than one answer may hold are not kept for those who come later.
            _ if table.tokens.len() < MAX_ANSWERS => {
                table.tokens.insert(text.to_owned());
            }
            _ => {}
        }
        for reader in &table.token_readers {
            if matches(&reader.pattern, text) {
                (reader.receive)(token(text, source));
            }
        }
    }

    /// The texts of the tokens of a kind.
    pub(super) fn tokens(&self, pattern: &Pattern) -> Vec<String> {
        let Ok(pattern) = self.key_expression(pattern) else { return Vec::new() };
        self.read().tokens.iter().filter(|text| matches(&pattern, text)).cloned().collect()
    }

    /// Whether anyone reads, follows or serves anything.
    pub(super) fn is_served(&self) -> bool {
        !self.read().servers.is_empty()
    }

    /// Who of the participants other than `from` serves what a get asks for.
    pub(super) fn servers(
        &self,
        selector: &keyexpr,
        from: Option<ParticipantId>,
    ) -> Vec<Arc<Server>> {
        let table = self.read();
        let others = table.servers.iter().filter(|server| Some(server.participant) != from);
        others.filter(|server| server.pattern.intersects(selector)).cloned().collect()
    }
}

impl Server {
    /// Whether the answer of this one suffices for a get.
    pub(super) fn suffices(&self, selector: &keyexpr) -> bool {
        self.complete && self.pattern.includes(selector)
    }

    /// What it serves, where a get asks for all of it and perhaps for more.
    pub(super) fn narrowed(&self, selector: &keyexpr) -> Option<String> {
        selector.includes(&self.pattern).then(|| self.pattern.as_str().to_owned())
    }

    /// Hands a get over, or leaves it unanswered if too many wait.
    pub(super) fn ask(&self, query: IncomingQuery) {
        // A service that has stopped answers nothing, which needs no warning.
        if let Err(TrySendError::Full(_)) = self.queries.try_send(query) {
            tracing::warn!("a get is dropped: too many wait");
        }
    }
}

fn matches(pattern: &OwnedKeyExpr, text: &str) -> bool {
    keyexpr::new(text).is_ok_and(|key| pattern.intersects(key))
}

fn token(text: &str, source: Source) -> Packet {
    Packet { source, ..Packet::put(text.to_owned(), String::new(), []) }
}

/// A packet without its payload, if that has more than `limit` bytes.
pub(super) fn limited(packet: &Packet, limit: usize) -> Packet {
    match &packet.payload {
        Ok(bytes) if bytes.len() > limit => Packet {
            key: packet.key.clone(),
            encoding: packet.encoding.clone(),
            source: packet.source,
            payload: Err(bytes.len()),
            attachment: packet.attachment.clone(),
        },
        _ => packet.clone(),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use muster_model::id::ServiceName;
    use muster_model::observation::Stream;
    use muster_wire::Key;

    use super::*;

    fn routes() -> Arc<FleetRoutes> {
        Arc::new(FleetRoutes::new(FleetId::new("alpha").unwrap()))
    }

    fn collect() -> (impl Fn(Packet) + Send + Sync + 'static, Arc<Mutex<Vec<Packet>>>) {
        let all = Arc::new(Mutex::new(Vec::new()));
        let to = Arc::clone(&all);
        (move |packet| to.lock().unwrap().push(packet), all)
    }

    fn keys(all: &Mutex<Vec<Packet>>) -> Vec<(String, Source)> {
        all.lock().unwrap().iter().map(|packet| (packet.key.clone(), packet.source)).collect()
    }

    #[test]
    fn what_one_puts_reaches_the_others_that_read_it_and_not_itself() {
        let routes = routes();
        let (receive, all) = collect();
        routes.subscribe(1, &Pattern::One(Key::Teams), receive).unwrap();
        let (receive, own) = collect();
        routes.subscribe(2, &Pattern::One(Key::Teams), receive).unwrap();
        let put = |key: &str| Packet::put(key.to_owned(), String::new(), vec![1]);
        routes.hand_over(2, &put("muster/v1/alpha/teams"));
        routes.hand_over(2, &put("muster/v1/alpha/audit"));
        assert_eq!(keys(&all).len(), 1);
        assert!(keys(&own).is_empty());
        routes.leave(1);
        routes.hand_over(2, &put("muster/v1/alpha/teams"));
        assert_eq!(keys(&all).len(), 1);
    }

    #[test]
    fn a_pattern_reads_what_the_bus_says_that_it_does() {
        let routes = routes();
        let keys = [
            "teams",
            "teamsters",
            "team",
            "graph/spatial",
            "graph",
            "robot/r1/pose",
            "robot/r1/psoe",
        ];
        for pattern in [
            Pattern::One(Key::Teams),
            Pattern::Graphs,
            Pattern::Stream(Stream::Pose),
            Pattern::UnknownStreams,
            Pattern::Everything,
        ] {
            let reader = routes.reader(1, &pattern, Arc::new(|_| ())).unwrap();
            for key in keys {
                let text = format!("muster/v1/alpha/{key}");
                let key = keyexpr::new(text.as_str()).unwrap();
                let wanted = reader.pattern.intersects(key) && pattern.is_meant_for_reader(&text);
                assert_eq!(reader.reads(key), wanted, "{pattern:?} {text}");
            }
        }
    }

    #[test]
    fn a_payload_beyond_the_limit_of_its_reader_is_left_out() {
        let routes = routes();
        let (receive, all) = collect();
        let lease = Key::Lease(ServiceName::Ingest);
        routes.subscribe(1, &Pattern::One(lease.clone()), receive).unwrap();
        let bytes = vec![0; lease.payload_limit() + 1];
        let key = routes.space.format(&lease);
        routes.hand_over(2, &Packet::put(key, String::new(), bytes.clone()));
        assert_eq!(all.lock().unwrap()[0].payload, Err(bytes.len()));
    }

    #[test]
    fn who_comes_later_receives_the_tokens_that_are_there() {
        let routes = routes();
        routes.token("muster/v1/alpha/robot/r1", Source::TokenAlive);
        routes.token("muster/v1/alpha/robot/r2", Source::TokenAlive);
        routes.token("muster/v1/alpha/robot/r1", Source::TokenGone);
        let (receive, all) = collect();
        routes.subscribe_tokens(1, &Pattern::RobotTokens, receive).unwrap();
        routes.token("muster/v1/alpha/robot/r2", Source::TokenGone);
        let text = "muster/v1/alpha/robot/r2".to_owned();
        assert_eq!(keys(&all), [(text.clone(), Source::TokenAlive), (text, Source::TokenGone)]);
    }

    #[test]
    fn a_fleet_is_without_robots_only_while_none_is_there() {
        let routes = routes();
        routes.token("muster/v1/alpha/service/ingest/i1", Source::TokenAlive);
        std::thread::sleep(Duration::from_millis(5));
        assert!(routes.without_robots_for() >= Duration::from_millis(5));
        routes.token("muster/v1/alpha/robot/r1", Source::TokenAlive);
        assert_eq!(routes.without_robots_for(), Duration::ZERO);
    }

    #[test]
    fn a_flood_is_cut_at_the_allowance_and_a_fleet_gets_it_again() {
        let start = Instant::now();
        let mut allowance = Allowance { left: MAX_ROBOT_MESSAGES_PER_SECOND, at: start };
        let taken = (0..100_000).filter(|_| allowance.take(start)).count();
        assert_eq!(taken as f64, MAX_ROBOT_MESSAGES_PER_SECOND);
        let later = start + Duration::from_millis(100);
        let taken = (0..100_000).filter(|_| allowance.take(later)).count();
        assert!((1_999..=2_001).contains(&taken), "{taken}");
    }

    #[test]
    fn a_get_reaches_every_server_but_who_asks() {
        let routes = routes();
        let (queries, _waiting) = mpsc::channel(1);
        let own = Pattern::Stream(Stream::Pose);
        for participant in [1, 2] {
            routes.serve(participant, &own, participant == 1, queries.clone()).unwrap();
        }
        let selector = keyexpr::new("muster/v1/alpha/robot/r1/pose").unwrap();
        assert_eq!(routes.servers(selector, None).len(), 2);
        let others = routes.servers(selector, Some(1));
        assert!(others.len() == 1 && !others[0].suffices(selector));
        assert!(routes.servers(selector, Some(2))[0].suffices(selector));
        let all = keyexpr::new("muster/v1/alpha/**").unwrap();
        assert!(!routes.servers(all, Some(2))[0].suffices(all), "it asks for more");
        assert_eq!(
            routes.servers(all, Some(2))[0].narrowed(all).as_deref(),
            Some("muster/v1/alpha/robot/*/pose")
        );
    }
}
