//! The life of a service as a list of entries: every input with its moment, and the commands that
//! followed, as they are.
//!
//! The shell writes an input before the host handles it, so that an input at which the core panics
//! is there as well, and the commands after. `replay` hands the inputs to a host again.

use muster_model::id::{FleetId, InstanceId, ServiceName};
use muster_model::time::Tick;
use muster_wire::envelope::EnvelopeError;
use muster_wire::recording::frame;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::core::Core;
use crate::io::{Command, Input};
use crate::start::{Start, Stored};

/// What a recording begins with: everything that a host is made from, and where it ran.
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
    /// When the host was made.
    pub started: Tick,
    /// The settings by defaults, file, environment and flags.
    pub settings: Value,
    /// What the service kept from its last run.
    pub stored: Stored,
    /// What the machine and the build are: last digits of numbers depend on it.
    pub host: String,
}

impl Head {
    /// The head of a recording of a host that is about to be made. `host` names machine and build.
    ///
    /// # Errors
    /// If the settings have no JSON form.
    pub fn new<C: Core>(
        start: &Start<C::Settings>,
        host: String,
    ) -> Result<Self, serde_json::Error> {
        Ok(Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            service: C::SERVICE,
            fleet: start.fleet.clone(),
            instance: start.instance.clone(),
            started: start.now,
            settings: serde_json::to_value(&start.settings)?,
            stored: start.stored.clone(),
            host,
        })
    }
}

/// One entry of a recording.
#[expect(clippy::large_enum_variant, reason = "entries are read one at a time")]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Entry {
    /// The host is about to handle an input.
    Input {
        /// The moment that the host is given.
        tick: Tick,
        /// The input.
        input: Input,
    },
    /// What the host wanted done for the input before, in order.
    Commands(Vec<Command>),
    /// The recording ends here on purpose, though the service may go on.
    End(String),
}

/// An [`Entry`] that is only written.
#[derive(Serialize)]
enum EntryRef<'a> {
    Input {
        tick: Tick,
        input: &'a Input,
    },
    Commands(&'a [Command]),
    #[expect(dead_code, reason = "the variants are numbered like those of Entry")]
    End(&'a str),
}

/// The bytes of an [`Entry::Input`].
///
/// # Errors
/// [`EnvelopeError`] if the input is larger than an entry may be.
pub fn input_frame(tick: Tick, input: &Input) -> Result<Vec<u8>, EnvelopeError> {
    frame(&EntryRef::Input { tick, input })
}

/// The bytes of an [`Entry::Commands`].
///
/// # Errors
/// [`EnvelopeError`] if the commands are larger than an entry may be.
pub fn commands_frame(commands: &[Command]) -> Result<Vec<u8>, EnvelopeError> {
    frame(&EntryRef::Commands(commands))
}
