//! Where values come from, and which of several wins.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::Value;

use super::Mode;
use crate::exit::ExitError;

/// Largest configuration file in bytes.
const MAX_FILE: u64 = 1024 * 1024;

/// Where a value came from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Origin {
    /// Built in.
    Default,
    /// The configuration file.
    File(PathBuf),
    /// An environment variable.
    Environment(String),
    /// A flag.
    Flag,
}

impl fmt::Display for Origin {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Default => formatter.write_str("default"),
            Self::File(path) => write!(formatter, "file {}", path.display()),
            Self::Environment(name) => write!(formatter, "environment {name}"),
            Self::Flag => formatter.write_str("flag"),
        }
    }
}

/// A value and where it came from.
#[derive(Debug, Clone)]
pub struct Sourced<T> {
    /// The value.
    pub value: T,
    /// Where it came from.
    pub origin: Origin,
}

/// The configuration file.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    pub(super) fleet: Option<String>,
    pub(super) connect: Option<Vec<String>>,
    pub(super) listen: Option<Vec<String>>,
    pub(super) mode: Option<Mode>,
    pub(super) zenoh_config: Option<PathBuf>,
    pub(super) state_directory: Option<PathBuf>,
    pub(super) log: Option<String>,
    pub(super) log_json: Option<bool>,
    pub(super) ingest: Option<Value>,
    pub(super) embedder: Option<Value>,
    pub(super) clusterer: Option<Value>,
    pub(super) auditor: Option<Value>,
}

/// Where environment variables are read: the process's own, or a test's.
pub type Environment<'a> = &'a dyn Fn(&str) -> Option<String>;

/// The environment of this process.
#[must_use]
pub fn process_environment(name: &str) -> Option<String> {
    std::env::var(name).ok().filter(|value| !value.is_empty())
}

pub(super) struct Layers<'a> {
    pub(super) environment: Environment<'a>,
    pub(super) file: Option<PathBuf>,
}

impl Layers<'_> {
    pub(super) fn pick<T>(
        &self,
        flag: Option<T>,
        variable: &str,
        parse: impl Fn(&str) -> Result<T, String>,
        file: Option<T>,
        default: T,
    ) -> Result<Sourced<T>, ExitError> {
        if let Some(value) = flag {
            return Ok(Sourced { value, origin: Origin::Flag });
        }
        if let Some(text) = (self.environment)(variable) {
            let value = parse(&text)
                .map_err(|problem| ExitError::usage(format!("{variable}: {problem}")))?;
            return Ok(Sourced { value, origin: Origin::Environment(variable.to_owned()) });
        }
        match (file, &self.file) {
            (Some(value), Some(path)) => Ok(Sourced { value, origin: Origin::File(path.clone()) }),
            _ => Ok(Sourced { value: default, origin: Origin::Default }),
        }
    }
}

pub(super) fn read_file(path: &Path) -> Result<File, ExitError> {
    let name = path.display();
    let fail = |problem: String| ExitError::usage(format!("config {name}: {problem}"));
    let size = std::fs::metadata(path).map_err(|error| fail(error.to_string()))?.len();
    if size > MAX_FILE {
        return Err(fail(format!("{size} bytes are more than the limit of {MAX_FILE}")));
    }
    let text = std::fs::read_to_string(path).map_err(|error| fail(error.to_string()))?;
    toml::from_str(&text).map_err(|error| fail(error.to_string()))
}

pub(super) fn split(text: &str) -> Vec<String> {
    text.split(',').map(|part| part.trim().to_owned()).filter(|part| !part.is_empty()).collect()
}

pub(super) fn default_state_directory(environment: Environment<'_>) -> Option<PathBuf> {
    let under = |variable: &str, tail: &str| {
        environment(variable).map(|directory| PathBuf::from(directory).join(tail))
    };
    under("XDG_STATE_HOME", "muster").or_else(|| under("HOME", ".local/state/muster"))
}
