//! Checked names: robots, fleets, teams, modalities, service instances.
//!
//! All ids obey one rule, `[a-z0-9_-]{1,64}`, so that each may stand as one chunk of a key
//! expression, in a log line and in a file name without being escaped.

use std::borrow::Cow;
use std::fmt;
use std::sync::Arc;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::limits::MAX_ID_LENGTH;

/// Why a text is not an id.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum IdError {
    /// The text has no character.
    #[error("an id must have at least one character out of a-z 0-9 _ -")]
    Empty,
    /// The text has more than [`MAX_ID_LENGTH`] characters.
    #[error("an id may have at most {MAX_ID_LENGTH} characters, this has {0}")]
    TooLong(usize),
    /// The text has a character outside of `[a-z0-9_-]`.
    #[error("an id may hold only a-z 0-9 _ -, this holds {0:?}")]
    Character(char),
}

/// Checks the rule of all ids.
///
/// # Errors
/// Names the part of `[a-z0-9_-]{1,64}` the text breaks.
pub fn check_id(text: &str) -> Result<(), IdError> {
    if text.is_empty() {
        return Err(IdError::Empty);
    }
    if let Some(character) = text.chars().find(|c| !matches!(c, 'a'..='z' | '0'..='9' | '_' | '-'))
    {
        return Err(IdError::Character(character));
    }
    if text.len() > MAX_ID_LENGTH {
        return Err(IdError::TooLong(text.len()));
    }
    Ok(())
}

/// The rule of all ids as a regular expression. What it refuses stands there a second time, for
/// validators whose `$` lets a final line feed pass.
fn id_schema(title: &str, description: &str) -> Schema {
    json_schema!({
        "type": "string",
        "title": title,
        "description": description,
        "minLength": 1,
        "maxLength": MAX_ID_LENGTH,
        "pattern": format!("^[a-z0-9_-]{{1,{MAX_ID_LENGTH}}}$"),
        "not": { "pattern": "[^a-z0-9_-]" },
    })
}

macro_rules! id {
    ($doc:literal $name:ident) => {
        #[doc = $doc]
        #[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(Arc<str>);

        impl $name {
            /// Checks and wraps a text.
            ///
            /// # Errors
            /// Names the part of `[a-z0-9_-]{1,64}` the text breaks.
            pub fn new(text: impl AsRef<str>) -> Result<Self, IdError> {
                check_id(text.as_ref())?;
                Ok(Self(text.as_ref().into()))
            }

            /// The text of the id.
            #[must_use]
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str(&self.0)
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(formatter, "{:?}", &self.0)
            }
        }

        impl std::str::FromStr for $name {
            type Err = IdError;
            fn from_str(text: &str) -> Result<Self, IdError> {
                Self::new(text)
            }
        }

        impl Serialize for $name {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_str(&self.0)
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let text = String::deserialize(deserializer)?;
                Self::new(&text).map_err(serde::de::Error::custom)
            }
        }

        impl JsonSchema for $name {
            fn schema_name() -> Cow<'static, str> {
                stringify!($name).into()
            }

            fn json_schema(_: &mut SchemaGenerator) -> Schema {
                id_schema(stringify!($name), $doc)
            }
        }
    };
}

id!(
    "A robot."
    RobotId
);
id!(
    "A fleet: the robots and services that belong together on a bus."
    FleetId
);
id!(
    "A wish, among those of its operator."
    WishId
);
id!(
    "A proposal, among those of its operator."
    ProposalId
);
id!(
    "A team. It keeps its id for as long as it can be matched with itself."
    TeamId
);
id!(
    "One relation among the robots: `spatial`, `connectivity`, `hierarchy` or a declared one."
    Modality
);
id!(
    "One running process of a service."
    InstanceId
);
id!(
    "What a robot can do that not every robot can, such as `medic`."
    SkillId
);
id!(
    "A person, or a program in its place, who commands a fleet."
    OperatorId
);
id!(
    "A command, among those of its operator."
    CommandId
);

impl Modality {
    /// The modalities that every fleet has.
    pub const BUILT_IN: [&str; 3] = ["spatial", "connectivity", "hierarchy"];

    /// Where robots are.
    #[must_use]
    pub fn spatial() -> Self {
        Self("spatial".into())
    }

    /// Which robots receive which.
    #[must_use]
    pub fn connectivity() -> Self {
        Self("connectivity".into())
    }

    /// Which robots are superior to which.
    #[must_use]
    pub fn hierarchy() -> Self {
        Self("hierarchy".into())
    }

    /// Whether every fleet has this modality.
    #[must_use]
    pub fn is_built_in(&self) -> bool {
        Self::BUILT_IN.contains(&self.as_str())
    }
}

impl TeamId {
    /// The id of the n-th team that a fleet has ever had.
    #[must_use]
    pub fn numbered(number: u64) -> Self {
        Self(format!("t{number}").into())
    }
}

impl InstanceId {
    /// An id made of the name of a host, whatever characters it has, and numbers that distinguish its
    /// processes. It ends in a number, so that it is never `settings`, `status` or `holder`.
    #[must_use]
    pub fn of_process(host: &str, process: u32, nonce: u32) -> Self {
        let host = host.trim().to_lowercase();
        let plain = host.chars().map(|c| if matches!(c, 'a'..='z' | '0'..='9') { c } else { '-' });
        let host: String = plain.take(MAX_ID_LENGTH - 24).collect();
        Self(format!("{host}-{process}-{nonce}").trim_start_matches('-').into())
    }
}

/// The text names no service.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "no service is called {0:?}; there are ingest, embedder, clusterer, auditor, historian, planner"
)]
pub struct ServiceNameError(pub String);

/// The services of a fleet: four that turn observations into audited teams, one that records them, and one that says
/// what other settings would lead to.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum ServiceName {
    /// Robot streams to graphs.
    Ingest,
    /// Graphs to an embedding.
    Embedder,
    /// Embedding to teams.
    Clusterer,
    /// Teams to silhouettes.
    Auditor,
    /// All of it to a history.
    Historian,
    /// What the teams would be.
    Planner,
}

impl ServiceName {
    /// All services in the order of the data's path.
    pub const ALL: [Self; 6] = [
        Self::Ingest,
        Self::Embedder,
        Self::Clusterer,
        Self::Auditor,
        Self::Historian,
        Self::Planner,
    ];

    /// The services that turn observations into audited teams: those that every fleet needs.
    pub const PIPELINE: [Self; 4] = [Self::Ingest, Self::Embedder, Self::Clusterer, Self::Auditor];

    /// The name as it stands in keys and on the command line.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Ingest => "ingest",
            Self::Embedder => "embedder",
            Self::Clusterer => "clusterer",
            Self::Auditor => "auditor",
            Self::Historian => "historian",
            Self::Planner => "planner",
        }
    }
}

impl fmt::Display for ServiceName {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.as_str())
    }
}

impl std::str::FromStr for ServiceName {
    type Err = ServiceNameError;
    fn from_str(text: &str) -> Result<Self, ServiceNameError> {
        let named = Self::ALL.into_iter().find(|service| service.as_str() == text);
        named.ok_or_else(|| ServiceNameError(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_id_is_one_to_sixty_four_plain_characters() {
        assert!(RobotId::new("r1_a-z").is_ok());
        assert!(RobotId::new("a".repeat(64)).is_ok());
        assert_eq!(RobotId::new(""), Err(IdError::Empty));
        assert_eq!(RobotId::new("a".repeat(65)), Err(IdError::TooLong(65)));
        for bad in ["R1", "r/1", "r*", "r 1", "r$", "ä", "r\n", "@r", "r.1"] {
            assert!(matches!(RobotId::new(bad), Err(IdError::Character(_))), "{bad:?}");
        }
    }

    #[test]
    fn every_process_has_an_id() {
        for host in ["Robot.7", "", "ÄÖÜ/..\n", &"long".repeat(100)] {
            let id = InstanceId::of_process(host, u32::MAX, u32::MAX);
            assert_eq!(check_id(id.as_str()), Ok(()), "{id}");
        }
    }

    #[test]
    fn a_bad_id_does_not_deserialize() {
        assert!(serde_json::from_str::<RobotId>("\"r1\"").is_ok());
        assert!(serde_json::from_str::<RobotId>("\"R 1\"").is_err());
    }
}
