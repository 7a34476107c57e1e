//! Lost terms, lost messages, lost robots.

use super::*;

fn higher(division: &Teams, term: u64) -> Message {
    mirrored(&Arc::new(Teams { header: header(term, 3), next_team: 40, ..division.clone() }))
}

#[test]
fn a_higher_revision_that_stands_still_begins_a_new_term() {
    let (mut bench, division) = divided(teams(2), &embedding(1, &[("a b", WEST), ("c d", EAST)]));
    bench.fetches.clear();
    bench.wait(5.0);
    assert_eq!(bench.fetches, [(TERM_FETCH, vec![Pattern::One(Key::Teams)])]);
    bench.take();
    for _ in 0..2 {
        let messages = vec![higher(&division, 9)];
        bench.step(Event::Fetched { fetch: TERM_FETCH, messages });
    }
    let sent = bench.take();
    assert!(sent.division().same_division(&division));
    assert_eq!(sent.division().header.revision, Revision { term: 10, epoch: 1 });
    assert_eq!(sent.robots_told(), "a b c d");
    // One that starts after it, with nothing but what was told, gives no taken number either.
    let mut next = Bench::restored(teams(2), vec![mirrored(&sent.division())]);
    for bench in [&mut bench, &mut next] {
        bench.take();
        bench.hear(&embedding(2, &[("n1 n2", WEST), ("n3", EAST)]));
        assert_eq!(short(&bench.division()), "t40: n1 n2 | t41: n3", "taken numbers are not given");
    }
}

#[test]
fn a_job_that_runs_as_a_higher_revision_shows_gives_no_number_that_is_taken() {
    let (mut bench, division) = divided(teams(2), &embedding(1, &[("a b", WEST), ("c d", EAST)]));
    bench.hold = true;
    bench.hear(&embedding(2, &[("n1 n2", WEST), ("n3", EAST)]));
    for _ in 0..2 {
        let messages = vec![higher(&division, 9)];
        bench.step(Event::Fetched { fetch: TERM_FETCH, messages });
    }
    assert!(bench.division().same_division(&division));
    bench.run_job();
    assert!(bench.take().teams.is_empty(), "what it has found is dropped");
    bench.run_job();
    assert_eq!(short(&bench.division()), "t40: n1 n2 | t41: n3");
}

#[test]
fn robots_that_are_gone_are_stale_and_lead_nobody() {
    let (mut bench, _) = divided(teams(2), &embedding(5, &[("a b", WEST), ("c d", EAST)]));
    bench.hear_roster(roster(4, "b c d"));
    assert!(bench.take().teams.is_empty(), "that roster is older than the embedding");
    bench.hear_roster(roster(5, "b c? d"));
    let division = bench.division();
    assert_eq!(division.stale, [robot("a"), robot("c")]);
    assert_eq!(leaders(&division), ["b", "d"]);
    bench.hear_roster(roster(6, ""));
    let division = bench.division();
    assert_eq!(division.stale, ["a", "b", "c", "d"].map(robot));
    assert_eq!(leaders(&division), ["b", "d"], "where all are gone the one before stays");
}

fn line(epoch: u64, robots: u32, split: u32) -> Arc<Embedding> {
    let row = |i: u32| {
        let x = if i < split { 0.0 } else { 9.0 };
        (robot(&format!("r{i:04}")), vec![x + f64::from(i) * 1e-5, 0.0], false)
    };
    from_rows(1, epoch, (0..robots).map(row).collect())
}

#[test]
fn a_large_fleet_is_told_again_in_turn() {
    let (mut bench, _) = divided(teams(2), &line(1, 200, 100));
    bench.step(Event::LinkRestored);
    let mut told: Vec<usize> = vec![bench.take().robots.len()];
    let mut names = BTreeSet::new();
    for _ in 0..4 {
        bench.wait(1.0);
        let sent = bench.take();
        told.push(sent.robots.len());
        names.extend(sent.robots.into_iter().map(|told| told.robot));
    }
    assert_eq!(told, [64; 5]);
    assert_eq!(names.len(), 200);
}

#[test]
fn in_a_large_team_only_those_who_changed_are_told() {
    let (mut bench, _) = divided(teams(2), &line(1, 700, 350));
    bench.take();
    bench.hear(&line(2, 700, 349));
    assert_eq!(bench.take().robots_told(), "r0349");
}

#[test]
fn the_embedding_of_the_division_is_kept_beside_the_newest() {
    let first = embedding(1, &[("a b", WEST), ("c d", EAST)]);
    let (mut bench, _) = divided(teams(2), &first);
    bench.hold = true;
    bench.hear(&again(&first, 1, 2));
    bench.hear(&embedding(3, &[("a c", WEST), ("b d", EAST)]));
    let epochs = |bench: &mut Bench| {
        let answers = bench.ask("embedding", None).unwrap();
        answers.iter().map(|m| m.header().unwrap().revision.epoch).collect::<Vec<_>>()
    };
    assert_eq!(epochs(&mut bench), [3, 1]);
    bench.run_job();
    assert_eq!(epochs(&mut bench), [3]);
}

#[test]
fn the_last_audit_is_repeated_for_the_auditor() {
    use muster_model::audit::{Audit, SilhouetteReport, Space, Verdict};
    let mut bench = Bench::begun(teams(2));
    for epoch in [2, 1] {
        bench.step(Event::Received(Message::Audit(Arc::new(Audit {
            header: header(7, epoch),
            teams: Revision::default(),
            embedding: Revision::default(),
            in_embedding: SilhouetteReport::undefined(Space::Embedding),
            in_physical: SilhouetteReport::undefined(Space::Physical),
            verdict: Verdict::Undefined,
        }))));
    }
    for selector in ["audit", "json/audit"] {
        let answer = bench.ask(selector, None).unwrap();
        assert_eq!(answer[0].header().unwrap().revision, Revision { term: 7, epoch: 2 });
    }
}

#[test]
fn a_division_that_is_finished_in_doubt_is_told_whole_once_the_role_is_confirmed() {
    let (mut bench, _) = divided(teams(3), &line(1, 200, 200));
    bench.hold = true;
    bench.hear(&line(2, 200, 150));
    bench.step(Event::LinkLost);
    bench.take();
    bench.run_job();
    bench.wait(2.0);
    assert!(bench.take().teams.is_empty(), "nobody hears it");
    bench.step(Event::LinkRestored);
    let sent = bench.take();
    let told = told(&sent.changes());
    assert!(!told.is_empty() && told == self::told(&sent.division().changes), "{told:?}");
    assert_eq!(sent.robots.len(), 200, "all have other companions now");
    bench.wait(1.0);
    let sent = bench.take();
    assert!(sent.changes().is_empty() && sent.division().changes.is_empty(), "told once");
}
