//! The clusterer on a bench: what it divides, what it tells whom, and when.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    missing_docs,
    unreachable_pub,
    reason = "this is a test, and so are its helpers"
)]

mod common;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use common::{
    Bench, START, again, embedding, from_rows, header, leaders, robot, roster, short, told,
};
use muster_clusterer::Clusterer;
use muster_machine::{Core, Event, START_FETCH, Stored};
use muster_model::embedding::Embedding;
use muster_model::event::EventKind;
use muster_model::header::Revision;
use muster_model::id::{RobotId, ServiceName, TeamId};
use muster_model::settings::ClustererSettings;
use muster_model::teams::Teams;
use muster_wire::{Key, Message, Pattern, Rejection};
use proptest::prelude::*;

const WEST: [f64; 2] = [0.0, 0.0];
const EAST: [f64; 2] = [1.0, 0.0];
const NORTH: [f64; 2] = [0.0, 1.0];

fn teams(teams: u32) -> ClustererSettings {
    ClustererSettings { teams, restarts: 10, ..ClustererSettings::default() }
}

fn mirrored(teams: &Arc<Teams>) -> Message {
    Message::Teams { teams: Arc::clone(teams), mirror: false }
}

/// A bench that has divided one embedding.
fn divided(settings: ClustererSettings, first: &Arc<Embedding>) -> (Bench, Arc<Teams>) {
    let mut bench = Bench::begun(settings);
    bench.hear(first);
    let division = bench.division();
    (bench, division)
}

#[test]
fn the_wiring_is_that_of_the_role() {
    let wiring = Clusterer::wiring();
    let patterns: Vec<_> = wiring.subscriptions.iter().map(|s| s.pattern.clone()).collect();
    assert_eq!(patterns, [Pattern::One(Key::Embedding), Pattern::One(Key::Roster)]);
    assert!(wiring.served.contains(&(Pattern::RobotTeams, true)));
    assert!(wiring.served.contains(&(Pattern::One(Key::Embedding), false)));
}

#[test]
fn nothing_is_said_before_the_term_has_begun() {
    let mut bench = Bench::new(teams(2));
    bench.step(Event::Started);
    assert_eq!(bench.fetches.len(), 1);
    assert_eq!(bench.fetches[0].0, START_FETCH);
    assert_eq!(bench.fetches[0].1.len(), 3);
    bench.hear(&embedding(1, &[("a b", WEST), ("c d", EAST)]));
    bench.hear_roster(roster(1, "a b c d"));
    bench.wait(100.0);
    assert!(bench.sent.is_empty() && bench.jobs_run == 0);

    bench.step(Event::Fetched { fetch: START_FETCH, messages: vec![] });
    let sent = bench.take();
    assert_eq!(sent.settings, 1);
    assert_eq!(sent.events[0], EventKind::ServiceStarted { term: 1 });
    assert_eq!(short(&sent.division()), "t1: a b | t2: c d");
    assert_eq!(bench.stored, Some(Stored { term: 1, patch: serde_json::Map::new() }));
}

#[test]
fn the_first_division_is_whole() {
    let mut bench = Bench::begun(teams(2));
    bench.take();
    bench.hear_roster(roster(1, "a b c d e f"));
    bench.now = START.after(std::time::Duration::from_secs(2));
    bench.hold = true;
    bench.hear(&embedding(7, &[("b d f", WEST), ("a c e", EAST)]));
    bench.wait(0.25);
    bench.run_job();
    let sent = bench.take();
    let division = sent.division();
    assert!(sent.teams[0].1, "the first division is mirrored");
    assert_eq!(short(&division), "t1: a c e | t2: b d f");
    assert_eq!(division.header.revision, Revision { term: 1, epoch: 1 });
    assert_eq!(division.embedding, Revision { term: 1, epoch: 7 });
    assert_eq!((division.requested, division.next_team), (2, 3));
    assert!(division.inertia > 0.0 && division.inertia < 1e-4);
    assert!(division.teams.iter().all(|team| team.centroid.len() == 2));
    let margins = division.teams.iter().flat_map(|team| team.members.iter().map(|m| m.margin));
    assert!(margins.into_iter().all(|margin| margin > 0.99 && margin <= 1.0));
    let stage = division.header.stages.last().unwrap();
    assert_eq!(stage.stage, ServiceName::Clusterer);
    assert_eq!(stage.published.since(stage.received).as_millis(), 250);
    assert_eq!(division.header.oldest, Some(START));
    assert_eq!(told(&sent.changes()), ["born t1", "born t2"]);
    assert_eq!(division.changes, sent.changes());
    assert_eq!(sent.robots_told(), "a b c d e f");
    assert_eq!(Some(sent.robots[0].clone()), division.robot_team(&sent.robots[0].robot));
    assert_eq!(bench.status().state, "2 teams of 6 robots");
}

#[test]
fn ids_stay_when_the_vectors_turn_over() {
    let (mut bench, first) =
        divided(teams(3), &embedding(1, &[("a b", WEST), ("c d", EAST), ("e f", NORTH)]));
    assert_eq!(short(&first), "t1: a b | t2: c d | t3: e f");
    let places = [WEST, EAST, NORTH, [-1.0, 0.0], [5.0, 5.0]];
    for (epoch, shift) in (2..).zip(1..places.len()) {
        let at = |i: usize| places[(i + shift) % places.len()];
        // Another seed would number the clusters otherwise, too.
        bench.ask("service/clusterer/settings", Some(&format!("{{\"seed\":{epoch}}}"))).unwrap();
        bench.take();
        bench.hear(&embedding(epoch, &[("a b", at(0)), ("c d", at(1)), ("e f", at(2))]));
        let sent = bench.take();
        assert!(sent.teams[0].0.same_division(&first));
        assert!(sent.changes().is_empty() && sent.robots.is_empty());
    }
}

#[test]
fn ids_and_numbers_outlive_the_process() {
    let first = embedding(1, &[("a b", WEST), ("c d", EAST)]);
    let (mut bench, _) = divided(teams(2), &first);
    bench.ask("service/clusterer/settings", Some("{\"teams\":1}")).unwrap();
    assert_eq!(short(&bench.division()), "t1: a b c d");
    bench.ask("service/clusterer/settings", Some("{\"teams\":2}")).unwrap();
    let last = bench.division();
    assert_eq!(short(&last), "t1: a b | t3: c d");

    // An older division of an older term is on the bus, too.
    let old = Teams {
        header: header(0, 900),
        next_team: 1,
        ..Teams::clone(&divided(teams(2), &embedding(1, &[("a c", WEST), ("b d", EAST)])).1)
    };
    let messages = vec![mirrored(&last), mirrored(&Arc::new(old))];
    let mut next = Bench::restored(teams(2), messages);
    // The last good answer is served, but not published as if it were new.
    assert!(next.take().teams.is_empty());
    assert_eq!(next.ask("teams", None).unwrap().len(), 1);
    assert_eq!(next.ask("robot/a/team", None).unwrap().len(), 1);
    assert_eq!(next.status().state, "waiting for an embedding");
    assert_eq!(next.driver.deadline(), None);

    next.hear(&again(&first, 1, 2));
    let sent = next.take();
    assert_eq!(short(&sent.division()), "t1: a b | t3: c d");
    assert_eq!(sent.division().header.revision, Revision { term: 2, epoch: 1 });
    assert!(sent.changes().is_empty());
    assert_eq!(sent.robots_told(), "a b c d", "a new holder tells everyone");
    next.ask("service/clusterer/settings", Some("{\"teams\":3}")).unwrap();
    let ids: Vec<String> = next.division().teams.iter().map(|team| team.id.to_string()).collect();
    assert_eq!(ids.last().unwrap(), "t4", "{ids:?}");
}

#[test]
fn a_restart_finds_embedding_and_teams_together() {
    let first = embedding(1, &[("a b", WEST), ("c d", EAST)]);
    let (_, last) = divided(teams(2), &first);
    let messages = vec![
        Message::Roster(Arc::new(roster(3, "a? b c d"))),
        Message::Embedding(first),
        mirrored(&last),
    ];
    let mut next = Bench::restored(teams(2), messages);
    let sent = next.take();
    assert_eq!(short(&sent.division()), short(&last));
    assert_eq!(sent.division().stale, [robot("a")]);
    assert_eq!(next.jobs_run, 1);
}

#[test]
fn an_unchanged_embedding_is_not_divided_again() {
    let first = embedding(1, &[("a b", WEST), ("c d", EAST)]);
    let (mut bench, division) = divided(teams(2), &first);
    for epoch in 2..6 {
        bench.wait(0.1);
        bench.hear(&again(&first, 1, epoch));
    }
    assert_eq!(bench.jobs_run, 1);
    assert!(bench.take().teams.is_empty());
    bench.wait(1.0);
    let sent = bench.take();
    let repeated = sent.division();
    assert!(repeated.same_division(&division));
    assert_eq!(repeated.embedding, Revision { term: 1, epoch: 5 }, "it is as fresh as its data");
    assert_eq!(repeated.teams, division.teams);
    assert!(repeated.changes.is_empty() && sent.robots.is_empty() && sent.events.is_empty());
    // The same in the next term of the embedder, and after the same patch of settings.
    bench.hear(&again(&first, 2, 1));
    bench.ask("service/clusterer/settings", Some("{\"heartbeat_s\":2.0,\"teams\":2}")).unwrap();
    assert_eq!(bench.jobs_run, 1);
    // What does matter starts a job.
    bench.ask("service/clusterer/settings", Some("{\"restarts\":11}")).unwrap();
    assert_eq!(bench.jobs_run, 2);
}

#[test]
fn the_same_input_gives_the_same_output() {
    let first = embedding(1, &[("a b c d", WEST), ("e f g", EAST), ("h i", NORTH)]);
    let next = embedding(2, &[("a b c", WEST), ("d e f g", EAST), ("h i", NORTH)]);
    let run = || {
        let mut bench = Bench::begun(teams(4));
        bench.hear(&first);
        bench.hear(&next);
        bench.sent
    };
    assert_eq!(run(), run());
}

#[test]
fn noise_on_the_border_moves_nobody() {
    let line = |epoch, middle: f64| {
        let at = |name: &str, x: f64| (robot(name), vec![x, 0.0], false);
        from_rows(
            1,
            epoch,
            vec![at("a", 0.0), at("b", 0.1), at("m", middle), at("y", 0.9), at("z", 1.0)],
        )
    };
    let (mut bench, first) = divided(teams(2), &line(1, 0.499));
    for epoch in 2..20 {
        bench.hear(&line(epoch, if epoch % 2 == 0 { 0.503 } else { 0.497 }));
        assert!(bench.division().same_division(&first), "epoch {epoch}");
    }
    bench.hear(&line(20, 0.8));
    assert_eq!(short(&bench.division()), "t1: a b | t2: m y z");
}

#[test]
fn unseen_robots_have_no_team_and_may_come_back() {
    let (mut bench, first) = divided(teams(2), &embedding(1, &[("a b c!", WEST), ("d e", EAST)]));
    assert_eq!(short(&first), "t1: a b | t2: d e | - c");
    assert_eq!(first.robot_team(&robot("c")).unwrap().team, None);

    bench.hear(&embedding(2, &[("a b c", WEST), ("d! e", EAST)]));
    let sent = bench.take();
    assert_eq!(short(&sent.division()), "t1: a b c | t2: e | - d");
    assert_eq!(told(&sent.changes()), ["moved c - t1", "moved d t2 -"]);
    assert_eq!(sent.robots_told(), "a b c d e");

    bench.hear(&embedding(3, &[("a b c", WEST), ("d e", EAST)]));
    let sent = bench.take();
    assert_eq!(short(&sent.division()), "t1: a b c | t2: d e");
    assert_eq!(told(&sent.changes()), ["moved d - t2"]);
    assert_eq!(sent.robots_told(), "d e");
}

#[test]
fn more_teams_than_places_are_told_once() {
    let few = |sent: &common::Sent| {
        let few = |kind: &EventKind| match kind {
            EventKind::FewerTeams { requested, formed, reason } => {
                Some((*requested, *formed, reason.clone()))
            }
            _ => None,
        };
        sent.events.iter().filter_map(few).collect::<Vec<_>>()
    };
    let mut bench = Bench::begun(teams(4));
    bench.hear(&embedding(1, &[("a", WEST), ("b", EAST)]));
    let sent = bench.take();
    assert_eq!(short(&sent.division()), "t1: a | t2: b");
    assert_eq!(sent.division().requested, 4);
    assert_eq!(few(&sent), [(4, 2, "only 2 robots can be placed".to_owned())]);
    bench.hear(&embedding(2, &[("a", WEST), ("b", NORTH)]));
    assert!(few(&bench.take()).is_empty());
    // Six robots at two places are two teams.
    let at = |name: &str, place: [f64; 2]| (robot(name), place.to_vec(), false);
    let rows: Vec<_> = ["a", "b", "c"].map(|n| at(n, WEST)).into_iter().collect();
    let rows = [rows, ["d", "e", "f"].map(|n| at(n, EAST)).into_iter().collect()].concat();
    bench.hear(&from_rows(1, 3, rows));
    let sent = bench.take();
    assert_eq!(sent.division().teams.len(), 2);
    assert!(few(&sent).is_empty(), "still 2 of 4");
    bench.hear(&embedding(4, &[("a!", WEST), ("b!", NORTH)]));
    let sent = bench.take();
    assert_eq!(few(&sent), [(4, 0, "nothing relates the robots to each other".to_owned())]);
    assert_eq!(short(&sent.division()), "- a b");
    bench.hear(&embedding(5, &[]));
    assert!(few(&bench.take()).is_empty(), "still 0 of 4");
    bench.hear(&embedding(6, &[("a b c d", WEST)]));
    assert_eq!(bench.division().teams.len(), 4);
    bench.hear(&embedding(7, &[]));
    assert_eq!(few(&bench.take()), [(4, 0, "there are no robots".to_owned())]);
}

#[test]
fn a_fleet_that_is_gone_leaves_no_team() {
    let (mut bench, _) = divided(teams(2), &embedding(1, &[("a b", WEST), ("c d", EAST)]));
    bench.hear(&embedding(2, &[]));
    let sent = bench.take();
    assert_eq!(told(&sent.changes()), ["died t1", "died t2"]);
    assert_eq!((sent.division().teams.len(), sent.division().next_team), (0, 3));
    assert_eq!(bench.status().state, "0 teams of 0 robots");
    bench.hear(&embedding(3, &[("a b", WEST), ("c d", EAST)]));
    assert_eq!(short(&bench.division()), "t3: a b | t4: c d");
}

#[test]
fn splits_mergers_births_and_deaths_are_told() {
    let (mut bench, _) = divided(teams(1), &embedding(1, &[("a b c", WEST), ("d e", EAST)]));
    bench.ask("service/clusterer/settings", Some("{\"teams\":2}")).unwrap();
    let sent = bench.take();
    assert_eq!(short(&sent.division()), "t1: a b c | t2: d e");
    assert_eq!(told(&sent.changes()), ["split t1 t2", "moved d t1 t2", "moved e t1 t2"]);

    bench.ask("service/clusterer/settings", Some("{\"teams\":3}")).unwrap();
    bench.take();
    bench.hear(&embedding(2, &[("a b c", WEST), ("d e", EAST), ("n1 n2 n3", NORTH)]));
    let division = bench.division();
    assert_eq!(division.teams.len(), 3);
    let newest = division.teams.last().unwrap();
    assert_eq!(newest.members.len(), 3, "{}", short(&division));

    bench.ask("service/clusterer/settings", Some("{\"teams\":2}")).unwrap();
    bench.take();
    bench.hear(&embedding(3, &[("a b c d e", WEST), ("n1 n2 n3", NORTH)]));
    let before = bench.division();
    let west = before.robot_team(&robot("a")).unwrap().team.unwrap();
    assert_eq!(before.robot_team(&robot("e")).unwrap().team, Some(west.clone()));
    bench.hear(&embedding(4, &[("a b", WEST), ("c d e", EAST)]));
    let sent = bench.take();
    let north = &before.teams.iter().find(|team| team.id != west).unwrap().id;
    assert!(told(&sent.changes()).contains(&format!("died {north}")));
    assert!(bench.counter("team_changes") > 5);
}

#[test]
fn the_one_who_commands_most_leads() {
    let first = embedding(1, &[("a b c d", WEST), ("x y", EAST)]);
    let (mut bench, division) = divided(teams(2), &first);
    assert_eq!(leaders(&division), ["a", "x"], "nobody commands: the first by name");
    // c commands a and b, b through x of the other team; d commands y, who is no member.
    bench.hear_roster(roster(1, "a<c b<x x<c y<d c d"));
    let sent = bench.take();
    assert_eq!(leaders(&sent.division()), ["c", "x"]);
    assert_eq!(sent.robots_told(), "a b c d", "the other team has not changed");
    // d commands as many: the one before stays.
    bench.hear_roster(roster(2, "a<c b<d c d x y"));
    assert!(bench.take().teams.is_empty());
    bench.hear(&embedding(2, &[("a b c d", WEST), ("x y", NORTH)]));
    assert_eq!(leaders(&bench.division()), ["c", "x"]);
    // Nobody commands: the one before stays, too, until it is in another team.
    bench.hear_roster(roster(3, "a b c d x y"));
    bench.hear(&embedding(3, &[("a b d", WEST), ("x y c", EAST)]));
    assert_eq!(leaders(&bench.division()), ["a", "x"]);
    // In a circle all command as many; one above them commands more.
    bench.hear_roster(roster(4, "a<b b<d d<a x<y y<x c<nobody"));
    assert!(bench.take().teams.is_empty());
    bench.hear_roster(roster(5, "a<b b<d d<a x<y y<c c"));
    assert_eq!(leaders(&bench.division()), ["a", "c"]);
}

#[test]
fn an_unchanged_division_is_told_every_heartbeat() {
    let settings = ClustererSettings { heartbeat_s: 0.5, ..teams(2) };
    let (mut bench, first) = divided(settings, &embedding(1, &[("a b", WEST), ("c d", EAST)]));
    let start = bench.now;
    assert_eq!(bench.driver.deadline(), Some(start.after(std::time::Duration::from_millis(500))));
    bench.wait(0.4);
    bench.step(Event::Timeout);
    assert!(bench.take().teams.is_empty(), "too early");
    bench.wait(0.15);
    let sent = bench.take();
    assert!(sent.teams[0].1, "the mirror beats as well");
    let second = sent.division();
    assert_eq!(second.header.revision, Revision { term: 1, epoch: 2 });
    assert_eq!(second.header.oldest, first.header.oldest, "the data are as old as they are");
    assert_eq!(second.header.stages.last().unwrap().published, bench.now);
    assert_eq!(second.header.stages.len(), first.header.stages.len());
    bench.wait(0.5);
    assert_eq!(bench.division().header.revision.epoch, 3);
    assert_eq!(bench.jobs_run, 1);
}

#[test]
fn the_mirror_is_told_on_change_and_by_heartbeat() {
    let (mut bench, _) = divided(teams(2), &embedding(1, &[("a b", WEST), ("c d", EAST)]));
    let mut mirrors = Vec::new();
    for epoch in 2..25 {
        bench.wait(0.1);
        // All the time a bit elsewhere: a new division each time, with the same teams.
        let drift = 1e-4 * f64::from(u32::try_from(epoch).unwrap());
        bench.hear(&embedding(epoch, &[("a b", [drift, 0.0]), ("c d", EAST)]));
        let sent = bench.take();
        assert!(sent.robots.is_empty());
        if sent.teams[0].1 {
            mirrors.push(epoch);
        }
    }
    assert_eq!(mirrors, [11, 21]);
    bench.hear(&embedding(25, &[("a b c", WEST), ("d", EAST)]));
    assert!(bench.take().teams[0].1);
}

#[test]
fn silent_robots_are_marked_without_a_new_embedding() {
    let (mut bench, first) = divided(teams(2), &embedding(1, &[("a b", WEST), ("c d!", EAST)]));
    assert!(first.stale.is_empty());
    bench.hear_roster(roster(1, "a b? c d? elsewhere?"));
    let sent = bench.take();
    assert_eq!(sent.division().stale, [robot("b"), robot("d")]);
    assert!(sent.teams[0].1 && sent.robots.is_empty());
    assert_eq!(sent.division().teams, first.teams);
    bench.hear_roster(roster(2, "a b? c d?"));
    assert!(bench.take().teams.is_empty(), "nothing is new");
    bench.hear_roster(roster(1, "a b c d"));
    assert!(bench.take().teams.is_empty(), "an old roster");
    assert_eq!(bench.counter("messages_old"), 1);
    bench.hear_roster(roster(3, "a b c d"));
    assert!(bench.division().stale.is_empty());
    assert_eq!(bench.jobs_run, 1);
}

#[test]
fn robots_are_told_when_their_team_changes_and_never_otherwise() {
    let (mut bench, _) =
        divided(teams(3), &embedding(1, &[("a b", WEST), ("c d", EAST), ("e f", NORTH)]));
    bench.hear(&embedding(2, &[("a b", [0.01, 0.0]), ("c d", EAST), ("e f", NORTH)]));
    assert_eq!(bench.take().robots_told(), "");
    bench.hear(&embedding(3, &[("a b", WEST), ("c d new", EAST), ("e f", NORTH)]));
    assert_eq!(bench.take().robots_told(), "c d new");
    bench.hear(&embedding(4, &[("a b", WEST), ("c d new", EAST), ("f", NORTH)]));
    let sent = bench.take();
    assert_eq!(sent.robots_told(), "f");
    let revision = sent.division().header.revision;
    assert_eq!(sent.robots[0].header.revision, revision);
    bench.wait(5.0);
    assert_eq!(bench.take().robots_told(), "");
}

#[test]
fn every_get_has_exactly_one_answer() {
    let mut bench = Bench::new(teams(2));
    let all = ["teams", "json/teams", "robot/*/team", "robot/a/team", "embedding", "audit", "**"];
    for selector in all {
        // `**` selects the settings as well, which are there from the start.
        let known = usize::from(selector == "**");
        assert_eq!(bench.ask(selector, None).unwrap().len(), known, "{selector}");
    }
    assert_eq!(bench.status().state, "waiting for an embedding");
    bench.step(Event::Started);
    bench.step(Event::Fetched { fetch: START_FETCH, messages: vec![] });
    bench.hear(&embedding(1, &[("a b", WEST), ("c d!", EAST)]));
    let one = |bench: &mut Bench, selector: &str| match bench.ask(selector, None).unwrap() {
        messages if messages.len() == 1 => messages[0].clone(),
        other => panic!("{selector}: {other:?}"),
    };
    assert!(matches!(one(&mut bench, "teams"), Message::Teams { .. }));
    assert!(matches!(one(&mut bench, "json/*"), Message::Teams { .. }));
    assert!(matches!(one(&mut bench, "embedding"), Message::Embedding(_)));
    assert!(matches!(one(&mut bench, "service/clusterer/settings"), Message::Settings(..)));
    for (name, team) in [("a", Some("t1")), ("d", None)] {
        let Message::RobotTeam(told) = one(&mut bench, &format!("robot/{name}/team")) else {
            panic!("{name}");
        };
        assert_eq!(told.team.as_ref().map(TeamId::as_str), team);
    }
    assert_eq!(bench.ask("robot/*/team", None).unwrap().len(), 4);
    assert_eq!(bench.ask("robot/$*a/team", None).unwrap().len(), 1);
    assert!(bench.ask("robot/nobody/team", None).unwrap().is_empty());
    assert!(bench.ask("roster", None).unwrap().is_empty());
    assert_eq!(bench.ask("*", None).unwrap().len(), 2);
    let error = bench.ask("service/clusterer/settings", Some("{\"teams\":0}")).unwrap_err();
    assert!(error.contains("teams"));
}

#[test]
fn an_answer_has_an_end() {
    let rows = (0..3000).map(|i| {
        let x = f64::from(i % 2) + f64::from(i) * 1e-6;
        (robot(&format!("r{i}")), vec![x, 0.0], false)
    });
    let settings = ClustererSettings { restarts: 1, ..teams(2) };
    let (mut bench, _) = divided(settings, &from_rows(1, 1, rows.collect()));
    let error = bench.ask("robot/*/team", None).unwrap_err();
    assert!(error.contains("muster/v1/f/teams"), "{error}");
    assert_eq!(bench.ask("robot/r1/team", None).unwrap().len(), 1);
    assert_eq!(bench.ask("teams", None).unwrap().len(), 1);
}

#[test]
fn a_failed_job_changes_nothing() {
    let first = embedding(1, &[("a b", WEST), ("c d", EAST)]);
    let (mut bench, division) = divided(teams(2), &first);
    bench.hold = true;
    let bad = embedding(2, &[("a c", WEST), ("b d", EAST)]);
    bench.hear(&bad);
    bench.jobs.clear();
    bench.step(Event::JobFailed("out of luck".to_owned()));
    let sent = bench.take();
    assert_eq!(sent.events, [EventKind::JobFailed { reason: "out of luck".to_owned() }]);
    assert_eq!(bench.counter("jobs_failed"), 1);
    // The same data would fail again.
    bench.hear(&again(&bad, 1, 3));
    assert!(bench.jobs.is_empty());
    bench.wait(1.0);
    let repeated = bench.division();
    assert!(repeated.same_division(&division));
    assert_eq!(
        repeated.embedding,
        Revision { term: 1, epoch: 1 },
        "of the data that it is made of"
    );
    assert_eq!(bench.ask("teams", None).unwrap().len(), 1);
    bench.hear(&embedding(4, &[("a d", WEST), ("b c", EAST)]));
    bench.run_job();
    assert_eq!(bench.take().teams.len(), 1);
}

#[test]
fn what_cannot_be_divided_fails_without_a_panic() {
    let (mut bench, _) = divided(teams(2), &embedding(1, &[("a b", WEST), ("c d", EAST)]));
    bench.hear(&embedding(2, &[("a b", [1e200, 0.0]), ("c d", EAST)]));
    let sent = bench.take();
    assert!(sent.teams.is_empty());
    assert!(
        matches!(&sent.events[..], [EventKind::JobFailed { reason }] if reason.contains("large"))
    );
    // Contradictory embeddings do not pass the decoder; if one did, it would not pass here.
    let broken = Embedding { unseen: vec![], ..(*embedding(3, &[("a", WEST)])).clone() };
    bench.hear(&Arc::new(broken));
    let sent = bench.take();
    assert!(
        matches!(&sent.events[..], [EventKind::Quarantined { key, .. }] if key.ends_with("embedding"))
    );
    assert_eq!(bench.counter("embeddings_received"), 2);
}

#[test]
fn old_terms_and_epochs_are_dropped() {
    let (mut bench, division) = divided(teams(2), &embedding(5, &[("a b", WEST), ("c d", EAST)]));
    let other = embedding(4, &[("a c", WEST), ("b d", EAST)]);
    bench.hear(&other);
    bench.hear(&again(&other, 0, 99));
    bench.hear(&again(&other, 1, 5));
    assert!(bench.take().teams.is_empty());
    assert_eq!(bench.counter("messages_old"), 2, "the same revision twice is not old");
    let Message::Teams { teams, .. } = &bench.ask("teams", None).unwrap()[0] else { panic!() };
    assert_eq!(*teams, division);
    bench.hear(&again(&other, 2, 1));
    assert_eq!(bench.jobs_run, 2);
}

#[test]
fn the_newest_embedding_follows_a_running_job() {
    let mut bench = Bench::begun(teams(2));
    bench.take();
    bench.hold = true;
    bench.hear(&embedding(1, &[("a b", WEST), ("c d", EAST)]));
    bench.hear(&embedding(2, &[("a c", WEST), ("b d", EAST)]));
    bench.hear(&embedding(3, &[("a b", WEST), ("c", EAST)]));
    bench.run_job();
    assert_eq!(bench.division().embedding.epoch, 1);
    bench.run_job();
    assert_eq!(bench.division().embedding.epoch, 3);
    assert!(bench.jobs.is_empty());
    assert_eq!(bench.counter("jobs_started"), 2);
    // What comes with the same data while the job runs makes its output fresh.
    let fourth = embedding(4, &[("a b", EAST), ("c", WEST)]);
    bench.hear(&fourth);
    bench.hear(&again(&fourth, 1, 5));
    bench.run_job();
    assert_eq!(bench.division().embedding.epoch, 5);
    assert!(bench.jobs.is_empty());
}

#[test]
fn events_of_one_division_are_bounded() {
    let half = |swap: bool| {
        let row = |i: usize| {
            let east = (i < 100) != (swap && i.is_multiple_of(3));
            let x = if east { 1.0 } else { 0.0 };
            (
                robot(&format!("r{i:03}")),
                vec![x, 1e-4 * f64::from(u32::try_from(i).unwrap())],
                false,
            )
        };
        (0..200).map(row).collect::<Vec<_>>()
    };
    let (mut bench, _) = divided(teams(2), &from_rows(1, 1, half(false)));
    bench.hear(&from_rows(1, 2, half(true)));
    let sent = bench.take();
    assert_eq!(sent.changes().len(), 64);
    assert_eq!(sent.division().changes.len(), 67);
    assert_eq!(bench.counter("team_changes_untold"), 3);
    assert_eq!(bench.counter("team_changes"), 2 + 67);
}

#[test]
fn refused_packets_are_told_of() {
    let mut bench = Bench::begun(teams(2));
    bench.take();
    let rejection =
        Rejection { robot: None, key: "muster/v1/f/embedding".into(), reason: "broken".into() };
    bench.step(Event::Rejected(rejection));
    assert!(matches!(bench.take().events[..], [EventKind::Quarantined { count: 1, .. }]));
    assert_eq!(bench.counter("messages_refused"), 1);
}

#[test]
fn after_a_lost_link_everyone_is_told_again() {
    let (mut bench, division) = divided(teams(2), &embedding(1, &[("a b", WEST), ("c d", EAST)]));
    bench.step(Event::LinkLost);
    bench.fetches.clear();
    bench.wait(0.2);
    bench.step(Event::LinkRestored);
    let sent = bench.take();
    assert!(sent.division().same_division(&division));
    assert_eq!(sent.robots_told(), "a b c d");
    assert_eq!(bench.fetches.len(), 1);
    let missed = embedding(2, &[("a b c", WEST), ("d", EAST)]);
    bench.step(Event::Fetched {
        fetch: bench.fetches[0].0,
        messages: vec![Message::Embedding(missed)],
    });
    assert_eq!(short(&bench.division()), "t1: a b c | t2: d");
}

/// What may happen to a clusterer.
#[derive(Debug, Clone)]
enum Act {
    /// An embedding: per robot absent, or a place on a small grid and whether it is unseen.
    Embedding(Vec<Option<(i8, i8, bool)>>),
    /// Another number of teams.
    Teams(u32),
    /// The process dies; the division survives elsewhere.
    Restart,
    /// Time passes.
    Wait(f64),
}

fn act() -> impl Strategy<Value = Act> {
    let place = prop::option::weighted(0.8, (-2_i8..3, -2_i8..3, prop::bool::weighted(0.1)));
    prop_oneof![
        8 => prop::collection::vec(place, 12).prop_map(Act::Embedding),
        1 => (1_u32..6).prop_map(Act::Teams),
        1 => Just(Act::Restart),
        1 => (0.0..2.0).prop_map(Act::Wait),
    ]
}

/// Team, members and leader, as a robot knows them.
type Place = (Option<TeamId>, Vec<RobotId>, Option<RobotId>);

/// What robots and readers of the bus know.
#[derive(Default)]
struct World {
    teams: Option<Arc<Teams>>,
    gone: BTreeSet<TeamId>,
    told: BTreeMap<RobotId, Place>,
}

impl World {
    fn read(&mut self, sent: &common::Sent) {
        for (teams, _) in &sent.teams {
            if let Some(before) = &self.teams {
                assert!(teams.header.revision > before.header.revision);
                let ids: BTreeSet<_> = teams.teams.iter().map(|team| team.id.clone()).collect();
                for team in &before.teams {
                    if !ids.contains(&team.id) {
                        self.gone.insert(team.id.clone());
                    }
                }
                assert!(ids.is_disjoint(&self.gone), "{ids:?} {:?}", self.gone);
                self.check_changes(before, teams);
            }
            self.teams = Some(Arc::clone(teams));
        }
        for told in &sent.robots {
            let content = (told.team.clone(), told.members.clone(), told.leader.clone());
            self.told.insert(told.robot.clone(), content);
        }
        for now in self.teams.iter().flat_map(|teams| teams.robot_teams()) {
            let content = (now.team, now.members, now.leader);
            assert_eq!(self.told.get(&now.robot), Some(&content), "{} knows its team", now.robot);
        }
    }

    fn check_changes(&self, before: &Teams, now: &Teams) {
        let place = |teams: &Teams| -> BTreeMap<RobotId, String> {
            let all = teams.robot_teams().map(|told| {
                (told.robot, told.team.map_or("-".to_owned(), |team| team.to_string()))
            });
            all.collect()
        };
        let (old, new) = (place(before), place(now));
        let moved: Vec<String> = old
            .iter()
            .filter_map(|(robot, from)| {
                let to = new.get(robot)?;
                (from != to).then(|| format!("moved {robot} {from} {to}"))
            })
            .collect();
        let all = told(&now.changes);
        let said: Vec<_> = all.iter().filter(|text| text.starts_with("moved")).cloned().collect();
        assert_eq!(said, moved);
        let has = |teams: &Teams, id: &TeamId| teams.teams.iter().any(|team| team.id == *id);
        let starts = now.teams.iter().filter(|team| !has(before, &team.id)).count();
        let ends = before.teams.iter().filter(|team| !has(now, &team.id)).count();
        let count = |words: [&str; 2]| {
            all.iter().filter(|text| words.iter().any(|word| text.starts_with(word))).count()
        };
        assert_eq!((count(["born", "split"]), count(["died", "merged"])), (starts, ends));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn every_robot_has_one_place_and_no_id_is_used_twice(
        acts in prop::collection::vec(act(), 1..25)
    ) {
        let mut settings = ClustererSettings { restarts: 3, ..teams(3) };
        let mut bench = Bench::begun(settings.clone());
        let mut world = World::default();
        let mut newest: Option<Arc<Embedding>> = None;
        for (epoch, act) in (1..).zip(acts) {
            match act {
                Act::Embedding(places) => {
                    let rows = places.into_iter().enumerate().filter_map(|(i, place)| {
                        let (x, y, unseen) = place?;
                        Some((robot(&format!("r{i}")), vec![f64::from(x), f64::from(y)], unseen))
                    });
                    let next = from_rows(1, epoch, rows.collect());
                    bench.hear(&next);
                    newest = Some(next);
                }
                Act::Teams(many) => {
                    settings.teams = many;
                    let patch = format!("{{\"teams\":{many}}}");
                    bench.ask("service/clusterer/settings", Some(&patch)).unwrap();
                }
                Act::Restart => {
                    world.read(&bench.take());
                    let teams = world.teams.iter().map(mirrored);
                    let embedding = newest.iter().map(|e| Message::Embedding(Arc::clone(e)));
                    let now = bench.now;
                    bench = Bench::restored(settings.clone(), teams.chain(embedding).collect());
                    bench.now = now;
                }
                Act::Wait(seconds) => bench.wait(seconds),
            }
            world.read(&bench.take());
            let (Some(teams), Some(embedding)) = (&world.teams, &newest) else { continue };
            let mut robots: Vec<RobotId> =
                teams.robot_teams().map(|told| told.robot).collect();
            robots.sort_unstable();
            prop_assert_eq!(&robots, &embedding.robots);
            let unseen = embedding.robots.iter().zip(&embedding.unseen).filter(|(_, u)| **u);
            prop_assert!(unseen.map(|(robot, _)| robot).eq(&teams.unassigned));
            prop_assert!(teams.teams.len() <= settings.teams as usize);
            prop_assert!(teams.teams.iter().all(|team| !team.members.is_empty()));
            let number = |id: &TeamId| id.as_str()[1..].parse::<u64>().unwrap();
            let numbers: Vec<u64> = teams.teams.iter().map(|team| number(&team.id)).collect();
            prop_assert!(numbers.is_sorted_by(|l, r| l < r));
            prop_assert!(numbers.iter().all(|number| *number < teams.next_team));
        }
    }
}
