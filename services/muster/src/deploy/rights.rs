//! What each identity may do on the bus, as key expressions.
//!
//! The rights of a service follow from the wiring of its core, so that the rules cannot fall behind the
//! code: it receives what it subscribes to, puts what it serves as its own output, and answers gets for
//! the outputs that it reads.

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_historian::Historian;
use muster_ingest::Ingest;
use muster_model::id::{RobotId, ServiceName};
use muster_model::observation::Stream;
use muster_planner::Planner;
use muster_service::{Authority, ServedKey, Wiring};
use muster_wire::{FleetPattern, Key, KeySpace, Pattern};

use super::fleet::{Fleet, FleetFile, Identity, Kind};

/// What one identity may do. Everything else is denied.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Rights {
    /// Keys that it may put.
    pub(super) put: Vec<String>,
    /// Keys that it may subscribe to.
    pub(super) subscribe: Vec<String>,
    /// Keys that it may get.
    pub(super) get: Vec<String>,
    /// Keys whose gets it may answer.
    pub(super) reply: Vec<String>,
    /// Liveliness tokens that it may declare.
    pub(super) declare_token: Vec<String>,
    /// Liveliness tokens that it may watch.
    pub(super) watch_token: Vec<String>,
}

impl Rights {
    /// The rights of an identity; none for a router, which is trusted with everything.
    pub(super) fn of(file: &FleetFile, identity: &Identity) -> Option<Self> {
        let fleet = file.fleet_of(identity);
        let space = KeySpace::new(fleet.name.clone());
        match identity.kind {
            Kind::Router => None,
            Kind::Host => {
                let host = file.hosts.iter().find(|host| host.name == identity.name);
                host.map(|host| of_host(&host.fleets))
            }
            Kind::Service => {
                let named = |service: &&ServiceName| service.as_str() == identity.name;
                let text = |pattern: &Pattern| space.pattern(pattern);
                fleet.services.iter().find(named).map(|service| of_service(&text, *service))
            }
            Kind::Robot => {
                let named = |robot: &&RobotId| robot.as_str() == identity.name;
                fleet.robots.iter().find(named).map(|robot| of_robot(fleet, &space, robot))
            }
            Kind::Operator => Some(of_operator(&space, &identity.name)),
            Kind::Viewer => Some(of_viewer(&space)),
            Kind::Bridge => Some(of_bridge(&space)),
        }
    }

    /// Each list sorted, without what is in it twice.
    fn sorted(mut self) -> Self {
        for list in [
            &mut self.put,
            &mut self.subscribe,
            &mut self.get,
            &mut self.reply,
            &mut self.declare_token,
            &mut self.watch_token,
        ] {
            list.sort_unstable();
            list.dedup();
        }
        self
    }
}

/// The wiring of a service, with what its instances need for the election.
fn wiring(service: ServiceName) -> Wiring {
    match service {
        ServiceName::Ingest => Wiring::of::<Ingest>(),
        ServiceName::Embedder => Wiring::of::<Embedder>(),
        ServiceName::Clusterer => Wiring::of::<Clusterer>(),
        ServiceName::Auditor => Wiring::of::<Auditor>(),
        ServiceName::Historian => Wiring::of::<Historian>(),
        ServiceName::Planner => Wiring::of::<Planner>(),
    }
}

/// The key on which every service answers with the schemas of all messages.
fn schema(space: &KeySpace) -> String {
    space.format(&Key::Schema)
}

/// The rights of a service; `text` writes keys of its fleet.
fn of_service(text: &dyn Fn(&Pattern) -> String, service: ServiceName) -> Rights {
    let wiring = wiring(service);
    // The bus declares the keys of robots that have tokens, and no others.
    let robots = wiring.puts_robot_teams().then_some(Pattern::RobotTokens);
    let Wiring { subscriptions, tokens, served, fetched } = wiring;
    let texts = |patterns: &mut dyn Iterator<Item = Pattern>| -> Vec<String> {
        patterns.map(|pattern| text(&pattern)).collect()
    };
    let received = texts(&mut subscriptions.into_iter().map(|subscription| subscription.pattern));
    let fetched = texts(&mut fetched.into_iter());
    // The schema is the same for all services: it is answered, and never put.
    let is_output = |key: &&ServedKey| {
        key.authority == Authority::Own && key.pattern != Pattern::One(Key::Schema)
    };
    let outputs = texts(&mut served.iter().filter(is_output).map(|key| key.pattern.clone()));
    let answered = texts(&mut served.into_iter().map(|key| key.pattern));
    let events = [Key::Event, Key::JsonEvent].map(|key| text(&Pattern::One(key)));
    // Whoever reads what robots put tells them what it refuses.
    let reads_robots = received.contains(&text(&Pattern::UnknownStreams));
    let refusals = reads_robots.then(|| text(&Pattern::RobotRefusals));

    Rights {
        put: outputs.iter().chain(&events).cloned().chain(refusals).collect(),
        // At the start it gets what it subscribes to, and its own last output.
        get: [received.as_slice(), &outputs, &fetched].concat(),
        subscribe: received,
        reply: answered,
        declare_token: vec![text(&Pattern::InstanceTokens(service))],
        watch_token: texts(&mut tokens.into_iter().chain(robots)),
    }
    .sorted()
}

/// One process has all services of the fleets: it puts and gets what any of them may. It receives, answers and watches each
/// fleet as a whole, since it declares no key for each service, but a few for all.
fn of_host(fleets: &[FleetPattern]) -> Rights {
    let mut rights = Rights::default();
    for fleet in fleets {
        let text = |pattern: &Pattern| fleet.keys(pattern);
        for service in ServiceName::ALL {
            let of_service = of_service(&text, service);
            rights.put.extend(of_service.put);
            rights.get.extend(of_service.get);
            rights.declare_token.extend(of_service.declare_token);
        }
        let everything = text(&Pattern::Everything);
        rights.subscribe.push(everything.clone());
        rights.reply.push(everything.clone());
        rights.watch_token.push(everything);
    }
    rights.sorted()
}

fn of_robot(fleet: &Fleet, space: &KeySpace, robot: &RobotId) -> Rights {
    let key = |key: Key| space.format(&key);
    let team = key(Key::RobotTeam(robot.clone()));
    let refused = key(Key::RobotRefused(robot.clone()));
    let token = key(Key::RobotToken(robot.clone()));
    let declared = fleet.modalities.iter().cloned().map(Stream::Relation);
    let streams = Stream::BUILT_IN.into_iter().chain(declared);
    let mut rights = Rights {
        put: streams.map(|stream| key(Key::Stream(robot.clone(), stream))).collect(),
        // It checks whether another process uses its id: one with a copy of its certificate.
        subscribe: vec![team.clone(), refused, key(Key::Stream(robot.clone(), Stream::Pose))],
        get: vec![team, schema(space)],
        declare_token: vec![token.clone()],
        watch_token: vec![token],
        ..Rights::default()
    };
    if fleet.robots_read_json {
        let json = [Key::JsonTeams, Key::JsonAudit, Key::JsonEvent].map(key);
        rights.subscribe.extend_from_slice(&json);
        rights.get.extend(json);
    }
    rights
}

/// An operator commands and asks for proposals under its own name, and reads everything but the proposals of others.
fn of_operator(space: &KeySpace, name: &str) -> Rights {
    let mut rights = of_viewer(space);
    rights.get.push(format!("muster/v1/{}/command/*/{name}/*", space.fleet()));
    rights.get.push(format!("muster/v1/{}/propose/{name}/*", space.fleet()));
    rights
}

/// A viewer reads everything but the answers to commands and proposals: a get of one may carry it, which a router cannot
/// distinguish. Outcomes of commands are events.
fn of_viewer(space: &KeySpace) -> Rights {
    let all = |tail: &str| format!("muster/v1/{}/{tail}", space.fleet());
    let keys = [
        Key::Roster,
        Key::Embedding,
        Key::Teams,
        Key::Audit,
        Key::Schema,
        Key::Wishes,
        Key::Alerts,
        Key::Event,
        Key::Why,
    ];
    let keys = keys.iter().map(|key| space.format(key));
    let wildcards =
        ["robot/**", "graph/*", "service/**", "json/*", "history/**", "wish/*/*", "bridge/*"];
    Rights { get: keys.chain(wildcards.map(all)).collect(), ..of_reader(space) }
}

/// A bridge speaks for robots, whichever they are, reads the division, and answers for itself. It declares no token: the presence of its robots
/// follows from what it puts.
fn of_bridge(space: &KeySpace) -> Rights {
    let streams = Stream::BUILT_IN.into_iter().map(Pattern::Stream);
    let read = [Key::Teams, Key::Audit, Key::Roster].map(|key| space.format(&key)).to_vec();
    Rights {
        put: streams.map(|stream| space.pattern(&stream)).collect(),
        get: read.clone(),
        subscribe: read,
        reply: vec![space.pattern(&Pattern::Bridges)],
        ..Rights::default()
    }
}

/// What all who read everything may do.
fn of_reader(space: &KeySpace) -> Rights {
    let everything = space.pattern(&Pattern::Everything);
    Rights {
        subscribe: vec![everything.clone()],
        watch_token: vec![everything],
        ..Rights::default()
    }
}

#[cfg(test)]
mod tests {
    use muster_model::id::InstanceId;
    use muster_model::settings::Settings;
    use muster_model::time::Tick;
    use muster_service::{Command, Core, Host, Input, Start, Stored};

    use super::super::fleet::ServingHost;
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

    /// All keys, by what may be done with them.
    fn lists(may: &Rights) -> [&Vec<String>; 6] {
        let Rights { put, subscribe, get, reply, declare_token, watch_token } = may;
        [put, subscribe, get, reply, declare_token, watch_token]
    }

    /// Whatever a core fetches at the start must be among what its service may get.
    fn check_start<C: Core>() {
        let start = Start {
            fleet: fleet().first().name.clone(),
            instance: InstanceId::new("test").unwrap(),
            now: Tick(1),
            settings: <C::Settings as Default>::default(),
            stored: Stored::default(),
        };
        let may = rights(&format!("service.{}", C::SERVICE));
        let mut fetched = 0;
        for command in Host::<C>::new(start).handle(Tick(1), Input::Started { linked: true }) {
            let Command::Ask(ask) = command else { continue };
            fetched += 1;
            let text = KeySpace::new(fleet().first().name.clone()).pattern(&ask.pattern);
            assert!(may.get.contains(&text), "{} may not get {text}", C::SERVICE);
        }
        assert!(fetched > 0);
        // The settings of a core are a table, as every patch of them.
        assert!(<C::Settings as Default>::default().patched(&serde_json::json!({})).is_ok());
    }

    #[test]
    fn every_service_may_get_what_it_fetches() {
        check_start::<Ingest>();
        check_start::<Embedder>();
        check_start::<Clusterer>();
        check_start::<Auditor>();
        check_start::<Historian>();
        check_start::<Planner>();
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
            ("robot/*/refused", "ingest"),
            ("audit", "auditor"),
            ("json/audit", "auditor"),
            ("history/*/state", "historian"),
            ("propose/*/*", "planner"),
        ] {
            for service in ServiceName::ALL {
                let may = rights(&format!("service.{service}"));
                let puts = may.put.contains(&of(tail));
                assert_eq!(puts, service.as_str() == owner, "{service} and {tail}");
            }
        }
        for service in ServiceName::ALL {
            let may = rights(&format!("service.{service}"));
            for list in lists(&may) {
                assert!(!list.iter().any(|key| key.contains("**")), "{list:?}");
            }
            // Instances of a service elect their leader on this key; those of historian have none.
            let elects = service != ServiceName::Historian;
            let lease = of(&format!("service/{service}/holder"));
            for list in [&may.put, &may.subscribe, &may.get, &may.reply] {
                assert_eq!(list.contains(&lease), elects, "{list:?}");
            }
            let tokens = of(&format!("service/{service}/*"));
            assert_eq!(may.declare_token, std::slice::from_ref(&tokens));
            assert_eq!(may.watch_token.contains(&tokens), elects);
            for other in ServiceName::ALL.iter().filter(|other| **other != service) {
                let foreign = of(&format!("service/{other}/"));
                assert!(
                    ![&may.put, &may.reply, &may.declare_token]
                        .iter()
                        .any(|list| list.iter().any(|key| key.starts_with(&foreign)))
                );
            }
        }
        assert!(rights("service.embedder").get.contains(&of("service/clusterer/settings")));
        for (identity, key) in [
            ("service.embedder", "teams"),
            ("service.embedder", "wishes"),
            ("operator.operator", "why"),
            ("viewer.dashboard", "why"),
        ] {
            assert!(rights(identity).get.contains(&of(key)), "{identity} and {key}");
        }
        assert!(!rights("robot.r1").get.contains(&of("why")));
        assert!(rights("service.ingest").subscribe.contains(&of("robot/*/pose")));
        assert!(rights("service.ingest").subscribe.contains(&of("robot/*/*")));
        let watching = [ServiceName::Ingest, ServiceName::Clusterer, ServiceName::Historian];
        for service in ServiceName::ALL {
            let may = rights(&format!("service.{service}"));
            let watches = may.watch_token.contains(&of("robot/*"));
            assert_eq!(watches, watching.contains(&service), "{service}");
        }
    }

    #[test]
    fn a_robot_may_put_its_own_streams_only() {
        let may = rights("robot.r1");
        for list in [&may.put, &may.declare_token, &may.subscribe, &may.watch_token] {
            assert!(list.iter().all(|key| key.starts_with("muster/v1/default/robot/r1")));
            assert!(!list.iter().any(|key| key.contains('*')), "{list:?}");
        }
        assert!(may.reply.is_empty());
        assert_eq!(may.put.len(), 3);
        let mut fleet = fleet();
        fleet.fleets[0].robots_read_json = true;
        fleet.fleets[0].modalities = vec!["thermal".parse().unwrap()];
        let robot = Identity { kind: Kind::Robot, name: "r1".to_owned(), fleet: None };
        let may = Rights::of(&fleet, &robot).unwrap();
        assert_eq!(may.put[3], "muster/v1/default/robot/r1/relation/thermal");
        assert!(may.subscribe.contains(&"muster/v1/default/json/teams".to_owned()));
    }

    #[test]
    fn a_bridge_speaks_for_robots_and_reads_the_division() {
        let mut fleet = fleet();
        fleet.fleets[0].bridges = vec!["ros2".to_owned()];
        let bridge = Identity { kind: Kind::Bridge, name: "ros2".to_owned(), fleet: None };
        assert!(fleet.identities().contains(&bridge));
        let may = Rights::of(&fleet, &bridge).unwrap();
        let of = |tails: [&str; 3]| tails.map(|tail| format!("muster/v1/default/{tail}")).to_vec();
        assert_eq!(may.put, of(["robot/*/pose", "robot/*/links", "robot/*/rank"]));
        assert_eq!(may.subscribe, of(["teams", "audit", "roster"]));
        assert_eq!(may.get, may.subscribe);
        assert_eq!(may.reply, ["muster/v1/default/bridge/*"]);
        assert!(may.declare_token.is_empty() && may.watch_token.is_empty());
    }

    #[test]
    fn operators_command_under_their_own_names_and_viewers_do_not() {
        let operator = rights("operator.operator");
        let viewer = rights("viewer.dashboard");
        for may in [&operator, &viewer] {
            assert!(may.put.is_empty() && may.declare_token.is_empty() && may.reply.is_empty());
            for key in ["service/**", "wish/*/*", "wishes", "alerts"] {
                assert!(may.get.contains(&format!("muster/v1/default/{key}")), "{may:?}");
            }
        }
        let commands = |may: &Rights| -> Vec<String> {
            let of_commands =
                |key: &&String| key.contains("/command/") || key.ends_with("default/**");
            may.get.iter().filter(of_commands).cloned().collect()
        };
        assert_eq!(commands(&operator), ["muster/v1/default/command/*/operator/*"]);
        assert!(commands(&viewer).is_empty());
    }

    #[test]
    fn a_host_is_all_services_of_its_fleets_and_neither_a_robot_nor_an_operator() {
        let mut file = fleet();
        let fleets = ["site-*", "default"].map(|text| text.parse().unwrap()).to_vec();
        file.hosts = vec![ServingHost { name: "base".to_owned(), fleets }];
        let base = Identity { kind: Kind::Host, name: "base".to_owned(), fleet: None };
        let may = Rights::of(&file, &base).unwrap();
        for service in ServiceName::ALL {
            let alone = rights(&format!("service.{service}"));
            for (of_service, of_host) in [
                (&alone.put, &may.put),
                (&alone.get, &may.get),
                (&alone.declare_token, &may.declare_token),
            ] {
                for key in of_service {
                    let elsewhere = key.replacen("/default/", "/site-$*/", 1);
                    assert!(of_host.contains(key) && of_host.contains(&elsewhere), "{key}");
                }
            }
        }
        let whole = ["muster/v1/default/**", "muster/v1/site-$*/**"];
        for list in [&may.subscribe, &may.reply, &may.watch_token] {
            assert_eq!(list, &whole);
        }
        let mut narrow = may.put.iter().chain(&may.get).chain(&may.declare_token);
        assert!(!narrow.any(|key| key.contains("**")));
        assert!(!may.put.iter().any(|key| key.ends_with("/pose")));
        assert!(!may.declare_token.iter().any(|key| key.contains("/robot/")));
    }

    #[test]
    fn members_of_another_fleet_have_their_rights_there() {
        let more = "\n[[fleets]]\nfleet = \"site-2\"\nrobots = [\"r1\"]\n";
        let text = format!("{}{more}", include_str!("../../../../deploy/fleet.toml"));
        let file = FleetFile::parse(&text).unwrap();
        let members: Vec<Identity> =
            file.identities().into_iter().filter(|identity| identity.fleet.is_some()).collect();
        assert_eq!(members.len(), 1 + ServiceName::ALL.len());
        for identity in members {
            let may = Rights::of(&file, &identity).unwrap();
            for key in lists(&may).into_iter().flatten() {
                assert!(key.starts_with("muster/v1/site-2/"), "{identity}: {key}");
            }
        }
    }
}
