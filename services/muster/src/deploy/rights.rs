//! What each identity may do on the bus, as key expressions.
//!
//! What a service may do follows from the wiring of its core, so that the rules cannot fall behind
//! the code: it hears what it subscribes to, says what it serves as its own, and repeats the rest.

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_ingest::Ingest;
use muster_machine::Wiring;
use muster_model::id::{RobotId, ServiceName};
use muster_model::observation::Stream;
use muster_wire::{Key, KeySpace, Pattern};

use super::fleet::{FleetFile, Identity, Kind};

/// What one identity may do. Whatever is not here it may not.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Rights {
    /// Keys that it may put.
    pub(super) say: Vec<String>,
    /// Keys that it may subscribe to.
    pub(super) hear: Vec<String>,
    /// Keys that it may get.
    pub(super) ask: Vec<String>,
    /// Keys for which it may answer gets.
    pub(super) answer: Vec<String>,
    /// Liveliness tokens that it may declare.
    pub(super) be: Vec<String>,
    /// Liveliness tokens that it may watch.
    pub(super) see: Vec<String>,
}

impl Rights {
    /// The rights of an identity; none for a router, which is trusted with everything.
    pub(super) fn of(fleet: &FleetFile, identity: &Identity) -> Option<Self> {
        let space = KeySpace::new(fleet.fleet.clone());
        match identity.kind {
            Kind::Router => None,
            Kind::Service => {
                let named = |service: &&ServiceName| service.as_str() == identity.name;
                fleet.services.iter().find(named).map(|service| of_service(&space, *service))
            }
            Kind::Robot => {
                let named = |robot: &&RobotId| robot.as_str() == identity.name;
                fleet.robots.iter().find(named).map(|robot| of_robot(fleet, &space, robot))
            }
            Kind::Operator => Some(of_reader(&space, true)),
            Kind::Viewer => Some(of_reader(&space, false)),
        }
    }
}

/// The wiring of a service, with what its instances need for their role.
fn wiring(service: ServiceName) -> Wiring {
    match service {
        ServiceName::Ingest => Wiring::of::<Ingest>(),
        ServiceName::Embedder => Wiring::of::<Embedder>(),
        ServiceName::Clusterer => Wiring::of::<Clusterer>(),
        ServiceName::Auditor => Wiring::of::<Auditor>(),
    }
}

/// The key that every service answers with the schemas of all messages.
fn schema(space: &KeySpace) -> String {
    space.format(&Key::Schema)
}

fn of_service(space: &KeySpace, service: ServiceName) -> Rights {
    let Wiring { subscriptions, tokens, served } = wiring(service);
    let texts = |patterns: &mut dyn Iterator<Item = Pattern>| -> Vec<String> {
        patterns.map(|pattern| space.pattern(&pattern)).collect()
    };
    let heard = texts(&mut subscriptions.into_iter().map(|subscription| subscription.pattern));
    let outputs = texts(
        &mut served.iter().filter(|(_, complete)| *complete).map(|(pattern, _)| pattern.clone()),
    );
    let answered = texts(&mut served.into_iter().map(|(pattern, _)| pattern));
    let events = [Key::Event, Key::JsonEvent].map(|key| space.format(&key));

    let mut rights = Rights {
        say: [outputs.as_slice(), &events].concat(),
        // As it starts it asks for what it hears, and for its own last output.
        ask: [heard.as_slice(), &outputs].concat(),
        hear: heard,
        answer: answered,
        be: vec![space.pattern(&Pattern::InstanceTokens(service))],
        see: texts(&mut tokens.into_iter()),
    };
    rights.answer.push(schema(space));
    for list in
        [&mut rights.say, &mut rights.hear, &mut rights.ask, &mut rights.answer, &mut rights.see]
    {
        list.sort_unstable();
        list.dedup();
    }
    rights
}

fn of_robot(fleet: &FleetFile, space: &KeySpace, robot: &RobotId) -> Rights {
    let key = |key: Key| space.format(&key);
    let team = key(Key::RobotTeam(robot.clone()));
    let token = key(Key::RobotToken(robot.clone()));
    let declared = fleet.modalities.iter().cloned().map(Stream::Relation);
    let streams = Stream::BUILT_IN.into_iter().chain(declared);
    let mut rights = Rights {
        say: streams.map(|stream| key(Key::Stream(robot.clone(), stream))).collect(),
        // It looks whether another process speaks for it: one that has a copy of its certificate.
        hear: vec![team.clone(), key(Key::Stream(robot.clone(), Stream::Pose))],
        ask: vec![team, schema(space)],
        be: vec![token.clone()],
        see: vec![token],
        ..Rights::default()
    };
    if fleet.robots_read_json {
        let json = [Key::JsonTeams, Key::JsonAudit, Key::JsonEvent].map(key);
        rights.hear.extend_from_slice(&json);
        rights.ask.extend(json);
    }
    rights
}

/// A get of settings may carry a change, which the router cannot tell from a question: who may only
/// look may not ask there.
fn of_reader(space: &KeySpace, may_set: bool) -> Rights {
    let everything = space.pattern(&Pattern::Everything);
    let ask = if may_set {
        vec![everything.clone()]
    } else {
        let keys = [
            Pattern::RobotTeams,
            Pattern::Graphs,
            Pattern::Statuses,
            Pattern::One(Key::Roster),
            Pattern::One(Key::Embedding),
            Pattern::One(Key::Teams),
            Pattern::One(Key::Audit),
            Pattern::One(Key::JsonTeams),
            Pattern::One(Key::JsonAudit),
        ];
        keys.iter().map(|pattern| space.pattern(pattern)).chain([schema(space)]).collect()
    };
    Rights { hear: vec![everything.clone()], ask, see: vec![everything], ..Rights::default() }
}

#[cfg(test)]
mod tests {
    use muster_machine::{Command, Core, Driver, Event, Start, Stored};
    use muster_model::id::InstanceId;
    use muster_model::settings::Settings;
    use muster_model::time::Tick;

    use super::*;

    fn fleet() -> FleetFile {
        FleetFile::parse(include_str!("../../../../deploy/fleet.toml")).unwrap()
    }

    fn rights(name: &str) -> Rights {
        let fleet = fleet();
        let identities = fleet.identities();
        let identity = identities.iter().find(|identity| identity.to_string() == name).unwrap();
        Rights::of(&fleet, identity).unwrap()
    }

    /// Whatever a core asks for as it starts must be among what its service may ask.
    fn check_start<C: Core>() {
        let start = Start {
            fleet: fleet().fleet,
            instance: InstanceId::new("test").unwrap(),
            now: Tick(1),
            settings: <C::Settings as Default>::default(),
            stored: Stored::default(),
        };
        let may = rights(&format!("service.{}", C::SERVICE));
        let mut asked = 0;
        for command in Driver::<C>::new(start).step(Tick(1), Event::Started) {
            let Command::Fetch { patterns, .. } = command else { continue };
            for pattern in patterns {
                asked += 1;
                let text = KeySpace::new(fleet().fleet).pattern(&pattern);
                assert!(may.ask.contains(&text), "{} may not ask for {text}", C::SERVICE);
            }
        }
        assert!(asked > 0);
        // The settings of a core are a table, as every patch of them.
        assert!(<C::Settings as Default>::default().patched(&serde_json::json!({})).is_ok());
    }

    #[test]
    fn every_service_may_ask_for_what_it_asks_for() {
        check_start::<Ingest>();
        check_start::<Embedder>();
        check_start::<Clusterer>();
        check_start::<Auditor>();
    }

    #[test]
    fn outputs_belong_to_one_service_and_are_read_by_others() {
        let of = |tail: &str| format!("muster/v1/default/{tail}");
        for (tail, owner) in [
            ("roster", "ingest"),
            ("graph/*", "ingest"),
            ("embedding", "embedder"),
            ("teams", "clusterer"),
            ("json/teams", "clusterer"),
            ("robot/*/team", "clusterer"),
            ("audit", "auditor"),
            ("json/audit", "auditor"),
        ] {
            for service in ServiceName::ALL {
                let may = rights(&format!("service.{service}"));
                let says = may.say.contains(&of(tail));
                assert_eq!(says, service.as_str() == owner, "{service} and {tail}");
            }
        }
        for service in ServiceName::ALL {
            let may = rights(&format!("service.{service}"));
            for list in [&may.say, &may.hear, &may.ask, &may.answer, &may.be, &may.see] {
                assert!(!list.iter().any(|key| key.contains("**")), "{list:?}");
            }
            // Instances of a service agree on who holds its role.
            let holder = of(&format!("service/{service}/holder"));
            for list in [&may.say, &may.hear, &may.ask, &may.answer] {
                assert!(list.contains(&holder), "{list:?}");
            }
            let tokens = of(&format!("service/{service}/*"));
            assert!(may.be == [tokens.clone()] && may.see.contains(&tokens));
            for other in ServiceName::ALL.iter().filter(|other| **other != service) {
                let foreign = of(&format!("service/{other}/"));
                assert!(
                    ![&may.say, &may.answer, &may.be]
                        .iter()
                        .any(|list| list.iter().any(|key| key.starts_with(&foreign)))
                );
            }
        }
        assert!(rights("service.embedder").ask.contains(&of("service/clusterer/settings")));
        assert!(rights("service.ingest").hear.contains(&of("robot/*/pose")));
        assert!(rights("service.ingest").see.contains(&of("robot/*")));
    }

    #[test]
    fn a_robot_may_speak_for_itself_only() {
        let may = rights("robot.r1");
        for list in [&may.say, &may.be, &may.hear, &may.see] {
            assert!(list.iter().all(|key| key.starts_with("muster/v1/default/robot/r1")));
            assert!(!list.iter().any(|key| key.contains('*')), "{list:?}");
        }
        assert!(may.answer.is_empty());
        assert_eq!(may.say.len(), 3);
        let mut fleet = fleet();
        fleet.robots_read_json = true;
        fleet.modalities = vec!["thermal".parse().unwrap()];
        let robot = Identity { kind: Kind::Robot, name: "r1".to_owned() };
        let may = Rights::of(&fleet, &robot).unwrap();
        assert_eq!(may.say[3], "muster/v1/default/robot/r1/relation/thermal");
        assert!(may.hear.contains(&"muster/v1/default/json/teams".to_owned()));
    }

    #[test]
    fn only_operators_may_ask_where_a_question_may_be_a_change() {
        assert_eq!(rights("operator.operator").ask, ["muster/v1/default/**"]);
        let may = rights("viewer.dashboard");
        assert!(may.say.is_empty() && may.be.is_empty() && may.answer.is_empty());
        assert!(!may.ask.iter().any(|key| key.contains("**") || key.contains("settings")));
    }
}
