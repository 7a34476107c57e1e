//! What if, over the bus and from the command line: a proposal is looked at, accepted and becomes the division, or is
//! dropped; what does not work is refused; and the live division waits for no proposal.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use muster_tests::SOON;
use muster_tests::access::Security;
use muster_tests::client::{Client, Watch, division};
use muster_tests::cluster::{Cluster, ClusterOptions, robots_of};
use serde_json::{Value, json};

use crate::pipeline::{FORMED_WITHIN, formed, groups, truth};

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "3", "--robots", "12"];
/// How long a division at rest stands: `dwell_s`, after which a pending change counts, several times.
const STANDS: Duration = Duration::from_secs(3);

type Division = BTreeMap<String, Option<String>>;

/// What a command that succeeds prints as JSON.
fn json_of(cluster: &Cluster, arguments: &[&str]) -> Value {
    let (code, out, err) = cluster.muster(&[arguments, &["--json"]].concat()).unwrap();
    assert_eq!(code, Some(0), "{arguments:?}: {err}");
    serde_json::from_str(&out).unwrap_or_else(|error| panic!("{error}: {out}"))
}

/// What a command that is refused says.
fn refusal(cluster: &Cluster, arguments: &[&str]) -> String {
    let (code, out, err) = cluster.muster(arguments).unwrap();
    assert_eq!(code, Some(2), "{arguments:?}: {out}{err}");
    err
}

/// The team of each robot in a proposal.
fn proposed(proposal: &Value) -> Division {
    let proposal = &proposal["division"];
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let mut all = Division::new();
    for team in proposal["teams"].as_array().into_iter().flatten() {
        for robot in team["members"].as_array().into_iter().flatten() {
            all.insert(text(robot), Some(text(&team["id"])));
        }
    }
    for robot in proposal["unassigned"].as_array().into_iter().flatten() {
        all.insert(text(robot), None);
    }
    all
}

/// The live division, once it has so many teams and has stood long enough that no change of it is pending.
async fn at_rest(watch: &Watch, teams: usize) -> Division {
    let has = |value: &Value| {
        let division = division(value);
        division.len() == 12
            && division.values().all(Option::is_some)
            && groups(division).len() == teams
    };
    let mut last = division(&watch.until("the teams", FORMED_WITHIN, has).await.unwrap());
    let mut since = Instant::now();
    while since.elapsed() < STANDS {
        watch.clear();
        let next = division(&watch.until("the teams again", SOON, has).await.unwrap());
        if next != last {
            since = Instant::now();
        }
        last = next;
    }
    last
}

async fn becomes(watch: &Watch, wanted: &Division) {
    let is = |value: &Value| division(value) == *wanted;
    watch.until("the division that was proposed", SOON, is).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_proposal_is_looked_at_accepted_and_becomes_the_division() {
    let mut cluster =
        Cluster::start_drawn("a_proposal", &[("clusterer", "teams=2")], &SCENARIO).unwrap();
    let (code, _, err) = cluster.muster(&["propose", "--teams", "3"]).unwrap();
    assert!(code == Some(3) && err.contains("no answer for propose/"), "no planner runs: {err}");
    cluster.start_service("planner").unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let truth = truth(&cluster, &SCENARIO);
    let client = cluster.client().await.unwrap();
    let watch = client.watch("json/teams").await.unwrap();
    let live = at_rest(&watch, 2).await;

    // What changes nothing is the live division.
    let same = json_of(&cluster, &["propose", "--teams", "2"]);
    assert_eq!((&same["state"], &same["division"]["moves"]), (&json!("ready"), &json!([])));
    assert_eq!(proposed(&same), live);
    assert_eq!(same["division"]["change"]["mean"], 0.0);

    // Three teams are the groups that there are; nobody is told of it.
    let three = json_of(&cluster, &["propose", "--teams", "3", "--id", "three"]);
    let wanted = proposed(&three);
    assert_eq!(groups(wanted.clone()), groups(truth));
    assert!(three["division"]["change"]["mean"].as_f64().unwrap() > 0.0, "{three}");
    let moves = three["division"]["moves"].as_array().unwrap();
    assert!(moves.iter().all(|one| one["to"] == "t3" && one["from"] != one["to"]), "{moves:?}");
    let (code, out, err) = cluster.muster(&["propose", "show", "three"]).unwrap();
    assert_eq!(code, Some(0), "{err}");
    for part in ["3 teams instead of 2", "robots would move", "muster propose accept three"] {
        assert!(out.contains(part), "{part}: {out}");
    }
    let (code, out, _) = cluster.muster(&["propose", "list"]).unwrap();
    assert!(code == Some(0) && out.contains("three") && out.contains("{\"teams\":2}"), "{out}");
    for (_, value) in watch.all() {
        assert_eq!(division(&value), live, "a proposal changes nothing");
    }

    let accepted = json_of(&cluster, &["propose", "accept", "three"]);
    let set = json!([{"service": "clusterer", "set": {"teams": 3}}]);
    assert_eq!(accepted["applied"], set);
    becomes(&watch, &wanted).await;
    let err = refusal(&cluster, &["propose", "show", "three"]);
    assert!(err.contains("/three is not there"), "an accepted proposal is dropped: {err}");

    // Without a robot, and with other weights: it is in reserve by a wish.
    let live = at_rest(&watch, 3).await;
    let robot = live.keys().next().unwrap().clone();
    let weights = ["--weights", "spatial=0.6,connectivity=0.3,hierarchy=0.1"];
    let asked = [&["propose", "--without", &robot, "--id", "less"][..], &weights].concat();
    let less = json_of(&cluster, &asked);
    assert_eq!(proposed(&less)[&robot], None);
    let accepted = json_of(&cluster, &["propose", "accept", "less"]);
    assert_eq!(accepted["applied"].as_array().map(Vec::len), Some(2), "{accepted}");
    becomes(&watch, &proposed(&less)).await;
    let (_, out, _) = cluster.muster(&["wish", "list"]).unwrap();
    assert!(out.contains("/propose-less  reserve") && out.contains(&robot), "{out}");
    let embedder = json_of(&cluster, &["set", "embedder"]);
    assert_eq!(embedder["weights"]["spatial"], 0.6);
}

#[tokio::test(flavor = "multi_thread")]
async fn proposals_are_dropped_refused_and_accepted_as_a_whole_or_not_at_all() {
    let mut cluster = Cluster::start("alpha", &[("clusterer", "teams=3")]).unwrap();
    cluster.start_service("planner").unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let live = formed(&client, &truth(&cluster, &SCENARIO)).await;

    for (arguments, part) in [
        (&["propose"][..], "say what is to be different"),
        (&["propose", "--without", "nobody"], "without: nobody is not in the fleet"),
        (&["propose", "--teams", "3", "--size", "..2"], "12 robots may only be in"),
        (&["propose", "--weights", "spatial=0.2"], "weights"),
        (&["propose", "--needs", "medic=1"], "0 robots with medic for 3 teams"),
        (&["propose", "accept", "p9"], "/p9 is not there"),
        (&["propose", "drop", "p9"], "/p9 is not there"),
    ] {
        let err = refusal(&cluster, arguments);
        assert!(err.contains(part), "{arguments:?}: {err}");
    }

    json_of(&cluster, &["propose", "--teams", "2"]);
    let dropped = json_of(&cluster, &["propose", "drop", "p1"]);
    assert_eq!((&dropped["state"], &dropped["division"]), (&json!("dropped"), &Value::Null));
    let (_, out, _) = cluster.muster(&["propose", "list"]).unwrap();
    assert!(out.contains("no open proposals"), "{out}");

    // Somebody changes the same setting meanwhile.
    json_of(&cluster, &["propose", "--teams", "2"]);
    json_of(&cluster, &["set", "clusterer", "teams=4"]);
    let err = refusal(&cluster, &["propose", "accept", "p1"]);
    assert!(err.contains("teams of clusterer was changed since"), "{err}");
    json_of(&cluster, &["set", "clusterer", "teams=3"]);

    // Somebody pins a robot that the proposal leaves out: what was applied before is taken back.
    let robot = live.keys().next().unwrap().clone();
    let asked = ["propose", "--size", "2..6", "--without", &robot, "--id", "both"];
    json_of(&cluster, &asked);
    let team = live[&robot].clone().unwrap();
    json_of(&cluster, &["wish", "pin", &robot, &team]);
    let (code, _, err) = cluster.muster(&["propose", "accept", "both"]).unwrap();
    assert_eq!(code, Some(1), "{err}");
    assert!(err.contains("the proposal is not applied") && err.contains(&robot), "{err}");
    let settings = json_of(&cluster, &["set", "clusterer"]);
    assert_eq!(settings["size"], json!({"min": null, "max": null}), "all or nothing");
    let (_, out, _) = cluster.muster(&["wish", "list"]).unwrap();
    assert!(!out.contains("reserve"), "{out}");
}

/// How many divisions the clusterer has published.
async fn published(client: &Client) -> u64 {
    let status = client.get_one("service/clusterer/status").await.unwrap();
    status["counters"]["divisions_published"].as_u64().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_live_division_waits_for_no_proposal() {
    const MORE: u64 = 5;
    let robots: Vec<String> = robots_of(&SCENARIO).unwrap().into_keys().collect();
    let mut cluster = Cluster::start_by(&ClusterOptions {
        security: Security::Secured,
        settings: &[("clusterer", "teams=3")],
        robots: &robots,
        ..ClusterOptions::default()
    })
    .unwrap();
    cluster.start_service("planner").unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let watch = client.watch("json/teams").await.unwrap();
    let live = formed(&client, &truth(&cluster, &SCENARIO)).await;
    json_of(&cluster, &["propose", "--teams", "2"]);

    // A computation that does not end: the planner stands still in the middle of a proposal.
    cluster.service("planner").unwrap().signal("STOP").unwrap();
    let (code, _, err) = cluster.muster(&["propose", "--teams", "4", "--wait", "1"]).unwrap();
    assert_eq!(code, Some(3), "nobody answers: {err}");
    let before = published(&client).await;
    while published(&client).await < before + MORE {
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    // It goes on, and follows what operators change.
    json_of(&cluster, &["set", "clusterer", "teams=2"]);
    let two = |value: &Value| groups(division(value)).len() == 2;
    watch.until("two teams", SOON, two).await.unwrap();
    json_of(&cluster, &["set", "clusterer", "teams=3"]);
    let three = |value: &Value| groups(division(value)) == groups(live.clone());
    watch.until("three teams", SOON, three).await.unwrap();

    // The planner runs again, and answers.
    cluster.service("planner").unwrap().signal("CONT").unwrap();
    let again =
        client.until("service/planner/status", SOON, |status| status["standing"] == "holding");
    again.await.unwrap();
    let proposal = json_of(&cluster, &["propose", "--teams", "2", "--id", "again"]);
    assert_eq!(proposal["division"]["teams"].as_array().map(Vec::len), Some(2));

    // Nobody asks under the name of another, and what a planner had is lost with it.
    let (code, _, err) = cluster.muster(&["propose", "--teams", "2", "--operator", "kim"]).unwrap();
    assert!(code == Some(1) && err.contains("denied: planner"), "{code:?} {err}");
    cluster.service("planner").unwrap().kill().unwrap();
    cluster.start_service("planner").unwrap();
    let again =
        client.until("service/planner/status", SOON, |status| status["standing"] == "holding");
    again.await.unwrap();
    let err = refusal(&cluster, &["propose", "show", "again"]);
    assert!(err.contains("/again is not there"), "{err}");
}
