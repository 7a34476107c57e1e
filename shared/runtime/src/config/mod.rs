//! The configuration of a process: defaults, then file, then environment, then flags.
//!
//! Every value remembers where it came from, which `--print-config` shows. Unknown keys are
//! errors at every level. One file may serve all services of a host: each reads the table of its own
//! name, and `--check-config` checks them all.

mod args;
mod assignments;
mod layers;
mod print;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use muster_model::id::{FleetId, ServiceName};
use muster_model::settings::{
    AuditorSettings, ClustererSettings, EmbedderSettings, HistorianSettings, IngestSettings,
    PlannerSettings, Settings, SettingsError,
};
use serde_json::Value;

pub use self::args::{Mode, ProcessArgs};
pub use self::assignments::{AssignmentError, parse_assignments};
pub use self::layers::{Environment, Origin, Sourced, process_environment};
use self::layers::{Layers, default_state_directory, patch_of, read_file, split};

pub use crate::bus::config::DEFAULT_ENDPOINT;
use crate::bus::config::{Choice, DEFAULT_FLEET};
use crate::bus::{self, BusConfig, check_endpoint, check_zenoh_config};
use crate::exit::ExitError;
use crate::recording::RecordTo;

/// Longest error in characters: the line of a file that is wrong fits, unless it is absurd.
const MAX_MESSAGE: usize = 1000;

/// An error with the text of a file or variable in it, made fit for a terminal: short, and without
/// control characters but the line feeds of a text that points at a place.
fn plain(error: ExitError) -> ExitError {
    let fit = |c: char| if c.is_control() && c != '\n' { '\u{FFFD}' } else { c };
    let message = error.message.chars().take(MAX_MESSAGE).map(fit).collect();
    ExitError { message, ..error }
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
    /// Where services are recorded. By a flag alone: no file is to fill a disk unnoticed.
    pub record: Option<RecordTo>,
    /// Where health, readiness and metrics are served.
    pub http: Sourced<Option<SocketAddr>>,
    patches: Vec<(ServiceName, Origin, Value)>,
}

impl From<&ProcessConfig> for BusConfig {
    fn from(config: &ProcessConfig) -> Self {
        fn choice<T: Clone>(sourced: &Sourced<T>) -> Choice<T> {
            let chosen = sourced.origin != Origin::Default;
            Choice { value: sourced.value.clone(), chosen }
        }
        let mode = match config.mode.value {
            Mode::Client => bus::Mode::Client,
            Mode::Peer => bus::Mode::Peer,
            Mode::Router => bus::Mode::Router,
        };
        Self {
            fleet: config.fleet.value.clone(),
            mode: Choice { value: mode, chosen: config.mode.origin != Origin::Default },
            connect: choice(&config.connect),
            listen: choice(&config.listen),
            zenoh_config: config.zenoh_config.value.clone(),
            gossip: false,
            lease: bus::config::LEASE,
        }
    }
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
        Self::layered(args, default_mode, environment).map_err(plain)
    }

    fn layered(
        args: &ProcessArgs,
        default_mode: Mode,
        environment: Environment<'_>,
    ) -> Result<Self, ExitError> {
        let path = args.config.clone().or_else(|| environment("MUSTER_CONFIG").map(PathBuf::from));
        let file = path.as_deref().map(read_file).transpose()?.unwrap_or_default();
        let layers = Layers { environment, file: path.clone() };
        let flag = args.clone();
        let text = |text: &str| Ok(text.to_owned());
        let path_of = |text: &str| Ok(PathBuf::from(text));
        let list = |text: &str| Ok(split(text));
        let switch = |text: &str| text.parse().map_err(|_| "must be true or false".to_owned());
        let mode = |text: &str| clap::ValueEnum::from_str(text, false);

        let default_fleet = DEFAULT_FLEET.to_owned();
        let fleet = layers.pick(flag.fleet, "MUSTER_FLEET", text, file.fleet, default_fleet)?;
        let value = FleetId::new(&fleet.value)
            .map_err(|error| ExitError::usage(format!("fleet: {error}")))?;
        let fleet = Sourced { value, origin: fleet.origin };
        let mode = layers.pick(flag.mode, "MUSTER_MODE", mode, file.mode, default_mode)?;
        let own_endpoint = vec![DEFAULT_ENDPOINT.to_owned()];
        let (to, at) = match mode.value {
            Mode::Router => (Vec::new(), own_endpoint),
            Mode::Client | Mode::Peer => (own_endpoint, Vec::new()),
        };
        let connect = layers.pick(flag.connect, "MUSTER_CONNECT", list, file.connect, to)?;
        let listen = layers.pick(flag.listen, "MUSTER_LISTEN", list, file.listen, at)?;
        for (field, endpoints) in [("connect", &connect.value), ("listen", &listen.value)] {
            for endpoint in endpoints {
                check_endpoint(endpoint)
                    .map_err(|problem| ExitError::usage(format!("{field}: {problem}")))?;
            }
        }
        if connect.value.is_empty() && mode.value == Mode::Client {
            let problem = "connect: must name at least one router; a client has no other way";
            return Err(ExitError::usage(problem));
        }
        let zenoh_config = layers.pick_optional(
            flag.zenoh_config,
            "MUSTER_ZENOH_CONFIG",
            path_of,
            file.zenoh_config,
        )?;
        let mut state_directory = layers.pick(
            flag.state_directory.map(Some),
            "STATE_DIRECTORY",
            // A service manager may name several directories with colons; the first is ours.
            |text| Ok(text.split(':').next().map(PathBuf::from)),
            file.state_directory.map(Some),
            default_state_directory(environment),
        )?;
        state_directory.value.take_if(|directory| directory.as_os_str() == "none");
        let log = layers.pick_optional(flag.log, "MUSTER_LOG", text, file.log)?;
        let log_json = flag.log_json.then_some(true);
        let log_json = layers.pick(log_json, "MUSTER_LOG_JSON", switch, file.log_json, false)?;
        let http = layers.pick_optional(flag.http, "MUSTER_HTTP", text, file.http)?;
        let address = http.value.as_deref().filter(|text| *text != "none");
        let address = address.map(read_address).transpose().map_err(ExitError::usage)?;
        let http = Sourced { value: address, origin: http.origin };

        let tables = [
            (ServiceName::Ingest, file.ingest),
            (ServiceName::Embedder, file.embedder),
            (ServiceName::Clusterer, file.clusterer),
            (ServiceName::Auditor, file.auditor),
            (ServiceName::Historian, file.historian),
            (ServiceName::Planner, file.planner),
        ];
        let patches = patches(tables, path.as_deref(), environment)?;
        let config = Self {
            fleet,
            connect,
            listen,
            mode,
            zenoh_config,
            state_directory,
            log,
            log_json,
            record: None,
            http,
            patches,
        };
        crate::logging::check(config.log.value.as_deref()).map_err(ExitError::usage)?;
        if let Some(path) = &config.zenoh_config.value {
            check_zenoh_config(path).map_err(ExitError::usage)?;
        }
        config.check_all_settings()?;
        Ok(config)
    }

    fn check_all_settings(&self) -> Result<(), ExitError> {
        self.settings::<IngestSettings>(ServiceName::Ingest)?;
        self.settings::<EmbedderSettings>(ServiceName::Embedder)?;
        self.settings::<ClustererSettings>(ServiceName::Clusterer)?;
        self.settings::<AuditorSettings>(ServiceName::Auditor)?;
        self.settings::<HistorianSettings>(ServiceName::Historian)?;
        self.settings::<PlannerSettings>(ServiceName::Planner)?;
        Ok(())
    }

    /// The configuration of a router in the same process. It connects to other routers only where
    /// these are named.
    #[must_use]
    pub fn as_router(&self, listen: Vec<String>) -> Self {
        let named = self.connect.origin != Origin::Default;
        let connect = if named { self.connect.value.clone() } else { Vec::new() };
        self.as_mode(Mode::Router, connect, listen)
    }

    /// The configuration of a client of a router in the same process.
    #[must_use]
    pub fn as_client(&self, connect: Vec<String>) -> Self {
        self.as_mode(Mode::Client, connect, Vec::new())
    }

    /// The same for another fleet.
    #[must_use]
    pub fn of_fleet(&self, fleet: FleetId) -> Self {
        Self { fleet: Sourced { value: fleet, origin: Origin::Flag }, ..self.clone() }
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
}

/// The patches of the services' settings, of the file and of the environment.
fn patches(
    tables: [(ServiceName, Option<toml::Table>); 6],
    path: Option<&Path>,
    environment: Environment<'_>,
) -> Result<Vec<(ServiceName, Origin, Value)>, ExitError> {
    let mut patches = Vec::new();
    for (service, table) in tables {
        if let (Some(table), Some(path)) = (table, path) {
            let patch = patch_of(table).map_err(|problem| {
                ExitError::usage(format!("config {}: {service}.{problem}", path.display()))
            })?;
            patches.push((service, Origin::File(path.to_owned()), patch));
        }
        let variable = format!("MUSTER_{}", service.as_str().to_uppercase());
        if let Some(text) = environment(&variable) {
            let patch = serde_json::from_str(&text).map_err(|error| {
                ExitError::usage(format!("{variable}: must be a JSON object: {error}"))
            })?;
            patches.push((service, Origin::Environment(variable), patch));
        }
    }
    Ok(patches)
}

fn read_address(text: &str) -> Result<SocketAddr, String> {
    text.parse().map_err(|_| {
        let text = muster_wire::message::quoted(text);
        format!("http: {text:?} is no address with a port; write one like 127.0.0.1:9464, or none")
    })
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
            config.settings::<ClustererSettings>(ServiceName::Clusterer).unwrap().teams.fixed()
        };
        assert_eq!(teams(&config), Some(3));
        let environment = |name: &str| match name {
            "MUSTER_FLEET" => Some("from-env".to_owned()),
            "MUSTER_CLUSTERER" => Some("{\"teams\": 4}".to_owned()),
            _ => None,
        };
        let mut config = resolve(&args, &environment).unwrap();
        assert_eq!(config.fleet.value.as_str(), "from-env");
        assert_eq!(teams(&config), Some(4));
        config.set(ServiceName::Clusterer, &["teams=5".to_owned()]).unwrap();
        assert_eq!(teams(&config), Some(5));
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
        assert!(with("[ingest]\ntick_hz = nan").contains("ingest.tick_hz"));
        assert!(with("[ingest.spatial]\nwidth = inf").contains("ingest.spatial.width"));
        assert!(with("connect = []").contains("connect"));
        assert!(with("connect = [\"tcp/localhost\"]").contains("port"));
        assert!(with("connect = [\"udp/localhost:7447\"]").contains("protocol"));
        assert!(with("log = \"loud=very=much\"").contains("log"));
        assert!(with("http = \"localhost\"").contains("http"));
        assert!(with("zenoh_config = \"/none.json5\"").contains("/none.json5"));
        assert!(problem("fleet = ").contains("muster.toml"));
        let absent = ProcessArgs { config: Some("/nowhere.toml".into()), ..ProcessArgs::default() };
        assert!(resolve(&absent, &none).unwrap_err().contains("nowhere"));
    }

    #[test]
    fn what_is_printed_is_accepted_again() {
        let file =
            "[ingest]\nspatial = { width = 3.0 }\n[clusterer]\nteams = { from = 2, to = 5 }\n";
        let (_directory, args) = with_file(file);
        let text = resolve(&args, &none).unwrap().print(&ServiceName::ALL).unwrap();
        assert!(text.contains("spatial.width = 3.0  # file"), "{text}");
        assert!(text.contains("teams.from = 2  # file"), "{text}");
        assert!(text.contains("restarts = 50  # default"), "{text}");
        let (_directory, args) = with_file(&text);
        resolve(&args, &none).unwrap();
    }
}
