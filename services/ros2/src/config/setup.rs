//! The file, checked: what is read and written, with all types and places found.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use muster_model::id::RobotId;
use muster_ros::{Catalog, Dialect, Layout, Place, TopicName, TypeHash};
use muster_wire::ForeignPattern;

use super::file::{Axes, Unit};
use crate::core::geometry::Geodetic;
use crate::template::Template;

/// Where a pose stands in a message.
#[derive(Debug, Clone, PartialEq)]
pub enum PoseForm {
    /// A pose with a frame in its head: where the frame, the position and the rotation stand.
    Framed {
        /// The name of the frame.
        frame: Place,
        /// Three coordinates.
        position: [Place; 3],
        /// A quaternion as x, y, z, w.
        rotation: [Place; 4],
    },
    /// A satellite fix.
    Fix {
        /// Below zero where there is no fix.
        status: Place,
        /// Degrees north, degrees east, metres up.
        place: [Place; 3],
        /// Where metres are counted from.
        datum: Geodetic,
    },
    /// Numbers that the file names.
    Named {
        /// The first and the second coordinate.
        ground: [Place; 2],
        /// The third one.
        height: Option<Place>,
        /// The heading.
        heading: Option<Place>,
    },
}

/// What is read from a topic.
#[derive(Debug, Clone, PartialEq)]
pub enum Content {
    /// Poses.
    Pose {
        /// Where they stand.
        form: Box<PoseForm>,
        /// The frame, instead of that of each message.
        frame: Option<String>,
        /// Which way the axes point.
        axes: Axes,
    },
    /// Links.
    Links {
        /// The list.
        list: Place,
        /// The robot that is received, in each.
        peer: Place,
        /// How well, in each.
        quality: Place,
        /// In which unit.
        unit: Unit,
    },
    /// The superior.
    Rank {
        /// Its name.
        superior: Place,
    },
    /// Transforms.
    Transforms {
        /// Whether they hold for good.
        is_static: bool,
    },
}

/// A topic that is read.
#[derive(Debug, Clone)]
pub struct Source {
    /// Its topics.
    pub topic: Template,
    /// The type of its messages.
    pub layout: Arc<Layout>,
    /// The hash of that.
    pub hash: TypeHash,
    /// The keys on which it comes: with any hash, so that a robot with another one is seen and refused.
    pub patterns: Vec<ForeignPattern>,
    /// What is read.
    pub content: Content,
}

/// The file, checked.
#[derive(Debug, Clone)]
pub struct Setup {
    /// How ROS comes to the bus.
    pub dialect: Dialect,
    /// The domains; one that stands for none with `ros2dds`.
    pub domains: Vec<u32>,
    /// Whether keys are written with the hashes of types.
    pub type_hashes: bool,
    /// The namespace of the bridge.
    pub namespace: Option<TopicName>,
    /// How often the newest of each robot is put.
    pub every: Duration,
    /// The frame of ROS that Muster's coordinates are in.
    pub world: String,
    /// The name of that frame in poses.
    pub frame: Option<String>,
    /// What stands before the frames of a robot; none where each robot has a topic of its own.
    pub prefix: Option<String>,
    /// How old a transform may be.
    pub max_age: Duration,
    /// What is read.
    pub sources: Vec<Source>,
    /// Superiors that never change.
    pub ranks: BTreeMap<RobotId, Option<RobotId>>,
    /// What is written.
    pub publish: PublishTopics,
    /// All types.
    pub catalog: Catalog,
}

/// The topics that are written.
#[derive(Debug, Clone, Default)]
pub struct PublishTopics {
    /// The division as JSON.
    pub teams: Option<TopicName>,
    /// The division in messages of its own.
    pub typed_teams: Option<TopicName>,
    /// The team of each robot.
    pub team: Option<Template>,
    /// The quality of the teams.
    pub diagnostics: Option<TopicName>,
    /// Where the teams are.
    pub markers: Option<TopicName>,
}
