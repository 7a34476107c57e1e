//! The list of open alerts: what raises them, how it is published, acknowledged and taken over.

use muster_model::alert::{AlertKind, AlertSubject};
use muster_model::history::{Coverage, RecordingState};
use muster_model::id::SkillId;
use muster_model::teams::{Limited, TeamNeed};

use super::teams::{PATH, SIX, TWO, frame_roster, graph, with_graphs, with_stale};
use super::*;

/// The open alerts, in short.
fn open(bench: &mut Bench) -> Vec<String> {
    let alerts = bench.read().alerts.clone().unwrap();
    alerts
        .open
        .iter()
        .map(|alert| format!("{} {} {}", alert.id, alert.kind, alert.subject))
        .collect()
}

/// The events of alerts, in short.
fn events(bench: &mut Bench) -> Vec<String> {
    let name = |event: &EventKind| match event {
        EventKind::AlertRaised { alert, kind, .. } => format!("+{alert} {kind}"),
        EventKind::AlertCleared { alert, kind, .. } => format!("-{alert} {kind}"),
        EventKind::AlertAcknowledged { alert, operator } => format!("{operator} saw {alert}"),
        other => format!("{other:?}"),
    };
    bench.read().alert_events.iter().map(name).collect()
}

/// One whose first team is cut off for long enough: c, on the path of its members, is stale.
fn cut_off() -> Bench {
    let mut bench = with_graphs();
    bench.get("service/auditor/settings", Some(r#"{"fragile": 1.0, "stale_share": 1.0}"#)).unwrap();
    bench.receive(with_stale(teams(2, 1, TWO, ""), &["c"]));
    bench.wait(3.0);
    bench
}

#[test]
fn a_team_that_is_cut_off_raises_one_alert_that_ends() {
    let mut bench = with_graphs();
    assert!(open(&mut bench).is_empty());
    bench = cut_off();
    assert_eq!(open(&mut bench), ["1 cut_off t1"]);
    let alert = bench.alerts.as_ref().unwrap().open[0].clone();
    assert_eq!(alert.reason, "no link joins the 2 parts of t1; its leader reaches 2 of 3 robots");
    assert_eq!((alert.value, alert.raised), (2.0, bench.now));
    bench.wait(5.0);
    bench.receive(teams(3, 1, TWO, ""));
    bench.wait(1.9);
    assert_eq!(open(&mut bench).len(), 1);
    bench.wait(0.1);
    assert!(open(&mut bench).is_empty());
    assert_eq!(events(&mut bench), ["+1 cut_off", "-1 cut_off"]);
    assert_eq!(bench.counter("alerts"), 1);
}

#[test]
fn the_alert_of_a_team_that_is_gone_ends_where_no_links_are_known() {
    let mut bench = cut_off();
    bench.receive(graph(2, "connectivity", &[]));
    bench.receive(frame_roster(2, &["connectivity"], &[]));
    bench.receive(with_stale(teams(3, 1, TWO, ""), &["c"]));
    bench.wait(9.0);
    assert_eq!(open(&mut bench), ["1 cut_off t1"], "nothing is known of t1");
    bench.receive(teams(4, 1, &[("t2", "e f"), ("t3", "a b c d")], ""));
    bench.wait(3.0);
    assert!(open(&mut bench).is_empty());
}

#[test]
fn a_leader_that_is_silent_and_many_stale_robots_and_a_fragile_team_raise_alerts() {
    let mut bench = with_graphs();
    bench.receive(with_stale(teams(2, 1, TWO, ""), &["e"]));
    bench.wait(3.0);
    assert_eq!(open(&mut bench), ["1 leaderless t2", "2 stale t2", "3 fragile t1"]);
    let robots = |bench: &Bench, at: usize| bench.alerts.as_ref().unwrap().open[at].robots.clone();
    assert_eq!((robots(&bench, 0), robots(&bench, 1)), (vec![robot("e")], vec![robot("e")]));
    assert_eq!(robots(&bench, 2), [robot("b"), robot("c")]);
}

#[test]
fn a_team_of_one_and_a_team_that_does_not_belong_together_raise_alerts() {
    let mut bench = Bench::leading(vec![]);
    bench.receive(embedding(1, FOUR));
    bench.receive(teams(1, 1, &[("t1", "a b c"), ("t2", "d")], ""));
    bench.wait(3.0);
    let found = open(&mut bench);
    assert!(
        found.contains(&"1 singleton t2".to_owned())
            || found.contains(&"2 singleton t2".to_owned()),
        "{found:?}"
    );
    bench.receive(teams(2, 1, CROSSED, ""));
    bench.wait(3.0);
    let found = open(&mut bench).join(", ");
    assert!(found.contains("poor t1") && found.contains("poor fleet"), "{found}");
    assert!(!found.contains("singleton"), "{found}");
}

#[test]
fn low_quality_and_flapping_are_on_the_list_and_keep_their_events() {
    let (mut bench, _) = scored();
    bench.forget_events();
    bench.receive(teams(2, 1, CROSSED, ""));
    bench.wait(3.0);
    assert!(matches!(bench.events()[..], [EventKind::QualityLow { .. }]));
    let alerts = bench.alerts.clone().unwrap();
    let is_fleet =
        |kind| alerts.open.iter().any(|of| of.kind == kind && of.subject == AlertSubject::Fleet);
    assert!(is_fleet(AlertKind::Poor));
    bench.receive(teams(3, 1, PAIRS, ""));
    assert!(matches!(bench.events()[..], [_, EventKind::QualityRecovered { .. }, ..]));
    bench.wait(2.0);
    let found = open(&mut bench).join(", ");
    assert!(!found.contains("poor fleet"), "{found}");
}

#[test]
fn limits_that_cannot_hold_are_an_alert_until_they_do() {
    let with_conflict = |epoch, conflict: Option<Limited>| {
        let Message::Teams { mut teams, mirror } = teams(epoch, 1, PAIRS, "") else { panic!() };
        teams.make_mut_unchecked().limited = conflict;
        Message::Teams { teams, mirror }
    };
    let (mut bench, _) = scored();
    let stands = Limited::standing("9 robots may only be in t1 and t2, which hold 8".to_owned());
    bench.receive(with_conflict(2, Some(stands)));
    bench.wait(2.9);
    assert!(open(&mut bench).is_empty());
    bench.wait(0.1);
    assert_eq!(open(&mut bench), ["1 infeasible fleet"]);
    let alert = bench.alerts.as_ref().unwrap().open[0].clone();
    assert_eq!(alert.reason, "9 robots may only be in t1 and t2, which hold 8");
    assert_eq!(alert.value, 1.0);
    // It goes on, and lacks a medic: that is less, and not over.
    bench.receive(with_conflict(3, Some(Limited::lacking("1 of 2 with medic".to_owned()))));
    bench.wait(5.0);
    assert_eq!(open(&mut bench), ["1 infeasible fleet"]);
    bench.receive(with_conflict(4, None));
    bench.wait(1.9);
    assert_eq!(open(&mut bench).len(), 1);
    bench.wait(0.1);
    assert!(open(&mut bench).is_empty());
    assert_eq!(events(&mut bench), ["+1 infeasible", "-1 infeasible"]);
}

#[test]
fn a_history_that_cannot_be_written_or_has_gaps_is_an_alert_without_a_division_too() {
    let instance = InstanceId::new("h-1").unwrap();
    let state = |lost, degraded: Option<&str>| {
        Message::HistoryState(Box::new(RecordingState {
            fleet: FleetId::new("f").unwrap(),
            instance: InstanceId::new("h-1").unwrap(),
            coverage: Coverage::default(),
            lost,
            degraded: degraded.map(str::to_owned),
        }))
    };
    let mut bench = Bench::leading(vec![state(0, None)]);
    bench.receive(state(0, Some("the disk is full")));
    bench.wait(2.9);
    assert!(open(&mut bench).is_empty());
    bench.wait(0.2);
    assert_eq!(open(&mut bench), ["1 history_degraded fleet"]);
    assert_eq!(bench.alerts.as_ref().unwrap().open[0].reason, "h-1: the disk is full");
    bench.receive(state(0, None));
    bench.wait(2.1);
    assert!(open(&mut bench).is_empty());
    // Nothing is wrong any more; what was lost is worth a look for a minute.
    bench.receive(state(40, None));
    bench.wait(10.0);
    assert_eq!(open(&mut bench), ["2 history_degraded fleet"]);
    assert_eq!(bench.alerts.as_ref().unwrap().open[0].reason, "h-1: 40 records were lost");
    bench.wait(60.0);
    assert!(open(&mut bench).is_empty());
    // A historian that is gone says nothing of its disk.
    bench.receive(state(40, Some("the disk is full")));
    bench.wait(5.0);
    assert_eq!(open(&mut bench).len(), 1);
    let service = ServiceName::Historian;
    bench.receive(Message::ServiceToken { service, instance, alive: false });
    bench.wait(3.0);
    assert!(open(&mut bench).is_empty());
}

#[test]
fn a_modality_in_doubt_is_an_alert() {
    use muster_model::embedding::EmbeddingGraph;
    use muster_model::id::Modality;
    let trusted = |epoch, trust| {
        let Message::Embedding(mut message) = embedding(epoch, FOUR) else { panic!() };
        message.make_mut_unchecked().graphs = vec![EmbeddingGraph {
            modality: Modality::spatial(),
            revision: revision(1),
            weight: 1.0,
            trust,
        }];
        Message::Embedding(message)
    };
    let mut bench = Bench::leading(vec![]);
    bench.receive(trusted(1, 0.2));
    bench.receive(teams(1, 1, PAIRS, ""));
    bench.wait(3.0);
    assert_eq!(open(&mut bench), ["1 modality_doubted spatial"]);
    bench.receive(trusted(2, 0.9));
    bench.receive(teams(2, 2, PAIRS, ""));
    bench.wait(3.0);
    assert!(open(&mut bench).is_empty());
}

#[test]
fn many_robots_that_change_teams_are_churn() {
    let mut bench = Bench::leading(vec![]);
    bench.receive(embedding(1, FOUR));
    bench
        .get("service/auditor/settings", Some(r#"{"flapping": 1000, "team_poor": -1, "poor": -1}"#))
        .unwrap();
    let divisions = [&[("t1", "a b"), ("t2", "c d")], &[("t1", "c d"), ("t2", "a b")]];
    for epoch in 0..3_u64 {
        bench.receive(teams(epoch + 1, 1, divisions[usize::try_from(epoch % 2).unwrap()], ""));
        bench.wait(1.0);
    }
    bench.wait(3.0);
    assert_eq!(open(&mut bench), ["1 churn fleet"]);
    bench.wait(62.0);
    assert!(open(&mut bench).is_empty());
}

#[test]
fn an_operator_acknowledges_an_alert_and_learns_what_is_wrong_with_a_request() {
    let mut bench = cut_off();
    let answer = bench.get("alerts", Some(r#"{"operator": "kim", "alert": 1}"#)).unwrap();
    let [Message::Alerts(alerts)] = &answer[..] else { panic!("{answer:?}") };
    assert_eq!(alerts.open[0].acknowledged.as_ref().unwrap().operator.as_str(), "kim");
    assert_eq!(bench.read().alerts.as_ref(), Some(alerts), "it is published as well");
    assert_eq!(events(&mut bench), ["+1 cut_off", "kim saw 1"]);
    for (payload, named) in [
        (r#"{"operator": "kim", "alert": 9}"#, "no open alert 9"),
        (r#"{"operator": "kim", "alert": -1}"#, "alert"),
        (r#"{"operator": "kim"}"#, "command"),
        ("x", "command"),
    ] {
        let refused = bench.get("alerts", Some(payload)).unwrap_err();
        assert!(refused.contains(named), "{refused}");
    }
    for selector in ["alerts", "json/alerts"] {
        assert_eq!(bench.get(selector, None).unwrap().len(), 1);
    }
}

#[test]
fn the_list_is_republished_for_consoles_that_come_late() {
    let mut bench = cut_off();
    bench.read();
    bench.alerts = None;
    bench.wait(1.0);
    assert_eq!(open(&mut bench), ["1 cut_off t1"]);
    assert_eq!(events(&mut bench).len(), 1);
    // An empty list is published as well.
    let mut bench = Bench::leading(vec![]);
    assert!(open(&mut bench).is_empty());
    bench.alerts = None;
    bench.wait(1.0);
    assert!(open(&mut bench).is_empty());
}

#[test]
fn a_standby_takes_over_numbers_and_acknowledgements() {
    let mut first = cut_off();
    first.get("alerts", Some(r#"{"operator": "kim", "alert": 1}"#)).unwrap();
    let list = first.read().alerts.clone().unwrap();
    let mut bench = Bench::leading(vec![Message::Alerts(Arc::clone(&list))]);
    assert_eq!(bench.read().alerts.as_ref().unwrap().open, list.open);
    bench.receive(graph(1, "connectivity", PATH));
    bench.receive(frame_roster(1, &["connectivity"], &[]));
    bench.receive(embedding(1, SIX));
    bench.get("service/auditor/settings", Some(r#"{"fragile": 1.0, "stale_share": 1.0}"#)).unwrap();
    bench.receive(with_stale(teams(2, 1, TWO, ""), &["c"]));
    bench.wait(9.0);
    assert_eq!(open(&mut bench), ["1 cut_off t1"]);
    assert!(events(&mut bench).is_empty(), "it is not raised again");
    bench.receive(with_stale(teams(3, 1, TWO, ""), &["f"]));
    bench.wait(3.0);
    assert_eq!(events(&mut bench), ["-1 cut_off"]);
}

#[test]
fn low_quality_that_an_earlier_leader_has_reported_is_not_reported_again() {
    let (mut first, _) = scored();
    first.receive(teams(2, 1, CROSSED, ""));
    first.wait(3.0);
    let list = first.read().alerts.clone().unwrap();
    let mut bench = Bench::leading(vec![Message::Alerts(list)]);
    bench.forget_events();
    bench.receive(embedding(1, FOUR));
    bench.receive(teams(2, 1, CROSSED, ""));
    bench.wait(5.0);
    assert!(bench.events().is_empty(), "{:?}", bench.events());
    bench.receive(teams(3, 1, PAIRS, ""));
    assert!(matches!(bench.events()[..], [EventKind::QualityRecovered { .. }]));
}

#[test]
fn a_suspect_raises_nothing_before_it_leads_again() {
    let mut bench = with_graphs();
    bench.get("service/auditor/settings", Some(r#"{"fragile": 1.0, "stale_share": 1.0}"#)).unwrap();
    bench.receive(with_stale(teams(2, 1, TWO, ""), &["c"]));
    bench.input(Input::LinkLost);
    bench.wait(5.0);
    assert!(events(&mut bench).is_empty());
    bench.input(Input::LinkRestored);
    assert_eq!(events(&mut bench), ["+1 cut_off"]);
}

/// A division whose teams need medics: so many of each team, and so many it has.
fn with_needs(teams: Message, needs: &[(&str, u32, u32)]) -> Message {
    let Message::Teams { mut teams, mirror } = teams else { panic!() };
    let need = |(team, min, have): &(&str, u32, u32)| TeamNeed {
        team: TeamId::new(team).unwrap(),
        skill: SkillId::new("medic").unwrap(),
        min: *min,
        max: None,
        soft: false,
        have: *have,
    };
    teams.make_mut_unchecked().needs = needs.iter().map(need).collect();
    Message::Teams { teams, mirror }
}

#[test]
fn a_team_that_lacks_what_it_needs_raises_an_alert_that_ends() {
    let mut bench = with_graphs();
    bench.get("service/auditor/settings", Some(r#"{"fragile": 1.0}"#)).unwrap();
    bench.receive(with_needs(teams(2, 1, TWO, ""), &[("t1", 1, 2), ("t2", 2, 0)]));
    bench.wait(2.9);
    assert!(open(&mut bench).is_empty());
    bench.wait(0.1);
    assert_eq!(open(&mut bench), ["1 lacking t2"]);
    let alert = bench.alerts.as_ref().unwrap().open[0].clone();
    assert_eq!((alert.reason.as_str(), alert.value), ("t2 has 0 of 2 with medic", 2.0));
    // A replacement comes, and the alert ends after a while.
    bench.receive(with_needs(teams(3, 1, TWO, ""), &[("t1", 1, 1), ("t2", 2, 2)]));
    bench.wait(2.0);
    assert!(open(&mut bench).is_empty());
    assert_eq!(events(&mut bench), ["+1 lacking", "-1 lacking"]);
}
