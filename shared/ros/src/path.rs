//! Fields of a message by their path, such as `pose.pose.position.x` or `links[0].rssi`.

use std::fmt;
use std::sync::Arc;

use crate::definition::{Arity, Element, FieldType};
use crate::layout::Layout;
use crate::name::{NameError, check_identifier};
use crate::value::Value;

/// Longest path in steps: deeper than types may be.
pub const MAX_STEPS: usize = 64;

/// One step of a path.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Step {
    /// To the field of this name.
    Field(String),
    /// To this value of an array or sequence, from 0.
    Index(usize),
}

/// The way to a field.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Path(Vec<Step>);

/// Why a path leads nowhere.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PathError {
    /// It has another form.
    #[error("a path has the form FIELD.FIELD or FIELD[0].FIELD")]
    Form,
    /// A part is no name of a field.
    #[error(transparent)]
    Name(#[from] NameError),
    /// A type has no such field.
    #[error("{type_name} has no field {field}; it has {known}")]
    Unknown {
        /// The type.
        type_name: String,
        /// The field.
        field: String,
        /// The fields that it has.
        known: String,
    },
    /// It goes on behind a value without fields, or into a list without an index.
    #[error("{0} is no single message with fields; a value of a list is taken as {0}[0]")]
    NoFields(String),
    /// It takes a value of what is no list, or beyond the end of an array.
    #[error("{0} is no list with so many values")]
    NoList(String),
}

impl std::str::FromStr for Path {
    type Err = PathError;

    fn from_str(text: &str) -> Result<Self, PathError> {
        let mut steps = Vec::new();
        for part in text.split('.') {
            let (name, mut rest) = part.split_at(part.find('[').unwrap_or(part.len()));
            check_identifier(name)?;
            steps.push(Step::Field(name.to_owned()));
            while let Some(inner) = rest.strip_prefix('[') {
                let (index, after) = inner.split_once(']').ok_or(PathError::Form)?;
                steps.push(Step::Index(index.parse().map_err(|_| PathError::Form)?));
                rest = after;
            }
            if !rest.is_empty() {
                return Err(PathError::Form);
            }
        }
        if steps.len() > MAX_STEPS { Err(PathError::Form) } else { Ok(Self(steps)) }
    }
}

impl fmt::Display for Path {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (number, step) in self.0.iter().enumerate() {
            match step {
                Step::Field(name) if number == 0 => formatter.write_str(name)?,
                Step::Field(name) => write!(formatter, ".{name}")?,
                Step::Index(index) => write!(formatter, "[{index}]")?,
            }
        }
        Ok(())
    }
}

/// A path in a message type: where to look, without names.
#[derive(Debug, Clone, PartialEq)]
pub struct Place {
    steps: Vec<usize>,
    kind: FieldType<Arc<Layout>>,
}

impl Path {
    /// Finds the path in a type.
    ///
    /// # Errors
    /// Names the part that the type does not have.
    pub fn find(&self, layout: &Layout) -> Result<Place, PathError> {
        let mut within = Some(layout);
        let mut found: Option<&FieldType<Arc<Layout>>> = None;
        let mut arity = Arity::One;
        let mut steps = Vec::with_capacity(self.0.len());
        for (number, step) in self.0.iter().enumerate() {
            let so_far = || Self(self.0[..number].to_vec()).to_string();
            match step {
                Step::Field(name) => {
                    let layout = match (within, arity) {
                        (Some(layout), Arity::One) => layout,
                        _ => return Err(PathError::NoFields(so_far())),
                    };
                    let at = layout.fields().iter().position(|field| field.name == *name);
                    let at = at.ok_or_else(|| unknown(layout, name))?;
                    let kind = &layout.fields()[at].kind;
                    steps.push(at);
                    (found, arity, within) = (Some(kind), kind.arity, nested(&kind.element));
                }
                Step::Index(index) => {
                    let length = match arity {
                        Arity::One => 0,
                        Arity::Array(length) => length as usize,
                        Arity::Sequence { bound } => {
                            bound.map_or(usize::MAX, |bound| bound as usize)
                        }
                    };
                    if *index >= length {
                        return Err(PathError::NoList(so_far()));
                    }
                    steps.push(*index);
                    arity = Arity::One;
                }
            }
        }
        let element = found.map(|kind| kind.element.clone()).ok_or(PathError::Form)?;
        Ok(Place { steps, kind: FieldType { element, arity } })
    }
}

fn nested(element: &Element<Arc<Layout>>) -> Option<&Layout> {
    if let Element::Nested(layout) = element { Some(layout) } else { None }
}

fn unknown(layout: &Layout, field: &str) -> PathError {
    let known: Vec<_> = layout.fields().iter().map(|field| field.name.as_str()).collect();
    PathError::Unknown {
        type_name: layout.name().to_string(),
        field: field.to_owned(),
        known: known.join(", "),
    }
}

impl Place {
    /// What stands there.
    #[must_use]
    pub fn kind(&self) -> &FieldType<Arc<Layout>> {
        &self.kind
    }

    /// The value of a message; none if a sequence is too short. Bytes are not taken apart.
    #[must_use]
    pub fn get<'a>(&self, message: &'a Value) -> Option<&'a Value> {
        self.steps.iter().try_fold(message, |value, step| match value {
            Value::Struct(values) | Value::List(values) => values.get(*step),
            _ => None,
        })
    }

    /// The value of a message, to be changed.
    #[must_use]
    pub fn get_mut<'a>(&self, message: &'a mut Value) -> Option<&'a mut Value> {
        self.steps.iter().try_fold(message, |value, step| match value {
            Value::Struct(values) | Value::List(values) => values.get_mut(*step),
            _ => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalog::Catalog;
    use crate::name::TypeName;

    fn layout(name: &str) -> Arc<Layout> {
        Catalog::standard().layout(&TypeName::parse(name).unwrap()).unwrap()
    }

    fn find(name: &str, path: &str) -> Result<Place, PathError> {
        path.parse::<Path>()?.find(&layout(name))
    }

    #[test]
    fn paths_lead_to_fields_and_values_of_lists() {
        let layout = layout("nav_msgs/Odometry");
        let mut odometry = layout.initial();
        let place = find("nav_msgs/Odometry", "pose.pose.position.x").unwrap();
        *place.get_mut(&mut odometry).unwrap() = Value::F64(2.5);
        assert_eq!(place.get(&odometry), Some(&Value::F64(2.5)));
        let last = find("nav_msgs/Odometry", "pose.covariance[35]").unwrap();
        assert_eq!(last.get(&odometry), Some(&Value::F64(0.0)));
        assert_eq!(last.kind().arity, Arity::One);
        let stamped = find("tf2_msgs/TFMessage", "transforms[3].child_frame_id").unwrap();
        let empty = Value::Struct(vec![Value::List(Vec::new())]);
        assert_eq!(stamped.get(&empty), None, "the sequence is too short");
    }

    #[test]
    fn what_a_type_does_not_have_is_named() {
        let odometry = "nav_msgs/Odometry";
        let error = find(odometry, "pose.position").unwrap_err().to_string();
        let expected =
            "geometry_msgs/msg/PoseWithCovariance has no field position; it has pose, covariance";
        assert_eq!(error, expected);
        for (path, place) in
            [("pose.covariance.x", "pose.covariance"), ("child_frame_id.x", "child_frame_id")]
        {
            assert_eq!(find(odometry, path), Err(PathError::NoFields(place.to_owned())));
        }
        for (path, place) in [("pose[0]", "pose"), ("pose.covariance[36]", "pose.covariance")] {
            assert_eq!(find(odometry, path), Err(PathError::NoList(place.to_owned())));
        }
        assert_eq!(
            find("tf2_msgs/TFMessage", "transforms.header"),
            Err(PathError::NoFields("transforms".to_owned()))
        );
        for wrong in
            ["", ".", "a.", "a[", "a[x]", "a[-1]", "a[0]b", "[0]", "a[99999999999999999999]"]
        {
            assert!(wrong.parse::<Path>().is_err(), "{wrong}");
        }
        assert_eq!("a[1][2].b".parse::<Path>().unwrap().to_string(), "a[1][2].b");
        assert!(vec!["a"; MAX_STEPS + 1].join(".").parse::<Path>().is_err());
    }
}
