//! What the core computes, when, and what it does when it cannot.

use crate::common::{Bench, Ingest, announced, announced_at, closed_forms, dot, robot, row};
use muster_model::content::Checked;
use muster_model::embedding::{Embedding, EmbeddingMode};
use muster_model::event::EventKind;
use muster_model::header::{Header, Revision};
use muster_model::id::ServiceName;
use muster_model::settings::{Alpha, Dimension, EmbedderSettings, MAX_DIMENSION, TeamCount};
use muster_service::Input;
use muster_wire::Message;

const NAMES: [&str; 3] = ["connectivity", "hierarchy", "spatial"];

fn fleet() -> Ingest {
    Ingest::two_cliques(&NAMES, 4)
}

fn following() -> (Bench, Ingest) {
    let (mut bench, mut ingest) = (Bench::fresh(), fleet());
    bench.frame(&mut ingest);
    assert_eq!(bench.published.len(), 1);
    (bench, ingest)
}

fn learned(bench: &mut Bench) -> Vec<Message> {
    bench.get("embedding", None).unwrap()
}

#[test]
fn two_cliques_have_vectors_apart() {
    let (mut bench, _) = following();
    let embedding = bench.last();
    for i in 0..4 {
        for j in 0..4 {
            let (a, b) = (row(embedding, &format!("a{i}")), row(embedding, &format!("b{j}")));
            assert!(dot(a, row(embedding, &format!("a{j}"))) > 0.9);
            assert!(dot(a, b).abs() < 1e-9);
        }
    }
    assert!(embedding.without_embedding.iter().all(|without| !without));
    assert_eq!(embedding.dimension, 4);
    assert!(embedding.quality.residual < 1e-12 && embedding.quality.katz_residual < 1e-12);
    assert_eq!(embedding.quality.mode, EmbeddingMode::Dense);
    let weights: Vec<_> = embedding.graphs.iter().map(|graph| graph.weight).collect();
    assert_eq!(weights, [0.05, 0.6, 0.35]);
    assert_eq!(embedding.header.stages.last().unwrap().stage, ServiceName::Embedder);
    assert_eq!(embedding.header.revision, Revision { term: 1, epoch: 1 });
    let state = bench.state();
    assert!(state.starts_with("8 robots, dimension 4, residual "), "{state}");
}

#[test]
fn robots_without_relations_have_no_embedding() {
    let (mut bench, mut ingest) = following();
    ingest.join("loner");
    bench.frame(&mut ingest);
    let embedding = bench.last();
    let without =
        embedding.robots.iter().zip(&embedding.without_embedding).filter(|(_, without)| **without);
    assert!(without.map(|(name, _)| name).eq([&robot("loner")]));
    assert!(row(embedding, "loner").iter().all(|value| *value == 0.0));
}

#[test]
fn small_and_empty_fleets_have_an_answer_or_none() {
    let (mut bench, mut ingest) = (Bench::fresh(), Ingest::new(&NAMES));
    bench.frame(&mut ingest);
    assert!(bench.published.is_empty());
    assert_eq!(bench.state(), "no robots");
    for count in 1..3 {
        ingest.join(&format!("r{count}"));
        bench.frame(&mut ingest);
        let embedding = bench.last();
        assert_eq!((embedding.robots.len(), embedding.dimension), (count, 2));
        assert_eq!(embedding.without_embedding, vec![true; count]);
    }
    ingest.edge("spatial", "r1", "r2", 1.0);
    bench.frame(&mut ingest);
    assert!(bench.last().without_embedding.iter().any(|without| !without));
    bench.set(r#"{"dimension": 64}"#);
    assert_eq!(bench.last().dimension, 4, "no more than two columns per robot");
}

#[test]
fn an_unchanged_frame_is_not_computed_again_but_published_at_intervals() {
    let (mut bench, mut ingest) = following();
    let first = bench.last().clone();
    for _ in 0..25 {
        bench.frame(&mut ingest);
    }
    assert_eq!(bench.counter("jobs_started"), 2, "and one at rest");
    assert_eq!(bench.published.len(), 3, "after one second, and after two");
    let again = bench.last();
    assert_eq!((&again.values, &again.graphs), (&first.values, &first.graphs));
    assert!(again.header.revision > first.header.revision);
    assert!(again.header.oldest > first.header.oldest && again.roster > first.roster);
    assert_eq!(again.quality.mode, EmbeddingMode::Cached);
    assert_eq!(learned(&mut bench), [Message::Embedding(bench.published[2].clone())]);
    // Without rosters the data ages, and nothing says otherwise.
    bench.wait(1.0);
    let count = bench.published.len();
    bench.wait(5.0);
    assert_eq!(bench.published.len(), count);
}

#[test]
fn a_repetition_that_no_roster_triggers_is_published_by_the_deadline() {
    let (mut bench, mut ingest) = following();
    bench.frame(&mut ingest);
    bench.wait(2.0);
    assert_eq!(bench.published.len(), 2);
}

#[test]
fn who_comes_and_goes_is_a_reason_to_compute() {
    let (mut bench, mut ingest) = following();
    ingest.leave("b3");
    bench.frame(&mut ingest);
    assert_eq!(bench.last().robots.len(), 7);
    assert_eq!(bench.counter("jobs_started"), 2);
}

#[test]
fn the_newest_frame_follows_a_long_job() {
    let (mut bench, mut ingest) = following();
    bench.hold_jobs = true;
    for weight in [0.2, 0.3, 0.4, 0.5] {
        ingest.edge("spatial", "a0", "a1", weight);
        bench.frame(&mut ingest);
    }
    let frame = ingest.frame(bench.now);
    bench.deliver(&frame);
    bench.hold_jobs = false;
    bench.run_job();
    assert_eq!(bench.published.len(), 3, "the frame that was started, and the newest");
    assert_eq!(bench.last().roster, frame.roster.header.revision);
    assert_eq!(bench.counter("jobs_started"), 3);
}

/// Meanwhile the embedding of before is republished for later rosters, as its basis holds again.
#[test]
fn what_a_long_job_made_of_settings_that_were_undone_brings_no_older_roster() {
    let (mut bench, mut ingest) = following();
    let dimension = bench.last().dimension;
    bench.hold_jobs = true;
    bench.set(r#"{"dimension": 2}"#);
    bench.set(r#"{"dimension": "auto"}"#);
    for _ in 0..15 {
        bench.frame(&mut ingest);
    }
    assert_eq!(bench.published.len(), 2);
    bench.hold_jobs = false;
    bench.run_job();
    for _ in 0..30 {
        bench.frame(&mut ingest);
    }
    assert_eq!(bench.last().dimension, dimension);
    assert!(bench.published.len() > 4);
    assert!(bench.published.is_sorted_by_key(|embedding| embedding.roster));
    assert!(bench.published.iter().all(|embedding| embedding.dimension == dimension));
}

#[test]
fn settings_recompute_the_frame_and_keep_the_similarity() {
    let (mut bench, _) = following();
    bench.set(r#"{"dimension": 2}"#);
    assert_eq!((bench.published.len(), bench.last().dimension), (2, 2));
    assert_eq!(bench.last().quality.mode, EmbeddingMode::Cached);
    bench.set(r#"{"alpha": {"fraction": 0.25}}"#);
    assert_eq!(bench.last().quality.mode, EmbeddingMode::Dense);
    bench.set(r#"{"weights": {"spatial": 0.5, "thermal": 0.5}}"#);
    let weights: Vec<_> = bench.last().graphs.iter().map(|graph| graph.weight).collect();
    assert_eq!(weights, [0.0, 0.0, 1.0], "the fleet has no thermal modality");
    assert!(bench.get("service/embedder/settings", Some(r#"{"dimension": 3}"#)).is_err());
    assert_eq!(bench.published.len(), 4);
}

#[test]
fn the_number_of_teams_reaches_the_rule_for_the_dimension() {
    let mut ingest = three_bridged_cliques();
    let mut bench = Bench::fresh();
    bench.receive_teams(&teams(2));
    bench.frame(&mut ingest);
    assert_eq!(bench.last().dimension, 4);
    bench.receive_teams(&teams(3));
    assert_eq!(bench.last().dimension, 6);
    assert_eq!(bench.last().quality.mode, EmbeddingMode::Cached);
    bench.receive_teams(&teams(3));
    assert_eq!(bench.published.len(), 2);
    for bad in ["{", r#"{"teams": 3}"#, &teams(0)] {
        bench.receive_teams(bad);
    }
    assert_eq!(bench.counter("messages_refused"), 3);
    assert_eq!(bench.published.len(), 2);
    // A dimension that is set does not ask for the teams.
    bench.set(r#"{"dimension": 4}"#);
    bench.receive_teams(&teams(5));
    assert_eq!(bench.published.len(), 3);
}

/// Settings of a clusterer.
#[test]
fn a_dimension_that_is_chosen_keeps_to_the_largest_that_may_be_asked_for() {
    let mut ingest = Ingest::new(&["spatial"]);
    for pair in 0..MAX_DIMENSION / 2 + 4 {
        ingest.clique("spatial", &format!("p{pair}x"), 2, 1.0);
    }
    let mut bench =
        Bench::started(EmbedderSettings::default(), vec![announced(&teams(MAX_DIMENSION))]);
    bench.frame(&mut ingest);
    assert_eq!(bench.last().dimension, MAX_DIMENSION);
}

fn teams(teams: u32) -> String {
    let teams = TeamCount::Fixed(teams);
    let settings = muster_model::settings::ClustererSettings { teams, ..Default::default() };
    serde_json::to_string(&settings).unwrap()
}

/// Three groups with weak edges between them: two vectors see all of them, three separate them.
fn three_bridged_cliques() -> Ingest {
    let mut ingest = Ingest::new(&["spatial"]);
    for (prefix, weight) in [("a", 1.0), ("b", 0.9), ("c", 0.8)] {
        ingest.clique("spatial", prefix, 4, weight);
    }
    for (from, to) in [("a0", "b0"), ("b0", "a0"), ("b1", "c0"), ("c0", "b1")] {
        ingest.edge("spatial", from, to, 0.05);
    }
    ingest
}

#[test]
fn an_announcement_that_was_overtaken_does_not_count() {
    let (mut bench, mut ingest) = (Bench::fresh(), three_bridged_cliques());
    bench.frame(&mut ingest);
    let at = |epoch| Revision { term: 1, epoch };
    bench.receive(announced_at(at(5), &teams(3)));
    assert_eq!(bench.last().dimension, 6);
    bench.receive(announced_at(at(4), &teams(2)));
    assert_eq!((bench.last().dimension, bench.counter("messages_old")), (6, 1));
    bench.receive(announced_at(at(5), &teams(2)));
    assert_eq!(bench.last().dimension, 4, "settings change between two outputs");
}

#[test]
fn a_lost_announcement_is_asked_for_again() {
    let (mut bench, mut ingest) = (Bench::fresh(), three_bridged_cliques());
    bench.frame(&mut ingest);
    bench.wait(7.8);
    assert!(bench.settings_fetches.is_empty());
    bench.wait(0.2);
    let fetch = bench.settings_fetches.pop_front().unwrap();
    bench.answer_fetch(fetch, vec![announced(&teams(3))]);
    assert_eq!(bench.last().dimension, 6);
    bench.wait(30.0);
    assert_eq!(bench.settings_fetches.len(), 3, "whether they are answered or not");
}

#[test]
fn a_forged_announcement_lasts_until_the_clusterer_has_contradicted_twice() {
    let (mut bench, mut ingest) = (Bench::fresh(), three_bridged_cliques());
    bench.frame(&mut ingest);
    bench.receive(announced_at(Revision { term: 900, epoch: 1 }, &teams(3)));
    let mut dimensions = Vec::new();
    for _ in 0..2 {
        bench.wait(10.0);
        let fetch = bench.settings_fetches.pop_front().unwrap();
        bench.answer_fetch(fetch, vec![announced(&teams(2))]);
        dimensions.push(bench.last().dimension);
    }
    assert_eq!(dimensions, [6, 4]);
}

#[test]
fn the_clusterer_is_asked_soon_once_it_has_contradicted_an_announcement() {
    let (mut bench, mut ingest) = (Bench::fresh(), three_bridged_cliques());
    bench.frame(&mut ingest);
    bench.receive(announced_at(Revision { term: 900, epoch: 1 }, &teams(3)));
    bench.receive(announced(&teams(2)));
    for expected in [6, 4] {
        bench.wait(1.0);
        let fetch = bench.settings_fetches.pop_front().unwrap();
        bench.answer_fetch(fetch, vec![announced(&teams(2))]);
        assert_eq!(bench.last().dimension, expected);
    }
    bench.settings_fetches.clear();
    bench.wait(8.0);
    assert!(bench.settings_fetches.is_empty(), "nothing is doubtful any more");
}

#[test]
fn every_group_has_an_embedding_and_the_dimension_does_not_flap() {
    // Three groups of five, two teams: by noise of the distances, each group is the least at times.
    let mut ingest = Ingest::new(&["spatial"]);
    for prefix in ["a", "b", "c"] {
        ingest.clique("spatial", prefix, 5, 1.0);
    }
    let mut bench = Bench::fresh();
    let mut state = 1_u32;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1_u32 << 24) - 0.5
    };
    for _ in 0..60 {
        for prefix in ["a", "b", "c"] {
            for (i, j) in (0..5).flat_map(|i| (0..i).map(move |j| (i, j))) {
                let weight = 1.0 / (1.0 + 0.2 * noise());
                let (from, to) = (format!("{prefix}{i}"), format!("{prefix}{j}"));
                ingest.edge("spatial", &from, &to, weight);
                ingest.edge("spatial", &to, &from, weight);
            }
        }
        bench.frame(&mut ingest);
        assert!(bench.last().without_embedding.iter().all(|without| !without));
        assert_eq!(bench.last().dimension, 6);
    }
    ingest.join("loner");
    bench.frame(&mut ingest);
    assert_eq!(bench.last().without_embedding.iter().filter(|without| **without).count(), 1);
    // A dimension that is set is obeyed.
    bench.set(r#"{"dimension": 4}"#);
    assert_eq!(bench.last().without_embedding.iter().filter(|without| **without).count(), 6);
}

#[test]
fn where_two_dimensions_are_as_good_the_larger_is_taken_and_kept() {
    let settled = |weights: &[f64]| -> Vec<u32> {
        let mut ingest = three_bridged_cliques();
        let mut bench = Bench::started(closed_forms(), vec![announced(&teams(3))]);
        for weight in weights {
            ingest.clique("spatial", "c", 4, *weight);
            bench.frame(&mut ingest);
        }
        bench.published.iter().map(|embedding| embedding.dimension).collect()
    };
    let weights: Vec<f64> = (1..180).map(|step| f64::from(step) / 200.0).collect();
    let turn = weights.windows(2).find(|pair| settled(&pair[..1]) != settled(&pair[1..]));
    let &[below, above] = turn.unwrap() else { panic!() };
    let (low, high) = (settled(&[below])[0], settled(&[above])[0]);
    assert_ne!(low, high);
    // A difference that is seen again is followed at once, and does not vanish with the next change of a weight.
    let larger = low.max(high);
    assert_eq!(settled(&[below, above, below]), [low, larger, larger]);
    assert_eq!(settled(&[above, below, above]), [high, larger, larger]);
}

#[test]
fn a_fleet_that_has_left_leaves_an_empty_embedding() {
    let (mut bench, mut ingest) = following();
    let names: Vec<_> = bench.last().robots.iter().map(|name| name.as_str().to_owned()).collect();
    names.iter().for_each(|name| ingest.leave(name));
    let frame = bench.frame(&mut ingest);
    let empty = bench.last().clone();
    assert_eq!((empty.robots.len(), empty.dimension, empty.values.len()), (0, 2, 0));
    assert_eq!(empty.roster, frame.roster.header.revision);
    assert_eq!(bench.state(), "no robots");
    let count = bench.published.len();
    bench.wait(3.0);
    assert_eq!(bench.published.len(), count);
    // So it is for a leader that only learned of the fleet; also where it learned of an empty embedding, as an instance that was
    // cut off answers with one that no reader has received.
    for known in [bench.published[0].clone(), Checked::new_unchecked(empty)] {
        let answers = vec![Message::Embedding(known)];
        let mut next = Bench::started(EmbedderSettings::default(), answers);
        frame.messages().for_each(|message| next.receive(message));
        next.input(Input::LinkRestored);
        next.answer_fetches(&ingest);
        assert_eq!(next.published.len(), 1);
        assert!(next.last().robots.is_empty());
    }
    // Weights that fit no modality are no reason to keep who has left.
    ingest.join("a0");
    bench.frame(&mut ingest);
    bench.set(r#"{"weights": {"thermal": 1.0}}"#);
    ingest.leave("a0");
    bench.frame(&mut ingest);
    assert!(bench.last().robots.is_empty());
}

/// All answers to the inquiry of a restarted embedder were lost, and the fleet has left meanwhile. A reader
/// that still holds the last embedding would divide robots that are gone.
#[test]
fn what_readers_hold_of_the_leader_before_is_learned_later_too() {
    let (mut bench, mut ingest) = following();
    let known = bench.published[0].clone();
    let names: Vec<_> = bench.last().robots.iter().map(|name| name.as_str().to_owned()).collect();
    names.iter().for_each(|name| ingest.leave(name));
    let frame = bench.frame(&mut ingest);
    let mut next = Bench::started(EmbedderSettings::default(), Vec::new());
    // Its term is above that of the embedding.
    let again = Embedding::clone(&known);
    let header = Header { revision: Revision { term: 0, epoch: 9 }, ..again.header.clone() };
    let held = Message::Embedding(Checked::new_unchecked(Embedding { header, ..again }));
    frame.messages().for_each(|message| next.receive(message));
    next.input(Input::LinkRestored);
    next.answer_fetches(&ingest);
    next.wait(5.5);
    assert!(next.published.is_empty());
    let check = next.term_checks.pop_front().unwrap();
    next.answer_fetch(check, vec![held]);
    assert_eq!(next.published.len(), 1);
    assert!(next.last().robots.is_empty());
}

#[test]
fn a_term_that_readers_have_passed_is_followed_by_a_new_one() {
    let (mut bench, mut ingest) = following();
    let values = bench.last().values.clone();
    bench.wait(5.5);
    assert_eq!(bench.term_checks.len(), 1);
    let mut other = Embedding::clone(bench.last());
    other.header.revision = Revision { term: 6, epoch: 3 };
    let found = || vec![Message::Embedding(Checked::new_unchecked(other.clone()))];
    let check = bench.term_checks.pop_front().unwrap();
    bench.answer_fetch(check, found());
    assert_eq!(bench.published.len(), 1, "the other may be alive");
    bench.wait(1.5);
    assert_eq!(bench.term_checks.len(), 1);
    let check = bench.term_checks.pop_front().unwrap();
    bench.answer_fetch(check, found());
    assert_eq!(bench.published.len(), 2);
    assert_eq!(bench.last().header.revision, Revision { term: 7, epoch: 1 });
    assert_eq!(bench.last().values, values);
    assert_eq!(bench.last().header.stages.last().unwrap().published, bench.now);
    assert_eq!(bench.last().header.stages.len(), 1);
    bench.frame(&mut ingest);
    bench.wait(1.5);
    assert_eq!(bench.last().header.revision, Revision { term: 7, epoch: 2 });
    assert_eq!(bench.counter("jobs_started"), 2, "and one at rest");
}

#[test]
fn the_number_of_teams_is_known_from_the_start() {
    let settings = announced(&teams(3));
    let mut bench = Bench::started(EmbedderSettings::default(), vec![settings]);
    let mut ingest = Ingest::new(&["spatial"]);
    for prefix in ["a", "b", "c"] {
        ingest.clique("spatial", prefix, 3, 1.0);
    }
    bench.frame(&mut ingest);
    assert_eq!(bench.last().dimension, 6);
}

#[test]
fn a_decay_that_is_too_large_is_refused_and_the_last_embedding_stands() {
    let (mut bench, mut ingest) = following();
    let good = learned(&mut bench);
    // The radius of other graphs is not known before a frame is embedded with them.
    bench.set(r#"{"alpha": 50.0, "self_loops": 0.4}"#);
    assert_eq!(bench.failures(), 1);
    let Some(EventKind::JobFailed { reason }) = bench.events.last() else { panic!() };
    let limit = reason.strip_prefix("alpha: 50 must be less than 1/ρ = ").expect(reason);
    let limit: f64 = limit.split(' ').next().unwrap().parse().unwrap();
    // Graphs that are scaled by raised degrees have a radius below 1, and self-loops add a half.
    assert!(limit > 1.0 / 1.5 && limit < 1.0, "{reason}");
    assert_eq!(learned(&mut bench), good);
    assert!(bench.state().contains("the newest frame failed: alpha"));
    // The same input is not tried again; frames that change are, and are reported only seldom.
    bench.wait(5.0);
    assert_eq!(bench.counter("jobs_failed"), 1);
    for number in 1..=30_u32 {
        ingest.edge("spatial", "a0", "a1", f64::from(number) / 40.0);
        bench.frame(&mut ingest);
    }
    assert_eq!(bench.counter("jobs_failed"), 31);
    assert_eq!(bench.failures(), 3);
    assert_eq!(bench.published.len(), 1, "an embedding of another frame is not made to look fresh");
    bench.set(r#"{"alpha": 0.1}"#);
    assert_eq!(bench.published.len(), 2);
    assert!(!bench.state().contains("failed"));
}

#[test]
fn a_decay_that_the_present_fleet_does_not_allow_is_refused_with_the_limit() {
    let (mut bench, _ingest) = following();
    for alpha in ["5", "50.0"] {
        let problem = bench
            .get("service/embedder/settings", Some(&format!("{{\"alpha\": {alpha}}}")))
            .unwrap_err();
        let problem: serde_json::Value = serde_json::from_str(&problem).unwrap();
        assert_eq!(problem["field"], "alpha");
        let text = problem["error"].as_str().unwrap();
        let (_, limit) = text.split_once("must be less than 1/ρ = ").expect(text);
        let limit: f64 = limit.split(' ').next().unwrap().parse().unwrap();
        assert!(limit > 1.0 / 1.5 && limit < 1.0 && text.contains("fraction"), "{text}");
    }
    assert_eq!(bench.counter("settings_changed"), 0);
    assert_eq!(bench.failures(), 0);
    bench.set(r#"{"alpha": 0.5}"#);
    bench.set(r#"{"alpha": {"fraction": 0.9}}"#);
    assert_eq!((bench.failures(), bench.counter("settings_changed")), (0, 2));
}

#[test]
fn a_service_whose_jobs_fail_says_since_when_until_one_does_not() {
    let (mut bench, mut ingest) = following();
    assert_eq!(bench.host.failing_jobs(), None);
    bench.set(r#"{"alpha": 50.0, "self_loops": 0.4}"#);
    let first = bench.host.failing_jobs().cloned().unwrap();
    assert!(first.reason.starts_with("alpha: 50 must be less"), "{}", first.reason);
    bench.wait(5.0);
    ingest.edge("spatial", "a0", "a1", 0.3);
    bench.frame(&mut ingest);
    assert_eq!(bench.host.failing_jobs().map(|failing| failing.since), Some(first.since));
    bench.set(r#"{"alpha": 0.1}"#);
    assert_eq!(bench.host.failing_jobs(), None);
}

#[test]
fn weights_of_absent_modalities_alone_are_an_error() {
    let (mut bench, _) = following();
    bench.set(r#"{"weights": {"thermal": 1.0}}"#);
    let Some(EventKind::JobFailed { reason }) = bench.events.last() else { panic!() };
    assert!(reason.contains("connectivity, hierarchy, spatial"), "{reason}");
    assert_eq!(bench.published.len(), 1);
}

#[test]
fn a_panic_costs_the_cache_and_nothing_else() {
    let (mut bench, mut ingest) = following();
    bench.hold_jobs = true;
    bench.set(r#"{"dimension": 2}"#);
    bench.panic_job("index out of bounds\n");
    assert_eq!((bench.failures(), bench.job.is_some()), (1, false));
    assert!(bench.state().contains("panicked"));
    // The same frame is tried again after a while, not at once.
    bench.wait(0.9);
    assert!(bench.job.is_none());
    bench.wait(0.2);
    bench.panic_job("index out of bounds\n");
    assert_eq!(bench.failures(), 1, "it was reported just now");
    // A frame that differs is tried at once.
    bench.hold_jobs = false;
    ingest.edge("spatial", "a0", "a1", 0.5);
    bench.frame(&mut ingest);
    assert_eq!(bench.last().quality.mode, EmbeddingMode::Dense);
    assert_eq!((bench.published.len(), bench.counter("jobs_failed")), (2, 2));
    bench.wait(5.0);
    assert_eq!(bench.counter("jobs_started"), 5, "and one at rest");
}

#[test]
fn a_panic_in_a_fleet_that_is_gone_asks_for_nothing() {
    let (mut bench, mut ingest) = (Bench::fresh(), fleet());
    bench.hold_jobs = true;
    bench.frame(&mut ingest);
    bench.panic_job("out of memory");
    for name in ["a0", "a1", "a2", "a3", "b0", "b1", "b2", "b3"] {
        ingest.leave(name);
    }
    bench.frame(&mut ingest);
    // It asks for timeouts, but not without end.
    bench.wait(4.0);
    assert_eq!((bench.job.is_some(), bench.published.len()), (false, 0));
}

#[test]
fn a_restart_goes_on_from_the_embedding_that_others_remember() {
    let (mut first, mut ingest) = following();
    let Some(Message::Embedding(old)) = learned(&mut first).pop() else { panic!() };
    // Signs are arbitrary: the next leader keeps to those that it finds.
    let mut flipped = Embedding::clone(&old);
    flipped.header.revision = Revision { term: 7, epoch: 900 };
    flipped.values.iter_mut().for_each(|value| *value = -*value);
    let flipped = Checked::new_unchecked(flipped);
    let older = Message::Embedding(old);
    let answers = vec![older, Message::Embedding(flipped.clone())];
    let mut bench = Bench::started(EmbedderSettings::default(), answers);
    assert_eq!(bench.stored.term, 8);
    assert_eq!(learned(&mut bench), [Message::Embedding(flipped.clone())]);
    bench.wait(3.0);
    assert!(bench.published.is_empty(), "what was learned is served and not repeated");

    bench.fetches.clear();
    ingest.join("c0");
    ingest.edge("spatial", "c0", "a0", 0.01);
    let frame = ingest.frame(bench.now);
    bench.deliver(&frame);
    bench.input(Input::LinkRestored);
    bench.answer_fetches(&ingest);
    assert_eq!(bench.last().header.revision, Revision { term: 8, epoch: 1 });
    for (at, name) in flipped.robots.iter().enumerate() {
        let dimension = flipped.dimension as usize;
        let before = &flipped.values[at * dimension..(at + 1) * dimension];
        let cosine = dot(row(bench.last(), name.as_str()), before);
        assert!(cosine > 0.99, "{name}: {cosine}");
    }
}

#[test]
fn an_embedding_of_the_leader_before_that_cannot_be_used_does_no_harm() {
    let (mut first, mut ingest) = following();
    let Some(Message::Embedding(old)) = learned(&mut first).pop() else { panic!() };
    let mut bad = Embedding::clone(&old);
    bad.header.revision.term = 4;
    bad.values.pop();
    let answers = vec![Message::Embedding(Checked::new_unchecked(bad))];
    let mut bench = Bench::started(EmbedderSettings::default(), answers);
    assert_eq!(bench.stored.term, 5);
    let _unheard = ingest.frame(bench.now);
    bench.wait(2.0);
    bench.answer_fetches(&ingest);
    assert_eq!(bench.last().dimension, 4);
}

#[test]
fn every_get_is_answered_once() {
    let mut bench = Bench::new(EmbedderSettings::default());
    let keys = ["embedding", "roster", "graph/*", "graph/spatial", "teams", "service/*/status"];
    for key in keys.into_iter().chain(["service/embedder/settings", "no/such/key"]) {
        let empty = !key.starts_with("service");
        assert_eq!(bench.get(key, None).unwrap().is_empty(), empty, "{key}");
    }
    let (mut bench, _) = following();
    for (key, count) in keys.into_iter().zip([1, 1, 3, 1, 0, 1]) {
        assert_eq!(bench.get(key, None).unwrap().len(), count, "{key}");
    }
    assert_eq!(bench.get("*", None).unwrap().len(), 2);
}

#[test]
fn reciprocity_is_a_setting_that_holds_at_once() {
    let mut bench = Bench::started(closed_forms(), Vec::new());
    let mut ingest = Ingest::new(&["hierarchy"]);
    for robot in ["a", "b", "c"] {
        ingest.join(robot);
    }
    ingest.edge("hierarchy", "a", "b", 1.0);
    ingest.edge("hierarchy", "a", "c", 1.0);
    bench.frame(&mut ingest);
    let radius = |bench: &Bench| bench.last().quality.spectral_radius.1;
    // Of [0 1 1; r 0 0; r 0 0] that is √(2r), divided by its norm of √2.
    assert!((radius(&bench) - 0.5_f64.sqrt()).abs() < 1e-9, "{}", radius(&bench));
    bench.set(r#"{"reciprocity": {"hierarchy": 1.0}}"#);
    assert!((radius(&bench) - 1.0).abs() < 1e-9, "{}", radius(&bench));
    bench.set(r#"{"reciprocity": {}}"#);
    assert!(radius(&bench) < 1e-6, "orders that lead down have no circle: {}", radius(&bench));
    assert!(
        bench
            .get("service/embedder/settings", Some(r#"{"reciprocity": {"hierarchy": 2}}"#))
            .is_err()
    );
}

#[test]
fn the_paper_as_it_stands_is_a_matter_of_settings() {
    let settings = EmbedderSettings {
        alpha: Alpha::Value(0.05),
        dimension: Dimension::Fixed(4),
        ..EmbedderSettings::paper()
    };
    let mut bench = Bench::started(settings, Vec::new());
    bench.frame(&mut fleet());
    let embedding = bench.last();
    assert!((embedding.quality.alpha - 0.05).abs() < 1e-15);
    // Columns of length one.
    for column in 0..4 {
        let length: f64 = embedding.values.iter().skip(column).step_by(4).map(|x| x * x).sum();
        assert!((length - 1.0).abs() < 1e-12);
    }
}

/// Settings of a clusterer that chooses the number of teams.
fn chosen(teams: TeamCount) -> String {
    let settings = muster_model::settings::ClustererSettings { teams, ..Default::default() };
    serde_json::to_string(&settings).unwrap()
}

#[test]
fn the_evidence_for_a_number_of_teams_is_published() {
    let (mut bench, mut ingest) = (Bench::fresh(), three_bridged_cliques());
    ingest.join("loner");
    bench.frame(&mut ingest);
    let scores = bench.last().quality.team_scores.clone();
    let best = (1..).zip(&scores).max_by(|l, r| l.1.total_cmp(r.1)).unwrap();
    assert_eq!(
        (best.0, scores.len()),
        (3, 12),
        "the robot without an edge does not count: {scores:?}"
    );
    assert_eq!(bench.last().dimension, 6, "the rule for the dimension expects three teams");
    let within = TeamCount::Between { from: 1, to: 2 };
    bench.receive_teams(&chosen(within));
    // What a division must reach goes by the best one within the range.
    assert_eq!(bench.last().quality.team_scores[1..], scores[1..2]);
    assert_eq!(bench.last().quality.teams_shown, Some(2));
    bench.receive_teams(&teams(3));
    assert!(bench.last().quality.team_scores.is_empty());
    assert_eq!(bench.last().quality.teams_shown, None);
    // A fixed dimension needs no number of teams, and the number of teams no free dimension.
    bench.receive_teams(&chosen(TeamCount::Auto));
    bench.set(r#"{"dimension": 4}"#);
    assert_eq!((bench.last().dimension, bench.last().quality.team_scores.len()), (4, 12));
}

#[test]
fn large_fleets_have_the_triplets_that_the_evidence_needs() {
    let mut ingest = Ingest::new(&["spatial"]);
    for group in 0..7 {
        ingest.clique("spatial", &format!("g{group}x"), 12, 1.0);
    }
    let mut bench = Bench::fresh();
    bench.frame(&mut ingest);
    let last = bench.last();
    assert_eq!(last.quality.mode, EmbeddingMode::InverseFree);
    let best = (1..).zip(&last.quality.team_scores).max_by(|l, r| l.1.total_cmp(r.1)).unwrap();
    assert_eq!((best.0, last.quality.team_scores.len()), (7, 16));
    assert_eq!(last.dimension, 14);
}
