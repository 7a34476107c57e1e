//! A whole team whose link is cut: nobody else changes team, and it comes back as what it was.

use std::collections::BTreeSet;
use std::time::Duration;

use muster_tests::client::{Watch, division};
use muster_tests::cluster::Cluster;
use muster_tests::relay::Relay;

use crate::pipeline::{formed, truth};

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "3", "--robots", "12"];

/// How long the link is cut: longer than robots that are silent stay in the fleet.
const CUT_TIME: Duration = Duration::from_secs(20);

/// How soon the robots are gone: 12 s after the cut, and later where a busy machine pauses `ingest`, which then
/// waits for robots as after a lost link.
const GONE_WITHIN: Duration = Duration::from_secs(40);

/// How soon all robots are back in the division.
const BACK_WITHIN: Duration = Duration::from_secs(15);

/// The teams that a robot was told, one after the other.
fn told(watch: &Watch, robot: &str) -> Vec<Option<String>> {
    let mut told: Vec<_> = watch
        .all()
        .into_iter()
        .filter(|(_, value)| value["robot"] == robot)
        .map(|(_, value)| value["team"].as_str().map(str::to_owned))
        .collect();
    told.dedup();
    told
}

/// Cuts the link of one of three camps, and restores it.
///
/// The bus is plain, where the robots of the camp return together. With a link for each they return one by one, and
/// with a number of teams that is fixed the first one may be told another team.
async fn cut_one_of_three(teams_setting: &str) {
    let cluster = Cluster::start("alpha", &[("clusterer", teams_setting)]).unwrap();
    let camps = truth(&cluster, &SCENARIO);
    let groups: BTreeSet<&String> = camps.values().collect();
    assert_eq!(groups.len(), 3, "{camps:?}");
    let cut_off = groups.last().copied().unwrap();
    let wire = Relay::to(&cluster.endpoint).await.unwrap();
    let robots = |endpoint: &str, is_cut_off: bool| {
        let of_camp = camps.iter().filter(|(_, camp)| (*camp == cut_off) == is_cut_off);
        let names: Vec<&str> = of_camp.map(|(robot, _)| robot.as_str()).collect();
        let names = names.join(",");
        cluster.robots_at(endpoint, &[&SCENARIO[..], &["--only", &names]].concat()).unwrap()
    };
    let _there = robots(&cluster.endpoint, false);
    let _cut_off = robots(&wire.endpoint, true);
    let client = cluster.client().await.unwrap();
    let wanted = formed(&client, &camps).await;
    tokio::time::sleep(Duration::from_secs(2)).await;
    let teams = client.watch("json/teams").await.unwrap();
    let robot_teams = client.watch("robot/*/team").await.unwrap();

    wire.cut();
    let others = camps.values().filter(|camp| *camp != cut_off).count();
    let without = |value: &serde_json::Value| division(value).len() == others;
    teams.until("the division without them", GONE_WITHIN, without).await.unwrap();
    tokio::time::sleep(CUT_TIME.saturating_sub(Duration::from_secs(12))).await;
    let away = teams.newest().unwrap();
    teams.clear();
    wire.restore();
    let whole = |value: &serde_json::Value| division(value) == wanted;
    let back = teams.until("all are back in their teams", BACK_WITHIN, whole).await;
    tokio::time::sleep(Duration::from_secs(2)).await;

    for robot in camps.keys() {
        let told = told(&robot_teams, robot);
        assert!(told.iter().all(|team| *team == wanted[robot]), "{robot} was told {told:?}");
    }
    assert!(division(&away).iter().all(|(robot, team)| *team == wanted[robot]), "{away}");
    for (_, value) in teams.all() {
        for (robot, team) in division(&value) {
            assert_eq!(team, wanted[&robot], "{robot} in {value}");
        }
    }
    back.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_team_of_a_fixed_number_that_is_cut_off_moves_nobody_else() {
    cut_one_of_three("teams=3").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_team_of_a_chosen_number_that_is_cut_off_moves_nobody_else() {
    cut_one_of_three("teams=auto").await;
}
