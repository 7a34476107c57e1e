//! Scenes as plain values: what is sent, before it has the bytes of any format.

use serde_json::Value;

/// Red, green, blue and opacity, each from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Color {
    /// Red.
    pub r: f64,
    /// Green.
    pub g: f64,
    /// Blue.
    pub b: f64,
    /// Opacity: 0 is invisible.
    pub a: f64,
}

/// Where a frame lies in its parent.
#[derive(Debug, Clone, PartialEq)]
pub struct Transform {
    /// The frame of the position.
    pub parent: String,
    /// The frame of the robot.
    pub child: String,
    /// Metres east, north, up.
    pub position: [f64; 3],
    /// Radians, counter-clockwise from east.
    pub heading: f64,
}

/// A ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Its middle, in metres.
    pub at: [f64; 3],
    /// Its diameter in metres.
    pub size: f64,
    /// Its colour.
    pub color: Color,
}

/// How the points of lines belong together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LineKind {
    /// Each point with the next one, and the last one with the first.
    Loop,
    /// Two points are one line each.
    Pairs,
}

/// Lines of one colour.
#[derive(Debug, Clone, PartialEq)]
pub struct Lines {
    /// How the points belong together.
    pub kind: LineKind,
    /// The points in metres.
    pub points: Vec<[f64; 3]>,
    /// Width in pixels.
    pub width: f64,
    /// Their colour.
    pub color: Color,
}

/// A text that faces whoever looks at it.
#[derive(Debug, Clone, PartialEq)]
pub struct Text {
    /// Its middle, in metres.
    pub at: [f64; 3],
    /// What it says.
    pub text: String,
    /// Its height in pixels.
    pub size: f64,
    /// Its colour.
    pub color: Color,
}

/// What is drawn, replaced and removed as one.
#[derive(Debug, Clone, PartialEq)]
pub struct Entity {
    /// Its name within its topic. An entity takes the place of the one that had it.
    pub id: String,
    /// The frame of its positions.
    pub frame: String,
    /// What a viewer says of it when it is clicked, by name.
    pub facts: Vec<(&'static str, String)>,
    /// Balls.
    pub spheres: Vec<Sphere>,
    /// Lines.
    pub lines: Vec<Lines>,
    /// Texts.
    pub texts: Vec<Text>,
}

/// Everything that a topic of scenes shows.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scene {
    /// All entities that there are.
    pub entities: Vec<Entity>,
    /// The names of those that there are not any more.
    pub removed: Vec<String>,
}

/// How much a line of the log matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// Normal operation.
    Info,
    /// Worth a look.
    Warning,
    /// Something does not work.
    Error,
}

/// One message of a topic.
#[derive(Debug, Clone, PartialEq)]
pub enum Message {
    /// Where robots are.
    Transforms(Vec<Transform>),
    /// What is drawn.
    Scene(Scene),
    /// A message of the bus.
    Json(Value),
    /// Something happened.
    Log {
        /// How much it matters.
        level: Level,
        /// Who says it.
        name: String,
        /// What happened.
        text: String,
    },
}
