//! Where a client finds its fleet, and its timeouts.

use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::time::Duration;

use muster_bus::config::{Choice, DEFAULT_ENDPOINT, DEFAULT_FLEET, LEASE};
use muster_bus::{BusConfig, ConnectTimeout, check_endpoint};
use muster_model::id::FleetId;
use muster_wire::Format;

use crate::error::Error;

/// When the newest message is stale: after five heartbeats of `clusterer`, which is also the time in
/// which a service that died is back.
const STALE_AFTER: Duration = Duration::from_secs(5);

/// Shortest and longest time after which a message may be stale. Below, one lost message would do it;
/// above, no operator would wait for it.
const STALE_AFTER_RANGE: RangeInclusive<Duration> =
    Duration::from_secs(1)..=Duration::from_secs(3600);

/// How often valid reports are republished: seldom enough to cost nothing, often enough that a service
/// which lost them has them again before an operator looks.
const REPUBLISH_EVERY: Duration = Duration::from_secs(10);

/// Shortest and longest time between republications.
const REPUBLISH_EVERY_RANGE: RangeInclusive<Duration> =
    Duration::from_secs(1)..=Duration::from_secs(3600);

/// How a client takes part in the bus.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Mode {
    /// Through a router.
    #[default]
    Client,
    /// With direct links to other peers, which do not relay for each other.
    Peer,
}

/// Where a client finds its fleet, and its timeouts.
///
/// ```
/// use muster_client::Config;
///
/// let config = Config { fleet: "alpha".to_owned(), ..Config::default() };
/// assert!(config.check().is_ok());
///
/// let wrong = Config { fleet: "Alpha".to_owned(), ..Config::default() };
/// assert!(wrong.check().unwrap_err().to_string().starts_with("fleet: "));
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Config {
    /// The fleet.
    pub fleet: String,
    /// Routers, as `tcp/HOST:PORT`, `quic/HOST:PORT`, `tls/HOST:PORT` or
    /// `unixsock-stream/PATH`: the first that answers is used, another when that is lost. None: those
    /// that [`Config::zenoh_config`] names, or `tcp/127.0.0.1:7447`, where the router of this host listens.
    pub routers: Option<Vec<String>>,
    /// Zenoh's own configuration in JSON5, for everything else: certificates, user and password,
    /// access through several interfaces. [`Config::routers`] overrides its endpoints.
    pub zenoh_config: Option<PathBuf>,
    /// How to take part in the bus.
    pub mode: Mode,
    /// Where a peer listens, in the form of [`Config::routers`].
    pub listen: Vec<String>,
    /// How long opening waits for a router; none: until there is one.
    pub connect_timeout: Option<Duration>,
    /// When the newest message is stale, if no newer one arrives: 5 s. It must be longer than
    /// `heartbeat_s` of `clusterer`, and longer still in fleets of thousands: each robot that received
    /// nothing for half of it sends a get.
    pub stale_after: Duration,
    /// How often links, rank and relations that were put once are republished: 10 s.
    pub republish_every: Duration,
    /// The format of a robot's messages: JSON, which any tool reads, or binary, which is smaller.
    pub format: Format,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            fleet: DEFAULT_FLEET.to_owned(),
            routers: None,
            zenoh_config: None,
            mode: Mode::default(),
            listen: Vec::new(),
            connect_timeout: None,
            stale_after: STALE_AFTER,
            republish_every: REPUBLISH_EVERY,
            format: Format::Json,
        }
    }
}

impl Config {
    /// The defaults, changed by the variables that every program of Muster reads: `MUSTER_FLEET`,
    /// `MUSTER_CONNECT` (several with commas), `MUSTER_ZENOH_CONFIG`. An empty one is ignored.
    #[must_use]
    pub fn from_env() -> Self {
        Self::from_variables(&|name| std::env::var(name).ok())
    }

    fn from_variables(variable: &dyn Fn(&str) -> Option<String>) -> Self {
        let default = Self::default();
        let variable = |name| variable(name).filter(|text| !text.is_empty());
        let split = |text: String| {
            text.split(',')
                .map(|part| part.trim().to_owned())
                .filter(|part| !part.is_empty())
                .collect()
        };
        Self {
            fleet: variable("MUSTER_FLEET").unwrap_or(default.fleet),
            routers: variable("MUSTER_CONNECT").map(split),
            zenoh_config: variable("MUSTER_ZENOH_CONFIG").map(PathBuf::from),
            ..default
        }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`Error::Input`] names the first field that is wrong.
    pub fn check(&self) -> Result<(), Error> {
        self.bus().map(drop)
    }

    /// The member of a fleet that the file with Zenoh's configuration is for, such as `operator.kim`; nothing without a
    /// file, or if it does not say whose it is. `muster deploy certs` writes it.
    ///
    /// # Errors
    /// [`Error::Input`] names the first field that is wrong.
    pub fn identity(&self) -> Result<Option<String>, Error> {
        muster_bus::identity(&self.bus()?).map_err(|error| Error::input("zenoh_config", &error))
    }

    /// The fleet, with every field checked that does not concern the session.
    pub(crate) fn fleet(&self) -> Result<FleetId, Error> {
        check_range("stale_after", self.stale_after, STALE_AFTER_RANGE)?;
        check_range("republish_every", self.republish_every, REPUBLISH_EVERY_RANGE)?;
        FleetId::new(&self.fleet).map_err(Error::id("fleet"))
    }

    /// The configuration of the bus, with every field checked.
    pub(crate) fn bus(&self) -> Result<BusConfig, Error> {
        let fleet = self.fleet()?;
        let connect = self.connect();
        if connect.value.is_empty() && self.mode == Mode::Client {
            return Err(Error::input("routers", "must name at least one, like tcp/10.0.0.1:7447"));
        }
        for (field, endpoints) in [("routers", &connect.value), ("listen", &self.listen)] {
            for endpoint in endpoints {
                check_endpoint(endpoint).map_err(|problem| Error::input(field, problem))?;
            }
        }
        let mode = match self.mode {
            Mode::Client => Choice::default(muster_bus::Mode::Client),
            Mode::Peer => Choice::chosen(muster_bus::Mode::Peer),
        };
        Ok(BusConfig {
            fleet,
            mode,
            connect,
            listen: Choice { value: self.listen.clone(), chosen: !self.listen.is_empty() },
            zenoh_config: self.zenoh_config.clone(),
            gossip: false,
            lease: LEASE,
        })
    }

    fn connect(&self) -> Choice<Vec<String>> {
        let default = || Choice::default(vec![DEFAULT_ENDPOINT.to_owned()]);
        self.routers.clone().map_or_else(default, Choice::chosen)
    }

    pub(crate) fn connect_timeout(&self) -> ConnectTimeout {
        self.connect_timeout.map_or(ConnectTimeout::Never, ConnectTimeout::After)
    }
}

fn check_range(
    field: &'static str,
    value: Duration,
    range: RangeInclusive<Duration>,
) -> Result<(), Error> {
    if range.contains(&value) {
        return Ok(());
    }
    let (least, most) = range.into_inner();
    Err(Error::input(field, format!("must be {least:?} to {most:?}, this is {value:?}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_wrong_field_is_named() {
        let good = Config::default;
        let wrong = [
            ("fleet", Config { fleet: "a/b".to_owned(), ..good() }),
            ("routers", Config { routers: Some(vec![]), ..good() }),
            ("routers", Config { routers: Some(vec!["here".to_owned()]), ..good() }),
            ("stale_after", Config { stale_after: Duration::ZERO, ..good() }),
            ("republish_every", Config { republish_every: Duration::MAX, ..good() }),
            ("listen", Config { listen: vec!["here".to_owned()], ..good() }),
        ];
        for (field, config) in wrong {
            let error = config.check().unwrap_err().to_string();
            assert!(error.starts_with(&format!("{field}: ")), "{error}");
        }
    }

    #[test]
    fn the_documented_defaults_are_the_real_ones() {
        let docs = [include_str!("lib.rs"), include_str!("config.rs")].concat();
        let Config { stale_after, republish_every, .. } = Config::default();
        let heartbeat_s = muster_model::settings::ClustererSettings::default().heartbeat_s;
        let follow_s = stale_after.as_secs_f64() + heartbeat_s;
        assert!(docs.contains(&format!("of `clusterer`, {follow_s} s by default")));
        assert!(docs.contains(&format!("if no newer one arrives: {} s", stale_after.as_secs())));
        assert!(docs.contains(&format!("are republished: {} s", republish_every.as_secs())));
    }

    #[test]
    fn a_named_router_overrides_zenohs_configuration_even_if_it_is_the_default() {
        let path =
            std::env::temp_dir().join(format!("muster-named-router-{}.json5", std::process::id()));
        std::fs::write(&path, "{connect: {endpoints: [\"tls/base:7447\"]}}").unwrap();
        let unnamed = Config { zenoh_config: Some(path.clone()), ..Config::default() };
        let named = Config { routers: Some(vec![DEFAULT_ENDPOINT.to_owned()]), ..unnamed.clone() };
        let routers = |config: &Config| muster_bus::routers(&config.bus().unwrap()).unwrap();
        assert_eq!(routers(&unnamed), ["tls/base:7447"]);
        assert_eq!(routers(&named), [DEFAULT_ENDPOINT]);
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn the_environment_of_all_programs_is_read() {
        let config = Config::from_variables(&|name| match name {
            "MUSTER_FLEET" => Some("alpha".to_owned()),
            "MUSTER_CONNECT" => Some("tcp/a:1, ,tcp/b:2,".to_owned()),
            _ => None,
        });
        assert_eq!(config.fleet, "alpha");
        let list = ["tcp/a:1", "tcp/b:2"].map(str::to_owned).to_vec();
        assert_eq!(config.bus().unwrap().connect, Choice::chosen(list));
        assert_eq!(Config::from_variables(&|_| None), Config::default());
        assert_eq!(Config::from_variables(&|_| Some(String::new())), Config::default());
    }
}
