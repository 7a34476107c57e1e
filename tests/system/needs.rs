//! Needs of teams, over the bus: the medic of a team is killed, and another one comes.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use muster_tests::cluster::{Cluster, Robots};
use serde_json::Value;

use crate::pipeline::FORMED_WITHIN;

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "2", "--robots", "10"];

/// How long after the death of a medic is noticed its team may be without one: it gets one with the next division, and not only after
/// the dwell of half a minute.
const PROMISED_TIME: Duration = Duration::from_secs(8);

const NEEDS: &str = r#"needs=[{"skill":"medic","per_team":{"min":1}}]"#;

/// What each team has of what it needs, in the order of the teams.
fn have(teams: &Value) -> Vec<u64> {
    let needs = teams["needs"].as_array().into_iter().flatten();
    needs.filter_map(|need| need["have"].as_u64()).collect()
}

/// The team of a robot.
fn team_of(teams: &Value, robot: &str) -> Option<String> {
    let all = teams["teams"].as_array()?;
    let is_in = |team: &&Value| {
        team["members"].as_array().is_some_and(|members| members.iter().any(|name| name == robot))
    };
    Some(all.iter().find(is_in)?["id"].as_str()?.to_owned())
}

fn start(cluster: &Cluster, only: &[&str], skills: &[&str]) -> Robots {
    let names = only.join(",");
    let robots = cluster.robots(&[&SCENARIO[..], &["--only", &names], skills].concat());
    robots.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn when_a_medic_is_killed_another_one_comes_and_where_there_is_none_an_alert_says_so() {
    // None is kept in its team by the dwell alone.
    let settings =
        [("clusterer", "teams=2"), ("clusterer", "dwell_s=30.0"), ("auditor", "alert_after_s=0.5")];
    let cluster = Cluster::start("alpha", &settings).unwrap();
    let truth = muster_tests::cluster::robots_of(&SCENARIO).unwrap();
    let group = |number: usize| -> Vec<&str> {
        let groups: BTreeSet<&String> = truth.values().collect();
        let name = *groups.iter().nth(number).unwrap();
        truth.iter().filter(|(_, group)| *group == name).map(|(robot, _)| robot.as_str()).collect()
    };
    let (first, second) = (group(0), group(1));
    // Two medics in the first group, one in the second.
    let (one, two, lone) =
        (first[first.len() - 1], first[first.len() - 2], second[second.len() - 1]);
    let others: Vec<&str> =
        truth.keys().map(String::as_str).filter(|name| ![one, two, lone].contains(name)).collect();
    let medic = ["--skills", "medic,driver"];
    let mut killed = start(&cluster, &[lone], &medic);
    let _spare = start(&cluster, &[one], &medic);
    let mut last = start(&cluster, &[two], &medic);
    let _others = start(&cluster, &others, &[]);
    let client = cluster.client().await.unwrap();
    let watch = client.watch("json/teams").await.unwrap();
    let events = client.watch("json/event").await.unwrap();
    let all = |value: &Value| {
        let members = |team: &Value| team["members"].as_array().map_or(0, Vec::len);
        value["teams"].as_array().is_some_and(|all| all.iter().map(members).sum::<usize>() == 10)
    };
    watch.until("ten robots", FORMED_WITHIN, all).await.unwrap();

    let wrong = NEEDS.replace(":1", ":2");
    let (code, _, err) = cluster.muster(&["set", "clusterer", &wrong]).unwrap();
    assert_eq!(code, Some(2), "{err}");
    assert!(err.contains("3 robots with medic for 2 teams, which need 4"), "{err}");
    let (code, _, err) = cluster.muster(&["set", "clusterer", NEEDS]).unwrap();
    assert_eq!(code, Some(0), "{err}");
    let filled = |value: &Value| {
        let have = have(value);
        have.len() == 2 && have.iter().all(|have| *have > 0)
    };
    let division = watch.until("filled needs", Duration::from_secs(5), filled).await.unwrap();
    let home = team_of(&division, lone).unwrap();
    assert_ne!(Some(&home), team_of(&division, one).as_ref(), "{division}");

    events.clear();
    watch.clear();
    killed.kill().unwrap();
    let is_stale = |value: &Value| {
        value["event"].as_str().is_some_and(|event| event.starts_with("robot"))
            && value.to_string().contains(lone)
    };
    events.until("a stale medic", Duration::from_secs(10), is_stale).await.unwrap();
    let noticed = Instant::now();
    let replaced = |value: &Value| {
        filled(value)
            && [one, two].iter().any(|robot| team_of(value, robot).as_ref() == Some(&home))
    };
    watch.until("another medic", PROMISED_TIME, replaced).await.unwrap();
    assert!(noticed.elapsed() <= PROMISED_TIME);
    let reason = format!("{lone} is silent");
    let is_filled = |value: &Value| {
        value["event"] == "need_filled" && value["reason"].as_str() == Some(&reason)
    };
    let event = events.until("why", Duration::from_secs(10), is_filled).await.unwrap();
    assert_eq!(event["skill"], "medic");

    // The last but one is killed as well: the division goes on, and says what is missing.
    last.kill().unwrap();
    let lacks = |value: &Value| {
        value["conflict"].as_str() == Some("1 robot with medic for 2 teams, which need 2")
    };
    watch.until("a conflict", Duration::from_secs(10), lacks).await.unwrap();
    let is_raised = |value: &Value| value["event"] == "alert_raised" && value["kind"] == "lacking";
    let event = events.until("an alert", Duration::from_secs(10), is_raised).await.unwrap();
    assert!(
        event["reason"].as_str().is_some_and(|text| text.contains("0 of 1 with medic")),
        "{event}"
    );
    let audit = client.get_one("audit?format=json").await.unwrap();
    let text = audit["teams"].to_string();
    assert!(text.contains("medic") && text.contains("driver"), "{text}");
}
