//! Puts by declared keys, for those who put to the same keys of robots again and again.

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use muster_model::id::RobotId;
use muster_wire::{Attachment, Key, Outbound, Packet, Pattern, Source};
use zenoh::Wait;
use zenoh::key_expr::KeyExpr;
use zenoh::pubsub::Publisher;

use crate::bus::{Bus, Urgency, priority_of};

/// Most keys that one session declares; those beyond are put by their text. A program that plays 10,000 robots has 40,000.
const MAX_DECLARED: usize = 65_536;

/// How long a key stays declared that nothing is put to: a robot that is back within this time costs its router nothing, and
/// those that came once and went leave nothing there.
const UNUSED_TIME: Duration = Duration::from_secs(600);

/// How often unused keys are looked for.
const SWEEP_INTERVAL: Duration = Duration::from_secs(60);

/// Puts to keys of robots that are declared when something is first put to them, and to all others by their text.
///
/// A router that receives a message under the text of a robot's key compares it with the keys of every robot, three times for
/// each message (`Resource::get_matches` of Zenoh 1.10.2). A declared one it has compared once.
///
/// What a robot puts has a publisher: a router remembers where messages on a key go only if somebody has declared a publisher or
/// a subscriber of that very key, and computes it for each message otherwise, which takes more than 0.1 ms with 500 robots. A
/// robot subscribes to its team, so that those who put it declare the key alone. Publishers have a price too: by each a session
/// asks its router who subscribes, and the router goes through the questions of all sessions for each new subscription.
///
/// The team of a robot without a token is put by its text. Such a robot reports through a bridge or a gateway, which declares nothing
/// for it: where no robot has keys at the router there is nothing to compare with, and a key declared for each of 20,000 would make
/// each of their poses cost 16 ms there.
#[derive(Debug)]
pub struct DeclaredKeys {
    bus: Bus,
    tokens: RobotTokens,
    declared: HashMap<String, Declared>,
    swept: Instant,
}

#[derive(Debug)]
struct Declared {
    form: Form,
    used: Instant,
}

/// How a key is declared.
#[derive(Debug)]
enum Form {
    Publisher(Arc<Publisher<'static>>),
    Key(KeyExpr<'static>),
}

/// The robots that have a liveliness token, as far as they are followed.
#[derive(Debug, Clone, Default)]
pub struct RobotTokens(Arc<Mutex<HashSet<RobotId>>>);

impl RobotTokens {
    /// Follows the tokens of a fleet, for as long as the session lives.
    ///
    /// # Errors
    /// If the session is closed, or one for tokens cannot be opened.
    pub async fn follow(&self, bus: &Bus) -> anyhow::Result<()> {
        let (tokens, space) = (self.clone(), bus.space.clone());
        let receive = move |packet: Packet| {
            if let Ok(Key::RobotToken(robot)) = space.parse(&packet.key) {
                tokens.note(robot, packet.source == Source::TokenAlive);
            }
        };
        bus.subscribe_tokens(&Pattern::RobotTokens, receive).await
    }

    fn note(&self, robot: RobotId, is_there: bool) {
        let mut robots = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if !is_there {
            robots.remove(&robot);
        } else if robots.len() < MAX_DECLARED {
            robots.insert(robot);
        }
    }

    fn contain(&self, robot: &RobotId) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).contains(robot)
    }
}

impl Clone for Form {
    fn clone(&self) -> Self {
        match self {
            Self::Publisher(publisher) => Self::Publisher(Arc::clone(publisher)),
            Self::Key(key) => Self::Key(key.clone()),
        }
    }
}

impl Clone for DeclaredKeys {
    /// Puts on the same bus, and declares for itself.
    fn clone(&self) -> Self {
        Self::with_tokens(self.bus.clone(), self.tokens.clone())
    }
}

impl DeclaredKeys {
    /// No key is declared, and none of teams will be.
    #[must_use]
    pub fn new(bus: Bus) -> Self {
        Self::with_tokens(bus, RobotTokens::default())
    }

    /// No key is declared. Those of teams will be where their robots have tokens.
    #[must_use]
    pub fn with_tokens(bus: Bus, tokens: RobotTokens) -> Self {
        Self { bus, tokens, declared: HashMap::new(), swept: Instant::now() }
    }

    /// Puts a message. May wait for a busy link, as long as the configuration allows.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn put(&mut self, message: Outbound) -> anyhow::Result<()> {
        self.put_packet(message.into_packet(&self.bus.space), Urgency::Normal)
    }

    /// Puts a packet on the bus, as [`Bus::put_packet`] does.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn put_packet(&mut self, packet: Packet, urgency: Urgency) -> anyhow::Result<()> {
        let now = Instant::now();
        self.sweep(now);
        // A bus that many fleets share has keys of its own.
        let is_shared = self.bus.participant.is_some();
        let declared = if is_shared { None } else { self.declared(&packet.key, now)? };
        let Some(declared) = declared else { return self.bus.put_packet(packet, urgency) };
        let Packet { key, encoding, payload, attachment, .. } = packet;
        let (payload, attachment) =
            (payload.unwrap_or_default(), attachment.map(Attachment::into_bytes));
        let put = match declared {
            Form::Publisher(publisher) => {
                publisher.put(payload).encoding(encoding.as_str()).attachment(attachment).wait()
            }
            Form::Key(declared) => self
                .bus
                .session
                .put(declared, payload)
                .encoding(encoding.as_str())
                .attachment(attachment)
                .priority(priority_of(urgency))
                .wait(),
        };
        put.map_err(|error| anyhow::anyhow!("cannot put to {key}: {error}"))
    }

    /// The declared form of a key. One of a robot is declared now, if there is room; others have none.
    fn declared(&mut self, text: &str, now: Instant) -> anyhow::Result<Option<Form>> {
        if let Some(declared) = self.declared.get_mut(text) {
            declared.used = now;
            return Ok(Some(declared.form.clone()));
        }
        if self.declared.len() >= MAX_DECLARED {
            return Ok(None);
        }
        let session = &self.bus.session;
        let form = match self.bus.space.parse(text) {
            Ok(Key::Stream(..)) => session
                .declare_publisher(text.to_owned())
                .wait()
                .map(|publisher| Form::Publisher(Arc::new(publisher))),
            Ok(Key::RobotTeam(robot)) if self.tokens.contain(&robot) => {
                session.declare_keyexpr(text.to_owned()).wait().map(Form::Key)
            }
            _ => return Ok(None),
        };
        let form = form.map_err(|error| anyhow::anyhow!("cannot declare {text}: {error}"))?;
        self.declared.insert(text.to_owned(), Declared { form: form.clone(), used: now });
        Ok(Some(form))
    }

    /// Takes back what nothing was put to for long.
    fn sweep(&mut self, now: Instant) {
        if now.duration_since(self.swept) < SWEEP_INTERVAL {
            return;
        }
        self.swept = now;
        let is_unused = |declared: &Declared| now.duration_since(declared.used) >= UNUSED_TIME;
        for (text, declared) in self.declared.extract_if(|_, declared| is_unused(declared)) {
            // A publisher is taken back when it is dropped.
            if let Form::Key(key) = declared.form
                && let Err(error) = self.bus.session.undeclare(key).wait()
            {
                tracing::debug!("cannot take {text} back: {error}");
            }
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use muster_model::id::FleetId;

    use super::*;

    #[tokio::test(flavor = "multi_thread")]
    async fn keys_of_robots_are_declared_for_as_long_as_they_are_used() {
        let mut config = zenoh::Config::default();
        for (key, value) in [("scouting/multicast/enabled", "false"), ("listen/endpoints", "[]")] {
            config.insert_json5(key, value).unwrap();
        }
        let session = zenoh::open(config).await.unwrap();
        let bus = Bus::on_session(session, FleetId::new("f").unwrap()).await.unwrap();
        let tokens = RobotTokens::default();
        let mut keys = DeclaredKeys::with_tokens(bus, tokens.clone());
        let now = Instant::now();
        tokens.note("r1".parse().unwrap(), true);
        for (key, is_declared) in [
            ("muster/v1/f/robot/r1/pose", true),
            ("muster/v1/f/robot/r1/team", true),
            ("muster/v1/f/robot/r2/team", false),
            ("muster/v1/f/teams", false),
            ("muster/v1/f/command/clusterer/kim/c1", false),
            ("rt/odom", false),
        ] {
            assert_eq!(keys.declared(key, now).unwrap().is_some(), is_declared, "{key}");
        }
        let used = now + SWEEP_INTERVAL;
        assert!(keys.declared("muster/v1/f/robot/r1/pose", used).unwrap().is_some());
        keys.sweep(now + UNUSED_TIME);
        assert!(keys.declared.keys().eq(["muster/v1/f/robot/r1/pose"]));
        keys.sweep(used + UNUSED_TIME);
        assert!(keys.declared.is_empty());
    }
}
