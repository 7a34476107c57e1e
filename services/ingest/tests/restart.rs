//! A new process takes up what other services remember of the last one.

use std::sync::Arc;

use crate::bench::{
    self, Bench, Named, bare_pose, links, modality, pose, rank, relation, report, robot, seconds,
    token,
};
use muster_model::content::Checked;
use muster_model::graph::GraphDelta;
use muster_model::id::SkillId;
use muster_model::observation::{Pose, Rank};
use muster_model::roster::Presence::{Active, Stale};
use muster_model::roster::Roster;
use muster_model::settings::IngestSettings;
use muster_model::time::Tick;
use muster_service::{Input, Stored};
use muster_wire::{Key, Message, Pattern};

const MODALITIES: [&str; 4] = ["connectivity", "hierarchy", "spatial", "thermal"];

fn settings() -> IngestSettings {
    IngestSettings { modalities: vec![modality("thermal")], ..IngestSettings::default() }
}

fn graphs(bench: &Bench) -> Vec<Named> {
    MODALITIES.iter().map(|name| bench.graph(name)).collect()
}

/// Four robots with everything that robots can say, one of which has left, so that nodes differ from
/// those of a new term.
fn before() -> Bench {
    let mut bench = Bench::new(settings());
    bench.receive(rank("gone", None, None));
    bench.wait(11.0);
    for (name, x) in [("r3", 3.0), ("r2", 1.0), ("r1", 0.0)] {
        bench.receive(pose(name, x, 0.0));
    }
    bench.receive(token("r4", true));
    bench.receive(links("r1", &[("r2", 0.75), ("r3", 0.25), ("unknown", 1.0)]));
    bench.receive(links("r4", &[("r1", 0.5)]));
    let (weight, role) = (Some(2.0), Some("scout".to_owned()));
    let skills = ["relay", "medic"].map(|name| SkillId::new(name).unwrap());
    let skills = Some(skills.to_vec());
    bench.receive(report("r2", Rank { weight, role, skills, ..Rank::under(Some(robot("r1"))) }));
    bench.receive(rank("r3", Some("r2"), Some(0.0)));
    bench.receive(rank("r4", Some("unknown"), Some(3.0)));
    bench.receive(relation("r3", "thermal", &[("r1", 5.0), ("r4", 6.0)]));
    bench.wait(0.2);
    bench
}

fn after(now: Tick, remembered: Vec<Message>) -> Bench {
    let mut bench = Bench::asleep_at(now, settings(), Stored::default());
    bench.start(remembered);
    bench
}

#[test]
fn a_restart_leads_to_the_same_fleet_in_a_higher_term() {
    let mut old = before();
    let mut new = after(old.now, old.remembered());
    new.wait(0.001);
    assert_eq!(graphs(&new), graphs(&old));
    let (old_roster, new_roster) = (old.roster.clone().unwrap(), new.roster.clone().unwrap());
    assert_eq!(new_roster.header.revision.term, old_roster.header.revision.term + 1);
    assert_eq!(new.stored.term, new_roster.header.revision.term);
    for (old, new) in old_roster.robots.iter().zip(&new_roster.robots) {
        let mut renumbered = new.clone();
        renumbered.node = old.node;
        assert_eq!(renumbered, *old);
    }
    let r2 = &new_roster.robots[1];
    let skills: Vec<_> = r2.skills.iter().map(SkillId::as_str).collect();
    assert_eq!((r2.robot.as_str(), skills), ("r2", vec!["medic", "relay"]));
    let nodes: Vec<_> = new_roster.robots.iter().map(|entry| entry.node).collect();
    assert_eq!(nodes, [0, 1, 2, 3], "nodes are numbered again");
    assert_eq!(new_roster.header.oldest, old_roster.header.oldest, "ages stay what they are");
    assert!(new.happened().is_empty(), "no robot joined");
    assert_eq!(new.counter("robots_restored"), 4);
    assert_eq!(new.counter("robots_joined"), 0);
    // A consumer goes on from the old graphs.
    for (_, message) in &new.published {
        if let Message::Graph(delta) = message {
            old.graphs.get_mut(&delta.modality).unwrap().apply(delta).unwrap();
        }
    }
    assert_eq!(old.graphs, new.graphs);
}

#[test]
fn a_robot_without_new_poses_stays_stale_over_a_restart_while_it_says_other_things() {
    let mut old = Bench::new(settings());
    old.receive(pose("r1", 0.0, 0.0));
    let posed = old.now;
    for _ in 0..5 {
        old.wait(1.0);
        old.receive(links("r1", &[]));
    }
    assert_eq!(old.happened(), ["joined r1", "stale r1"]);
    old.wait(1.1);
    let mut new = after(old.now, old.remembered());
    new.wait(1.0);
    new.receive(links("r1", &[]));
    assert!(new.happened().is_empty(), "neither recovered nor stale again");
    assert_eq!(new.presence("r1"), Some(Stale));
    let oldest = new.roster.as_ref().unwrap().header.oldest.unwrap();
    assert!(
        new.now.since(oldest) > seconds(2.0) && oldest >= posed,
        "its pose is not made younger"
    );
    new.receive(pose("r1", 0.0, 0.0));
    assert_eq!(new.happened(), ["recovered r1"]);
}

#[test]
fn restored_robots_have_their_whole_grace_period() {
    let mut old = before();
    let remembered = old.remembered();
    old.now = old.now.after(seconds(3600.0));
    let mut new = after(old.now, remembered);
    new.wait(1.999);
    assert!(new.happened().is_empty());
    assert_eq!(new.presence("r1"), Some(Active));
    assert!(new.now.since(new.entry("r1").unwrap().last_seen) > seconds(3600.0));
    assert!(new.roster.as_ref().unwrap().header.data_age_s(new.now) > Some(3600.0));
    new.wait(0.1);
    assert_eq!(new.happened(), ["stale r1 r2 r3 r4"]);
    assert_eq!(new.presence("r1"), Some(Stale));
    new.receive(token("r4", true));
    new.receive(pose("r1", 0.0, 0.0));
    new.wait(0.5);
    assert_eq!(new.happened(), ["recovered r1 r4"]);
    new.wait(7.4);
    new.happened();
    new.wait(0.2);
    let left = new.happened();
    assert!(left.ends_with(&["left r2 r3".to_owned()]), "{left:?}");
    assert_eq!(new.names(), ["r1", "r4"]);
}

#[test]
fn what_was_reported_in_this_run_wins_and_the_rest_is_restored() {
    let mut old = before();
    let mut new = Bench::asleep_at(old.now, settings(), Stored::default());
    new.begin_inquiry();
    new.receive(pose("r1", 100.0, 0.0));
    new.receive(links("r4", &[]));
    new.receive(pose("r9", 0.0, 0.0));
    new.wait(0.1);
    new.answer_all(old.remembered());
    new.wait(0.001);
    assert_eq!(new.happened(), ["joined r9"]);
    assert_eq!(new.names(), ["r1", "r2", "r3", "r4", "r9"]);
    assert_eq!(new.entry("r1").unwrap().position, Some([100.0, 0.0, 0.0]));
    assert_eq!(
        new.weight("connectivity", "r2", "r1"),
        Some(0.75),
        "its links were not reported again"
    );
    assert_eq!(new.weight("connectivity", "r1", "r4"), None);
    assert_eq!(new.weight("hierarchy", "r1", "r2"), Some(2.0));
}

#[test]
fn restored_observations_know_no_order() {
    let mut old = before();
    let boot = Some("a".to_owned());
    old.receive(report("r1", Pose { boot: boot.clone(), seq: Some(900), ..bare_pose(0.0, 0.0) }));
    old.wait(0.2);
    let mut new = after(old.now, old.remembered());
    let restarted = Pose { boot, seq: Some(3), ..bare_pose(9.0, 0.0) };
    new.receive(report("r1", restarted));
    new.wait(0.2);
    assert!(new.happened().is_empty());
    assert_eq!(new.entry("r1").unwrap().position, Some([9.0, 0.0, 0.0]));
}

#[test]
fn the_newest_roster_counts_and_the_term_is_above_all() {
    let mut old = before();
    let stale_memory = old.remembered();
    old.receive(pose("r1", 50.0, 0.0));
    old.wait(0.2);
    let mut remembered = old.remembered();
    remembered.extend(stale_memory);
    let Some(Message::Graph(delta)) = remembered.first().cloned() else { panic!() };
    let mut other = GraphDelta::clone(&delta);
    other.modality = modality("elsewhere");
    other.header.revision.term = 40;
    remembered.push(Message::Graph(Arc::new(other)));
    for _ in 0..remembered.len() {
        remembered.rotate_left(1);
        let mut new = after(old.now, remembered.clone());
        new.wait(0.001);
        assert_eq!(new.entry("r1").unwrap().position, Some([50.0, 0.0, 0.0]));
        assert_eq!(graphs(&new), graphs(&old));
        assert_eq!(new.roster.as_ref().unwrap().header.revision.term, 41);
    }
}

#[test]
fn the_term_that_was_held_on_this_host_counts_too() {
    let stored = Stored { term: 7, ..Stored::default() };
    let mut bench = Bench::asleep_at(bench::START, settings(), stored);
    bench.start(Vec::new());
    bench.wait(1.0);
    assert_eq!(bench.roster.as_ref().unwrap().header.revision.term, 8);
}

/// Applies a change to every graph or roster that is remembered.
fn spoiled(
    remembered: &[Message],
    graph: impl Fn(&mut GraphDelta),
    roster: impl Fn(&mut Roster),
) -> Vec<Message> {
    let mut remembered = remembered.to_vec();
    for message in &mut remembered {
        match message {
            Message::Graph(delta) => graph(Arc::make_mut(delta)),
            Message::Roster(entries) => roster(entries.make_mut_unchecked()),
            _ => {}
        }
    }
    remembered
}

#[test]
fn what_contradicts_itself_is_not_restored() {
    let mut old = before();
    let remembered = old.remembered();
    let restored = |messages: Vec<Message>| {
        let mut new = after(old.now, messages);
        new.wait(0.001);
        new
    };
    let links_lost = |new: &Bench| {
        assert_eq!(new.names().len(), 4);
        assert!(new.graph("connectivity").is_empty() && new.graph("thermal").is_empty());
        assert_eq!(new.graph("spatial"), old.graph("spatial"), "positions are in the roster");
        assert_eq!(new.weight("hierarchy", "r1", "r2"), Some(1.0), "the superior is in the roster");
    };
    let spoil: [fn(&mut GraphDelta); 4] = [
        |delta| delta.base = Some(delta.header.revision),
        |delta| delta.header.revision.term += 1,
        |delta| delta.nodes_added.reverse_names(),
        |delta| delta.nodes_added.truncate(1),
    ];
    for change in spoil {
        links_lost(&restored(spoiled(&remembered, change, |_| {})));
    }
    // A graph that is a frame off is better than none.
    let off = restored(spoiled(&remembered, |delta| delta.header.revision.epoch += 1, |_| {}));
    assert_eq!(graphs(&off), graphs(&old));

    let twice =
        spoiled(&remembered, |_| {}, |roster| roster.robots[1].node = roster.robots[0].node);
    assert!(restored(twice).names().is_empty());
    let absurd = restored(spoiled(
        &remembered,
        |_| {},
        |roster| {
            roster.robots[0].position = Some([f64::NAN, 0.0, 0.0]);
            roster.robots[1].frame = Some("mars".to_owned());
            roster.robots[2].superior = Some(robot("r3"));
        },
    ));
    assert_eq!(absurd.names().len(), 4);
    for name in ["r1", "r2"] {
        assert_eq!(absurd.entry(name).unwrap().position, None, "{name}");
    }
    assert_eq!(absurd.entry("r3").unwrap().superior, None);
    let only_graphs = remembered.iter().filter(|m| matches!(m, Message::Graph(_))).cloned();
    let mut empty = restored(only_graphs.collect());
    empty.wait(1.0);
    assert!(empty.names().is_empty());
    assert_eq!(empty.roster.as_ref().unwrap().header.revision.term, 3, "its term is known though");
}

trait ReverseNames {
    fn reverse_names(&mut self);
}

impl ReverseNames for Vec<(u32, muster_model::id::RobotId)> {
    fn reverse_names(&mut self) {
        let names: Vec<_> = self.iter().rev().map(|(_, name)| name.clone()).collect();
        for (node, name) in self.iter_mut().zip(names) {
            node.1 = name;
        }
    }
}

#[test]
fn no_more_robots_are_restored_than_there_may_be() {
    let mut old = before();
    let few = IngestSettings { max_robots: 2, ..settings() };
    let mut new = Bench::asleep_at(old.now, few, Stored::default());
    new.start(old.remembered());
    new.wait(0.001);
    assert_eq!(new.names(), ["r1", "r2"]);
}

#[test]
fn the_first_frame_waits_for_the_fleet_to_gather() {
    let mut bench = Bench::asleep_at(bench::START, settings(), Stored::default());
    bench.start(Vec::new());
    bench.wait(0.9);
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(0.5);
    bench.receive(pose("r2", 1.0, 0.0));
    bench.wait(0.499);
    assert!(bench.published.is_empty());
    bench.wait(0.001);
    assert_eq!(bench.names(), ["r1", "r2"]);
    bench.receive(pose("r3", 2.0, 0.0));
    bench.wait(0.1);
    assert_eq!(bench.names(), ["r1", "r2", "r3"], "only the first frame waits");
}

#[test]
fn an_empty_roster_is_published_a_moment_after_the_start_and_the_first_robot_is_waited_with_all_the_same()
 {
    let mut bench = Bench::asleep_at(bench::START, settings(), Stored::default());
    bench.start(Vec::new());
    bench.wait(0.999);
    assert!(bench.published.is_empty());
    bench.wait(0.001);
    assert_eq!((bench.frame_times().len(), bench.names().len()), (1, 0));
    bench.wait(30.0);
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(0.999);
    assert!(bench.names().is_empty());
    bench.wait(0.001);
    assert_eq!(bench.names(), ["r1"]);
}

#[test]
fn a_stale_robot_stays_stale_and_leaves_however_often_ingest_restarts() {
    let mut old = before();
    old.wait(3.0);
    assert_eq!(old.presence("r1"), Some(Stale));
    let last_seen = old.entry("r1").unwrap().last_seen;
    let mut happened = Vec::new();
    for _ in 0..3 {
        old.now = old.now.after(seconds(1.5));
        let mut new = after(old.now, old.remembered());
        // The token of a process that hangs appears again with each start.
        new.receive(token("r1", true));
        new.wait(1.5);
        assert!(new.published.iter().all(|(_, message)| match message {
            Message::Roster(roster) =>
                roster.robots.iter().all(|e| e.robot != robot("r1") || e.presence == Stale),
            _ => true,
        }));
        happened.extend(new.happened().into_iter().filter(|happened| happened.contains("r1")));
        old = new;
    }
    assert!(matches!(happened.as_slice(), [left] if left.starts_with("left r1")), "{happened:?}");
    assert!(old.now.since(last_seen) < seconds(12.5));
}

#[test]
fn a_stale_robot_that_speaks_as_ingest_starts_has_recovered() {
    let mut old = before();
    old.wait(3.0);
    let mut new = Bench::asleep_at(old.now, settings(), Stored::default());
    new.begin_inquiry();
    new.receive(pose("r1", 0.0, 0.0));
    new.answer_all(old.remembered());
    new.wait(0.001);
    assert_eq!(new.happened(), ["recovered r1"]);
    assert_eq!(new.presence("r1"), Some(Active));
}

#[test]
fn a_process_that_hangs_does_not_come_back_by_a_restart() {
    let mut old = Bench::new(settings());
    old.receive(token("hung", true));
    old.receive(pose("hung", 0.0, 0.0));
    for _ in 0..15 {
        old.receive(pose("r1", 0.0, 0.0));
        old.wait(1.0);
    }
    assert_eq!(old.names(), ["r1"]);
    let start = |pause_s: f64| {
        let mut new =
            Bench::asleep_at(old.now.after(seconds(pause_s)), settings(), Stored::default());
        new.begin_inquiry();
        new.receive(token("hung", true));
        new.receive(token("r1", true));
        new.receive(pose("speaks", 1.0, 0.0));
        new
    };
    let remembered: Vec<_> = old.roster.iter().cloned().map(Message::Roster).collect();
    let begin = |pause_s: f64, messages: &[Message]| {
        let mut new = start(pause_s);
        new.answer_all(messages.to_vec());
        new.wait(1.0);
        new
    };
    let mut soon = begin(2.0, &remembered);
    assert_eq!(soon.happened(), ["joined speaks"]);
    assert_eq!(soon.names(), ["r1", "speaks"]);
    soon.receive(token("newcomer", true));
    soon.receive(rank("hung", None, None));
    soon.wait(0.2);
    assert_eq!(soon.names(), ["hung", "newcomer", "r1", "speaks"]);
    // The fleet may be another one, or there was none.
    assert_eq!(begin(60.0, &remembered).names(), ["hung", "r1", "speaks"]);
    assert_eq!(begin(2.0, &[]).names(), ["hung", "r1", "speaks"]);
}

#[test]
fn a_term_above_the_own_leads_to_a_new_one_with_everything_published_again() {
    let mut bench = before();
    let before = graphs(&bench);
    let term = bench.roster.as_ref().unwrap().header.revision.term;
    let mut ahead = Roster::clone(bench.roster.as_ref().unwrap());
    ahead.header.revision.term = term + 5;
    let ahead = Message::Roster(Checked::new_unchecked(ahead));
    let mut checks = Vec::new();
    for _ in 0..2 {
        bench.asks.clear();
        for _ in 0..5 {
            bench.wait(1.0);
            for (name, x) in [("r3", 3.0), ("r2", 1.0), ("r1", 0.0)] {
                bench.receive(pose(name, x, 0.0));
            }
        }
        checks.extend(bench.asked());
        bench.answer_all(vec![ahead.clone()]);
    }
    assert_eq!(checks, [Pattern::One(Key::Roster), Pattern::One(Key::Roster)]);
    let from = bench.published.len();
    bench.wait(0.001);
    let bases: Vec<_> = bench.published[from..]
        .iter()
        .filter_map(|(_, message)| match message {
            Message::Graph(delta) => Some(delta.base),
            _ => None,
        })
        .collect();
    assert_eq!(bases, [None; 4], "at once, and whole");
    let roster = bench.roster.clone().unwrap();
    assert_eq!((roster.header.revision.term, bench.stored.term), (term + 6, term + 6));
    let nodes: Vec<_> = roster.robots.iter().map(|entry| entry.node).collect();
    assert_eq!(nodes, [0, 1, 2, 3]);
    assert_eq!(graphs(&bench), before);
    // Robots go on to join and leave in it.
    bench.receive(pose("r9", 9.0, 0.0));
    bench.wait(0.2);
    assert_eq!(bench.entry("r9").unwrap().node, 4);
}

#[test]
fn readers_are_asked_for_the_roster_at_once_when_the_link_is_back() {
    let mut bench = before();
    for outage_s in [60.0, 0.5] {
        bench.input(Input::LinkLost);
        bench.asks.clear();
        bench.wait(outage_s);
        assert!(bench.asks.is_empty(), "no service would answer");
        bench.input(Input::LinkRestored);
        assert_eq!(bench.asks.len(), 1);
    }
    bench.input(Input::LinkLost);
    bench.asks.clear();
    bench.input(Input::LinkRestored);
    assert_eq!(bench.asked(), [Pattern::One(Key::Roster)]);
    bench.answer_all(Vec::new());
    bench.wait(4.0);
    assert!(bench.asks.is_empty());
    bench.wait(1.0);
    assert_eq!(bench.asks.len(), 1);
}
