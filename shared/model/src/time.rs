//! The one time of a process.

use std::time::Duration;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A moment in microseconds since the Unix epoch.
///
/// The shell reads the wall clock once, at its start, and adds the steady clock to it: ticks of one
/// process never run backwards, and those of different hosts differ as their clocks did. Cores
/// receive ticks and read no clock.
#[derive(
    Debug,
    Clone,
    Copy,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Serialize,
    Deserialize,
    JsonSchema,
)]
pub struct Tick(pub u64);

impl Tick {
    /// This moment and a duration later; saturates.
    #[must_use]
    pub fn after(self, duration: Duration) -> Self {
        Self(self.0.saturating_add(u64::try_from(duration.as_micros()).unwrap_or(u64::MAX)))
    }

    /// A duration before this moment; saturates.
    #[must_use]
    pub fn before(self, duration: Duration) -> Self {
        Self(self.0.saturating_sub(u64::try_from(duration.as_micros()).unwrap_or(u64::MAX)))
    }

    /// How long ago `earlier` was; zero if it is later than this moment.
    #[must_use]
    pub fn since(self, earlier: Self) -> Duration {
        Duration::from_micros(self.0.saturating_sub(earlier.0))
    }

    /// The moment that JSON messages have as seconds since the Unix epoch; what is no such moment becomes the nearest one.
    #[must_use]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the conversion saturates, and microseconds are exact enough"
    )]
    pub fn of_seconds(seconds: f64) -> Self {
        Self((seconds * 1e6).round() as u64)
    }

    /// Seconds since the Unix epoch, as the JSON messages have them.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "microseconds stay exact until the year 2255")]
    pub fn as_seconds(self) -> f64 {
        self.0 as f64 / 1e6
    }
}

/// Turns seconds of a checked setting into a duration: not finite, or negative, becomes zero, and
/// more than a century becomes a century.
#[must_use]
pub fn seconds(value: f64) -> Duration {
    const CENTURY_S: f64 = 3.2e9;
    if value > 0.0 { Duration::from_secs_f64(value.min(CENTURY_S)) } else { Duration::ZERO }
}
