//! The measurement of latency is right, on a fleet that is small enough for any machine.

use std::time::Duration;

use muster_tests::latency::report;
use muster_tests::latency::run_plan::{self, RunPlan};

#[tokio::test(flavor = "multi_thread")]
async fn every_pose_is_followed_to_a_division() {
    let plan = RunPlan {
        robots: 12,
        teams: 2,
        rate_hz: 10.0,
        settles: Duration::from_secs(1),
        lasts: Duration::from_secs(4),
        settings: vec![("ingest".to_owned(), "tick_hz=20".to_owned())],
        busy: 0,
        pins: 4,
    };
    let measured = run_plan::run(&plan, |_| {}).await.unwrap();
    // Other tests run at the same time: bounds on time are generous.
    assert!((200..=540).contains(&measured.poses), "{} poses in 4 s", measured.poses);
    let ways = &measured.ways;
    assert_eq!(ways.whole.len() + ways.missing, measured.poses);
    assert_eq!(ways.beyond.len() + ways.superseded, ways.whole.len());
    assert_eq!((ways.missing, measured.lost_on_the_way.max(0)), (0, 0));
    assert!(measured.dropped.is_empty(), "{:?}", measured.dropped);
    assert!(ways.whole.iter().chain(&ways.beyond).all(|ms| (0.0..5_000.0).contains(ms)));
    assert!(ways.held.iter().all(|ms| *ms >= 0.0));
    assert!(measured.divisions.iter().all(|division| division.robots == 12));
    assert!((1.0..4_500.0).contains(&measured.longest_pause()), "{}", measured.longest_pause());
    assert!(measured.ages().iter().all(|(_, age)| *age > 0.0));
    assert!(measured.round_trip.iter().all(|trip| trip.p50 > 0.0 && trip.p50 <= trip.p99));
    let names: Vec<_> = measured.taken.iter().map(|taken| taken.name).collect();
    let all = ["router", "robots", "ingest", "embedder", "clusterer", "auditor", "listener"];
    assert_eq!(names, all);
    assert!(measured.taken.iter().all(|taken| taken.memory > 1.0 && taken.processors >= 0.0));

    let page =
        report::page(std::slice::from_ref(&measured), &[], "test", Some("plot.svg")).unwrap();
    assert!(!page.contains("NaN") || measured.changes.is_empty(), "{page}");
    assert!(page.contains("nothing lost but superseded poses"), "{page}");
    assert!(report::plot(&[measured]).ends_with("</svg>\n"));
}
