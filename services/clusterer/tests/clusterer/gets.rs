//! Starts, gets, and lost links.

use super::*;

#[test]
fn the_wiring_is_that_of_the_service() {
    let wiring = Clusterer::wiring();
    let patterns: Vec<_> = wiring.subscriptions.iter().map(|s| s.pattern.clone()).collect();
    let keys = [Key::Embedding, Key::Roster, Key::Audit, Key::Teams, Key::Alerts, Key::Wishes];
    assert_eq!(patterns, keys.map(Pattern::One));
    for key in [Key::Audit, Key::JsonAudit, Key::Alerts, Key::JsonAlerts] {
        assert!(wiring.served.contains(&ServedKey::cached(Pattern::One(key))));
    }
    assert!(wiring.served.contains(&ServedKey::own(Pattern::RobotTeams)));
    assert!(wiring.served.contains(&ServedKey::cached(Pattern::One(Key::Embedding))));
}

/// An `ingest` that has lost its terms learns from its readers which of them a lower term would not
/// reach. It must learn so from each of them.
#[test]
fn what_it_goes_by_it_answers_to_an_ingest_that_has_forgotten() {
    assert!(Clusterer::wiring().served.contains(&ServedKey::cached(Pattern::One(Key::Roster))));
    let mut bench = Bench::leading(teams(2));
    bench.receive_roster(roster(7, "a b"));
    bench.receive_roster(roster(3, "a b c"));
    match &bench.get("roster", None).unwrap()[..] {
        [Message::Roster(known)] => assert_eq!(*known.as_ref(), roster(7, "a b")),
        other => panic!("{other:?}"),
    }
}

#[test]
fn nothing_is_published_before_the_term_has_begun() {
    let mut bench = Bench::new(teams(2));
    bench.input(Input::Started { linked: true });
    // The question for the leader is answered: there is none.
    let inquiry = std::mem::take(&mut bench.asks);
    assert_eq!(inquiry.len(), 5);
    bench.receive_embedding(&embedding(1, &[("a b", WEST), ("c d", EAST)]));
    bench.receive_roster(roster(1, "a b c d"));
    bench.wait(100.0);
    assert!(bench.published.is_empty() && bench.jobs_run == 0);

    bench.answer_fetch(inquiry, vec![]);
    let sent = bench.take();
    // At once, and with the first renewals of the lease.
    assert_eq!(sent.settings, 2);
    assert_eq!(sent.events[0], EventKind::ServiceStarted { term: 1 });
    assert_eq!(short(&sent.division()), "t1: a b | t2: c d");
    assert_eq!(bench.stored, Stored { term: 1, lacks_settings: true, ..Stored::default() });
}

#[test]
fn a_restart_finds_embedding_and_teams_together() {
    let first = embedding(1, &[("a b", WEST), ("c d", EAST)]);
    let (_, last) = divided(teams(2), &first);
    let messages = vec![
        Message::Roster(Checked::new_unchecked(roster(3, "a? b c d"))),
        Message::Embedding(first),
        mirrored(&last),
    ];
    let mut next = Bench::restored(teams(2), messages);
    let sent = next.take();
    assert_eq!(short(&sent.division()), short(&last));
    assert_eq!(sent.division().stale, [robot("a")]);
    assert_eq!(next.jobs_run, 1);
}

#[test]
fn every_get_has_exactly_one_answer() {
    let mut bench = Bench::new(teams(2));
    let all = ["teams", "json/teams", "robot/*/team", "robot/a/team", "embedding", "audit", "**"];
    for selector in all {
        // `**` selects the settings as well, which are there from the start.
        let known = usize::from(selector == "**");
        assert_eq!(bench.get(selector, None).unwrap().len(), known, "{selector}");
    }
    assert_eq!(bench.status().state, "waiting for an embedding");
    bench.start(vec![]);
    bench.receive_embedding(&embedding(1, &[("a b", WEST), ("c d!", EAST)]));
    let one = |bench: &mut Bench, selector: &str| match bench.get(selector, None).unwrap() {
        messages if messages.len() == 1 => messages[0].clone(),
        other => panic!("{selector}: {other:?}"),
    };
    assert!(matches!(one(&mut bench, "teams"), Message::Teams { .. }));
    assert!(matches!(one(&mut bench, "json/teams"), Message::Teams { .. }));
    assert_eq!(bench.get("json/*", None).unwrap().len(), 2, "teams and wishes");
    assert!(matches!(one(&mut bench, "embedding"), Message::Embedding(_)));
    assert!(matches!(one(&mut bench, "service/clusterer/settings"), Message::Settings(..)));
    for (name, team) in [("a", Some("t1")), ("d", None)] {
        let Message::RobotTeam(known) = one(&mut bench, &format!("robot/{name}/team")) else {
            panic!("{name}");
        };
        assert_eq!(known.team.as_ref().map(TeamId::as_str), team);
    }
    assert_eq!(bench.get("robot/*/team", None).unwrap().len(), 4);
    assert_eq!(bench.get("robot/$*a/team", None).unwrap().len(), 1);
    assert!(bench.get("robot/absent/team", None).unwrap().is_empty());
    assert!(bench.get("roster", None).unwrap().is_empty());
    assert_eq!(bench.get("*", None).unwrap().len(), 3, "teams, wishes and the embedding");
    let error = bench.get("service/clusterer/settings", Some("{\"teams\":0}")).unwrap_err();
    assert!(error.contains("teams"));
}

#[test]
fn an_answer_has_an_end() {
    let rows = (0..3000).map(|i| {
        let x = f64::from(i % 2) + f64::from(i) * 1e-6;
        (robot(&format!("r{i}")), vec![x, 0.0], false)
    });
    let settings = ClustererSettings { restarts: 1, ..teams(2) };
    let (mut bench, _) = divided(settings, &from_rows(1, 1, rows.collect()));
    // Teams so large list no members.
    assert_eq!(bench.get("robot/*/team", None).unwrap().len(), 3000);
    assert_eq!(bench.get("robot/r1/team", None).unwrap().len(), 1);
    assert_eq!(bench.get("teams", None).unwrap().len(), 1);
}
