//! Plain scenes as messages of Foxglove's schemas, and their bytes.

use foxglove::messages::line_primitive::Type as LineType;
use foxglove::messages::log::Level as LogLevel;
use foxglove::messages::scene_entity_deletion::Type as DeletionType;
use foxglove::messages::{
    Color, Duration, FrameTransform, FrameTransforms, KeyValuePair, LinePrimitive, Log, Point3,
    Pose, Quaternion, SceneEntity, SceneEntityDeletion, SceneUpdate, SpherePrimitive,
    TextPrimitive, Timestamp, Vector3,
};
use foxglove::{Encode, Schema};
use muster_model::time::Tick;

use crate::Topic;
use crate::limits::SCENE_LIFETIME;
use crate::scene::{self, Entity, Level, LineKind, Lines, Message, Scene, Sphere, Text, Transform};
use crate::schema::for_viewers;

/// The form of a topic's messages.
#[derive(Debug, Clone)]
pub struct Form {
    /// How messages are encoded: `protobuf` or `json`.
    pub encoding: String,
    /// What they are.
    pub schema: Option<Schema>,
}

fn form_of<T: Encode>() -> Form {
    Form { encoding: T::get_message_encoding(), schema: T::get_schema() }
}

/// The form of JSON of the bus, by the name of its schema there.
#[must_use]
pub fn json_form(name: &str) -> Form {
    let text = for_viewers(name).map(|schema| schema.to_string().into_bytes());
    let schema = text.map(|text| Schema::new(format!("muster.{name}"), "jsonschema", text));
    Form { encoding: "json".to_owned(), schema }
}

/// The form of a topic's messages.
#[must_use]
pub fn form(topic: &Topic) -> Form {
    match topic {
        Topic::Transforms => form_of::<FrameTransforms>(),
        Topic::Teams | Topic::Links(_) => form_of::<SceneUpdate>(),
        Topic::Quality => json_form("audit"),
        Topic::Events => form_of::<Log>(),
    }
}

/// A moment in nanoseconds since 1970.
#[must_use]
pub fn nanoseconds(now: Tick) -> u64 {
    now.0.saturating_mul(1_000)
}

fn timestamp(now: Tick) -> Timestamp {
    let seconds = u32::try_from(now.0 / 1_000_000).unwrap_or(u32::MAX);
    let rest = u32::try_from(now.0 % 1_000_000).unwrap_or_default();
    Timestamp::new(seconds, rest * 1_000)
}

fn lifetime() -> Duration {
    Duration::new(i32::try_from(SCENE_LIFETIME.as_secs()).unwrap_or(i32::MAX), 0)
}

/// The bytes of a message; none if it cannot be written.
#[must_use]
pub fn bytes(message: Message, now: Tick) -> Option<Vec<u8>> {
    fn encoded<T: Encode>(message: &T) -> Option<Vec<u8>> {
        let mut bytes = Vec::with_capacity(message.encoded_len().unwrap_or_default());
        message.encode(&mut bytes).ok()?;
        Some(bytes)
    }
    match message {
        Message::Transforms(all) => {
            let transforms = all.into_iter().map(|one| transform(one, now)).collect();
            encoded(&FrameTransforms { transforms })
        }
        Message::Scene(scene) => encoded(&scene_update(scene, now)),
        Message::Json(value) => serde_json::to_vec(&value).ok(),
        Message::Log { level, name, text } => {
            let level = match level {
                Level::Info => LogLevel::Info,
                Level::Warning => LogLevel::Warning,
                Level::Error => LogLevel::Error,
            };
            encoded(&Log {
                timestamp: Some(timestamp(now)),
                level: level.into(),
                message: text,
                name,
                file: String::new(),
                line: 0,
            })
        }
    }
}

fn transform(transform: Transform, now: Tick) -> FrameTransform {
    let Transform { parent, child, position: [x, y, z], heading } = transform;
    let (sin, cos) = (heading / 2.0).sin_cos();
    FrameTransform {
        timestamp: Some(timestamp(now)),
        parent_frame_id: parent,
        child_frame_id: child,
        translation: Some(Vector3 { x, y, z }),
        rotation: Some(Quaternion { x: 0.0, y: 0.0, z: sin, w: cos }),
    }
}

fn scene_update(scene: Scene, now: Tick) -> SceneUpdate {
    let deletion = |id| SceneEntityDeletion {
        timestamp: Some(timestamp(now)),
        r#type: DeletionType::MatchingId.into(),
        id,
    };
    SceneUpdate {
        deletions: scene.removed.into_iter().map(deletion).collect(),
        entities: scene.entities.into_iter().map(|one| entity(one, now)).collect(),
    }
}

fn entity(entity: Entity, now: Tick) -> SceneEntity {
    let Entity { id, frame, facts, spheres, lines, texts } = entity;
    let fact = |(key, value): (&str, String)| KeyValuePair { key: key.to_owned(), value };
    SceneEntity {
        timestamp: Some(timestamp(now)),
        frame_id: frame,
        id,
        lifetime: Some(lifetime()),
        frame_locked: true,
        metadata: facts.into_iter().map(fact).collect(),
        spheres: spheres.into_iter().map(sphere).collect(),
        lines: lines.into_iter().map(line).collect(),
        texts: texts.into_iter().map(text).collect(),
        ..SceneEntity::default()
    }
}

fn color(color: scene::Color) -> Color {
    let scene::Color { r, g, b, a } = color;
    Color { r, g, b, a }
}

/// A place without a turn of its own.
fn pose([x, y, z]: [f64; 3]) -> Pose {
    Pose {
        position: Some(Vector3 { x, y, z }),
        orientation: Some(Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
    }
}

fn sphere(sphere: Sphere) -> SpherePrimitive {
    let size = Vector3 { x: sphere.size, y: sphere.size, z: sphere.size };
    SpherePrimitive {
        pose: Some(pose(sphere.at)),
        size: Some(size),
        color: Some(color(sphere.color)),
    }
}

fn line(lines: Lines) -> LinePrimitive {
    let kind = match lines.kind {
        LineKind::Loop => LineType::LineLoop,
        LineKind::Pairs => LineType::LineList,
    };
    let point = |[x, y, z]: [f64; 3]| Point3 { x, y, z };
    LinePrimitive {
        r#type: kind.into(),
        pose: Some(pose([0.0; 3])),
        thickness: lines.width,
        scale_invariant: true,
        points: lines.points.into_iter().map(point).collect(),
        color: Some(color(lines.color)),
        colors: Vec::new(),
        indices: Vec::new(),
    }
}

fn text(text: Text) -> TextPrimitive {
    TextPrimitive {
        pose: Some(pose(text.at)),
        billboard: true,
        font_size: text.size,
        scale_invariant: true,
        color: Some(color(text.color)),
        text: text.text,
    }
}
