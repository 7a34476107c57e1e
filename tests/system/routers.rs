//! Services, robots and consoles at routers of other versions of Zenoh.

use std::path::Path;
use std::time::Instant;

use muster_tests::SOON;
use muster_tests::client::division;
use muster_tests::cluster::{Cluster, SERVICES};
use muster_tests::ports::free_endpoint;
use muster_tests::process::{Process, python};
use serde_json::Value;

/// Versions of Zenoh whose router every part of Muster works with. `tests/run` installs them.
const WORK: [&str; 2] = ["1.9.0", "1.10.2"];

/// A version whose router loses answers to gets.
const LOSES_ANSWERS: &str = "1.7.2";

/// Starts the router of a version, and services at it.
pub(crate) fn start(version: &str) -> Cluster {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap();
    let packages = root.join("target/routers").join(version);
    assert!(
        packages.join("zenoh").exists(),
        "there is no eclipse-zenoh in {}; tests/run installs it",
        packages.display()
    );
    let folder = tempfile::tempdir().unwrap();
    let endpoint = free_endpoint().unwrap();
    let script = root.join("tests/peers/router.py");
    let config = root.join("deploy/router/plain.json5");
    let mut router = Process::start_at(
        &python().unwrap(),
        "router",
        &[script.to_str().unwrap(), config.to_str().unwrap(), &endpoint],
        &[("PYTHONPATH", packages.to_str().unwrap())],
        folder.path(),
    )
    .unwrap();
    router.until_prints(&format!("a router of Zenoh {version} listens"), SOON).unwrap();
    Cluster::start_at(endpoint, folder, router).unwrap()
}

#[test]
fn a_fleet_is_divided_and_found_well_at_routers_of_other_versions() {
    for version in WORK {
        let cluster = start(version);
        let _robots = cluster.robots(&["--scenario", "clusters", "--robots", "8"]).unwrap();
        let start = Instant::now();
        loop {
            let (doctor, out, err) =
                cluster.muster(&["doctor", "--json", "--listen-for", "1"]).unwrap();
            let report: Value = serde_json::from_str(&out).unwrap_or_else(|_| panic!("{out}{err}"));
            let (code, status, err) = cluster.muster(&["status"]).unwrap();
            // Services that have just been started are well, and have published nothing yet.
            let is_whole = code == Some(0)
                && SERVICES.iter().all(|service| status.contains(service))
                && status.contains("8 with a token");
            if doctor == Some(0) && is_whole {
                break;
            }
            assert!(start.elapsed() < SOON, "{version}: {report:#}{status}{err}");
        }
        let (code, out, err) = cluster.muster(&["teams", "--json"]).unwrap();
        assert_eq!(code, Some(0), "{version}: {err}");
        assert!(out.contains("\"members\""), "{version}: {out}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fleet_is_divided_at_an_old_router_that_loses_answers() {
    let cluster = start(LOSES_ANSWERS);
    let client = cluster.client().await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let _robots = cluster.robots(&["--scenario", "clusters", "--robots", "8"]).unwrap();
    let all = |teams: &Value| {
        let division = division(teams);
        division.len() == 8 && division.values().all(Option::is_some)
    };
    teams.until("eight robots have teams", SOON, all).await.unwrap();
    // What operators see of it, and the remedy.
    let start = Instant::now();
    loop {
        let (_, out, err) = cluster.muster(&["doctor", "--json", "--listen-for", "1"]).unwrap();
        let report: Value = serde_json::from_str(&out).unwrap_or_else(|_| panic!("{out}{err}"));
        let findings = report["findings"].as_array().unwrap();
        let silent = findings.iter().find(|finding| finding["id"] == "service_silent");
        if silent.is_some_and(|found| found["remedy"].to_string().contains("before 1.9")) {
            break;
        }
        assert!(start.elapsed() < SOON, "{report:#}");
    }
}
