//! From the file to the setup: every field is checked.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use muster_model::id::RobotId;
use muster_ros::key::MAX_DOMAIN;
use muster_ros::{Catalog, Dialect, TopicName, TypeName};
use muster_wire::ForeignPattern;
use muster_wire::foreign::ForeignKeyError;

use super::file::{File, PublishFile};
use super::setup::{Content, PublishTopics, Setup, Source};
use super::sources::{checked_frame, source};
use super::{ConfigError, MAX_DOMAINS, MAX_RATE_HZ, MAX_TOPICS, wrong};
use crate::template::Template;

/// Messages of our own, as those who have ROS build them.
const OWN_MESSAGES: [(&str, &str); 2] = [
    ("muster_msgs/Team", include_str!("../../../../deploy/ros2/muster_msgs/msg/Team.msg")),
    ("muster_msgs/Teams", include_str!("../../../../deploy/ros2/muster_msgs/msg/Teams.msg")),
];

impl File {
    /// Checks the file.
    ///
    /// # Errors
    /// Names the field that is wrong, and what would be right.
    pub fn check(&self) -> Result<Setup, ConfigError> {
        let dialect = Dialect::from(self.dialect);
        let mut catalog = Catalog::standard();
        for (name, text) in OWN_MESSAGES {
            let name =
                TypeName::parse(name).map_err(|error| wrong("publish.typed_teams", error))?;
            catalog.add(&name, text).map_err(|error| wrong("publish.typed_teams", error))?;
        }
        let (is_shared, mut sources) = self.transforms(&catalog)?;
        for (number, pose) in self.pose.iter().enumerate() {
            let field = |name: &str| format!("pose[{number}].{name}");
            sources.push(pose.source(&mut catalog, &field)?);
        }
        for (number, links) in self.links.iter().enumerate() {
            let field = |name: &str| format!("links[{number}].{name}");
            sources.push(links.source(&mut catalog, &field)?);
        }
        for (number, rank) in self.rank.iter().enumerate() {
            let field = |name: &str| format!("rank[{number}].{name}");
            sources.push(rank.source(&mut catalog, &field)?);
        }
        let lists =
            [("pose", self.pose.len()), ("links", self.links.len()), ("rank", self.rank.len())];
        if let Some((field, _)) = lists.into_iter().find(|(_, count)| *count > MAX_TOPICS) {
            return Err(wrong(field, format!("there may be at most {MAX_TOPICS} topics")));
        }
        let namespace = self.namespace.as_deref().map(TopicName::new).transpose();
        let namespace = namespace.map_err(|error| wrong("namespace", error))?;
        if namespace.is_some() && dialect == Dialect::RmwZenoh {
            return Err(wrong("namespace", "rmw_zenoh has none; write it into the topics"));
        }
        let domains = self.checked_domains(dialect)?;
        for (source, field) in sources.iter_mut().zip(self.topic_fields()) {
            source.patterns = patterns(dialect, &domains, namespace.as_ref(), source)
                .map_err(|error| wrong(field, error))?;
        }
        Ok(Setup {
            dialect,
            domains,
            type_hashes: self.type_hashes,
            namespace,
            every: self.every()?,
            world: checked_frame("world", &self.world)?,
            frame: self.frame.clone(),
            prefix: is_shared.then(|| self.frames.prefix.clone()),
            max_age: checked_seconds("frames.max_age_s", self.frames.max_age_s)?,
            sources,
            ranks: self.checked_ranks()?,
            publish: self.publish.check()?,
            catalog,
        })
    }

    /// The fields with the topics of all sources, in their order.
    fn topic_fields(&self) -> impl Iterator<Item = String> {
        let lists =
            [("pose", self.pose.len()), ("links", self.links.len()), ("rank", self.rank.len())];
        let each = |(list, count)| (0..count).map(move |number| format!("{list}[{number}].topic"));
        let frames = ["frames.tf", "frames.tf_static"].map(str::to_owned);
        frames.into_iter().chain(lists.into_iter().flat_map(each))
    }

    fn checked_domains(&self, dialect: Dialect) -> Result<Vec<u32>, ConfigError> {
        if dialect == Dialect::Ros2Dds {
            return Ok(vec![0]);
        }
        if self.domains.is_empty() || self.domains.len() > MAX_DOMAINS {
            return Err(wrong("domains", format!("name from 1 to {MAX_DOMAINS}")));
        }
        if let Some(domain) = self.domains.iter().find(|domain| **domain > MAX_DOMAIN) {
            let problem = format!("{domain} is none; they go from 0 to {MAX_DOMAIN}");
            return Err(wrong("domains", problem));
        }
        // Each message would come twice, and be put twice.
        let mut seen = BTreeSet::new();
        match self.domains.iter().find(|domain| !seen.insert(**domain)) {
            Some(domain) => Err(wrong("domains", format!("{domain} is named twice; name it once"))),
            None => Ok(self.domains.clone()),
        }
    }

    fn every(&self) -> Result<Duration, ConfigError> {
        if (0.1..=MAX_RATE_HZ).contains(&self.rate_hz) {
            Ok(Duration::from_secs_f64(1.0 / self.rate_hz))
        } else {
            Err(wrong("rate_hz", format!("must lie from 0.1 to {MAX_RATE_HZ}")))
        }
    }

    fn checked_ranks(&self) -> Result<BTreeMap<RobotId, Option<RobotId>>, ConfigError> {
        let superior = |(robot, superior): (&RobotId, &String)| {
            let field = || format!("ranks.{robot}");
            let superior = (!superior.is_empty()).then(|| RobotId::new(superior)).transpose();
            let superior = superior.map_err(|error| wrong(field(), error))?;
            if superior.as_ref() == Some(robot) {
                return Err(wrong(field(), "a robot is not its own superior"));
            }
            Ok((robot.clone(), superior))
        };
        self.ranks.iter().map(superior).collect()
    }

    /// The topics of transforms, and whether all robots share them.
    fn transforms(&self, catalog: &Catalog) -> Result<(bool, Vec<Source>), ConfigError> {
        let mut sources = Vec::new();
        let mut shared = Vec::new();
        let topics = [("frames.tf", &self.frames.tf), ("frames.tf_static", &self.frames.tf_static)];
        for (field, topic) in topics {
            let topic = Template::new(topic).map_err(|error| wrong(field, error))?;
            shared.push(!topic.names_robot());
            let is_static = field.ends_with("static");
            let content = Content::Transforms { is_static };
            sources.push(source(catalog, topic, "tf2_msgs/msg/TFMessage", content, field)?);
        }
        // A transform that changes would hold for good.
        if sources[0].topic == sources[1].topic {
            let problem = "is the topic of frames.tf; name another one";
            return Err(wrong("frames.tf_static", problem));
        }
        if shared[0] != shared[1] {
            let problem = "both topics name {robot}, or neither";
            return Err(wrong("frames.tf_static", problem));
        }
        if shared[0] && !self.frames.prefix.contains("{robot}") {
            return Err(wrong(
                "frames.prefix",
                "must contain {robot}: frames of robots that share a topic have the robot's name in them",
            ));
        }
        Ok((shared[0], sources))
    }
}

impl PublishFile {
    fn check(&self) -> Result<PublishTopics, ConfigError> {
        let topic = |field: &str, text: &Option<String>| {
            let topic = text.as_deref().filter(|text| !text.is_empty()).map(TopicName::new);
            topic.transpose().map_err(|error| wrong(format!("publish.{field}"), error))
        };
        let team = self.team.as_deref().filter(|text| !text.is_empty()).map(Template::new);
        let team = team.transpose().map_err(|error| wrong("publish.team", error))?;
        if team.as_ref().is_some_and(|team| !team.names_robot()) {
            return Err(wrong("publish.team", "must contain {robot}, which stands for the robot"));
        }
        let topics = PublishTopics {
            teams: topic("teams", &self.teams)?,
            typed_teams: topic("typed_teams", &self.typed_teams)?,
            team,
            diagnostics: topic("diagnostics", &self.diagnostics)?,
            markers: topic("markers", &self.markers)?,
        };
        topics.check_apart()?;
        Ok(topics)
    }
}

impl PublishTopics {
    /// Refuses two topics of one name: a publisher has one type, and readers could not tell their messages apart.
    fn check_apart(&self) -> Result<(), ConfigError> {
        let topics = [
            ("teams", &self.teams),
            ("typed_teams", &self.typed_teams),
            ("diagnostics", &self.diagnostics),
            ("markers", &self.markers),
        ];
        let mut seen = BTreeMap::new();
        for (field, topic) in topics {
            let Some(topic) = topic else { continue };
            let of_robot = self.team.as_ref().and_then(|team| team.robot_of(topic.as_str()));
            let problem = match (seen.insert(topic, field), of_robot) {
                (Some(other), _) => format!("is the topic of publish.{other}"),
                (None, Some(robot)) => format!("is the topic of publish.team for a robot {robot}"),
                (None, None) => continue,
            };
            let remedy = "name another one, or leave it empty to publish one of them only";
            return Err(wrong(format!("publish.{field}"), format!("{problem}; {remedy}")));
        }
        Ok(())
    }
}

/// The key expressions of a source.
fn patterns(
    dialect: Dialect,
    domains: &[u32],
    namespace: Option<&TopicName>,
    source: &Source,
) -> Result<Vec<ForeignPattern>, ForeignKeyError> {
    let robots = source.topic.with("*");
    match dialect {
        Dialect::RmwZenoh => {
            let type_name = source.layout.name().to_dds();
            let text = |domain| format!("{domain}/{robots}/{type_name}/*");
            domains.iter().map(text).map(ForeignPattern::new).collect()
        }
        Dialect::Ros2Dds => {
            let text = match namespace {
                Some(namespace) => format!("{}/{robots}", namespace.as_str()),
                None => robots,
            };
            Ok(vec![ForeignPattern::new(text)?])
        }
    }
}

fn checked_seconds(field: &str, seconds: f64) -> Result<Duration, ConfigError> {
    if (0.01..=3600.0).contains(&seconds) {
        Ok(Duration::from_secs_f64(seconds))
    } else {
        Err(wrong(field, "must lie from 0.01 to 3600"))
    }
}
