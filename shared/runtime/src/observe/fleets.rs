//! What a process shows that serves many fleets: the metrics of each under its name, and which of them is not ready.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use muster_model::id::{FleetId, ServiceName};
use prometheus_client::encoding::text::{encode_eof, encode_registry};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;
use serde_json::{Map, Value, json};

use super::health;
use super::http::Port;
use super::metrics::{self, Metrics};
use super::observer::{Observer, Shared, Watched};
use crate::config::ProcessConfig;

/// Most fleets that an answer names: no one would read more.
const MAX_NAMED: usize = 100;

/// Histograms of which each fleet shows the count and the sum alone: a thousand fleets have too many lines as it is.
const WITHOUT_BUCKETS: [&str; 3] =
    ["muster_event_handling_seconds", "muster_job_seconds", "muster_embedding_stage_seconds"];

/// Whether a sample of a fleet is left out.
fn is_left_out(line: &str) -> bool {
    let of =
        |name: &&str| line.strip_prefix(*name).is_some_and(|rest| rest.starts_with("_bucket{"));
    // The last bucket, which has all, belongs to the form of a histogram.
    WITHOUT_BUCKETS.iter().any(of) && !line.contains("le=\"+Inf\"")
}

/// What a process shows of many fleets. Clones share it.
#[derive(Debug, Clone)]
pub struct FleetsObservatory {
    pub(super) fleets: Arc<Fleets>,
    /// The port closes with the last clone.
    port: Option<Arc<Port>>,
}

/// The fleets of a process.
#[derive(Debug)]
pub(super) struct Fleets {
    known: RwLock<BTreeMap<FleetId, Known>>,
    host: Host,
}

#[derive(Debug)]
struct Known {
    shared: Arc<Shared>,
    /// Why its services have ended, until they run again.
    failed: Option<String>,
}

/// What belongs to no fleet, and what a fleet costs its host.
#[derive(Debug)]
struct Host {
    registry: Registry,
    process: Registry,
    served: Gauge,
    refused: Gauge,
    restarts: Family<[(&'static str, String); 1], Counter>,
    dropped: Family<[(&'static str, String); 1], Counter>,
    linked: AtomicU64,
}

impl Host {
    fn new() -> Self {
        let (registry, process) = metrics::of_process();
        let mut host = Self {
            registry,
            process,
            served: Gauge::default(),
            refused: Gauge::default(),
            restarts: Family::default(),
            dropped: Family::default(),
            linked: AtomicU64::new(0),
        };
        let to = &mut host.registry;
        to.register("fleets", "Fleets that this process serves", host.served.clone());
        let help = "Fleets that appeared and are not served, because as many are served as may be";
        to.register("fleets_refused", help, host.refused.clone());
        let help = "Times that the services of a fleet failed and were started again";
        to.register("fleet_restarts", help, host.restarts.clone());
        let help =
            "Messages of robots that were dropped because their fleet sent more than one fleet may";
        to.register("fleet_messages_dropped", help, host.dropped.clone());
        host
    }
}

impl FleetsObservatory {
    /// Opens the port of a process, if its configuration names one. There are no fleets yet.
    ///
    /// # Errors
    /// If the port cannot be listened at; the text names the flag.
    pub fn open(config: &ProcessConfig) -> anyhow::Result<Self> {
        let fleets = Arc::new(Fleets { known: RwLock::default(), host: Host::new() });
        let port = match config.http.value {
            Some(address) => Some(Arc::new(Port::open(address, Arc::clone(&fleets) as _)?)),
            None => None,
        };
        Ok(Self { fleets, port })
    }

    /// Where the port listens, if there is one.
    #[must_use]
    pub fn address(&self) -> Option<std::net::SocketAddr> {
        self.port.as_ref().map(|port| port.address())
    }

    /// A router has answered: from now on the process is ready when its fleets are.
    pub fn linked(&self) {
        self.fleets.host.linked.store(1, Ordering::Relaxed);
    }

    /// The observers of services of a fleet, which is shown from now on.
    #[must_use]
    pub fn watch(&self, fleet: &FleetId, services: &[ServiceName]) -> Vec<Observer> {
        let metrics = Metrics::new(fleet);
        let watched: Vec<_> =
            services.iter().map(|service| Arc::new(Watched::new(*service, &metrics))).collect();
        let shared = Arc::new(Shared::new(metrics, watched.clone()));
        let mut known = self.fleets.write();
        known.insert(fleet.clone(), Known { shared, failed: None });
        self.fleets.host.served.set(metrics::count(known.len()));
        watched.into_iter().map(Observer::new).collect()
    }

    /// The services of a fleet have ended, and will be started again.
    pub fn failed(&self, fleet: &FleetId, problem: String) {
        if let Some(known) = self.fleets.write().get_mut(fleet) {
            known.failed = Some(problem);
        }
        let labels = [("fleet", fleet.to_string())];
        self.fleets.host.restarts.get_or_create(&labels).inc();
    }

    /// A fleet is not served any more.
    pub fn forget(&self, fleet: &FleetId) {
        let mut known = self.fleets.write();
        known.remove(fleet);
        self.fleets.host.served.set(metrics::count(known.len()));
        let labels = [("fleet", fleet.to_string())];
        self.fleets.host.restarts.remove(&labels);
        self.fleets.host.dropped.remove(&labels);
    }

    /// So many fleets have appeared and are not served.
    pub fn refused(&self, count: usize) {
        self.fleets.host.refused.set(metrics::count(count));
    }

    /// So many messages of a fleet were dropped so far. A fleet that never sent too many has no such metric.
    pub fn dropped(&self, fleet: &FleetId, total: u64) {
        if total > 0 {
            let labels = [("fleet", fleet.to_string())];
            metrics::set_counter(&self.fleets.host.dropped.get_or_create(&labels), total);
        }
    }
}

impl Fleets {
    /// No critical section can panic half-way, so that a poisoned lock still guards a whole list.
    fn read(&self) -> RwLockReadGuard<'_, BTreeMap<FleetId, Known>> {
        self.known.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, BTreeMap<FleetId, Known>> {
        self.known.write().unwrap_or_else(PoisonError::into_inner)
    }

    /// An answer about all fleets, which names those that are not well by their services and what is wrong with each.
    fn answer(
        &self,
        name: &str,
        bad: &str,
        wrong: impl Fn(&Known) -> Map<String, Value>,
    ) -> (bool, Value) {
        let known = self.read();
        let mut named = Map::new();
        let mut count = 0_usize;
        for (fleet, known) in known.iter() {
            let wrong = wrong(known);
            if !wrong.is_empty() {
                count += 1;
                if named.len() < MAX_NAMED {
                    named.insert(fleet.to_string(), wrong.into());
                }
            }
        }
        let good = count == 0;
        (good, json!({name: good, "fleets": known.len(), bad: named}))
    }
}

impl super::http::Shown for Fleets {
    fn healthz(&self) -> (bool, Value) {
        self.answer("alive", "not_alive", |known| {
            // What has failed is started again after a pause, in which nothing of it turns.
            if known.failed.is_some() {
                return Map::new();
            }
            let looks =
                known.shared.watched.iter().map(|watched| (watched.service, watched.look()));
            let hanging = looks.filter(|(_, look)| !health::is_alive(look));
            let since = |look: &health::Look| look.since_turn.map(|since| since.as_secs_f64());
            hanging
                .map(|(service, look)| (service.to_string(), json!({"last_turn_s": since(&look)})))
                .collect()
        })
    }

    fn readyz(&self) -> (bool, Value) {
        let (good, mut answer) = self.answer("ready", "not_ready", |known| {
            if let Some(problem) = &known.failed {
                return Map::from_iter([("services".to_owned(), json!([problem]))]);
            }
            let reasons = known.shared.watched.iter().map(|watched| {
                (watched.service.to_string(), health::reasons(watched.service, &watched.look()))
            });
            let not_ready = reasons.filter(|(_, reasons)| !reasons.is_empty());
            not_ready.map(|(service, reasons)| (service, json!(reasons))).collect()
        });
        if self.host.linked.load(Ordering::Relaxed) == 0 {
            answer["ready"] = false.into();
            answer["reasons"] = json!(["no router has answered yet"]);
            return (false, answer);
        }
        (good, answer)
    }

    fn metrics(&self) -> Result<String, std::fmt::Error> {
        let shared: Vec<_> = self.read().values().map(|known| Arc::clone(&known.shared)).collect();
        let mut text = String::new();
        encode_registry(&mut text, &self.host.process)?;
        let mut own = String::new();
        encode_registry(&mut own, &self.host.registry)?;
        let mut merged = Merged::default();
        merged.add(&own);
        for shared in shared {
            shared.watched.iter().for_each(|watched| watched.refresh());
            merged.add(&shared.metrics.of_fleet()?);
        }
        merged.write(&mut text)?;
        encode_eof(&mut text)?;
        Ok(text)
    }
}

/// Metrics of several registries in one text: all samples of a metric must stand together, under one description.
#[derive(Debug, Default)]
struct Merged {
    /// The descriptions and samples of the metrics, in the order in which they came.
    metrics: Vec<(String, String)>,
    places: BTreeMap<String, usize>,
}

impl Merged {
    /// Adds the text of a registry, each of whose metrics begins with its description.
    fn add(&mut self, text: &str) {
        let mut place = None;
        let mut is_new = false;
        for line in text.split_inclusive('\n') {
            if let Some(rest) = line.strip_prefix("# HELP ") {
                let name = rest.split(' ').next().unwrap_or_default();
                is_new = !self.places.contains_key(name);
                if is_new {
                    self.places.insert(name.to_owned(), self.metrics.len());
                    self.metrics.push((String::new(), String::new()));
                }
                place = self.places.get(name).copied();
            }
            let Some((description, samples)) = place.and_then(|at| self.metrics.get_mut(at)) else {
                continue;
            };
            if !line.starts_with('#') {
                if !is_left_out(line) {
                    samples.push_str(line);
                }
            } else if is_new {
                description.push_str(line);
            }
        }
    }

    fn write(&self, to: &mut String) -> std::fmt::Result {
        self.metrics.iter().try_for_each(|(description, samples)| {
            to.write_str(description)?;
            to.write_str(samples)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::http::Shown as _;
    use super::*;
    use crate::config::{Mode, ProcessArgs};

    fn observatory() -> FleetsObservatory {
        let args = ProcessArgs::default();
        let config = ProcessConfig::resolve(&args, Mode::Client, &|_| None).unwrap();
        FleetsObservatory::open(&config).unwrap()
    }

    fn fleet(name: &str) -> FleetId {
        FleetId::new(name).unwrap()
    }

    #[test]
    fn all_samples_of_a_metric_stand_together_under_one_description() {
        let observatory = observatory();
        let services = [ServiceName::Ingest, ServiceName::Embedder];
        for name in ["alpha", "beta"] {
            let observers = observatory.watch(&fleet(name), &services);
            observers[0].link(true);
        }
        observatory.dropped(&fleet("beta"), 7);
        let text = observatory.fleets.metrics().unwrap();
        let mut seen = std::collections::BTreeSet::new();
        for line in text.lines().filter_map(|line| line.strip_prefix("# TYPE ")) {
            assert!(seen.insert(line.split(' ').next().unwrap()), "{line} stands twice");
        }
        let at = |line: &str| text.find(line).unwrap_or_else(|| panic!("{line} is missing"));
        let link = at("# TYPE muster_link_up gauge");
        let [alpha, beta] = ["alpha", "beta"]
            .map(|name| at(&format!("muster_link_up{{fleet=\"{name}\",service=\"ingest\"}} 1")));
        let between = &text[link + 1..beta];
        assert!(link < alpha && alpha < beta && !between.contains("# TYPE"), "{between}");
        assert!(text.contains("muster_fleets 2\n"), "{text}");
        let buckets = |name: &str| {
            let of_ingest = |line: &&str| {
                line.starts_with(&format!("{name}_bucket{{"))
                    && line.contains("fleet=\"alpha\"")
                    && line.contains("service=\"ingest\"")
            };
            text.lines().filter(of_ingest).count()
        };
        assert_eq!(buckets("muster_data_age_seconds"), 16);
        assert_eq!(buckets("muster_job_seconds"), 1);
        assert!(text.contains("muster_fleet_messages_dropped_total{fleet=\"beta\"} 7\n"), "{text}");
        assert!(text.ends_with("# EOF\n"));
        observatory.forget(&fleet("alpha"));
        let text = observatory.fleets.metrics().unwrap();
        assert!(!text.contains("alpha") && text.contains("muster_fleets 1\n"), "{text}");
    }

    #[test]
    fn ready_names_the_fleets_that_are_not() {
        let observatory = observatory();
        let (ready, answer) = observatory.fleets.readyz();
        assert!(!ready && answer["reasons"][0] == "no router has answered yet", "{answer}");
        observatory.linked();
        assert!(observatory.fleets.readyz().0, "a host without fleets misses nothing");
        let observers = observatory.watch(&fleet("alpha"), &[ServiceName::Ingest]);
        let (ready, answer) = observatory.fleets.readyz();
        assert!(!ready && answer["not_ready"]["alpha"]["ingest"].is_array(), "{answer}");
        observers[0].link(true);
        let reasons = |answer: &Value| answer["not_ready"]["alpha"]["ingest"][0].clone();
        assert_eq!(reasons(&observatory.fleets.readyz().1), "the term has not begun");
        observatory.failed(&fleet("alpha"), "a service failed".to_owned());
        let (_, answer) = observatory.fleets.readyz();
        assert_eq!(answer["not_ready"]["alpha"]["services"][0], "a service failed");
    }
}
