//! The topics that are read: what each must say, and where it stands in the messages.

use std::sync::Arc;

use muster_ros::definition::{Arity, Element};
use muster_ros::{Catalog, Layout, Place, TypeHash, TypeName};

use super::file::{Axes, DatumFile, LinksFile, PoseFile, RankFile};
use super::setup::{Content, PoseForm, Source};
use super::{ConfigError, wrong};
use crate::core::geometry::Geodetic;
use crate::template::Template;

pub(super) fn checked_frame(field: &str, frame: &str) -> Result<String, ConfigError> {
    let frame = frame.strip_prefix('/').unwrap_or(frame);
    if frame.is_empty() { Err(wrong(field, "must not be empty")) } else { Ok(frame.to_owned()) }
}

pub(super) fn source(
    catalog: &Catalog,
    topic: Template,
    type_name: &str,
    content: Content,
    field: &str,
) -> Result<Source, ConfigError> {
    let type_name = TypeName::parse(type_name).map_err(|error| wrong(field, error))?;
    let layout = catalog.layout(&type_name).map_err(|error| wrong(field, error))?;
    let hash = TypeHash::of(&layout);
    Ok(Source { topic, layout, hash, patterns: Vec::new(), content })
}

/// The topic of one robot each, and the layout of its type.
fn topic_of(
    catalog: &mut Catalog,
    topic: &str,
    type_name: &str,
    definition: Option<&str>,
    field: &dyn Fn(&str) -> String,
) -> Result<(Template, Arc<Layout>), ConfigError> {
    let topic = Template::new(topic).map_err(|error| wrong(field("topic"), error))?;
    if !topic.names_robot() {
        return Err(wrong(field("topic"), "must contain {robot}, which stands for the robot"));
    }
    let name = TypeName::parse(type_name).map_err(|error| wrong(field("type"), error))?;
    if let Some(text) = definition {
        catalog.add(&name, text).map_err(|error| wrong(field("definition"), error))?;
    }
    let layout = catalog.layout(&name).map_err(|error| {
        wrong(field("type"), format!("{error}; add its .msg text as definition"))
    })?;
    Ok((topic, layout))
}

fn place(layout: &Layout, path: &str, field: &str) -> Result<Place, ConfigError> {
    let path: muster_ros::Path = path.parse().map_err(|error| wrong(field, error))?;
    path.find(layout).map_err(|error| wrong(field, error))
}

impl PoseFile {
    pub(super) fn source(
        &self,
        catalog: &mut Catalog,
        field: &dyn Fn(&str) -> String,
    ) -> Result<Source, ConfigError> {
        let definition = self.definition.as_deref();
        let (topic, layout) = topic_of(catalog, &self.topic, &self.type_name, definition, field)?;
        let form = Box::new(self.form(&layout, field)?);
        let frame = self.frame.as_deref().map(|frame| checked_frame(&field("frame"), frame));
        let frame = frame.transpose()?;
        if matches!(*form, PoseForm::Fix { .. }) {
            // A fix says where it is on the earth: nothing of this could apply to it.
            let problem = "a satellite fix has none; leave it out";
            if self.frame.is_some() {
                return Err(wrong(field("frame"), problem));
            }
            if self.axes != Axes::default() {
                return Err(wrong(field("axes"), problem));
            }
        }
        if frame.is_none() && matches!(*form, PoseForm::Named { .. }) {
            return Err(wrong(field("frame"), "name the frame that the coordinates are in"));
        }
        if self.axes == Axes::NorthEastDown && frame.is_none() {
            let problem = "name the frame whose axes point east, north and up with the same origin";
            return Err(wrong(field("frame"), problem));
        }
        let hash = TypeHash::of(&layout);
        let content = Content::Pose { form, frame, axes: self.axes };
        Ok(Source { topic, layout, hash, patterns: Vec::new(), content })
    }

    fn form(
        &self,
        layout: &Layout,
        field: &dyn Fn(&str) -> String,
    ) -> Result<PoseForm, ConfigError> {
        let at = |path: &str| place(layout, path, &field("type"));
        if let Some(fields) = &self.fields {
            let at =
                |name: &str, path: &str| place(layout, path, &field(&format!("fields.{name}")));
            let height = fields.z.as_deref().map(|path| at("z", path)).transpose()?;
            let heading = fields.heading.as_deref().map(|path| at("heading", path)).transpose()?;
            let ground = [at("x", &fields.x)?, at("y", &fields.y)?];
            return Ok(PoseForm::Named { ground, height, heading });
        }
        let name = layout.name().to_string();
        let pose = match name.as_str() {
            "nav_msgs/msg/Odometry" | "geometry_msgs/msg/PoseWithCovarianceStamped" => "pose.pose",
            "geometry_msgs/msg/PoseStamped" => "pose",
            "sensor_msgs/msg/NavSatFix" => {
                let datum = self.datum.ok_or_else(|| {
                    wrong(field("datum"), "name the place that metres are counted from")
                })?;
                let DatumFile { latitude, longitude, altitude } = datum;
                let datum = Geodetic { latitude, longitude, altitude };
                if !datum.is_valid() {
                    return Err(wrong(field("datum"), "this is no place on the earth"));
                }
                let place = [at("latitude")?, at("longitude")?, at("altitude")?];
                return Ok(PoseForm::Fix { status: at("status.status")?, place, datum });
            }
            _ => {
                let problem = "say where the coordinates stand, as {x = \"x\", y = \"y\"}";
                return Err(wrong(field("fields"), problem));
            }
        };
        let position = |axis: &str| at(&format!("{pose}.position.{axis}"));
        let rotation = |axis: &str| at(&format!("{pose}.orientation.{axis}"));
        Ok(PoseForm::Framed {
            frame: at("header.frame_id")?,
            position: [position("x")?, position("y")?, position("z")?],
            rotation: [rotation("x")?, rotation("y")?, rotation("z")?, rotation("w")?],
        })
    }
}

impl LinksFile {
    pub(super) fn source(
        &self,
        catalog: &mut Catalog,
        field: &dyn Fn(&str) -> String,
    ) -> Result<Source, ConfigError> {
        let definition = self.definition.as_deref();
        let (topic, layout) = topic_of(catalog, &self.topic, &self.type_name, definition, field)?;
        let list = place(&layout, &self.list, &field("list"))?;
        let kind = list.kind();
        let Element::Nested(each) = &kind.element else {
            return Err(wrong(field("list"), "must be a list of messages, one for each link"));
        };
        if kind.arity == Arity::One {
            return Err(wrong(field("list"), "must be a list"));
        }
        let peer = place(each, &self.peer, &field("peer"))?;
        let quality = place(each, &self.quality, &field("quality"))?;
        let content = Content::Links { list, peer, quality, unit: self.unit };
        Ok(Source { topic, hash: TypeHash::of(&layout), layout, patterns: Vec::new(), content })
    }
}

impl RankFile {
    pub(super) fn source(
        &self,
        catalog: &mut Catalog,
        field: &dyn Fn(&str) -> String,
    ) -> Result<Source, ConfigError> {
        let definition = self.definition.as_deref();
        let (topic, layout) = topic_of(catalog, &self.topic, &self.type_name, definition, field)?;
        let superior = place(&layout, &self.superior, &field("superior"))?;
        let content = Content::Rank { superior };
        Ok(Source { topic, hash: TypeHash::of(&layout), layout, patterns: Vec::new(), content })
    }
}
