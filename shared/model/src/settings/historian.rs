//! Settings of `historian`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Settings, SettingsError, check_range};

/// Settings of `historian`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HistorianSettings {
    /// Records are kept for this many days.
    #[schemars(range(min = 0.01, max = 3650))]
    pub keep_days: f64,
    /// Above so many megabytes of records, the oldest whole minutes go.
    #[schemars(range(min = 4, max = 1_000_000))]
    pub max_mb: f64,
    /// Scores of divisions are recorded at most once in this many seconds, and whenever the verdict changes.
    #[schemars(range(min = 1, max = 3600))]
    pub audit_interval_s: f64,
    /// Positions of robots are recorded once in this many seconds, where they have changed; 0: never.
    #[schemars(range(min = 0, max = 3600))]
    pub positions_interval_s: f64,
}

impl Default for HistorianSettings {
    fn default() -> Self {
        Self { keep_days: 30.0, max_mb: 2048.0, audit_interval_s: 10.0, positions_interval_s: 30.0 }
    }
}

impl Settings for HistorianSettings {
    fn check(&self) -> Result<(), SettingsError> {
        check_range("keep_days", self.keep_days, 0.01..=3650.0)?;
        check_range("max_mb", self.max_mb, 4.0..=1_000_000.0)?;
        check_range("audit_interval_s", self.audit_interval_s, 1.0..=3600.0)?;
        check_range("positions_interval_s", self.positions_interval_s, 0.0..=3600.0)
    }
}
