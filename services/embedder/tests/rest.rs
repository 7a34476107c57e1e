//! A fleet that moves, and one that has come to rest.

use crate::common::{Bench, Ingest, closed_forms};
use muster_model::settings::{Alpha, EmbedderSettings, Normalization};

/// Squads of five on a line, with a link to the next squad each, so many in all.
fn fleet(robots: usize) -> Ingest {
    let mut ingest = Ingest::new(&["links"]);
    let name = |i: usize| format!("r{i:04}");
    (0..robots).for_each(|i| ingest.join(&name(i)));
    for i in 0..robots {
        for j in (i / 5 * 5)..(i / 5 * 5 + 5).min(robots) {
            if i != j {
                ingest.edge("links", &name(i), &name(j), 1.0 / (1.0 + (i % 7 + j % 7) as f64));
            }
        }
        if i + 5 < robots {
            ingest.edge("links", &name(i), &name(i + 5), 0.1);
        }
    }
    ingest
}

#[test]
fn a_fleet_at_rest_gets_more_digits_once() {
    let mut bench = Bench::fresh();
    let mut ingest = fleet(90);
    bench.frame(&mut ingest);
    let moving = bench.last().quality.residual;
    assert!(moving > 1e-10, "{moving}");
    for _ in 0..30 {
        bench.frame(&mut ingest);
    }
    assert!(bench.last().quality.residual <= 1e-10);
    assert_eq!(bench.counter("jobs_started"), 2);
    ingest.edge("links", "r0003", "r0004", 0.3);
    bench.frame(&mut ingest);
    assert_eq!(bench.counter("jobs_started"), 3);
    assert!(bench.last().quality.residual > 1e-10);
}

#[test]
fn a_thorough_embedding_takes_the_header_of_what_was_published_while_it_was_made() {
    let mut bench = Bench::fresh();
    let mut ingest = fleet(90);
    bench.frame(&mut ingest);
    bench.hold_jobs = true;
    bench.wait(1.2);
    assert!(bench.job.is_some(), "the thorough one");
    // Rosters go on while it is made, and the last embedding is published again with their headers.
    for _ in 0..15 {
        bench.frame(&mut ingest);
    }
    let again = bench.last().roster;
    bench.run_job();
    assert!(bench.last().quality.residual <= 1e-10);
    assert!(bench.last().roster >= again);
    // Nor does one that comes too late for its graphs lead readers back to an older roster.
    ingest.edge("links", "r0000", "r0001", 0.51);
    bench.frame(&mut ingest);
    bench.run_job();
    bench.wait(1.2);
    assert!(bench.job.is_some(), "the thorough one");
    for _ in 0..12 {
        bench.frame(&mut ingest);
    }
    let again = bench.last().roster;
    ingest.edge("links", "r0000", "r0001", 0.52);
    bench.frame(&mut ingest);
    bench.run_job();
    assert!(bench.last().roster >= again);
}

#[test]
fn the_same_digits_are_not_published_again() {
    let mut bench = Bench::fresh();
    let mut ingest = fleet(10);
    bench.frame(&mut ingest);
    bench.wait(0.95);
    assert_eq!((bench.counter("jobs_started"), bench.published.len()), (1, 1));
    bench.wait(0.2);
    assert_eq!((bench.counter("jobs_started"), bench.published.len()), (2, 1));
    assert_eq!(bench.counter("embeddings_confirmed"), 1);
}

#[test]
fn scales_and_decay_hold_while_the_graphs_drift_and_settle_at_rest() {
    for settings in [closed_forms(), EmbedderSettings::default()] {
        let Alpha::Fraction { fraction } = settings.alpha else { panic!() };
        let is_bounded = settings.normalize == Normalization::Degree;
        let mut bench = Bench::started(settings, Vec::new());
        let mut ingest = fleet(90);
        bench.frame(&mut ingest);
        let first = bench.last().quality.clone();
        let product = |quality: &muster_model::embedding::EmbeddingQuality| {
            quality.alpha * 0.5 * (quality.spectral_radius.0 + quality.spectral_radius.1)
        };
        assert!((product(&first) - fraction).abs() < 1e-9);
        for step in 1..=4 {
            ingest.edge("links", "r0000", "r0001", 0.5 + 0.02 * f64::from(step));
            bench.frame(&mut ingest);
            let quality = &bench.last().quality;
            assert_eq!(quality.alpha.to_bits(), first.alpha.to_bits());
            assert!((product(quality) - fraction).abs() < 0.1 * fraction);
        }
        assert!((product(&bench.last().quality) - fraction).abs() > 1e-6, "it has drifted");
        bench.wait(1.5);
        assert!((product(&bench.last().quality) - fraction).abs() < 1e-9);
        ingest.edge("links", "r0000", "r0001", 60.0);
        bench.frame(&mut ingest);
        let off = (product(&bench.last().quality) - fraction).abs();
        // Degrees bound the radius, whatever one edge weighs.
        assert!(if is_bounded { off < 0.1 * fraction } else { off < 1e-9 }, "{off}");
    }
}

#[test]
fn centralities_weigh_all_walks() {
    let mut bench = Bench::started(closed_forms(), Vec::new());
    let mut ingest = Ingest::new(&["links"]);
    ["a", "b", "c", "d"].iter().for_each(|name| ingest.join(name));
    ingest.edge("links", "a", "b", 1.0);
    ingest.edge("links", "b", "a", 1.0);
    ingest.edge("links", "c", "a", 0.5);
    bench.frame(&mut ingest);
    // The norm of this graph is √1.25, and its radius 1: αA = A/2, so that a = 1 + b/2 = b = 2,
    // c = 1 + a/4, d = 1.
    for (found, wanted) in bench.last().centrality.iter().zip([2.0, 2.0, 1.5, 1.0]) {
        assert!((found - wanted).abs() < 1e-8, "{:?}", bench.last().centrality);
    }
}
