//! A bridge, and robots that put messages of ROS.

use std::sync::Arc;
use std::time::Duration;

use muster_model::id::InstanceId;
use muster_model::observation::{Pose, Report};
use muster_model::time::Tick;
use muster_ros::{Attachment, Gid, Message, TypeHash, Value};
use muster_ros2::config::{File, Setup};
use muster_ros2::core::{Bridge, Input, Output};
use muster_wire::Packet;

/// A publisher of ROS.
pub(super) const GID: Gid = Gid([7; 16]);

pub(super) struct World {
    pub(super) setup: Arc<Setup>,
    pub(super) bridge: Bridge,
    pub(super) now: Tick,
    pub(super) sequence: i64,
    /// The publisher of everything that is put from now on.
    pub(super) gid: Gid,
    /// What its clock shows.
    pub(super) stamp_ns: i64,
}

pub(super) fn quarter_turn() -> Value {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    Value::Struct([0.0, 0.0, half, half].map(Value::from).to_vec())
}

impl World {
    pub(super) fn new(topics: &str) -> Self {
        let file: File = toml::from_str(topics).unwrap();
        let setup = Arc::new(file.check().unwrap());
        let instance = InstanceId::new("host-1").unwrap();
        let bridge = Bridge::new(Arc::clone(&setup), "abc", &instance);
        Self {
            setup,
            bridge,
            now: Tick(0).after(Duration::from_secs(1000)),
            sequence: 0,
            gid: GID,
            stamp_ns: 0,
        }
    }

    pub(super) fn pass(&mut self, seconds: f64) {
        self.now = self.now.after(Duration::from_secs_f64(seconds));
    }

    pub(super) fn message(&self, type_name: &str) -> Message {
        Message::new(&self.setup.catalog, type_name).unwrap()
    }

    pub(super) fn key(message: &Message, topic: &str) -> String {
        let layout = message.layout();
        format!("0/{topic}/{}/{}", layout.name().to_dds(), TypeHash::of(layout))
    }

    pub(super) fn packet(&mut self, key: String, message: &Message) -> Packet {
        self.sequence += 1;
        let attachment =
            Attachment { sequence: self.sequence, stamp_ns: self.stamp_ns, gid: self.gid };
        let attachment = muster_wire::Attachment::new(attachment.to_bytes()).ok();
        Packet { attachment, ..Packet::put(key, "", message.encode().unwrap()) }
    }

    /// The source that a topic belongs to, by its place in the setup.
    pub(super) fn source(&self, topic: &str) -> usize {
        let found = self.setup.sources.iter().position(|one| one.topic.robot_of(topic).is_some());
        found.unwrap_or_else(|| panic!("no source has {topic}"))
    }

    pub(super) fn put(&mut self, topic: &str, message: &Message) -> Vec<Output> {
        let key = Self::key(message, topic);
        let packet = self.packet(key, message);
        self.bridge.handle(self.now, Input::Sample(self.source(topic), packet))
    }

    /// What a publisher keeps, as it answers when it is asked.
    pub(super) fn answer(&mut self, topic: &str, message: &Message) -> Vec<Output> {
        let key = Self::key(message, topic);
        let packet = self.packet(key, message);
        self.bridge.handle(self.now, Input::Kept(self.source(topic), packet))
    }

    /// A message on a topic, as every source that reads it receives it.
    pub(super) fn put_to_all(&mut self, topic: &str, message: &Message) -> Vec<Output> {
        let packet = self.packet(Self::key(message, topic), message);
        let mut outputs = Vec::new();
        for source in 0..self.setup.sources.len() {
            if self.setup.sources[source].topic.robot_of(topic).is_some() {
                let input = Input::Sample(source, packet.clone());
                outputs.extend(self.bridge.handle(self.now, input));
            }
        }
        outputs
    }

    pub(super) fn odometry(&self, frame: &str, x: f64, y: f64) -> Message {
        let mut message = self.message("nav_msgs/Odometry");
        message.set("header.frame_id", frame).unwrap();
        message.set("pose.pose.position.x", x).unwrap();
        message.set("pose.pose.position.y", y).unwrap();
        message
    }

    pub(super) fn transform(&self, parent: &str, child: &str, x: f64, rotation: Value) -> Message {
        let mut one = self.message("geometry_msgs/TransformStamped");
        one.set("header.frame_id", parent).unwrap();
        one.set("child_frame_id", child).unwrap();
        one.set("transform.translation.x", x).unwrap();
        one.set("transform.rotation", rotation).unwrap();
        let mut message = self.message("tf2_msgs/TFMessage");
        message.set("transforms", Value::List(vec![one.into_value()])).unwrap();
        message
    }

    pub(super) fn localise(&mut self, topic: &str, parent: &str, child: &str) {
        let message = self.transform(parent, child, 10.0, quarter_turn());
        assert_eq!(self.put(topic, &message), []);
    }

    /// Reports and reasons of the next tick.
    pub(super) fn tick(&mut self) -> (Vec<(String, Report)>, Vec<String>) {
        let (mut reports, mut reasons) = (Vec::new(), Vec::new());
        for output in self.bridge.handle(self.now, Input::Tick) {
            match output {
                Output::Report(robot, report) => reports.push((robot.to_string(), report)),
                Output::Refused(refusal) => reasons.push(refusal.reason),
                _ => {}
            }
        }
        (reports, reasons)
    }

    pub(super) fn pose(&mut self) -> Pose {
        let (reports, reasons) = self.tick();
        match &reports[..] {
            [(_, Report::Pose(pose))] => pose.clone(),
            other => panic!("{other:?} {reasons:?}"),
        }
    }

    pub(super) fn reason(&mut self) -> String {
        let (reports, reasons) = self.tick();
        assert_eq!(reports, []);
        reasons.concat()
    }
}

pub(super) fn near(pose: &Pose, x: f64, y: f64, heading: Option<f64>) {
    assert!((pose.x - x).abs() < 1e-9 && (pose.y - y).abs() < 1e-9, "{pose:?}");
    let same = match (pose.heading, heading) {
        (Some(own), Some(wanted)) => (own - wanted).abs() < 1e-6,
        (own, wanted) => own == wanted,
    };
    assert!(same, "{pose:?}");
}
