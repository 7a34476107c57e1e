//! Where values come from, and which of several wins.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::Value;

use super::Mode;
use crate::exit::ExitError;
use crate::store::read_at_most;

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
    pub(super) http: Option<String>,
    pub(super) ingest: Option<toml::Table>,
    pub(super) embedder: Option<toml::Table>,
    pub(super) clusterer: Option<toml::Table>,
    pub(super) auditor: Option<toml::Table>,
    pub(super) historian: Option<toml::Table>,
    pub(super) planner: Option<toml::Table>,
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

    /// A value that has no default.
    pub(super) fn pick_optional<T>(
        &self,
        flag: Option<T>,
        variable: &str,
        parse: impl Fn(&str) -> Result<T, String>,
        file: Option<T>,
    ) -> Result<Sourced<Option<T>>, ExitError> {
        let parse = |text: &str| parse(text).map(Some);
        self.pick(flag.map(Some), variable, parse, file.map(Some), None)
    }
}

pub(super) fn read_file(path: &Path) -> Result<File, ExitError> {
    let name = path.display();
    let fail = |problem: String| ExitError::usage(format!("config {name}: {problem}"));
    let bytes = read_at_most(path, MAX_FILE).map_err(|error| fail(error.to_string()))?;
    let text = String::from_utf8(bytes).map_err(|error| fail(error.to_string()))?;
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

/// A table of the file as a patch of settings. TOML knows numbers that JSON does not; those are no
/// settings, and must not pass for fields that are left out.
///
/// # Errors
/// Names the field that is not finite.
pub(super) fn patch_of(table: toml::Table) -> Result<Value, String> {
    fn check(value: &toml::Value, path: &str) -> Result<(), String> {
        match value {
            toml::Value::Float(number) if !number.is_finite() => {
                Err(format!("{path}: must be a finite number"))
            }
            toml::Value::Table(table) => table.iter().try_for_each(|(name, value)| {
                let dot = if path.is_empty() { "" } else { "." };
                check(value, &format!("{path}{dot}{name}"))
            }),
            toml::Value::Array(values) => values.iter().try_for_each(|value| check(value, path)),
            _ => Ok(()),
        }
    }
    let table = toml::Value::Table(table);
    check(&table, "")?;
    serde_json::to_value(&table).map_err(|error| error.to_string())
}
