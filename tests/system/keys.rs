//! The bus itself agrees with the rules of keys.

use muster_model::id::{
    FleetId, InstanceId, Modality, OperatorId, ProposalId, RobotId, ServiceName,
};
use muster_model::observation::Stream;
use muster_wire::{ForeignKey, ForeignPattern, Key, KeySpace, Pattern, Request};
use zenoh::key_expr::KeyExpr;

fn every_key() -> Vec<Key> {
    let robot = RobotId::new("r_1-x").unwrap();
    let modality = Modality::new("thermal").unwrap();
    let mut keys = vec![
        Key::RobotToken(robot.clone()),
        Key::Stream(robot.clone(), Stream::Pose),
        Key::Stream(robot.clone(), Stream::Links),
        Key::Stream(robot.clone(), Stream::Rank),
        Key::Stream(robot.clone(), Stream::Relation(modality.clone())),
        Key::Foreign(ForeignKey::new("@a/0/rt::chatter_").unwrap()),
        Key::RobotTeam(robot),
        Key::Graph(modality),
        Key::Roster,
        Key::Embedding,
        Key::Teams,
        Key::Audit,
        Key::Event,
        Key::JsonTeams,
        Key::JsonAudit,
        Key::JsonEvent,
        Key::Schema,
        Key::History(InstanceId::new("host-1").unwrap()),
        Key::HistoryState(InstanceId::new("host-1").unwrap()),
        Key::Bridge(InstanceId::new("host-1").unwrap()),
        Key::Proposal(OperatorId::new("alice").unwrap(), ProposalId::new("p1").unwrap()),
    ];
    for service in ServiceName::ALL {
        keys.push(Key::Settings(service));
        keys.push(Key::Status(service));
        keys.push(Key::Lease(service));
        keys.push(Key::ServiceToken(service, InstanceId::new("host-1").unwrap()));
    }
    keys
}

fn space() -> KeySpace {
    KeySpace::new(FleetId::new("alpha").unwrap())
}

#[test]
fn every_key_and_pattern_is_canonical() {
    for key in every_key() {
        let text = space().format(&key);
        assert_eq!(KeyExpr::autocanonize(text.clone()).unwrap().as_str(), text);
        KeyExpr::try_from(text).unwrap();
    }
    for pattern in [
        Pattern::RobotTokens,
        Pattern::Stream(Stream::Pose),
        Pattern::Stream(Stream::Links),
        Pattern::Stream(Stream::Rank),
        Pattern::Relations,
        Pattern::Foreign(ForeignPattern::new("0/*/**/a$*b").unwrap()),
        Pattern::RobotTeams,
        Pattern::Graphs,
        Pattern::ServiceTokens,
        Pattern::Histories,
        Pattern::HistoryStates,
        Pattern::Bridges,
        Pattern::InstanceTokens(ServiceName::Ingest),
        Pattern::Statuses,
        Pattern::Everything,
    ] {
        let text = space().pattern(&pattern);
        assert_eq!(KeyExpr::autocanonize(text.clone()).unwrap().as_str(), text);
    }
}

#[test]
fn gets_select_what_the_bus_says_they_do() {
    let selectors = [
        "muster/v1/alpha/teams",
        "muster/v1/alpha/*",
        "muster/v1/alpha/**",
        "muster/v1/*/teams",
        "**",
        "**/teams",
        "muster/v1/alpha/robot/*",
        "muster/v1/alpha/robot/*/team",
        "muster/v1/alpha/robot/**",
        "muster/v1/alpha/robot/r_1$*/pose",
        "muster/v$*/alpha/**",
        "muster/v1/alpha/service/*/settings",
        "muster/v1/beta/**",
        "muster/v1/alpha/json/*",
        "muster/**/relation/*",
        "muster/v1/alpha/graph/th$*al",
        "muster/v1/alpha/graph/$*x$*",
    ];
    for selector in selectors {
        let expression = KeyExpr::try_from(selector).unwrap();
        let request = Request::new(selector, "", None).unwrap();
        for key in every_key() {
            let text = KeyExpr::try_from(space().format(&key)).unwrap();
            assert_eq!(
                request.selects(&space(), &key),
                expression.intersects(&text),
                "{selector} and {text}"
            );
        }
    }
}
