//! Programs beside this one: each is a process of its own, since this program is built without what they need. Some run
//! beside the services of `muster up`, others in place of a command.

use std::ffi::OsString;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use muster_runtime::config::{Mode, Origin, ProcessArgs, ProcessConfig, process_environment};
use muster_runtime::exit::{Exit, ExitError};
use muster_runtime::stop::{ENDS_WITH_INPUT, Stop};

/// How long a program may take to end before it is killed.
const STOP_WITHIN: Duration = Duration::from_secs(3);

/// How often is looked whether a program still runs.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// A program that ends so soon after its first start cannot run here at all: a setting is wrong, or its address is taken.
const BEGINS_WITHIN: Duration = Duration::from_secs(5);

/// How long after its end a program is started again the first time. Each further pause is twice as long.
const FIRST_PAUSE: Duration = Duration::from_secs(1);

/// The longest pause, and how long a program must have run to begin with the first pause again.
const LONGEST_PAUSE: Duration = Duration::from_secs(60);

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

    /// Runs the programs until it is time to stop. The services do not need them: one that ends after it has begun well is
    /// started again, and the services go on.
    ///
    /// # Errors
    /// If one does not start, or ends just after its first start.
    pub(crate) async fn run(self, config: ProcessConfig, mut stop: Stop) -> anyhow::Result<()> {
        let flags = flags(&config);
        let mut running = Running(Vec::new());
        for (program, path) in self.0 {
            running.0.push(Process::start(program, path, &flags)?);
        }
        loop {
            tokio::select! {
                () = stop.stopped() => break,
                () = tokio::time::sleep(LOOK_EVERY) => {}
            }
            for process in &mut running.0 {
                process.look(&flags, Instant::now())?;
            }
        }
        running.end().await;
        Ok(())
    }
}

/// A program next to the services, which is started again when it ends.
#[derive(Debug)]
struct Process {
    program: Program,
    path: PathBuf,
    /// None between its end and its next start.
    child: Option<Child>,
    first_start: Instant,
    /// When it was started, or is to be.
    start: Instant,
    /// How long it is waited after its next end.
    pause: Duration,
}

impl Process {
    fn start(program: Program, path: PathBuf, flags: &[OsString]) -> Result<Self, ExitError> {
        let child = spawn(&path, flags).map_err(|error| ExitError {
            exit: Exit::Failure,
            message: format!("{} does not start: {error}", program.name),
        })?;
        let now = Instant::now();
        Ok(Self {
            program,
            path,
            child: Some(child),
            first_start: now,
            start: now,
            pause: FIRST_PAUSE,
        })
    }

    /// Looks whether it has ended, and starts it again when it is time.
    ///
    /// # Errors
    /// If it has ended just after its first start.
    fn look(&mut self, flags: &[OsString], now: Instant) -> anyhow::Result<()> {
        let name = self.program.name;
        let Some(child) = &mut self.child else {
            if now >= self.start {
                match spawn(&self.path, flags) {
                    Ok(child) => self.child = Some(child),
                    Err(error) => self.wait(&format!("does not start: {error}"), now),
                }
            }
            return Ok(());
        };
        if let Some(status) = child.try_wait()? {
            if now - self.first_start < BEGINS_WITHIN {
                anyhow::bail!("{name} ended by itself: {status}");
            }
            self.child = None;
            if now - self.start >= LONGEST_PAUSE {
                self.pause = FIRST_PAUSE;
            }
            self.wait(&format!("ended by itself: {status}"), now);
        }
        Ok(())
    }

    fn wait(&mut self, why: &str, now: Instant) {
        let name = self.program.name;
        tracing::warn!("{name} {why}; it is started again in {} s", self.pause.as_secs());
        self.start = now + self.pause;
        self.pause = (2 * self.pause).min(LONGEST_PAUSE);
    }

    fn has_ended(&mut self) -> bool {
        self.child.as_mut().is_none_or(|child| matches!(child.try_wait(), Ok(Some(_))))
    }
}

fn spawn(path: &Path, flags: &[OsString]) -> std::io::Result<Child> {
    let mut command = Command::new(path);
    // If this process is killed, the end of its pipe ends the other.
    command.args(flags).stdin(Stdio::piped()).env(ENDS_WITH_INPUT, "1");
    for variable in OWN_VARIABLES {
        command.env_remove(variable);
    }
    // A file that the environment names may have the port of this process.
    command.args(["--http", "none"]).spawn()
}

/// Programs that run. What still runs when this is dropped is killed.
#[derive(Debug)]
struct Running(Vec<Process>);

impl Running {
    /// Asks all to end, and waits a moment until they have.
    async fn end(mut self) {
        for process in &self.0 {
            let Some(child) = &process.child else { continue };
            // A signal of a terminal has reached them already; a second one changes nothing.
            let asked = Command::new("kill").arg(child.id().to_string()).status();
            if let Err(error) = asked {
                tracing::warn!("{} cannot be asked to end: {error}", process.program.name);
            }
        }
        let start = Instant::now();
        while start.elapsed() < STOP_WITHIN {
            if self.0.iter_mut().all(Process::has_ended) {
                return;
            }
            tokio::time::sleep(LOOK_EVERY).await;
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        for child in self.0.iter_mut().filter_map(|process| process.child.as_mut()) {
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

    #[test]
    fn a_program_that_ends_is_started_again_after_growing_pauses() {
        let mut process = Process::start(FOXGLOVE, PathBuf::from("/bin/false"), &[]).unwrap();
        let begin = process.first_start;
        while !process.has_ended() {
            std::thread::yield_now();
        }
        let soon = process.look(&[], begin + Duration::from_secs(1)).unwrap_err();
        assert!(soon.to_string().starts_with("muster-foxglove ended by itself: exit status: 1"));
        let mut now = begin + BEGINS_WITHIN;
        for seconds in [1, 2, 4, 8, 16, 32, 60, 60] {
            process.look(&[], now).unwrap();
            assert!(process.child.is_none());
            now += Duration::from_secs(seconds);
            process.look(&[], now - Duration::from_millis(1)).unwrap();
            assert!(process.child.is_none(), "before {seconds} s");
            process.look(&[], now).unwrap();
            assert!(process.child.is_some(), "after {seconds} s");
            while !process.has_ended() {
                std::thread::yield_now();
            }
        }
        // After a minute of work the first pause counts again.
        now += LONGEST_PAUSE;
        process.look(&[], now).unwrap();
        process.look(&[], now + FIRST_PAUSE).unwrap();
        assert!(process.child.is_some());
    }
}
