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

/// Time between two robots that return one after the other.
const RETURN_PAUSE: Duration = Duration::from_millis(700);

/// How the robots of a camp return.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Return {
    /// All have one link.
    Together,
    /// Each has a link of its own.
    OneByOne,
}

/// Cuts the links of one of three camps, and restores them.
async fn cut_one_of_three(teams_setting: &str, how: Return) {
    let cluster = Cluster::start("alpha", &[("clusterer", teams_setting)]).unwrap();
    let camps = truth(&cluster, &SCENARIO);
    let groups: BTreeSet<&String> = camps.values().collect();
    assert_eq!(groups.len(), 3, "{camps:?}");
    let cut_off = groups.last().copied().unwrap();
    let of_camp = |is_cut_off: bool| -> Vec<&str> {
        let of_camp = camps.iter().filter(|(_, camp)| (*camp == cut_off) == is_cut_off);
        of_camp.map(|(robot, _)| robot.as_str()).collect()
    };
    let robots = |endpoint: &str, names: &[&str]| {
        let names = names.join(",");
        cluster.robots_at(endpoint, &[&SCENARIO[..], &["--only", &names]].concat()).unwrap()
    };
    let _there = robots(&cluster.endpoint, &of_camp(false));
    let all_away = of_camp(true);
    let with_one_link = match how {
        Return::Together => all_away.len(),
        Return::OneByOne => 1,
    };
    let (mut wires, mut cut_robots) = (Vec::new(), Vec::new());
    for names in all_away.chunks(with_one_link) {
        let wire = Relay::to(&cluster.endpoint).await.unwrap();
        cut_robots.push(robots(&wire.endpoint, names));
        wires.push(wire);
    }
    let client = cluster.client().await.unwrap();
    let wanted = formed(&client, &camps).await;
    tokio::time::sleep(Duration::from_secs(2)).await;
    let teams = client.watch("json/teams").await.unwrap();
    let robot_teams = client.watch("robot/*/team").await.unwrap();

    wires.iter().for_each(Relay::cut);
    let others = camps.values().filter(|camp| *camp != cut_off).count();
    let without = |value: &serde_json::Value| division(value).len() == others;
    teams.until("the division without them", GONE_WITHIN, without).await.unwrap();
    tokio::time::sleep(CUT_TIME.saturating_sub(Duration::from_secs(12))).await;
    let away = teams.newest().unwrap();
    teams.clear();
    for wire in &wires {
        wire.restore();
        tokio::time::sleep(RETURN_PAUSE).await;
    }
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
    cut_one_of_three("teams=3", Return::Together).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_robots_of_a_team_of_a_fixed_number_return_one_by_one_to_it() {
    cut_one_of_three("teams=3", Return::OneByOne).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_team_of_a_chosen_number_that_is_cut_off_moves_nobody_else() {
    cut_one_of_three("teams=auto", Return::OneByOne).await;
}
