//! What a service is: hooks that say what happened, and the keys that it reads and serves.

use muster_model::id::{FleetId, InstanceId, ServiceName};
use muster_model::settings::Settings;
use muster_model::time::Tick;
use muster_wire::{Key, Message, Packet, Pattern};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::context::{Context, View};
use crate::gets::Get;
use crate::io::Record;
use crate::stopwatch::Stopwatch;

/// What a service keeps over a restart.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stored {
    /// The last term that it began on this host.
    pub term: u64,
    /// The fields of the settings that operators have changed.
    #[serde(with = "patch_form")]
    pub patch: Map<String, Value>,
}

/// A patch is written as it is where the form describes itself, as JSON does, and as JSON text where it
/// does not, as in a recording.
mod patch_form {
    use serde::de::Error as _;
    use serde::ser::Error as _;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use serde_json::{Map, Value};

    pub(super) fn serialize<S: Serializer>(
        patch: &Map<String, Value>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            return patch.serialize(serializer);
        }
        let text = serde_json::to_string(patch).map_err(S::Error::custom)?;
        text.serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Map<String, Value>, D::Error> {
        if deserializer.is_human_readable() {
            return Map::deserialize(deserializer);
        }
        let text = String::deserialize(deserializer)?;
        serde_json::from_str(&text).map_err(D::Error::custom)
    }
}

/// What an instance begins with.
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
    /// One slot per key; a newer packet replaces the waiting one.
    Latest,
    /// A queue of at most so many packets per key; a newer packet drops the oldest. For deltas,
    /// whose gaps the core detects and repairs with a fetch.
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

/// Whose output a served key holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Authority {
    /// The service's own output. The leader's answer alone suffices.
    Own,
    /// The last output of another service that this one received: an answer in case that service is
    /// gone.
    Cached,
}

/// One key expression that a service answers gets for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServedKey {
    /// Which keys.
    pub pattern: Pattern,
    /// Whose output they hold.
    pub authority: Authority,
}

impl ServedKey {
    /// A key of the service's own output.
    #[must_use]
    pub fn own(pattern: Pattern) -> Self {
        Self { pattern, authority: Authority::Own }
    }

    /// A key of another service's output.
    #[must_use]
    pub fn cached(pattern: Pattern) -> Self {
        Self { pattern, authority: Authority::Cached }
    }
}

/// Which keys a service subscribes to, and which it serves.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Wiring {
    /// Subscriptions.
    pub subscriptions: Vec<Subscription>,
    /// Liveliness tokens that it follows.
    pub tokens: Vec<Pattern>,
    /// Keys that it answers gets for.
    pub served: Vec<ServedKey>,
}

impl Wiring {
    /// The wiring of a core with what the host adds: lease renewals, settings and tokens of the other
    /// instances come in; settings, status, the leader and the schema are served.
    #[must_use]
    pub fn of<C: Core>() -> Self {
        let mut wiring = C::wiring();
        let service = C::SERVICE;
        let mut served = vec![Key::Settings(service), Key::Status(service), Key::Schema];
        if C::REPLICATION == Replication::OneLeads {
            for key in [Key::Lease(service), Key::Settings(service)] {
                let pattern = Pattern::One(key);
                wiring.subscriptions.push(Subscription { pattern, delivery: Delivery::Latest });
            }
            wiring.tokens.push(Pattern::InstanceTokens(service));
            served.push(Key::Lease(service));
        }
        wiring.served.extend(served.into_iter().map(|key| ServedKey::own(Pattern::One(key))));
        wiring
    }
}

/// How many instances of a service publish.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Replication {
    /// One instance leads and publishes; the others stand by and take over.
    OneLeads,
    /// Every instance works for itself, such as a recorder or a console: there is no election.
    EveryInstance,
}

/// What a core holds in memory, counted. Settings and `model::limits` bound every count.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct MemoryUse {
    /// Records of single robots.
    pub robots: usize,
    /// Edges of graphs and of the reports that they are made of.
    pub edges: usize,
    /// Whole messages: rosters, embeddings, divisions, audits. A message shared by two places counts
    /// twice.
    pub messages: usize,
    /// Senders of refused messages that are watched for repetition. The host counts them.
    pub offenders: usize,
}

/// Whether silence on the bus says anything about others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Connectivity {
    /// The link to the router is up, and this instance's place among the others is known again.
    Online,
    /// The link to the router is lost.
    Offline,
    /// The process did not run for a while. The link was never reported lost.
    Paused,
}

/// How a job ended.
#[derive(Debug)]
pub enum JobEnd<Done> {
    /// With a result.
    Finished(Done),
    /// With a panic, and what it said: at most a line, without control characters.
    Panicked(String),
}

/// A service without its shell: a deterministic state machine.
///
/// The host calls one hook per event and owns everything that all services share: election and
/// terms, suppressed output, settings, refused messages, fetches, gets, jobs and stored state. A hook
/// reads no clock, starts no thread, opens no file and knows no bus; it acts through [`Context`].
pub trait Core: Send + Sized + 'static {
    /// Its settings.
    type Settings: Settings;
    /// Names its fetches, so that it can tell their answers apart.
    type Fetch: std::fmt::Debug + Copy + Eq + Send + 'static;
    /// Long work.
    type Job: Send + 'static;
    /// What long work leads to.
    type Done: Send + 'static;
    /// Its name.
    const SERVICE: ServiceName;
    /// How many instances publish.
    const REPLICATION: Replication = Replication::OneLeads;

    /// Which keys it subscribes to and serves. The host adds settings, status and the election.
    fn wiring() -> Wiring;

    /// What an instance asks the bus for before it leads: its own last output and what it reads.
    fn initial() -> Vec<Pattern>;

    /// The key of its main output. The leader asks its readers from time to time what they have
    /// seen of it.
    fn output() -> Key;

    /// Whether a message is an output of this service, so that a new term must be above it.
    fn is_output(message: &Message) -> bool;

    /// A core to which nothing has happened.
    fn new(now: Tick, settings: &Self::Settings) -> Self;

    /// This instance leads from now on; `answers` is what the bus holds of [`Core::initial`], in no
    /// particular order.
    fn on_lead(&mut self, context: &mut Context<'_, Self>, answers: Vec<Message>);

    /// Another instance leads; `answers` as in [`Core::on_lead`].
    fn on_follow(&mut self, context: &mut Context<'_, Self>, answers: Vec<Message>);

    /// Another instance has taken over. The core forgets what it published.
    fn on_stand_down(&mut self, context: &mut Context<'_, Self>);

    /// This instance goes on in a new, higher term: readers have seen a higher revision than its own,
    /// or another instance had begun the same term. Everything is to be published again. `found` is
    /// what the readers hold of [`Core::output`].
    fn on_new_term(&mut self, context: &mut Context<'_, Self>, found: Vec<Message>);

    /// A message arrived.
    fn on_message(&mut self, context: &mut Context<'_, Self>, message: Message);

    /// A packet arrived on a key of another program, of a subscription to [`Pattern::Foreign`].
    fn on_foreign(&mut self, _context: &mut Context<'_, Self>, _packet: Packet) {}

    /// A get of a key that the core serves. It is answered exactly once, now or later.
    fn on_get(&mut self, context: &mut Context<'_, Self>, get: Get);

    /// A fetch has ended with the messages that were answered in time.
    fn on_answers(
        &mut self,
        _context: &mut Context<'_, Self>,
        _fetch: Self::Fetch,
        _answers: Vec<Message>,
    ) {
    }

    /// The instance asks the bus for [`Core::initial`], which also answers open questions.
    fn on_inquiry(&mut self, _context: &mut Context<'_, Self>) {}

    /// The deadline has passed.
    fn on_timer(&mut self, _context: &mut Context<'_, Self>) {}

    /// The job has ended.
    fn on_job(&mut self, _context: &mut Context<'_, Self>, _end: JobEnd<Self::Done>) {}

    /// A job that the core no longer waited for has ended, so that another one may start.
    fn on_job_slot_free(&mut self, _context: &mut Context<'_, Self>) {}

    /// A lookup of records has ended; oldest first.
    fn on_records(
        &mut self,
        _context: &mut Context<'_, Self>,
        _lookup: u64,
        _records: Vec<Record>,
    ) {
    }

    /// An operator has changed the settings.
    fn on_settings(&mut self, _context: &mut Context<'_, Self>) {}

    /// Silence says something else than before. A leader that is cut off is told [`Connectivity::Online`]
    /// only once it knows that no other instance has taken over.
    fn on_connectivity(&mut self, _context: &mut Context<'_, Self>, _connectivity: Connectivity) {}

    /// Before every input. `now` is the moment at which all commands of the input before were
    /// carried out.
    fn before_input(&mut self, _now: Tick) {}

    /// After every input: does what has become due.
    fn after_input(&mut self, _context: &mut Context<'_, Self>) {}

    /// When [`Core::on_timer`] is wanted next. It may come early or late, but it comes.
    fn deadline(&self, view: &View<'_, Self>) -> Option<Tick>;

    /// What the service is doing, in a few words.
    fn state(&self, view: &View<'_, Self>) -> String;

    /// What the core holds now.
    fn memory_use(&self) -> MemoryUse {
        MemoryUse::default()
    }

    /// Does long work. Runs on another thread and depends on nothing but the job and the stopwatch.
    fn run(job: Self::Job, stopwatch: &mut Stopwatch) -> Self::Done;
}
