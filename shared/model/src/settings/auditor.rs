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
    /// What is wrong must last for this many seconds before an alert; flapping and churn are rates over a
    /// minute, and need no delay.
    #[schemars(range(min = 0, max = 3600))]
    pub alert_after_s: f64,
    /// An alert ends once the mean silhouette is this much above `poor`, or that of a team above `team_poor`.
    #[schemars(range(min = 0, max = 1))]
    pub alert_clearance: f64,
    /// Robots that change teams to and fro raise an alert above so many returns per robot and minute.
    #[schemars(range(min = 0, max = 1000))]
    pub flapping: f64,
    /// Alerts of shares and rates (`flapping`, `churn`, `stale_share`, `fragile`) end at this part of their
    /// threshold.
    #[schemars(range(min = 0, max = 1))]
    pub alert_release: f64,
    /// What raised an alert of a team must be over for this many seconds before the alert ends.
    #[schemars(range(min = 0, max = 3600))]
    pub alert_clear_s: f64,
    /// Mean silhouette of a team in the embedding below which it is poor.
    #[schemars(range(min = -1, max = 1))]
    pub team_poor: f64,
    /// A team is cut off if no link joins so many parts of it, or more.
    #[schemars(range(min = 2, max = 1000))]
    pub cut_off_parts: u32,
    /// A team of at most so many robots is an alert where there are other teams; 0 for never.
    #[schemars(range(min = 0, max = 1000))]
    pub singleton: u32,
    /// A team is stale if more than this share of its robots is.
    #[schemars(range(min = 0, max = 1))]
    pub stale_share: f64,
    /// So many changes of teams per robot and minute, or more, are churn.
    #[schemars(range(min = 0, max = 1000))]
    pub churn: f64,
    /// A team is fragile if the loss of one robot would cut off more than this share of the others.
    #[schemars(range(min = 0, max = 1))]
    pub fragile: f64,
}

impl Default for AuditorSettings {
    fn default() -> Self {
        Self {
            good: 0.5,
            poor: 0.25,
            alert_after_s: 3.0,
            alert_clearance: 0.05,
            flapping: 0.05,
            alert_release: 0.5,
            alert_clear_s: 2.0,
            team_poor: 0.0,
            cut_off_parts: 2,
            singleton: 1,
            stale_share: 0.25,
            churn: 1.0,
            fragile: 0.3,
        }
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
        check_range("flapping", self.flapping, 0.0..=1000.0)?;
        check_range("alert_release", self.alert_release, 0.0..=1.0)?;
        check_range("alert_clear_s", self.alert_clear_s, 0.0..=3600.0)?;
        check_range("team_poor", self.team_poor, -1.0..=1.0)?;
        check_range("cut_off_parts", f64::from(self.cut_off_parts), 2.0..=1000.0)?;
        check_range("singleton", f64::from(self.singleton), 0.0..=1000.0)?;
        check_range("stale_share", self.stale_share, 0.0..=1.0)?;
        check_range("churn", self.churn, 0.0..=1000.0)?;
        check_range("fragile", self.fragile, 0.0..=1.0)
    }
}
