//! Flags of the recorder and of the player.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use muster_runtime::config::{Mode, ProcessArgs, ProcessConfig, process_environment};
use muster_runtime::exit::{self, ExitError};
use muster_runtime::service;

use super::{record, replay};

/// Slowest and fastest play that makes sense: a second in a quarter of an hour, and a day in a minute and a half.
const SPEEDS: std::ops::RangeInclusive<f64> = 0.001..=1000.0;

/// The flags.
#[derive(Debug, Parser)]
#[command(
    name = "muster-mcap",
    version,
    about = "Records a fleet in MCAP, and plays recordings",
    after_help = exit::HELP
)]
struct Arguments {
    #[command(flatten)]
    process: ProcessArgs,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Record a live fleet: the JSON of the bus, and the scenes of Foxglove
    Record(RecordArgs),
    /// Play a recording into a fleet of its own, whose name begins with replay-
    Replay(ReplayArgs),
}

/// What is recorded.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Foxglove, Lichtblick, PlotJuggler and every reader of MCAP open the file. Half a second after it \
happened, everything is on the disk.\n\nExamples:\n  muster record run.mcap                until Ctrl-C\n  \
muster record run.mcap --seconds 60 --fleet alpha\n\n\
What a single service did is another recording, which finds faults of Muster: see `muster up --record` and \
`muster replay-core`."
)]
pub(super) struct RecordArgs {
    /// The file, which must not be there yet; a long recording goes on in FILE.2.mcap
    #[arg(value_name = "FILE.mcap")]
    pub(super) file: PathBuf,
    /// End after so many seconds; without it, record until stopped
    #[arg(long)]
    pub(super) seconds: Option<f64>,
}

/// What is played.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Poses, links, ranks and relations are put as they were, at their old distances in time. All that \
follows from them stands in the fleet replay-NAME, whose name says what it is. It needs services of its own.\n\nExamples:\n  \
muster up --fleet replay-alpha        the services of the replay, beside those of the live fleet\n  \
muster replay run.mcap                the fleet alpha of the file, in the fleet replay-alpha\n  \
muster teams --watch --fleet replay-alpha\n  muster replay run.mcap --speed 10"
)]
pub(super) struct ReplayArgs {
    /// The recording, and its further parts in order
    #[arg(value_name = "FILE.mcap", required = true)]
    pub(super) files: Vec<PathBuf>,
    /// How many times as fast as it was
    #[arg(long, default_value_t = 1.0)]
    pub(super) speed: f64,
}

/// The whole `main` of the program.
#[must_use]
pub fn main() -> ExitCode {
    exit::finish(start(&Arguments::parse()))
}

fn start(arguments: &Arguments) -> anyhow::Result<()> {
    let config = ProcessConfig::resolve(&arguments.process, Mode::Client, &process_environment)?;
    if config.mode.value == Mode::Router {
        return Err(ExitError::usage("mode: this is no router; use client or peer").into());
    }
    if service::report(&arguments.process, &config, &[])? {
        return Ok(());
    }
    match &arguments.command {
        Command::Record(args) => {
            let valid = |seconds: &f64| seconds.is_finite() && *seconds >= 0.0;
            if args.seconds.as_ref().is_some_and(|seconds| !valid(seconds)) {
                return Err(ExitError::usage("--seconds: must be at least 0").into());
            }
            service::block_on(&config, async |config, stop| record::run(args, config, stop).await)
        }
        Command::Replay(args) => {
            if !SPEEDS.contains(&args.speed) {
                let (least, most) = (SPEEDS.start(), SPEEDS.end());
                return Err(ExitError::usage(format!("--speed: must be {least} to {most}")).into());
            }
            service::block_on(&config, async |config, stop| replay::run(args, config, stop).await)
        }
    }
}
