//! What is wrong where robots run ROS 2: routers that do not suit them, and topics that a bridge refuses.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use muster_client::RouterState;
use muster_model::bridge::{BridgeState, RefusedTopic, TopicFault};

use super::{Finding, warning};
use crate::show::page::names;

/// The lease that the router and the sessions of ROS announce by default (`DEFAULT_RMW_ZENOH_ROUTER_CONFIG.json5`).
pub(super) const ROS_LEASE: Duration = Duration::from_secs(60);

/// The first version of Zenoh whose routers lose no answers to gets.
const KEEPS_ANSWERS: (u32, u32) = (1, 9);

/// How many programs of ROS, or peers, there must be for one to miss another.
const TWO: usize = 2;

/// The node of `muster-ros2`, which is a client of its router and misses nothing: its namespace and its name.
const OWN_NODE: (&str, &str) = ("%", "muster");

/// Programs of ROS on the bus, by their liveliness tokens.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(in crate::doctor) struct RosPrograms {
    /// The sessions, of which each program has one, with the name of one of its nodes.
    sessions: BTreeMap<String, String>,
}

impl RosPrograms {
    /// The programs behind tokens `@ros2_lv/DOMAIN/SESSION/NUMBER/NUMBER/KIND/ENCLAVE/NAMESPACE/NODE…`, but for the bridges
    /// of Muster.
    pub(in crate::doctor) fn of_tokens(tokens: &[String]) -> Self {
        let mut sessions = BTreeMap::new();
        let mut own = BTreeSet::new();
        for token in tokens {
            let parts: Vec<&str> = token.split('/').collect();
            let [_, _, session, _, _, _, _, namespace, node, ..] = parts[..] else { continue };
            if (namespace, node) == OWN_NODE {
                own.insert(session);
            } else {
                sessions.entry(session.to_owned()).or_insert_with(|| node.to_owned());
            }
        }
        sessions.retain(|session, _| !own.contains(session.as_str()));
        Self { sessions }
    }

    /// Whether there is any.
    pub(in crate::doctor) fn any(&self) -> bool {
        !self.sessions.is_empty()
    }

    /// Whether there are enough for one to miss another.
    pub(in crate::doctor) fn several(&self) -> bool {
        self.sessions.len() >= TWO
    }
}

/// A router, by its endpoint and its id, that does not announce its peers, at which programs of ROS cannot find each other.
pub(in crate::doctor) fn unannounced(
    endpoint: &str,
    id: &str,
    programs: &RosPrograms,
    routers: &[RouterState],
) -> Option<Finding> {
    // A router that says its links, and has no two peers, keeps no programs apart.
    let known = routers.iter().find(|router| router.id == id);
    let keeps_apart = known.is_none_or(|router| router.peers >= TWO);
    if !programs.several() || !keeps_apart {
        return None;
    }
    let count = programs.sessions.len();
    let nodes: BTreeSet<_> = programs.sessions.values().collect();
    Some(
        warning(
            "ros_unannounced",
            format!(
                "{count} programs of ROS are on the bus ({}), and the router at {endpoint} does not announce its peers \
                 to each other",
                names(nodes.iter())
            ),
            "those that link to it as peers, as rmw_zenoh has it by default, hear nothing of each other: run `muster router \
             --ros`, or set scouting.gossip.enabled in the router's configuration. Muster itself needs neither",
        )
        .about([endpoint]),
    )
}

/// Routers that lose answers to gets. Only those that tell their version are known.
pub(super) fn old_routers(routers: &[RouterState]) -> Option<Finding> {
    let is_old = |router: &&RouterState| {
        let mut parts = router.version.split('.').map(str::parse);
        match (parts.next(), parts.next()) {
            (Some(Ok(major)), Some(Ok(minor))) => (major, minor) < KEEPS_ANSWERS,
            _ => false,
        }
    };
    let old: Vec<_> = routers.iter().filter(is_old).collect();
    if old.is_empty() {
        return None;
    }
    let shown: Vec<_> = old
        .iter()
        .map(|router| {
            let version = router.version.split([' ', '-']).next().unwrap_or_default();
            format!("{} (Zenoh {version})", router.id)
        })
        .collect();
    Some(
        warning(
            "router_old",
            format!("routers of a Zenoh before 1.9: {}", names(shown.iter())),
            "these lose answers to gets, so that commands and services that start miss some: run `muster router --ros` in \
             their place, or a zenohd of 1.9 or later; robots of ROS may stay as they are",
        )
        .about(old.iter().map(|router| &router.id)),
    )
}

/// Topics of robots that bridges refuse, by what is wrong with them.
pub(super) fn refused_topics(bridges: &[BridgeState]) -> Vec<Finding> {
    let mut by: BTreeMap<TopicFault, Vec<&RefusedTopic>> = BTreeMap::new();
    for refused in bridges.iter().flat_map(|bridge| &bridge.refused) {
        by.entry(refused.fault).or_default().push(refused);
    }
    let finding = |(fault, topics): (TopicFault, Vec<&RefusedTopic>)| {
        let shown: Vec<_> =
            topics.iter().map(|one| format!("{}: {}", one.topic, one.reason)).collect();
        let (id, what, remedy) = words(fault);
        warning(id, format!("{what}: {}", names(shown.iter())), remedy)
            .about(topics.iter().map(|one| &one.topic))
    };
    by.into_iter().map(finding).collect()
}

/// The id of a fault, what is seen of it, and what to do.
fn words(fault: TopicFault) -> (&'static str, &'static str, &'static str) {
    match fault {
        TopicFault::NoChain => (
            "ros_no_chain",
            "poses without a way to the world are refused",
            "run the localisation of these robots, or a static transform from the world to their odom; `frames` and `world` \
             in the file of muster-ros2 say which topics and which frame are read",
        ),
        TopicFault::OldTransform => (
            "ros_old_transform",
            "poses are refused whose transforms are old",
            "the localisation of these robots has stopped, or is slower than frames.max_age_s of muster-ros2",
        ),
        TopicFault::TypeHash => (
            "ros_type_hash",
            "messages of another definition are refused",
            "write the whole .msg text that these robots run as `definition` of the topic in the file of muster-ros2",
        ),
        TopicFault::NoAttachment => (
            "ros_no_attachment",
            "messages without an attachment are refused",
            "a program puts them by hand, and no program of ROS reads them either; with zenoh-bridge-ros2dds set dialect = \
             \"ros2dds\" in the file of muster-ros2",
        ),
        TopicFault::Other => (
            "ros_refused",
            "topics of robots are refused",
            "each reason says what would be right; services/ros2/README.md has them all",
        ),
    }
}

#[cfg(test)]
mod tests {
    use muster_model::id::InstanceId;

    use super::*;

    fn token(session: &str, namespace: &str, node: &str) -> String {
        format!("@ros2_lv/0/{session}/0/4/MP/%/{namespace}/{node}/%chatter/t/h/q")
    }

    #[test]
    fn programs_are_counted_by_their_sessions_and_a_bridge_is_none() {
        let tokens = [
            token("a1", "%", "talker"),
            token("a1", "%", "listener"),
            token("b2", "%", "muster"),
            token("b2", "%", "muster"),
            "@ros2_lv/0/c3".to_owned(),
        ];
        let programs = RosPrograms::of_tokens(&tokens);
        assert!(programs.any() && !programs.several(), "{programs:?}");
        let more = [&tokens[..], &[token("d4", "%r1", "muster")]].concat();
        assert!(RosPrograms::of_tokens(&more).several());
        assert!(!RosPrograms::of_tokens(&[]).any());
    }

    #[test]
    fn two_programs_at_a_router_that_does_not_announce_are_found() {
        let none = RosPrograms::default();
        let two = RosPrograms::of_tokens(&[token("a1", "%", "talker"), token("b2", "%", "rviz")]);
        let router =
            |peers| RouterState { id: "ab".to_owned(), version: "1.10.2".to_owned(), peers };
        let found = |programs: &RosPrograms, routers: &[RouterState]| {
            unannounced("tcp/a:1", "ab", programs, routers)
        };
        let finding = found(&two, &[]).unwrap();
        assert!(finding.seen.contains("rviz talker"), "{}", finding.seen);
        assert!(finding.remedy.contains("muster router --ros"));
        assert!(found(&two, &[router(2)]).is_some());
        assert!(found(&two, &[router(1)]).is_none(), "its programs are clients");
        assert!(found(&none, &[]).is_none(), "there is no program of ROS");
    }

    #[test]
    fn only_a_version_that_is_known_is_called_old() {
        assert!(old_routers(&[]).is_none(), "no router says its version");
        let router = |version: &str| RouterState {
            id: version.to_owned(),
            version: version.to_owned(),
            peers: 0,
        };
        let good = ["1.9.0", "1.10.2-1-gabc built with rustc", "2.0", "x", ""].map(router);
        assert!(old_routers(&good).is_none());
        let bad = [&good[..], &[router("1.8.0-modified built with rustc 1.85")]].concat();
        let finding = old_routers(&bad).unwrap();
        assert!(finding.seen.ends_with("(Zenoh 1.8.0)"), "{}", finding.seen);
        assert_eq!(finding.subjects.len(), 1);
    }

    #[test]
    fn refused_topics_are_found_by_what_is_wrong_each_with_its_remedy() {
        let topic = |name: &str, fault| RefusedTopic {
            topic: name.to_owned(),
            fault,
            reason: "no way".to_owned(),
        };
        let faults = [
            (TopicFault::NoChain, "ros_no_chain", "localisation"),
            (TopicFault::OldTransform, "ros_old_transform", "max_age_s"),
            (TopicFault::TypeHash, "ros_type_hash", "definition"),
            (TopicFault::NoAttachment, "ros_no_attachment", "ros2dds"),
            (TopicFault::Other, "ros_refused", "README"),
        ];
        for (fault, id, remedy) in faults {
            let bridge = BridgeState {
                instance: InstanceId::new("host-1").unwrap(),
                version: "1".to_owned(),
                robots: 2,
                received: 2,
                reported: 0,
                refused_topics: 2,
                refused: vec![topic("0/r1/odom", fault), topic("0/r2/odom", fault)],
            };
            let [finding] = &refused_topics(&[bridge])[..] else { panic!("{fault:?}") };
            assert_eq!((finding.id, finding.subjects.len()), (id, 2));
            assert!(finding.remedy.contains(remedy), "{}", finding.remedy);
            assert!(finding.seen.contains("0/r1/odom: no way"), "{}", finding.seen);
        }
    }
}
