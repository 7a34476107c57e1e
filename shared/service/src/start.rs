//! What an instance begins with, and what it keeps over a restart.

use std::collections::BTreeMap;

use muster_model::command::CommandOutcome;
use muster_model::id::{FleetId, InstanceId};
use muster_model::time::Tick;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// What a service keeps over a restart.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stored {
    /// The last term that it began on this host.
    pub term: u64,
    /// The fields of the settings that operators have changed, or that differ from those of this host's file and flags.
    #[serde(with = "patch_form")]
    pub patch: Map<String, Value>,
    /// When operators have changed them, by the path of each field. A field of the patch without a date is one that a leader has
    /// by its own file or flags.
    #[serde(default)]
    pub changed: BTreeMap<String, Tick>,
    /// Whether those of the fleet were not known in that term: an instance that has them takes over, also after a restart.
    #[serde(default)]
    pub lacks_settings: bool,
    /// What came of the last commands, the oldest first: none is carried out again.
    #[serde(default)]
    pub commands: Vec<CommandOutcome>,
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
