//! How the core follows rosters and graphs over a bus that loses, delays and repeats.

use std::sync::Arc;

use crate::common::{Bench, Ingest, Published, difference_of_shape, modality, patterns, settings};
use muster_model::content::Checked;
use muster_model::event::EventKind;
use muster_model::graph::{GraphReplica, GraphRow};
use muster_model::header::Revision;
use muster_model::settings::{Dimension, EmbedderSettings};
use muster_service::{Authority, Core, Input, testkit};
use muster_wire::{Key, Message, Pattern};
use proptest::prelude::*;

const NAMES: [&str; 3] = ["connectivity", "hierarchy", "spatial"];

fn fleet() -> Ingest {
    Ingest::two_cliques(&NAMES, 4)
}

/// A bench that has received one whole frame.
fn following() -> (Bench, Ingest) {
    let (mut bench, mut ingest) = (Bench::fresh(), fleet());
    bench.frame(&mut ingest);
    assert_eq!(bench.published.len(), 1);
    (bench, ingest)
}

/// A frame that changes one modality, not delivered yet.
fn changed(bench: &Bench, ingest: &mut Ingest, name: &str, weight: f64) -> Published {
    ingest.edge(name, "a0", "a1", weight);
    ingest.frame(bench.now)
}

fn revision_of(bench: &Bench, name: &str) -> Revision {
    bench.last().graphs.iter().find(|graph| graph.modality == modality(name)).unwrap().revision
}

#[test]
fn nothing_is_published_before_the_first_fetch_has_ended() {
    let (mut bench, mut ingest) = (Bench::new(EmbedderSettings::default()), fleet());
    bench.now = bench.now.before(testkit::START_RETRY_TIME);
    bench.input(Input::Started { linked: true });
    bench.now = bench.now.after(testkit::START_RETRY_TIME);
    assert_eq!(bench.state(), "starting");
    bench.frame(&mut ingest);
    assert!(bench.published.is_empty() && bench.events.is_empty());
    for questions in std::mem::take(&mut bench.fetches) {
        bench.answer_fetch(questions, Vec::new());
    }
    assert_eq!(bench.published.len(), 1);
}

#[test]
fn the_answers_of_the_first_fetch_are_a_frame() {
    let mut ingest = fleet();
    let frame = ingest.frame(muster_model::time::Tick(7));
    // The roster first: answers come in no particular order.
    let mut answers: Vec<_> = frame.messages().collect();
    answers.reverse();
    let bench = Bench::started(EmbedderSettings::default(), answers);
    assert_eq!(bench.last().roster, frame.roster.header.revision);
}

#[test]
fn a_frame_is_complete_only_with_all_its_graphs() {
    let (mut bench, mut ingest) = following();
    ingest.edge("spatial", "a0", "a1", 0.3);
    ingest.edge("hierarchy", "a0", "a1", 0.4);
    let frame = ingest.frame(bench.now);
    bench.receive(frame.graph("spatial"));
    bench.receive(frame.roster());
    assert_eq!(bench.published.len(), 1);
    bench.receive(frame.graph("hierarchy"));
    assert_eq!(bench.published.len(), 2);
    assert_eq!(bench.last().roster, frame.roster.header.revision);
    assert_eq!(bench.fetches.len(), 0, "a roster that overtakes its graphs is no reason to fetch");
    let revisions: Vec<_> =
        bench.last().graphs.iter().map(|graph| (graph.modality.clone(), graph.revision)).collect();
    assert_eq!(revisions, frame.roster.graphs);
}

#[test]
fn a_gap_is_mended_by_a_fetch_of_that_graph() {
    let (mut bench, mut ingest) = following();
    let before = bench.counter("fetches");
    bench.wait(1.0);
    let _lost = changed(&bench, &mut ingest, "spatial", 0.3);
    let frame = changed(&bench, &mut ingest, "spatial", 0.4);
    bench.receive(frame.graph("spatial"));
    bench.receive(frame.roster());
    assert_eq!(bench.counter("gaps"), 1);
    assert_eq!(bench.published.len(), 1);
    let wanted = vec![Pattern::One(Key::Roster), Pattern::One(Key::Graph(modality("spatial")))];
    assert!(bench.fetches.iter().map(|fetch| patterns(fetch)).eq([wanted]));
    bench.answer_fetches(&ingest);
    assert_eq!(revision_of(&bench, "spatial"), frame.roster.header.revision);
    assert_eq!((bench.counter("fetches") - before, bench.counter("frames_consistent")), (1, 2));
}

#[test]
fn a_lost_last_delta_shows_by_the_roster() {
    let (mut bench, mut ingest) = following();
    bench.wait(1.0);
    let frame = changed(&bench, &mut ingest, "spatial", 0.3);
    bench.receive(frame.roster());
    assert_eq!(bench.fetches.len(), 0);
    bench.wait(0.06);
    assert_eq!(bench.answer_fetches(&ingest), 1);
    assert_eq!(revision_of(&bench, "spatial"), frame.roster.header.revision);
}

#[test]
fn deltas_in_the_wrong_order_are_mended() {
    let (mut bench, mut ingest) = following();
    bench.wait(1.0);
    let first = changed(&bench, &mut ingest, "spatial", 0.3);
    let second = changed(&bench, &mut ingest, "spatial", 0.4);
    bench.receive(second.graph("spatial"));
    bench.receive(first.graph("spatial"));
    bench.receive(first.roster());
    bench.receive(second.roster());
    bench.answer_fetches(&ingest);
    assert_eq!(bench.last().roster, second.roster.header.revision);
}

#[test]
fn fetches_without_an_answer_are_repeated_at_intervals() {
    let (mut bench, mut ingest) = following();
    let before = bench.counter("fetches");
    bench.wait(1.0);
    let frame = changed(&bench, &mut ingest, "spatial", 0.3);
    bench.receive(frame.roster());
    for _ in 0..40 {
        bench.wait(0.1);
        // One fetch is in flight at most, and it is not answered.
        assert!(bench.fetches.len() <= 1);
        if let Some(fetch) = bench.fetches.pop_front() {
            bench.answer_fetch(fetch, Vec::new());
        }
    }
    assert!((7..=9).contains(&(bench.counter("fetches") - before)));
    bench.wait(0.5);
    bench.answer_fetches(&ingest);
    assert_eq!(bench.published.len(), 2);
}

#[test]
fn a_graph_ahead_of_the_roster_waits_but_not_for_ever() {
    let (mut bench, mut ingest) = following();
    bench.wait(1.0);
    let frame = changed(&bench, &mut ingest, "spatial", 0.3);
    bench.receive(frame.graph("spatial"));
    bench.wait(0.9);
    assert_eq!(bench.fetches.len(), 0);
    bench.wait(0.2);
    assert_eq!(bench.answer_fetches(&ingest), 1);
    assert_eq!(bench.last().roster, frame.roster.header.revision);
}

#[test]
fn a_fetch_that_crosses_the_next_frame_is_completed_by_it() {
    let (mut bench, mut ingest) = following();
    bench.wait(1.0);
    let lost = changed(&bench, &mut ingest, "spatial", 0.3);
    bench.receive(lost.roster());
    bench.wait(0.1);
    let fetch = bench.fetches.pop_front().unwrap();
    let stale = ingest.answer(&patterns(&fetch));
    let next = changed(&bench, &mut ingest, "spatial", 0.4);
    bench.deliver(&next);
    bench.answer_fetch(fetch, stale);
    assert_eq!(bench.published.len(), 2);
    assert_eq!(bench.last().roster, next.roster.header.revision);
    bench.wait(2.0);
    assert!(bench.fetches.is_empty());
}

#[test]
fn a_new_term_begins_with_snapshots_and_the_old_one_is_over() {
    let (mut bench, mut ingest) = following();
    let late = changed(&bench, &mut ingest, "spatial", 0.3);
    ingest.restart();
    let frame = bench.frame(&mut ingest);
    assert!(frame.graphs.iter().all(|delta| delta.base.is_none()));
    assert_eq!(bench.last().roster, Revision { term: 2, epoch: 1 });
    bench.deliver(&late);
    assert_eq!(bench.counter("messages_old"), 2);
    assert_eq!(bench.last().roster.term, 2);
    bench.deliver(&frame);
    assert_eq!(bench.counter("messages_old"), 2, "a repetition is not old");
}

#[test]
fn a_contradictory_delta_or_roster_is_refused_and_the_graph_stays() {
    let (mut bench, mut ingest) = following();
    let before = bench.get("graph/spatial", None).unwrap();
    let frame = changed(&bench, &mut ingest, "spatial", 0.3);
    let Message::Graph(delta) = frame.graph("spatial") else { panic!() };
    let mut bad = delta.as_ref().clone();
    bad.rows = vec![GraphRow { source: 999, edges: Vec::new() }];
    bench.receive(Message::Graph(Arc::new(bad)));
    assert_eq!(bench.get("graph/spatial", None).unwrap(), before);
    let mut roster = frame.roster.as_ref().clone();
    roster.graphs = vec![roster.graphs[0].clone(); 20];
    bench.receive_encoded(&Message::Roster(Checked::new_unchecked(roster)));
    let refusals: Vec<_> = bench
        .quarantined()
        .into_iter()
        .map(|kind| match kind {
            EventKind::Quarantined { key, reason, .. } => (key.as_str(), reason.as_str()),
            _ => panic!(),
        })
        .collect();
    assert_eq!(
        refusals.iter().map(|(key, _)| *key).collect::<Vec<_>>(),
        ["muster/v1/f/graph/spatial", "muster/v1/f/roster"]
    );
    assert!(refusals[0].1.contains("unknown node") && refusals[1].1.contains("more modalities"));
    bench.deliver(&frame);
    assert_eq!(bench.published.len(), 2);
}

#[test]
fn a_modality_that_the_roster_does_not_list_is_dropped() {
    let (mut bench, mut ingest) = following();
    let frame = ingest.frame(bench.now);
    let Some(Message::Graph(model)) = bench.get("graph/spatial", None).unwrap().pop() else {
        panic!()
    };
    for number in 0..40 {
        let mut invented = model.as_ref().clone();
        invented.modality = modality(&format!("m{number}"));
        bench.receive(Message::Graph(Arc::new(invented)));
    }
    assert_eq!(bench.counter("modalities_ignored"), 40 - 16);
    bench.deliver(&frame);
    assert_eq!(bench.get("graph/*", None).unwrap().len(), 3);
    assert_eq!(bench.last().graphs.len(), 3);
}

#[test]
fn a_modality_that_is_declared_later_is_followed_without_a_fetch() {
    let (mut bench, mut ingest) = following();
    ingest.clique("thermal", "a", 4, 0.5);
    let frame = ingest.frame(bench.now);
    bench.receive(frame.graph("thermal"));
    bench.input(Input::Timer);
    bench.receive(frame.roster());
    assert_eq!((bench.last().graphs.len(), bench.fetches.len()), (4, 0));
}

#[test]
fn invented_modalities_keep_the_fleets_own_out_for_no_longer_than_a_fetch() {
    let (mut bench, mut ingest) = (Bench::fresh(), fleet());
    let frame = ingest.frame(bench.now);
    for number in 0..40 {
        let mut invented = frame.graphs[0].as_ref().clone();
        invented.modality = modality(&format!("m{number}"));
        bench.receive(Message::Graph(Arc::new(invented)));
    }
    bench.deliver(&frame);
    assert!(bench.published.is_empty());
    bench.wait(1.0);
    bench.answer_fetches(&ingest);
    assert_eq!(bench.last().graphs.len(), 3);
}

#[test]
fn without_a_roster_the_bus_is_asked_again() {
    let mut bench = Bench::fresh();
    let mut ingest = fleet();
    assert_eq!(bench.state(), "waiting for a roster");
    let _unheard = ingest.frame(bench.now);
    bench.wait(2.5);
    assert_eq!(bench.answer_fetches(&ingest), 1);
    assert_eq!(bench.published.len(), 1);
}

#[test]
fn a_link_that_is_back_leads_to_a_fetch_of_everything() {
    let (mut bench, mut ingest) = following();
    bench.input(Input::LinkLost);
    let _unheard = changed(&bench, &mut ingest, "spatial", 0.3);
    bench.input(Input::LinkRestored);
    let all = vec![Pattern::One(Key::Roster), Pattern::Graphs, settings()];
    assert_eq!(patterns(bench.fetches.front().unwrap()), all);
    bench.answer_fetches(&ingest);
    assert_eq!(bench.published.len(), 2);
    assert_eq!(bench.term_checks.len(), 1, "another leader may have come meanwhile");
}

/// A snapshot of a graph with one edge, from far in the future.
fn forged(frame: &Published) -> Message {
    let Message::Graph(model) = frame.graph("spatial") else { panic!() };
    let mut forged = model.as_ref().clone();
    forged.header.revision = Revision { term: 900, epoch: 1 };
    forged.rows.truncate(1);
    Message::Graph(Arc::new(forged))
}

#[test]
fn a_forged_graph_is_taken_back_to_what_the_roster_lists() {
    let (mut bench, mut ingest) = (Bench::fresh(), fleet());
    let before = bench.counter("fetches");
    let first = bench.frame(&mut ingest);
    bench.receive(forged(&first));
    for number in 1..=20_u32 {
        ingest.edge("spatial", "a0", "a1", f64::from(number) / 40.0);
        let frame = bench.frame(&mut ingest);
        bench.answer_fetches(&ingest);
        if number == 12 {
            assert_eq!(bench.last().roster, frame.roster.header.revision);
        }
    }
    assert_eq!(bench.counter("graphs_taken_back"), 1);
    assert!(bench.counter("fetches") - before <= 2);
    assert_eq!(revision_of(&bench, "spatial"), ingest.published[&modality("spatial")].revision());
}

#[test]
fn a_graph_is_not_taken_back_while_its_roster_may_be_on_the_way() {
    let (mut bench, mut ingest) = (Bench::fresh(), fleet());
    let first = bench.frame(&mut ingest);
    bench.input(Input::LinkRestored);
    let fetch = bench.fetches.pop_front().unwrap();
    let stale = ingest.answer(&patterns(&fetch));
    let next = changed(&bench, &mut ingest, "spatial", 0.3);
    bench.receive(next.graph("spatial"));
    bench.answer_fetch(fetch, stale);
    assert_eq!(bench.counter("graphs_taken_back"), 0);
    bench.receive(next.roster());
    assert_eq!(bench.last().roster, next.roster.header.revision);
    // Nor by a forged message, nor to anything but what the roster lists.
    bench.receive(forged(&first));
    bench.wait(3.0);
    bench.receive(first.graph("spatial"));
    let fetch = bench.fetches.pop_front().unwrap();
    bench.answer_fetch(fetch, vec![first.graph("spatial")]);
    assert_eq!(bench.counter("graphs_taken_back"), 0);
}

#[test]
fn what_ingest_published_is_answered_for_it() {
    let (mut bench, ingest) = following();
    let wiring = muster_embedder::Embedder::wiring();
    assert_eq!(
        wiring.served.iter().filter(|served| served.authority == Authority::Cached).count(),
        2
    );
    let answers = bench.get("graph/*", None).unwrap();
    for answer in &answers {
        let Message::Graph(delta) = answer else { panic!() };
        let mut copy = GraphReplica::default();
        copy.apply(delta).unwrap();
        assert_eq!(copy, ingest.published[&delta.modality]);
    }
    assert_eq!(answers.len(), 3);
    assert!(matches!(bench.get("roster", None).unwrap()[..], [Message::Roster(_)]));
}

/// One frame of a random history.
#[derive(Debug, Clone)]
struct Step {
    changes: Vec<(usize, usize, usize, u8)>,
    join: Option<usize>,
    leave: Option<usize>,
    restart: bool,
    lost: u8,
    roster_first: bool,
    /// 0: answered at once, 1: answered with the frame before, 2: not answered.
    fetch: u8,
    wait: f64,
}

fn step() -> impl Strategy<Value = Step> {
    let change = (0..3_usize, 0..6_usize, 0..6_usize, 0..3_u8);
    (
        prop::collection::vec(change, 0..4),
        prop::option::weighted(0.3, 0..6_usize),
        prop::option::weighted(0.2, 0..6_usize),
        prop::bool::weighted(0.05),
        prop_oneof![3 => Just(0_u8), 2 => 0..16_u8],
        prop::bool::weighted(0.2),
        0..3_u8,
        prop_oneof![3 => Just(0.1), 1 => Just(0.7)],
    )
        .prop_map(|(changes, join, leave, restart, lost, roster_first, fetch, wait)| Step {
            changes,
            join,
            leave,
            restart,
            lost,
            roster_first,
            fetch,
            wait,
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn whatever_is_lost_the_end_is_the_truth(steps in prop::collection::vec(step(), 1..25)) {
        // Which dimension is best may depend on the frame before.
        let fixed =
            || EmbedderSettings { dimension: Dimension::Fixed(4), ..EmbedderSettings::default() };
        let mut bench = Bench::started(fixed(), Vec::new());
        let mut ingest = Ingest::new(&NAMES);
        for name in ["r0", "r1", "r2"] {
            ingest.join(name);
        }
        for step in steps {
            let stale: Vec<_> = std::mem::take(&mut bench.fetches)
                .into_iter()
                .map(|fetch| (ingest.answer(&patterns(&fetch)), fetch))
                .collect();
            if step.restart {
                ingest.restart();
            }
            if let Some(number) = step.join {
                ingest.join(&format!("r{number}"));
            }
            if let Some(number) = step.leave {
                ingest.leave(&format!("r{number}"));
            }
            for (name, from, to, weight) in step.changes {
                let (from, to) = (format!("r{from}"), format!("r{to}"));
                ingest.edge(NAMES[name], &from, &to, f64::from(weight));
            }
            let frame = ingest.frame(bench.now);
            let mut messages: Vec<_> = frame.messages().collect();
            if step.roster_first {
                messages.rotate_right(1);
            }
            for (place, message) in messages.into_iter().enumerate() {
                if step.lost & (1 << place) == 0 {
                    bench.receive(message);
                }
            }
            for (answers, fetch) in stale {
                let answers = if step.fetch == 2 { Vec::new() } else { answers };
                bench.answer_fetch(fetch, answers);
            }
            if step.fetch == 0 {
                bench.answer_fetches(&ingest);
            }
            bench.wait(step.wait);
        }
        // From here on nothing is lost but what was lost before.
        let last = ingest.frame(bench.now);
        bench.receive(last.roster());
        for _ in 0..20 {
            bench.wait(0.2);
            bench.answer_fetches(&ingest);
        }
        for answer in bench.get("graph/*", None).unwrap() {
            let Message::Graph(delta) = answer else { panic!() };
            let mut copy = GraphReplica::default();
            copy.apply(&delta).unwrap();
            prop_assert_eq!(&copy, &ingest.published[&delta.modality]);
        }
        prop_assert_eq!(bench.quarantined().len(), 0);
        if ingest.count() > 0 {
            let graphs: Vec<_> =
                bench.last().graphs.iter().map(|graph| (graph.modality.clone(), graph.revision)).collect();
            prop_assert_eq!(graphs, last.roster.graphs.clone());
            let whole = ingest.answer(&[Pattern::One(Key::Roster), Pattern::Graphs]);
            let truth = Bench::started(fixed(), whole);
            prop_assert!(difference_of_shape(bench.last(), truth.last()) < 1e-9);
        }
    }
}
