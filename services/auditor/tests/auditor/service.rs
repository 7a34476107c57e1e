//! The service around it: starts, gets, failures, lost links.

use super::*;

#[test]
fn the_wiring_is_that_of_the_service() {
    let served = Auditor::wiring().served;
    assert!(served.contains(&ServedKey::own(Pattern::One(Key::Audit))));
    for cached in [
        Pattern::One(Key::Teams),
        Pattern::One(Key::JsonTeams),
        Pattern::RobotTeams,
        Pattern::One(Key::Embedding),
        Pattern::One(Key::Roster),
    ] {
        assert!(served.contains(&ServedKey::cached(cached.clone())), "{cached:?}");
    }
}

#[test]
fn nothing_is_published_before_the_term_has_begun() {
    let mut bench = Bench::new();
    bench.input(Input::Started { linked: true });
    // The question for the leader is answered: there is none.
    let inquiry = std::mem::take(&mut bench.asks);
    assert_eq!(inquiry.len(), 7);
    bench.receive(embedding(1, FOUR));
    bench.receive(teams(1, 1, PAIRS, ""));
    bench.wait(100.0);
    assert!(bench.audits().is_empty() && bench.events().is_empty() && bench.jobs_run == 0);
    bench.answer_fetch(inquiry, vec![]);
    assert_eq!(bench.events(), [EventKind::ServiceStarted { term: 1 }]);
    assert_eq!(bench.audit().header.revision, revision(2));
}

#[test]
fn a_division_waits_for_its_embedding() {
    let mut bench = Bench::leading(vec![]);
    bench.receive(teams(1, 1, PAIRS, ""));
    assert_eq!(bench.jobs_run, 0);
    assert_eq!(bench.status().state, "waiting for the embedding of a division");
    bench.wait(0.1);
    bench.receive(embedding(1, FOUR));
    assert_eq!(bench.audit().teams, revision(1));
    assert!(bench.asks.is_empty());

    // One that does not come is asked for, again and again, and not from the start each time.
    bench.receive(embedding(3, FOUR));
    bench.receive(teams(2, 2, CROSSED, ""));
    bench.wait(0.1);
    bench.receive(teams(3, 2, CROSSED, ""));
    bench.wait(0.15);
    let mut fetches = bench.take_fetches();
    assert_eq!(fetches.iter().map(Vec::len).collect::<Vec<_>>(), [2]);
    bench.answer_fetch(fetches.remove(0), vec![]);
    bench.forget_audits();
    bench.wait(0.5);
    assert!(bench.asks.is_empty());
    bench.wait(0.5);
    let mut fetches = bench.take_fetches();
    assert_eq!(fetches.len(), 1);
    // A reader that still has it answers, though there is a newer one.
    bench.forget_audits();
    let messages = vec![teams(3, 2, CROSSED, ""), embedding(2, FOUR)];
    bench.answer_fetch(fetches.remove(0), messages);
    let audit = bench.audit();
    assert_eq!((audit.teams, audit.embedding), (revision(3), revision(2)));
    assert_eq!(bench.counter("messages_old"), 0);
}

#[test]
fn an_embedding_is_kept_until_its_division_comes() {
    let mut bench = Bench::leading(vec![]);
    let moved = |epoch: u64| [("a", [epoch as f64, 0.0]), ("b", [0.0, 1.0])];
    for epoch in 1..=40 {
        bench.receive(embedding(epoch, &moved(epoch)));
    }
    bench.receive(teams(1, 9, &[("t1", "a"), ("t2", "b")], ""));
    assert_eq!(bench.audit().embedding, revision(9));
    bench.receive(teams(2, 1, &[("t1", "a"), ("t2", "b")], ""));
    assert!(bench.audits().is_empty(), "that one is forgotten");
    bench.receive(teams(3, 40, &[("t1", "a"), ("t2", "b")], ""));
    assert_eq!(bench.audit().embedding, revision(40));
}

#[test]
fn a_restart_scores_what_others_remember() {
    let (_, last) = scored();
    let last = Arc::new(Audit {
        header: Header { revision: Revision { term: 7, epoch: 3 }, ..last.header.clone() },
        ..Audit::clone(&last)
    });
    let mut bench = Bench::leading(vec![Message::Audit(Arc::clone(&last))]);
    assert_eq!(bench.get("audit", None).unwrap(), [Message::Audit(last.clone())]);
    assert_eq!(bench.host.deadline(), Some(START.after(muster_service::RENEWAL_INTERVAL)));
    bench.receive(embedding(1, FOUR));
    bench.receive(teams(1, 1, PAIRS, ""));
    // The list of alerts came first.
    assert_eq!(bench.audit().header.revision, Revision { term: 8, epoch: 2 });

    // Answers come in any order.
    let messages = vec![
        teams(2, 1, PAIRS, ""),
        Message::Audit(last),
        embedding(1, FOUR),
        teams(1, 0, CROSSED, ""),
    ];
    let mut bench = Bench::leading(messages);
    assert_eq!(bench.audit().teams, revision(2));
    assert_eq!(bench.counter("messages_old"), 0);
}

#[test]
fn old_terms_and_epochs_are_dropped() {
    let (mut bench, _) = scored();
    bench.receive(embedding(5, FOUR));
    bench.receive(teams(5, 5, CROSSED, ""));
    bench.audit();
    bench.receive(teams(4, 5, PAIRS, ""));
    bench.receive(teams(5, 5, PAIRS, ""));
    bench.receive(embedding(4, FOUR));
    assert_eq!(bench.counter("messages_old"), 2);
    let Message::Teams { teams: mut old, mirror } = teams(900, 5, PAIRS, "") else { panic!() };
    old.make_mut_unchecked().header.revision.term = 0;
    bench.receive(Message::Teams { teams: old, mirror });
    assert_eq!(bench.counter("messages_old"), 3);
    assert!(bench.audits().is_empty());
}

#[test]
fn a_failed_job_changes_nothing() {
    let (mut bench, first) = scored();
    bench.hold_jobs = true;
    bench.receive(teams(2, 1, CROSSED, ""));
    bench.panic_job("out of luck");
    assert_eq!(
        bench.events(),
        [EventKind::JobFailed { reason: "the job panicked: out of luck".to_owned() }]
    );
    assert_eq!(bench.counter("jobs_failed"), 1);
    bench.receive(teams(3, 1, CROSSED, ""));
    assert!(bench.job.is_none(), "it would fail again");
    bench.wait(1.0);
    assert!(bench.job.is_some(), "a panic is tried again");
    bench.panic_job("still");
    assert_eq!(bench.events().len(), 1, "not reported again so soon");
    let again = bench.audit();
    assert_eq!((again.teams, &again.in_embedding), (revision(1), &first.in_embedding));
    bench.receive(embedding(2, &[("a", [1e200, 0.0]), ("b", [0.0, 0.0])]));
    bench.receive(teams(4, 2, &[("t1", "a"), ("t2", "b")], ""));
    bench.run_job();
    assert!(
        matches!(&bench.events()[1], EventKind::JobFailed { reason } if reason.contains("large"))
    );
}

#[test]
fn the_newest_division_follows_a_running_job() {
    let mut bench = Bench::leading(vec![]);
    bench.hold_jobs = true;
    bench.receive(embedding(1, FOUR));
    bench.receive(teams(1, 1, PAIRS, ""));
    bench.receive(teams(2, 1, CROSSED, ""));
    bench.receive(teams(3, 1, &[("t1", "a"), ("t2", "b c d")], ""));
    bench.receive(embedding(2, FOUR));
    bench.run_job();
    assert_eq!(bench.audit().teams, revision(1));
    bench.run_job();
    assert_eq!(bench.audit().teams, revision(3));
    assert!(bench.job.is_none());
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
        assert!(bench.get(selector, None).unwrap().is_empty(), "{selector}");
    }
    assert_eq!(bench.status().state, "waiting for a division");
    bench.start(vec![]);
    bench.receive(roster(1, &[("a", "map", None)]));
    bench.receive(embedding(1, FOUR));
    bench.receive(teams(1, 1, &[("t1", "a b"), ("t2", "c")], "d"));
    let answers = [
        ("audit", 1),
        ("json/*", 3),
        ("json/audit", 1),
        ("*", 5),
        ("robot/*/team", 4),
        ("robot/d/team", 1),
        ("robot/x/team", 0),
    ];
    for (selector, count) in answers {
        assert_eq!(bench.get(selector, None).unwrap().len(), count, "{selector}");
    }
    assert!(matches!(bench.get("teams", None).unwrap()[..], [Message::Teams { .. }]));
    assert!(matches!(bench.get("embedding", None).unwrap()[..], [Message::Embedding(_)]));
    assert!(matches!(bench.get("roster", None).unwrap()[..], [Message::Roster(_)]));
    assert_eq!(bench.get("service/auditor/settings", None).unwrap().len(), 1);
    assert_eq!(bench.get("**", None).unwrap().len(), 1);
}

#[test]
fn refused_packets_are_reported() {
    let mut bench = Bench::leading(vec![]);
    bench.forget_events();
    let rejection =
        Rejection { robot: None, key: "muster/v1/f/teams".into(), reason: "broken".into() };
    bench.receive_refused(rejection);
    let contradiction = teams(1, 1, &[("t1", "a"), ("t1", "b")], "");
    let space = muster_wire::KeySpace::new(FleetId::new("f").unwrap());
    bench.receive_packet(contradiction.to_packet(&space));
    assert!(matches!(bench.events()[0], EventKind::Quarantined { count: 1, .. }));
    assert_eq!((bench.counter("messages_refused"), bench.jobs_run), (2, 0));
}

#[test]
fn after_a_lost_link_the_missed_is_fetched() {
    let (mut bench, _) = scored();
    bench.input(Input::LinkLost);
    bench.input(Input::LinkRestored);
    let mut fetches = bench.take_fetches();
    assert_eq!((fetches.len(), fetches[0].len(), fetches[1].len()), (2, 4, 1));
    assert_eq!(fetches[1][0].pattern, Pattern::One(Key::Audit));
    bench.audit();
    let messages = vec![teams(2, 2, CROSSED, ""), embedding(2, FOUR)];
    bench.answer_fetch(fetches.remove(0), messages);
    assert_eq!(bench.audit().teams, revision(2));
}

#[test]
fn a_higher_revision_that_stands_still_begins_a_new_term() {
    let (mut bench, audit) = scored();
    bench.wait(5.0);
    assert!(bench.asked().contains(&Pattern::One(Key::Audit)));
    let mut other = Audit::clone(&audit);
    other.header.revision = Revision { term: 9, epoch: 4 };
    let seen = || vec![Message::Audit(Arc::new(other.clone()))];
    bench.answer_term_check(seen());
    while !bench.asked().contains(&Pattern::One(Key::Audit)) {
        bench.wait(0.1);
    }
    bench.forget_audits();
    bench.answer_term_check(seen());
    assert_eq!(bench.audit().header.revision, Revision { term: 10, epoch: 1 });
}

#[test]
fn an_old_embedding_is_taken_with_the_division_that_names_it() {
    let (mut bench, _) = scored();
    for epoch in 10..60 {
        bench.receive(embedding(epoch, FOUR));
    }
    let messages = vec![embedding(59, FOUR), teams(2, 5, CROSSED, ""), embedding(5, FOUR)];
    bench.input(Input::LinkLost);
    bench.input(Input::LinkRestored);
    bench.audit();
    let missed = bench.take_fetches().remove(0);
    bench.answer_fetch(missed, messages);
    assert_eq!(bench.audit().embedding, revision(5));
}
