//! Lost terms, lost messages, lost robots.

use super::*;

fn higher(division: &Teams, term: u64) -> Message {
    mirrored(&Checked::new_unchecked(Teams {
        header: header(term, 3),
        next_team: 40,
        ..division.clone()
    }))
}

/// Both next questions for the own output are answered so. What was published before the last of
/// them is forgotten.
fn readers_have_seen(bench: &mut Bench, seen: Message) {
    bench.answer_term_check(vec![seen.clone()]);
    while bench.asks.is_empty() {
        bench.wait(0.1);
    }
    bench.take();
    bench.answer_term_check(vec![seen]);
}

#[test]
fn a_higher_revision_that_stands_still_begins_a_new_term() {
    let (mut bench, division) = divided(teams(2), &embedding(1, &[("a b", WEST), ("c d", EAST)]));
    bench.asks.clear();
    bench.wait(5.0);
    assert_eq!(bench.asked(), [Pattern::One(Key::Teams)]);
    readers_have_seen(&mut bench, higher(&division, 9));
    let sent = bench.take();
    assert!(sent.division().same_division(&division));
    assert_eq!(sent.division().header.revision, Revision { term: 10, epoch: 1 });
    assert_eq!(sent.informed_robots(), "a b c d");
    // One that starts after it, with nothing but what was published, leaves some numbers out besides.
    let mut next = Bench::restored(teams(2), vec![mirrored(&sent.division())]);
    for (bench, wanted) in
        [(&mut bench, "t40: n1 n2 | t41: n3"), (&mut next, "t90: n1 n2 | t91: n3")]
    {
        bench.take();
        bench.receive_embedding(&embedding(2, &[("n1 n2", WEST), ("n3", EAST)]));
        assert_eq!(short(&bench.division()), wanted, "taken numbers are not given");
    }
}

#[test]
fn a_job_that_runs_as_a_higher_revision_shows_gives_no_number_that_is_taken() {
    let (mut bench, division) = divided(teams(2), &embedding(1, &[("a b", WEST), ("c d", EAST)]));
    bench.hold_jobs = true;
    bench.receive_embedding(&embedding(2, &[("n1 n2", WEST), ("n3", EAST)]));
    readers_have_seen(&mut bench, higher(&division, 9));
    assert!(bench.division().same_division(&division));
    bench.run_job();
    assert!(bench.take().teams.is_empty(), "what it has found is dropped");
    bench.run_job();
    assert_eq!(short(&bench.division()), "t40: n1 n2 | t41: n3");
}

#[test]
fn robots_that_are_gone_are_stale_and_lead_no_team() {
    let (mut bench, _) = divided(teams(2), &embedding(5, &[("a b", WEST), ("c d", EAST)]));
    bench.receive_roster(roster(4, "b c d"));
    assert!(bench.take().teams.is_empty(), "that roster is older than the embedding");
    bench.receive_roster(roster(5, "b c? d"));
    let division = bench.division();
    assert_eq!(division.stale, [robot("a"), robot("c")]);
    assert_eq!(leaders(&division), ["b", "d"]);
    bench.receive_roster(roster(6, ""));
    let division = bench.division();
    assert_eq!(division.stale, ["a", "b", "c", "d"].map(robot));
    assert_eq!(leaders(&division), ["b", "d"], "where all are gone the one before stays");
}

fn line(epoch: u64, robots: u32, split: u32) -> Checked<Embedding> {
    let row = |i: u32| {
        let x = if i < split { 0.0 } else { 9.0 };
        (robot(&format!("r{i:04}")), vec![x + f64::from(i) * 1e-5, 0.0], false)
    };
    from_rows(1, epoch, (0..robots).map(row).collect())
}

#[test]
fn a_large_fleet_is_informed_again_in_rotation() {
    let (mut bench, _) = divided(teams(2), &line(1, 200, 100));
    bench.input(Input::LinkRestored);
    let mut counts: Vec<usize> = vec![bench.take().robots.len()];
    let mut names = BTreeSet::new();
    for _ in 0..4 {
        bench.wait(1.0);
        let sent = bench.take();
        counts.push(sent.robots.len());
        names.extend(sent.robots.into_iter().map(|team| team.robot));
    }
    assert_eq!(counts, [64; 5]);
    assert_eq!(names.len(), 200);
}

#[test]
fn in_a_large_team_only_those_who_changed_are_informed() {
    let (mut bench, _) = divided(teams(2), &line(1, 700, 350));
    bench.take();
    bench.receive_embedding(&line(2, 700, 349));
    assert_eq!(bench.take().informed_robots(), "r0349");
}

#[test]
fn the_embedding_of_the_division_is_kept_with_the_newest() {
    let first = embedding(1, &[("a b", WEST), ("c d", EAST)]);
    let (mut bench, _) = divided(teams(2), &first);
    bench.hold_jobs = true;
    bench.receive_embedding(&again(&first, 1, 2));
    bench.receive_embedding(&embedding(3, &[("a c", WEST), ("b d", EAST)]));
    let epochs = |bench: &mut Bench| {
        let answers = bench.get("embedding", None).unwrap();
        answers.iter().map(|m| m.header().unwrap().revision.epoch).collect::<Vec<_>>()
    };
    assert_eq!(epochs(&mut bench), [3, 1]);
    bench.run_job();
    assert_eq!(epochs(&mut bench), [3]);
}

#[test]
fn the_last_audit_is_answered_for_the_auditor() {
    use muster_model::audit::{Audit, Flapping, Quality, SilhouetteReport, Space};
    let mut bench = Bench::leading(teams(2));
    for epoch in [2, 1] {
        bench.receive(Message::Audit(Arc::new(Audit {
            header: header(7, epoch),
            teams: Revision::default(),
            embedding: Revision::default(),
            in_embedding: SilhouetteReport::undefined(Space::Embedding),
            in_physical: SilhouetteReport::undefined(Space::Physical),
            quality: Quality::Undefined,
            flapping: Flapping::default(),
            graphs: None,
            per_team: vec![],
            losses: vec![],
        })));
    }
    for selector in ["audit", "json/audit"] {
        let answer = bench.get(selector, None).unwrap();
        assert_eq!(answer[0].header().unwrap().revision, Revision { term: 7, epoch: 2 });
    }
}

#[test]
fn the_last_list_of_alerts_is_answered_for_the_auditor_and_acknowledges_nothing() {
    use muster_model::alert::Alerts;
    let mut bench = Bench::leading(teams(2));
    for epoch in [2, 1] {
        let alerts = Alerts { header: header(7, epoch), next_id: epoch, folded: 0, open: vec![] };
        bench.receive(Message::Alerts(Arc::new(alerts)));
    }
    for selector in ["alerts", "json/alerts"] {
        let answer = bench.get(selector, None).unwrap();
        assert_eq!(answer[0].header().unwrap().revision, Revision { term: 7, epoch: 2 });
    }
    assert!(bench.get("alerts", Some(r#"{"operator": "kim", "alert": 1}"#)).unwrap().is_empty());
}

#[test]
fn a_division_that_a_suspect_finished_is_published_whole_once_it_leads_again() {
    let (mut bench, _) = divided(teams(3), &line(1, 200, 200));
    bench.hold_jobs = true;
    bench.receive_embedding(&line(2, 200, 150));
    bench.input(Input::LinkLost);
    bench.take();
    bench.run_job();
    bench.wait(2.0);
    assert!(bench.take().teams.is_empty(), "its output is suppressed");
    bench.input(Input::LinkRestored);
    let sent = bench.take();
    let changes = changes_in_short(&sent.changes());
    assert!(!changes.is_empty(), "{sent:?}");
    assert_eq!(changes, changes_in_short(&sent.division().changes));
    assert_eq!(sent.robots.len(), 200, "all have other companions now");
    bench.wait(1.0);
    let sent = bench.take();
    assert!(sent.changes().is_empty() && sent.division().changes.is_empty(), "reported once");
}

/// What it has made since may never be published.
#[test]
fn a_suspect_answers_with_the_division_that_others_have_received() {
    let answered = |bench: &mut Bench| match &bench.get("teams", None).unwrap()[..] {
        [Message::Teams { teams, .. }] => teams.header.revision,
        other => panic!("{other:?}"),
    };
    let (mut bench, published) = divided(teams(3), &line(1, 200, 200));
    bench.hold_jobs = true;
    bench.receive_embedding(&line(2, 200, 150));
    bench.input(Input::LinkLost);
    bench.run_job();
    assert_eq!(answered(&mut bench), published.header.revision);
    bench.wait(2.0);
    bench.take();
    bench.input(Input::LinkRestored);
    let since = bench.take().division().header.revision;
    assert!(since > published.header.revision);
    assert_eq!(answered(&mut bench), since);
}

/// What is remembered of robots and teams that are gone is forgotten after a minute, however many there were.
#[test]
fn ten_thousand_robots_come_and_go_with_flat_memory() {
    let mut bench = Bench::leading(teams(2));
    let mut held = Vec::new();
    for round in 0..20_u64 {
        let name = |number: u64| format!("r{:05}", round * 500 + number);
        let names = |from: u64| (from..from + 250).map(name).collect::<Vec<_>>().join(" ");
        bench.receive_roster(roster(2 * round + 1, &format!("{} {}", names(0), names(250))));
        let all = embedding(2 * round + 1, &[(&names(0), WEST), (&names(250), EAST)]);
        bench.receive_embedding(&all);
        bench.wait(2.0);
        bench.receive_roster(roster(2 * round + 2, ""));
        bench.receive_embedding(&embedding(2 * round + 2, &[]));
        bench.wait(90.0);
        bench.take();
        held.push(bench.host.memory_use());
    }
    // The first round has nothing before it.
    let least = held[1].robots.min(held[2].robots);
    assert!(held[1..].iter().all(|now| now.robots <= least + 500), "{held:?}");
    assert!(held.last().unwrap().robots <= 1500, "{held:?}");
    assert_eq!(held[5], held[19], "{held:?}");
}
