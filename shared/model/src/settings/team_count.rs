//! How many teams are wanted: a number, a range, or as many as the relations show.

use std::borrow::Cow;
use std::fmt;
use std::ops::RangeInclusive;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{SettingsError, check_range};
use crate::limits::{MAX_AUTO_TEAMS, MAX_RANGE_TEAMS, MAX_TEAMS};

/// What [`TeamCount`] must be.
const EXPECTED: &str = "\"auto\", a whole number, or {\"from\": number, \"to\": number}";

/// How many teams the fleet is divided into.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TeamCount {
    /// So many.
    Fixed(u32),
    /// As many within a range as the relations of the robots show.
    Between {
        /// The least number.
        from: u32,
        /// The largest number.
        to: u32,
    },
    /// As many as the relations of the robots show, from 1 to [`MAX_AUTO_TEAMS`].
    Auto,
}

impl TeamCount {
    /// The numbers that are possible.
    #[must_use]
    pub fn range(self) -> RangeInclusive<u32> {
        match self {
            Self::Fixed(teams) => teams..=teams,
            Self::Between { from, to } => from..=to,
            Self::Auto => 1..=MAX_AUTO_TEAMS,
        }
    }

    /// The number, if it does not depend on the fleet.
    #[must_use]
    pub fn fixed(self) -> Option<u32> {
        match self {
            Self::Fixed(teams) => Some(teams),
            Self::Between { .. } | Self::Auto => None,
        }
    }

    /// Checks the bounds.
    ///
    /// # Errors
    /// Names `teams`, `teams.from` or `teams.to`.
    pub fn check(self) -> Result<(), SettingsError> {
        match self {
            Self::Fixed(teams) => {
                check_range("teams", f64::from(teams), 1.0..=f64::from(MAX_TEAMS))
            }
            Self::Between { from, to } => {
                let bounds = 1.0..=f64::from(MAX_RANGE_TEAMS);
                check_range("teams.from", f64::from(from), bounds.clone())?;
                check_range("teams.to", f64::from(to), bounds)?;
                if from > to {
                    let problem = format!("must be at least teams.from, which is {from}, not {to}");
                    return Err(SettingsError::new("teams.to", problem));
                }
                Ok(())
            }
            Self::Auto => Ok(()),
        }
    }
}

impl From<usize> for TeamCount {
    /// So many teams; more than 32 bits hold count as the largest number.
    fn from(teams: usize) -> Self {
        Self::Fixed(u32::try_from(teams).unwrap_or(u32::MAX))
    }
}

impl fmt::Display for TeamCount {
    /// `auto`, `3` or `2..6`.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fixed(teams) => write!(formatter, "{teams}"),
            Self::Between { from, to } => write!(formatter, "{from}..{to}"),
            Self::Auto => formatter.write_str("auto"),
        }
    }
}

/// The bounds of a range, as they are written.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Bounds {
    from: u32,
    to: u32,
}

impl Serialize for TeamCount {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match *self {
            Self::Fixed(teams) => serializer.serialize_u32(teams),
            Self::Between { from, to } => Bounds { from, to }.serialize(serializer),
            Self::Auto => serializer.serialize_str("auto"),
        }
    }
}

impl<'de> Deserialize<'de> for TeamCount {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Form;

        // An untagged enum would lose which bound of a range is wrong.
        impl<'de> Visitor<'de> for Form {
            type Value = TeamCount;

            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str(EXPECTED)
            }

            fn visit_str<E: Error>(self, word: &str) -> Result<TeamCount, E> {
                match word {
                    "auto" => Ok(TeamCount::Auto),
                    _ => Err(E::custom(format!("must be {EXPECTED}"))),
                }
            }

            fn visit_u64<E: Error>(self, teams: u64) -> Result<TeamCount, E> {
                let number = u32::try_from(teams);
                let number =
                    number.map_err(|_| E::invalid_value(Unexpected::Unsigned(teams), &self));
                number.map(TeamCount::Fixed)
            }

            fn visit_i64<E: Error>(self, teams: i64) -> Result<TeamCount, E> {
                let number = u32::try_from(teams);
                let number = number.map_err(|_| E::invalid_value(Unexpected::Signed(teams), &self));
                number.map(TeamCount::Fixed)
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<TeamCount, A::Error> {
                let Bounds { from, to } = Bounds::deserialize(MapAccessDeserializer::new(map))?;
                Ok(TeamCount::Between { from, to })
            }
        }

        deserializer.deserialize_any(Form)
    }
}

impl JsonSchema for TeamCount {
    fn schema_name() -> Cow<'static, str> {
        "TeamCount".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let bound = |description: &str| {
            json_schema!({
                "description": description,
                "type": "integer", "minimum": 1, "maximum": MAX_RANGE_TEAMS,
            })
        };
        json_schema!({
            "description": format!(
                "How many teams: a number, a range, of which the number is chosen by the relations of \
                 the robots, or \"auto\", which is a range from 1 to {MAX_AUTO_TEAMS}."
            ),
            "anyOf": [
                { "const": "auto" },
                { "type": "integer", "minimum": 1, "maximum": MAX_TEAMS },
                {
                    "type": "object",
                    "properties": {
                        "from": bound("The least number of teams."),
                        "to": bound("The largest number of teams, at least `from`."),
                    },
                    "required": ["from", "to"],
                    "additionalProperties": false,
                },
            ],
        })
    }
}
