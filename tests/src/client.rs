//! A robot or dashboard without the client crate: plain Zenoh and JSON.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use muster_model::time::Tick;
use muster_service::testkit::command_of;
use muster_wire::{Packet, Source};
use serde_json::Value;
use tokio::time::sleep;
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::handlers::FifoChannelHandler;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::CongestionControl;
use zenoh::query::{ConsolidationMode, QueryTarget, Reply};
use zenoh::sample::SampleKind;

/// How often a waiting test looks again.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// How long a command waits for a service that answers that it is starting: two seconds on an idle machine.
const SERVICE_STARTS_WITHIN: Duration = Duration::from_secs(20);

/// Most messages that a watch keeps.
const MAX_KEPT: usize = 100_000;

/// An outside client.
#[derive(Debug, Clone)]
pub struct Client {
    session: Session,
    prefix: String,
}

/// What was received on a key expression, in order.
#[derive(Debug, Clone)]
pub struct Watch(Arc<Mutex<Vec<Arrived>>>);

/// A message with its key and the moment of its arrival, in seconds since 1970.
#[derive(Debug, Clone)]
struct Arrived {
    at: f64,
    key: String,
    value: Value,
}

/// Which team each robot is in.
pub type Division = BTreeMap<String, Option<String>>;

/// The division in a message on `json/teams`.
#[must_use]
pub fn division(teams: &Value) -> Division {
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
    let mut division = Division::new();
    for team in list(&teams["teams"]) {
        for robot in list(&team["members"]) {
            division.insert(text(&robot), Some(text(&team["id"])));
        }
    }
    for robot in list(&teams["unassigned"]) {
        division.insert(text(&robot), None);
    }
    division
}

/// The moment in seconds since 1970.
#[must_use]
pub fn now() -> f64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.unwrap_or_default().as_secs_f64()
}

fn fail(error: zenoh::Error) -> anyhow::Error {
    anyhow::anyhow!("{error}")
}

/// The configuration of a client of a plain router.
///
/// # Errors
/// If the endpoint is none.
pub(crate) fn client_of(endpoint: &str, timeout_ms: &str) -> anyhow::Result<zenoh::Config> {
    with_retries(zenoh::Config::default(), endpoint, timeout_ms)
}

/// A configuration with the endpoint of a router, which is tried for so many milliseconds, or for ever with -1.
///
/// # Errors
/// If the endpoint is none.
pub(crate) fn with_retries(
    mut config: zenoh::Config,
    endpoint: &str,
    timeout_ms: &str,
) -> anyhow::Result<zenoh::Config> {
    for (key, value) in [
        ("mode", "\"client\"".to_owned()),
        ("connect/endpoints", format!("[\"{endpoint}\"]")),
        ("connect/timeout_ms", timeout_ms.to_owned()),
        ("scouting/multicast/enabled", "false".to_owned()),
        // Zenoh's own default waits up to 4 s before it tries a lost router again.
        ("connect/retry", "{period_init_ms: 100, period_max_ms: 500}".to_owned()),
    ] {
        config.insert_json5(key, &value).map_err(fail)?;
    }
    Ok(config)
}

impl Client {
    /// Connects to a router.
    ///
    /// # Errors
    /// If the router does not answer.
    pub async fn connect(endpoint: &str, fleet: &str) -> anyhow::Result<Self> {
        Self::open(client_of(endpoint, "10000")?, fleet).await
    }

    /// Connects to a router for many robots at once. Their messages wait longer for a busy link than by Zenoh's
    /// default, as long as those of `muster-client`.
    ///
    /// # Errors
    /// If the router does not answer.
    pub async fn connect_for_many(endpoint: &str, fleet: &str) -> anyhow::Result<Self> {
        let mut config = client_of(endpoint, "10000")?;
        let drop = "transport/link/tx/queue/congestion_control/drop";
        let waits = "{wait_before_drop: 100000, max_wait_before_drop_fragments: 1000000}";
        config.insert_json5(drop, waits).map_err(fail)?;
        Self::open(config, fleet).await
    }

    /// Connects to a router whenever it answers, and tries a lost one twice a second.
    ///
    /// # Errors
    /// If the endpoint is none.
    pub async fn connect_for_ever(endpoint: &str, fleet: &str) -> anyhow::Result<Self> {
        Self::open(client_of(endpoint, "-1")?, fleet).await
    }

    /// Connects by a configuration of Zenoh.
    ///
    /// # Errors
    /// If no router admits it.
    pub async fn open(config: zenoh::Config, fleet: &str) -> anyhow::Result<Self> {
        let session = zenoh::open(config).await.map_err(fail)?;
        Ok(Self { session, prefix: format!("muster/v1/{fleet}/") })
    }

    /// The session, for what the helpers do not do.
    #[must_use]
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// The whole text of a key of the fleet.
    #[must_use]
    pub fn key(&self, tail: &str) -> String {
        format!("{}{tail}", self.prefix)
    }

    /// Puts JSON.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn put(&self, tail: &str, value: &Value) -> anyhow::Result<()> {
        self.put_bytes(tail, value.to_string().into_bytes(), "application/json").await
    }

    /// Puts bytes with an encoding.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn put_bytes(
        &self,
        tail: &str,
        bytes: Vec<u8>,
        encoding: &str,
    ) -> anyhow::Result<()> {
        let put = self.session.put(self.key(tail), bytes).encoding(Encoding::from(encoding));
        // A message that the link drops would test nothing.
        put.congestion_control(CongestionControl::Block).await.map_err(fail)
    }

    /// Declares a liveliness token.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn token(&self, tail: &str) -> anyhow::Result<LivelinessToken> {
        self.session.liveliness().declare_token(self.key(tail)).await.map_err(fail)
    }

    /// Gets JSON: every answer with its key, errors as their text. A payload for settings, a wish or the alerts goes in a
    /// command of its own, and what is returned is what its key answers.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn get(
        &self,
        tail: &str,
        payload: Option<&Value>,
    ) -> anyhow::Result<Vec<(String, Result<Value, String>)>> {
        self.get_within(tail, payload, Duration::from_secs(3)).await
    }

    /// Gets JSON as [`Client::get`] does, within a time of the caller's. What has a payload waits longer for a service that answers
    /// that it is starting.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn get_within(
        &self,
        tail: &str,
        payload: Option<&Value>,
        within: Duration,
    ) -> anyhow::Result<Vec<(String, Result<Value, String>)>> {
        let text = payload.map(Value::to_string);
        let command =
            text.as_deref().and_then(|text| command_of(wall_tick(), tail, &command_id(), text));
        let is_command = command.is_some();
        let (key, sent) = match command {
            Some((key, command)) => (key, Some(command)),
            None => (tail.to_owned(), text),
        };
        let start = Instant::now();
        let waits = within.max(SERVICE_STARTS_WITHIN);
        let answers = loop {
            let answers = self.get_raw(&key, sent.clone(), within).await?;
            // The same command again is carried out once.
            let starts = |answer: &Result<Value, String>| {
                answer.as_ref().is_err_and(|error| error.contains(" is starting; ask again"))
            };
            let is_starting = sent.is_some() && answers.iter().any(|(_, answer)| starts(answer));
            if start.elapsed() > waits || !is_starting {
                break answers;
            }
            sleep(Duration::from_millis(100)).await;
        };
        if !is_command {
            return Ok(answers);
        }
        let inner = |outcome: Value| outcome.get("answer").cloned().unwrap_or(Value::Null);
        Ok(answers.into_iter().map(|(_, answer)| (tail.to_owned(), answer.map(inner))).collect())
    }

    /// Gets JSON with a payload as it is.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn get_raw(
        &self,
        tail: &str,
        payload: Option<String>,
        within: Duration,
    ) -> anyhow::Result<Vec<(String, Result<Value, String>)>> {
        let selector = self.key(tail);
        let mut get = self.session.get(selector.as_str()).timeout(within);
        if let Some(payload) = payload {
            get = get.payload(payload);
        }
        answers(get.await.map_err(fail)?, &self.prefix).await
    }

    /// Gets a key until its first good answer is right, and returns that.
    ///
    /// # Errors
    /// If there is none in time; the text holds what was answered last.
    pub async fn until(
        &self,
        tail: &str,
        within: Duration,
        right: impl Fn(&Value) -> bool,
    ) -> anyhow::Result<Value> {
        let start = Instant::now();
        loop {
            let answer = self.get_one(tail).await;
            if answer.as_ref().is_ok_and(&right) {
                return answer;
            }
            anyhow::ensure!(start.elapsed() < within, "{tail}, not within {within:?}: {answer:?}");
            sleep(LOOK_EVERY).await;
        }
    }

    /// Gets JSON from all that answer, also where one answer would suffice.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn get_from_all(&self, tail: &str) -> anyhow::Result<Vec<Value>> {
        let selector = self.key(tail);
        let get = self.session.get(selector.as_str()).timeout(Duration::from_secs(3));
        let get = get.target(QueryTarget::All).consolidation(ConsolidationMode::None);
        let answers = answers(get.await.map_err(fail)?, &self.prefix).await?;
        Ok(answers.into_iter().filter_map(|(_, answer)| answer.ok()).collect())
    }

    /// The first good answer to a get.
    ///
    /// # Errors
    /// If there is none; the text holds what was answered.
    pub async fn get_one(&self, tail: &str) -> anyhow::Result<Value> {
        let answers = self.get(tail, None).await?;
        let good = answers.iter().find_map(|(_, answer)| answer.as_ref().ok());
        good.cloned().ok_or_else(|| anyhow::anyhow!("{tail} is answered with {answers:?}"))
    }

    /// Keeps all JSON that arrives on a key expression of the fleet.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn watch(&self, tail: &str) -> anyhow::Result<Watch> {
        let kept = Arc::new(Mutex::new(Vec::new()));
        let keeping = Arc::clone(&kept);
        self.listen(tail, move |key, value| {
            let mut kept = keeping.lock().unwrap_or_else(PoisonError::into_inner);
            if kept.len() < MAX_KEPT {
                kept.push(Arrived { at: now(), key, value });
            }
        })
        .await?;
        Ok(Watch(kept))
    }

    /// Calls a function with the key and the value of all JSON that arrives on a key expression of
    /// the fleet. The function must not wait.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn listen(
        &self,
        tail: &str,
        arrived: impl Fn(String, Value) + Send + Sync + 'static,
    ) -> anyhow::Result<()> {
        let prefix = self.prefix.clone();
        self.session
            .declare_subscriber(self.key(tail))
            .callback(move |sample| {
                if let Ok(value) = serde_json::from_slice(&sample.payload().to_bytes()) {
                    arrived(sample.key_expr().as_str().replacen(&prefix, "", 1), value);
                }
            })
            .background()
            .await
            .map_err(fail)
    }
}

impl Client {
    /// Calls a function with every packet that arrives on a key expression of the fleet. The function must not
    /// wait.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn listen_to_packets(
        &self,
        tail: &str,
        arrived: impl Fn(Packet) + Send + Sync + 'static,
    ) -> anyhow::Result<()> {
        self.session
            .declare_subscriber(self.key(tail))
            .callback(move |sample| {
                let (key, encoding) = (sample.key_expr().as_str(), sample.encoding().to_string());
                let mut packet = Packet::put(key, encoding, sample.payload().to_bytes().to_vec());
                if sample.kind() == SampleKind::Delete {
                    packet.source = Source::Delete;
                }
                arrived(packet);
            })
            .background()
            .await
            .map_err(fail)
    }
}

/// Every answer to a get with its key, errors as their text.
async fn answers(
    replies: FifoChannelHandler<Reply>,
    prefix: &str,
) -> anyhow::Result<Vec<(String, Result<Value, String>)>> {
    let mut answers = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        answers.push(match reply.result() {
            Ok(sample) => {
                let value = serde_json::from_slice(&sample.payload().to_bytes());
                let key = sample.key_expr().as_str().replacen(prefix, "", 1);
                (key, value.map_err(|error| error.to_string()))
            }
            Err(error) => {
                let text = String::from_utf8_lossy(&error.payload().to_bytes()).into_owned();
                (String::new(), Err(text))
            }
        });
    }
    Ok(answers)
}

impl Watch {
    /// Everything that has arrived, in order, with its key.
    #[must_use]
    pub fn all(&self) -> Vec<(String, Value)> {
        let kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.iter().map(|arrived| (arrived.key.clone(), arrived.value.clone())).collect()
    }

    /// Everything that has arrived, in order, with the moments of arrival in seconds since 1970.
    #[must_use]
    pub fn timed(&self) -> Vec<(f64, Value)> {
        let kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.iter().map(|arrived| (arrived.at, arrived.value.clone())).collect()
    }

    /// Hands over everything that has arrived, in order, with the moments of arrival in seconds since
    /// 1970, and forgets it.
    #[must_use]
    pub fn take(&self) -> Vec<(f64, Value)> {
        let taken = std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner));
        taken.into_iter().map(|arrived| (arrived.at, arrived.value)).collect()
    }

    /// The newest that has arrived.
    #[must_use]
    pub fn newest(&self) -> Option<Value> {
        let kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.last().map(|arrived| arrived.value.clone())
    }

    /// Forgets everything that has arrived.
    pub fn clear(&self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    /// Waits until a message that has arrived, or arrives, is right.
    ///
    /// # Errors
    /// If none is in time; the text holds the newest.
    pub async fn until(
        &self,
        what: &str,
        within: Duration,
        right: impl Fn(&Value) -> bool,
    ) -> anyhow::Result<Value> {
        let start = Instant::now();
        loop {
            let found = {
                let kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
                kept.iter().rev().map(|arrived| &arrived.value).find(|value| right(value)).cloned()
            };
            if let Some(found) = found {
                return Ok(found);
            }
            anyhow::ensure!(
                start.elapsed() < within,
                "not within {within:?}: {what}; the newest is {:?}",
                self.newest()
            );
            sleep(LOOK_EVERY).await;
        }
    }
}

/// The robots that an event is about: one, or several that changed within a moment.
#[must_use]
pub fn robots_of_event(event: &Value) -> Vec<String> {
    let several = event["robots"].as_array().into_iter().flatten();
    let all = several.chain(event.get("robot"));
    all.filter_map(|robot| robot.as_str().map(str::to_owned)).collect()
}

/// Whether an event has a name such as `robot_left`, or that of several robots, `robots_left`.
#[must_use]
pub fn is_event_of_robots(event: &Value, name: &str) -> bool {
    let named = event["event"].as_str().unwrap_or_default();
    let of_several = named.strip_prefix("robots_");
    named == name || of_several.is_some_and(|tail| name.strip_prefix("robot_") == Some(tail))
}

/// Now, by the wall clock.
fn wall_tick() -> Tick {
    Tick(0).after(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default())
}

/// An id that no other command of this process has.
fn command_id() -> String {
    static SENT: AtomicU64 = AtomicU64::new(0);
    format!("t{}-{}", std::process::id(), SENT.fetch_add(1, Ordering::Relaxed))
}
