//! Gets of the Katz similarity of two robots.

use crate::common::{Bench, Ingest, closed_forms, modality};
use muster_model::katz::{PairMethod, PairSimilarity};
use muster_model::settings::EmbedderSettings;
use muster_numeric::katz::katz_similarity;
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::spectral_radius::spectral_radius;
use muster_service::{GetId, IncomingGet, Input};
use muster_wire::Message;

/// A directed ring of so many robots with a chord, on two modalities.
fn fleet(robots: usize) -> Ingest {
    let mut ingest = Ingest::new(&["links", "orders"]);
    let name = |i: usize| format!("r{:04}", i % robots);
    (0..robots).for_each(|i| ingest.join(&name(i)));
    for i in 0..robots {
        ingest.edge("links", &name(i), &name(i + 1), 1.0);
    }
    ingest.edge("orders", &name(0), &name(2), 2.0);
    ingest
}

fn settings() -> EmbedderSettings {
    EmbedderSettings {
        weights: [(modality("links"), 0.75), (modality("orders"), 0.25)].into(),
        ..closed_forms()
    }
}

impl Bench {
    /// Asks for pairs, and lets them wait.
    fn wonder(&mut self, first: u64, pairs: &[(usize, usize)]) {
        for (get, (from, to)) in (first..).zip(pairs) {
            self.input(Input::Get(IncomingGet {
                get: GetId(get),
                selector: "muster/v1/f/embedding".to_owned(),
                narrowed: None,
                parameters: format!("katz=r{from:04},r{to:04}"),
                payload: None,
            }));
        }
    }

    fn pair(&mut self, from: usize, to: usize) -> Result<PairSimilarity, String> {
        self.wonder(9000, &[(from, to)]);
        let mut reply = self.replies.pop().unwrap();
        reply.answer.map(|_| match reply.messages.pop() {
            Some(Message::Katz(pair)) => *pair,
            other => panic!("{other:?}"),
        })
    }
}

#[test]
fn similarities_and_shares_are_those_of_the_definition() {
    for (robots, method) in [(12, PairMethod::Cached), (1100, PairMethod::Column)] {
        let mut bench = Bench::started(settings(), Vec::new());
        let mut ingest = fleet(robots);
        for chord in [2.0, 3.0] {
            ingest.edge("orders", "r0000", "r0002", chord);
            bench.frame(&mut ingest);
            // Each graph is scaled by its norm: 1 for the ring, the weight for the chord.
            let ring = (0..robots).map(|i| (i, (i + 1) % robots, 0.75));
            let edges = ring.chain([(0, 2, 0.25)]);
            let fused = SparseMatrix::from_triplets(robots, edges).unwrap();
            let radius = spectral_radius(&fused, None);
            let s = katz_similarity(&fused, 0.5 / radius.upper, &radius).unwrap();
            for (from, to) in [(0, 2), (0, 1), (2, 0), (5, 5), (11, 3)] {
                let pair = bench.pair(from, to).unwrap();
                let wanted = s.row(from)[to];
                let near =
                    |found: f64, wanted: f64| (found - wanted).abs() <= 1e-12 * wanted.max(1e-3);
                assert!(near(pair.similarity, wanted), "{from} {to}: {pair:?} {wanted}");
                assert_eq!(pair.method, method);
                assert!(pair.residual < 1e-12);
                let alpha = 0.5 / radius.upper;
                assert!(near(pair.alpha, alpha));
                let [links, orders] = [&pair.shares[0], &pair.shares[1]];
                assert_eq!((links.0.as_str(), orders.0.as_str()), ("links", "orders"));
                assert!(near(links.1 + orders.1, wanted));
                let onward = |k: usize| s.row(k)[to] + f64::from(u8::from(k == to));
                let by_chord = if from == 0 { alpha * 0.25 * onward(2) } else { 0.0 };
                assert!(near(orders.1, by_chord), "{orders:?} {by_chord}");
                assert_eq!(pair.header, bench.last().header);
            }
        }
    }
}

#[test]
fn what_cannot_be_compared_is_refused_with_a_reason() {
    let mut bench = Bench::started(settings(), Vec::new());
    let error = bench.pair(0, 1).unwrap_err();
    assert!(error.contains("ask again"), "{error}");
    bench.frame(&mut fleet(12));
    let error = bench.pair(0, 99).unwrap_err();
    assert!(error.contains("katz") && error.contains("r0099"), "{error}");
    assert!(bench.pair(0, 1).is_ok());
}

#[test]
fn questions_take_turns_with_embeddings_and_each_is_answered_once() {
    let mut bench = Bench::started(settings(), Vec::new());
    let mut ingest = fleet(12);
    bench.frame(&mut ingest);
    bench.hold_jobs = true;
    ingest.edge("links", "r0003", "r0007", 0.5);
    bench.frame(&mut ingest);
    assert!(bench.job.is_some(), "the embedding");
    bench.wonder(1, &[(0, 1), (1, 2), (0, 99)]);
    ingest.edge("links", "r0003", "r0007", 0.7);
    bench.frame(&mut ingest);
    let published = bench.published.len();
    bench.run_job();
    assert_eq!((bench.job.is_some(), bench.replies.len()), (true, 0), "the questions");
    // More questions meanwhile do not hold the frame up that waits.
    bench.wonder(4, &[(1, 2)]);
    bench.run_job();
    assert_eq!(bench.replies.len(), 3);
    assert!(bench.replies.iter().map(|reply| reply.get.0).eq(1..=3));
    assert_eq!(bench.replies.iter().filter(|reply| reply.answer.is_ok()).count(), 2);
    bench.run_job();
    assert_eq!(bench.published.len(), published + 2, "the frame that waited as well");
    assert_eq!(bench.replies.len(), 3);
    bench.run_job();
    assert_eq!(bench.replies.len(), 4);
}

#[test]
fn a_comparison_that_panics_is_answered_and_does_no_harm() {
    let mut bench = Bench::started(settings(), Vec::new());
    let mut ingest = fleet(12);
    bench.frame(&mut ingest);
    bench.hold_jobs = true;
    bench.wonder(1, &[(0, 1)]);
    bench.panic_job("ouch");
    assert!(bench.replies.pop().unwrap().answer.is_err());
    assert_eq!(bench.failures(), 0);
    // Nothing needs to change in the fleet for the next question to be answered.
    bench.hold_jobs = false;
    bench.wait(1.5);
    assert!(bench.pair(0, 1).is_ok());
    ingest.edge("links", "r0003", "r0007", 0.7);
    bench.frame(&mut ingest);
    assert!(bench.pair(0, 1).is_ok());
}

#[test]
fn a_flood_of_questions_is_bounded() {
    let mut bench = Bench::started(settings(), Vec::new());
    bench.frame(&mut fleet(12));
    bench.hold_jobs = true;
    bench.wonder(1, &[(0, 1); 1000]);
    let refused = bench.replies.len();
    assert!((500..1000).contains(&refused), "{refused}");
    while bench.job.is_some() {
        bench.run_job();
    }
    assert_eq!(bench.replies.len(), 1000);
}
