//! The configuration of a process: defaults, then file, then environment, then flags.
//!
//! Every value remembers where it came from, so that `--print-config` can tell. Unknown keys are
//! errors at every level. One file may serve all services of a host: each reads the table of its own
//! name, and `--check-config` checks them all.

use std::fmt::{self, Write as _};
use std::path::{Path, PathBuf};

use muster_model::id::{FleetId, InstanceId, ServiceName};
use muster_model::settings::{
    AuditorSettings, ClustererSettings, EmbedderSettings, IngestSettings, Settings, SettingsError,
};
use muster_wire::key::is_free_instance_name;
use serde::Deserialize;
use serde_json::{Map, Value};

use crate::bus::check_endpoint;
use crate::exit::ExitError;

/// The fleet of a process that is told of none.
const DEFAULT_FLEET: &str = "default";

/// Where the router of this host listens, by the custom of Zenoh.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// Largest configuration file in bytes.
const MAX_FILE: u64 = 1024 * 1024;

/// How a process takes part in the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// Through a router: what robots and services are.
    Client,
    /// With direct links to other peers. Peers do not relay for each other.
    Peer,
    /// Relays for all others.
    Router,
}

impl fmt::Display for Mode {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Client => "client",
            Self::Peer => "peer",
            Self::Router => "router",
        })
    }
}

/// The flags that every program takes.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(
    next_help_heading = "Process options (also as MUSTER_… in the environment and in --config)"
)]
pub struct ProcessArgs {
    /// The fleet: robots and services of other fleets on the same bus are not seen [MUSTER_FLEET]
    #[arg(long, global = true, value_name = "NAME")]
    pub fleet: Option<String>,
    /// Router to connect to, several with commas: the first that answers is used [MUSTER_CONNECT]
    #[arg(long, global = true, value_name = "ENDPOINT", value_delimiter = ',')]
    pub connect: Option<Vec<String>>,
    /// Where to listen, several with commas [MUSTER_LISTEN]
    #[arg(long, global = true, value_name = "ENDPOINT", value_delimiter = ',')]
    pub listen: Option<Vec<String>>,
    /// How to take part in the bus [MUSTER_MODE]
    #[arg(long, global = true, value_name = "MODE")]
    pub mode: Option<Mode>,
    /// Zenoh's own configuration in JSON5, for everything else [MUSTER_ZENOH_CONFIG]
    #[arg(long, global = true, value_name = "FILE")]
    pub zenoh_config: Option<PathBuf>,
    /// Configuration file in TOML [MUSTER_CONFIG]
    #[arg(long, global = true, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Where settings are kept over a restart; "none" for nowhere [STATE_DIRECTORY]
    #[arg(long, global = true, value_name = "DIRECTORY")]
    pub state_directory: Option<PathBuf>,
    /// What is logged to standard error, such as info or warn,muster=debug [MUSTER_LOG]
    #[arg(long, global = true, value_name = "FILTER")]
    pub log: Option<String>,
    /// Log JSON lines [MUSTER_LOG_JSON=true]
    #[arg(long, global = true)]
    pub log_json: bool,
    /// Check the configuration and end
    #[arg(long, global = true)]
    pub check_config: bool,
    /// Print the configuration with the origin of each value, and end
    #[arg(long, global = true)]
    pub print_config: bool,
}

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

/// The configuration of a process.
#[derive(Debug, Clone)]
pub struct ProcessConfig {
    /// The fleet.
    pub fleet: Sourced<FleetId>,
    /// Routers to connect to.
    pub connect: Sourced<Vec<String>>,
    /// Where to listen.
    pub listen: Sourced<Vec<String>>,
    /// How to take part in the bus.
    pub mode: Sourced<Mode>,
    /// Zenoh's own configuration.
    pub zenoh_config: Sourced<Option<PathBuf>>,
    /// Where settings are kept.
    pub state_directory: Sourced<Option<PathBuf>>,
    /// What is logged.
    pub log: Sourced<Option<String>>,
    /// Whether logs are JSON lines.
    pub log_json: Sourced<bool>,
    patches: Vec<(ServiceName, Origin, Value)>,
}

/// The configuration file.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    fleet: Option<String>,
    connect: Option<Vec<String>>,
    listen: Option<Vec<String>>,
    mode: Option<Mode>,
    zenoh_config: Option<PathBuf>,
    state_directory: Option<PathBuf>,
    log: Option<String>,
    log_json: Option<bool>,
    ingest: Option<Value>,
    embedder: Option<Value>,
    clusterer: Option<Value>,
    auditor: Option<Value>,
}

/// Where environment variables are read: the process's own, or a test's.
pub type Environment<'a> = &'a dyn Fn(&str) -> Option<String>;

/// The environment of this process.
#[must_use]
pub fn process_environment(name: &str) -> Option<String> {
    std::env::var(name).ok().filter(|value| !value.is_empty())
}

struct Layers<'a> {
    environment: Environment<'a>,
    file: Option<PathBuf>,
}

impl Layers<'_> {
    fn pick<T>(
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

fn read_file(path: &Path) -> Result<File, ExitError> {
    let name = path.display();
    let fail = |problem: String| ExitError::usage(format!("config {name}: {problem}"));
    let size = std::fs::metadata(path).map_err(|error| fail(error.to_string()))?.len();
    if size > MAX_FILE {
        return Err(fail(format!("{size} bytes are more than the limit of {MAX_FILE}")));
    }
    let text = std::fs::read_to_string(path).map_err(|error| fail(error.to_string()))?;
    toml::from_str(&text).map_err(|error| fail(error.to_string()))
}

fn split(text: &str) -> Vec<String> {
    text.split(',').map(|part| part.trim().to_owned()).filter(|part| !part.is_empty()).collect()
}

fn default_state_directory(environment: Environment<'_>) -> Option<PathBuf> {
    let under = |variable: &str, tail: &str| {
        environment(variable).map(|directory| PathBuf::from(directory).join(tail))
    };
    under("XDG_STATE_HOME", "muster").or_else(|| under("HOME", ".local/state/muster"))
}

impl ProcessConfig {
    /// Puts the layers together.
    ///
    /// # Errors
    /// Names the field, variable or file that is wrong, and the remedy.
    pub fn resolve(
        args: &ProcessArgs,
        default_mode: Mode,
        environment: Environment<'_>,
    ) -> Result<Self, ExitError> {
        let path = args.config.clone().or_else(|| environment("MUSTER_CONFIG").map(PathBuf::from));
        let file = path.as_deref().map(read_file).transpose()?.unwrap_or_default();
        let layers = Layers { environment, file: path.clone() };
        let text = |text: &str| Ok(text.to_owned());
        let paths = |text: &str| Ok(Some(PathBuf::from(text)));
        let lists = |text: &str| Ok(split(text));

        let fleet = layers.pick(
            args.fleet.clone(),
            "MUSTER_FLEET",
            text,
            file.fleet,
            DEFAULT_FLEET.to_owned(),
        )?;
        let fleet = Sourced {
            value: FleetId::new(&fleet.value)
                .map_err(|error| ExitError::usage(format!("fleet: {error}")))?,
            origin: fleet.origin,
        };
        let mode = layers.pick(
            args.mode,
            "MUSTER_MODE",
            |text| clap::ValueEnum::from_str(text, false),
            file.mode,
            default_mode,
        )?;
        let default_connect = match mode.value {
            Mode::Router => Vec::new(),
            Mode::Client | Mode::Peer => vec![DEFAULT_ENDPOINT.to_owned()],
        };
        let default_listen = match mode.value {
            Mode::Router => vec![DEFAULT_ENDPOINT.to_owned()],
            Mode::Client | Mode::Peer => Vec::new(),
        };
        let connect = layers.pick(
            args.connect.clone(),
            "MUSTER_CONNECT",
            lists,
            file.connect,
            default_connect,
        )?;
        let listen = layers.pick(
            args.listen.clone(),
            "MUSTER_LISTEN",
            lists,
            file.listen,
            default_listen,
        )?;
        for (field, endpoints) in [("connect", &connect.value), ("listen", &listen.value)] {
            for endpoint in endpoints {
                check_endpoint(endpoint)
                    .map_err(|problem| ExitError::usage(format!("{field}: {problem}")))?;
            }
        }
        let zenoh_config = layers.pick(
            args.zenoh_config.clone().map(Some),
            "MUSTER_ZENOH_CONFIG",
            paths,
            file.zenoh_config.map(Some),
            None,
        )?;
        let mut state_directory = layers.pick(
            args.state_directory.clone().map(Some),
            "STATE_DIRECTORY",
            // A service manager may name several directories with colons; the first is ours.
            |text| Ok(text.split(':').next().map(PathBuf::from)),
            file.state_directory.map(Some),
            default_state_directory(environment),
        )?;
        state_directory.value.take_if(|directory| directory.as_os_str() == "none");
        let log = layers.pick(
            args.log.clone().map(Some),
            "MUSTER_LOG",
            |text| Ok(Some(text.to_owned())),
            file.log.map(Some),
            None,
        )?;
        let log_json = layers.pick(
            args.log_json.then_some(true),
            "MUSTER_LOG_JSON",
            |text| text.parse().map_err(|_| "must be true or false".to_owned()),
            file.log_json,
            false,
        )?;

        let mut patches = Vec::new();
        let tables = [
            (ServiceName::Ingest, file.ingest),
            (ServiceName::Embedder, file.embedder),
            (ServiceName::Clusterer, file.clusterer),
            (ServiceName::Auditor, file.auditor),
        ];
        for (service, table) in tables {
            if let (Some(table), Some(path)) = (table, &path) {
                patches.push((service, Origin::File(path.clone()), table));
            }
            let variable = format!("MUSTER_{}", service.as_str().to_uppercase());
            if let Some(text) = environment(&variable) {
                let patch = serde_json::from_str(&text).map_err(|error| {
                    ExitError::usage(format!("{variable}: must be a JSON object: {error}"))
                })?;
                patches.push((service, Origin::Environment(variable), patch));
            }
        }
        let config = Self {
            fleet,
            connect,
            listen,
            mode,
            zenoh_config,
            state_directory,
            log,
            log_json,
            patches,
        };
        config.check_all_settings()?;
        Ok(config)
    }

    fn check_all_settings(&self) -> Result<(), ExitError> {
        self.settings::<IngestSettings>(ServiceName::Ingest)?;
        self.settings::<EmbedderSettings>(ServiceName::Embedder)?;
        self.settings::<ClustererSettings>(ServiceName::Clusterer)?;
        self.settings::<AuditorSettings>(ServiceName::Auditor)?;
        Ok(())
    }

    /// The configuration of a router in the same process.
    #[must_use]
    pub fn as_router(&self, listen: Vec<String>) -> Self {
        self.as_mode(Mode::Router, Vec::new(), listen)
    }

    /// The configuration of a client of a router in the same process.
    #[must_use]
    pub fn as_client(&self, connect: Vec<String>) -> Self {
        self.as_mode(Mode::Client, connect, Vec::new())
    }

    fn as_mode(&self, mode: Mode, connect: Vec<String>, listen: Vec<String>) -> Self {
        Self {
            mode: Sourced { value: mode, origin: Origin::Flag },
            connect: Sourced { value: connect, origin: Origin::Flag },
            listen: Sourced { value: listen, origin: Origin::Flag },
            ..self.clone()
        }
    }

    /// Adds `--set` flags to the settings of a service.
    ///
    /// # Errors
    /// Names the field that is wrong.
    pub fn set(&mut self, service: ServiceName, assignments: &[String]) -> Result<(), ExitError> {
        if !assignments.is_empty() {
            let patch = parse_assignments(assignments)
                .map_err(|error| ExitError::usage(format!("--set {error}")))?;
            self.patches.push((service, Origin::Flag, patch));
        }
        self.check_all_settings()
    }

    /// The settings of a service by defaults, file, environment and flags.
    ///
    /// # Errors
    /// Names the field that is wrong, and where it stands.
    pub fn settings<S: Settings>(&self, service: ServiceName) -> Result<S, ExitError> {
        let mut settings = S::default();
        for (_, origin, patch) in self.patches.iter().filter(|(of, ..)| *of == service) {
            settings = settings.patched(patch).map_err(|SettingsError { field, problem }| {
                ExitError::usage(format!("{service}.{field} ({origin}): {problem}"))
            })?;
        }
        Ok(settings)
    }

    /// The configuration as TOML, each value with its origin.
    ///
    /// # Errors
    /// If settings do not hold together.
    pub fn print(&self, services: &[ServiceName]) -> Result<String, ExitError> {
        let mut text = String::new();
        let mut line = |name: &str, value: Value, origin: &Origin| {
            let value = toml_value(&value);
            // Writing to a string does not fail.
            let _ = match value {
                Some(value) => writeln!(text, "{name} = {value}  # {origin}"),
                None => writeln!(text, "# {name} is not set  # {origin}"),
            };
        };
        let path = |path: &Option<PathBuf>| {
            path.as_ref().map_or(Value::Null, |path| path.display().to_string().into())
        };
        line("fleet", self.fleet.value.as_str().into(), &self.fleet.origin);
        line("connect", self.connect.value.clone().into(), &self.connect.origin);
        line("listen", self.listen.value.clone().into(), &self.listen.origin);
        line("mode", self.mode.value.to_string().into(), &self.mode.origin);
        line("zenoh_config", path(&self.zenoh_config.value), &self.zenoh_config.origin);
        line("state_directory", path(&self.state_directory.value), &self.state_directory.origin);
        line("log", self.log.value.clone().into(), &self.log.origin);
        line("log_json", self.log_json.value.into(), &self.log_json.origin);
        for service in services {
            let settings = match service {
                ServiceName::Ingest => to_value(&self.settings::<IngestSettings>(*service)?),
                ServiceName::Embedder => to_value(&self.settings::<EmbedderSettings>(*service)?),
                ServiceName::Clusterer => to_value(&self.settings::<ClustererSettings>(*service)?),
                ServiceName::Auditor => to_value(&self.settings::<AuditorSettings>(*service)?),
            };
            let _ = write!(text, "\n[{service}]\n");
            self.print_table(&mut text, *service, &settings, "");
        }
        Ok(text)
    }

    fn print_table(
        &self,
        text: &mut String,
        service: ServiceName,
        table: &Map<String, Value>,
        path: &str,
    ) {
        for (name, value) in table {
            let field = format!("{path}{name}");
            match value {
                Value::Object(inner) if inner.len() > 1 => {
                    self.print_table(text, service, inner, &format!("{field}."));
                }
                _ => {
                    let origin = self.origin(service, &field);
                    let _ = match toml_value(value) {
                        Some(value) => writeln!(text, "{field} = {value}  # {origin}"),
                        None => writeln!(text, "# {field} is not set  # {origin}"),
                    };
                }
            }
        }
    }

    fn origin(&self, service: ServiceName, field: &str) -> Origin {
        let pointer = format!("/{}", field.replace('.', "/"));
        self.patches
            .iter()
            .rev()
            .find(|(of, _, patch)| *of == service && patch.pointer(&pointer).is_some())
            .map_or(Origin::Default, |(_, origin, _)| origin.clone())
    }
}

fn to_value<S: Settings>(settings: &S) -> Map<String, Value> {
    match serde_json::to_value(settings) {
        Ok(Value::Object(map)) => map,
        _ => Map::new(),
    }
}

/// A value as it stands in TOML on one line; none for null, which TOML does not have.
fn toml_value(value: &Value) -> Option<String> {
    if value.is_null() {
        return None;
    }
    toml::Value::try_from(value).ok().map(|value| value.to_string())
}

/// Reads `field=value` pairs, with dots for nested fields, into a patch. A value is JSON where it can
/// be read as such, and a text otherwise.
///
/// # Errors
/// Names the pair that has no `=`.
pub fn parse_assignments(assignments: &[String]) -> Result<Value, String> {
    let mut patch = Map::new();
    for assignment in assignments {
        let Some((path, text)) = assignment.split_once('=') else {
            return Err(format!("{assignment:?}: must be FIELD=VALUE, such as teams=3"));
        };
        let value = serde_json::from_str(text).unwrap_or_else(|_| Value::String(text.to_owned()));
        let mut chunks: Vec<&str> = path.trim().split('.').collect();
        let last = chunks.pop().unwrap_or_default();
        let mut table = &mut patch;
        for chunk in chunks {
            let inner = table.entry(chunk).or_insert_with(|| Value::Object(Map::new()));
            let Value::Object(inner) = inner else {
                return Err(format!("{path}: is named as a value and as a table"));
            };
            table = inner;
        }
        table.insert(last.to_owned(), value);
    }
    Ok(Value::Object(patch))
}

/// The name of this process among the instances of its service: host and process id.
#[must_use]
pub fn instance_name() -> InstanceId {
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let host: String = host
        .trim()
        .to_lowercase()
        .chars()
        .map(|c| if matches!(c, 'a'..='z' | '0'..='9' | '-' | '_') { c } else { '-' })
        .take(40)
        .collect();
    let nonce = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0, |time| time.subsec_micros());
    let name = format!("{host}-{}-{nonce}", std::process::id());
    let name = InstanceId::new(name.trim_start_matches('-')).ok().filter(is_free_instance_name);
    // The form above always is an id; a constant keeps the function free of panics.
    name.unwrap_or_else(fallback_instance)
}

fn fallback_instance() -> InstanceId {
    match InstanceId::new("instance") {
        Ok(id) => id,
        Err(_) => unreachable!("a constant id"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn none(_: &str) -> Option<String> {
        None
    }

    fn resolve(args: &ProcessArgs, environment: Environment<'_>) -> Result<ProcessConfig, String> {
        ProcessConfig::resolve(args, Mode::Client, environment).map_err(|error| error.message)
    }

    fn with_file(text: &str) -> (tempfile::TempDir, ProcessArgs) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("muster.toml");
        std::fs::write(&path, text).unwrap();
        (directory, ProcessArgs { config: Some(path), ..ProcessArgs::default() })
    }

    #[test]
    fn flags_beat_environment_beats_file_beats_default() {
        let (_directory, args) = with_file("fleet = \"from-file\"\n[clusterer]\nteams = 3\n");
        let config = resolve(&args, &none).unwrap();
        assert_eq!(config.fleet.value.as_str(), "from-file");
        let teams = |config: &ProcessConfig| {
            config.settings::<ClustererSettings>(ServiceName::Clusterer).unwrap().teams
        };
        assert_eq!(teams(&config), 3);
        let environment = |name: &str| match name {
            "MUSTER_FLEET" => Some("from-env".to_owned()),
            "MUSTER_CLUSTERER" => Some("{\"teams\": 4}".to_owned()),
            _ => None,
        };
        let mut config = resolve(&args, &environment).unwrap();
        assert_eq!(config.fleet.value.as_str(), "from-env");
        assert_eq!(teams(&config), 4);
        config.set(ServiceName::Clusterer, &["teams=5".to_owned()]).unwrap();
        assert_eq!(teams(&config), 5);
        let args = ProcessArgs { fleet: Some("from-flag".to_owned()), ..args };
        assert_eq!(resolve(&args, &environment).unwrap().fleet.origin, Origin::Flag);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let problem = |text: &str| resolve(&with_file(text).1, &none).unwrap_err();
        let with = |text: &str| {
            let (_directory, args) = with_file(text);
            resolve(&args, &none).unwrap_err()
        };
        assert!(with("flet = 1").contains("flet"));
        assert!(with("[clusterer]\nteams = 0").contains("clusterer.teams"));
        assert!(with("[clusterer]\nteam = 1").contains("clusterer.team"));
        assert!(with("connect = [\"localhost\"]").contains("connect"));
        assert!(with("fleet = \"A b\"").contains("fleet"));
        assert!(with("mode = \"boss\"").contains("mode"));
        assert!(problem("fleet = ").contains("muster.toml"));
        let absent = ProcessArgs { config: Some("/nowhere.toml".into()), ..ProcessArgs::default() };
        assert!(resolve(&absent, &none).unwrap_err().contains("nowhere"));
    }

    #[test]
    fn what_is_printed_is_accepted_again() {
        let (_directory, args) = with_file("[ingest]\nspatial = { width = 3.0 }\n");
        let text = resolve(&args, &none).unwrap().print(&ServiceName::ALL).unwrap();
        assert!(text.contains("spatial.width = 3.0  # file"), "{text}");
        assert!(text.contains("teams = 2  # default"), "{text}");
        let (_directory, args) = with_file(&text);
        resolve(&args, &none).unwrap();
    }

    #[test]
    fn assignments_become_a_patch() {
        let parse = |text: &str| parse_assignments(&[text.to_owned()]);
        assert_eq!(parse("teams=3").unwrap(), serde_json::json!({"teams": 3}));
        assert_eq!(parse("init=random").unwrap(), serde_json::json!({"init": "random"}));
        assert_eq!(parse("a.b={\"c\":1}").unwrap(), serde_json::json!({"a": {"b": {"c": 1}}}));
        assert!(parse("teams").is_err());
    }

    #[test]
    fn this_process_has_an_instance_name() {
        assert!(instance_name().as_str().contains(&std::process::id().to_string()));
    }
}
