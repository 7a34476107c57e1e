//! Programs beside this one: each is a process of its own, since this program is built without what they need. Some run
//! beside the services of `muster up`, others in place of a command.

use std::ffi::OsString;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use muster_runtime::config::{Mode, Origin, ProcessArgs, ProcessConfig, process_environment};
use muster_runtime::exit::{Exit, ExitError};
use muster_runtime::stop::Stop;

/// How long a program may take to end before it is killed.
const STOP_WITHIN: Duration = Duration::from_secs(3);

/// How often is looked whether a program still runs.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// Variables that are meant for this process and not for one beside it: only one of them can listen there.
const OWN_VARIABLES: [&str; 2] = ["MUSTER_HTTP", "MUSTER_LISTEN"];

/// A program of this repository that `muster` starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Program {
    /// The name of the program.
    pub(crate) name: &'static str,
    /// The package that has it, and its folder.
    package: &'static str,
    folder: &'static str,
}

/// The live fleet for Foxglove.
const FOXGLOVE: Program =
    Program { name: "muster-foxglove", package: "muster-foxglove", folder: "services/foxglove" };

/// Robots that run ROS 2.
const ROS2: Program =
    Program { name: "muster-ros2", package: "muster-ros2", folder: "services/ros2" };

/// Recordings in MCAP.
const MCAP: Program =
    Program { name: "muster-mcap", package: "muster-foxglove", folder: "services/foxglove" };

/// Arguments that another program reads.
#[derive(Debug, clap::Args)]
#[command(disable_help_flag = true)]
pub(crate) struct PassedArgs {
    /// The file, and options; --help shows them
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENT")]
    arguments: Vec<OsString>,
}

/// Runs a command of `muster-mcap` in place of this program.
///
/// # Errors
/// If the program is not there, or does not start.
pub(crate) fn run_mcap(
    command: &str,
    passed: &PassedArgs,
    process: &ProcessArgs,
) -> anyhow::Result<()> {
    let path = MCAP.find()?;
    // It returns only if it fails.
    let error =
        Command::new(path).arg(command).args(flags_before(process)).args(&passed.arguments).exec();
    let message = format!("{} does not start: {error}", MCAP.name);
    Err(ExitError { exit: Exit::Failure, message }.into())
}

/// The flags that stood before the arguments of another program.
fn flags_before(args: &ProcessArgs) -> Vec<OsString> {
    let mut flags: Vec<OsString> = Vec::new();
    let mut add = |name: &str, value: Option<OsString>| {
        if let Some(value) = value {
            flags.extend([name.into(), value]);
        }
    };
    add("--fleet", args.fleet.clone().map(OsString::from));
    add("--connect", args.connect.as_ref().map(|all| all.join(",").into()));
    add("--listen", args.listen.as_ref().map(|all| all.join(",").into()));
    add("--mode", args.mode.map(|mode| mode.to_string().into()));
    add("--zenoh-config", args.zenoh_config.clone().map(OsString::from));
    add("--config", args.config.clone().map(OsString::from));
    add("--log", args.log.clone().map(OsString::from));
    if args.log_json {
        flags.push("--log-json".into());
    }
    flags
}

/// What `muster up --with` starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Companion {
    /// The live fleet for Foxglove and Lichtblick
    Foxglove,
    /// Robots that run ROS 2; a router that --router runs passes on who of ROS is there
    Ros2,
}

impl Companion {
    const fn program(self) -> Program {
        match self {
            Self::Foxglove => FOXGLOVE,
            Self::Ros2 => ROS2,
        }
    }
}

impl Program {
    /// Where the program is: beside this one, or where the shell finds programs.
    ///
    /// # Errors
    /// If it is not there; the text says how to build it.
    pub(crate) fn find(self) -> Result<PathBuf, ExitError> {
        let own = std::env::current_exe().ok();
        let beside = own.as_deref().and_then(Path::parent).map(Path::to_path_buf);
        let path = process_environment("PATH").unwrap_or_default();
        let folders = beside.into_iter().chain(std::env::split_paths(&path));
        folders.map(|folder| folder.join(self.name)).find(|file| file.is_file()).ok_or_else(|| {
            let Self { name, package, folder } = self;
            ExitError::usage(format!(
                "{name} is neither beside muster nor in PATH; build it with `cargo build --release --package {package}`, \
                 or install it with `cargo install --path {folder}`"
            ))
        })
    }
}

/// The flags by which another program is on the same bus, in the same fleet, and logs the same.
pub(crate) fn flags(config: &ProcessConfig) -> Vec<OsString> {
    let mut flags: Vec<OsString> = vec!["--fleet".into(), config.fleet.value.as_str().into()];
    if config.connect.origin != Origin::Default {
        flags.extend(["--connect".into(), config.connect.value.join(",").into()]);
    }
    if config.mode.value == Mode::Peer {
        flags.extend(["--mode".into(), "peer".into()]);
    }
    if let Some(path) = &config.zenoh_config.value {
        flags.extend(["--zenoh-config".into(), path.into()]);
    }
    if let Some(log) = &config.log.value {
        flags.extend(["--log".into(), log.into()]);
    }
    if config.log_json.value {
        flags.push("--log-json".into());
    }
    flags
}

/// Programs that were found.
#[derive(Debug, Default)]
pub(crate) struct Companions(Vec<(Program, PathBuf)>);

impl Companions {
    /// Finds the programs, each once.
    ///
    /// # Errors
    /// Names the first that is not there.
    pub(crate) fn find(wanted: &[Companion]) -> Result<Self, ExitError> {
        let mut found: Vec<(Program, PathBuf)> = Vec::new();
        for program in wanted.iter().map(|companion| companion.program()) {
            if !found.iter().any(|(known, _)| *known == program) {
                found.push((program, program.find()?));
            }
        }
        Ok(Self(found))
    }

    /// Runs the programs until it is time to stop, or one of them ends.
    ///
    /// # Errors
    /// If one does not start, or ends by itself.
    pub(crate) async fn run(self, config: ProcessConfig, mut stop: Stop) -> anyhow::Result<()> {
        let mut running = Running(Vec::new());
        for (program, path) in self.0 {
            let mut command = Command::new(path);
            command.args(flags(&config)).stdin(Stdio::null());
            for variable in OWN_VARIABLES {
                command.env_remove(variable);
            }
            let child = command.spawn().map_err(|error| ExitError {
                exit: Exit::Failure,
                message: format!("{} does not start: {error}", program.name),
            })?;
            running.0.push((program, child));
        }
        loop {
            tokio::select! {
                () = stop.stopped() => break,
                () = tokio::time::sleep(LOOK_EVERY) => {}
            }
            for (program, child) in &mut running.0 {
                if let Some(status) = child.try_wait()? {
                    anyhow::bail!("{} ended by itself: {status}", program.name);
                }
            }
        }
        running.end().await;
        Ok(())
    }
}

/// Programs that run. What still runs when this is dropped is killed.
#[derive(Debug)]
struct Running(Vec<(Program, Child)>);

impl Running {
    /// Asks all to end, and waits a moment until they have.
    async fn end(mut self) {
        for (program, child) in &self.0 {
            // A signal of a terminal has reached them already; a second one changes nothing.
            let asked = Command::new("kill").arg(child.id().to_string()).status();
            if let Err(error) = asked {
                tracing::warn!("{} cannot be asked to end: {error}", program.name);
            }
        }
        let start = Instant::now();
        while start.elapsed() < STOP_WITHIN {
            if self.0.iter_mut().all(|(_, child)| matches!(child.try_wait(), Ok(Some(_)))) {
                return;
            }
            tokio::time::sleep(LOOK_EVERY).await;
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        for (_, child) in &mut self.0 {
            // One that has ended cannot be killed, and is waited for at once.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use muster_runtime::config::ProcessArgs;

    use super::*;

    #[derive(Parser)]
    struct Arguments {
        #[command(flatten)]
        process: ProcessArgs,
    }

    fn flags_of(flags: &[&str]) -> Vec<String> {
        let arguments = Arguments::try_parse_from(["muster"].iter().chain(flags)).unwrap();
        let config = ProcessConfig::resolve(&arguments.process, Mode::Client, &|_| None).unwrap();
        super::flags(&config).into_iter().map(|flag| flag.into_string().unwrap()).collect()
    }

    #[test]
    fn another_program_finds_the_same_fleet() {
        assert_eq!(flags_of(&[]), ["--fleet", "default"]);
        // A process reads the file when it starts, so it must be there.
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("z.json5");
        std::fs::write(&file, "{}").unwrap();
        let all = [
            "--fleet",
            "alpha",
            "--connect",
            "tcp/a:1,tcp/b:2",
            "--mode",
            "peer",
            "--zenoh-config",
            file.to_str().unwrap(),
            "--log",
            "debug",
            "--log-json",
        ];
        assert_eq!(flags_of(&all), all);
    }

    #[test]
    fn what_stands_before_the_arguments_of_another_program_is_passed_on() {
        let before =
            ["--fleet", "alpha", "--connect", "tcp/a:1,tcp/b:2", "--log", "debug", "--log-json"];
        let arguments = Arguments::try_parse_from(["muster"].iter().chain(&before)).unwrap();
        let flags = flags_before(&arguments.process);
        let flags: Vec<String> =
            flags.into_iter().map(|flag| flag.into_string().unwrap()).collect();
        assert_eq!(flags, before);
        let none = Arguments::try_parse_from(["muster"]).unwrap();
        assert!(flags_before(&none.process).is_empty(), "the other program has the same defaults");
    }

    #[test]
    fn a_program_that_is_not_there_is_named_with_how_to_build_it() {
        let missing = Program {
            name: "muster-nothing",
            package: "muster-nothing",
            folder: "services/nothing",
        };
        let error = missing.find().unwrap_err().message;
        assert!(
            error.starts_with("muster-nothing is neither beside muster nor in PATH"),
            "{error}"
        );
        assert!(error.contains("cargo build --release --package muster-nothing"), "{error}");
        assert!(error.contains("cargo install --path services/nothing"), "{error}");
    }
}
