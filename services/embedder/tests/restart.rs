//! What stands after a restart of everything: the number of teams that the fleet shows, and K.

use crate::common::{Bench, Ingest};
use muster_model::embedding::Embedding;
use muster_model::settings::EmbedderSettings;
use muster_service::Command;
use muster_wire::kept::KeptShape;

/// Four squads of four. The stronger the ties between the first two and between the last two, the more they are two teams.
fn fleet(tie: f64) -> Ingest {
    let mut ingest = Ingest::new(&["links"]);
    for (squad, weight) in [("a", 1.0), ("b", 0.95), ("c", 0.9), ("d", 0.85)] {
        ingest.clique("links", squad, 4, weight);
    }
    tie_squads(&mut ingest, tie);
    ingest
}

fn tie_squads(ingest: &mut Ingest, tie: f64) {
    for (left, right) in [("a", "b"), ("c", "d")] {
        for (i, j) in (0..4).flat_map(|i| (0..4).map(move |j| (i, j))) {
            ingest.edge("links", &format!("{left}{i}"), &format!("{right}{j}"), tie);
            ingest.edge("links", &format!("{right}{j}"), &format!("{left}{i}"), tie);
        }
    }
}

/// The number of teams that an embedding shows, and K.
fn shape(embedding: &Embedding) -> KeptShape {
    let teams = embedding.quality.teams_shown.unwrap();
    KeptShape { teams, rank: embedding.dimension / 2 }
}

fn of_fresh(tie: f64) -> KeptShape {
    let mut bench = Bench::fresh();
    bench.frame(&mut fleet(tie));
    shape(bench.last())
}

/// A fleet whose number is kept from frame to frame, and would be another one without the frames before; and what was kept.
fn near_tie() -> (f64, KeptShape, Vec<u8>) {
    let mut bench = Bench::fresh();
    let mut ingest = fleet(0.0);
    let mut tie = 0.0;
    while tie < 1.0 {
        tie += 0.002;
        tie_squads(&mut ingest, tie);
        bench.frame(&mut ingest);
        let shown = shape(bench.last());
        if of_fresh(tie).teams != shown.teams {
            // What has changed is written at most twice a second. After a second it would be at rest.
            bench.wait(0.6);
            return (tie, shown, bench.kept.clone().unwrap());
        }
    }
    panic!("no number is kept");
}

#[test]
fn the_number_that_was_kept_from_frame_to_frame_stands_after_a_restart_of_everything() {
    let (tie, shown, kept) = near_tie();
    assert_eq!(KeptShape::decode(&kept), Ok(shown));
    let mut bench = Bench::restarted(EmbedderSettings::default(), kept);
    bench.frame(&mut fleet(tie));
    assert_eq!(shape(bench.last()), shown);
}

/// So that it shows the same after a restart, and as robots that were cut off are back.
#[test]
fn a_fleet_at_rest_shows_the_same_however_it_came_there() {
    let (tie, shown, kept) = near_tie();
    let mut bench = Bench::restarted(EmbedderSettings::default(), kept);
    bench.frame(&mut fleet(tie));
    assert_eq!(shape(bench.last()), shown);
    let mut fresh = Bench::fresh();
    fresh.frame(&mut fleet(tie));
    for bench in [&mut bench, &mut fresh] {
        bench.wait(1.5);
    }
    assert_eq!(shape(bench.last()), shape(fresh.last()));
    assert_ne!(shape(bench.last()), shown);
}

/// It has no further job that would end the time for which it goes on from what it has found.
#[test]
fn what_a_fleet_at_rest_shows_is_kept_for_the_next_start() {
    let (tie, shown, kept) = near_tie();
    let mut bench = Bench::restarted(EmbedderSettings::default(), kept.clone());
    let mut ingest = fleet(tie);
    bench.frame(&mut ingest);
    bench.wait(1.5);
    let at_rest = shape(bench.last());
    assert_ne!(at_rest, shown);
    // What was kept before stands until the robots have gathered.
    assert_eq!(bench.kept.clone().unwrap_or(kept.clone()), kept);
    for _ in 0..3 {
        bench.frame(&mut ingest);
        bench.wait(1.0);
    }
    let kept = bench.kept.clone().unwrap();
    assert_eq!(KeptShape::decode(&kept), Ok(at_rest));
    let mut next = Bench::restarted(EmbedderSettings::default(), kept);
    next.frame(&mut fleet(tie));
    assert_eq!(shape(next.last()), at_rest);
}

#[test]
fn a_new_leader_goes_on_from_the_number_of_the_one_before() {
    let (tie, shown, _) = near_tie();
    let mut before = Bench::fresh();
    let mut ingest = fleet(0.0);
    before.frame(&mut ingest);
    assert_eq!(shape(before.last()).teams, shown.teams, "it begins with the number that is kept");
    let last = before.published.last().unwrap().clone();
    let answers = vec![muster_wire::Message::Embedding(last)];
    let mut bench = Bench::started(EmbedderSettings::default(), answers);
    bench.frame(&mut fleet(tie));
    assert_eq!(shape(bench.last()).teams, shown.teams);
}

/// Its first job is for an older roster than that of the embedding which others have, and the fleet is at rest when the
/// next one ends.
#[test]
fn a_new_leader_publishes_what_the_one_before_has_published() {
    let mut ingest = fleet(0.0);
    let mut before = Bench::fresh();
    let frames: Vec<_> = (0..20).map(|_| before.frame(&mut ingest)).collect();
    let last = before.published.last().unwrap().clone();
    assert!(last.roster > frames[0].roster.header.revision, "it was published again");
    let answers = vec![muster_wire::Message::Embedding(last)];
    let mut bench = Bench::started(EmbedderSettings::default(), answers);
    bench.hold_jobs = true;
    for frame in &frames {
        bench.wait(0.1);
        bench.deliver(frame);
    }
    bench.run_job();
    assert!(bench.published.is_empty(), "its vectors are of a fleet that may have moved");
    bench.hold_jobs = false;
    for _ in 0..20 {
        bench.frame(&mut ingest);
    }
    assert!(!bench.published.is_empty());
}

#[test]
fn what_is_kept_and_no_shape_is_put_aside() {
    for kept in [b"{}".to_vec(), Vec::new(), vec![0xB7; 40]] {
        let mut bench = Bench::restarted(EmbedderSettings::default(), kept);
        let is_reported = |command: &Command| matches!(command, Command::KeptIsUnusable(problem) if problem.contains("this service has kept"));
        assert!(bench.others.iter().any(is_reported));
        bench.frame(&mut fleet(0.1));
        assert_eq!(shape(bench.last()), of_fresh(0.1));
    }
}
