//! Robots on a bus become teams, and late subscribers receive everything.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use muster_tests::client::{Client, Division, division};
use muster_tests::cluster::Cluster;
use serde_json::{Value, json};

/// How long a fleet may take from nothing to teams: a dozen programs start, without optimisation, and another test has the
/// processors for seconds. It only ends a test that hangs; what is promised has bounds of its own.
pub(crate) const FORMED_WITHIN: Duration = Duration::from_secs(40);

/// The groups of a scenario, as `muster robot --list` prints them.
pub(crate) fn truth(cluster: &Cluster, scenario: &[&str]) -> BTreeMap<String, String> {
    let (code, out, err) = cluster.muster(&[&["robot", "--list"], scenario].concat()).unwrap();
    assert_eq!(code, Some(0), "{err}");
    out.lines()
        .map(|line| {
            let (robot, group) = line.split_once(' ').unwrap();
            (robot.to_owned(), group.to_owned())
        })
        .collect()
}

/// The sets of robots that are together, whatever they are called.
pub(crate) fn groups<T: Ord>(
    of: impl IntoIterator<Item = (String, T)>,
) -> BTreeSet<BTreeSet<String>> {
    let mut groups: BTreeMap<T, BTreeSet<String>> = BTreeMap::new();
    for (robot, group) in of {
        groups.entry(group).or_default().insert(robot);
    }
    groups.into_values().collect()
}

/// Waits until the division has the groups of the truth.
pub(crate) async fn formed(client: &Client, truth: &BTreeMap<String, String>) -> Division {
    let teams = client.watch("json/teams").await.unwrap();
    let wanted = groups(truth.clone());
    let right = |value: &Value| {
        let division = division(value);
        division.values().all(Option::is_some) && groups(division) == wanted
    };
    division(&teams.until("the right teams", FORMED_WITHIN, right).await.unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fleet_forms_the_right_teams() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=3")]).unwrap();
    let scenario = ["--scenario", "clusters", "--teams", "3", "--robots", "18"];
    let _robots = cluster.robots(&scenario).unwrap();
    let client = cluster.client().await.unwrap();
    let division = formed(&client, &truth(&cluster, &scenario)).await;
    let ids: BTreeSet<_> = division.values().flatten().cloned().collect();
    assert_eq!(ids.len(), 3);
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_in_bincode_form_the_same_teams() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let scenario = ["--scenario", "clusters", "--robots", "10"];
    let _robots = cluster.robots(&[&scenario[..], &["--bincode"]].concat()).unwrap();
    let client = cluster.client().await.unwrap();
    formed(&client, &truth(&cluster, &scenario)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn ten_lines_of_json_make_a_robot() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let client = cluster.client().await.unwrap();
    let robot_teams = client.watch("robot/*/team").await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let places = [("a1", 0.0), ("a2", 3.0), ("a3", 6.0), ("b1", 90.0), ("b2", 93.0), ("b3", 96.0)];
    let right = |value: &Value| {
        let division = division(value);
        division.len() == 6
            && value["data_age_s"].as_f64().is_some_and(|age| age < 2.0)
            && division["a1"] == division["a2"]
            && division["a1"] == division["a3"]
            && division["b1"] == division["b3"]
            && division["a1"] != division["b1"]
    };
    let mut formed = None;
    let start = Instant::now();
    while start.elapsed() < FORMED_WITHIN {
        for (robot, x) in places {
            client.put(&format!("robot/{robot}/pose"), &json!({"x": x, "y": 0.0})).await.unwrap();
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
        formed = teams.newest().filter(right);
        if formed.is_some() {
            break;
        }
    }
    let formed = formed.expect("six poses make two teams");
    for field in ["fleet", "term", "epoch", "data_age_s", "teams", "unassigned", "stages"] {
        assert!(formed.get(field).is_some(), "{field} is missing in {formed}");
    }
    let stages: Vec<_> =
        formed["stages"].as_array().unwrap().iter().map(|stage| stage["stage"].clone()).collect();
    assert_eq!(stages, ["ingest", "embedder", "clusterer"]);

    let right =
        |value: &Value| value["robot"] == "b2" && value["members"] == json!(["b1", "b2", "b3"]);
    let mine =
        robot_teams.until("b2 receives its team", Duration::from_secs(3), right).await.unwrap();
    assert_eq!(
        Some(&mine["team"]),
        formed["teams"].as_array().unwrap().iter().find_map(|team| {
            team["members"].as_array().unwrap().contains(&json!("b2")).then(|| &team["id"])
        })
    );
    assert!(mine["confidence"].as_f64().unwrap() > 0.5);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_late_subscriber_gets_everything() {
    let cluster = Cluster::start(
        "alpha",
        &[("ingest", "modalities=[\"thermal\"]"), ("clusterer", "teams=2")],
    )
    .unwrap();
    let scenario = ["--scenario", "clusters", "--robots", "8"];
    let _robots = cluster.robots(&scenario).unwrap();
    let truth = truth(&cluster, &scenario);
    let first = cluster.client().await.unwrap();
    let formed = formed(&first, &truth).await;

    let late = cluster.client().await.unwrap();
    for key in ["teams?format=json", "json/teams"] {
        assert_eq!(division(&late.get_one(key).await.unwrap()), formed, "{key}");
    }
    let judged = |audit: &Value| {
        audit["silhouette"]["per_robot"].as_object().is_some_and(|all| all.len() == 8)
    };
    // The auditor judges a division after it was published; until the first there is no answer.
    let audit = late.until("json/audit", Duration::from_secs(10), judged).await.unwrap();
    assert_eq!(audit["space"], "embedding");
    assert_eq!(audit["physical"]["space"], "physical");
    assert!(audit["silhouette"]["mean"].as_f64().unwrap() > 0.5, "{audit}");
    assert!(audit["physical"]["mean"].as_f64().unwrap() > 0.5, "{audit}");

    let graphs = late.get("graph/*?format=json", None).await.unwrap();
    let names: BTreeSet<_> = graphs.iter().map(|(key, _)| key.as_str()).collect();
    let wanted = ["graph/connectivity", "graph/hierarchy", "graph/spatial", "graph/thermal"];
    assert_eq!(names, BTreeSet::from(wanted));
    let spatial = late.get_one("graph/spatial?format=json").await.unwrap();
    assert_eq!(spatial["robots"].as_array().unwrap().len(), 8);
    assert!(!spatial["edges"].as_array().unwrap().is_empty());

    let roster = late.get_one("roster?format=json").await.unwrap();
    assert_eq!(roster["robots"].as_array().unwrap().len(), 8);
    let embedding = late.get_one("embedding?format=json").await.unwrap();
    assert_eq!(embedding["robots"].as_array().unwrap().len(), 8);
    assert!(embedding["quality"]["residual"].as_f64().unwrap() < 1e-8);
    let robot = truth.keys().next().unwrap();
    let team = late.get_one(&format!("robot/{robot}/team")).await.unwrap();
    assert_eq!(team["team"].as_str().map(str::to_owned), formed[robot]);
    let all = late.get("robot/*/team", None).await.unwrap();
    assert_eq!(all.iter().map(|(key, _)| key).collect::<BTreeSet<_>>().len(), 8);

    let teams = late.watch("json/teams").await.unwrap();
    let heartbeat = teams.until("the heartbeat", Duration::from_secs(5), |_| true).await.unwrap();
    assert_eq!(division(&heartbeat), formed);
}

#[tokio::test(flavor = "multi_thread")]
async fn two_fleets_on_one_bus_do_not_see_each_other() {
    let alpha = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let mut beta = Cluster::start("beta", &[("clusterer", "teams=2")]).unwrap();
    beta.endpoint = alpha.endpoint.clone();
    for service in muster_tests::cluster::SERVICES {
        beta.start_service(service).unwrap();
    }
    let (of_alpha, of_beta) = (
        ["--scenario", "clusters", "--robots", "8", "--seed", "1"],
        ["--scenario", "clusters", "--robots", "12", "--seed", "2"],
    );
    let _robots = (alpha.robots(&of_alpha).unwrap(), beta.robots(&of_beta).unwrap());
    let clients = (alpha.client().await.unwrap(), beta.client().await.unwrap());
    let events = (
        clients.0.watch("json/event").await.unwrap(),
        clients.1.watch("json/event").await.unwrap(),
    );
    let formed_alpha = formed(&clients.0, &truth(&alpha, &of_alpha)).await;
    let formed_beta = formed(&clients.1, &truth(&beta, &of_beta)).await;
    assert_eq!((formed_alpha.len(), formed_beta.len()), (8, 12));
    for (events, fleet) in [(events.0, "alpha"), (events.1, "beta")] {
        for (_, event) in events.all() {
            assert_eq!(event["fleet"], fleet);
            assert_ne!(event["event"], "quarantined", "{event}");
        }
    }
}
