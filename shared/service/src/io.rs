//! Everything that reaches a host, and everything that a host wants done: plain data, which a
//! recording holds as it is.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::history::{Entry, Page, Query, RecordingReport, Retention};
use muster_model::role::ReplicaState;
use muster_wire::{Key, KeySpace, Message, Packet, Pattern, Rejection};
use serde::{Deserialize, Serialize};

use crate::start::Stored;

/// Names a get that waits for its answer. The caller of the host gives it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct GetId(pub u64);

/// Names one question of the host to the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct AskId(pub u64);

/// A packet on its way to the core. It is decoded as it arrives, or as it is handled.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Arrival {
    packet: Packet,
    /// Whether it came by a subscription to keys of other programs.
    is_foreign: bool,
    #[serde(skip)]
    decoded: Option<Result<Message, Rejection>>,
}

impl PartialEq for Arrival {
    fn eq(&self, other: &Self) -> bool {
        self.packet == other.packet
    }
}

impl Arrival {
    /// A packet that is decoded as it is handled. Messages between services may be large, take
    /// many times their bytes once decoded, and may be superseded before.
    #[must_use]
    pub fn encoded(packet: Packet) -> Self {
        Self { packet, is_foreign: false, decoded: None }
    }

    /// A packet that is decoded now.
    #[must_use]
    pub fn decoded(space: &KeySpace, packet: Packet) -> Self {
        let decoded = Some(Message::decode(space, &packet));
        Self { packet, is_foreign: false, decoded }
    }

    /// A packet on a key of another program, which no message of Muster's is decoded from.
    #[must_use]
    pub fn foreign(packet: Packet) -> Self {
        Self { packet, is_foreign: true, decoded: None }
    }

    /// A message that did not cross a bus, for callers that run hosts in one process. It is handed to
    /// the core as it is.
    #[must_use]
    pub fn of_message(space: &KeySpace, message: Message) -> Self {
        Self { packet: message.to_packet(space), is_foreign: false, decoded: Some(Ok(message)) }
    }

    /// A refusal without a packet, for callers that run hosts in one process.
    #[must_use]
    pub fn of_rejection(rejection: Rejection) -> Self {
        let packet = Packet::put(rejection.key.clone(), "", []);
        Self { packet, is_foreign: false, decoded: Some(Err(rejection)) }
    }

    /// Decodes the packet now, if it was not decoded before.
    pub fn decode(&mut self, space: &KeySpace) {
        if self.is_foreign {
            return;
        }
        self.decoded.get_or_insert_with(|| Message::decode(space, &self.packet));
    }

    /// The packet.
    #[must_use]
    pub fn packet(&self) -> &Packet {
        &self.packet
    }

    /// Whether it came by a subscription to keys of other programs.
    pub(crate) fn is_foreign(&self) -> bool {
        self.is_foreign
    }

    /// The packet, by value.
    pub(crate) fn into_packet(self) -> Packet {
        self.packet
    }

    /// Whether the packet was decoded and refused.
    #[must_use]
    pub fn is_refused(&self) -> bool {
        matches!(self.decoded, Some(Err(_)))
    }

    /// The message, decoded now if it was not before.
    ///
    /// # Errors
    /// A [`Rejection`] that names what is wrong with the packet.
    pub fn into_message(self, space: &KeySpace) -> Result<Message, Rejection> {
        self.decoded.unwrap_or_else(|| Message::decode(space, &self.packet))
    }

    /// The message, if the packet is decoded and was not refused.
    #[must_use]
    pub fn message(&self) -> Option<&Message> {
        self.decoded.as_ref()?.as_ref().ok()
    }
}

/// Everything that can happen to a service. The set is closed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(
    clippy::large_enum_variant,
    reason = "an input is handed on once; most are arrivals, the largest variant"
)]
pub enum Input {
    /// The service begins; its subscriptions are declared.
    Started {
        /// Whether the link to the router is up.
        linked: bool,
    },
    /// A packet of a subscription or a liveliness token.
    Arrived(Arrival),
    /// `Host::deadline` has passed.
    Timer,
    /// The job has ended. `Host::finish_job` brought its result, unless it
    /// panicked.
    JobEnded {
        /// The times that the job measured, in microseconds.
        laps: Vec<u64>,
        /// The text of the panic, if it panicked.
        panic: Option<String>,
    },
    /// A question has been answered, or its time is over.
    Answered {
        /// Which one.
        ask: AskId,
        /// The answers.
        answers: Vec<Arrival>,
    },
    /// A get of a key that the service serves.
    Get(IncomingGet),
    /// The link to the router is lost.
    LinkLost,
    /// The link to the router is back.
    LinkRestored,
    /// State has been written, or could not be.
    Stored {
        /// Why it could not be written.
        error: Option<String>,
    },
    /// What the core kept in its last run. It comes before [`Input::Started`], if there is anything.
    Restored(Vec<u8>),
    /// What the core wants kept has been written, or could not be.
    Kept {
        /// Why it could not be written.
        error: Option<String>,
    },
    /// A lookup of records has ended.
    Found {
        /// The number that the core gave it.
        lookup: u64,
        /// What was found, or why nothing can be.
        page: Result<Page, String>,
    },
    /// Counters of the process, for the next status. They are data like any other, so that a replay
    /// answers the same.
    ProcessCounters(BTreeMap<String, u64>),
    /// What was kept could not be read: it is damaged, or the disk fails. The instance began without it.
    StateLost {
        /// What is wrong with it, and where it is.
        reason: String,
    },
    /// Records have been written, or could not be.
    Recorded(Box<RecordingReport>),
}

/// A get as the bus brings it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct IncomingGet {
    /// To be named in the reply.
    pub get: GetId,
    /// The key expression that is asked for.
    pub selector: String,
    /// The key expression of the queryable that it reached, if the get asks for all of it: each
    /// queryable answers for its own keys alone.
    pub narrowed: Option<String>,
    /// What follows the `?` of the selector.
    pub parameters: String,
    /// What the get carries, such as a patch of settings.
    pub payload: Option<Vec<u8>>,
}

/// Something that goes on the bus. Two are equal if their packets are.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Publication {
    /// The packets: the message, and its JSON mirror if it has one.
    pub packets: Vec<Packet>,
    /// Whether it must not wait behind large messages.
    pub is_lease_renewal: bool,
    /// The message itself; a recording does not hold it.
    #[serde(skip)]
    pub message: Option<Message>,
}

/// One question to all who serve a key expression.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ask {
    /// To be named in [`Input::Answered`].
    pub ask: AskId,
    /// What is asked for.
    pub pattern: Pattern,
    /// How long answers are waited for.
    pub within: Duration,
    /// How long after an answer a further one is waited for; none: until all who are asked have answered.
    pub further_within: Option<Duration>,
}

/// An answer to a get. Two are equal if their packets are.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Reply {
    /// Which get.
    pub get: GetId,
    /// The packets, or an error text that names the remedy.
    pub answer: Result<Vec<Packet>, String>,
    /// The messages themselves; a recording does not hold them.
    #[serde(skip)]
    pub messages: Vec<Message>,
}

impl PartialEq for Publication {
    fn eq(&self, other: &Self) -> bool {
        (&self.packets, self.is_lease_renewal) == (&other.packets, other.is_lease_renewal)
    }
}

impl PartialEq for Reply {
    fn eq(&self, other: &Self) -> bool {
        (self.get, &self.answer) == (other.get, &other.answer)
    }
}

/// Everything that a host wants done. The set is closed. Commands are carried out in order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Command {
    /// Put packets on the bus.
    Publish(Publication),
    /// Answer a get. Every get is answered exactly once.
    Reply(Reply),
    /// Run the job that `Host::take_job` gives; its end comes back as
    /// [`Input::JobEnded`].
    RunJob,
    /// Ask the bus; [`Input::Answered`] comes back in any case, after [`Ask::within`] at the latest.
    Ask(Ask),
    /// Keep state over a restart; [`Input::Stored`] comes back.
    Store(Stored),
    /// Keep this for the core over a restart, in place of what was kept before; [`Input::Kept`] comes back.
    Keep(Vec<u8>),
    /// What the core kept in its last run cannot be used: operators are to be told why, and the file is to be
    /// put aside.
    KeptIsUnusable(String),
    /// The instance stands elsewhere in the election. A leader's answer suffices on the service's own
    /// keys, so that they are declared again when leadership comes or goes.
    ReplicaState(ReplicaState),
    /// Declare a liveliness token.
    DeclareToken(Key),
    /// Withdraw a liveliness token.
    WithdrawToken(Key),
    /// Append a record to the history that this instance keeps. [`Input::Recorded`] comes back for all that were
    /// written together.
    Append(Box<Entry>),
    /// Look records up; [`Input::Found`] comes back.
    LookUp {
        /// The number that the core gave it.
        lookup: u64,
        /// What is asked for.
        query: Query,
    },
    /// A message of the core has no form on the bus. It is a fault of the program.
    Unencodable(String),
    /// Forget records that are too old or too many.
    Retain(Retention),
}

impl Input {
    /// The kind of the input, as metrics count it.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Started { .. } => "started",
            Self::Arrived(arrival) if arrival.is_refused() => "refused",
            Self::Arrived(_) => "message",
            Self::Timer => "timeout",
            Self::JobEnded { panic: None, .. } => "job_done",
            Self::JobEnded { panic: Some(_), .. } => "job_failed",
            Self::Answered { .. } => "fetched",
            Self::Get(_) => "get",
            Self::LinkLost => "link_lost",
            Self::LinkRestored => "link_restored",
            Self::Stored { .. } => "stored",
            Self::StateLost { .. } => "state_lost",
            Self::Restored(_) => "restored",
            Self::Kept { .. } => "kept",
            Self::Found { .. } => "found",
            Self::ProcessCounters(_) => "process_counters",
            Self::Recorded(_) => "recorded",
        }
    }
}
