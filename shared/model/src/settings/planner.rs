//! Settings of `planner`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Settings, SettingsError, check_range};
use crate::limits::MAX_ROBOTS;

/// Settings of `planner`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlannerSettings {
    /// Proposals for larger fleets are refused: where services share a small host, their computation takes the
    /// processor from the live division for as long as it lasts.
    #[schemars(range(min = 1, max = MAX_ROBOTS))]
    pub max_robots: u32,
}

impl Default for PlannerSettings {
    fn default() -> Self {
        Self { max_robots: u32::try_from(MAX_ROBOTS).unwrap_or(u32::MAX) }
    }
}

impl Settings for PlannerSettings {
    fn check(&self) -> Result<(), SettingsError> {
        #[expect(clippy::cast_precision_loss, reason = "there are fewer than 2⁵³ robots")]
        let most = MAX_ROBOTS as f64;
        check_range("max_robots", f64::from(self.max_robots), 1.0..=most)
    }
}
