//! How many robots a team has.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{SettingsError, check_range};
use crate::limits::MAX_TEAM_SIZE;

/// How many robots a team has. What is left out is no limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TeamSize {
    /// Least number of robots.
    #[serde(default)]
    #[schemars(range(min = 0, max = MAX_TEAM_SIZE))]
    pub min: Option<u32>,
    /// Most robots.
    #[serde(default)]
    #[schemars(range(min = 1, max = MAX_TEAM_SIZE))]
    pub max: Option<u32>,
}

impl TeamSize {
    /// Whether it limits nothing.
    #[must_use]
    pub fn is_open(self) -> bool {
        self.least() == 0 && self.max.is_none()
    }

    /// Least number of robots, 0 without a limit.
    #[must_use]
    pub fn least(self) -> u32 {
        self.min.unwrap_or(0)
    }

    /// These limits, and those of another where it has none.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        Self { min: self.min.or(other.min), max: self.max.or(other.max) }
    }

    /// Checks the limits of a field, with those that hold where it has none.
    ///
    /// # Errors
    /// Names `min` or `max` of the field.
    pub(super) fn check(self, field: &str, other: Self) -> Result<(), SettingsError> {
        let most = f64::from(MAX_TEAM_SIZE);
        if let Some(min) = self.min {
            check_range(&format!("{field}.min"), f64::from(min), 0.0..=most)?;
        }
        if let Some(max) = self.max {
            check_range(&format!("{field}.max"), f64::from(max), 1.0..=most)?;
        }
        let whole = self.or(other);
        if let Some(max) = whole.max.filter(|max| *max < whole.least()) {
            let problem =
                format!("must be at least the least number, {}, not {max}", whole.least());
            return Err(SettingsError::new(format!("{field}.max"), problem));
        }
        Ok(())
    }
}
