//! A router and the four services, each a process that can be killed and started alone.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use tempfile::TempDir;

use crate::access::{Access, OPERATOR, Security};
use crate::client::{Client, client_of, with_retries};
use crate::ports::free_endpoint;
use crate::process::{Process, run};

/// The services in the order of the data's path.
pub const SERVICES: [&str; 4] = ["ingest", "embedder", "clusterer", "auditor"];

/// How long a router may take to listen.
const ROUTER_WITHIN: Duration = Duration::from_secs(10);

/// How long a client tries to connect, in milliseconds.
const CLIENT_TIMEOUT_MS: &str = "10000";

/// How long a command that only prints may take.
const LISTED_WITHIN: Duration = Duration::from_secs(20);

/// A router and services of one fleet.
#[derive(Debug)]
pub struct Cluster {
    /// The fleet.
    pub fleet: String,
    /// Where the router listens.
    pub endpoint: String,
    /// Where services connect, if not there.
    pub services_connect: Option<String>,
    folder: TempDir,
    router: Process,
    services: BTreeMap<String, Process>,
    flags: BTreeMap<String, Vec<String>>,
    common: Vec<String>,
    access: Option<Access>,
}

/// What a cluster is to be.
#[derive(Debug, Clone, Copy)]
pub struct ClusterOptions<'a> {
    /// The fleet.
    pub fleet: &'a str,
    /// The bus.
    pub security: Security,
    /// `--set` flags per service.
    pub settings: &'a [(&'a str, &'a str)],
    /// Flags of all services.
    pub common: &'a [&'a str],
    /// The robots that may take part, which a secured bus must know.
    pub robots: &'a [String],
    /// What the name of its folder begins with.
    pub folder_prefix: &'a str,
}

impl Default for ClusterOptions<'_> {
    fn default() -> Self {
        Self {
            fleet: "alpha",
            security: Security::Plain,
            settings: &[],
            common: &[],
            robots: &[],
            folder_prefix: "muster-test-",
        }
    }
}

/// Simulated robots of a fleet: one process for all, or one for each where each shows its own certificate.
/// They are killed when the test lets go of them.
#[derive(Debug)]
pub struct Robots(Vec<Process>);

impl Robots {
    /// The id of the first process.
    #[must_use]
    pub fn id(&self) -> u32 {
        self.0.first().map_or(0, Process::id)
    }

    /// Kills all processes, as a crash would.
    ///
    /// # Errors
    /// If one cannot be killed.
    pub fn kill(&mut self) -> anyhow::Result<()> {
        self.0.iter_mut().try_for_each(Process::kill)
    }

    /// Sends all processes a signal by name, such as `TERM` or `STOP`.
    ///
    /// # Errors
    /// If a signal cannot be sent.
    pub fn signal(&self, signal: &str) -> anyhow::Result<()> {
        self.0.iter().try_for_each(|process| process.signal(signal))
    }

    /// The processes.
    pub fn processes(&mut self) -> &mut [Process] {
        &mut self.0
    }
}

/// The robots of a scenario, each with its group, as `muster robot --list` prints them.
///
/// # Errors
/// If the arguments make no scenario.
pub fn robots_of(scenario: &[&str]) -> anyhow::Result<BTreeMap<String, String>> {
    let arguments = [&["robot", "--list"], scenario].concat();
    let (code, out, err) = run("muster", &arguments, LISTED_WITHIN)?;
    anyhow::ensure!(code == Some(0), "muster {arguments:?}: {err}");
    let robot = |line: &str| {
        let (robot, group) = line.split_once(' ')?;
        Some((robot.to_owned(), group.to_owned()))
    };
    Ok(out.lines().filter_map(robot).collect())
}

/// Starts a router and waits until it listens.
///
/// # Errors
/// If it does not start to listen in time.
pub fn start_router(endpoint: &str, folder: &Path) -> anyhow::Result<Process> {
    let mut router = Process::start("muster", &["router", "--listen", endpoint], &[], folder)?;
    router.until_prints("router listens at", ROUTER_WITHIN)?;
    Ok(router)
}

/// Starts a router on a plain or a secured bus and waits until it listens.
fn start_router_of(
    access: Option<&Access>,
    endpoint: &str,
    folder: &Path,
) -> anyhow::Result<Process> {
    let Some(access) = access else { return start_router(endpoint, folder) };
    let config = access.router.to_string_lossy().into_owned();
    let mut router = Process::start("muster", &["router", "--zenoh-config", &config], &[], folder)?;
    router.until_prints("router listens at", ROUTER_WITHIN)?;
    Ok(router)
}

impl Cluster {
    /// Starts a router and all services, with `--set` flags per service.
    ///
    /// # Errors
    /// If a program does not start.
    pub fn start(fleet: &str, settings: &[(&str, &str)]) -> anyhow::Result<Self> {
        Self::start_with(fleet, settings, &[])
    }

    /// Starts a router and all services, with `--set` flags per service and flags for all of them.
    ///
    /// # Errors
    /// If a program does not start.
    pub fn start_with(
        fleet: &str,
        settings: &[(&str, &str)],
        common: &[&str],
    ) -> anyhow::Result<Self> {
        Self::start_by(&ClusterOptions { fleet, settings, common, ..ClusterOptions::default() })
    }

    /// Starts a router and all services of the fleet `alpha`, on the bus that is drawn for a test, with `--set`
    /// flags per service. The robots of the scenario may take part.
    ///
    /// # Errors
    /// If a program does not start.
    pub fn start_drawn(
        test: &str,
        settings: &[(&str, &str)],
        scenario: &[&str],
    ) -> anyhow::Result<Self> {
        let robots: Vec<String> = robots_of(scenario)?.into_keys().collect();
        let security = Security::drawn(test)?;
        let defaults = ClusterOptions::default();
        Self::start_by(&ClusterOptions { security, settings, robots: &robots, ..defaults })
    }

    /// Starts a router and all services.
    ///
    /// # Errors
    /// If a program does not start.
    pub fn start_by(options: &ClusterOptions<'_>) -> anyhow::Result<Self> {
        let mut cluster = Self::start_without_services(options)?;
        for service in SERVICES {
            cluster.start_service(service)?;
        }
        Ok(cluster)
    }

    /// Starts a router, and none of the services.
    ///
    /// # Errors
    /// If a program does not start.
    pub fn start_without_services(options: &ClusterOptions<'_>) -> anyhow::Result<Self> {
        let mut endpoint = free_endpoint()?;
        let folder = tempfile::Builder::new().prefix(options.folder_prefix).tempdir()?;
        let access = match options.security {
            Security::Plain => None,
            Security::Secured => {
                let port = endpoint.rsplit(':').next().unwrap_or_default();
                let access = Access::new(folder.path(), options.fleet, port, options.robots)?;
                endpoint = access.endpoint()?;
                Some(access)
            }
        };
        let router = start_router_of(access.as_ref(), &endpoint, folder.path())?;
        Ok(Self::at(options, endpoint, folder, router, access))
    }

    /// Starts all services on a plain bus, at a router that listens already.
    ///
    /// # Errors
    /// If a program does not start.
    pub fn start_at(endpoint: String, folder: TempDir, router: Process) -> anyhow::Result<Self> {
        let mut cluster = Self::at(&ClusterOptions::default(), endpoint, folder, router, None);
        for service in SERVICES {
            cluster.start_service(service)?;
        }
        Ok(cluster)
    }

    /// A router that runs, and none of the services.
    fn at(
        options: &ClusterOptions<'_>,
        endpoint: String,
        folder: TempDir,
        router: Process,
        access: Option<Access>,
    ) -> Self {
        let mut flags: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for (service, assignment) in options.settings {
            flags.entry((*service).to_owned()).or_default().push((*assignment).to_owned());
        }
        Self {
            fleet: options.fleet.to_owned(),
            endpoint,
            services_connect: None,
            folder,
            router,
            services: BTreeMap::new(),
            flags,
            common: options.common.iter().map(|flag| (*flag).to_owned()).collect(),
            access,
        }
    }

    /// Whether members show certificates.
    #[must_use]
    pub fn is_secured(&self) -> bool {
        self.access.is_some()
    }

    /// The flags by which a program takes part as a member, such as `viewer.wall`; on a plain bus all are the same.
    #[must_use]
    pub fn flags_of(&self, identity: &str) -> Vec<String> {
        self.connects(identity, &self.endpoint)
    }

    /// The flags by which a member connects to an endpoint.
    fn connects(&self, identity: &str, endpoint: &str) -> Vec<String> {
        let mut flags = vec!["--fleet".to_owned(), self.fleet.clone()];
        flags.extend(["--connect".to_owned(), endpoint.to_owned()]);
        if let Some(access) = &self.access {
            let config = access.config(identity).to_string_lossy().into_owned();
            flags.extend(["--zenoh-config".to_owned(), config]);
        }
        flags
    }

    /// The folder of logs and states.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Starts a service; it may have run before.
    ///
    /// # Errors
    /// If it does not start.
    pub fn start_service(&mut self, service: &str) -> anyhow::Result<()> {
        self.start_instance(service, service)
    }

    /// Starts a further instance of a service, as on another host: with a name and a state of its own.
    ///
    /// # Errors
    /// If it does not start.
    pub fn start_instance(&mut self, service: &str, instance: &str) -> anyhow::Result<()> {
        let folder = if service == instance { "state" } else { instance };
        let state = self.folder.path().join(folder).to_string_lossy().into_owned();
        let endpoint = self.services_connect.as_ref().unwrap_or(&self.endpoint);
        let mut arguments = self.connects(&format!("service.{service}"), endpoint);
        arguments.extend(["--state-directory".to_owned(), state]);
        arguments.extend(self.common.iter().cloned());
        for assignment in self.flags.get(service).into_iter().flatten() {
            arguments.extend(["--set".to_owned(), assignment.clone()]);
        }
        let name = format!("muster-{service}");
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let process = Process::start(&name, &arguments, &[], self.folder.path())?;
        self.services.insert(instance.to_owned(), process);
        Ok(())
    }

    /// The process of a service, or of a further instance by its name.
    ///
    /// # Errors
    /// If it was never started.
    pub fn service(&mut self, service: &str) -> anyhow::Result<&mut Process> {
        self.services.get_mut(service).with_context(|| format!("no {service} was started"))
    }

    /// The id of the router's process.
    #[must_use]
    pub fn router_id(&self) -> u32 {
        self.router.id()
    }

    /// Kills the router, as a crash would.
    ///
    /// # Errors
    /// If it cannot be killed.
    pub fn kill_router(&mut self) -> anyhow::Result<()> {
        self.router.kill()
    }

    /// Starts the router again.
    ///
    /// # Errors
    /// If it does not listen in time.
    pub fn restart_router(&mut self) -> anyhow::Result<()> {
        self.router = start_router_of(self.access.as_ref(), &self.endpoint, self.folder.path())?;
        Ok(())
    }

    /// The process of the router.
    pub fn router(&mut self) -> &mut Process {
        &mut self.router
    }

    /// Starts simulated robots of this fleet. On a secured bus they must be among those that may take part.
    ///
    /// # Errors
    /// If the program does not start.
    pub fn robots(&self, arguments: &[&str]) -> anyhow::Result<Robots> {
        self.robots_at(&self.endpoint, arguments)
    }

    /// Starts simulated robots of this fleet that connect to an endpoint. On a secured bus they must be among
    /// those that may take part.
    ///
    /// # Errors
    /// If the program does not start.
    pub fn robots_at(&self, endpoint: &str, arguments: &[&str]) -> anyhow::Result<Robots> {
        let start = |identity: &str, arguments: &[&str]| {
            let connects = self.connects(identity, endpoint);
            let connects: Vec<&str> = connects.iter().map(String::as_str).collect();
            let arguments = [&["robot"], &connects[..], arguments].concat();
            Process::start("muster", &arguments, &[], self.folder.path())
        };
        if self.access.is_none() {
            return Ok(Robots(vec![start("", arguments)?]));
        }
        // One process is one link, and shows one certificate.
        let (scenario, only) = split_only(arguments);
        let robots: Vec<String> = match only {
            Some(names) => names.split(',').map(str::to_owned).collect(),
            None => robots_of(&scenario)?.into_keys().collect(),
        };
        let each = robots.iter().map(|robot| {
            let only = ["--only", robot.as_str()];
            start(&format!("robot.{robot}"), &[&scenario[..], &only].concat())
        });
        Ok(Robots(each.collect::<Result<_, _>>()?))
    }

    /// Runs the console's command on this fleet.
    ///
    /// # Errors
    /// If it does not start or end.
    pub fn muster(&self, arguments: &[&str]) -> anyhow::Result<(Option<i32>, String, String)> {
        let connects = self.connects(OPERATOR, &self.endpoint);
        let connects: Vec<&str> = connects.iter().map(String::as_str).collect();
        run("muster", &[arguments, &connects].concat(), Duration::from_secs(20))
    }

    /// An outside client on the router of this fleet, which may do everything that an operator may.
    ///
    /// # Errors
    /// If it does not connect.
    pub async fn client(&self) -> anyhow::Result<Client> {
        if self.access.is_none() {
            return Client::connect(&self.endpoint, &self.fleet).await;
        }
        self.member(OPERATOR, &self.endpoint, CLIENT_TIMEOUT_MS).await
    }

    /// An outside client with the rights of a member, such as `robot.r1`, at an endpoint, which tries for so many
    /// milliseconds, or for ever with -1.
    ///
    /// # Errors
    /// If it does not connect.
    pub async fn member(
        &self,
        identity: &str,
        endpoint: &str,
        timeout_ms: &str,
    ) -> anyhow::Result<Client> {
        Client::open(self.member_config(identity, endpoint, timeout_ms)?, &self.fleet).await
    }

    /// The Zenoh configuration of a member of a secured bus, such as `viewer.wall`; none on a plain one.
    #[must_use]
    pub fn identity(&self, identity: &str) -> Option<PathBuf> {
        self.access.as_ref().map(|access| access.config(identity))
    }

    /// The configuration of such a client.
    ///
    /// # Errors
    /// If there is no such member, or the endpoint is none.
    pub fn member_config(
        &self,
        identity: &str,
        endpoint: &str,
        timeout_ms: &str,
    ) -> anyhow::Result<zenoh::Config> {
        let fail = |error: zenoh::Error| anyhow::anyhow!("{error}");
        let mut config = match &self.access {
            None => client_of(endpoint, timeout_ms)?,
            Some(access) => {
                let identity = zenoh::Config::from_file(access.config(identity));
                with_retries(identity.map_err(fail)?, endpoint, timeout_ms)?
            }
        };
        // As that of Muster's programs: a link that has gone silent is opened again.
        config.insert_json5("transport/link/tx/lease", "2000").map_err(fail)?;
        Ok(config)
    }
}

/// Arguments without `--only`, and its value.
fn split_only<'a>(arguments: &[&'a str]) -> (Vec<&'a str>, Option<&'a str>) {
    match arguments.iter().position(|argument| *argument == "--only") {
        None => (arguments.to_vec(), None),
        Some(place) => {
            let only = arguments.get(place + 1).copied();
            let mut rest = arguments.to_vec();
            rest.drain(place..(place + 2).min(arguments.len()));
            (rest, only)
        }
    }
}
