//! Keys of topics, in both dialects.

use std::fmt;

use crate::hash::TypeHash;
use crate::name::{NameError, TopicName, TypeName};

/// Largest number of a domain that ROS allows.
pub const MAX_DOMAIN: u32 = 232;

/// How ROS 2 comes to the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Dialect {
    /// Every program of ROS is on the bus itself.
    RmwZenoh,
    /// A bridge forwards the topics of DDS under their names.
    Ros2Dds,
}

/// Its name in configurations.
impl fmt::Display for Dialect {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::RmwZenoh => "rmw_zenoh",
            Self::Ros2Dds => "ros2dds",
        })
    }
}

/// Why a text is no key of a topic.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum KeyError {
    /// There are too few parts.
    #[error("a key of rmw_zenoh has the form DOMAIN/TOPIC/TYPE/HASH")]
    Parts,
    /// The domain is no number that ROS allows.
    #[error("a domain is a whole number from 0 to {MAX_DOMAIN}")]
    Domain,
    /// The topic is none.
    #[error("topic: {0}")]
    Topic(NameError),
    /// The type is that of no message.
    #[error("type: {0}")]
    Type(NameError),
    /// The hash is none.
    #[error(transparent)]
    Hash(#[from] crate::hash::HashError),
}

/// Reads the number of a domain: digits without a leading zero.
pub(crate) fn parse_domain(text: &str) -> Option<u32> {
    let domain: u32 = text.parse().ok()?;
    (domain <= MAX_DOMAIN && domain.to_string() == text).then_some(domain)
}

/// The key of a topic with `rmw_zenoh`: `DOMAIN/TOPIC/TYPE/HASH`. Topics of another type or hash are other keys, so that
/// a subscription to them receives nothing.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TopicKey {
    /// The domain, `ROS_DOMAIN_ID`.
    pub domain: u32,
    /// The topic with its namespace.
    pub topic: TopicName,
    /// The type of the messages.
    pub type_name: TypeName,
    /// The hash of the type, as the publisher has it.
    pub hash: TypeHash,
}

impl TopicKey {
    /// Reads the text of a key.
    ///
    /// # Errors
    /// Names the part that is wrong. The keys of services have another type.
    pub fn parse(text: &str) -> Result<Self, KeyError> {
        let (domain, rest) = text.split_once('/').ok_or(KeyError::Parts)?;
        let (rest, hash) = rest.rsplit_once('/').ok_or(KeyError::Parts)?;
        let (topic, type_name) = rest.rsplit_once('/').ok_or(KeyError::Parts)?;
        Ok(Self {
            domain: parse_domain(domain).ok_or(KeyError::Domain)?,
            topic: topic_of(topic)?,
            type_name: TypeName::from_dds(type_name).map_err(KeyError::Type)?,
            hash: hash.parse()?,
        })
    }
}

impl fmt::Display for TopicKey {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { domain, topic, type_name, hash } = self;
        write!(formatter, "{domain}/{}/{}/{hash}", topic.as_str(), type_name.to_dds())
    }
}

/// The key of a topic with `zenoh-bridge-ros2dds`: the namespace of the bridge, if it has one, and the topic.
#[must_use]
pub fn dds_key(namespace: Option<&TopicName>, topic: &TopicName) -> String {
    match namespace {
        Some(namespace) => format!("{}/{}", namespace.as_str(), topic.as_str()),
        None => topic.as_str().to_owned(),
    }
}

/// The topic that such a key stands for, with the namespace in it.
///
/// # Errors
/// If the text is no topic.
pub fn parse_dds_key(text: &str) -> Result<TopicName, KeyError> {
    topic_of(text)
}

/// A topic as it stands in a key: without outer slashes.
fn topic_of(text: &str) -> Result<TopicName, KeyError> {
    let topic = TopicName::new(text).map_err(KeyError::Topic)?;
    if topic.as_str().len() == text.len() {
        Ok(topic)
    } else {
        Err(KeyError::Topic(NameError::Empty))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHATTER: &str = "7/cell4/chatter/std_msgs::msg::dds_::String_/\
         RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

    #[test]
    fn keys_of_rmw_zenoh_are_read_and_written_alike() {
        let humble = "0/odom/nav_msgs::msg::dds_::Odometry_/TypeHashNotSupported";
        for text in [CHATTER, humble] {
            assert_eq!(TopicKey::parse(text).unwrap().to_string(), text);
        }
        let key = TopicKey::parse(CHATTER).unwrap();
        assert_eq!((key.domain, key.topic.as_str()), (7, "cell4/chatter"));
        assert_eq!(key.type_name.to_string(), "std_msgs/msg/String");
        assert_eq!(TopicKey::parse(humble).unwrap().hash, TypeHash::NotSupported);
    }

    #[test]
    fn what_is_no_key_of_a_topic_is_refused() {
        let hash = CHATTER.rsplit_once('/').unwrap().1;
        let with =
            |domain: &str, topic: &str, name: &str| format!("{domain}/{topic}/{name}/{hash}");
        let string = "std_msgs::msg::dds_::String_";
        assert!(TopicKey::parse(&with("0", "a/b/c", string)).is_ok());
        for wrong in [
            with("", "a", string),
            with("00", "a", string),
            with("+1", "a", string),
            with("233", "a", string),
            with("4294967296", "a", string),
            with("x", "a", string),
            with("0", "", string),
            with("0", "/a", string),
            with("0", "a/", string),
            with("0", "a*", string),
            with("0", "a", "a::srv::dds_::B_"),
            with("0", "a", "String"),
            format!("0/a/{string}/RIHS01_"),
            format!("0/a/{string}"),
            "0".to_owned(),
            String::new(),
        ] {
            assert!(TopicKey::parse(&wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn keys_of_the_bridge_are_names_of_topics() {
        let topic = TopicName::new("/robot_1/odom").unwrap();
        assert_eq!(dds_key(None, &topic), "robot_1/odom");
        let namespace = TopicName::new("/site").unwrap();
        assert_eq!(dds_key(Some(&namespace), &topic), "site/robot_1/odom");
        assert_eq!(parse_dds_key("robot_1/odom"), Ok(topic));
        for wrong in ["", "/odom", "odom/", "a//b", "@/x"] {
            assert!(parse_dds_key(wrong).is_err(), "{wrong}");
        }
    }
}
