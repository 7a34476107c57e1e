//! Identities and rules of a secured bus, as `muster deploy` makes them from a fleet file, and the choice
//! between a plain and a secured bus.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::{Context, ensure};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::process::run;

/// How long `muster deploy` may take.
const DEPLOYED_WITHIN: Duration = Duration::from_secs(60);

/// Chooses the bus of the tests that may run on either: `plain`, `secured`, or a seed.
pub const BUS_VARIABLE: &str = "MUSTER_TEST_BUS";

/// The operator of every fleet of the tests, which may read everything and change settings.
pub const OPERATOR: &str = "operator.operator";

/// The viewer of every fleet of the tests, which may read everything and change nothing.
pub const VIEWER: &str = "viewer.wall";

/// The bridge to robots of ROS of every fleet of the tests.
pub const BRIDGE: &str = "bridge.ros2";

/// A member that no test counts on, for messages that exceed its rights.
pub const STRANGER: &str = "stranger";

/// Whether members show certificates and may do only their part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Security {
    /// Whoever reaches the router may do everything.
    Plain,
    /// Mutual TLS and access control.
    Secured,
}

impl Security {
    /// The bus of a test by its name: as [`BUS_VARIABLE`] says, or by a seed of the moment, which is printed
    /// so that the choice can be repeated.
    ///
    /// # Errors
    /// If the variable is neither of the two nor a number.
    pub fn drawn(test: &str) -> anyhow::Result<Self> {
        static FRESH_SEED: OnceLock<u64> = OnceLock::new();
        let chosen = std::env::var(BUS_VARIABLE).unwrap_or_default();
        let seed = match chosen.as_str() {
            "plain" => return Ok(Self::Plain),
            "secured" => return Ok(Self::Secured),
            "" => *FRESH_SEED.get_or_init(|| {
                SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
            }),
            number => number
                .parse()
                .with_context(|| format!("{BUS_VARIABLE}: must be plain, secured or a seed"))?,
        };
        let security = Self::of_seed(seed, test);
        // Past the test harness, which keeps back what a good test prints.
        writeln!(std::io::stderr(), "{test}: {security:?} bus; again: {BUS_VARIABLE}={seed}")?;
        Ok(security)
    }

    /// The bus that a seed chooses for a test.
    #[must_use]
    pub fn of_seed(seed: u64, test: &str) -> Self {
        let mut key = [0; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        for (place, byte) in test.bytes().enumerate() {
            let place = 8 + place % 24;
            key[place] = key[place].rotate_left(3) ^ byte;
        }
        let is_secured = ChaCha8Rng::from_seed(key).random::<bool>();
        if is_secured { Self::Secured } else { Self::Plain }
    }
}

/// The identities of a fleet with one router on loopback.
#[derive(Debug)]
pub(crate) struct Access {
    identities: PathBuf,
    /// The whole configuration of the router.
    pub(crate) router: PathBuf,
}

fn text(path: &Path) -> anyhow::Result<&str> {
    path.to_str().context("a path of the tests is not UTF-8")
}

fn deploy(arguments: &[&str]) -> anyhow::Result<()> {
    let (code, out, err) = run("muster", &[&["deploy"], arguments].concat(), DEPLOYED_WITHIN)?;
    ensure!(code == Some(0), "muster deploy {arguments:?}: {out}{err}");
    Ok(())
}

impl Access {
    /// Makes identities in a folder: of the services, of these robots, of [`OPERATOR`], of [`BRIDGE`] and of the
    /// robot [`STRANGER`].
    ///
    /// # Errors
    /// If `muster deploy` is not built or refuses.
    pub(crate) fn new(
        folder: &Path,
        fleet: &str,
        port: &str,
        robots: &[String],
    ) -> anyhow::Result<Self> {
        let file = folder.join("fleet.toml");
        let names: Vec<&str> = robots.iter().map(String::as_str).chain([STRANGER]).collect();
        let content = format!(
            "fleet = \"{fleet}\"\nrobots = {names:?}\noperators = [\"operator\"]\nviewers = [\"wall\"]\n\
             bridges = [\"ros2\"]\n[[routers]]\n\
             name = \"base\"\naddresses = [\"127.0.0.1\"]\nport = {port}\n"
        );
        std::fs::write(&file, content)?;
        let (identities, router) = (folder.join("identities"), folder.join("router.json5"));
        let file = text(&file)?;
        deploy(&["certs", "--fleet-file", file, "--out", text(&identities)?])?;
        let identity = identities.join("router.base");
        let files = ["--identity", text(&identity)?, "--out", text(&router)?];
        deploy(&[&["acl", "--fleet-file", file], &files[..]].concat())?;
        Ok(Self { identities, router })
    }

    /// The Zenoh configuration of a member, such as `robot.r1`.
    pub(crate) fn config(&self, identity: &str) -> PathBuf {
        self.identities.join(identity).join("zenoh.json5")
    }

    /// The endpoint of the router, by the protocol that `muster deploy` chose.
    ///
    /// # Errors
    /// If an identity names none.
    pub(crate) fn endpoint(&self) -> anyhow::Result<String> {
        let config = zenoh::Config::from_file(self.config(OPERATOR))
            .map_err(|error| anyhow::anyhow!("{error}"))?;
        let json = config.get_json("connect/endpoints").map_err(|e| anyhow::anyhow!("{e}"))?;
        let endpoints: Vec<String> = serde_json::from_str(&json)?;
        endpoints.into_iter().next().context("an identity names no router")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_chooses_the_same_bus_again_and_both_over_many() {
        let of = |seed| Security::of_seed(seed, "a_test");
        assert!((0..50).all(|seed| of(seed) == of(seed)));
        let secured = (0..50).filter(|seed| of(*seed) == Security::Secured).count();
        assert!((10..40).contains(&secured), "{secured} of 50");
        assert!((0..50).any(|seed| of(seed) != Security::of_seed(seed, "another_test")));
    }
}
