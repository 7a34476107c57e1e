//! Flags, environment and the file of topics.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Parser;
use muster_runtime::bus::BusConfig;
use muster_runtime::bus::check_endpoint;
use muster_runtime::bus::config::Choice;
use muster_runtime::config::{Environment, Mode, ProcessArgs, ProcessConfig, process_environment};
use muster_runtime::exit::{self, ExitError};
use muster_runtime::service;
use muster_runtime::store::read_at_most;

use super::run;
use crate::config::{File, Setup};

/// Largest file of topics in bytes: some dozens of definitions.
const MAX_FILE: u64 = 256 * 1024;

/// The flags.
#[derive(Debug, Parser)]
#[command(
    name = "muster-ros2",
    version,
    about = "Brings robots that run ROS 2 into a fleet, and shows their teams to ROS",
    after_help = format!(
        "Examples:\n  muster-ros2                            robots that publish /ROBOT/odom and /ROBOT/tf\n  \
         muster-ros2 --topics /etc/muster/ros2.toml\n  \
         muster-ros2 --topics ros2.toml --print-config\n\n\
         Robots and this program meet at a router with gossip: muster router --ros\n\n{}",
        exit::HELP
    )
)]
struct Ros2Args {
    /// File in TOML that says which topics are read and written [MUSTER_ROS2_TOPICS]
    #[arg(long, value_name = "FILE")]
    topics: Option<PathBuf>,
    #[command(flatten)]
    process: ProcessArgs,
}

/// What the program runs with.
#[derive(Debug)]
pub(super) struct Ros2Options {
    pub(super) setup: Setup,
    /// The bus of ROS.
    pub(super) ros: BusConfig,
}

/// The whole `main` of the program.
#[must_use]
pub fn main() -> ExitCode {
    exit::finish(start(&Ros2Args::parse()))
}

fn start(args: &Ros2Args) -> anyhow::Result<()> {
    let environment: Environment<'_> = &process_environment;
    let config = ProcessConfig::resolve(&args.process, Mode::Client, environment)?;
    if config.mode.value == Mode::Router {
        return Err(ExitError::usage("mode: this is no router; use client or peer").into());
    }
    let path = args.topics.clone().or_else(|| environment("MUSTER_ROS2_TOPICS").map(PathBuf::from));
    let file = path.as_deref().map(read).transpose()?.unwrap_or_default();
    let options = resolve(&file, path.as_deref(), &config)?;
    if service::report(&args.process, &config, &[])? {
        if args.process.print_config {
            writeln!(std::io::stdout(), "\n# topics\n{}", toml::to_string(&file)?)?;
        }
        return Ok(());
    }
    service::block_on(&config, async |config, stop| run::run(config, options, stop).await)
}

fn wrong(path: Option<&Path>, problem: &str) -> ExitError {
    match path {
        Some(path) => ExitError::usage(format!("topics {}: {problem}", path.display())),
        None => ExitError::usage(format!("topics: {problem}")),
    }
}

fn resolve(
    file: &File,
    path: Option<&Path>,
    config: &ProcessConfig,
) -> Result<Ros2Options, ExitError> {
    let setup = file.check().map_err(|error| wrong(path, &error.to_string()))?;
    let mut ros = BusConfig::from(config);
    if !file.connect.is_empty() {
        for endpoint in &file.connect {
            check_endpoint(endpoint).map_err(|error| wrong(path, &format!("connect: {error}")))?;
        }
        ros.connect = Choice::chosen(file.connect.clone());
        // Zenoh's own configuration is for the bus of the fleet: a secured one allows no other protocol, and programs of ROS have
        // no certificates.
        ros.zenoh_config = None;
    }
    Ok(Ros2Options { setup, ros })
}

fn read(path: &Path) -> Result<File, ExitError> {
    let fail = |problem: String| wrong(Some(path), &problem);
    let bytes = read_at_most(path, MAX_FILE).map_err(|error| fail(error.to_string()))?;
    let text = String::from_utf8(bytes).map_err(|_| fail("must be UTF-8".to_owned()))?;
    toml::from_str(&text).map_err(|error: toml::de::Error| fail(error.to_string()))
}
