//! What can be seen of a process from outside of the bus: health, readiness and metrics over HTTP.
//!
//! An [`Observatory`] belongs to a process and owns the port, if one is asked for, a [`FleetsObservatory`] to one that
//! serves many fleets; each service has an
//! [`Observer`], to which its shell reports what happens. The cores know nothing of it: what is measured is
//! what the shell sees pass, and the [`muster_model::status::ServiceStatus`] that every core has
//! anyway. The port is served by a thread of its own, so that it answers when everything else hangs.

mod counted;
mod fleets;
mod health;
mod http;
mod metrics;
mod observer;
mod process;

use std::sync::Arc;

use muster_model::id::ServiceName;

pub use self::fleets::FleetsObservatory;
use self::metrics::Metrics;
pub use self::observer::{Observer, Queues};
use self::observer::{Shared, Watched};
use crate::config::ProcessConfig;

/// What a process shows of itself.
#[derive(Debug)]
pub struct Observatory {
    shared: Arc<Shared>,
    /// Where it is shown; nowhere if no port is asked for. The port closes with it.
    port: Option<http::Port>,
}

impl Observatory {
    /// Opens the port of a process, if its configuration names one, and begins to watch its services.
    ///
    /// # Errors
    /// If the port cannot be listened at; the text names the flag.
    pub fn open(config: &ProcessConfig, services: &[ServiceName]) -> anyhow::Result<Self> {
        let metrics = Metrics::new(&config.fleet.value);
        let mut services = services.to_vec();
        services.sort_unstable();
        services.dedup();
        let watched =
            services.iter().map(|service| Arc::new(Watched::new(*service, &metrics))).collect();
        let shared = Arc::new(Shared::new(metrics, watched));
        let port = match config.http.value {
            Some(address) => Some(http::Port::open(address, Arc::clone(&shared) as _)?),
            None => None,
        };
        Ok(Self { shared, port })
    }

    /// Where the port listens, if there is one.
    #[must_use]
    pub fn address(&self) -> Option<std::net::SocketAddr> {
        self.port.as_ref().map(http::Port::address)
    }

    /// Reports that the loop of the router of this process runs. From the first call on, the process counts as
    /// alive only while calls follow at least every five seconds.
    pub fn router_turned(&self) {
        self.shared.router_turned();
    }

    /// The observer of a service. One that was not named when the observatory was opened is watched
    /// without being shown.
    #[must_use]
    pub fn observer(&self, service: ServiceName) -> Observer {
        let known = self.shared.watched.iter().find(|watched| watched.service == service);
        let watched =
            known.map_or_else(|| Arc::new(Watched::new(service, &self.shared.metrics)), Arc::clone);
        Observer::new(watched)
    }
}
