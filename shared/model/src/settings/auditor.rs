//! Settings of `auditor`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Settings, SettingsError, check_range};

/// Settings of `auditor`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AuditorSettings {
    /// Mean silhouette in the embedding from which a division is good.
    #[schemars(range(min = -1, max = 1))]
    pub good: f64,
    /// Mean silhouette in the embedding below which a division is poor.
    #[schemars(range(min = -1, max = 1))]
    pub poor: f64,
    /// A division must be poor for this many seconds before an alert.
    #[schemars(range(min = 0, max = 3600))]
    pub alert_after_s: f64,
    /// An alert ends once the mean silhouette is this much above `poor`.
    #[schemars(range(min = 0, max = 1))]
    pub alert_clearance: f64,
    /// Robots that change teams to and fro raise an alert above so many returns per robot and minute. It
    /// ends at half of that.
    #[schemars(range(min = 0, max = 1000))]
    pub flapping: f64,
}

impl Default for AuditorSettings {
    fn default() -> Self {
        Self { good: 0.5, poor: 0.25, alert_after_s: 3.0, alert_clearance: 0.05, flapping: 0.05 }
    }
}

impl Settings for AuditorSettings {
    fn check(&self) -> Result<(), SettingsError> {
        check_range("good", self.good, -1.0..=1.0)?;
        check_range("poor", self.poor, -1.0..=1.0)?;
        if self.good < self.poor {
            return Err(SettingsError::new("good", "must not be less than poor"));
        }
        check_range("alert_after_s", self.alert_after_s, 0.0..=3600.0)?;
        check_range("alert_clearance", self.alert_clearance, 0.0..=1.0)?;
        check_range("flapping", self.flapping, 0.0..=1000.0)
    }
}
