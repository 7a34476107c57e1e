//! What is published, and when.

use std::collections::BTreeMap;

use crate::bench::{
    self, Bench, bare_pose, links, modality, pose, rank, relation, report, seconds, token,
};
use muster_ingest::Ingest;
use muster_model::graph::{GraphDelta, GraphReplica};
use muster_model::id::ServiceName;
use muster_model::observation::Pose;
use muster_model::settings::IngestSettings;
use muster_service::{Core, Delivery, Input, ServedKey};
use muster_wire::{Key, Message, Pattern};
use serde_json::json;

/// The deltas of one graph that were published from a place in the output on.
fn deltas<'a>(bench: &'a Bench, of: &str, from: usize) -> Vec<&'a GraphDelta> {
    let deltas = bench.published[from..].iter().filter_map(|(_, message)| match message {
        Message::Graph(delta) => Some(delta.as_ref()),
        _ => None,
    });
    deltas.filter(|delta| delta.modality == modality(of)).collect()
}

#[test]
fn the_wiring_takes_every_stream_and_serves_every_output() {
    let wiring = Ingest::wiring();
    let patterns: Vec<_> =
        wiring.subscriptions.iter().map(|subscription| subscription.pattern.clone()).collect();
    assert_eq!(patterns, Pattern::streams());
    for subscription in wiring.subscriptions {
        assert_eq!(subscription.delivery, Delivery::Latest);
    }
    assert_eq!(wiring.tokens, [Pattern::RobotTokens]);
    assert_eq!(
        wiring.served,
        [ServedKey::own(Pattern::Graphs), ServedKey::own(Pattern::One(Key::Roster))]
    );
    assert_eq!(Ingest::SERVICE, ServiceName::Ingest);
}

#[test]
fn nothing_is_published_before_the_last_term_is_known() {
    let mut bench = Bench::asleep(IngestSettings::default());
    bench.begin_inquiry();
    // The question for the leader is answered: there is none.
    let settings = Pattern::One(Key::Settings(ServiceName::Ingest));
    assert_eq!(bench.asked(), [Pattern::One(Key::Roster), Pattern::Graphs, settings]);
    bench.receive(pose("r1", 0.0, 0.0));
    bench.receive(pose("r1", f64::NAN, 0.0));
    bench.receive(token("r2", true));
    bench.input(Input::Timer);
    bench.wait(1.0);
    assert!(bench.published.is_empty() && bench.events.is_empty());
    assert_eq!(bench.get("roster", None), Ok(vec![]));
    assert_eq!(bench.get("graph/spatial", None), Ok(vec![]));
    assert_eq!(bench.get("teams", None), Ok(vec![]));
    assert_eq!(bench.status().state, "waiting for the bus");
    let asks = bench.asks.clone();
    bench.answer_all(Vec::new());
    bench.wait(0.001);
    assert_eq!(bench.happened(), ["joined r1", "joined r2"]);
    assert_eq!(bench.counter("robots_joined"), 2);
    assert_eq!(bench.names(), ["r1", "r2"]);
    assert_eq!(bench.counter("messages_refused"), 1);
    // A second answer to the same questions changes nothing.
    let revision = bench.roster.as_ref().unwrap().header.revision;
    bench.asks.splice(..0, asks);
    bench.answer_all(Vec::new());
    bench.receive(pose("r1", 1.0, 0.0));
    bench.wait(0.5);
    assert_eq!(bench.roster.as_ref().unwrap().header.revision.term, revision.term);
}

#[test]
fn a_term_begins_with_every_graph_even_if_it_is_empty() {
    let settings =
        IngestSettings { modalities: vec![modality("thermal")], ..IngestSettings::default() };
    let mut bench = Bench::new(settings);
    for name in ["connectivity", "hierarchy", "spatial", "thermal"] {
        let first = deltas(&bench, name, 0);
        assert_eq!((first.len(), first[0].base), (1, None), "{name}");
    }
    assert!(matches!(bench.published.last(), Some((_, Message::Roster(_)))), "the roster is last");
    bench.wait(59.9);
    assert_eq!(bench.frame_times().len(), 61, "an empty roster that was lost is published again");
    assert_eq!(bench.delta_count(), 4);
}

#[test]
fn a_frame_has_one_revision_and_the_roster_lists_each_graph_with_its_own() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    bench.receive(pose("r2", 1.0, 0.0));
    bench.receive(pose("r3", 3.0, 0.0));
    bench.wait(0.2);
    let from = bench.published.len();
    bench.receive(pose("r1", 0.5, 0.0));
    bench.receive(rank("r1", Some("r2"), None));
    bench.wait(0.2);
    let heads: Vec<_> =
        bench.published[from..].iter().map(|(_, message)| message.header().unwrap()).collect();
    assert_eq!(heads.len(), 3, "the hierarchy, the spatial graph, the roster");
    assert!(heads.iter().all(|head| *head == heads[0]));
    assert_eq!(heads[0].fleet, bench::fleet());
    let listed = &bench.roster.as_ref().unwrap().graphs;
    let revisions: BTreeMap<_, _> =
        listed.iter().map(|(name, revision)| (name.as_str(), *revision)).collect();
    assert_eq!(
        revisions.keys().copied().collect::<Vec<_>>(),
        ["connectivity", "hierarchy", "spatial"]
    );
    assert_eq!(revisions["hierarchy"], heads[0].revision);
    assert!(revisions["connectivity"] < heads[0].revision);
}

#[test]
fn the_first_change_after_a_quiet_time_is_published_at_once_and_others_keep_the_rate() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(0.55);
    let start = bench.now;
    let from = bench.frame_times().len();
    for step in 1..=100 {
        bench.receive(pose("r1", f64::from(step), 0.0));
        bench.wait(0.01);
    }
    let times = &bench.frame_times()[from..];
    assert_eq!(times[0], start);
    assert_eq!(times.len(), 11);
    for pair in times.windows(2) {
        assert_eq!(pair[1].since(pair[0]), seconds(0.1));
    }
    bench.set(&json!({"tick_hz": 2.0}));
    let from = bench.frame_times().len();
    for step in 1..=300 {
        bench.receive(pose("r1", f64::from(step), 0.0));
        bench.wait(0.01);
    }
    for pair in bench.frame_times()[from..].windows(2) {
        assert_eq!(pair[1].since(pair[0]), seconds(0.5));
    }
}

#[test]
fn frames_that_take_long_are_fewer_until_they_are_short_again() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(0.5);
    let from = bench.frame_times().len();
    for step in 1..=200 {
        let frames = bench.frame_times().len();
        bench.receive(pose("r1", f64::from(step), 0.0));
        bench.input(Input::Timer);
        // The next event comes when the frame is made and published, and 60 ms are more than a quarter of a
        // tick.
        let made = bench.frame_times().len() > frames;
        bench.now = bench.now.after(seconds(if made { 0.06 } else { 0.01 }));
    }
    let times = &bench.frame_times()[from..];
    assert!(times.len() > 5, "{times:?}");
    for pair in times.windows(2) {
        assert_eq!(pair[1].since(pair[0]), seconds(0.24));
    }

    // A host that hangs during a frame makes the next one at once, and then has its tick again.
    bench.wait(1.0);
    bench.receive(pose("r1", -1.0, 0.0));
    bench.input(Input::Timer);
    bench.now = bench.now.after(seconds(1.5));
    let from = bench.frame_times().len();
    for step in 1..=50 {
        bench.receive(pose("r1", f64::from(step), 1.0));
        bench.wait(0.01);
    }
    let times = &bench.frame_times()[from..];
    assert!(times.len() >= 4, "{times:?}");
    assert!(times[1..].windows(2).all(|pair| pair[1].since(pair[0]) == seconds(0.1)), "{times:?}");
}

/// Timers come a little late, each time.
#[test]
fn frames_that_are_made_a_moment_late_do_not_move_those_after_them() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(0.55);
    // How late in seconds, and how many frames there are in ten seconds: one that is later is no timer's fault.
    for (late, frames) in [(0.0, 100), (0.001, 100), (0.005, 100), (0.02, 83)] {
        bench.wait(1.0);
        let from = bench.frame_times().len();
        let end = bench.now.after(seconds(10.0));
        for step in 1.. {
            bench.receive(pose("r1", f64::from(step), late));
            let due = bench.host.deadline().unwrap();
            bench.now = due.max(bench.now).after(seconds(late));
            if bench.now > end {
                break;
            }
            bench.input(Input::Timer);
        }
        let made = bench.frame_times().len() - from;
        assert!(made.abs_diff(frames) <= 1, "{late} s late: {made} frames");
    }
}

#[test]
fn an_early_timeout_makes_no_frame() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(0.001);
    let frames = bench.frame_times().len();
    bench.receive(pose("r1", 1.0, 0.0));
    bench.now = bench.now.after(seconds(0.09));
    bench.input(Input::Timer);
    assert_eq!(bench.frame_times().len(), frames);
    bench.wait(0.01);
    assert_eq!(bench.frame_times().len(), frames + 1);
}

#[test]
fn what_repeats_itself_leads_to_heartbeats_only() {
    let mut bench = Bench::default();
    let say = |bench: &mut Bench| {
        bench.receive(pose("r1", 0.0, 0.0));
        bench.receive(pose("r2", 3.0, 0.0));
        bench.receive(links("r1", &[("r2", 0.5), ("r3", 0.1)]));
        bench.receive(rank("r2", Some("r1"), None));
    };
    say(&mut bench);
    bench.wait(0.5);
    let (deltas, frames) = (bench.delta_count(), bench.frame_times().len());
    for _ in 0..100 {
        say(&mut bench);
        bench.wait(0.1);
    }
    assert_eq!(bench.delta_count(), deltas);
    let beats = bench.frame_times().len() - frames;
    assert!((9..=10).contains(&beats), "{beats}");
    let last_seen = bench.entry("r1").unwrap().last_seen;
    assert!(bench.now.since(last_seen) < seconds(1.2), "heartbeats say who was received");
    for pair in bench.frame_times()[frames..].windows(2) {
        assert_eq!(pair[1].since(pair[0]), seconds(1.0));
    }
}

#[test]
fn slow_frames_have_slow_heartbeats() {
    let mut bench = Bench::new(IngestSettings {
        tick_hz: 0.5,
        gone_after_s: 60.0,
        ..IngestSettings::default()
    });
    bench.receive(token("r1", true));
    bench.wait(11.0);
    for pair in bench.frame_times().windows(2) {
        assert_eq!(pair[1].since(pair[0]), seconds(2.0));
    }
    assert_eq!(bench.frame_times().len(), 6);
}

#[test]
fn a_report_that_changes_no_graph_leads_to_no_frame() {
    let mut bench = Bench::default();
    bench.receive(token("r1", true));
    bench.wait(0.2);
    let frames = bench.published.len();
    for quality in 0..5 {
        bench.receive(links("r1", &[("unknown", f64::from(quality) / 10.0)]));
        bench.wait(0.1);
    }
    assert_eq!(bench.published.len(), frames);
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(0.1);
    assert_eq!(bench.published.len(), frames + 1, "a first pose alone is news for the roster");
}

#[test]
fn a_delta_holds_only_the_rows_that_changed() {
    let mut bench = Bench::default();
    for name in ["r1", "r2", "r3", "r4"] {
        bench.receive(token(name, true));
    }
    bench.receive(links("r1", &[("r2", 0.5), ("r3", 0.25)]));
    bench.receive(links("r4", &[("r2", 1.0)]));
    bench.wait(0.2);
    let from = bench.published.len();
    bench.receive(links("r1", &[("r3", 0.25)]));
    bench.wait(0.2);
    let changed = deltas(&bench, "connectivity", from);
    assert_eq!(changed.len(), 1);
    let rows: Vec<_> = changed[0].rows.iter().map(|row| (row.source, row.edges.clone())).collect();
    assert_eq!(rows, [(2, vec![(4, 1.0)])]);
    bench.receive(links("r4", &[]));
    let from = bench.published.len();
    bench.wait(0.2);
    let changed = deltas(&bench, "connectivity", from);
    assert_eq!((changed[0].rows[0].source, changed[0].rows[0].edges.len()), (2, 0));
    assert_eq!(changed[0].nodes_added.len() + changed[0].nodes_removed.len(), 0);
}

#[test]
fn edges_run_as_the_modality_says() {
    let settings =
        IngestSettings { modalities: vec![modality("thermal")], ..IngestSettings::default() };
    let mut bench = Bench::new(settings);
    bench.receive(pose("r1", 0.0, 0.0));
    bench.receive(pose("r2", 1.0, 0.0));
    bench.receive(links("r1", &[("r2", 0.5)]));
    bench.receive(rank("r1", Some("r2"), Some(4.0)));
    bench.receive(relation("r1", "thermal", &[("r2", 7.0), ("r3", 0.0)]));
    bench.wait(0.2);
    assert_eq!(bench.weight("connectivity", "r2", "r1"), Some(0.5));
    assert_eq!(bench.weight("hierarchy", "r2", "r1"), Some(4.0));
    assert_eq!(bench.weight("thermal", "r1", "r2"), Some(7.0));
    for name in ["connectivity", "hierarchy", "thermal"] {
        assert_eq!(bench.graph(name).len(), 1, "{name}");
    }
    assert_eq!(bench.weight("spatial", "r1", "r2"), bench.weight("spatial", "r2", "r1"));
    assert_eq!(bench.graph("spatial").len(), 2);
}

#[test]
fn robots_of_different_frames_and_unplaced_ones_are_not_near() {
    let frames = vec!["map".to_owned(), "odom".to_owned()];
    let mut bench = Bench::new(IngestSettings { frames, ..IngestSettings::default() });
    let odom = |x: f64| Pose { frame: Some("odom".to_owned()), ..bare_pose(x, 0.0) };
    bench.receive(pose("r1", 0.0, 0.0));
    bench.receive(pose("r2", 1.0, 0.0));
    bench.receive(report("r3", odom(0.5)));
    bench.receive(report("r4", odom(1.5)));
    bench.receive(token("r5", true));
    bench.wait(0.2);
    let edges: Vec<_> = bench.graph("spatial").into_keys().collect();
    let named: Vec<_> = edges.iter().map(|(from, to)| format!("{from}-{to}")).collect();
    assert_eq!(named, ["r1-r2", "r2-r1", "r3-r4", "r4-r3"]);
    assert_eq!(bench.entry("r1").unwrap().frame.as_deref(), Some("map"));
    assert_eq!(bench.graphs[&modality("spatial")].nodes().len(), 5);
}

#[test]
fn the_header_holds_the_ages_of_the_data() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    let first = bench.now;
    bench.wait(0.3);
    bench.receive(pose("r2", 1.0, 0.0));
    let second = bench.now;
    bench.wait(0.3);
    bench.receive(links("r2", &[("r1", 0.5)]));
    let third = bench.now;
    bench.wait(0.05);
    let header = &bench.roster.as_ref().unwrap().header;
    assert_eq!((header.oldest, header.newest), (Some(first), Some(second)));
    let stage = header.stages[0];
    assert_eq!((stage.stage, stage.received, header.stages.len()), (ServiceName::Ingest, third, 1));
    assert!(stage.published >= third);
    bench.wait(2.0);
    bench.receive(pose("r2", 2.0, 0.0));
    bench.wait(0.2);
    let header = bench.roster.as_ref().unwrap().header.clone();
    assert_eq!(header.oldest, header.newest, "a stale robot's pose does not count");
    bench.wait(3.0);
    let all_stale = &bench.roster.as_ref().unwrap().header;
    assert_eq!((all_stale.oldest, all_stale.newest), (Some(first), header.newest));
    bench.receive(token("r3", true));
    bench.wait(0.2);
    assert_eq!(bench.roster.as_ref().unwrap().header.oldest, None, "no active robot is placed");
}

#[test]
fn gets_are_answered_with_the_last_frame() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    bench.receive(pose("r2", 1.0, 0.0));
    bench.wait(0.2);
    let roster = bench.roster.clone().unwrap();
    bench.receive(pose("r3", 2.0, 0.0));
    assert_eq!(bench.get("roster", None), Ok(vec![Message::Roster(roster.clone())]));
    let answer = bench.get("graph/*", None).unwrap();
    assert_eq!(answer.len(), 3);
    for message in answer {
        let Message::Graph(delta) = message else { panic!("{message:?}") };
        let (_, revision) =
            roster.graphs.iter().find(|(listed, _)| *listed == delta.modality).unwrap();
        assert_eq!((delta.base, delta.header.revision), (None, *revision));
        let mut replica = GraphReplica::default();
        replica.apply(&delta).unwrap();
        assert_eq!(replica, bench.graphs[&delta.modality]);
    }
    assert_eq!(bench.get("graph/spatial", None).unwrap().len(), 1);
    assert_eq!(bench.get("graph/unknown", None), Ok(vec![]));
    assert_eq!(bench.get("teams", None), Ok(vec![]));
    assert!(bench.get("service/ingest/settings", Some(&json!({"tick": 1}))).is_err());
}

#[test]
fn declared_modalities_come_and_go() {
    let mut bench = Bench::default();
    bench.receive(token("r1", true));
    bench.receive(token("r2", true));
    bench.wait(0.2);
    bench.set(&json!({"modalities": ["thermal"]}));
    bench.receive(relation("r1", "thermal", &[("r2", 1.0)]));
    bench.wait(0.2);
    assert_eq!(bench.graph("thermal").len(), 1);
    let before = bench.published.len();
    bench.set(&json!({"modalities": []}));
    bench.wait(0.2);
    assert!(!bench.graphs.contains_key(&modality("thermal")));
    assert_eq!(bench.get("graph/thermal", None), Ok(vec![]));
    assert_eq!(bench.published.len(), before + 1, "the other graphs did not change");
    bench.set(&json!({"modalities": ["thermal"]}));
    bench.wait(0.2);
    assert!(bench.graph("thermal").is_empty(), "what was said before is forgotten");
}

#[test]
fn new_kernels_make_new_weights() {
    let mut bench = Bench::default();
    for (name, x) in [("r1", 0.0), ("r2", 1.0), ("r3", 3.0)] {
        bench.receive(pose(name, x, 0.0));
    }
    bench.wait(0.2);
    let before = bench.weight("spatial", "r1", "r3").unwrap();
    bench.set(&json!({"spatial": {"kernel": "exponential"}}));
    bench.wait(0.2);
    assert_ne!(bench.weight("spatial", "r1", "r3").unwrap(), before);
    bench.set(&json!({"spatial": {"radius_m": 2.5}}));
    bench.wait(0.2);
    assert_eq!(bench.weight("spatial", "r1", "r3"), None);
    assert_eq!(bench.graph("spatial").len(), 4);
}

#[test]
fn the_graph_does_not_depend_on_who_came_first() {
    let places = [("r1", 0.0), ("r2", 1.0), ("r3", 3.0), ("r4", 3.5)];
    let graph = |backwards: bool| {
        let mut bench = Bench::default();
        let mut order = places.to_vec();
        if backwards {
            order.reverse();
        }
        for (name, x) in order {
            bench.receive(pose(name, x, 0.0));
        }
        bench.wait(0.2);
        bench.graph("spatial")
    };
    assert_eq!(graph(true), graph(false));
}
