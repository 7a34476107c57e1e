//! One program as a process of its own, with its output in a file.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};

/// How often a waiting test looks again.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// A running program. It is killed when the test lets go of it.
#[derive(Debug)]
pub struct Process {
    name: String,
    child: Child,
    log: PathBuf,
}

/// The path of a program of this workspace, as built with the tests.
///
/// # Errors
/// If it is not built; the text names the remedy.
pub fn program(name: &str) -> anyhow::Result<PathBuf> {
    let this = std::env::current_exe()?;
    // Tests are in a folder below the programs; programs of the tests are among the programs.
    let folder = this.parent().context("the test is in no target folder")?;
    let path = match folder.parent() {
        Some(above) if folder.ends_with("deps") => above.join(name),
        _ => folder.join(name),
    };
    ensure!(path.exists(), "{} is not built; run `cargo build --workspace` first", path.display());
    Ok(path)
}

/// The Python that has what others use with Muster: a Zenoh client and a validator of JSON Schema.
///
/// # Errors
/// If it is not installed; the text names the remedy.
pub fn python() -> anyhow::Result<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let python = root.join("target/peers/bin/python");
    let found = Command::new(&python)
        .args(["-c", "import zenoh, jsonschema"])
        .output()
        .is_ok_and(|output| output.status.success());
    ensure!(
        found,
        "there is no Python with eclipse-zenoh and jsonschema in target/peers; tests/run installs it, \
         or `python3 -m venv target/peers && \
         target/peers/bin/python -m pip install -r tests/peers/requirements.txt`"
    );
    Ok(python)
}

/// A program of Debian's package `prometheus`: `promtool` or `prometheus`.
///
/// # Errors
/// If it is not there; the text names the remedy.
pub fn prometheus_program(name: &str) -> anyhow::Result<PathBuf> {
    let unpacked = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/prometheus/usr/bin");
    let installed = std::env::var_os("PATH").unwrap_or_default();
    let places = [unpacked].into_iter().chain(std::env::split_paths(&installed));
    let found = places.map(|place| place.join(name)).find(|path| path.exists());
    found.with_context(|| {
        format!(
            "there is no {name}: tests/run unpacks it from Debian's package prometheus into \
             target/prometheus, or `apt-get install prometheus`, which also starts a server"
        )
    })
}

impl Process {
    /// Starts a program; what it prints goes to `{name}.log` in a folder.
    ///
    /// # Errors
    /// If it is not built or does not start.
    pub fn start(
        program_name: &str,
        arguments: &[&str],
        environment: &[(&str, &str)],
        folder: &Path,
    ) -> anyhow::Result<Self> {
        Self::start_at(&program(program_name)?, program_name, arguments, environment, folder)
    }

    /// Starts a program at a path, under a name.
    ///
    /// # Errors
    /// If it does not start.
    pub fn start_at(
        program: &Path,
        program_name: &str,
        arguments: &[&str],
        environment: &[(&str, &str)],
        folder: &Path,
    ) -> anyhow::Result<Self> {
        let mut command = Command::new(program);
        command.args(arguments).envs(environment.iter().copied());
        Self::start_command(program_name, command, folder)
    }

    /// Starts a command that becomes the program of this name; what it prints goes to a file that
    /// begins with the name.
    ///
    /// # Errors
    /// If it does not start.
    pub fn start_command(
        program_name: &str,
        mut command: Command,
        folder: &Path,
    ) -> anyhow::Result<Self> {
        static NEXT: std::sync::atomic::AtomicU32 = std::sync::atomic::AtomicU32::new(0);
        let number = NEXT.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        let log = folder.join(format!("{number}-{}.log", program_name.replace('/', "-")));
        let output = std::fs::File::create(&log)?;
        let child = command
            .stdin(Stdio::null())
            .stdout(output.try_clone()?)
            .stderr(output)
            .spawn()
            .with_context(|| format!("{program_name} does not start"))?;
        Ok(Self { name: program_name.to_owned(), child, log })
    }

    /// Its process id.
    #[must_use]
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// What it has printed so far.
    #[must_use]
    pub fn output(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Waits until it has printed a text.
    ///
    /// # Errors
    /// If it has ended, or has not printed it in time; the text holds what it has printed.
    pub fn until_prints(&mut self, text: &str, within: Duration) -> anyhow::Result<()> {
        let start = Instant::now();
        while !self.output().contains(text) {
            let is_waiting = self.is_running()? && start.elapsed() < within;
            ensure!(is_waiting, "{} has not printed {text:?}:\n{}", self.name, self.output());
            std::thread::sleep(LOOK_EVERY);
        }
        Ok(())
    }

    /// Ends it at once, as a crash would.
    ///
    /// # Errors
    /// If it cannot be killed.
    pub fn kill(&mut self) -> anyhow::Result<()> {
        self.child.kill()?;
        self.child.wait()?;
        Ok(())
    }

    /// Sends it a signal by name, such as `TERM` or `STOP`.
    ///
    /// # Errors
    /// If the signal cannot be sent.
    pub fn signal(&self, signal: &str) -> anyhow::Result<()> {
        let id = self.child.id().to_string();
        let status = Command::new("kill").args(["-s", signal, &id]).status()?;
        ensure!(status.success(), "cannot signal {}", self.name);
        Ok(())
    }

    /// Waits for its end.
    ///
    /// # Errors
    /// If it has not ended in time; the text holds what it has printed.
    pub fn wait(&mut self, within: Duration) -> anyhow::Result<ExitStatus> {
        let start = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait()? {
                return Ok(status);
            }
            ensure!(start.elapsed() < within, "{} has not ended:\n{}", self.name, self.output());
            std::thread::sleep(LOOK_EVERY);
        }
    }

    /// Whether it has not ended.
    ///
    /// # Errors
    /// If that cannot be found out.
    pub fn is_running(&mut self) -> anyhow::Result<bool> {
        Ok(self.child.try_wait()?.is_none())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.kill();
        if std::thread::panicking() {
            eprintln!("--- {} ---\n{}", self.name, self.output());
        }
    }
}

/// Runs a program to its end and returns its code, standard output and standard error.
///
/// # Errors
/// If it does not start, or has not ended in time.
pub fn run(
    program_name: &str,
    arguments: &[&str],
    within: Duration,
) -> anyhow::Result<(Option<i32>, String, String)> {
    let folder = tempfile::tempdir()?;
    let (out, err) = (folder.path().join("out"), folder.path().join("err"));
    let mut child = Command::new(program(program_name)?)
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(std::fs::File::create(&out)?)
        .stderr(std::fs::File::create(&err)?)
        .spawn()?;
    let start = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        if start.elapsed() > within {
            child.kill()?;
            child.wait()?;
            anyhow::bail!(
                "{program_name} {arguments:?} has not ended:\n{}{}",
                std::fs::read_to_string(&out)?,
                std::fs::read_to_string(&err)?
            );
        }
        std::thread::sleep(LOOK_EVERY);
    };
    Ok((status.code(), std::fs::read_to_string(&out)?, std::fs::read_to_string(&err)?))
}
