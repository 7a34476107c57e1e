//! What is scored by what.

use muster_method::silhouettes::SilhouetteParams;
use muster_model::audit::SilhouetteMethod;

use super::*;

#[test]
fn a_division_is_scored_in_both_spaces() {
    let mut bench = Bench::leading(vec![]);
    bench.receive(roster(
        1,
        &[
            ("a", "map", Some([0.0, 0.0, 0.0])),
            ("b", "map", Some([0.0, 9.0, 2.0])),
            ("c", "other", Some([1.0, 1.0, 0.0])),
            ("d", "map", Some([5.0, 5.0, 1.0])),
            ("e", "map", None),
            ("f", "map", Some([4.0, 0.0, f64::NAN])),
            ("g", "map", Some([7.0, 5.0, 1.0])),
            ("loose", "other", Some([7.0, 5.0, 1.0])),
        ],
    ));
    let rows: Rows<'_> = &[
        ("a", [0.0, 0.0]),
        ("b", [0.5, 0.1]),
        ("c", [1.0, 0.3]),
        ("d", [0.9, -0.4]),
        ("e", [0.2, 0.7]),
        ("f", [0.3, 0.3]),
        ("g", [2.0, 2.0]),
        ("loose", [9.0, 9.0]),
    ];
    bench.receive(embedding(1, rows));
    bench.wait(0.5);
    bench.hold_jobs = true;
    bench.receive(teams(
        4,
        1,
        &[("t1", "a d"), ("t2", "b c e"), ("t3", "f"), ("t10", "g")],
        "loose",
    ));
    bench.wait(0.2);
    bench.run_job();
    let audit = bench.audit();
    assert_eq!((audit.teams, audit.embedding), (revision(4), revision(1)));
    let stage = audit.header.stages.last().unwrap();
    assert_eq!(stage.stage, ServiceName::Auditor);
    assert_eq!(stage.published.since(stage.received).as_millis(), 200);
    assert_eq!(audit.header.oldest, Some(START));

    let points: Vec<Vec<f64>> = rows[..7].iter().map(|row| row.1.to_vec()).collect();
    let labels = [1, 2, 2, 1, 2, 3, 10];
    check_report(&audit.in_embedding, &["a", "b", "c", "d", "e", "f", "g"], &points, &labels);
    assert_eq!(audit.in_embedding.space, Space::Embedding);
    let singleton = |name: &str| {
        audit.in_embedding.per_robot.iter().find(|(r, _)| r.as_str() == name).unwrap().1
    };
    assert_eq!((singleton("f"), singleton("g")), (0.0, 0.0));
    let points =
        [[0.0, 0.0, 0.0], [0.0, 9.0, 2.0], [5.0, 5.0, 1.0], [7.0, 5.0, 1.0]].map(|p| p.to_vec());
    check_report(&audit.in_physical, &["a", "b", "d", "g"], &points, &[1, 2, 1, 10]);
    assert_eq!(audit.in_physical.space, Space::Physical);
}

#[test]
fn a_large_fleet_is_scored_by_a_sample_and_each_robot_by_squared_distances() {
    // Two heaps, one of them half as wide, and a robot of the first in the other's team.
    let place = |robot: usize| {
        let (heap, at) = (robot % 2, robot / 2);
        [(at % 100) as f64 / (1 + heap) as f64 + 150.0 * heap as f64, (at / 100) as f64]
    };
    let team = |robot: usize| if robot == 1 { 0 } else { robot % 2 };
    let names = |robots: usize| -> Vec<String> {
        (0..robots).map(|robot| format!("r{robot:05}")).collect()
    };
    let audit = |robots: usize| {
        let names = names(robots);
        let rows: Vec<_> =
            names.iter().enumerate().map(|(robot, name)| (name.as_str(), place(robot))).collect();
        let of = |wanted: usize| {
            let members = (0..robots).filter(|robot| team(*robot) == wanted);
            members.map(|robot| names[robot].clone()).collect::<Vec<_>>().join(" ")
        };
        let (first, second) = (of(0), of(1));
        let mut bench = Bench::leading(vec![]);
        bench.receive(embedding(1, &rows));
        bench.receive(teams(1, 1, &[("t1", &first), ("t2", &second)], ""));
        bench.audit()
    };
    use SilhouetteMethod::{Exact, Sampled, SquaredExact};
    let exact_robots = SilhouetteParams::default().exact_robots;
    let exact = audit(exact_robots).in_embedding.clone();
    assert_eq!((exact.method, exact.standard_error, exact.detail_method), (Exact, 0.0, Exact));
    let robots = exact_robots + 1000;
    let sampled = audit(robots).in_embedding.clone();
    assert_eq!((sampled.method, sampled.detail_method), (Sampled, SquaredExact));
    assert!((1e-4..0.02).contains(&sampled.standard_error), "{}", sampled.standard_error);
    // The fleet has hardly another shape for being a little larger.
    let [mean, wanted] = [&sampled, &exact].map(|report| report.mean.unwrap());
    assert!((mean - wanted).abs() < 0.02 + 5.0 * sampled.standard_error, "{mean} {wanted}");
    // Every robot has a silhouette, and the sums of squared distances are those of the definition.
    assert_eq!(sampled.per_robot.len(), robots);
    for robot in [0, 1, 2, 777, robots - 1] {
        let mean_to = |wanted: usize| {
            let others = (0..robots).filter(|other| team(*other) == wanted && *other != robot);
            let squares = others.map(|other| {
                let ([a, b], [c, d]) = (place(robot), place(other));
                (a - c).powi(2) + (b - d).powi(2)
            });
            let squares: Vec<f64> = squares.collect();
            squares.iter().sum::<f64>() / squares.len() as f64
        };
        let (a, b) = (mean_to(team(robot)), mean_to(1 - team(robot)));
        let (name, found) = &sampled.per_robot[robot];
        assert_eq!(name.as_str(), names(robots)[robot]);
        assert!((found - (b - a) / a.max(b)).abs() < 1e-9, "{name}");
    }
    assert!(sampled.per_robot[1].1 < 0.0, "it stands in the other heap");
    assert_eq!(sampled.per_team.len(), 2);
}

#[test]
fn fewer_than_two_teams_are_not_scored() {
    let mut bench = Bench::leading(vec![]);
    bench.receive(embedding(1, FOUR));
    for (epoch, division) in (1..).zip([&[][..], &[("t1", "a b c d")][..]]) {
        bench.receive(teams(epoch, 1, division, ""));
        let audit = bench.audits().pop().unwrap();
        assert_eq!(audit.quality, Quality::Undefined);
        for report in [&audit.in_embedding, &audit.in_physical] {
            assert_eq!(report.mean, None);
            assert!(report.per_robot.is_empty() && report.per_team.is_empty());
        }
    }
    assert!(bench.status().state.starts_with("undefined"));
    // Teams of robots that the embedding does not know are as good as none.
    bench.receive(teams(3, 1, &[("t1", "a b"), ("t2", "x y")], ""));
    assert_eq!(bench.audits().pop().unwrap().quality, Quality::Undefined);
}

#[test]
fn the_quality_follows_the_thresholds() {
    let (mut bench, audit) = scored();
    assert_eq!(audit.quality, Quality::Good);
    assert_eq!(bench.status().state, "good, mean silhouette 0.84");
    // New thresholds apply to the old silhouettes at once, without a job.
    bench.get("service/auditor/settings", Some(r#"{"good":0.95}"#)).unwrap();
    assert_eq!(bench.audit().quality, Quality::Fair);
    bench.get("service/auditor/settings", Some(r#"{"poor":0.9}"#)).unwrap();
    assert_eq!(bench.audit().quality, Quality::Poor);
    assert_eq!(bench.jobs_run, 1);
    assert!(bench.get("service/auditor/settings", Some(r#"{"good":0.1}"#)).is_err());
    assert!(bench.audits().is_empty());
}

#[test]
fn an_unchanged_division_is_published_every_second_without_a_job() {
    let (mut bench, first) = scored();
    for epoch in 2..8 {
        bench.wait(0.1);
        bench.receive(embedding(epoch, FOUR));
        bench.receive(teams(epoch, epoch, PAIRS, ""));
    }
    assert!(bench.audits().is_empty());
    assert_eq!(bench.host.deadline(), Some(START.after(Duration::from_secs(1))));
    bench.wait(0.45);
    let again = bench.audit();
    assert_eq!((again.teams, again.embedding), (revision(7), revision(7)), "as fresh as its data");
    assert!(again.header.revision > first.header.revision);
    assert_eq!(again.in_embedding, first.in_embedding);
    // With nothing new at all it goes on, and grows older.
    bench.wait(1.0);
    assert_eq!(bench.audit().header.oldest, Some(START));
    assert_eq!(bench.jobs_run, 1);
    // New positions are something new.
    let positions = [("a", "map", Some([0.0; 3])), ("c", "map", Some([1.0; 3]))];
    bench.receive(roster(8, &positions));
    bench.receive(embedding(8, FOUR));
    bench.receive(teams(8, 8, PAIRS, ""));
    assert_eq!(bench.audit().in_physical.mean, Some(0.0));
    bench.receive(teams(9, 8, CROSSED, ""));
    assert!(bench.audit().in_embedding.mean.unwrap() < 0.0);
    assert_eq!(bench.counter("divisions_judged"), 3);
}

#[test]
fn the_roster_is_that_of_the_embedding_or_else_the_newest() {
    let at = |x: f64| {
        [
            ("a", "map", Some([0.0; 3])),
            ("b", "map", Some([1.0, 0.0, 0.0])),
            ("c", "map", Some([x, 0.0, 0.0])),
        ]
    };
    let mut bench = Bench::leading(vec![]);
    bench.receive(roster(1, &at(9.0)));
    bench.receive(roster(2, &at(3.0)));
    bench.receive(embedding(1, FOUR));
    bench.receive(teams(1, 1, PAIRS, ""));
    let own = bench.audit().in_physical.mean.unwrap();
    let expected = |x: f64| {
        let points = [vec![0.0], vec![1.0], vec![x]];
        naive(&points, &[1, 1, 2]).iter().sum::<f64>() / 3.0
    };
    assert!((own - expected(9.0)).abs() < 1e-12);
    bench.receive(embedding(5, FOUR));
    bench.receive(teams(2, 5, PAIRS, ""));
    assert!((bench.audit().in_physical.mean.unwrap() - expected(3.0)).abs() < 1e-12);
    // The right one comes late.
    bench.receive(roster(4, &at(5.0)));
    assert!(bench.audits().is_empty());
    bench.receive(roster(5, &at(7.0)));
    assert!((bench.audit().in_physical.mean.unwrap() - expected(7.0)).abs() < 1e-12);
}

#[test]
fn of_two_frames_with_equally_many_robots_the_first_by_name_counts() {
    let mut bench = Bench::leading(vec![]);
    let at = |x: f64| Some([x, 0.0, 0.0]);
    bench.receive(roster(
        1,
        &[
            ("a", "hall", at(0.0)),
            ("b", "yard", at(1.0)),
            ("c", "hall", at(2.0)),
            ("d", "yard", at(3.0)),
        ],
    ));
    bench.receive(embedding(1, FOUR));
    bench.receive(teams(1, 1, PAIRS, ""));
    let names: Vec<String> =
        bench.audit().in_physical.per_robot.iter().map(|(robot, _)| robot.to_string()).collect();
    assert_eq!(names, ["a", "c"]);
}

#[test]
fn lasting_bad_quality_raises_one_alert() {
    let (mut bench, _) = scored();
    // Robots go to and fro as well.
    bench
        .get("service/auditor/settings", Some(r#"{"flapping": 1000, "team_poor": -1.0}"#))
        .unwrap();
    bench.forget_audits();
    bench.forget_events();
    bench.receive(teams(2, 1, CROSSED, ""));
    assert!(bench.audit().quality == Quality::Poor && bench.events().is_empty());
    bench.wait(2.9);
    assert!(bench.events().is_empty());
    assert_eq!(bench.host.deadline(), Some(START.after(Duration::from_secs(3))));
    bench.wait(0.1);
    assert!(matches!(bench.events()[..], [EventKind::QualityLow { mean }] if mean < 0.0));
    for _ in 0..5 {
        bench.wait(2.0);
    }
    bench.receive(teams(3, 1, PAIRS, ""));
    assert!(matches!(bench.events()[..], [_, EventKind::QualityRecovered { mean }] if mean > 0.3));
    assert_eq!(bench.counter("alerts"), 1);
    // A short dip is none.
    bench.receive(teams(4, 1, CROSSED, ""));
    bench.wait(2.0);
    bench.receive(teams(5, 1, PAIRS, ""));
    bench.wait(2.0);
    bench.receive(teams(6, 1, CROSSED, ""));
    bench.wait(2.0);
    assert_eq!(bench.events().len(), 2);
}

#[test]
fn an_alert_that_becomes_due_while_suspect_is_raised_after_it() {
    let (mut bench, _) = scored();
    bench.get("service/auditor/settings", Some(r#"{"team_poor": -1.0}"#)).unwrap();
    bench.forget_events();
    bench.receive(teams(2, 1, CROSSED, ""));
    bench.input(Input::LinkLost);
    bench.wait(4.0);
    assert!(bench.events().is_empty());
    assert!(bench.host.deadline().is_none_or(|due| due > bench.now), "nothing is to be done");
    bench.input(Input::LinkRestored);
    assert!(matches!(bench.events()[..], [EventKind::QualityLow { mean }] if mean < 0.0));
    assert_eq!(bench.counter("alerts"), 1);
}
