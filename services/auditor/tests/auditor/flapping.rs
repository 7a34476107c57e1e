//! Robots that change teams to and fro: what the audit says of them, and the alert.

use muster_model::alert::AlertKind;

use super::*;

/// One that has scored a division of four robots, and receives `count` more, one each second: b goes to and
/// fro.
fn flapping(count: u64) -> Bench {
    let (mut bench, _) = scored();
    let away = &[("t1", "a"), ("t2", "b c d")];
    for epoch in 2..2 + count {
        bench.wait(1.0);
        bench.receive(teams(epoch, 1, if epoch % 2 == 0 { away } else { PAIRS }, ""));
    }
    bench
}

/// The events that concern flapping, in short.
fn alerts(bench: &mut Bench) -> Vec<String> {
    let short = |event: &EventKind| match event {
        EventKind::Flapping { returns_per_robot_minute, robots } => {
            let robots: Vec<_> = robots.iter().map(ToString::to_string).collect();
            Some(format!("{returns_per_robot_minute:.2} {}", robots.join(" ")))
        }
        EventKind::FlappingEnded { returns_per_robot_minute } => {
            Some(format!("ended {returns_per_robot_minute:.3}"))
        }
        _ => None,
    };
    bench.events().iter().filter_map(short).collect()
}

fn last(bench: &mut Bench) -> Flapping {
    bench.audits().last().unwrap().flapping.clone()
}

#[test]
fn the_audit_says_how_often_robots_come_back() {
    assert_eq!(last(&mut flapping(1)), Flapping::default());
    let found = last(&mut flapping(2));
    // One return of four robots, over the shortest time that a rate is taken over.
    assert!((found.returns_per_robot_minute - 1.5).abs() < 1e-12, "{found:?}");
    assert_eq!(found.robots, [RobotReturns { robot: robot("b"), returns: 1 }]);
    assert_eq!(last(&mut flapping(4)).robots[0].returns, 3);
}

#[test]
fn a_robot_that_goes_to_and_fro_raises_one_alert_that_ends_by_time_alone() {
    let mut bench = flapping(2);
    assert!(alerts(&mut bench).is_empty(), "it walked back once");
    bench = flapping(3);
    assert_eq!(alerts(&mut bench), ["3.00 b"]);
    bench.wait(58.0);
    assert_eq!(alerts(&mut bench).len(), 1);
    bench.wait(2.0);
    // Its returns were in the third and fourth second.
    assert_eq!(alerts(&mut bench), ["3.00 b", "ended 0.000"]);
    assert_eq!(last(&mut bench), Flapping::default());
}

#[test]
fn an_alert_ends_by_time_even_if_no_division_is_scored() {
    let mut bench = flapping(2);
    bench.hold_jobs = true;
    bench.receive(teams(4, 7, CROSSED, ""));
    assert_eq!(alerts(&mut bench).len(), 1, "{:?}", bench.events());
    bench.wait(61.0);
    assert_eq!(alerts(&mut bench).len(), 2);
}

#[test]
fn another_threshold_raises_or_ends_the_alert_at_once() {
    let mut bench = flapping(3);
    bench.get("service/auditor/settings", Some(r#"{"flapping": 6.0}"#)).unwrap();
    assert_eq!(alerts(&mut bench), ["3.00 b", "ended 3.000"]);
    bench.get("service/auditor/settings", Some(r#"{"flapping": 2.9}"#)).unwrap();
    assert_eq!(alerts(&mut bench).len(), 3);
}

#[test]
fn the_alert_of_an_earlier_leader_does_not_end_before_its_changes_are_out_of_the_window() {
    let mut first = flapping(3);
    let list = first.read().alerts.clone().unwrap();
    assert!(list.open.iter().any(|alert| alert.kind == AlertKind::Flapping));
    let mut bench = Bench::leading(vec![Message::Alerts(list)]);
    bench.forget_events();
    bench.receive(embedding(1, FOUR));
    bench.receive(teams(9, 1, PAIRS, ""));
    bench.wait(58.0);
    assert!(alerts(&mut bench).is_empty(), "{:?}", bench.events());
    bench.wait(4.0);
    assert_eq!(alerts(&mut bench), ["ended 0.000"]);
}

#[test]
fn a_suspect_raises_the_alert_once_it_leads_again() {
    let mut bench = flapping(2);
    bench.input(Input::LinkLost);
    bench.receive(teams(4, 1, &[("t1", "a"), ("t2", "b c d")], ""));
    bench.wait(1.0);
    assert!(alerts(&mut bench).is_empty());
    bench.input(Input::LinkRestored);
    assert_eq!(alerts(&mut bench), ["3.00 b"]);
}

#[test]
fn the_window_of_a_leader_begins_with_its_term() {
    let mut bench = Bench::new();
    bench.input(Input::Started { linked: true });
    let inquiry = std::mem::take(&mut bench.asks);
    bench.receive(embedding(1, FOUR));
    for epoch in 1..6 {
        bench.receive(teams(epoch, 1, if epoch % 2 == 0 { CROSSED } else { PAIRS }, ""));
    }
    // Until its questions are old enough that nobody will answer them.
    bench.wait(100.0);
    bench.answer_fetch(inquiry, vec![]);
    assert!(alerts(&mut bench).is_empty());
    assert_eq!(last(&mut bench), Flapping::default());
    bench.receive(teams(6, 1, CROSSED, ""));
    assert_eq!(last(&mut bench), Flapping::default());
}
