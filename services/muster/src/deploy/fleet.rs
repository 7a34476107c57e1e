//! The fleet file: the members of secured fleets and their names.

use std::collections::BTreeSet;
use std::fmt;
use std::net::IpAddr;
use std::path::Path;

use muster_model::id::{FleetId, Modality, RobotId, ServiceName, check_id};
use muster_runtime::bus::MAX_SCOPES;
use muster_runtime::exit::ExitError;
use muster_runtime::store::read_at_most;
use muster_wire::FleetPattern;
use muster_wire::message::quoted;
use serde::Deserialize;

/// Largest fleet file in bytes: 10,000 robots with the longest names, and some.
const MAX_FILE: u64 = 1024 * 1024;

/// Longest common name of a certificate, by its standard (X.520, ub-common-name).
const MAX_COMMON_NAME: usize = 64;

/// Longest address of a router, by the standard of host names.
const MAX_ADDRESS: usize = 253;

/// Most routers in the configuration of a client: a longer list is a mistake.
const MAX_ROUTERS: usize = 16;

/// Longest validity in days: no host lasts longer.
const MAX_DAYS: u32 = 36_500;

/// The kinds of identities.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    /// Relays for all others, which trust it.
    Router,
    /// Runs all services of several fleets in one process.
    Host,
    /// One of the services; all its instances share the identity.
    Service,
    /// One robot.
    Robot,
    /// May read everything and change settings.
    Operator,
    /// May read everything.
    Viewer,
    /// Puts what robots report that speak another protocol.
    Bridge,
}

impl fmt::Display for Kind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Router => "router",
            Self::Host => "host",
            Self::Service => "service",
            Self::Robot => "robot",
            Self::Operator => "operator",
            Self::Viewer => "viewer",
            Self::Bridge => "bridge",
        })
    }
}

/// The subject of a certificate.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Identity {
    /// The kind of identity.
    pub(super) kind: Kind,
    /// Its name among its kind.
    pub(super) name: String,
    /// The fleet of which it is a member; none for the first of the file, and for routers and hosts, which are of all.
    pub(super) fleet: Option<FleetId>,
}

impl Identity {
    /// `kind.name`, which is unique in its fleet.
    pub(super) fn in_fleet(&self) -> String {
        format!("{}.{}", self.kind, self.name)
    }
}

/// `kind.name`, followed by `.fleet` unless that is the first. No name contains a dot, so the text is unique.
impl fmt::Display for Identity {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.in_fleet())?;
        self.fleet.as_ref().map_or(Ok(()), |fleet| write!(formatter, ".{fleet}"))
    }
}

/// How clients and routers connect to a router, with certificates on both sides either way.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Protocol {
    /// Over UDP. Zenoh's link over TLS has a data race on its stream: it breaks now and then, and may
    /// corrupt memory (eclipse-zenoh/zenoh#2557). Its link over QUIC has a stream per direction.
    #[default]
    Quic,
    /// Over TCP, for networks that block UDP.
    Tls,
}

/// All of them: a router listens for each.
pub(super) const PROTOCOLS: [Protocol; 2] = [Protocol::Quic, Protocol::Tls];

impl fmt::Display for Protocol {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Quic => "quic",
            Self::Tls => "tls",
        })
    }
}

/// One router.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Router {
    /// Its name among the routers.
    pub(super) name: String,
    /// Host names and addresses by which it is reached; clients use the first.
    pub(super) addresses: Vec<String>,
    /// The port on which it listens, of UDP for QUIC and of TCP for TLS.
    #[serde(default = "default_port")]
    pub(super) port: u16,
}

/// Why a fleet file is refused.
#[derive(Debug, thiserror::Error)]
pub(super) enum FleetFileError {
    /// It is no TOML of this form.
    #[error(transparent)]
    Toml(#[from] toml::de::Error),
    /// A field is wrong.
    #[error("{field}: {problem}")]
    Field {
        /// The field, with the name of its router.
        field: String,
        /// What is wrong, and the remedy.
        problem: String,
    },
}

fn refuse(field: impl Into<String>, problem: impl Into<String>) -> Result<(), FleetFileError> {
    Err(FleetFileError::Field { field: field.into(), problem: problem.into() })
}

/// One fleet and its members.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Fleet {
    /// Its name.
    #[serde(rename = "fleet")]
    pub(super) name: FleetId,
    /// Its robots.
    #[serde(default)]
    pub(super) robots: Vec<RobotId>,
    /// Its services.
    #[serde(default = "all_services")]
    pub(super) services: Vec<ServiceName>,
    /// Its operators.
    #[serde(default)]
    pub(super) operators: Vec<String>,
    /// Its viewers.
    #[serde(default)]
    pub(super) viewers: Vec<String>,
    /// Its bridges to robots that speak another protocol, such as `muster-ros2`.
    #[serde(default)]
    pub(super) bridges: Vec<String>,
    /// Declared relations that robots may report.
    #[serde(default)]
    pub(super) modalities: Vec<Modality>,
    /// Whether robots may read `json/*` of the whole fleet.
    #[serde(default)]
    pub(super) robots_read_json: bool,
}

/// A host that runs all services of several fleets in one process.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ServingHost {
    /// Its name among the hosts.
    pub(super) name: String,
    /// The fleets that it may serve, as `muster up --fleets` has them.
    pub(super) fleets: Vec<FleetPattern>,
}

/// The text of a fleet file: the first fleet stands at the top, each other one in a table of its own.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Text {
    fleet: FleetId,
    #[serde(default)]
    robots: Vec<RobotId>,
    #[serde(default = "all_services")]
    services: Vec<ServiceName>,
    #[serde(default)]
    operators: Vec<String>,
    #[serde(default)]
    viewers: Vec<String>,
    #[serde(default)]
    bridges: Vec<String>,
    #[serde(default)]
    modalities: Vec<Modality>,
    #[serde(default)]
    robots_read_json: bool,
    #[serde(default)]
    fleets: Vec<Fleet>,
    #[serde(default)]
    hosts: Vec<ServingHost>,
    routers: Vec<Router>,
    #[serde(default)]
    protocol: Protocol,
    #[serde(default = "default_certificate_days")]
    certificate_days: u32,
    #[serde(default = "default_authority_days")]
    authority_days: u32,
}

/// The content of a fleet file.
#[derive(Debug, Clone)]
pub(super) struct FleetFile {
    /// The fleets, at least one.
    pub(super) fleets: Vec<Fleet>,
    /// Hosts that serve several fleets.
    pub(super) hosts: Vec<ServingHost>,
    /// The routers, in the order in which clients try them.
    pub(super) routers: Vec<Router>,
    /// The protocol of links to routers.
    pub(super) protocol: Protocol,
    /// Validity of certificates in days.
    pub(super) certificate_days: u32,
    /// Validity of the certificate authority in days.
    pub(super) authority_days: u32,
}

impl From<Text> for FleetFile {
    fn from(text: Text) -> Self {
        let first = Fleet {
            name: text.fleet,
            robots: text.robots,
            services: text.services,
            operators: text.operators,
            viewers: text.viewers,
            bridges: text.bridges,
            modalities: text.modalities,
            robots_read_json: text.robots_read_json,
        };
        Self {
            fleets: std::iter::once(first).chain(text.fleets).collect(),
            hosts: text.hosts,
            routers: text.routers,
            protocol: text.protocol,
            certificate_days: text.certificate_days,
            authority_days: text.authority_days,
        }
    }
}

fn default_port() -> u16 {
    7447
}

fn all_services() -> Vec<ServiceName> {
    ServiceName::ALL.to_vec()
}

fn default_certificate_days() -> u32 {
    365
}

fn default_authority_days() -> u32 {
    3650
}

impl Router {
    /// Endpoints on which it listens, on every interface. The IPv6 wildcard accepts IPv4 as well.
    pub(super) fn listens(&self) -> Vec<String> {
        let with_ipv6 = self.addresses.iter().any(|address| address.contains(':'));
        let any = if with_ipv6 { "[::]" } else { "0.0.0.0" };
        PROTOCOLS.map(|protocol| format!("{protocol}/{any}:{}", self.port)).to_vec()
    }
}

impl FleetFile {
    /// The endpoint to which clients connect.
    pub(super) fn endpoint(&self, router: &Router) -> String {
        let address = router.addresses.first().map_or("localhost", String::as_str);
        // Only addresses of IPv6 contain colons; brackets separate them from the port.
        if address.contains(':') {
            format!("{}/[{address}]:{}", self.protocol, router.port)
        } else {
            format!("{}/{address}:{}", self.protocol, router.port)
        }
    }

    /// Reads and checks a file.
    ///
    /// # Errors
    /// Names the file, the field that is wrong, and the remedy.
    pub(super) fn read(path: &Path) -> Result<Self, ExitError> {
        let fail = |problem: &dyn fmt::Display| {
            ExitError::usage(format!("fleet file {}: {problem}", path.display()))
        };
        let bytes = read_at_most(path, MAX_FILE).map_err(|error| fail(&error))?;
        let text = String::from_utf8(bytes).map_err(|error| fail(&error))?;
        Self::parse(&text).map_err(|error| fail(&error))
    }

    /// Reads and checks the text of a file.
    ///
    /// # Errors
    /// Names the field that is wrong, and the remedy.
    pub(super) fn parse(text: &str) -> Result<Self, FleetFileError> {
        let file = Self::from(toml::from_str::<Text>(text)?);
        file.check()?;
        Ok(file)
    }

    fn check(&self) -> Result<(), FleetFileError> {
        let count = self.routers.len();
        if !(1..=MAX_ROUTERS).contains(&count) {
            return refuse("routers", format!("must be 1 to {MAX_ROUTERS}, these are {count}"));
        }
        for router in &self.routers {
            let name = quoted(&router.name);
            let addresses = format!("routers.{name}.addresses");
            if router.addresses.is_empty() {
                return refuse(addresses, "must name at least one address");
            }
            if let Some(address) = router.addresses.iter().find(|address| !is_address(address)) {
                let problem = format!(
                    "{:?} is neither a host name nor an address; write one like base.local or 192.168.1.10, \
                     without a port",
                    quoted(address)
                );
                return refuse(addresses, problem);
            }
            if router.port == 0 {
                return refuse(format!("routers.{name}.port"), "must be 1 to 65535");
            }
        }
        for (field, days) in
            [("certificate_days", self.certificate_days), ("authority_days", self.authority_days)]
        {
            if !(1..=MAX_DAYS).contains(&days) {
                return refuse(field, format!("must be 1 to {MAX_DAYS}, this is {days}"));
            }
        }
        for host in &self.hosts {
            if !(1..=MAX_SCOPES).contains(&host.fleets.len()) {
                let problem = format!(
                    "must be 1 to {MAX_SCOPES} names or patterns, these are {}; a pattern like site-* means many",
                    host.fleets.len()
                );
                return refuse(format!("hosts.{}.fleets", quoted(&host.name)), problem);
            }
        }
        let mut names = BTreeSet::new();
        for fleet in &self.fleets {
            if !names.insert(&fleet.name) {
                return refuse("fleets", format!("{} is named twice", fleet.name));
            }
            if let Some(modality) = fleet.modalities.iter().find(|one| one.is_built_in()) {
                let problem = format!("{modality} is built in; name only declared ones");
                return refuse(self.field("modalities", &fleet.name), problem);
            }
        }
        self.check_identities()
    }

    /// A field of a fleet as it stands in the file.
    fn field(&self, field: &str, fleet: &FleetId) -> String {
        if *fleet == self.first().name {
            field.to_owned()
        } else {
            format!("fleets.{fleet}.{field}")
        }
    }

    fn check_identities(&self) -> Result<(), FleetFileError> {
        let mut named = BTreeSet::new();
        for identity in self.identities() {
            let field = match identity.kind {
                Kind::Router => "routers",
                Kind::Host => "hosts",
                Kind::Service => "services",
                Kind::Robot => "robots",
                Kind::Operator => "operators",
                Kind::Viewer => "viewers",
                Kind::Bridge => "bridges",
            };
            let field = self.field(field, &self.fleet_of(&identity).name);
            check_id(&identity.name).or_else(|error| refuse(&field, error.to_string()))?;
            let length = self.common_name(&identity).len();
            if length > MAX_COMMON_NAME {
                let problem = format!(
                    "the certificate of {} would have a name of {length} characters, and may have \
                     {MAX_COMMON_NAME}; choose a shorter name for it or the fleet",
                    identity.name
                );
                return refuse(field, problem);
            }
            if !named.insert(identity.clone()) {
                return refuse(field, format!("{} is named twice", identity.name));
            }
        }
        Ok(())
    }

    /// The first fleet, by whose name routers and hosts are certified.
    pub(super) fn first(&self) -> &Fleet {
        &self.fleets[0]
    }

    /// The fleet of which an identity is a member; the first for routers and hosts.
    pub(super) fn fleet_of(&self, identity: &Identity) -> &Fleet {
        let named = |fleet: &&Fleet| Some(&fleet.name) == identity.fleet.as_ref();
        self.fleets.iter().find(named).unwrap_or_else(|| self.first())
    }

    /// The fleets of an identity, for people.
    pub(super) fn whose(&self, identity: &Identity) -> String {
        let host = self.hosts.iter().find(|host| host.name == identity.name);
        match host.filter(|_| identity.kind == Kind::Host) {
            Some(host) => {
                let fleets: Vec<_> = host.fleets.iter().map(ToString::to_string).collect();
                format!("fleets {}", fleets.join(", "))
            }
            None => format!("fleet {}", self.fleet_of(identity).name),
        }
    }

    /// The names of all fleets, for people.
    pub(super) fn names(&self) -> String {
        self.fleets.iter().map(|fleet| fleet.name.as_str()).collect::<Vec<_>>().join(", ")
    }

    /// All identities of the file.
    pub(super) fn identities(&self) -> Vec<Identity> {
        let mut all = Vec::new();
        let mut add = |kind, fleet: Option<&FleetId>, name: &str| {
            all.push(Identity { kind, name: name.to_owned(), fleet: fleet.cloned() });
        };
        self.routers.iter().for_each(|router| add(Kind::Router, None, &router.name));
        self.hosts.iter().for_each(|host| add(Kind::Host, None, &host.name));
        for (at, fleet) in self.fleets.iter().enumerate() {
            let name = (at > 0).then_some(&fleet.name);
            fleet.services.iter().for_each(|service| add(Kind::Service, name, service.as_str()));
            fleet.robots.iter().for_each(|robot| add(Kind::Robot, name, robot.as_str()));
            fleet.operators.iter().for_each(|operator| add(Kind::Operator, name, operator));
            fleet.viewers.iter().for_each(|viewer| add(Kind::Viewer, name, viewer));
            fleet.bridges.iter().for_each(|bridge| add(Kind::Bridge, name, bridge));
        }
        all
    }

    /// The common name of a certificate, by which routers identify its subject.
    pub(super) fn common_name(&self, identity: &Identity) -> String {
        format!("{}.{}", identity.in_fleet(), self.fleet_of(identity).name)
    }

    /// A router by its name, or the only one.
    ///
    /// # Errors
    /// Names the routers of the fleet.
    pub(super) fn router(&self, name: Option<&str>) -> Result<&Router, ExitError> {
        let found = match name {
            Some(name) => self.routers.iter().find(|router| router.name == name),
            None => self.routers.first().filter(|_| self.routers.len() == 1),
        };
        found.ok_or_else(|| {
            let names: Vec<_> = self.routers.iter().map(|router| router.name.as_str()).collect();
            ExitError::usage(format!("--router: must be one of {}", names.join(", ")))
        })
    }
}

/// Whether a host name or an address is valid in an endpoint and in a certificate.
fn is_address(address: &str) -> bool {
    let is_name = address.split('.').all(|label| {
        !label.is_empty()
            && label.len() <= 63
            && label.chars().all(|c| c.is_ascii_alphanumeric() || c == '-')
            && !label.starts_with('-')
            && !label.ends_with('-')
    });
    address.parse::<IpAddr>().is_ok() || (is_name && address.len() <= MAX_ADDRESS)
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXAMPLE: &str = include_str!("../../../../deploy/fleet.toml");

    #[test]
    fn the_example_is_read() {
        let fleet = FleetFile::parse(EXAMPLE).unwrap();
        assert_eq!(fleet.identities().len(), 1 + 6 + 3 + 1 + 1);
        let robot = Identity { kind: Kind::Robot, name: "r1".to_owned(), fleet: None };
        assert_eq!(fleet.common_name(&robot), "robot.r1.default");
        let router = fleet.router(None).unwrap();
        assert_eq!(fleet.endpoint(router), "quic/base.local:7447");
        assert_eq!(router.listens(), ["quic/0.0.0.0:7447", "tls/0.0.0.0:7447"]);
    }

    #[test]
    fn an_error_names_the_field() {
        let with = |from: &str, to: &str| {
            assert!(EXAMPLE.contains(from), "{from}");
            FleetFile::parse(&EXAMPLE.replace(from, to)).unwrap_err().to_string()
        };
        assert!(with("\"r3\"", "\"R 3\"").contains("a-z"));
        assert!(with("\"r3\"", "\"r1\"").contains("robots: r1 is named twice"));
        let long = "x".repeat(60);
        assert!(with("\"r3\"", &format!("{long:?}")).contains("shorter"));
        assert!(with("operators =", "operator =").contains("operator"));
        assert!(with("\"planner\"]", "\"boss\"]").contains("boss"));
        assert!(with("\"base.local\"", "\"base local\"").contains("routers.base.addresses"));
        assert!(with("\"base.local\"", "\"tcp/base:1\"").contains("routers.base.addresses"));
        assert!(with("port = 7447", "port = 0").contains("routers.base.port"));
        assert!(
            with("certificate_days = 365", "certificate_days = 0").contains("certificate_days")
        );
        assert!(with("modalities = []", "modalities = [\"spatial\"]").contains("modalities"));
        assert!(with("[\"operator\"]", "[\"a.b\"]").contains("operators"));
        let address = FleetFile::parse(&EXAMPLE.replace("\"base.local\"", "\"::1\"")).unwrap();
        assert_eq!(address.endpoint(&address.routers[0]), "quic/[::1]:7447");
        assert_eq!(address.routers[0].listens(), ["quic/[::]:7447", "tls/[::]:7447"]);
        let over_tcp = FleetFile::parse(&EXAMPLE.replace("\"quic\"", "\"tls\"")).unwrap();
        assert_eq!(over_tcp.endpoint(&over_tcp.routers[0]), "tls/base.local:7447");
        assert!(with("\"quic\"", "\"tcp\"").contains("quic"));
        assert!(address.router(Some("other")).unwrap_err().message.contains("base"));
    }

    const TWO: &str = r#"
        [[fleets]]
        fleet = "site-2"
        robots = ["r1"]
        services = ["ingest"]

        [[hosts]]
        name = "base"
        fleets = ["default", "site-*"]
    "#;

    #[test]
    fn members_of_several_fleets_have_names_of_their_own() {
        let file = FleetFile::parse(&format!("{EXAMPLE}{TWO}")).unwrap();
        let names: Vec<(String, String)> = file
            .identities()
            .iter()
            .map(|identity| (identity.to_string(), file.common_name(identity)))
            .filter(|(text, _)| text.contains("r1") || text.contains("base"))
            .collect();
        let of = |text: &str, name: &str| (text.to_owned(), name.to_owned());
        assert_eq!(
            names,
            [
                of("router.base", "router.base.default"),
                of("host.base", "host.base.default"),
                of("robot.r1", "robot.r1.default"),
                of("robot.r1.site-2", "robot.r1.site-2"),
            ]
        );
        assert_eq!(file.names(), "default, site-2");
        let with = |from: &str, to: &str| {
            assert!(TWO.contains(from), "{from}");
            let text = format!("{EXAMPLE}{}", TWO.replace(from, to));
            FleetFile::parse(&text).unwrap_err().to_string()
        };
        assert!(with("\"site-2\"", "\"default\"").contains("fleets: default is named twice"));
        assert!(with("[\"r1\"]", "[\"r1\", \"r1\"]").contains("fleets.site-2.robots: r1"));
        assert!(with("\"default\", ", "\"a/b\", ").contains("a/b"));
        assert!(with("\"default\", \"site-*\"", "").contains("hosts.base.fleets: must be 1"));
        assert!(with("name = \"base\"", "name = \"b.c\"").contains("hosts: "));
    }
}
