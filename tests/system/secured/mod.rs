//! A bus with certificates and rules: members of the fleet work as on a plain bus; others are refused, and so are
//! members that exceed their rights. Every refusal is tested with its counterpart that is allowed.

mod certificates;
mod client;
mod fleets;
mod joining;
mod members;
mod refusals;

use std::path::{Path, PathBuf};
use std::time::Duration;

use muster_tests::SOON;
use muster_tests::client::{Client, Watch, division};
use muster_tests::cluster::SERVICES;
use muster_tests::ports::free_endpoint;
use muster_tests::process::{Process, run};
use serde_json::{Value, json};
use tempfile::TempDir;

/// How long a client that is refused tries.
const REFUSED_WITHIN_MS: &str = "3000";

/// Robots on two places.
const ROBOTS: [(&str, f64); 4] = [("a1", 0.0), ("a2", 3.0), ("b1", 90.0), ("b2", 93.0)];

/// A secured router with services, all as processes with identities of their own.
pub(crate) struct Secured {
    services: Vec<(String, Process)>,
    routers: Vec<Process>,
    // Dropped last: it has the output of the processes.
    folder: TempDir,
}

/// Runs `muster deploy` and expects it to end well.
fn deploy(arguments: &[&str]) -> String {
    let (code, out, err) = run("muster", &[&["deploy"], arguments].concat(), SOON).unwrap();
    assert_eq!(code, Some(0), "{arguments:?}: {err}");
    out
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Writes the fleet file of the tests, with routers on loopback.
fn fleet_file(folder: &Path, robots: &str, routers: &[&str]) -> PathBuf {
    let path = folder.join("fleet.toml");
    let mut text = format!(
        "fleet = \"alpha\"\nrobots = [{robots}]\noperators = [\"op\"]\nviewers = [\"wall\"]\n"
    );
    for router in routers {
        let endpoint = free_endpoint().unwrap();
        let port = endpoint.rsplit(':').next().unwrap();
        text += &format!(
            "[[routers]]\nname = \"{router}\"\naddresses = [\"127.0.0.1\"]\nport = {port}\n"
        );
    }
    std::fs::write(&path, text).unwrap();
    path
}

impl Secured {
    pub(crate) fn start(routers: &[&str]) -> Self {
        Self::start_over("quic", routers)
    }

    /// With a protocol of all links to routers.
    fn start_over(protocol: &str, routers: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let fleet = fleet_file(folder.path(), r#""a1", "a2", "b1", "b2", "absent""#, routers);
        let members = std::fs::read_to_string(&fleet).unwrap();
        std::fs::write(&fleet, format!("protocol = \"{protocol}\"\n{members}")).unwrap();
        let mut secured = Self::start_routers(folder, &fleet, routers);
        for service in SERVICES {
            secured.start_service(service);
        }
        secured
    }

    /// The routers of a fleet file, without services.
    fn start_routers(folder: TempDir, fleet: &Path, routers: &[&str]) -> Self {
        let identities = folder.path().join("identities");
        deploy(&["certs", "--fleet-file", text(fleet), "--out", text(&identities)]);
        let mut secured = Self { services: Vec::new(), routers: Vec::new(), folder };
        for router in routers {
            let config = secured.folder.path().join(format!("{router}.json5"));
            let identity = identities.join(format!("router.{router}"));
            let (file, identity) = (text(fleet), text(&identity));
            let arguments = ["acl", "--fleet-file", file, "--router", router];
            let files = ["--identity", identity, "--out", text(&config)];
            deploy(&[&arguments[..], &files].concat());
            let arguments = ["router", "--zenoh-config", text(&config)];
            let folder = secured.folder.path();
            let mut process = Process::start("muster", &arguments, &[], folder).unwrap();
            process.until_prints("router listens at", SOON).unwrap();
            secured.routers.push(process);
        }
        secured
    }

    pub(crate) fn identity(&self, name: &str) -> PathBuf {
        self.folder.path().join("identities").join(name).join("zenoh.json5")
    }

    /// Starts one more instance of a service.
    fn start_service(&mut self, service: &str) {
        let state = self.folder.path().join("state");
        let config = self.identity(&format!("service.{service}"));
        let arguments = [
            "--fleet",
            "alpha",
            "--zenoh-config",
            text(&config),
            "--state-directory",
            text(&state),
        ];
        let program = format!("muster-{service}");
        let process = Process::start(&program, &arguments, &[], self.folder.path()).unwrap();
        self.services.push((service.to_owned(), process));
    }

    /// Removes the state files of the services, so that only their readers know it.
    fn remove_state(&self) {
        let _ = std::fs::remove_dir_all(self.folder.path().join("state"));
    }

    async fn client(&self, name: &str) -> Client {
        open(&self.identity(name), &[]).await.unwrap()
    }

    fn muster(&self, arguments: &[&str]) -> (Option<i32>, String, String) {
        self.muster_as("operator.op", arguments)
    }

    fn muster_as(&self, identity: &str, arguments: &[&str]) -> (Option<i32>, String, String) {
        let config = self.identity(identity);
        let common = ["--fleet", "alpha", "--zenoh-config", text(&config)];
        run("muster", &[arguments, &common].concat(), SOON).unwrap()
    }
}

/// Connects with an identity, of which some values are changed.
async fn open(identity: &Path, changes: &[(&str, &str)]) -> anyhow::Result<Client> {
    open_in("alpha", identity, changes).await
}

/// The same with the keys of a fleet.
async fn open_in(fleet: &str, identity: &Path, changes: &[(&str, &str)]) -> anyhow::Result<Client> {
    let fail = |error: zenoh::Error| anyhow::anyhow!("{error}");
    let mut config = zenoh::Config::from_file(identity).map_err(fail)?;
    config.insert_json5("connect/timeout_ms", REFUSED_WITHIN_MS).map_err(fail)?;
    for (key, value) in changes {
        config.insert_json5(key, value).map_err(fail)?;
    }
    Client::open(config, fleet).await
}

/// Lets robots report until the operator sees two teams made of their reports from now on.
async fn form(robots: &[(Client, f64)], teams: &Watch) -> Value {
    let since = crate::restarts::now();
    let right = |value: &Value| {
        let division = division(value);
        value["stages"][0]["received"].as_f64().is_some_and(|received| received > since)
            && division.len() == 4
            && division["a1"].is_some()
            && division["a1"] == division["a2"]
            && division["b1"] == division["b2"]
            && division["a1"] != division["b1"]
    };
    for _ in 0..200 {
        put_poses(robots).await;
        tokio::time::sleep(Duration::from_millis(100)).await;
        if let Some(teams) = teams.newest().filter(right) {
            return teams;
        }
    }
    panic!("four robots do not make two teams; the newest is {:?}", teams.newest());
}

async fn put_poses(robots: &[(Client, f64)]) {
    for ((name, _), (robot, x)) in ROBOTS.iter().zip(robots) {
        let pose = json!({"x": x, "y": 0.0});
        robot.put(&format!("robot/{name}/pose"), &pose).await.unwrap();
    }
}

async fn robots(secured: &Secured) -> Vec<(Client, f64)> {
    let mut robots = Vec::new();
    for (name, x) in ROBOTS {
        robots.push((secured.client(&format!("robot.{name}")).await, x));
    }
    robots
}
