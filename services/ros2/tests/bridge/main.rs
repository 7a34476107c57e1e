//! The core of the bridge: what comes of samples of ROS, and what ROS is shown.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod limits;
mod robots;
mod shown;
mod world;

use muster_model::bridge::TopicFault;
use muster_model::id::RobotId;
use muster_model::observation::{Links, Rank, Report};
use muster_ros::{Attachment, Catalog, Token, TypeName, Value};
use muster_ros2::core::{Input, Output};
use muster_wire::{Packet, Source};

use self::world::{GID, World, near};

#[test]
fn the_newest_pose_is_moved_into_the_world_with_the_number_of_its_publisher() {
    let mut world = World::new("");
    world.localise("r1/tf", "map", "odom");
    let message = world.odometry("odom", 1.0, 2.0);
    world.put("r1/odom", &message);
    let message = world.odometry("odom", 3.0, 1.0);
    world.put("r1/odom", &message);
    let pose = world.pose();
    // Turned by a quarter and moved by ten.
    near(&pose, 9.0, 3.0, Some(std::f64::consts::FRAC_PI_2));
    assert_eq!((pose.boot.as_deref(), pose.seq), (Some(GID.to_string().as_str()), Some(3)));
    assert_eq!(pose.stamp, None, "the clocks of robots change no order");
    assert_eq!(world.tick(), (Vec::new(), Vec::new()), "each sample is put once");
}

#[test]
fn a_pose_without_a_way_to_the_world_is_refused_and_never_taken_as_it_is() {
    let mut world = World::new("");
    let message = world.odometry("odom", 1.0, 2.0);
    world.put("r1/odom", &message);
    assert_eq!(world.tick(), (Vec::new(), Vec::new()), "a robot that starts has a moment");
    world.pass(3.0);
    world.put("r1/odom", &message);
    assert!(world.reason().starts_with("no transforms lead from the frame odom to map"));
    // Those of another robot lead nowhere.
    world.localise("r2/tf", "map", "odom");
    world.pass(11.0);
    world.put("r1/odom", &message);
    assert!(world.reason().starts_with("no transforms lead"));
    world.localise("r1/tf", "map", "odom");
    world.pass(2.0);
    world.put("r1/odom", &message);
    let (reports, _) = world.tick();
    assert_eq!(reports, [], "the transform is too old");
    world.localise("r1/tf_static", "map", "odom");
    world.pass(20.0);
    world.put("r1/odom", &message);
    near(&world.pose(), 8.0, 1.0, Some(std::f64::consts::FRAC_PI_2));
    // In the world itself nothing is needed.
    let message = world.odometry("/map", 5.0, 6.0);
    world.put("r3/odom", &message);
    near(&world.pose(), 5.0, 6.0, Some(0.0));
}

#[test]
fn unknown_hashes_and_missing_numbers_are_refused_and_humble_is_not() {
    let mut world = World::new("");
    let message = world.odometry("map", 1.0, 2.0);
    let key = World::key(&message, "r1/odom");
    let source = world.source("r1/odom");
    let send = |world: &mut World, key: String, attachment: bool| {
        let mut packet = world.packet(key, &message);
        packet.attachment = packet.attachment.filter(|_| attachment);
        let outputs = world.bridge.handle(world.now, Input::Sample(source, packet));
        match &outputs[..] {
            [] => String::new(),
            [Output::Refused(refusal)] => refusal.reason.clone(),
            other => panic!("{other:?}"),
        }
    };
    let other = key.replace("RIHS01_", "RIHS01_00")[..key.len()].to_owned();
    assert!(send(&mut world, other, true).contains("another definition of nav_msgs/msg/Odometry"));
    assert!(send(&mut world, key.replace("r1", "r2"), false).contains("has no attachment"));
    let humble = key.rsplit_once('/').unwrap().0.to_owned() + "/TypeHashNotSupported";
    assert_eq!(send(&mut world, humble, true), "");
    near(&world.pose(), 1.0, 2.0, Some(0.0));
    assert_eq!(world.bridge.counts().refused, 2);
}

#[test]
fn what_is_no_message_or_no_robot_is_refused() {
    let mut world = World::new("");
    let message = world.odometry("map", 1.0, 2.0);
    let key = World::key(&message, "r1/odom");
    let mut packet = world.packet(key.clone(), &message);
    packet.payload = packet.payload.map(|bytes| bytes[..bytes.len() - 1].to_vec());
    assert_eq!(world.bridge.handle(world.now, Input::Sample(2, packet)), []);
    assert!(world.reason().contains("the bytes end before the message does"));
    let large = Packet { payload: Err(1 << 20), ..world.packet(key.clone(), &message) };
    world.pass(20.0);
    let outputs = world.bridge.handle(world.now, Input::Sample(2, large));
    assert!(matches!(&outputs[..], [Output::Refused(one)] if one.reason.contains("too many")));
    let gone = Packet { source: Source::Delete, ..world.packet(key, &message) };
    assert_eq!(world.bridge.handle(world.now, Input::Sample(2, gone)), []);
    // Capitals become small, and two robots do not become one.
    world.put("Bot/odom", &message);
    assert_eq!(world.tick().0[0].0, "bot");
    let outputs = world.put("bot/odom", &message);
    assert!(matches!(&outputs[..], [Output::Refused(one)] if one.reason.contains("rename one")));
    // A NaN is no coordinate.
    let message = world.odometry("map", f64::NAN, 2.0);
    world.put("r4/odom", &message);
    assert!(world.reason().contains("no finite number"));
}

#[test]
fn the_same_reason_is_said_once_in_a_while() {
    let mut world = World::new("");
    let message = world.odometry("odom", 1.0, 2.0);
    let mut said = 0;
    for _ in 0..200 {
        world.put("r1/odom", &message);
        said += world.tick().1.len();
        world.pass(0.1);
    }
    assert_eq!(said, 2, "in 20 seconds");
}

#[test]
fn robots_share_a_tree_with_their_names_before_the_frames() {
    let mut world = World::new("frames = { tf = \"/tf\", tf_static = \"/tf_static\" }");
    world.localise("tf", "map", "r1/odom");
    for frame in ["r1/odom", "odom"] {
        let message = world.odometry(frame, 1.0, 2.0);
        world.put("r1/odom", &message);
        near(&world.pose(), 8.0, 1.0, Some(std::f64::consts::FRAC_PI_2));
    }
    // The frame of another robot, which has no transforms, is not taken for it.
    let message = world.odometry("odom", 1.0, 2.0);
    world.put("r2/odom", &message);
    assert_eq!(world.reason(), "");
    world.pass(3.0);
    world.put("r2/odom", &message);
    assert!(world.reason().contains("from the frame r2/odom to map"));
}

#[test]
fn px4_fixes_links_and_ranks_are_read() {
    let mut world = World::new(
        r#"
        [[pose]]
        topic = "/{robot}/local"
        type = "px4_msgs/msg/VehicleLocalPosition"
        definition = "uint64 timestamp\nfloat32 x\nfloat32 y\nfloat32 z\nfloat32 heading"
        fields = { x = "x", y = "y", z = "z", heading = "heading" }
        axes = "north_east_down"
        frame = "map"
        [[pose]]
        topic = "/{robot}/fix"
        type = "sensor_msgs/NavSatFix"
        datum = { latitude = 48.0, longitude = 11.0, altitude = 500.0 }
        [[links]]
        topic = "/{robot}/neighbours"
        type = "own_msgs/Links"
        definition = """
        Link[] links
        ================================================================================
        MSG: own_msgs/Link
        string peer
        float32 rssi
        """
        list = "links"
        peer = "peer"
        quality = "rssi"
        unit = "dbm"
        [[rank]]
        topic = "/{robot}/superior"
        type = "std_msgs/String"
        superior = "data"
        [ranks]
        r2 = "r1"
        r9 = ""
        "#,
    );
    let mut px4 = world.message("px4_msgs/VehicleLocalPosition");
    px4.set("x", 1.0_f32).unwrap();
    px4.set("y", 2.0_f32).unwrap();
    px4.set("z", -3.0_f32).unwrap();
    world.put("r1/local", &px4);
    let pose = world.pose();
    near(&pose, 2.0, 1.0, Some(std::f64::consts::FRAC_PI_2));
    assert_eq!(pose.z, Some(3.0));

    let mut fix = world.message("sensor_msgs/NavSatFix");
    fix.set("status.status", 0).unwrap();
    fix.set("latitude", 48.0).unwrap();
    fix.set("longitude", 11.0).unwrap();
    fix.set("altitude", 501.0).unwrap();
    // The first source of its poses must be silent.
    world.pass(4.0);
    world.put("r1/fix", &fix);
    let pose = world.pose();
    assert!(pose.x.abs() < 1e-6 && pose.y.abs() < 1e-6 && (pose.z.unwrap() - 1.0).abs() < 1e-6);
    for (field, value, reason) in [
        ("status.status", Value::Int(-1), "no satellite fix"),
        ("latitude", Value::F64(49.0), "away from the datum"),
        ("latitude", Value::F64(f64::NAN), "no place on the earth"),
    ] {
        let mut wrong = fix.clone();
        wrong.set(field, value).unwrap();
        world.pass(11.0);
        world.put("r1/fix", &wrong);
        assert!(world.reason().contains(reason), "{reason}");
    }

    let link = |peer: &str, rssi: f32| Value::Struct(vec![Value::from(peer), Value::from(rssi)]);
    let mut links = world.message("own_msgs/Links");
    links.set("links", Value::List(vec![link("/R2", -50.0), link("r3", -80.5)])).unwrap();
    world.put("r1/neighbours", &links);
    let (reports, _) = world.tick();
    let [(robot, Report::Links(Links { links: found, .. }))] = &reports[..] else {
        panic!("{reports:?}")
    };
    assert_eq!(robot, "r1");
    let found: Vec<_> = found.iter().map(|link| (link.peer.as_str(), link.quality)).collect();
    assert_eq!(found, [("r2", -50.0), ("r3", -80.5)]);
    links.set("links", Value::List(vec![link("r2", 0.5e3)])).unwrap();
    world.put("r1/neighbours", &links);
    assert!(world.reason().contains("the quality 500 is not in dBm"));

    let mut superior = world.message("std_msgs/String");
    superior.set("data", "r1").unwrap();
    world.put("r3/superior", &superior);
    world.put("r2/local", &px4);
    world.pass(11.0);
    let (reports, _) = world.tick();
    let ranks: Vec<_> = reports
        .into_iter()
        .filter_map(|(robot, report)| match report {
            Report::Rank(Rank { superior, boot, .. }) => Some((robot, superior, boot.unwrap())),
            _ => None,
        })
        .collect();
    let r1 = Some(RobotId::new("r1").unwrap());
    // That of the topic, and that of the file for the robot that is there; r9 is not.
    let expected = [
        ("r3".to_owned(), r1.clone(), "host-1".to_owned()),
        ("r2".to_owned(), r1, "host-1".to_owned()),
    ];
    assert_eq!(ranks, expected);
}

#[test]
fn a_bridge_of_dds_has_no_numbers_and_counts_by_itself() {
    let mut world = World::new("dialect = \"ros2dds\"\nnamespace = \"/site\"");
    assert_eq!(world.bridge.start(), [], "and no tokens");
    let message = world.odometry("map", 1.0, 2.0);
    for seq in 1..=2 {
        let packet = Packet::put("site/r1/odom", "", message.encode().unwrap());
        let source = world.source("r1/odom");
        assert_eq!(world.bridge.handle(world.now, Input::Sample(source, packet)), []);
        let pose = world.pose();
        assert_eq!((pose.boot.as_deref(), pose.seq), (Some("host-1"), Some(seq)));
    }
}

#[test]
fn publishers_have_tokens_and_number_what_they_put() {
    let mut world = World::new("domains = [0, 7]");
    let nodes: Vec<_> = world.bridge.start();
    let node = |domain: u32| Output::Declare(format!("@ros2_lv/{domain}/abc/0/0/NN/%/%/muster"));
    assert_eq!(nodes, [node(0), node(7)]);
    // Without a division there is what is refused of ROS.
    for sequence in 1..=3 {
        let outputs = world.bridge.handle(world.now, Input::Tick);
        let mut tokens = Vec::new();
        let mut put = Vec::new();
        for output in outputs {
            match output {
                Output::Declare(text) => tokens.push(Token::parse(&text).unwrap()),
                Output::Publish { key, payload, attachment } => {
                    let attachment = Attachment::parse(attachment.unwrap().as_bytes()).unwrap();
                    put.push((key, payload, attachment));
                }
                other => panic!("{other:?}"),
            }
        }
        assert_eq!(tokens.len(), if sequence == 1 { 2 } else { 0 });
        assert_eq!(put.len(), 2, "one in each domain");
        for (number, (key, payload, attachment)) in put.iter().enumerate() {
            assert!(key.starts_with(["0/diagnostics/", "7/diagnostics/"][number]), "{key}");
            assert_eq!(attachment.sequence, sequence);
            assert_eq!(attachment.stamp_ns, i64::try_from(world.now.0).unwrap() * 1000);
            if let Some(token) = tokens.get(number) {
                assert_eq!(attachment.gid, token.gid());
            }
            let name = TypeName::parse("diagnostic_msgs/DiagnosticArray").unwrap();
            let layout = Catalog::standard().layout(&name).unwrap();
            assert!(muster_ros::cdr::decode(&layout, payload).is_ok());
        }
        assert_eq!(world.bridge.handle(world.now, Input::Tick), [], "not twice at one moment");
        world.pass(1.0);
    }
}

#[test]
fn the_bridge_tells_what_it_refuses_each_with_its_fault() {
    let mut world = World::new("");
    let message = world.odometry("odom", 1.0, 2.0);
    let source = world.source("r1/odom");
    let bare = Packet::put(World::key(&message, "r1/odom"), "", message.encode().unwrap());
    let _ = world.bridge.handle(world.now, Input::Sample(source, bare));
    let key = World::key(&message, "r2/odom");
    let other = world.packet(key.replace("RIHS01_", "RIHS01_00")[..key.len()].to_owned(), &message);
    let _ = world.bridge.handle(world.now, Input::Sample(source, other));
    world.put("r3/odom", &message);
    world.localise("r4/tf", "map", "odom");
    world.tick();
    world.pass(5.0);
    world.put("r3/odom", &message);
    world.put("r4/odom", &message);
    world.tick();
    let state = world.bridge.state();
    let faults: Vec<_> = state
        .refused
        .iter()
        .map(|one| (one.topic.split('/').nth(1).unwrap().to_owned(), one.fault))
        .collect();
    let expected = [
        ("r1", TopicFault::NoAttachment),
        ("r2", TopicFault::TypeHash),
        ("r3", TopicFault::NoChain),
        ("r4", TopicFault::OldTransform),
    ];
    assert_eq!(faults, expected.map(|(robot, fault)| (robot.to_owned(), fault)));
    assert_eq!((state.refused_topics, state.received, state.instance.as_str()), (4, 6, "host-1"));
    world.pass(60.0);
    world.tick();
    assert_eq!(world.bridge.state().refused, [], "what is over is not named");
}
