//! The life of a core as a list of entries: every event with its moment, and what the core wanted
//! done, as the bytes that would go on the bus.
//!
//! A shell makes an [`Entry`] of each event before the core sees it, so that an event at which the
//! core panics is there as well, and one of the commands after. [`crate::replay`] lives through it.

use muster_model::id::{FleetId, InstanceId, ServiceName};
use muster_model::time::Tick;
use muster_wire::envelope::EnvelopeError;
use muster_wire::recording::{Put, Received};
use muster_wire::{KeySpace, Message, Rejection, Request};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::core::{Core, Event, Start, Stored};
use crate::driver::Command;

/// What a recording begins with: everything that a core is made from, and where it ran.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// The version of the program.
    pub version: String,
    /// Which service.
    pub service: ServiceName,
    /// The fleet.
    pub fleet: FleetId,
    /// The process.
    pub instance: InstanceId,
    /// When the core was made.
    pub started: Tick,
    /// The settings by defaults, file, environment and flags.
    pub settings: Value,
    /// What the service kept from its last run.
    pub stored: Stored,
    /// What the machine and the build are: last digits of numbers depend on it.
    pub host: String,
}

impl Head {
    /// The head of a recording of a core that is about to be made.
    ///
    /// # Errors
    /// If the settings have no JSON form.
    pub fn new<C: Core>(start: &Start<C::Settings>, host: String) -> Result<Self, String> {
        Ok(Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            service: C::SERVICE,
            fleet: start.fleet.clone(),
            instance: start.instance.clone(),
            started: start.now,
            settings: serde_json::to_value(&start.settings).map_err(|error| error.to_string())?,
            stored: start.stored.clone(),
            host,
        })
    }
}

/// One entry of a recording.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Entry {
    /// An event is about to be handed to the core.
    Event {
        /// The moment that the core is told.
        tick: Tick,
        /// The event.
        input: Input,
    },
    /// What the core wanted done for the event before, in order.
    Outputs(Vec<Output>),
    /// The recording ends here on purpose, though the service may go on.
    End(String),
}

/// An event as it is recorded.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Input {
    /// [`Event::Started`]
    Started,
    /// [`Event::Received`]
    Received(Received),
    /// [`Event::Rejected`]
    Rejected(Rejection),
    /// [`Event::Timeout`]
    Timeout,
    /// [`Event::Done`], with the laps of the job in microseconds: the job itself is run again.
    Done(Vec<u64>),
    /// [`Event::JobFailed`], with the laps until then and what the panic said.
    JobFailed(Vec<u64>, String),
    /// [`Event::Fetched`]
    Fetched(u32, Vec<Received>),
    /// [`Event::Query`]
    Query(u64, Request),
    /// [`Event::LinkLost`]
    LinkLost,
    /// [`Event::LinkRestored`]
    LinkRestored,
}

/// A command as it is recorded.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Output {
    /// [`Command::Publish`]: what goes on the bus, or why it cannot.
    Published(Result<Vec<Put>, String>),
    /// [`Command::Reply`], without what the shell adds to a status.
    Replied(u64, Result<Vec<Put>, String>),
    /// [`Command::Run`]
    Ran,
    /// [`Command::Fetch`], with the key expressions.
    Fetched(u32, Vec<String>),
    /// [`Command::Store`], as JSON.
    Stored(String),
}

impl Entry {
    /// An event as it is recorded. `laps` are those of the job that has ended, if one has.
    ///
    /// # Errors
    /// [`EnvelopeError`] if a message has no recorded form.
    pub fn event<Done>(
        space: &KeySpace,
        tick: Tick,
        event: &Event<Done>,
        laps: &[u64],
    ) -> Result<Self, EnvelopeError> {
        let input = match event {
            Event::Started => Input::Started,
            Event::Received(message) => Input::Received(Received::new(space, message)?),
            Event::Rejected(rejection) => Input::Rejected(rejection.clone()),
            Event::Timeout => Input::Timeout,
            Event::Done(_) => Input::Done(laps.to_vec()),
            Event::JobFailed(said) => Input::JobFailed(laps.to_vec(), said.clone()),
            Event::Fetched { fetch, messages } => {
                let heard = messages.iter().map(|message| Received::new(space, message));
                Input::Fetched(*fetch, heard.collect::<Result<_, _>>()?)
            }
            Event::Query { query, request } => Input::Query(query.0, request.clone()),
            Event::LinkLost => Input::LinkLost,
            Event::LinkRestored => Input::LinkRestored,
        };
        Ok(Self::Event { tick, input })
    }

    /// What a core wanted done, as it is recorded.
    #[must_use]
    pub fn outputs<Job>(space: &KeySpace, now: Tick, commands: &[Command<Job>]) -> Self {
        Self::Outputs(commands.iter().map(|command| Output::new(space, now, command)).collect())
    }
}

impl Output {
    /// A command as it is recorded.
    #[must_use]
    pub fn new<Job>(space: &KeySpace, now: Tick, command: &Command<Job>) -> Self {
        match command {
            Command::Publish(message) => {
                let outbound = message.publish(now).map_err(|error| error.to_string());
                Self::Published(
                    outbound.map(|all| {
                        all.into_iter().map(|outbound| Put::new(space, outbound)).collect()
                    }),
                )
            }
            Command::Reply { query, request, answer } => {
                Self::Replied(query.0, answered(space, now, request, answer))
            }
            Command::Run(_) => Self::Ran,
            Command::Fetch { fetch, patterns } => {
                let patterns = patterns.iter().map(|pattern| space.pattern(pattern));
                Self::Fetched(*fetch, patterns.collect())
            }
            Command::Store(stored) => Self::Stored(match serde_json::to_string(stored) {
                Ok(text) => text,
                Err(error) => error.to_string(),
            }),
        }
    }
}

fn answered(
    space: &KeySpace,
    now: Tick,
    request: &Request,
    answer: &Result<Vec<Message>, String>,
) -> Result<Vec<Put>, String> {
    let mut all = Vec::new();
    for message in answer.as_ref().map_err(Clone::clone)? {
        let outbound = message.answer(space, request, now).map_err(|error| error.to_string())?;
        all.extend(outbound.into_iter().map(|outbound| Put::new(space, outbound)));
    }
    Ok(all)
}
