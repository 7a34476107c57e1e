//! Which robots are there, and by which of their topics.

use muster_model::observation::Report;
use muster_ros::{Gid, Value};
use muster_ros2::core::{Input, Output};
use muster_wire::Packet;

use super::world::{GID, World, near};

/// Ticks each second.
fn idle(world: &mut World, seconds: u32) -> Vec<(String, Report)> {
    let mut reports = Vec::new();
    for _ in 0..seconds {
        world.pass(1.0);
        reports.extend(world.tick().0);
    }
    reports
}

fn ranks(reports: &[(String, Report)]) -> usize {
    reports.iter().filter(|(_, report)| matches!(report, Report::Rank(_))).count()
}

/// Robots that name their superiors.
const SUPERIORS: &str = r#"
    [[rank]]
    topic = "/{robot}/superior"
    type = "std_msgs/String"
    superior = "data"
"#;

#[test]
fn numbers_of_the_bridge_never_begin_again() {
    let mut world = World::new(
        r#"
        dialect = "ros2dds"
        [[pose]]
        topic = "/{robot}/odom"
        type = "nav_msgs/Odometry"
        [[pose]]
        topic = "/{robot}/other"
        type = "nav_msgs/Odometry"
        "#,
    );
    let message = world.odometry("map", 1.0, 2.0);
    let mut last = 0;
    for topic in ["r1/odom", "r1/odom", "r1/other", "r1/odom"] {
        let packet = Packet::put(topic, "", message.encode().unwrap());
        let source = world.source(topic);
        assert_eq!(world.bridge.handle(world.now, Input::Sample(source, packet)), []);
        let seq = world.pose().seq.unwrap();
        assert!(seq > last, "{topic}: {seq} follows {last}");
        last = seq;
        idle(&mut world, 75);
        assert!(world.bridge.robots().is_empty(), "the topic is forgotten");
    }
}

#[test]
fn static_frames_go_with_their_robot() {
    let mut world = World::new("");
    world.localise("r1/tf_static", "map", "odom");
    let message = world.odometry("odom", 1.0, 2.0);
    world.put("r1/odom", &message);
    near(&world.pose(), 8.0, 1.0, Some(std::f64::consts::FRAC_PI_2));
    idle(&mut world, 75);
    world.put("r1/odom", &message);
    assert_eq!(world.tick().0, [], "the robot that is there now has said nothing of its frames");
}

#[test]
fn only_robots_that_report_have_a_rank_of_the_file() {
    let mut world = World::new("ranks = { r1 = \"\" }");
    let message = world.odometry("nowhere", 1.0, 2.0);
    for _ in 0..25 {
        world.localise("r1/tf", "map", "odom");
        world.put("r1/odom", &message);
        assert_eq!(idle(&mut world, 1), [], "transforms and refused poses are no robot");
    }
    let message = world.odometry("map", 1.0, 2.0);
    world.put("r1/odom", &message);
    let reports = idle(&mut world, 9);
    world.put("r1/odom", &message);
    let reports = [reports, idle(&mut world, 9)].concat();
    assert!(ranks(&reports) > 0, "{reports:?}");
    idle(&mut world, 10);
    assert_eq!(ranks(&idle(&mut world, 30)), 0, "it reports nothing any more");
}

#[test]
fn one_source_of_a_robot_is_read_and_the_next_when_it_is_silent() {
    let mut world = World::new(
        r#"
        [[pose]]
        topic = "/{robot}/odom"
        type = "nav_msgs/Odometry"
        [[pose]]
        topic = "/{robot}/amcl"
        type = "nav_msgs/Odometry"
        "#,
    );
    let (first, second) = (world.odometry("map", 1.0, 0.0), world.odometry("map", 2.0, 0.0));
    for _ in 0..20 {
        world.put("r1/amcl", &second);
        world.put("r1/odom", &first);
        near(&world.pose(), 1.0, 0.0, Some(0.0));
        world.pass(0.5);
        world.put("r1/amcl", &second);
        assert_eq!(world.tick().0, [], "the other one waits");
        world.pass(0.5);
    }
    world.pass(5.0);
    world.put("r1/amcl", &second);
    near(&world.pose(), 2.0, 0.0, Some(0.0));
    world.put("r2/amcl", &second);
    near(&world.pose(), 2.0, 0.0, Some(0.0));
    world.put("r1/odom", &first);
    near(&world.pose(), 1.0, 0.0, Some(0.0));
}

#[test]
fn a_superior_that_a_robot_names_wins_over_that_of_the_file() {
    let mut world = World::new(
        r#"
        [[rank]]
        topic = "/{robot}/superior"
        type = "std_msgs/String"
        superior = "data"
        [ranks]
        r2 = "r9"
        "#,
    );
    let mut superior = world.message("std_msgs/String");
    superior.set("data", "r1").unwrap();
    let mut reports = Vec::new();
    for _ in 0..25 {
        world.put("r2/superior", &superior);
        reports.extend(idle(&mut world, 1));
    }
    assert_eq!(reports.len(), 25);
    for (_, report) in reports {
        let Report::Rank(rank) = report else { panic!("{report:?}") };
        assert_eq!(rank.superior.unwrap().as_str(), "r1");
    }
}

#[test]
fn a_robot_is_of_one_domain() {
    let mut world = World::new("domains = [0, 7]");
    world.localise("r1/tf", "map", "odom");
    let message = world.odometry("odom", 1.0, 2.0);
    world.put("r1/odom", &message);
    near(&world.pose(), 8.0, 1.0, Some(std::f64::consts::FRAC_PI_2));
    for topic in ["r1/tf", "r1/odom"] {
        let message = if topic == "r1/odom" {
            message.clone()
        } else {
            world.transform("map", "odom", 0.0, turn(1.0))
        };
        let key = World::key(&message, topic).replacen('0', "7", 1);
        let packet = world.packet(key, &message);
        let source = world.source(topic);
        let outputs = world.bridge.handle(world.now, Input::Sample(source, packet));
        let [Output::Refused(refusal)] = &outputs[..] else { panic!("{outputs:?}") };
        assert!(refusal.reason.contains("domain 0"), "{}", refusal.reason);
    }
    world.put("r1/odom", &message);
    near(&world.pose(), 8.0, 1.0, Some(std::f64::consts::FRAC_PI_2));
}

#[test]
fn trees_that_robots_share_are_those_of_their_domain() {
    let topics = "domains = [0, 7]\nframes = { tf = \"/tf\", tf_static = \"/tf_static\" }";
    let mut world = World::new(topics);
    world.localise("tf", "map", "r1/odom");
    let message = world.transform("map", "r1/odom", 0.0, turn(1.0));
    let key = World::key(&message, "tf").replacen('0', "7", 1);
    let packet = world.packet(key, &message);
    let source = world.source("tf");
    assert_eq!(world.bridge.handle(world.now, Input::Sample(source, packet)), []);
    let message = world.odometry("odom", 1.0, 2.0);
    world.put("r1/odom", &message);
    near(&world.pose(), 8.0, 1.0, Some(std::f64::consts::FRAC_PI_2));
}

/// A rotation about the vertical by no angle, with a length.
fn turn(w: f64) -> Value {
    Value::Struct([0.0, 0.0, 0.0, w].map(Value::from).to_vec())
}

#[test]
fn the_number_of_a_publisher_is_not_negative() {
    let mut world = World::new("");
    let message = world.odometry("map", 1.0, 2.0);
    for sequence in [-1, -5] {
        world.pass(11.0);
        world.sequence = sequence - 1;
        let outputs = world.put("r1/odom", &message);
        let [Output::Refused(refusal)] = &outputs[..] else { panic!("{outputs:?}") };
        assert!(refusal.reason.contains("number"), "{}", refusal.reason);
        assert_eq!(world.tick().0, []);
    }
}

/// The number of a message of ROS: seconds and nanoseconds.
fn stamp(seconds: i32) -> Value {
    Value::Struct(vec![Value::from(seconds), Value::from(0_u32)])
}

#[test]
fn wrong_clocks_change_no_order() {
    let mut world = World::new("");
    // Each message is newer than the one before, and its clock says that it is older: from the future to the past.
    for (round, seconds) in
        [2_000_000_000, 1_000_000_000, 0, -1_000_000_000].into_iter().enumerate()
    {
        let x = round as f64;
        world.stamp_ns = i64::from(seconds) * 1_000_000_000;
        let mut tf = world.transform("map", "odom", 10.0 * x, turn(1.0));
        tf.set("transforms[0].header.stamp", stamp(seconds)).unwrap();
        world.put("r1/tf", &tf);
        let mut odometry = world.odometry("odom", x, 0.0);
        odometry.set("header.stamp", stamp(seconds)).unwrap();
        world.put("r1/odom", &odometry);
        near(&world.pose(), 11.0 * x, 0.0, Some(0.0));
        world.pass(0.1);
    }
    // What comes late is the older one, whatever its clock says.
    let newest = world.sequence;
    world.stamp_ns = i64::MAX;
    let late = world.transform("map", "odom", 500.0, turn(1.0));
    world.sequence = 0;
    world.put("r1/tf", &late);
    let late = world.odometry("odom", 500.0, 0.0);
    world.sequence = 0;
    world.put("r1/odom", &late);
    assert_eq!(world.tick().0, [], "the odometry is older than that before");
    world.sequence = newest;
    let odometry = world.odometry("odom", 3.0, 0.0);
    world.put("r1/odom", &odometry);
    near(&world.pose(), 33.0, 0.0, Some(0.0));
}

#[test]
fn of_two_publishers_that_alternate_the_one_that_came_last_counts_and_this_is_said_once() {
    let mut world = World::new("");
    let (first, second) = (GID, Gid([9; 16]));
    let (own, other) = (world.odometry("map", 1.0, 0.0), world.odometry("map", 2.0, 0.0));
    world.put("r1/odom", &own);
    near(&world.pose(), 1.0, 0.0, Some(0.0));
    // A robot that starts again has another publisher, which is believed at once.
    world.gid = second;
    world.put("r1/odom", &other);
    near(&world.pose(), 2.0, 0.0, Some(0.0));
    let mut said = Vec::new();
    for _ in 0..20 {
        world.pass(0.1);
        world.gid = first;
        said.extend(world.put("r1/odom", &own));
        world.gid = second;
        said.extend(world.put("r1/odom", &other));
        let pose = world.pose();
        near(&pose, 2.0, 0.0, Some(0.0));
        assert_eq!(pose.boot, Some(second.to_string()));
    }
    let [Output::Refused(refusal)] = &said[..] else { panic!("{said:?}") };
    assert!(refusal.reason.contains("two programs publish this topic"), "{}", refusal.reason);
    // The one that is left is believed once the other has been silent for a while.
    world.gid = first;
    for _ in 0..40 {
        world.pass(0.1);
        world.put("r1/odom", &own);
    }
    near(&world.pose(), 1.0, 0.0, Some(0.0));
}

#[test]
fn a_publisher_whose_numbers_do_not_grow_is_refused() {
    let mut world = World::new("");
    let message = world.odometry("map", 1.0, 0.0);
    let mut said = Vec::new();
    for _ in 0..30 {
        world.sequence = 0;
        said.extend(world.put("r1/odom", &message));
        world.pass(0.1);
    }
    let [Output::Refused(refusal)] = &said[..] else { panic!("{said:?}") };
    assert!(refusal.reason.contains("do not grow"), "{}", refusal.reason);
}

#[test]
fn what_a_publisher_keeps_is_reported_once_however_often_it_is_asked_for() {
    let mut world = World::new(SUPERIORS);
    let mut superior = world.message("std_msgs/String");
    superior.set("data", "r1").unwrap();
    let mut reports = 0;
    for _ in 0..5 {
        world.sequence = 0;
        world.put("r2/superior", &superior);
        reports += ranks(&idle(&mut world, 10));
    }
    assert_eq!(reports, 1);
    assert_eq!(world.bridge.robots().len(), 1, "its publisher is there");
}

#[test]
fn what_a_robot_said_once_is_put_again_while_it_reports_where_it_is() {
    let mut world = World::new(SUPERIORS);
    let mut superior = world.message("std_msgs/String");
    superior.set("data", "r1").unwrap();
    world.put("r2/superior", &superior);
    let pose = world.odometry("map", 1.0, 2.0);
    let mut put = Vec::new();
    for second in 0..30 {
        // From here on its localisation says nothing: it is not made present by what it said long ago.
        if second < 11 {
            world.put("r2/odom", &pose);
        }
        let reports = idle(&mut world, 1).into_iter().map(|(_, report)| report);
        put.extend(reports.filter(|report| matches!(report, Report::Rank(_))));
    }
    assert_eq!(
        put.len(),
        1 + 10,
        "at once, and every two seconds until ten after its last pose: {put:?}"
    );
    let mut last = 0;
    for report in put {
        let Report::Rank(rank) = &report else { panic!("{report:?}") };
        assert_eq!(rank.superior.as_ref().unwrap().as_str(), "r1");
        // A service refuses what does not follow.
        assert_eq!(rank.boot.as_deref(), Some("host-1"));
        assert!(rank.seq > Some(last), "{report:?}");
        last = rank.seq.unwrap();
    }
    superior.set("data", "r3").unwrap();
    world.put("r2/superior", &superior);
    world.put("r2/odom", &pose);
    let reports = idle(&mut world, 4);
    let names = reports.iter().filter_map(|(_, report)| match report {
        Report::Rank(rank) => rank.superior.as_ref().map(ToString::to_string),
        _ => None,
    });
    assert_eq!(names.collect::<Vec<_>>(), ["r3", "r3"], "what it said before is forgotten");
}

/// The superiors among reports.
fn superiors(reports: &[(String, Report)]) -> Vec<&str> {
    let names = reports.iter().filter_map(|(_, report)| match report {
        Report::Rank(rank) => rank.superior.as_ref(),
        _ => None,
    });
    names.map(|superior| superior.as_str()).collect()
}

#[test]
fn what_a_robot_said_once_holds_for_as_long_as_its_poses_come() {
    let mut world = World::new(SUPERIORS);
    let mut superior = world.message("std_msgs/String");
    superior.set("data", "r1").unwrap();
    world.put("r2/superior", &superior);
    let pose = world.odometry("map", 1.0, 2.0);
    let mut reports = Vec::new();
    for _ in 0..200 {
        world.put("r2/odom", &pose);
        reports = idle(&mut world, 1).into_iter().chain(reports).take(20).collect();
    }
    assert!(superiors(&reports).len() >= 6, "still every two seconds: {reports:?}");
    idle(&mut world, 75);
    let used = world.bridge.memory_use();
    assert_eq!((used.robots, used.topics), (0, 0), "it is gone");
}

#[test]
fn what_a_publisher_keeps_is_not_late_however_much_it_is() {
    let mut world = World::new(SUPERIORS);
    let mut superior = world.message("std_msgs/String");
    superior.set("data", "r1").unwrap();
    for _ in 0..10 {
        world.put("r2/superior", &superior);
    }
    idle(&mut world, 10);
    for _ in 0..5 {
        let newest = world.sequence;
        world.sequence = newest - 10;
        for _ in 0..10 {
            assert_eq!(world.answer("r2/superior", &superior), []);
        }
        assert_eq!(ranks(&idle(&mut world, 10)), 0, "nothing of it is new");
        assert_eq!(world.put("r2/superior", &superior), []);
        assert_eq!(ranks(&idle(&mut world, 1)), 1, "the publisher goes on");
    }
    // What was lost is found among what is kept.
    world.sequence += 1;
    superior.set("data", "r3").unwrap();
    assert_eq!(world.answer("r2/superior", &superior), []);
    assert_eq!(superiors(&idle(&mut world, 1)), ["r3"]);
    // Answers make up for no put that has the number of the one before.
    let newest = world.sequence;
    let mut said = Vec::new();
    for _ in 0..20 {
        world.sequence = newest - 1;
        said.extend(world.put("r2/superior", &superior));
        world.sequence = newest - 1;
        said.extend(world.answer("r2/superior", &superior));
    }
    let [Output::Refused(refusal)] = &said[..] else { panic!("{said:?}") };
    assert!(refusal.reason.contains("do not grow"), "{}", refusal.reason);
}

#[test]
fn what_a_publisher_keeps_takes_the_place_of_no_other_that_is_there() {
    let mut world = World::new(SUPERIORS);
    let mut superior = world.message("std_msgs/String");
    let mut send = |world: &mut World, publisher: u8, is_kept: bool| {
        superior.set("data", format!("of-{publisher}")).unwrap();
        world.gid = Gid([publisher; 16]);
        world.sequence = i64::from(publisher);
        let topic = "r2/superior";
        let outputs =
            if is_kept { world.answer(topic, &superior) } else { world.put(topic, &superior) };
        assert_eq!(outputs, []);
        let (reports, _) = world.tick();
        superiors(&reports).join(" ")
    };
    assert_eq!(send(&mut world, 1, true), "of-1", "there is no other");
    for _ in 0..10 {
        for publisher in [2, 1] {
            assert_eq!(send(&mut world, publisher, true), "", "the first one is there");
        }
        world.pass(10.0);
    }
    world.pass(100.0);
    assert_eq!(send(&mut world, 2, true), "", "the bridge had no link, and the first is not gone");
    assert_eq!(send(&mut world, 1, true), "");
    assert_eq!(send(&mut world, 2, false), "of-2", "it appeared last");
    for _ in 0..10 {
        world.pass(10.0);
        assert_eq!(send(&mut world, 1, true), "", "what it said was replaced");
    }
    assert_eq!(
        send(&mut world, 3, true),
        "of-3",
        "the second is gone, and what this one put was lost"
    );
    world.pass(100.0);
    assert_eq!(send(&mut world, 2, true), "", "what it said was replaced");
}

/// A message with all that a robot reports, on one topic.
const ALL_IN_ONE: &str = r#"
    [[pose]]
    topic = "/{robot}/state"
    type = "own_msgs/State"
    definition = """
    float64 x
    float64 y
    string superior
    Link[] links
    ================================================================================
    MSG: own_msgs/Link
    string peer
    float32 quality
    """
    fields = { x = "x", y = "y" }
    frame = "map"
    [[links]]
    topic = "/{robot}/state"
    type = "own_msgs/State"
    list = "links"
    peer = "peer"
    quality = "quality"
    [[rank]]
    topic = "/{robot}/state"
    type = "own_msgs/State"
    superior = "superior"
"#;

#[test]
fn several_sources_read_one_topic() {
    let mut world = World::new(ALL_IN_ONE);
    let mut state = world.message("own_msgs/State");
    state.set("superior", "r2").unwrap();
    let link = Value::Struct(vec![Value::from("r2"), Value::from(0.5_f32)]);
    state.set("links", Value::List(vec![link])).unwrap();
    for round in 0..3 {
        state.set("x", f64::from(round)).unwrap();
        assert_eq!(world.put_to_all("r1/state", &state), []);
        let (reports, reasons) = world.tick();
        let [(_, Report::Pose(pose)), (_, Report::Links(links)), (_, Report::Rank(rank))] =
            &reports[..]
        else {
            panic!("{reports:?} {reasons:?}")
        };
        near(pose, f64::from(round), 0.0, None);
        assert_eq!((links.links.len(), rank.superior.as_ref().unwrap().as_str()), (1, "r2"));
        world.pass(0.1);
    }
}

#[test]
fn a_topic_is_shown_as_read_while_any_source_reads_it() {
    let mut world = World::new(ALL_IN_ONE);
    let state = world.message("own_msgs/State");
    world.put_to_all("r1/state", &state);
    // What is kept is asked for where it holds, and comes to no source of poses.
    let key = World::key(&state, "r1/state");
    let packet = world.packet(key, &state);
    let is_rank = |source: &muster_ros2::config::Source| {
        matches!(source.content, muster_ros2::config::Content::Rank { .. })
    };
    let rank = world.setup.sources.iter().position(is_rank).unwrap();
    let (mut declared, mut withdrawn) = (0, Vec::new());
    for second in 0..200 {
        if second < 100 {
            let _ = world.bridge.handle(world.now, Input::Kept(rank, packet.clone()));
        }
        for output in world.bridge.handle(world.now, Input::Tick) {
            match output {
                Output::Declare(token) if token.contains("%r1%state") => declared += 1,
                Output::Withdraw(token) if token.contains("%r1%state") => withdrawn.push(second),
                _ => {}
            }
        }
        world.pass(1.0);
    }
    assert_eq!(declared, 1);
    assert!(matches!(withdrawn[..], [150..=180]), "{withdrawn:?}");
}
