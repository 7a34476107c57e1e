//! Seeds of the whole-fleet simulation, and proof that it finds what is broken.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::time::Duration;

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_ingest::Ingest;
use muster_machine::Core;
use muster_model::limits::MAX_ROBOT_PAYLOAD;

use muster_tests::simulation::{Batch, Options, Sabotage, Summary, run_batch, shrink, simulate};
use muster_wire::{Key, Pattern};

/// How many seeds the test command runs; `simulate --seeds` runs any number.
const SEEDS: u64 = 300;

fn batch(first: u64, seeds: u64) -> Batch {
    Batch {
        first,
        seeds,
        jobs: std::thread::available_parallelism().map_or(1, usize::from),
        options: Options::default(),
        sabotage: None,
        shrink_within: Duration::from_secs(30),
    }
}

fn run(batch: &Batch) -> Summary {
    run_batch(batch, |_, _| {}, |_| {})
}

#[test]
fn every_promise_holds_for_three_hundred_seeds() {
    let summary = run(&batch(0, SEEDS));
    println!("{}", summary.text());
    let failed = summary.failed.values().next().cloned().unwrap_or_default();
    assert!(summary.failed.is_empty(), "{}\n{failed}", summary.text());
    assert_eq!(summary.runs, SEEDS);
    // A storm without faults would prove nothing.
    for kind in [
        "storm",
        "clean cut",
        "silent cut",
        "router restart",
        "kill",
        "hang",
        "slow service",
        "slow jobs",
        "job panics",
        "clock set",
        "robot leaves",
        "rank change",
        "rubbish",
        "ghosts",
        "burst",
        "settings",
        "bad alpha",
    ] {
        let many = summary.total.faults.get(kind).copied().unwrap_or(0);
        assert!(many > 0, "no fault of the kind {kind:?} has happened");
    }
    let total = &summary.total;
    assert!(total.lost > 0 && total.repeated > 0 && total.mixed > 0 && total.panics > 0);
    assert!(total.events > SEEDS * 2000, "{}", total.events);
}

/// A holder that has forgotten its terms asks its readers, and each must answer for what it goes by:
/// one that does not would drop all that the holder says until the epochs have passed what it knows.
#[test]
fn every_reader_repeats_what_it_reads() {
    let wirings = [Ingest::wiring(), Embedder::wiring(), Clusterer::wiring(), Auditor::wiring()];
    for wiring in wirings {
        for subscription in wiring.subscriptions {
            let pattern = subscription.pattern;
            // Robots have no terms, and settings are believed when they contradict twice.
            let exempt = pattern.payload_limit() == MAX_ROBOT_PAYLOAD
                || matches!(pattern, Pattern::One(Key::Settings(_)));
            let served = wiring.served.iter().any(|(served, _)| *served == pattern);
            assert!(exempt || served, "{pattern:?} is read and not repeated");
        }
    }
}

#[test]
fn the_same_seed_tells_the_same_story() {
    for seed in [1, 2, 3, 8] {
        let first = simulate(seed, &Options::default(), None, true);
        let again = simulate(seed, &Options::default(), None, true);
        assert!(first.log.len() > 1000);
        for (line, other) in first.log.iter().zip(&again.log) {
            assert_eq!(line, other, "seed {seed}");
        }
        assert_eq!(first, again, "seed {seed}");
    }
    let one = simulate(1, &Options::default(), None, true);
    let other = simulate(2, &Options::default(), None, true);
    assert_ne!(one.log, other.log);
}

#[test]
fn what_is_broken_on_purpose_is_found_and_made_short() {
    let settle = "after the last fault all agree within the stated time";
    for (sabotage, promises) in [
        (Sabotage::RobotTwice, vec!["what a service publishes, others understand"]),
        (Sabotage::RobotForgotten, vec!["a robot is in exactly one team, or in none"]),
        (Sabotage::WrongSilhouette, vec!["silhouettes are those of the definition"]),
        (Sabotage::NotANumber, vec!["every number that is published is finite"]),
        (Sabotage::OldTermAsNewest, vec!["every division names an embedding that was published"]),
        (Sabotage::DeafAuditor, vec![settle]),
        (Sabotage::Restless, vec![settle, "unchanged input leaves the teams unchanged"]),
    ] {
        let options = Options { robots: Some(6), ..Options::default() };
        let stories = (0..40).map(|seed| simulate(seed, &options, Some(sabotage), false));
        let found = stories
            .filter_map(|story| Some((story.seed, story.failure?)))
            .find(|(_, failure)| promises.contains(&failure.promise) && failure.happened.len() > 3);
        let (seed, failure) = found.unwrap_or_else(|| panic!("{sabotage:?} is not found"));
        let within = Duration::from_secs(30);
        let shrunk = shrink(seed, &options, Some(sabotage), &failure, within);
        let left = shrunk.story.failure.as_ref().unwrap();
        assert_eq!(left.promise, failure.promise, "{sabotage:?}");
        assert_eq!(
            shrunk.faults.len(),
            1,
            "{sabotage:?} of seed {seed}: {:#?}",
            shrunk.story.faults
        );
        let fault = &shrunk.story.faults[0];
        assert!(
            sabotage.after().iter().any(|kind| fault.contains(&format!(": {kind}: "))),
            "{fault}"
        );
        assert!(shrunk.story.log.last().unwrap().contains("BROKEN"), "{sabotage:?}");
        // Without the sabotage the same story breaks no promise.
        assert_eq!(simulate(seed, &shrunk.options, None, false).failure, None, "{sabotage:?}");
    }
}
