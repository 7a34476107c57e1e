//! Random lives of a fleet: what a consumer follows is what a get answers, and what a restart
//! restores.

use crate::bench::{Bench, Put, links, modality, named, pose, rank, relation, seconds, token};
use muster_model::graph::GraphReplica;
use muster_model::roster::{Presence, RosterEntry};
use muster_model::settings::{IngestSettings, Settings};
use muster_service::{Input, Stored};
use muster_wire::Message;
use proptest::prelude::*;
use serde_json::{Value, json};

const NAMES: [&str; 6] = ["a", "b", "c", "d", "e", "f"];

#[derive(Debug, Clone)]
enum Step {
    Say(Put),
    Wait(f64),
    Set(Value),
    Link(bool),
}

fn name() -> impl Strategy<Value = &'static str> {
    prop::sample::select(&NAMES[..])
}

/// Other robots with weights; some weights and some relations to oneself are to be refused.
fn peers() -> impl Strategy<Value = Vec<(&'static str, f64)>> {
    let weight = prop::sample::select(vec![0.0, 0.25, 0.5, 1.0, 1.0, 1.5]);
    prop::collection::vec((name(), weight), 0..4)
}

fn message() -> impl Strategy<Value = Put> {
    prop_oneof![
        4 => (name(), 0..5_i32, 0..3_i32).prop_map(|(r, x, y)| pose(r, x.into(), y.into())),
        2 => (name(), peers()).prop_map(|(r, peers)| links(r, &peers)),
        2 => (name(), prop::option::of(name()), prop::sample::select(vec![0.0, 1.0, 9.0]))
            .prop_map(|(r, superior, weight)| rank(r, superior, Some(weight))),
        2 => (name(), prop::sample::select(vec!["thermal", "trust"]), peers())
            .prop_map(|(r, of, peers)| relation(r, of, &peers)),
        2 => (name(), any::<bool>()).prop_map(|(r, alive)| token(r, alive)),
    ]
}

fn patch() -> impl Strategy<Value = Value> {
    prop::sample::select(vec![
        json!({"modalities": []}),
        json!({"modalities": ["thermal"]}),
        json!({"modalities": ["trust", "thermal"]}),
        json!({"tick_hz": 5.0}),
        json!({"max_robots": 4}),
        json!({"max_robots": 6}),
        json!({"spatial": {"all_pairs_up_to": 0, "neighbours": 1}}),
        json!({"spatial": {"kernel": "wendland-c2", "cutoff": 2}}),
        json!({"spatial": null}),
        json!({"stale_after_s": 0.5, "gone_after_s": 1.5}),
        json!({"stale_after_s": 1.0, "gone_after_s": 4.0}),
    ])
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        12 => message().prop_map(Step::Say),
        6 => (0..40_u32).prop_map(|tenths| Step::Wait(f64::from(tenths * tenths) / 400.0)),
        2 => patch().prop_map(Step::Set),
        1 => any::<bool>().prop_map(Step::Link),
    ]
}

/// What is answered to a get of every graph is what the deltas lead to.
fn answers_are_what_was_followed(bench: &mut Bench) {
    let answer = bench.get("graph/*", None).unwrap();
    assert_eq!(answer.len(), bench.graphs.len());
    for message in answer {
        let Message::Graph(delta) = message else { panic!("{message:?}") };
        let mut replica = GraphReplica::default();
        replica.apply(&delta).unwrap();
        assert_eq!(replica, bench.graphs[&delta.modality], "{}", delta.modality);
    }
    let roster = bench.roster.clone().unwrap();
    assert_eq!(bench.get("roster", None), Ok(vec![Message::Roster(roster)]));
}

/// However long one looks, there are no more frames than the fastest rate allows. One frame may be late by what a
/// timer is late (5 ms) without moving those after it, so that two are nearer each other by no more than that.
fn frames_keep_their_rate(bench: &Bench) {
    let times = bench.frame_times();
    for (first, begin) in times.iter().enumerate() {
        for (periods, end) in (1..).zip(&times[first + 1..]) {
            let shortest = seconds(f64::from(periods) * 0.1 - 0.005);
            assert!(
                end.since(*begin) >= shortest,
                "{periods} periods of 10 Hz in {:?}",
                end.since(*begin)
            );
        }
    }
}

/// Whoever has left a moment ago is out of the roster with the next frame, if not sooner.
fn the_roster_catches_up(bench: &mut Bench) -> bool {
    (0..5).any(|_| {
        let known = bench.counter("robots_joined") + bench.counter("robots_restored")
            - bench.counter("robots_left");
        let is_published = known == bench.names().len() as u64;
        if !is_published {
            bench.wait(0.2);
        }
        is_published
    })
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn consumers_follow_every_life_and_a_restart_restores_its_end(
        steps in prop::collection::vec(step(), 1..120),
    ) {
        let settings =
            IngestSettings { modalities: vec![modality("thermal")], ..IngestSettings::default() };
        let mut bench = Bench::new(settings.clone());
        for step in steps {
            match step {
                Step::Say(message) => bench.receive(message),
                Step::Wait(duration_s) => {
                    bench.wait(duration_s);
                    answers_are_what_was_followed(&mut bench);
                }
                Step::Set(patch) => bench.set(&patch),
                Step::Link(true) => bench.input(Input::LinkRestored),
                Step::Link(false) => bench.input(Input::LinkLost),
            }
        }
        bench.input(Input::LinkRestored);
        bench.wait(0.3);
        answers_are_what_was_followed(&mut bench);
        frames_keep_their_rate(&bench);
        prop_assert!(the_roster_catches_up(&mut bench));

        // The new process has the same settings, and room for all robots.
        let patch = Value::Object(bench.stored.patch.clone());
        let mut settings = settings.patched(&patch).unwrap();
        settings.max_robots = 6;
        let gone_after_s = settings.gone_after_s;
        let mut new = Bench::asleep_at(bench.now, settings, Stored::default());
        new.start(bench.remembered());
        // An outage was forgiven before the restart; whoever was stale has no grace period again.
        let grace_period = seconds(gone_after_s);
        let roster = bench.roster.clone().unwrap();
        let now = new.now;
        let leaves = |entry: &RosterEntry| {
            entry.presence == Presence::Stale && now.since(entry.last_seen) >= grace_period
        };
        if roster.robots.iter().any(leaves) {
            new.wait(0.001);
            let stay = roster.robots.iter().filter(|entry| !leaves(entry));
            prop_assert_eq!(new.names(), stay.map(|e| e.robot.as_str()).collect::<Vec<_>>());
            return Ok(());
        }
        // With no robot to restore, it waits for one to join.
        new.wait(if bench.names().is_empty() { 1.0 } else { 0.001 });
        prop_assert_eq!(new.names(), bench.names());
        prop_assert_eq!(new.graphs.len(), bench.graphs.len());
        for (modality, graph) in &bench.graphs {
            prop_assert_eq!(named(&new.graphs[modality]), named(graph), "{}", modality);
        }
        answers_are_what_was_followed(&mut new);
    }

    /// Refused messages between the others change no output.
    #[test]
    fn the_outputs_do_not_depend_on_refused_messages(
        steps in prop::collection::vec((message(), 0..30_u32), 1..60),
    ) {
        let run = |with_refused: bool| {
            let mut bench = Bench::new(IngestSettings::default());
            for (message, hundredths) in &steps {
                if with_refused {
                    bench.receive(pose("a", f64::NAN, 0.0));
                    bench.receive(links("b", &[("c", 2.0)]));
                    bench.receive(rank("x", Some("x"), None));
                    bench.receive(relation("y", "thermal", &[("a", 1.0)]));
                }
                bench.receive(message.clone());
                bench.wait(f64::from(*hundredths) / 100.0);
            }
            bench.wait(1.0);
            bench.published
        };
        prop_assert_eq!(run(true), run(false));
    }
}
