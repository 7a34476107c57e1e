//! A message with its type, to be filled in by the names of its fields.

use std::sync::Arc;

use crate::catalog::{Catalog, LayoutError};
use crate::cdr::{self, ByteOrder, CdrError};
use crate::layout::Layout;
use crate::name::{NameError, TypeName};
use crate::path::{Path, PathError};
use crate::value::Value;

/// Why a message is not made.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MessageError {
    /// The text names no type.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The type has no layout.
    #[error(transparent)]
    Layout(#[from] LayoutError),
    /// The type has no such field.
    #[error(transparent)]
    Path(#[from] PathError),
}

/// A message with its type.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    layout: Arc<Layout>,
    value: Value,
}

impl Message {
    /// A message whose fields have their defaults.
    ///
    /// # Errors
    /// If the text names no type of the catalog.
    pub fn new(catalog: &Catalog, type_name: &str) -> Result<Self, MessageError> {
        let layout = catalog.layout(&TypeName::parse(type_name)?)?;
        Ok(Self { value: layout.initial(), layout })
    }

    /// The type.
    #[must_use]
    pub fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    /// Its fields.
    #[must_use]
    pub fn value(&self) -> &Value {
        &self.value
    }

    /// Its fields, by value: to be a part of another message.
    #[must_use]
    pub fn into_value(self) -> Value {
        self.value
    }

    /// Sets a field.
    ///
    /// # Errors
    /// If the type has no such field. Whether the value is one of the field is seen by [`Message::encode`].
    pub fn set(&mut self, path: &str, value: impl Into<Value>) -> Result<(), MessageError> {
        let place = path.parse::<Path>()?.find(&self.layout)?;
        let field = place.get_mut(&mut self.value);
        *field.ok_or_else(|| PathError::NoList(path.to_owned()))? = value.into();
        Ok(())
    }

    /// The message as bytes, little-endian, as ROS writes them.
    ///
    /// # Errors
    /// If a value is none of its field, or the message is too long.
    pub fn encode(&self) -> Result<Vec<u8>, CdrError> {
        cdr::encode(&self.layout, &self.value, ByteOrder::Little)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_filled_in_by_names() {
        let catalog = Catalog::standard();
        let mut message = Message::new(&catalog, "std_msgs/String").unwrap();
        message.set("data", "ab").unwrap();
        assert_eq!(message.encode().unwrap(), [0, 1, 0, 0, 3, 0, 0, 0, b'a', b'b', 0]);
        assert!(message.set("text", "ab").unwrap_err().to_string().contains("it has data"));
        message.set("data", 7).unwrap();
        assert!(message.encode().unwrap_err().to_string().starts_with("data: "));
        assert!(Message::new(&catalog, "std_msgs/Text").is_err());
        let mut odometry = Message::new(&catalog, "nav_msgs/Odometry").unwrap();
        odometry.set("pose.covariance[7]", 0.5).unwrap();
        let tf = Message::new(&catalog, "tf2_msgs/TFMessage").unwrap();
        assert!(tf.clone().set("transforms[0].child_frame_id", "a").is_err(), "there is none");
    }
}
