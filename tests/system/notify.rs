//! What the programs report to a service manager, and when it would restart them.

use std::time::Duration;

use muster_tests::SOON;
use muster_tests::cluster::{SERVICES, start_router};
use muster_tests::manager::Manager;
use muster_tests::ports::free_endpoint;
use muster_tests::process::Process;

/// Within which the manager wants a notice that the loop runs.
const WATCHDOG: Duration = Duration::from_secs(2);

/// How long watchdog notices are counted: the loop sends four per deadline, and on a busy machine at least one.
const COUNTING_TIME: Duration = Duration::from_secs(4);

/// Fewest notices in that time with which a manager does not restart the program.
const MIN_NOTICES: usize = 2;

fn start(manager: &Manager, name: &str, arguments: &[&str], folder: &std::path::Path) -> Process {
    let environment = manager.environment(WATCHDOG);
    let environment: Vec<_> =
        environment.iter().map(|(name, value)| (name.as_str(), value.as_str())).collect();
    Process::start(name, arguments, &environment, folder).unwrap()
}

#[test]
fn a_service_is_ready_and_fed_through_outages_of_its_router() {
    let folder = tempfile::tempdir().unwrap();
    let mut manager = Manager::listen(folder.path()).unwrap();
    let endpoint = free_endpoint().unwrap();
    let arguments = ["--connect", &endpoint, "--state-directory", "none"];
    let mut service = start(&manager, "muster-clusterer", &arguments, folder.path());

    // Without a router it has started all the same, reports what it waits for, and is not restarted.
    manager.until("READY=1", SOON).unwrap();
    manager.until(&format!("STATUS=waiting for a router at {endpoint}"), SOON).unwrap();
    assert!(manager.fed_in(COUNTING_TIME) >= MIN_NOTICES, "{:?}", manager.received);
    let router = start_router(&endpoint, folder.path()).unwrap();
    manager.until("STATUS=clusterer serves fleet default", SOON).unwrap();
    assert!(manager.fed_in(COUNTING_TIME) >= MIN_NOTICES, "{:?}", manager.received);
    drop(router);
    manager.until("STATUS=the link to the router is lost", SOON).unwrap();
    assert!(manager.fed_in(COUNTING_TIME) >= MIN_NOTICES, "{:?}", manager.received);
    manager.received.clear();
    let _router = start_router(&endpoint, folder.path()).unwrap();
    manager.until("STATUS=clusterer serves fleet default", SOON).unwrap();

    assert!(!manager.received.iter().any(|line| line == "READY=1"), "a process is ready once");
    service.signal("TERM").unwrap();
    manager.until("STOPPING=1", SOON).unwrap();
    assert_eq!(service.wait(Duration::from_secs(5)).unwrap().code(), Some(0));
}

#[test]
fn every_program_reports_that_it_is_ready_and_that_it_stops() {
    let folder = tempfile::tempdir().unwrap();
    let endpoint = free_endpoint().unwrap();
    let of_router = tempfile::tempdir().unwrap();
    let mut router_manager = Manager::listen(of_router.path()).unwrap();
    let arguments = ["router", "--listen", &endpoint];
    let mut router = start(&router_manager, "muster", &arguments, folder.path());
    router_manager.until("READY=1", SOON).unwrap();
    router_manager.until("STATUS=router listens at", SOON).unwrap();
    assert!(router_manager.fed_in(COUNTING_TIME) >= MIN_NOTICES, "{:?}", router_manager.received);

    let mut programs: Vec<_> =
        SERVICES.iter().map(|service| (format!("muster-{service}"), vec![])).collect();
    programs.push(("muster".to_owned(), vec!["up"]));
    for (program, command) in programs {
        let own = tempfile::tempdir().unwrap();
        let mut manager = Manager::listen(own.path()).unwrap();
        let common = ["--connect", endpoint.as_str(), "--state-directory", "none"];
        let arguments = [command.as_slice(), &common].concat();
        let mut process = start(&manager, &program, &arguments, folder.path());
        manager.until("READY=1", SOON).unwrap();
        manager.until("serves fleet default", SOON).unwrap();
        assert!(manager.fed_in(COUNTING_TIME) >= MIN_NOTICES, "{program}: {:?}", manager.received);
        process.signal("TERM").unwrap();
        manager.until("STOPPING=1", SOON).unwrap();
        assert_eq!(process.wait(Duration::from_secs(5)).unwrap().code(), Some(0));
    }
    router.signal("TERM").unwrap();
    router_manager.until("STOPPING=1", SOON).unwrap();
    assert_eq!(router.wait(Duration::from_secs(5)).unwrap().code(), Some(0));
}
