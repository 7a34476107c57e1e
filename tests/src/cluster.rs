//! A router and the four services, each a process that can be killed and started alone.

use std::collections::BTreeMap;
use std::net::TcpListener;
use std::path::Path;
use std::time::Duration;

use anyhow::Context;
use tempfile::TempDir;

use crate::client::Client;
use crate::process::Process;

/// The services in the order of the data's path.
pub const SERVICES: [&str; 4] = ["ingest", "embedder", "clusterer", "auditor"];

/// How long a router may take to listen.
const ROUTER_WITHIN: Duration = Duration::from_secs(10);

/// A router and services of one fleet.
#[derive(Debug)]
pub struct Cluster {
    /// The fleet.
    pub fleet: String,
    /// Where the router listens.
    pub endpoint: String,
    folder: TempDir,
    router: Process,
    services: BTreeMap<String, Process>,
    flags: BTreeMap<String, Vec<String>>,
    common: Vec<String>,
}

/// An endpoint on loopback whose port is free.
///
/// # Errors
/// If there is none.
pub fn free_endpoint() -> anyhow::Result<String> {
    let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
    Ok(format!("tcp/127.0.0.1:{port}"))
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
        let endpoint = free_endpoint()?;
        let folder = tempfile::tempdir()?;
        let router = start_router(&endpoint, folder.path())?;
        Self::start_at(fleet, &endpoint, folder, router, settings, common)
    }

    /// Starts all services at a router that listens already, with flags as above.
    ///
    /// # Errors
    /// If a program does not start.
    pub fn start_at(
        fleet: &str,
        endpoint: &str,
        folder: TempDir,
        router: Process,
        settings: &[(&str, &str)],
        common: &[&str],
    ) -> anyhow::Result<Self> {
        let mut flags: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for (service, assignment) in settings {
            flags.entry((*service).to_owned()).or_default().push((*assignment).to_owned());
        }
        let mut cluster = Self {
            fleet: fleet.to_owned(),
            endpoint: endpoint.to_owned(),
            folder,
            router,
            services: BTreeMap::new(),
            flags,
            common: common.iter().map(|flag| (*flag).to_owned()).collect(),
        };
        for service in SERVICES {
            cluster.start_service(service)?;
        }
        Ok(cluster)
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
        let state = self.folder.path().join(folder);
        let mut arguments =
            vec!["--fleet", &self.fleet, "--connect", &self.endpoint, "--state-directory"];
        let state = state.to_string_lossy().into_owned();
        arguments.push(&state);
        arguments.extend(self.common.iter().map(String::as_str));
        for assignment in self.flags.get(service).into_iter().flatten() {
            arguments.extend(["--set", assignment]);
        }
        let name = format!("muster-{service}");
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
        self.router = start_router(&self.endpoint, self.folder.path())?;
        Ok(())
    }

    /// Starts simulated robots of this fleet as one process.
    ///
    /// # Errors
    /// If the program does not start.
    pub fn robots(&self, arguments: &[&str]) -> anyhow::Result<Process> {
        let common = ["robot", "--fleet", &self.fleet, "--connect", &self.endpoint];
        Process::start("muster", &[&common, arguments].concat(), &[], self.folder.path())
    }

    /// Runs the console's command on this fleet.
    ///
    /// # Errors
    /// If it does not start or end.
    pub fn muster(&self, arguments: &[&str]) -> anyhow::Result<(Option<i32>, String, String)> {
        let common = ["--fleet", self.fleet.as_str(), "--connect", &self.endpoint];
        crate::process::run("muster", &[arguments, &common].concat(), Duration::from_secs(20))
    }

    /// An outside client on the router of this fleet.
    ///
    /// # Errors
    /// If it does not connect.
    pub async fn client(&self) -> anyhow::Result<Client> {
        Client::connect(&self.endpoint, &self.fleet).await
    }
}
