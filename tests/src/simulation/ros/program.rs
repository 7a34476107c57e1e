//! Robots of ROS: where they truly are, what their programs publish, and what of that leads to the world.

use std::collections::BTreeMap;
use std::sync::Arc;

use muster_model::id::RobotId;
use muster_ros2::config::Setup;
use muster_wire::{Attachment, Packet};

use super::cdr::Writer;
use crate::simulation::chance::{Chance, Purpose};
use crate::simulation::clock::{HostClock, MS, Micros, SECOND};
use crate::simulation::link::Link;

/// How a robot of ROS says where it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Way {
    /// Odometry, and a localisation that moves its frame.
    Localised,
    /// Odometry in a frame that was placed once, by a transform that its publisher keeps.
    Placed,
    /// Odometry, a localisation in the frame of a site, and a transform of that site that its publisher keeps.
    OfSite,
    /// Its poses are those of the world already.
    InWorld,
    /// Odometry alone: nothing leads to the world.
    Nowhere,
    /// As localised, with another definition of the odometry.
    OtherHash,
    /// As localised, by a program that puts its odometry without an attachment.
    Unnumbered,
}

impl Way {
    /// Most robots of ROS have a way to the world.
    pub(crate) const DRAWN: [Self; 10] = [
        Self::Localised,
        Self::Localised,
        Self::Localised,
        Self::Placed,
        Self::OfSite,
        Self::OfSite,
        Self::InWorld,
        Self::Nowhere,
        Self::OtherHash,
        Self::Unnumbered,
    ];

    /// Whether it leads to the world.
    pub(crate) const fn leads(self) -> bool {
        !matches!(self, Self::Nowhere | Self::OtherHash | Self::Unnumbered)
    }
}

/// What a program of a robot publishes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum RosStream {
    Odometry,
    Transforms,
    Static,
    Links,
    Rank,
}

/// A place on the ground: metres and radians.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Ground {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) yaw: f64,
}

impl Ground {
    /// The same in the frame that `frame` lies in: turned by its angle, then shifted.
    pub(crate) fn seen_from(self, frame: Self) -> Self {
        let (sin, cos) = frame.yaw.sin_cos();
        Self {
            x: frame.x + cos * self.x - sin * self.y,
            y: frame.y + sin * self.x + cos * self.y,
            yaw: frame.yaw + self.yaw,
        }
    }
}

/// What a message says, as the judge knows it without reading its bytes.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Said {
    Odometry {
        frame: String,
        at: Ground,
    },
    Transform {
        tree: String,
        parent: String,
        child: String,
        at: Ground,
        is_static: bool,
    },
    Links,
    Rank,
    /// What no bridge may take.
    Rubbish,
}

/// A message on its way to the bridge.
#[derive(Debug)]
pub(crate) struct Sample {
    pub(crate) robot: Option<RobotId>,
    pub(crate) said: Said,
    pub(crate) gid: String,
    pub(crate) sequence: i64,
    pub(crate) source: usize,
    pub(crate) packet: Packet,
}

/// One robot of ROS.
#[derive(Debug)]
pub(crate) struct RosRobot {
    /// Its name in ROS.
    pub(crate) name: String,
    pub(crate) id: RobotId,
    pub(crate) way: Way,
    /// Its link to the bus of ROS.
    pub(crate) link: Link,
    pub(crate) clock: HostClock,
    pub(crate) runs: bool,
    /// Counts its programs.
    pub(crate) life: u32,
    /// Until when its localisation says nothing.
    pub(crate) silent_until: Micros,
    /// Until when something is wrong with it: its programs, its links, its transforms.
    pub(crate) disturbed_until: Micros,
    /// How long after one odometry the next one follows; the same of transforms.
    pub(crate) periods: [Micros; 2],
    pub(crate) has_links: bool,
    /// Which publishers it receives.
    pub(crate) peer: String,
    /// Its superior, and whether it says so itself.
    pub(crate) superior: Option<RobotId>,
    pub(crate) says_rank: bool,
    number: usize,
    is_big: bool,
    begin: Ground,
    speed: [f64; 2],
    origin: Ground,
    drift: [f64; 2],
    site: Ground,
    sequences: BTreeMap<(RosStream, bool), i64>,
    /// What its publishers keep for those that come late.
    pub(crate) kept: BTreeMap<RosStream, Arc<Sample>>,
}

impl RosRobot {
    pub(crate) fn new(seed: u64, number: usize) -> Option<Self> {
        let mut chance = Chance::new(seed, Purpose::Ros, 10 + number);
        let name = if number == 1 { "Ros1".to_owned() } else { format!("ros{number}") };
        let mut ground = |most: f64| Ground {
            x: chance.real(-most, most),
            y: chance.real(-most, most),
            yaw: chance.real(-3.0, 3.0),
        };
        let (begin, origin, site) = (ground(20.0), ground(40.0), ground(40.0));
        let way = chance.pick(&Way::DRAWN).copied().unwrap_or(Way::Localised);
        // The first one has a way, or the others would have no one to be divided with.
        let way = if number == 0 && !way.leads() { Way::Localised } else { way };
        let mut clock = HostClock::default();
        if chance.percent(40) {
            clock.ahead = chance.pick(&HostClock::WRONG).copied().unwrap_or_default();
        }
        Some(Self {
            id: RobotId::new(name.to_ascii_lowercase()).ok()?,
            name,
            way,
            link: Link::new(Chance::new(seed, Purpose::Ros, 1000 + number)),
            clock,
            runs: false,
            life: 0,
            silent_until: 0,
            disturbed_until: 0,
            periods: [chance.between(90, 300) * MS, chance.between(90, 350) * MS],
            has_links: chance.percent(50),
            peer: if number == 0 { "ros1" } else { "ros0" }.to_owned(),
            superior: None,
            says_rank: chance.percent(60),
            number,
            is_big: chance.percent(30),
            begin,
            speed: [chance.real(-1.0, 1.0), chance.real(-1.0, 1.0)],
            origin,
            drift: [chance.real(-0.3, 0.3), chance.real(-0.02, 0.02)],
            site,
            sequences: BTreeMap::new(),
            kept: BTreeMap::new(),
        })
    }

    /// Its programs begin: their publishers have other names than those before, and count from one.
    pub(crate) fn start(&mut self) {
        self.runs = true;
        self.life += 1;
        self.sequences.clear();
        self.kept.clear();
    }

    /// Where it is in the frame of its odometry at a moment of its motion.
    fn odometry(&self, moved: Micros) -> Ground {
        let seconds = seconds(moved);
        Ground {
            x: self.begin.x + self.speed[0] * seconds,
            y: self.begin.y + self.speed[1] * seconds,
            yaw: self.begin.yaw,
        }
    }

    /// Where that frame lies in its parent.
    fn frame(&self, moved: Micros) -> Ground {
        let seconds = if self.way == Way::Placed { 0.0 } else { seconds(moved) };
        Ground {
            x: self.origin.x + self.drift[0] * seconds,
            y: self.origin.y,
            yaw: self.origin.yaw + self.drift[1] * seconds,
        }
    }

    /// Where it is in the world.
    pub(crate) fn place(&self, moved: Micros) -> Ground {
        let odometry = self.odometry(moved);
        match self.way {
            Way::InWorld => odometry,
            Way::OfSite => odometry.seen_from(self.frame(moved)).seen_from(self.site),
            _ => odometry.seen_from(self.frame(moved)),
        }
    }

    /// The name of a publisher in bytes. `is_second` is that of another program that publishes the same.
    fn gid(&self, stream: RosStream, is_second: bool) -> [u8; 16] {
        let mut gid = [0x5a; 16];
        gid[0] = u8::try_from(self.number).unwrap_or_default();
        gid[1..5].copy_from_slice(&self.life.to_le_bytes());
        gid[5] = stream as u8;
        gid[6] = u8::from(is_second);
        gid
    }

    /// The frame that its programs call by a name, as it is called in the tree.
    fn frame_name(&self, setup: &Setup, name: &str) -> String {
        match &setup.prefix {
            Some(prefix) if name != WORLD => {
                format!("{}{name}", prefix.replace("{robot}", &self.name))
            }
            _ => name.to_owned(),
        }
    }

    /// What it publishes now on a stream; none if it has nothing to say there.
    pub(crate) fn publish(
        &mut self,
        setup: &Setup,
        now: Micros,
        moved: Micros,
        stream: RosStream,
        is_second: bool,
    ) -> Option<Arc<Sample>> {
        let stamp = self.clock.wall(now).0;
        let mut bytes = Writer::new(self.is_big);
        let said = match stream {
            RosStream::Odometry => {
                let mut at = self.odometry(moved);
                // Another program believes that it is elsewhere.
                at.x += if is_second { 7.0 } else { 0.0 };
                let own = if self.way == Way::InWorld { WORLD } else { "odom" };
                // Frames of poses have the prefix, or not: the bridge takes both.
                let frame = if self.is_big { self.frame_name(setup, own) } else { own.to_owned() };
                bytes.header(stamp, &frame);
                bytes.text("base_link");
                bytes.doubles(&[at.x, at.y, 0.0]);
                bytes.doubles(&quaternion(at.yaw));
                bytes.doubles(&[0.0; 36 + 6 + 36]);
                Said::Odometry { frame: self.frame_name(setup, own), at }
            }
            RosStream::Transforms | RosStream::Static => {
                let is_static = stream == RosStream::Static;
                let (parent, child, at) = self.transform(moved, is_static)?;
                let parent = self.frame_name(setup, parent);
                let child = self.frame_name(setup, child);
                bytes.long(1);
                bytes.header(stamp, &parent);
                bytes.text(&child);
                bytes.doubles(&[at.x, at.y, 0.0]);
                bytes.doubles(&quaternion(at.yaw));
                let tree = if setup.prefix.is_some() { String::new() } else { self.name.clone() };
                Said::Transform { tree, parent, child, at, is_static }
            }
            RosStream::Links => {
                bytes.long(1);
                bytes.text(&self.peer);
                bytes.double(0.5);
                Said::Links
            }
            RosStream::Rank => {
                bytes.text(self.superior.as_ref().map_or("", RobotId::as_str));
                Said::Rank
            }
        };
        let is_odometry = stream == RosStream::Odometry;
        let is_wrong = is_odometry && matches!(self.way, Way::OtherHash | Way::Unnumbered);
        let said = if is_wrong { Said::Rubbish } else { said };
        let (source, key) = key(setup, stream, &self.name)?;
        let key = if self.way == Way::OtherHash && is_odometry {
            let end = key.rfind("RIHS01_")?;
            format!("{}RIHS01_{}", &key[..end], "5".repeat(64))
        } else {
            key
        };
        let sequence = self.sequences.entry((stream, is_second)).or_default();
        *sequence += 1;
        let sequence = *sequence;
        let gid = self.gid(stream, is_second);
        let packet = Packet::put(key, "", bytes.into_bytes());
        let is_numbered = !(self.way == Way::Unnumbered && is_odometry);
        let attachment =
            if is_numbered { attachment(sequence, stamp, gid).map(Some)? } else { None };
        let sample = Arc::new(Sample {
            robot: Some(self.id.clone()),
            said,
            gid: gid.iter().map(|byte| format!("{byte:02x}")).collect(),
            sequence,
            source,
            packet: Packet { attachment, ..packet },
        });
        if matches!(stream, RosStream::Static | RosStream::Rank) {
            self.kept.insert(stream, Arc::clone(&sample));
        }
        Some(sample)
    }

    /// The transform that it publishes: parent, child, and how the child lies in the parent.
    fn transform(
        &self,
        moved: Micros,
        is_static: bool,
    ) -> Option<(&'static str, &'static str, Ground)> {
        match (self.way, is_static) {
            (Way::InWorld, _) | (Way::Placed, false) => None,
            (Way::Placed, true) => Some((WORLD, "odom", self.frame(moved))),
            (Way::OfSite, true) => Some((WORLD, "site", self.site)),
            (Way::OfSite, false) => Some(("site", "odom", self.frame(moved))),
            // Where its base is in its odometry leads nowhere.
            (Way::Nowhere, false) => Some(("odom", "base_link", self.odometry(moved))),
            (_, false) => Some((WORLD, "odom", self.frame(moved))),
            (_, true) => None,
        }
    }
}

/// The frame of the fleet in ROS.
pub(crate) const WORLD: &str = "map";

fn seconds(moved: Micros) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "a run lasts minutes")]
    let seconds = moved as f64 / SECOND as f64;
    seconds
}

/// A turn about the vertical.
fn quaternion(yaw: f64) -> [f64; 4] {
    [0.0, 0.0, (yaw / 2.0).sin(), (yaw / 2.0).cos()]
}

/// What comes with a message: its number, the time of its publisher, and who that is.
pub(crate) fn attachment(sequence: i64, micros: u64, gid: [u8; 16]) -> Option<Attachment> {
    let stamp = i64::try_from(micros.saturating_mul(1000)).unwrap_or(i64::MAX);
    let mut bytes = sequence.to_le_bytes().to_vec();
    bytes.extend(stamp.to_le_bytes());
    bytes.push(16);
    bytes.extend(gid);
    Attachment::new(bytes).ok()
}

/// The source of a stream by its number, and the key of a robot's topic.
pub(crate) fn key(setup: &Setup, stream: RosStream, name: &str) -> Option<(usize, String)> {
    let (topic, type_name) = match stream {
        RosStream::Odometry => ("odom", "nav_msgs::msg::dds_::Odometry_"),
        RosStream::Transforms => ("tf", "tf2_msgs::msg::dds_::TFMessage_"),
        RosStream::Static => ("tf_static", "tf2_msgs::msg::dds_::TFMessage_"),
        RosStream::Links => ("neighbours", "own_msgs::msg::dds_::Neighbours_"),
        RosStream::Rank => ("superior", "std_msgs::msg::dds_::String_"),
    };
    let is_shared =
        setup.prefix.is_some() && matches!(stream, RosStream::Transforms | RosStream::Static);
    let topic = if is_shared { topic.to_owned() } else { format!("{name}/{topic}") };
    let is_of = |source: &muster_ros2::config::Source| source.topic.robot_of(&topic).is_some();
    let number = setup.sources.iter().position(is_of)?;
    let hash = setup.sources.get(number)?.hash.to_string();
    Some((number, format!("0/{topic}/{type_name}/{hash}")))
}
