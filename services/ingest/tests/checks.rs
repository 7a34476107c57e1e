//! Every check on what robots say, and that a refused message changes nothing.

use crate::bench::{
    self, Bench, Put, bare_pose, links, links_to, modality, pose, rank, relation, report, robot,
    token,
};
use muster_model::observation::{Links, Observation, Pose, Relation};
use muster_model::roster::Presence;
use muster_model::settings::IngestSettings;
use muster_service::Delivery;
use muster_service::inbox::Parcel;
use muster_wire::{KeySpace, Packet, Pattern, Rejection};
use serde_json::json;

fn settings() -> IngestSettings {
    IngestSettings {
        max_robots: 3,
        frames: vec!["map".to_owned(), "odom".to_owned()],
        modalities: vec![modality("thermal")],
        ..IngestSettings::default()
    }
}

/// Three robots with everything that robots can say.
fn three_robots() -> Bench {
    let mut bench = Bench::new(settings());
    for (name, x) in [("r1", 0.0), ("r2", 1.0), ("r3", 3.0)] {
        bench.receive(pose(name, x, 0.0));
    }
    bench.receive(links("r1", &[("r2", 0.75), ("r3", 0.25)]));
    bench.receive(rank("r2", Some("r1"), Some(2.0)));
    bench.receive(relation("r3", "thermal", &[("r1", 5.0)]));
    bench.wait(0.2);
    bench.happened();
    bench
}

/// The event that a message leads to.
fn refusal(bench: &mut Bench, message: Put) -> String {
    bench.happened();
    bench.receive(message);
    let happened = bench.happened();
    assert_eq!(happened.len(), 1, "{happened:?}");
    happened[0].clone()
}

fn ordered(boot: Option<&str>, seq: Option<u64>, stamp: Option<f64>) -> Put {
    let boot = boot.map(str::to_owned);
    report("r1", Pose { boot, seq, stamp, ..bare_pose(0.0, 0.0) })
}

/// Whether a message is let in.
fn passes(bench: &mut Bench, message: Put) -> bool {
    bench.wait(2.5);
    bench.happened();
    bench.receive(message);
    !bench.happened().iter().any(|happened| happened.starts_with("refused"))
}

#[test]
fn content_that_does_not_fit_is_refused_with_its_reason() {
    let in_frame = |frame: &str| Pose { frame: Some(frame.to_owned()), ..bare_pose(0.0, 0.0) };
    let foreign = Relation {
        edges: vec![(robot("r2"), robot("r3"), 1.0)],
        stamp: None,
        boot: None,
        seq: None,
    };
    let cases = [
        (report("r1", in_frame("mars")), "frame: \"mars\" is not known; there are map"),
        (pose("r1", f64::NAN, 0.0), "x: must be a finite number"),
        (links("r1", &[("r2", 1.5)]), "links.quality: must be a quality from 0 to 1"),
        (links("r1", &[("r1", 0.5)]), "links.peer: a robot does not report a link to itself"),
        (links("r1", &[("r2", 0.5), ("r2", 0.6)]), "named twice"),
        (rank("r1", Some("r1"), None), "superior: a robot is not its own superior"),
        (rank("r1", Some("r2"), Some(-1.0)), "weight: must be"),
        (relation("r1", "smell", &[("r2", 1.0)]), "smell is not declared"),
        (relation("r1", "thermal", &[("r1", 1.0)]), "no edge to itself"),
        (report("r1", (modality("thermal"), foreign)), "an edge for r2"),
        (pose("r4", 0.0, 0.0), "the fleet is full: max_robots is 3"),
        (token("r5", true), "the fleet is full: max_robots is 3"),
    ];
    for (message, reason) in cases {
        let mut bench = three_robots();
        let happened = refusal(&mut bench, message.clone());
        assert!(happened.contains(reason), "{message:?}: {happened}");
        assert!(happened.starts_with("refused r"), "{happened}");
        assert_eq!(bench.counter("messages_refused"), 1);
    }
    let mut bench = three_robots();
    bench.receive(report("r1", in_frame("odom")));
    assert!(bench.happened().is_empty());
}

#[test]
fn a_refused_packet_is_reported_as_it_is() {
    let mut bench = three_robots();
    let key = "muster/v1/alpha/robot/r1/pose";
    let rejection = Rejection::new(bench.space(), key, "x: no number");
    bench.receive_refused(rejection);
    assert_eq!(bench.happened(), ["refused r1: x: no number"]);
}

#[test]
fn the_unit_of_links_is_that_of_the_settings() {
    let mut bench = three_robots();
    bench.set(&json!({"connectivity": {"unit": "rssi_dbm"}}));
    bench.receive(links("r1", &[("r2", -65.0), ("r3", -95.0)]));
    bench.wait(0.2);
    assert_eq!(bench.weight("connectivity", "r2", "r1"), Some(0.5));
    assert_eq!(bench.weight("connectivity", "r3", "r1"), None);
}

#[test]
fn what_a_signal_is_worth_follows_the_settings_at_once() {
    let mut bench = three_robots();
    bench.set(&json!({"connectivity": {"unit": "rssi_dbm"}}));
    bench.receive(links("r1", &[("r2", -65.0), ("r3", -95.0)]));
    bench.set(&json!({"connectivity": {"rssi_floor_dbm": -100.0, "rssi_ceiling_dbm": -60.0}}));
    bench.wait(0.2);
    assert_eq!(bench.weight("connectivity", "r2", "r1"), Some(0.875));
    assert_eq!(
        bench.weight("connectivity", "r3", "r1"),
        Some(0.125),
        "it was worth nothing before"
    );
    // What was reported in one unit is not taken for the other.
    bench.receive(links("r2", &[("r1", -70.0)]));
    bench.set(&json!({"connectivity": {"unit": "quality"}}));
    bench.receive(links("r3", &[("r1", 0.5)]));
    bench.set(&json!({"connectivity": {"unit": "rssi_dbm"}}));
    bench.wait(0.2);
    assert_eq!(bench.weight("connectivity", "r1", "r2"), Some(0.75));
    assert_eq!(bench.weight("connectivity", "r1", "r3"), Some(0.5));
}

#[test]
fn within_a_boot_the_sequence_grows() {
    let mut bench = three_robots();
    assert!(passes(&mut bench, ordered(Some("a"), Some(5), None)));
    assert!(!passes(&mut bench, ordered(Some("a"), Some(5), None)));
    assert!(!passes(&mut bench, ordered(Some("a"), Some(4), Some(1e9))));
    assert!(passes(&mut bench, ordered(Some("a"), Some(900), None)));
    assert_eq!(bench.counter("messages_late"), 2);
    // Not even a long wait lets in what the robot itself says is old.
    bench.wait(5.0);
    bench.receive(token("r1", true));
    assert!(!passes(&mut bench, ordered(Some("a"), Some(900), None)));
}

#[test]
fn a_boot_that_was_left_does_not_come_back() {
    let mut bench = three_robots();
    assert!(passes(&mut bench, ordered(Some("a"), Some(100), None)));
    assert!(passes(&mut bench, ordered(Some("b"), Some(1), None)));
    let happened = refusal(&mut bench, ordered(Some("a"), Some(101), None));
    assert!(happened.contains("replayed or out of order"), "{happened}");
    // The last eight are remembered.
    for boot in 0..7 {
        assert!(passes(&mut bench, ordered(Some(&format!("c{boot}")), Some(1), None)));
    }
    assert!(!passes(&mut bench, ordered(Some("a"), Some(100), None)));
    assert!(passes(&mut bench, ordered(Some("c7"), Some(1), None)));
    assert!(passes(&mut bench, ordered(Some("a"), Some(100), None)));
    assert!(!passes(&mut bench, ordered(Some("c0"), Some(1), None)));
}

#[test]
fn streams_are_ordered_each_by_itself() {
    let mut bench = three_robots();
    assert!(passes(&mut bench, ordered(Some("a"), Some(7), None)));
    let links = Links { boot: Some("a".to_owned()), seq: Some(2), ..links_to(&[("r2", 0.5)]) };
    assert!(passes(&mut bench, report("r1", links)));
}

#[test]
fn without_a_sequence_the_stamp_does_not_go_back() {
    let mut bench = three_robots();
    let at = |seconds: f64| Some(bench::START.as_seconds() + seconds);
    assert!(passes(&mut bench, ordered(None, None, at(100.0))));
    assert!(passes(&mut bench, ordered(None, None, at(100.0))));
    assert!(!passes(&mut bench, ordered(None, None, at(99.0))));
    assert!(passes(&mut bench, ordered(None, None, at(101.0))));
    assert!(passes(&mut bench, ordered(None, None, None)));
    assert!(!passes(&mut bench, ordered(None, None, at(100.5))));
    // A new boot begins a new order.
    assert!(passes(&mut bench, ordered(Some("a"), None, at(1.0))));
}

#[test]
fn an_absurd_stamp_is_counted_and_says_nothing_of_the_order() {
    let mut bench = three_robots();
    let now_s = bench::START.as_seconds();
    bench.receive(ordered(None, None, Some(now_s)));
    bench.receive(ordered(None, None, Some(9e12)));
    bench.receive(ordered(None, None, Some(now_s)));
    bench.receive(ordered(None, None, Some(1.0)));
    assert!(bench.happened().is_empty());
    assert_eq!(bench.counter("stamps_absurd"), 2);
    bench.receive(ordered(None, None, Some(now_s - 1.0)));
    assert_eq!(bench.counter("messages_late"), 1, "the last sane one counts");
}

/// Says a message of r1 ten times a second until it is let in, and returns how long that took. The
/// robot is there all the while.
fn time_to_pass(bench: &mut Bench, message: impl Fn(u32) -> Put) -> f64 {
    let since = bench.now;
    for count in 0..100 {
        let accepted = bench.counter("poses_accepted");
        bench.receive(message(count));
        let happened = bench.happened();
        assert!(!happened.iter().any(|happened| happened.ends_with("r1")), "{happened:?}");
        if bench.counter("poses_accepted") > accepted {
            return bench.now.since(since).as_secs_f64();
        }
        bench.wait(0.1);
    }
    panic!("it is locked out");
}

#[test]
fn a_forged_boot_does_not_lock_the_robot_out() {
    let mut bench = Bench::default();
    for seq in 1..=50 {
        bench.receive(ordered(Some("own"), Some(seq), None));
        bench.wait(0.1);
    }
    bench.happened();
    bench.receive(ordered(Some("forged"), Some(7), None));
    bench.wait(0.1);
    let locked_s =
        time_to_pass(&mut bench, |count| ordered(Some("own"), Some(51 + u64::from(count)), None));
    assert!((1.8..=2.0).contains(&locked_s), "{locked_s}");
    // What was said before is still old, on both sides, however long nothing else is said.
    bench.wait(3.0);
    bench.happened();
    for (boot, seq) in [("own", 50), ("own", 30), ("forged", 7)] {
        let happened = refusal(&mut bench, ordered(Some(boot), Some(seq), None));
        assert!(happened.contains("replayed"), "{happened}");
        bench.wait(2.0);
    }
    let entry = bench.entry("r1").cloned();
    assert_eq!(entry.unwrap().presence, Presence::Stale, "no sign of life");
}

#[test]
fn a_robot_that_counts_from_the_start_without_a_boot_is_let_in_in_time() {
    let stamp = |n: u32| bench::START.as_seconds() + f64::from(n);
    for has_seq in [true, false] {
        let mut bench = Bench::default();
        let say = |n: u32| {
            let seq = has_seq.then_some(u64::from(n));
            ordered(None, seq, (!has_seq).then_some(stamp(n)))
        };
        bench.receive(say(500));
        bench.happened();
        bench.wait(1.5);
        let locked_s = time_to_pass(&mut bench, |count| say(1 + count));
        assert!((1.9..=2.0).contains(&locked_s), "{locked_s}");
        bench.receive(say(400));
        assert!(bench.happened().is_empty());
    }
}

#[test]
fn a_robot_whose_token_came_back_may_count_from_the_start_at_once() {
    let mut bench = Bench::default();
    bench.receive(token("r1", true));
    bench.receive(ordered(None, Some(500), None));
    bench.receive(token("r1", false));
    bench.receive(token("r1", true));
    bench.happened();
    bench.receive(ordered(None, Some(1), None));
    assert!(bench.happened().is_empty());
    bench.receive(ordered(None, Some(1), None));
    assert_eq!(bench.counter("messages_late"), 1, "once");
    bench.receive(ordered(Some("a"), Some(9), None));
    bench.receive(token("r1", false));
    bench.receive(token("r1", true));
    bench.receive(ordered(Some("a"), Some(9), None));
    assert_eq!(bench.counter("messages_late"), 2, "a replay all the same");
}

#[test]
fn a_stream_has_a_rate_and_a_burst() {
    let mut bench = Bench::new(IngestSettings { max_rate_hz: 10.0, ..IngestSettings::default() });
    let mut burst = |count: u32| {
        for _ in 0..count {
            bench.receive(pose("r1", 0.0, 0.0));
        }
        let accepted = bench.counter("poses_accepted");
        bench.wait(0.25);
        (accepted, bench.happened())
    };
    assert_eq!(burst(10).0, 10);
    let (accepted, happened) = burst(10);
    assert_eq!(accepted, 12, "0.25 s at 10 Hz are two and a half more");
    assert!(happened[0].contains("rate: at most 10 messages per second"), "{happened:?}");
    assert_eq!(burst(1).0, 13);
    // Refused messages take nothing from what the robot may say.
    for _ in 0..20 {
        bench.receive(pose("r1", f64::NAN, 0.0));
    }
    bench.wait(0.1);
    let before = bench.counter("poses_accepted");
    bench.receive(pose("r1", 0.0, 0.0));
    assert_eq!(bench.counter("poses_accepted"), before + 1);
    // Another stream and another robot have their own.
    bench.receive(links("r1", &[]));
    bench.receive(pose("r2", 0.0, 0.0));
    assert_eq!(bench.counter("links_accepted"), 1);
    assert_eq!(bench.counter("poses_accepted"), before + 2);
}

#[test]
fn lower_limits_evict_no_robot() {
    let mut bench = three_robots();
    bench.set(&json!({"max_robots": 1}));
    bench.receive(pose("r2", 1.0, 1.0));
    bench.wait(0.5);
    assert_eq!(bench.names(), ["r1", "r2", "r3"]);
    assert!(bench.happened().is_empty());
}

#[test]
fn refused_messages_change_nothing() {
    let run = |with_refused: bool| {
        let mut bench = three_robots();
        for round in 0..40_u32 {
            let at = f64::from(round);
            if with_refused {
                bench.receive(pose("r4", at, at));
                bench.receive(pose("r1", f64::INFINITY, at));
                bench.receive(links("r2", &[("r2", 0.5)]));
                bench.receive(links("r2", &[("r3", 7.0)]));
                bench.receive(rank("r3", Some("r3"), None));
                bench.receive(relation("r1", "smell", &[("r2", 1.0)]));
                bench.receive(ordered(Some("a"), Some(0), None));
                bench.receive(token("r9", true));
                bench.receive(token("r9", false));
            }
            let mut moved = bare_pose(at, 0.0);
            moved.boot = Some("a".to_owned());
            moved.seq = Some(u64::from(round) * 2);
            assert!(moved.check().is_ok());
            bench.receive(report("r1", moved));
            if with_refused {
                bench.receive(ordered(Some("a"), Some(u64::from(round) * 2), None));
            }
            bench.wait(0.07);
        }
        bench.wait(20.0);
        if with_refused {
            assert!(bench.counter("messages_refused") > 300);
        }
        bench.published
    };
    assert_eq!(run(true), run(false));
}

/// Lets two programs put by turns, and returns the reasons of what was refused.
fn by_turns(puts: impl Fn(u32) -> [Put; 2]) -> Vec<String> {
    let mut bench = Bench::default();
    for count in 0..40 {
        for put in puts(count) {
            bench.receive(put);
            bench.wait(0.05);
        }
    }
    bench.refused.iter().map(|refused| refused.reason.clone()).collect()
}

#[test]
fn two_programs_that_put_as_one_robot_are_called_that() {
    let stamp = |count: u32, behind: f64| {
        Some(bench::START.as_seconds() + f64::from(count) / 10.0 - behind)
    };
    let boots = |count: u32| {
        let put = |boot| ordered(Some(boot), Some(u64::from(count)), None);
        [put("a"), put("b")]
    };
    let cloned_boot = |count: u32| {
        let put = |ahead: u32| ordered(Some("a"), Some(u64::from(count + ahead)), None);
        [put(500), put(0)]
    };
    let without_boots = |count: u32| {
        let put = |ahead: u32| ordered(None, Some(u64::from(count + ahead)), None);
        [put(500), put(0)]
    };
    let stamps = |count: u32| [0.0, 60.0].map(|behind| ordered(None, None, stamp(count, behind)));
    let all: [&dyn Fn(u32) -> [Put; 2]; 4] = [&boots, &cloned_boot, &without_boots, &stamps];
    for (number, puts) in all.into_iter().enumerate() {
        let reasons = by_turns(puts);
        let last = reasons.last().unwrap();
        assert!(
            last.starts_with("two programs put as r1: give each robot"),
            "{number}: {reasons:?}"
        );
    }
}

#[test]
fn a_single_late_message_is_no_second_program() {
    let mut bench = Bench::default();
    for count in 0..200_u64 {
        bench.receive(ordered(Some("a"), Some(count), None));
        bench.wait(0.1);
        if count % 150 == 50 {
            bench.receive(ordered(Some("a"), Some(count - 20), None));
        }
    }
    let reasons: Vec<_> = bench.refused.iter().map(|refused| refused.reason.as_str()).collect();
    assert_eq!(reasons, ["replayed or out of order: seq goes back"]);
}

#[test]
fn a_robot_learns_why_its_messages_are_refused() {
    let mut bench = three_robots();
    let space = KeySpace::new(bench::fleet());
    let misspelt = Packet::put("muster/v1/alpha/robot/r9/poze", "application/json", b"{}".to_vec());
    let pattern = Pattern::UnknownStreams;
    let parcel = Parcel::new(&space, misspelt.clone(), &pattern, Delivery::Latest);
    assert!(parcel.is_some(), "the subscription of ingest covers it");
    bench.receive(misspelt);
    let frame = Pose { frame: Some("mars".to_owned()), ..bare_pose(0.0, 0.0) };
    for _ in 0..100 {
        bench.receive(report("r1", frame.clone()));
    }
    bench.wait(2.0);
    bench.receive(report("r1", frame));
    let learned: Vec<_> = bench
        .refused
        .iter()
        .map(|refused| (refused.robot.as_str(), refused.key.as_str(), refused.count))
        .collect();
    let key = "muster/v1/alpha/robot/r1/pose";
    let misspelt = ("r9", "muster/v1/alpha/robot/r9/poze", 1);
    assert_eq!(learned, [misspelt, ("r1", key, 1), ("r1", key, 100)]);
    assert!(bench.refused[0].reason.contains("\"poze\" is unknown"), "{:?}", bench.refused[0]);
    assert!(bench.refused[0].reason.contains("relation/{modality}"));
    assert!(bench.refused[1].reason.contains("there are map, odom"), "{:?}", bench.refused[1]);
    let is_named = |happened: &String| happened.starts_with("refused") && happened.contains("poze");
    assert!(bench.happened().iter().any(is_named), "operators see it as well");
}

#[test]
fn a_long_reason_is_whole() {
    let frames: Vec<String> = (0..12).map(|number| format!("frame-of-building-{number}")).collect();
    let mut bench = Bench::new(IngestSettings { frames, ..IngestSettings::default() });
    let frame = Pose { frame: Some("mars".to_owned()), ..bare_pose(0.0, 0.0) };
    let happened = refusal(&mut bench, report("r1", frame));
    assert!(happened.ends_with("frame-of-building-11"), "{happened}");
    assert_eq!(bench.refused[0].reason.split(", ").count(), 12);
}
