//! Recordings that are played: they run in fleets of their own, whose names say so on every key and in every message.

use crate::id::FleetId;

/// What the name of a fleet begins with in which a recording is played, and of no other.
pub const REPLAY_PREFIX: &str = "replay-";

/// Whether a recording is played in a fleet.
#[must_use]
pub fn is_replay(fleet: &FleetId) -> bool {
    fleet.as_str().starts_with(REPLAY_PREFIX)
}
