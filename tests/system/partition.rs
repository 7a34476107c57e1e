//! Two sites with a router and all services each, whose link breaks for longer than any lease: each
//! side continues with a leader of its own, and afterwards there is one again and the same teams.

use std::time::{Duration, Instant};

use muster_tests::client::{Client, Division, Watch, division};
use muster_tests::cluster::{SERVICES, start_router};
use muster_tests::ports::free_endpoint;
use muster_tests::process::{Process, run};
use muster_tests::relay::Relay;
use serde_json::Value;
use tempfile::TempDir;

use crate::pipeline::FORMED_WITHIN;

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "3", "--robots", "12"];

/// How long the sites are apart: longer than a lease and a takeover, shorter than silent robots are kept, so that
/// both sides still know the whole fleet.
const PARTITION_TIME: Duration = Duration::from_secs(7);

/// How soon one leader is left once the sites are connected.
const AGREED_WITHIN: Duration = Duration::from_secs(10);

/// One site: a router and an instance of each service.
struct Site {
    endpoint: String,
    _router: Process,
    _services: Vec<Process>,
}

impl Site {
    fn start(folder: &TempDir, name: &str, other: Option<&str>) -> Self {
        let endpoint = free_endpoint().unwrap();
        let at = folder.path().join(name);
        std::fs::create_dir(&at).unwrap();
        let router = match other {
            None => start_router(&endpoint, &at).unwrap(),
            Some(other) => {
                let arguments = ["router", "--listen", &endpoint, "--connect", other];
                Process::start("muster", &arguments, &[], &at).unwrap()
            }
        };
        let state = at.join("state").to_string_lossy().into_owned();
        let services = SERVICES.map(|service| {
            let mut arguments = vec!["--fleet", "alpha", "--connect", &endpoint];
            arguments.extend(["--state-directory", &state]);
            if service == "clusterer" {
                arguments.extend(["--set", "teams=3"]);
            }
            Process::start(&format!("muster-{service}"), &arguments, &[], &at).unwrap()
        });
        Self { endpoint, _router: router, _services: services.into() }
    }

    fn robots(&self, folder: &TempDir, names: &[String]) -> Process {
        let names = names.join(",");
        let common = ["robot", "--fleet", "alpha", "--connect", &self.endpoint, "--only", &names];
        Process::start("muster", &[&common[..], &SCENARIO].concat(), &[], folder.path()).unwrap()
    }
}

/// How many instances of each service lead, and how many there are, seen from a site.
async fn leaders(client: &Client) -> Vec<(usize, usize)> {
    let mut counts = Vec::new();
    for service in SERVICES {
        let statuses = client.get_from_all(&format!("service/{service}/status")).await.unwrap();
        let leading = statuses.iter().filter(|status| status["standing"] == "holding").count();
        counts.push((leading, statuses.len()));
    }
    counts
}

/// Waits until one of so many instances of each service leads; how long that took.
async fn until_one_leads(client: &Client, of: usize, within: Duration, when: &str) -> Duration {
    let start = Instant::now();
    loop {
        let found = leaders(client).await;
        if found == [(1, of); 4] {
            return start.elapsed();
        }
        assert!(start.elapsed() < within, "{when}: {found:?} lead");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

/// The divisions that a reader accepts: none older than the last.
fn seen(watch: &Watch) -> Vec<Division> {
    let mut newest = (0, 0);
    let in_order = watch.all().into_iter().filter(|(_, value)| {
        let at = (value["term"].as_u64().unwrap(), value["epoch"].as_u64().unwrap());
        let counts = at >= newest;
        newest = newest.max(at);
        counts
    });
    in_order.map(|(_, value)| division(&value)).collect()
}

fn term(value: &Value) -> u64 {
    value["term"].as_u64().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn both_sides_of_a_partition_go_on_and_agree_afterwards() {
    let folder = tempfile::tempdir().unwrap();
    let here = Site::start(&folder, "here", None);
    let wire = Relay::to(&here.endpoint).await.unwrap();
    let near = Client::connect(&here.endpoint, "alpha").await.unwrap();
    until_one_leads(&near, 1, FORMED_WITHIN, "at the beginning").await;
    let there = Site::start(&folder, "there", Some(&wire.endpoint));
    let far = Client::connect_for_ever(&there.endpoint, "alpha").await.unwrap();
    let (_, list, _) =
        run("muster", &[&["robot", "--list"][..], &SCENARIO].concat(), FORMED_WITHIN).unwrap();
    let names: Vec<_> =
        list.lines().filter_map(|line| Some(line.split_whitespace().next()?.to_owned())).collect();
    assert_eq!(names.len(), 12, "{list}");
    let _robots_here = here.robots(&folder, &names[..6]);
    let _robots_there = there.robots(&folder, &names[6..]);

    let (teams_here, teams_there) =
        (near.watch("json/teams").await.unwrap(), far.watch("json/teams").await.unwrap());
    let whole = |value: &Value| {
        let teams = division(value);
        teams.len() == 12 && teams.values().all(Option::is_some)
    };
    teams_here.until("teams of all", FORMED_WITHIN, whole).await.unwrap();
    tokio::time::sleep(Duration::from_secs(3)).await;
    let wanted = division(&teams_here.newest().unwrap());
    assert_eq!(division(&teams_there.newest().unwrap()), wanted);

    teams_here.clear();
    teams_there.clear();
    wire.cut();
    tokio::time::sleep(PARTITION_TIME).await;
    // Each side has a leader of its own, and robots of both sides still receive their teams.
    assert_eq!(leaders(&near).await, [(1, 1); 4], "on the one side");
    assert_eq!(leaders(&far).await, [(1, 1); 4], "on the other side");
    let (term_here, term_there) =
        (term(&teams_here.newest().unwrap()), term(&teams_there.newest().unwrap()));
    assert!(term_there > term_here, "{term_there} began during {term_here}");

    wire.restore();
    let agreed = until_one_leads(&near, 2, AGREED_WITHIN, "after the partition").await;
    eprintln!("one leader of each service {agreed:?} after the link was restored");
    tokio::time::sleep(Duration::from_secs(3)).await;
    for (watch, side) in [(&teams_here, "here"), (&teams_there, "there")] {
        let seen = seen(watch);
        assert!(seen.len() > 2, "{side}");
        assert!(seen.iter().all(|teams| *teams == wanted), "{side}: {seen:?} and not {wanted:?}");
        assert!(term(&watch.newest().unwrap()) >= term_there, "{side}: the higher term wins");
    }
}
