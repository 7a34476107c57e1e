//! What is wrong or too much: it is refused with its reason, and takes nothing else with it.

use muster_model::observation::Pose;
use muster_ros::{Catalog, Message, TypeName, Value, cdr};
use muster_ros2::core::{Input, Output};
use muster_wire::Packet;

use super::world::{World, near, quarter_turn};

fn reason(outputs: &[Output]) -> &str {
    let [Output::Refused(refusal)] = outputs else { panic!("{outputs:?}") };
    &refusal.reason
}

/// A message with several transforms.
fn transforms(world: &World, all: &[(&str, &str, Value)]) -> Message {
    let each = all.iter().map(|(parent, child, rotation)| {
        let mut one = world.message("geometry_msgs/TransformStamped");
        one.set("header.frame_id", *parent).unwrap();
        one.set("child_frame_id", *child).unwrap();
        one.set("transform.translation.x", 10.0).unwrap();
        one.set("transform.rotation", rotation.clone()).unwrap();
        one.into_value()
    });
    let each = Value::List(each.collect());
    let mut message = world.message("tf2_msgs/TFMessage");
    message.set("transforms", each).unwrap();
    message
}

fn odom_is_localised(world: &mut World) {
    let message = world.odometry("odom", 1.0, 2.0);
    world.put("r1/odom", &message);
    near(&world.pose(), 8.0, 1.0, Some(std::f64::consts::FRAC_PI_2));
}

#[test]
fn a_wrong_transform_leaves_the_others_of_its_message() {
    let mut world = World::new("");
    let zero = Value::Struct([0.0; 4].map(Value::from).to_vec());
    let all = [("map", "lidar", zero), ("map", "odom", quarter_turn())];
    let message = transforms(&world, &all);
    let outputs = world.put("r1/tf", &message);
    assert!(reason(&outputs).contains("the rotation of lidar is no quaternion"));
    odom_is_localised(&mut world);
}

#[test]
fn long_names_of_frames_are_refused() {
    let mut world = World::new("");
    let long = "f".repeat(256);
    for (parent, child) in [("map", long.as_str()), (&long, "lidar")] {
        world.pass(11.0);
        let all = [(parent, child, quarter_turn()), ("map", "odom", quarter_turn())];
        let message = transforms(&world, &all);
        let outputs = world.put("r1/tf", &message);
        assert!(reason(&outputs).contains("more than 255 bytes"), "{}", reason(&outputs));
        odom_is_localised(&mut world);
    }
    let message = transforms(&world, &[("map", &long[1..], quarter_turn())]);
    assert_eq!(world.put("r1/tf", &message), []);
}

#[test]
fn a_robot_has_so_many_frames_and_the_tree_of_all_has_more() {
    let fill = |world: &mut World, topic: &str| {
        world.localise(topic, "map", "odom");
        let names: Vec<String> = (0..1024).map(|number| format!("f{number}")).collect();
        let all: Vec<_> =
            names.iter().map(|name| ("odom", name.as_str(), quarter_turn())).collect();
        let message = transforms(world, &all);
        let outputs = world.put(topic, &message);
        // The frames that are there go on.
        world.localise(topic, "map", "odom");
        outputs
    };
    let mut world = World::new("");
    let outputs = fill(&mut world, "r1/tf");
    assert!(reason(&outputs).contains("more than 1024 frames"), "{}", reason(&outputs));
    odom_is_localised(&mut world);
    let mut world = World::new("frames = { tf = \"/tf\", tf_static = \"/tf_static\" }");
    assert_eq!(fill(&mut world, "tf"), []);
}

#[test]
fn so_many_bytes_wait_at_most() {
    let mut world = World::new("");
    let message = world.odometry("map", 1.0, 2.0);
    let large = vec![0; 256 * 1024];
    let send = |world: &mut World, robot: usize| {
        let packet = world.packet(World::key(&message, &format!("r{robot}/odom")), &message);
        let packet = Packet { payload: Ok(large.clone()), ..packet };
        world.bridge.handle(world.now, Input::Sample(2, packet))
    };
    for robot in 0..256 {
        assert_eq!(send(&mut world, robot), [], "{robot}");
    }
    assert_eq!(send(&mut world, 0), [], "a newer one takes the place of the last");
    assert!(reason(&send(&mut world, 256)).contains("wait"));
    world.tick();
    world.pass(11.0);
    assert_eq!(send(&mut world, 256), [], "all were taken");
}

#[test]
fn a_topic_too_many_brings_no_robot() {
    let mut world = World::new("");
    let message = world.odometry("map", 1.0, 2.0);
    let mut refused = 0;
    let key = World::key(&message, "robot/odom");
    let packet = world.packet(key.clone(), &message);
    for robot in 0..=65_536 {
        let packet =
            Packet { key: key.replacen("robot", &format!("r{robot}"), 1), ..packet.clone() };
        refused += world.bridge.handle(world.now, Input::Sample(2, packet)).len();
    }
    assert_eq!((refused, world.bridge.robots().len()), (1, 65_536));
}

#[test]
fn an_unknown_heading_is_none_and_not_east() {
    let mut world = World::new(
        r#"
        [[pose]]
        topic = "/{robot}/local"
        type = "px4_msgs/msg/VehicleLocalPosition"
        definition = "float32 x\nfloat32 y\nfloat32 heading"
        fields = { x = "x", y = "y", heading = "heading" }
        axes = "north_east_down"
        frame = "map"
        [[pose]]
        topic = "/{robot}/odom"
        type = "nav_msgs/Odometry"
        axes = "north_east_down"
        frame = "map"
        "#,
    );
    let heading = |pose: Pose| pose.heading;
    let mut px4 = world.message("px4_msgs/VehicleLocalPosition");
    for unknown in [f32::NAN, f32::INFINITY] {
        px4.set("heading", unknown).unwrap();
        world.put("r1/local", &px4);
        assert_eq!(heading(world.pose()), None);
    }
    px4.set("heading", 0.0_f32).unwrap();
    world.put("r1/local", &px4);
    assert!(heading(world.pose()).is_some());
    let mut up = world.odometry("map", 1.0, 2.0);
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let rotation = Value::Struct([0.0, -half, 0.0, half].map(Value::from).to_vec());
    up.set("pose.pose.orientation", rotation).unwrap();
    world.put("r2/odom", &up);
    assert_eq!(heading(world.pose()), None, "it looks straight up");
}

#[test]
fn all_topics_that_are_not_taken_are_counted() {
    let mut world = World::new("");
    let message = world.odometry("nowhere", 1.0, 2.0);
    let put = |world: &mut World| {
        for robot in 0..70 {
            world.put(&format!("r{robot}/odom"), &message);
        }
    };
    put(&mut world);
    world.pass(5.0);
    put(&mut world);
    world.tick();
    world.pass(1.1);
    let outputs = world.bridge.handle(world.now, Input::Tick);
    let shown = outputs.iter().find_map(|output| match output {
        Output::Publish { key, payload, .. } if key.starts_with("0/diagnostics/") => Some(payload),
        _ => None,
    });
    let name = TypeName::parse("diagnostic_msgs/DiagnosticArray").unwrap();
    let layout = Catalog::standard().layout(&name).unwrap();
    let text = format!("{:?}", cdr::decode(&layout, shown.unwrap()).unwrap());
    assert!(text.contains("\"70 topics are not taken\""), "{text}");
}
