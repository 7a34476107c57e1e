//! Recordings that are played: they run in fleets of their own, whose names say so on every key and in every message.

use crate::id::FleetId;

/// What the name of a fleet begins with in which a recording is played: `muster replay` plays into no other. Nothing stops
/// live robots from joining such a fleet; whoever names one so is shown that it is a replay.
pub const REPLAY_PREFIX: &str = "replay-";

/// Whether a fleet is one for recordings, by its name.
#[must_use]
pub fn is_replay(fleet: &FleetId) -> bool {
    fleet.as_str().starts_with(REPLAY_PREFIX)
}
