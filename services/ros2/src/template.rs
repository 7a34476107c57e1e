//! Topics with `{robot}` in them, which stands for one part of the name.

use std::fmt;

use muster_ros::{NameError, TopicName};

/// What stands for the robot.
const ROBOT: &str = "{robot}";

/// A topic, or one for each robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Template {
    /// What stands before and behind the robot; one part alone where no robot is named.
    before: String,
    behind: Option<String>,
}

impl Template {
    /// Reads a topic, in which one part between slashes may be `{robot}`.
    ///
    /// # Errors
    /// If it is no topic with any robot in its place.
    pub fn new(text: &str) -> Result<Self, NameError> {
        // A name that is allowed stands in for the robot.
        let topic = TopicName::new(&text.replacen(ROBOT, "_", 1))?;
        let length = topic.as_str().len();
        let inner = text.strip_prefix('/').unwrap_or(text);
        let inner = inner.strip_suffix('/').unwrap_or(inner);
        match inner.split_once(ROBOT) {
            None => Ok(Self { before: inner[..length].to_owned(), behind: None }),
            Some((before, behind)) => {
                let is_whole = (before.is_empty() || before.ends_with('/'))
                    && (behind.is_empty() || behind.starts_with('/'));
                if !is_whole {
                    return Err(NameError::Identifier);
                }
                Ok(Self { before: before.to_owned(), behind: Some(behind.to_owned()) })
            }
        }
    }

    /// Whether a robot is named.
    #[must_use]
    pub fn names_robot(&self) -> bool {
        self.behind.is_some()
    }

    /// The topic without the slash at its begin, with a text for the robot: a name, or a wildcard.
    #[must_use]
    pub fn with(&self, robot: &str) -> String {
        match &self.behind {
            Some(behind) => format!("{}{robot}{behind}", self.before),
            None => self.before.clone(),
        }
    }

    /// The robot that a topic without the slash at its begin names; an empty text where no robot is named, and none if
    /// it is another topic.
    #[must_use]
    pub fn robot_of<'a>(&self, topic: &'a str) -> Option<&'a str> {
        match &self.behind {
            None => (topic == self.before).then_some(""),
            Some(behind) => {
                let robot =
                    topic.strip_prefix(self.before.as_str())?.strip_suffix(behind.as_str())?;
                (!robot.is_empty() && !robot.contains('/')).then_some(robot)
            }
        }
    }
}

impl fmt::Display for Template {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "/{}", self.with(ROBOT))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_part_stands_for_the_robot() {
        let odom = Template::new("/{robot}/odom").unwrap();
        assert_eq!((odom.with("*"), odom.with("r1")), ("*/odom".to_owned(), "r1/odom".to_owned()));
        assert_eq!(odom.robot_of("r1/odom"), Some("r1"));
        for other in ["odom", "/odom", "a/b/odom", "r1/odom/x", "r1/pose", ""] {
            assert_eq!(odom.robot_of(other), None, "{other}");
        }
        let deep = Template::new("/site/{robot}/a/b/").unwrap();
        assert_eq!(deep.robot_of("site/r1/a/b"), Some("r1"));
        assert_eq!(deep.to_string(), "/site/{robot}/a/b");
        let shared = Template::new("/tf").unwrap();
        assert!(!shared.names_robot());
        assert_eq!((shared.robot_of("tf"), shared.robot_of("tf_static")), (Some(""), None));
        assert_eq!(Template::new("{robot}").unwrap().robot_of("r1"), Some("r1"));
        for wrong in ["", "/", "/x{robot}/odom", "/{robot}x", "/{robot}/{robot}", "/a b/{robot}"] {
            assert!(Template::new(wrong).is_err(), "{wrong}");
        }
    }
}
