//! Where a client finds its fleet, and how patient it is.

use std::path::PathBuf;
use std::time::Duration;

use muster_bus::config::{Choice, DEFAULT_ENDPOINT, DEFAULT_FLEET};
use muster_bus::{BusConfig, Mode, Patience, check_endpoint};
use muster_model::id::FleetId;
use muster_wire::Format;

use crate::error::Error;

/// When what a robot or console was told counts as stale: five heartbeats of `clusterer`, which is
/// also the time in which a service that died is back.
const STALE_AFTER: Duration = Duration::from_secs(5);

/// Shortest and longest time after which something may count as stale. Below, one lost message would
/// do it; above, nobody would ever be told.
const STALE_AFTER_RANGE: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(3600));

/// How often what a robot has said once is said again: seldom enough to cost nothing, often enough
/// that a service which lost it learns it within one breath of an operator.
const REPEAT_EVERY: Duration = Duration::from_secs(10);

/// Shortest and longest time between repetitions.
const REPEAT_EVERY_RANGE: (Duration, Duration) =
    (Duration::from_secs(1), Duration::from_secs(3600));

/// Where a client finds its fleet, and how patient it is.
///
/// ```
/// use muster_client::Config;
///
/// let config = Config { fleet: "alpha".to_owned(), ..Config::default() };
/// assert_eq!(config.routers, ["tcp/127.0.0.1:7447"]);
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
    /// `unixsock-stream/PATH`: the first that answers is used, another when that is lost.
    pub routers: Vec<String>,
    /// Zenoh's own configuration in JSON5, for everything else: certificates, user and password,
    /// access through several interfaces. What [`Config::routers`] names overrides its endpoints,
    /// unless that is the default.
    pub zenoh_config: Option<PathBuf>,
    /// How long opening waits for a router; none: until there is one.
    pub patience: Option<Duration>,
    /// When what was told last counts as stale, if nothing newer is told: 5 s. It must be longer than
    /// `heartbeat_s` of `clusterer`, and in fleets of thousands longer still: each robot that has
    /// heard nothing for half of it asks.
    pub stale_after: Duration,
    /// How often links, rank and relations that were put once are put again: 10 s.
    pub repeat_every: Duration,
    /// The form in which a robot speaks: JSON, which any tool reads, or binary, which is smaller.
    pub format: Format,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            fleet: DEFAULT_FLEET.to_owned(),
            routers: vec![DEFAULT_ENDPOINT.to_owned()],
            zenoh_config: None,
            patience: None,
            stale_after: STALE_AFTER,
            repeat_every: REPEAT_EVERY,
            format: Format::Json,
        }
    }
}

impl Config {
    /// The defaults, changed by the variables that every program of Muster reads: `MUSTER_FLEET`,
    /// `MUSTER_CONNECT` (several with commas), `MUSTER_ZENOH_CONFIG`. One that is empty is as good as
    /// none.
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
            routers: variable("MUSTER_CONNECT").map_or(default.routers, split),
            zenoh_config: variable("MUSTER_ZENOH_CONFIG").map(PathBuf::from),
            ..default
        }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// Names the first field that is wrong.
    pub fn check(&self) -> Result<(), Error> {
        self.bus().map(drop)
    }

    /// What the bus needs to know, with every field checked.
    pub(crate) fn bus(&self) -> Result<BusConfig, Error> {
        let fleet = FleetId::new(&self.fleet).map_err(Error::id("fleet"))?;
        if self.routers.is_empty() {
            return Err(Error::input("routers", "must name at least one, like tcp/10.0.0.1:7447"));
        }
        for router in &self.routers {
            check_endpoint(router).map_err(|problem| Error::input("routers", problem))?;
        }
        check_range("stale_after", self.stale_after, STALE_AFTER_RANGE)?;
        check_range("repeat_every", self.repeat_every, REPEAT_EVERY_RANGE)?;
        let chosen = self.routers != [DEFAULT_ENDPOINT];
        Ok(BusConfig {
            fleet,
            mode: Choice::default(Mode::Client),
            connect: Choice { value: self.routers.clone(), chosen },
            listen: Choice::default(Vec::new()),
            zenoh_config: self.zenoh_config.clone(),
        })
    }

    pub(crate) fn bus_patience(&self) -> Patience {
        self.patience.map_or(Patience::Forever, Patience::AtMost)
    }
}

fn check_range(
    field: &'static str,
    value: Duration,
    (least, most): (Duration, Duration),
) -> Result<(), Error> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
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
            ("routers", Config { routers: vec![], ..good() }),
            ("routers", Config { routers: vec!["here".to_owned()], ..good() }),
            ("stale_after", Config { stale_after: Duration::ZERO, ..good() }),
            ("repeat_every", Config { repeat_every: Duration::MAX, ..good() }),
        ];
        for (field, config) in wrong {
            let error = config.check().unwrap_err().to_string();
            assert!(error.starts_with(&format!("{field}: ")), "{error}");
        }
    }

    #[test]
    fn the_variables_of_our_programs_hold_here_too() {
        let config = Config::from_variables(&|name| match name {
            "MUSTER_FLEET" => Some("alpha".to_owned()),
            "MUSTER_CONNECT" => Some("tcp/a:1, ,tcp/b:2,".to_owned()),
            _ => None,
        });
        assert_eq!((config.fleet.as_str(), config.routers.len()), ("alpha", 2));
        assert!(config.bus().unwrap().connect.chosen);
        assert_eq!(Config::from_variables(&|_| None), Config::default());
        assert_eq!(Config::from_variables(&|_| Some(String::new())), Config::default());
    }
}
