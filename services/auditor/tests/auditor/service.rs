//! The service around it: starts, gets, failures, lost links.

use super::*;

#[test]
fn the_wiring_is_that_of_the_role() {
    let served = Auditor::wiring().served;
    assert!(served.contains(&(Pattern::One(Key::Audit), true)));
    for witnessed in [
        Pattern::One(Key::Teams),
        Pattern::One(Key::JsonTeams),
        Pattern::RobotTeams,
        Pattern::One(Key::Embedding),
        Pattern::One(Key::Roster),
    ] {
        assert!(served.contains(&(witnessed.clone(), false)), "{witnessed:?}");
    }
}

#[test]
fn nothing_is_said_before_the_term_has_begun() {
    let mut bench = Bench::new();
    bench.step(Event::Started);
    assert_eq!((bench.fetches.len(), bench.fetches[0].0), (1, START_FETCH));
    assert_eq!(bench.fetches[0].1.len(), 6);
    bench.hear(embedding(1, FOUR));
    bench.hear(teams(1, 1, PAIRS, ""));
    bench.wait(100.0);
    assert!(bench.audits.is_empty() && bench.events.is_empty() && bench.jobs_run == 0);
    bench.step(Event::Fetched { fetch: START_FETCH, messages: vec![] });
    assert_eq!(bench.events, [EventKind::ServiceStarted { term: 1 }]);
    assert_eq!(bench.audit().header.revision, revision(1));
}

#[test]
fn a_division_waits_for_its_embedding() {
    let mut bench = Bench::begun(vec![]);
    bench.hear(teams(1, 1, PAIRS, ""));
    assert_eq!(bench.jobs_run, 0);
    assert_eq!(bench.status().state, "waiting for the embedding of a division");
    bench.wait(0.1);
    bench.hear(embedding(1, FOUR));
    assert_eq!(bench.audit().teams, revision(1));
    assert!(bench.fetches.is_empty());

    // One that does not come is asked for, again and again, and not for ever anew.
    bench.hear(embedding(3, FOUR));
    bench.hear(teams(2, 2, CROSSED, ""));
    bench.wait(0.1);
    bench.hear(teams(3, 2, CROSSED, ""));
    bench.wait(0.15);
    assert_eq!(bench.fetches.len(), 1);
    assert_eq!(bench.fetches[0].1.len(), 2);
    bench.step(Event::Fetched { fetch: bench.fetches[0].0, messages: vec![] });
    bench.audits.clear();
    bench.wait(0.5);
    assert_eq!(bench.fetches.len(), 1);
    bench.wait(0.5);
    assert_eq!(bench.fetches.len(), 2);
    // Whoever still has it answers, though a newer one is there.
    bench.audits.clear();
    let messages = vec![teams(3, 2, CROSSED, ""), embedding(2, FOUR)];
    bench.step(Event::Fetched { fetch: bench.fetches[0].0, messages });
    let audit = bench.audit();
    assert_eq!((audit.teams, audit.embedding), (revision(3), revision(2)));
    assert_eq!(bench.counter("messages_old"), 0);
}

#[test]
fn an_embedding_is_kept_until_its_division_comes() {
    let mut bench = Bench::begun(vec![]);
    let moved = |epoch: u64| [("a", [epoch as f64, 0.0]), ("b", [0.0, 1.0])];
    for epoch in 1..=40 {
        bench.hear(embedding(epoch, &moved(epoch)));
    }
    bench.hear(teams(1, 9, &[("t1", "a"), ("t2", "b")], ""));
    assert_eq!(bench.audit().embedding, revision(9));
    bench.hear(teams(2, 1, &[("t1", "a"), ("t2", "b")], ""));
    assert!(bench.audits.is_empty(), "that one is forgotten");
    bench.hear(teams(3, 40, &[("t1", "a"), ("t2", "b")], ""));
    assert_eq!(bench.audit().embedding, revision(40));
}

#[test]
fn a_restart_judges_what_others_remember() {
    let (_, last) = judged();
    let last = Arc::new(Audit {
        header: Header { revision: Revision { term: 7, epoch: 3 }, ..last.header.clone() },
        ..Audit::clone(&last)
    });
    let mut bench = Bench::begun(vec![Message::Audit(Arc::clone(&last))]);
    assert_eq!(bench.ask("audit", None).unwrap(), [Message::Audit(last.clone())]);
    assert_eq!(bench.driver.deadline(), Some(START.after(muster_machine::CLAIM_EVERY)));
    bench.hear(embedding(1, FOUR));
    bench.hear(teams(1, 1, PAIRS, ""));
    assert_eq!(bench.audit().header.revision, Revision { term: 8, epoch: 1 });

    // Answers come in any order.
    let messages = vec![
        teams(2, 1, PAIRS, ""),
        Message::Audit(last),
        embedding(1, FOUR),
        teams(1, 0, CROSSED, ""),
    ];
    let mut bench = Bench::begun(messages);
    assert_eq!(bench.audit().teams, revision(2));
    assert_eq!(bench.counter("messages_old"), 0);
}

#[test]
fn old_terms_and_epochs_are_dropped() {
    let (mut bench, _) = judged();
    bench.hear(embedding(5, FOUR));
    bench.hear(teams(5, 5, CROSSED, ""));
    bench.audit();
    bench.hear(teams(4, 5, PAIRS, ""));
    bench.hear(teams(5, 5, PAIRS, ""));
    bench.hear(embedding(4, FOUR));
    assert_eq!(bench.counter("messages_old"), 2);
    let Message::Teams { teams: mut old, mirror } = teams(900, 5, PAIRS, "") else { panic!() };
    Arc::make_mut(&mut old).header.revision.term = 0;
    bench.hear(Message::Teams { teams: old, mirror });
    assert_eq!(bench.counter("messages_old"), 3);
    assert!(bench.audits.is_empty());
}

#[test]
fn a_failed_job_changes_nothing() {
    let (mut bench, first) = judged();
    bench.hold = true;
    bench.hear(teams(2, 1, CROSSED, ""));
    bench.jobs.clear();
    bench.step(Event::JobFailed("out of luck".to_owned()));
    assert_eq!(
        bench.events,
        [EventKind::JobFailed { reason: "the job panicked: out of luck".to_owned() }]
    );
    assert_eq!(bench.counter("jobs_failed"), 1);
    bench.hear(teams(3, 1, CROSSED, ""));
    assert!(bench.jobs.is_empty(), "it would fail again");
    bench.wait(1.0);
    assert_eq!(bench.jobs.len(), 1, "a panic is tried again");
    bench.jobs.clear();
    bench.step(Event::JobFailed("still".to_owned()));
    assert_eq!(bench.events.len(), 1, "not told again so soon");
    let again = bench.audit();
    assert_eq!((again.teams, &again.in_embedding), (revision(1), &first.in_embedding));
    bench.hear(embedding(2, &[("a", [1e200, 0.0]), ("b", [0.0, 0.0])]));
    bench.hear(teams(4, 2, &[("t1", "a"), ("t2", "b")], ""));
    bench.run_job();
    assert!(
        matches!(&bench.events[1], EventKind::JobFailed { reason } if reason.contains("large"))
    );
}

#[test]
fn the_newest_division_follows_a_running_job() {
    let mut bench = Bench::begun(vec![]);
    bench.hold = true;
    bench.hear(embedding(1, FOUR));
    bench.hear(teams(1, 1, PAIRS, ""));
    bench.hear(teams(2, 1, CROSSED, ""));
    bench.hear(teams(3, 1, &[("t1", "a"), ("t2", "b c d")], ""));
    bench.hear(embedding(2, FOUR));
    bench.run_job();
    assert_eq!(bench.audit().teams, revision(1));
    bench.run_job();
    assert_eq!(bench.audit().teams, revision(3));
    assert!(bench.jobs.is_empty());
}

#[test]
fn every_get_has_exactly_one_answer() {
    let mut bench = Bench::new();
    let all = [
        "audit",
        "json/audit",
        "teams",
        "embedding",
        "roster",
        "robot/*/team",
        "robot/a/team",
        "x",
    ];
    for selector in all {
        assert!(bench.ask(selector, None).unwrap().is_empty(), "{selector}");
    }
    assert_eq!(bench.status().state, "waiting for a division");
    bench.step(Event::Started);
    bench.step(Event::Fetched { fetch: START_FETCH, messages: vec![] });
    bench.hear(roster(1, &[("a", "map", None)]));
    bench.hear(embedding(1, FOUR));
    bench.hear(teams(1, 1, &[("t1", "a b"), ("t2", "c")], "d"));
    let answers = [
        ("audit", 1),
        ("json/*", 2),
        ("json/audit", 1),
        ("*", 4),
        ("robot/*/team", 4),
        ("robot/d/team", 1),
        ("robot/x/team", 0),
    ];
    for (selector, count) in answers {
        assert_eq!(bench.ask(selector, None).unwrap().len(), count, "{selector}");
    }
    assert!(matches!(bench.ask("teams", None).unwrap()[..], [Message::Teams { .. }]));
    assert!(matches!(bench.ask("embedding", None).unwrap()[..], [Message::Embedding(_)]));
    assert!(matches!(bench.ask("roster", None).unwrap()[..], [Message::Roster(_)]));
    assert_eq!(bench.ask("service/auditor/settings", None).unwrap().len(), 1);
    assert_eq!(bench.ask("**", None).unwrap().len(), 1);
}

#[test]
fn refused_packets_are_told_of() {
    let mut bench = Bench::begun(vec![]);
    bench.events.clear();
    let rejection =
        Rejection { robot: None, key: "muster/v1/f/teams".into(), reason: "broken".into() };
    bench.step(Event::Rejected(rejection));
    // Contradictions do not pass the decoder; if one did, it would not pass here.
    bench.hear(teams(1, 1, &[("t1", "a"), ("t1", "b")], ""));
    assert!(matches!(bench.events[0], EventKind::Quarantined { count: 1, .. }));
    assert_eq!((bench.counter("messages_refused"), bench.jobs_run), (2, 0));
}

#[test]
fn after_a_lost_link_the_missed_is_fetched() {
    let (mut bench, _) = judged();
    bench.step(Event::LinkLost);
    bench.step(Event::LinkRestored);
    assert_eq!((bench.fetches.len(), bench.fetches[0].1.len()), (2, 3));
    assert_eq!(bench.fetches[1].0, TERM_FETCH);
    bench.audit();
    let messages = vec![teams(2, 2, CROSSED, ""), embedding(2, FOUR)];
    bench.step(Event::Fetched { fetch: bench.fetches[0].0, messages });
    assert_eq!(bench.audit().teams, revision(2));
}

#[test]
fn a_higher_revision_that_stands_still_begins_a_new_term() {
    let (mut bench, audit) = judged();
    bench.wait(5.0);
    assert!(bench.fetches.contains(&(TERM_FETCH, vec![Pattern::One(Key::Audit)])));
    bench.audits.clear();
    let mut other = Audit::clone(&audit);
    other.header.revision = Revision { term: 9, epoch: 4 };
    for _ in 0..2 {
        let messages = vec![Message::Audit(Arc::new(other.clone()))];
        bench.step(Event::Fetched { fetch: TERM_FETCH, messages });
    }
    assert_eq!(bench.audit().header.revision, Revision { term: 10, epoch: 1 });
}

#[test]
fn an_old_embedding_is_taken_with_the_division_that_names_it() {
    let (mut bench, _) = judged();
    for epoch in 10..60 {
        bench.hear(embedding(epoch, FOUR));
    }
    let messages = vec![embedding(59, FOUR), teams(2, 5, CROSSED, ""), embedding(5, FOUR)];
    bench.step(Event::Fetched { fetch: 1, messages });
    assert_eq!(bench.audit().embedding, revision(5));
}
