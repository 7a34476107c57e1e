//! Names of message types and of topics.

use std::fmt;

/// Longest name of a package, type, field or topic in bytes, as in ROS.
pub const MAX_NAME_BYTES: usize = 255;

/// Why a text is no name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    /// The text has no character.
    #[error("a name must not be empty")]
    Empty,
    /// The text has more than [`MAX_NAME_BYTES`] bytes.
    #[error("a name may have at most {MAX_NAME_BYTES} bytes, this has {0}")]
    TooLong(usize),
    /// A part of the text is no identifier.
    #[error(
        "each part of a name begins with a letter or _, and goes on with letters, digits and _"
    )]
    Identifier,
    /// The text does not name a message type.
    #[error("a message type has the form PACKAGE/msg/TYPE")]
    Type,
}

/// Checks an identifier: `[A-Za-z_][A-Za-z0-9_]*`, at most [`MAX_NAME_BYTES`].
///
/// # Errors
/// Says which rule the text breaks.
pub fn check_identifier(text: &str) -> Result<(), NameError> {
    if text.is_empty() {
        return Err(NameError::Empty);
    }
    if text.len() > MAX_NAME_BYTES {
        return Err(NameError::TooLong(text.len()));
    }
    let is_first = |c: char| c.is_ascii_alphabetic() || c == '_';
    let is_other = |c: char| c.is_ascii_alphanumeric() || c == '_';
    if text.starts_with(is_first) && text.chars().all(is_other) {
        Ok(())
    } else {
        Err(NameError::Identifier)
    }
}

/// The type of a message, such as `nav_msgs/msg/Odometry`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TypeName {
    package: String,
    name: String,
}

impl TypeName {
    /// The type of a name in a package.
    ///
    /// # Errors
    /// If one of them is no identifier.
    pub fn new(package: &str, name: &str) -> Result<Self, NameError> {
        check_identifier(package)?;
        check_identifier(name)?;
        Ok(Self { package: package.to_owned(), name: name.to_owned() })
    }

    /// Reads `PACKAGE/msg/TYPE`, or the short form `PACKAGE/TYPE`.
    ///
    /// # Errors
    /// If the text has neither form.
    pub fn parse(text: &str) -> Result<Self, NameError> {
        let parts: Vec<&str> = text.splitn(4, '/').collect();
        match parts[..] {
            [package, "msg", name] | [package, name] => Self::new(package, name),
            _ => Err(NameError::Type),
        }
    }

    /// Reads the form of keys, `PACKAGE::msg::dds_::TYPE_`.
    ///
    /// # Errors
    /// If the text has another form, as that of a service has.
    pub fn from_dds(text: &str) -> Result<Self, NameError> {
        let (package, name) = text.split_once("::msg::dds_::").ok_or(NameError::Type)?;
        Self::new(package, name.strip_suffix('_').ok_or(NameError::Type)?)
    }

    /// The form of keys, `PACKAGE::msg::dds_::TYPE_`.
    #[must_use]
    pub fn to_dds(&self) -> String {
        format!("{}::msg::dds_::{}_", self.package, self.name)
    }

    /// Its package.
    #[must_use]
    pub fn package(&self) -> &str {
        &self.package
    }

    /// Its name within the package.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }
}

impl fmt::Display for TypeName {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}/msg/{}", self.package, self.name)
    }
}

impl std::str::FromStr for TypeName {
    type Err = NameError;

    fn from_str(text: &str) -> Result<Self, NameError> {
        Self::parse(text)
    }
}

/// A topic with its namespace, such as `robot_1/odom`. It is kept without the slash at its begin.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TopicName(String);

impl TopicName {
    /// Checks and wraps a name, with or without slashes at its ends.
    ///
    /// # Errors
    /// If a part between slashes is no identifier, or the name is too long.
    pub fn new(text: &str) -> Result<Self, NameError> {
        let inner = text.strip_prefix('/').unwrap_or(text);
        let inner = inner.strip_suffix('/').unwrap_or(inner);
        if inner.len() > MAX_NAME_BYTES {
            return Err(NameError::TooLong(inner.len()));
        }
        inner.split('/').try_for_each(check_identifier)?;
        Ok(Self(inner.to_owned()))
    }

    /// The name without the slash at its begin.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// The form that ROS shows: with the slash at its begin.
impl fmt::Display for TopicName {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "/{}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_of_a_type_names_the_same_type() {
        let odometry = TypeName::new("nav_msgs", "Odometry").unwrap();
        for text in ["nav_msgs/msg/Odometry", "nav_msgs/Odometry"] {
            assert_eq!(TypeName::parse(text).as_ref(), Ok(&odometry));
        }
        assert_eq!(odometry.to_dds(), "nav_msgs::msg::dds_::Odometry_");
        assert_eq!(TypeName::from_dds(&odometry.to_dds()).as_ref(), Ok(&odometry));
        assert_eq!(odometry.to_string(), "nav_msgs/msg/Odometry");
        for wrong in ["", "Odometry", "a/srv/B", "a/msg/B/c", "a/msg/", "1a/B", "a b/C", "a/b::C"] {
            assert!(TypeName::parse(wrong).is_err(), "{wrong}");
        }
        for wrong in ["a::srv::dds_::B_", "a::msg::dds_::B", "a::msg::dds_::_", "::msg::dds_::B_"] {
            assert!(TypeName::from_dds(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn the_order_of_types_is_that_of_their_texts() {
        let texts = ["a/msg/B", "a/msg/C", "a_b/msg/A", "aa/msg/A", "a1/msg/A"];
        let mut types: Vec<_> = texts.iter().map(|text| TypeName::parse(text).unwrap()).collect();
        types.sort();
        let mut texts = texts.map(str::to_owned);
        texts.sort();
        assert_eq!(types.iter().map(TypeName::to_string).collect::<Vec<_>>(), texts);
    }

    #[test]
    fn topics_are_kept_without_outer_slashes() {
        for text in ["/robot_1/odom", "robot_1/odom", "robot_1/odom/"] {
            let topic = TopicName::new(text).unwrap();
            assert_eq!(
                (topic.as_str(), topic.to_string().as_str()),
                ("robot_1/odom", "/robot_1/odom")
            );
        }
        for wrong in ["", "/", "//odom", "a//b", "a/*", "a b", "a/1b", "a$b", "a?b", "é"] {
            assert!(TopicName::new(wrong).is_err(), "{wrong}");
        }
        assert_eq!(TopicName::new(&"a".repeat(256)), Err(NameError::TooLong(256)));
    }
}
