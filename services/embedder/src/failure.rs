//! Which failures are told, and which have just been.

use std::mem::{Discriminant, discriminant};
use std::time::Duration;

use muster_model::time::Tick;
use muster_wire::message::quoted;

use crate::compute::ComputeError;

/// How long a failure is not told again while its reason stays the same: frames come many times a
/// second, and each may fail.
const SILENCE: Duration = Duration::from_secs(2);

/// What tells failures apart, whatever numbers stand in their text; none for a panic.
type Kind = Option<Discriminant<ComputeError>>;

/// The failures of the jobs.
#[derive(Debug, Default)]
pub(crate) struct Failures {
    standing: Option<String>,
    told: Option<(Kind, Tick)>,
}

impl Failures {
    /// Why the newest frame has no embedding, if it has none.
    pub(crate) fn standing(&self) -> Option<&str> {
        self.standing.as_deref()
    }

    /// A job has succeeded.
    pub(crate) fn end(&mut self) {
        self.standing = None;
    }

    /// A job has ended with an error; what is to be told of it, unless it just was.
    pub(crate) fn refused(&mut self, now: Tick, error: &ComputeError) -> Option<String> {
        self.failed(now, Some(discriminant(error)), error.to_string())
    }

    /// A job has panicked; what is to be told of it, unless it just was.
    pub(crate) fn panicked(&mut self, now: Tick, said: &str) -> Option<String> {
        self.failed(now, None, format!("the job panicked: {}", quoted(said)))
    }

    fn failed(&mut self, now: Tick, kind: Kind, reason: String) -> Option<String> {
        self.standing = Some(reason.clone());
        if self.told.is_some_and(|(told, at)| told == kind && now.since(at) < SILENCE) {
            return None;
        }
        self.told = Some((kind, now));
        Some(reason)
    }
}
