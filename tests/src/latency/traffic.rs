//! How many bytes each kind of key carries, for each robot: what an operator of a slow link adds up.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::client::Client;

/// The keys of services, and all keys of ten robots: those of every robot would be as much work for the router as the whole
/// fleet.
const PATTERNS: [&str; 5] = ["*", "graph/*", "json/*", "service/**", "robot/r00000$*/*"];

/// How many robots the last pattern has.
const SAMPLED_ROBOTS: usize = 10;

/// What the messages of one kind of key take.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Load {
    /// How many messages.
    pub messages: u64,
    /// The bytes of their payloads.
    pub bytes: u64,
}

/// What each kind of key carried within a time.
#[derive(Debug, Clone, Default)]
pub struct Traffic {
    /// By the key, with a star for what differs from robot to robot or from service to service. What robots carry is that of
    /// the sampled ones.
    by_key: BTreeMap<String, Load>,
    seconds: f64,
    robots: usize,
}

/// What one kind of key carries.
#[derive(Debug, Clone, PartialEq)]
pub struct Carried {
    /// The key.
    pub key: String,
    /// Messages per second, of all robots.
    pub messages_hz: f64,
    /// Bytes of payload for each message.
    pub bytes: f64,
    /// Bytes of payload per second for each robot of the fleet.
    pub robot_bytes_hz: f64,
}

/// The key with a star for what differs from robot to robot or from service to service.
fn kind(tail: &str) -> String {
    let chunks = tail.split('/').enumerate();
    let is_varied = tail.starts_with("robot/") || tail.starts_with("service/");
    let chunks: Vec<_> =
        chunks.map(|(at, chunk)| if at == 1 && is_varied { "*" } else { chunk }).collect();
    chunks.join("/")
}

impl Traffic {
    /// Listens to a fleet of so many robots for a time.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn listen(client: &Client, robots: usize, lasts: Duration) -> anyhow::Result<Self> {
        let seen = Arc::new(Mutex::new(BTreeMap::<String, Load>::new()));
        let prefix = client.key("");
        for pattern in PATTERNS {
            let (seen, prefix) = (Arc::clone(&seen), prefix.clone());
            let subscriber = client.session().declare_subscriber(client.key(pattern));
            let subscriber = subscriber.callback(move |sample| {
                let tail = sample.key_expr().as_str().strip_prefix(&prefix).map(kind);
                let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
                let load = seen.entry(tail.unwrap_or_default()).or_default();
                load.messages += 1;
                load.bytes += sample.payload().len() as u64;
            });
            subscriber.background().await.map_err(|error| anyhow::anyhow!("{pattern}: {error}"))?;
        }
        tokio::time::sleep(lasts).await;
        let by_key = std::mem::take(&mut *seen.lock().unwrap_or_else(PoisonError::into_inner));
        Ok(Self { by_key, seconds: lasts.as_secs_f64(), robots })
    }

    /// What each kind of key carries, the heaviest first.
    #[must_use]
    pub fn carried(&self) -> Vec<Carried> {
        let mut all: Vec<_> = self.by_key.iter().map(|(key, load)| self.one(key, *load)).collect();
        all.sort_by(|left, right| right.robot_bytes_hz.total_cmp(&left.robot_bytes_hz));
        all
    }

    fn one(&self, key: &str, load: Load) -> Carried {
        let robots = self.robots as f64;
        let sampled = robots.min(SAMPLED_ROBOTS as f64);
        let of_all = if key.starts_with("robot/") { robots / sampled } else { 1.0 };
        let Load { messages, bytes } = load;
        Carried {
            key: key.to_owned(),
            messages_hz: messages as f64 * of_all / self.seconds,
            bytes: bytes as f64 / messages.max(1) as f64,
            robot_bytes_hz: bytes as f64 * of_all / self.seconds / robots,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_are_sampled_and_services_are_not() {
        for (tail, wanted) in [
            ("robot/r000003/pose", "robot/*/pose"),
            ("service/ingest/holder", "service/*/holder"),
            ("graph/spatial", "graph/spatial"),
            ("teams", "teams"),
        ] {
            assert_eq!(kind(tail), wanted);
        }
        let load = |messages, bytes| Load { messages, bytes };
        let by_key = [("robot/*/pose", load(20, 2000)), ("teams", load(4, 4000))];
        let by_key = by_key.map(|(key, load)| (key.to_owned(), load)).into();
        let traffic = Traffic { by_key, seconds: 2.0, robots: 100 };
        let carried = |key: &str, messages_hz, bytes, robot_bytes_hz| Carried {
            key: key.to_owned(),
            messages_hz,
            bytes,
            robot_bytes_hz,
        };
        let wanted =
            [carried("robot/*/pose", 100.0, 100.0, 100.0), carried("teams", 2.0, 1000.0, 20.0)];
        assert_eq!(traffic.carried(), wanted);
    }
}
