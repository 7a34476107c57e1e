//! Events in, effects out.

use muster_model::id::{FleetId, InstanceId, ServiceName};
use muster_model::role::Standing;
use muster_model::settings::Settings;
use muster_model::status::ServiceStatus;
use muster_model::time::Tick;
use muster_wire::{Key, Message, Packet, Pattern, Rejection, Request};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::role::START_FETCH;

use crate::stopwatch::Stopwatch;

/// Names a get that waits for its answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct QueryId(pub u64);

/// What can happen to a core. The set is closed: nothing else ever reaches it.
#[derive(Debug)]
pub enum Event<Done> {
    /// The service begins: the link to the bus is up and the subscriptions are declared.
    Started,
    /// A message arrived.
    Received(Message),
    /// A packet was refused before it became a message.
    Rejected(Rejection),
    /// [`Core::deadline`] has passed.
    Timeout,
    /// The job ended.
    Done(Done),
    /// The job panicked, with what it said.
    JobFailed(String),
    /// A fetch ended: everything that was answered in time.
    Fetched {
        /// The number that the core gave it.
        fetch: u32,
        /// The answers, in no particular order.
        messages: Vec<Message>,
    },
    /// Somebody gets a key that the service serves.
    Query {
        /// To be named in the reply.
        query: QueryId,
        /// What is asked.
        request: Request,
    },
    /// The link to the router was lost: silence says nothing about the robots now.
    LinkLost,
    /// The link to the router is back.
    LinkRestored,
}

/// What a core wants done. The set is closed.
#[derive(Debug)]
pub enum Effect<Job> {
    /// Put a message on the bus.
    Publish(Message),
    /// Answer a get: with messages, or with an error that names the remedy. Every get is answered
    /// exactly once.
    Reply {
        /// Which get.
        query: QueryId,
        /// The get itself, which says which messages it selects and in which form.
        request: Request,
        /// The answer.
        answer: Result<Vec<Message>, String>,
    },
    /// Run a job. A core starts one at a time, by its [`crate::JobGate`].
    Start(Job),
    /// Ask the bus for the newest messages; the answers come back as [`Event::Fetched`], within a
    /// bounded time even if nobody answers.
    Fetch {
        /// A number of the core's own.
        fetch: u32,
        /// What is asked for.
        patterns: Vec<Pattern>,
    },
    /// Keep something over a restart of the service. It is kept before any later reply is sent.
    Store(Stored),
}

/// The effects of one event, in order.
#[derive(Debug)]
pub struct Effects<Job>(Vec<Effect<Job>>);

impl<Job> Default for Effects<Job> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<Job> Effects<Job> {
    /// Adds an effect.
    pub fn push(&mut self, effect: Effect<Job>) {
        self.0.push(effect);
    }

    /// Adds the publication of a message.
    pub fn publish(&mut self, message: Message) {
        self.push(Effect::Publish(message));
    }

    /// Takes all effects out, in order.
    pub fn drain(&mut self) -> impl Iterator<Item = Effect<Job>> + '_ {
        self.0.drain(..)
    }
}

/// What a service keeps over a restart.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stored {
    /// The last term that it began on this host.
    pub term: u64,
    /// The fields of the settings that operators have changed.
    pub patch: Map<String, Value>,
}

/// What a core begins with.
#[derive(Debug, Clone)]
pub struct Start<S> {
    /// The fleet.
    pub fleet: FleetId,
    /// This process.
    pub instance: InstanceId,
    /// Now.
    pub now: Tick,
    /// The settings by defaults, file, environment and flags.
    pub settings: S,
    /// What the service kept from its last run.
    pub stored: Stored,
}

/// How packets of a subscription wait for the core.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// One slot per key; a newer packet replaces the one that waits.
    Latest,
    /// A queue of at most so many packets per key; the oldest is dropped for a newer one. For
    /// deltas, whose gaps the core sees and mends with a fetch.
    Queue(usize),
}

/// One subscription.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Subscription {
    /// Which keys.
    pub pattern: Pattern,
    /// How packets wait.
    pub delivery: Delivery,
}

/// Which keys come in, and which are served.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Wiring {
    /// Messages that come in.
    pub subscriptions: Vec<Subscription>,
    /// Liveliness tokens that come in.
    pub tokens: Vec<Pattern>,
    /// Keys that the service answers gets for. `true` for its own output, for which the holder's answer
    /// suffices; `false` where it only repeats what it last heard from the holder of another role, in case that one is gone.
    pub served: Vec<(Pattern, bool)>,
}

impl Wiring {
    /// The wiring of a core with what every instance of a service needs for its role: the claims and
    /// settings of the holder and the tokens of the others come in; settings, status and the holder
    /// are served.
    #[must_use]
    pub fn of<C: Core>() -> Self {
        let mut wiring = C::wiring();
        for key in [Key::Holder(C::SERVICE), Key::Settings(C::SERVICE)] {
            let pattern = Pattern::One(key);
            wiring.subscriptions.push(Subscription { pattern, delivery: Delivery::Latest });
        }
        wiring.tokens.push(Pattern::InstanceTokens(C::SERVICE));
        let served = [Key::Settings, Key::Status, Key::Holder];
        wiring.served.extend(served.map(|key| (Pattern::One(key(C::SERVICE)), true)));
        wiring
    }
}

/// Whether a fetch goes on asking for a pattern while nobody answers: a service that starts does, for
/// those who know its last output may need a moment to find back after a failure of the router. Who
/// holds the role itself answers at once, or nobody does.
#[must_use]
pub fn is_patient<C: Core>(fetch: u32, pattern: &Pattern) -> bool {
    let of_role = [Key::Holder(C::SERVICE), Key::Settings(C::SERVICE)];
    fetch == START_FETCH && !of_role.iter().any(|key| *pattern == Pattern::One(key.clone()))
}

/// What a core holds in memory, counted. Every count is bounded by settings and `model::limits`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Footprint {
    /// Records of single robots: those that are known, waited for, or remembered.
    pub robots: usize,
    /// Edges of graphs and of the reports that they are made of.
    pub edges: usize,
    /// Whole messages: rosters, embeddings, divisions, audits. One that two places share counts
    /// twice.
    pub messages: usize,
    /// Senders of refused messages who are watched for repetition.
    pub offenders: usize,
}

/// A service without its shell.
pub trait Core: Send + Sized + 'static {
    /// Its settings.
    type Settings: Settings;
    /// Long work.
    type Job: Send + 'static;
    /// What long work leads to.
    type Done: Send + 'static;
    /// Its name.
    const SERVICE: ServiceName;

    /// Which keys come in, and which are served. Settings and status are served for every core.
    fn wiring() -> Wiring;

    /// A core that has seen no event yet.
    fn new(start: Start<Self::Settings>) -> Self;

    /// Takes one event in.
    fn handle(&mut self, now: Tick, event: Event<Self::Done>, effects: &mut Effects<Self::Job>);

    /// When [`Event::Timeout`] is wanted next. It may be early or late, never lost.
    fn deadline(&self) -> Option<Tick>;

    /// Where the instance stands towards the role of its service. Only a holder's messages are put
    /// on the bus.
    fn standing(&self) -> Standing;

    /// What the service tells of itself, for those who watch over the process.
    fn status(&self, now: Tick) -> ServiceStatus;

    /// What the core holds now. A core that holds nothing of a fleet has nothing to count.
    fn footprint(&self) -> Footprint {
        Footprint::default()
    }

    /// Does long work. Runs on another thread, beside the core, and must not depend on anything
    /// but the job and the stopwatch.
    fn run(job: Self::Job, stopwatch: &mut Stopwatch) -> Self::Done;

    /// Understands a packet that one of the subscriptions received.
    ///
    /// # Errors
    /// A [`Rejection`] that tells what is wrong with it.
    fn understand(space: &muster_wire::KeySpace, packet: &Packet) -> Result<Message, Rejection> {
        Message::decode(space, packet)
    }
}
