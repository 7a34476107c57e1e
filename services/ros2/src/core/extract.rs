//! From values of ROS messages to reports.

use muster_model::bridge::TopicFault;
use muster_model::id::RobotId;
use muster_model::observation::{Link, Links, Pose, Rank, Report};
use muster_model::time::Tick;
use muster_ros::{Place, Value};
use muster_wire::message::quoted;

use super::frames::{ChainError, Frames};
use super::geometry::{Geodetic, MAX_DATUM_DISTANCE_M, Rotation, Transform};
use crate::config::{Axes, Content, PoseForm, Setup, Unit};

/// The range of a received signal strength in dBm: below is less than the noise, above more than is sent.
const DBM_RANGE: std::ops::RangeInclusive<f64> = -200.0..=50.0;

/// Longest name of a frame in bytes: as long as a name of ROS may be in DDS.
const MAX_FRAME_NAME_BYTES: usize = 255;

/// When, and as which message of which publisher, a sample is taken.
#[derive(Debug)]
pub(super) struct Stamped {
    pub(super) now: Tick,
    pub(super) boot: String,
    pub(super) seq: u64,
}

/// Why a message is not taken.
#[derive(Debug)]
pub(super) struct Problem {
    /// What is wrong, for programs.
    pub(super) fault: TopicFault,
    /// What is wrong, and what would be right.
    pub(super) reason: String,
}

impl Problem {
    pub(super) fn new(fault: TopicFault, reason: impl Into<String>) -> Self {
        Self { fault, reason: reason.into() }
    }

    /// Whether it may pass by itself while a robot starts: its transforms may come after its odometry.
    pub(super) fn may_pass(&self) -> bool {
        self.fault == TopicFault::NoChain
    }
}

impl From<String> for Problem {
    fn from(reason: String) -> Self {
        Self::new(TopicFault::Other, reason)
    }
}

impl From<&str> for Problem {
    fn from(reason: &str) -> Self {
        reason.to_owned().into()
    }
}

/// A transform out of a message.
#[derive(Debug)]
pub(super) struct NamedTransform<'a> {
    pub(super) parent: &'a str,
    pub(super) child: &'a str,
    pub(super) transform: Transform,
}

/// Frames are named without the slash that some programs begin them with.
fn frame_name(text: &str) -> &str {
    text.strip_prefix('/').unwrap_or(text)
}

/// The transforms of a `tf2_msgs/TFMessage`, each by itself: one that is wrong leaves the others as they are.
pub(super) fn transforms(
    message: &Value,
) -> Result<impl Iterator<Item = Result<NamedTransform<'_>, String>>, String> {
    let list = match message {
        Value::Struct(outer) => outer.first().and_then(Value::as_list),
        _ => None,
    };
    Ok(list.ok_or_else(no_transforms)?.iter().map(named_transform))
}

fn no_transforms() -> String {
    "this is no list of transforms".to_owned()
}

/// Header (stamp, frame), child, transform (translation, rotation): the layout is built in.
fn named_transform(one: &Value) -> Result<NamedTransform<'_>, String> {
    let wrong = no_transforms;
    let Value::Struct(parts) = one else { return Err(wrong()) };
    let [Value::Struct(header), Value::Text(child), Value::Struct(transform)] = &parts[..] else {
        return Err(wrong());
    };
    let ([_, Value::Text(parent)], [translation, rotation]) = (&header[..], &transform[..]) else {
        return Err(wrong());
    };
    if let Some(long) = [parent, child].into_iter().find(|name| name.len() > MAX_FRAME_NAME_BYTES) {
        let name = quoted(long);
        return Err(format!(
            "the name of the frame {name} has more than {MAX_FRAME_NAME_BYTES} bytes"
        ));
    }
    let numbers = |value: &Value| -> Option<Vec<f64>> {
        let Value::Struct(fields) = value else { return None };
        fields.iter().map(Value::as_f64).collect()
    };
    let translation = numbers(translation).and_then(|v| v.try_into().ok()).ok_or_else(wrong)?;
    let rotation: [f64; 4] = numbers(rotation).and_then(|v| v.try_into().ok()).ok_or_else(wrong)?;
    let rotation = Rotation::new(rotation)
        .ok_or_else(|| format!("the rotation of {} is no quaternion of length 1", quoted(child)))?;
    let transform = Transform { translation, rotation };
    Ok(NamedTransform { parent: frame_name(parent), child: frame_name(child), transform })
}

fn number(value: &Value, place: &Place, what: &str) -> Result<f64, String> {
    let number = place.get(value).and_then(Value::as_f64);
    number.ok_or_else(|| format!("{what} is no number"))
}

fn numbers<const N: usize>(
    value: &Value,
    places: &[Place; N],
    what: &str,
) -> Result<[f64; N], String> {
    let mut found = [0.0; N];
    for (found, place) in found.iter_mut().zip(places) {
        *found = number(value, place, what)?;
    }
    Ok(found)
}

fn text<'a>(value: &'a Value, place: &Place, what: &str) -> Result<&'a str, String> {
    place.get(value).and_then(Value::as_text).ok_or_else(|| format!("{what} is no text"))
}

/// The id of a robot that a message names, with or without a slash.
fn robot_id(text: &str) -> Result<RobotId, String> {
    let name = frame_name(text).to_ascii_lowercase();
    RobotId::new(&name).map_err(|error| format!("{:?} is no robot: {error}", quoted(text)))
}

/// What a robot reports by a message.
pub(super) fn report(
    setup: &Setup,
    content: &Content,
    name: &str,
    frames: Option<&Frames>,
    value: &Value,
    stamped: Stamped,
) -> Result<Report, Problem> {
    let Stamped { now, boot, seq } = stamped;
    let (boot, seq) = (Some(boot), Some(seq));
    // The clocks of robots may be wrong: the order follows from the numbers alone, and the age from the arrival.
    let stamp = None;
    Ok(match content {
        Content::Pose { form, frame, axes } => {
            let reading = Reading { setup, name, frames, now };
            let placed = reading.pose(form, frame.as_deref(), *axes, value)?;
            let [x, y, z] = placed.position;
            let frame = setup.frame.clone();
            Report::Pose(Pose {
                x,
                y,
                z: Some(z),
                heading: placed.heading,
                frame,
                stamp,
                boot,
                seq,
            })
        }
        Content::Links { list, peer, quality, unit } => {
            let list =
                list.get(value).and_then(Value::as_list).ok_or("the list of links is none")?;
            let link = |one: &Value| {
                let peer = robot_id(text(one, peer, "the peer of a link")?)?;
                let quality = number(one, quality, "the quality of a link")?;
                check_quality(quality, *unit)?;
                Ok(Link { peer, quality })
            };
            let links = list.iter().map(link).collect::<Result<_, String>>()?;
            Report::Links(Links { links, stamp, boot, seq })
        }
        Content::Rank { superior } => {
            let superior = text(value, superior, "the superior")?;
            let superior = (!superior.is_empty()).then(|| robot_id(superior)).transpose()?;
            Report::Rank(Rank { boot, seq, ..Rank::under(superior) })
        }
        Content::Transforms { .. } => return Err("transforms are no report".into()),
    })
}

fn check_quality(quality: f64, unit: Unit) -> Result<(), String> {
    let (is_right, wanted) = match unit {
        Unit::Quality => ((0.0..=1.0).contains(&quality), "from 0 to 1"),
        Unit::Dbm => (DBM_RANGE.contains(&quality), "in dBm"),
    };
    if is_right { Ok(()) } else { Err(format!("the quality {quality} is not {wanted}; see unit")) }
}

/// A place in the world.
struct Placed {
    position: [f64; 3],
    heading: Option<f64>,
}

/// What poses of a robot are read with.
struct Reading<'a> {
    setup: &'a Setup,
    name: &'a str,
    frames: Option<&'a Frames>,
    now: Tick,
}

impl Reading<'_> {
    fn pose(
        &self,
        form: &PoseForm,
        frame: Option<&str>,
        axes: Axes,
        value: &Value,
    ) -> Result<Placed, Problem> {
        let (pose, own_frame, has_heading) = match form {
            PoseForm::Framed { frame, position, rotation } => {
                let translation = numbers(value, position, "the position")?;
                let rotation = numbers(value, rotation, "the orientation")?;
                // Some programs leave the orientation at zero, where they know none.
                let is_unknown = rotation == [0.0; 4];
                let rotation = if is_unknown {
                    Rotation::IDENTITY
                } else {
                    Rotation::new(rotation).ok_or("the orientation is no quaternion of length 1")?
                };
                let frame = text(value, frame, "the frame")?;
                (Transform { translation, rotation }, frame, !is_unknown)
            }
            PoseForm::Fix { status, place, datum } => {
                return Ok(self.fix(value, status, place, datum)?);
            }
            PoseForm::Named { ground, height, heading } => {
                let [x, y] = numbers(value, ground, "a coordinate")?;
                let z = height.as_ref().map(|place| number(value, place, "the height"));
                let angle = heading.as_ref().map(|place| number(value, place, "the heading"));
                let (z, angle) = (z.transpose()?.unwrap_or(0.0), angle.transpose()?);
                // PX4 has NaN where it knows no heading.
                let angle = angle.filter(|angle| angle.is_finite());
                let rotation = Rotation::about_z(angle.unwrap_or(0.0));
                (Transform { translation: [x, y, z], rotation }, "", angle.is_some())
            }
        };
        if !pose.is_finite() {
            return Err("a coordinate is no finite number".into());
        }
        let (pose, has_heading) = match axes {
            Axes::EastNorthUp => (pose, has_heading),
            // What points straight up or down has no heading, and none can be made of it.
            Axes::NorthEastDown => {
                (pose.from_north_east_down(), has_heading && pose.rotation.heading().is_some())
            }
        };
        let frame = frame.unwrap_or(own_frame);
        if frame.is_empty() {
            return Err("the pose names no frame; name it in the configuration".into());
        }
        let world = pose.within(self.chain(frame)?);
        let heading = world.rotation.heading().filter(|_| has_heading);
        Ok(Placed { position: world.translation, heading })
    }

    /// How a frame that a robot names lies in the world.
    fn chain(&self, frame: &str) -> Result<Transform, Problem> {
        let Setup { world, prefix, max_age, .. } = self.setup;
        let frame = frame_name(frame);
        if frame == world {
            return Ok(Transform::IDENTITY);
        }
        // Where robots share a tree, a robot may name its frames with or without its prefix.
        let full = match prefix {
            Some(prefix) => {
                let prefix = prefix.replace("{robot}", self.name);
                if frame.starts_with(&prefix) {
                    frame.to_owned()
                } else {
                    format!("{prefix}{frame}")
                }
            }
            None => frame.to_owned(),
        };
        let empty = Frames::new(0);
        let frames = self.frames.unwrap_or(&empty);
        let chain = frames.chain(self.now, &full, world, *max_age);
        chain.map_err(|error| {
            let fault = match error {
                ChainError::Apart { .. } => TopicFault::NoChain,
                ChainError::Old { .. } => TopicFault::OldTransform,
                ChainError::Circle(_) => TopicFault::Other,
            };
            Problem::new(fault, muster_wire::message::plain_reason(&error.to_string()))
        })
    }

    fn fix(
        &self,
        value: &Value,
        status: &Place,
        place: &[Place; 3],
        datum: &Geodetic,
    ) -> Result<Placed, String> {
        if number(value, status, "the status")? < 0.0 {
            return Err("there is no satellite fix".to_owned());
        }
        let [latitude, longitude, altitude] = numbers(value, place, "a coordinate")?;
        // Receivers that know no height leave it out.
        let altitude = if altitude.is_nan() { datum.altitude } else { altitude };
        let place = Geodetic { latitude, longitude, altitude };
        if !place.is_valid() {
            return Err("the coordinates are no place on the earth".to_owned());
        }
        let position = place.east_north_up_of(datum);
        if position[0].hypot(position[1]) > MAX_DATUM_DISTANCE_M {
            return Err(format!(
                "the fix is more than {MAX_DATUM_DISTANCE_M} m away from the datum; set the datum near the fleet"
            ));
        }
        Ok(Placed { position, heading: None })
    }
}
