//! The metrics of a process, by the conventions of Prometheus, as OpenMetrics text.

use std::fmt::Debug;
use std::hash::Hash;
use std::time::Duration;

use muster_model::id::{FleetId, ServiceName};
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::encoding::text::{encode_eof, encode_registry};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Metric, Registry, Unit};

use super::counted::Counted;
use super::process::ProcessCollector;

/// What `/metrics` answers with.
pub(super) const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// A gauge of fractions.
pub(super) type Number = Gauge<f64, std::sync::atomic::AtomicU64>;

/// The labels of a metric that each service has: none but the service.
pub(super) type Of = [(&'static str, &'static str); 1];

/// The same with one label more.
pub(super) type OfWith = [(&'static str, &'static str); 2];

/// The same with a text that is only known at run time.
pub(super) type OfNamed = [(&'static str, String); 2];

type Histograms = Family<Of, Histogram, fn() -> Histogram>;

/// The same for several labels.
pub(super) type HistogramsWith = Family<OfWith, Histogram, fn() -> Histogram>;

/// 10 µs to 2.6 s: an event is handled in microseconds, unless something is wrong.
fn handling() -> Histogram {
    Histogram::new(exponential_buckets(1e-5, 4.0, 10))
}

/// 1 ms to 16 s: what a stage, a job or the whole way of a pose takes.
fn stage() -> Histogram {
    Histogram::new(exponential_buckets(1e-3, 2.0, 15))
}

/// The trust in a modality of which nothing is known yet: a scrape between the first two steps must not see doubt.
fn trusted() -> Number {
    let trust = Number::default();
    trust.set(1.0);
    trust
}

/// All metrics of a process.
#[derive(Debug)]
pub(super) struct Metrics {
    pub(super) up: Family<Of, Gauge>,
    pub(super) ready: Family<Of, Gauge>,
    pub(super) term: Family<Of, Gauge>,
    pub(super) epoch: Family<Of, Gauge>,
    pub(super) standing: Family<OfWith, Gauge>,
    pub(super) link: Family<Of, Gauge>,
    pub(super) reconnects: Family<Of, Counter>,
    pub(super) data_age: Histograms,
    pub(super) stage: Histograms,
    pub(super) events: Family<OfWith, Counter>,
    pub(super) handling: Histograms,
    pub(super) jobs_running: Family<Of, Gauge>,
    pub(super) job: Histograms,
    pub(super) jobs_failed: Family<Of, Counter>,
    pub(super) inbox: Family<Of, Gauge>,
    pub(super) inbox_bytes: Family<Of, Gauge>,
    pub(super) inbox_superseded: Family<Of, Counter>,
    pub(super) inbox_dropped: Family<Of, Counter>,
    pub(super) outbox: Family<Of, Gauge>,
    pub(super) outbox_bytes: Family<Of, Gauge>,
    pub(super) outbox_sent: Family<Of, Counter>,
    pub(super) outbox_dropped: Family<Of, Counter>,
    pub(super) received_bytes: Family<Of, Counter>,
    pub(super) published_bytes: Family<Of, Counter>,
    pub(super) answered: Family<Of, Counter>,
    pub(super) refused: Family<Of, Counter>,
    pub(super) state_lost: Family<Of, Gauge>,
    pub(super) state_unwritable: Family<Of, Gauge>,
    pub(super) counted: Counted,
    pub(super) results: Results,
    /// What every process has, under the names that Prometheus gives it.
    process: Registry,
    /// What Muster counts, all under `muster_` and with the fleet as a label.
    registry: Registry,
}

/// The metrics that only one service has: they appear with the first result.
#[derive(Debug, Clone)]
pub(super) struct Results {
    pub(super) robots: Family<OfWith, Gauge>,
    pub(super) teams: Family<Of, Gauge>,
    pub(super) teams_requested: Family<Of, Gauge>,
    pub(super) unassigned: Family<Of, Gauge>,
    pub(super) silhouette: Family<OfWith, Number>,
    pub(super) returns: Family<Of, Number>,
    pub(super) alerts: Family<OfWith, Gauge>,
    pub(super) trust: Family<OfNamed, Number, fn() -> Number>,
    pub(super) katz_residual: Family<Of, Number>,
    pub(super) residual: Family<Of, Number>,
    pub(super) spectral_radius: Family<Of, Number>,
    pub(super) alpha: Family<Of, Number>,
    pub(super) embeddings: Family<OfWith, Counter>,
    pub(super) embedding_stage: HistogramsWith,
    pub(super) history_degraded: Family<Of, Gauge>,
    pub(super) history_bytes: Family<Of, Gauge>,
    pub(super) history_through: Family<Of, Number>,
}

/// A new metric under a name.
fn metric<M: Metric + Clone + Default>(to: &mut Registry, name: &str, help: &str) -> M {
    let metric = M::default();
    to.register(name, help, metric.clone());
    metric
}

/// A new metric in bytes.
fn bytes<M: Metric + Clone + Default>(to: &mut Registry, name: &str, help: &str) -> M {
    let metric = M::default();
    to.register_with_unit(name, help, Unit::Bytes, metric.clone());
    metric
}

/// New histograms in seconds.
fn seconds<L: EncodeLabelSet + Clone + Eq + Hash + Send + Sync + Debug + 'static>(
    to: &mut Registry,
    buckets: fn() -> Histogram,
    name: &str,
    help: &str,
) -> Family<L, Histogram, fn() -> Histogram> {
    let histograms = Family::new_with_constructor(buckets);
    to.register_with_unit(name, help, Unit::Seconds, Family::clone(&histograms));
    histograms
}

impl Results {
    fn new(to: &mut Registry) -> Self {
        Self {
            robots: metric(to, "robots", "Robots of the roster, by presence"),
            teams: metric(to, "teams", "Teams of the division"),
            teams_requested: metric(to, "teams_requested", "Teams that were asked for"),
            unassigned: metric(to, "robots_unassigned", "Robots that no relation ties to a team"),
            silhouette: metric(
                to,
                "silhouette_mean",
                "Mean silhouette of the division, by the space that it is taken in",
            ),
            returns: metric(
                to,
                "team_returns_per_robot_minute",
                "Changes of robots into a team that they had left within the last minute",
            ),
            alerts: metric(to, "alerts_open", "Open alerts, by kind"),
            trust: {
                let trust = Family::new_with_constructor(trusted as fn() -> Number);
                let help = "By how much the weight of each modality is multiplied, from 0 to 1";
                to.register("modality_trust", help, Family::clone(&trust));
                trust
            },
            katz_residual: metric(to, "katz_residual", "Relative residual of the Katz similarity"),
            residual: metric(
                to,
                "embedding_residual",
                "Largest relative residual of the singular triplets",
            ),
            spectral_radius: metric(
                to,
                "spectral_radius",
                "Upper bound of the spectral radius (rho) of the fused graph",
            ),
            alpha: metric(to, "katz_alpha", "Decay (alpha) of the Katz similarity"),
            embeddings: metric(
                to,
                "embeddings",
                "Embeddings that were published, by how they were computed",
            ),
            embedding_stage: seconds(
                to,
                handling,
                "embedding_stage",
                "Time that each stage of an embedding took",
            ),
            history_degraded: metric(
                to,
                "history_degraded",
                "1 while a historian keeps less than it should",
            ),
            history_bytes: bytes(to, "history", "Bytes that the records of a history take"),
            history_through: {
                let through = Family::default();
                let help = "Up to when a history is on the disk, since 1970";
                let name = "history_recorded_through_timestamp";
                to.register_with_unit(name, help, Unit::Seconds, Family::clone(&through));
                through
            },
        }
    }
}

impl Metrics {
    /// The metrics of a process of a fleet, all at zero.
    pub(super) fn new(fleet: &FleetId) -> Self {
        let fleet = ("fleet".into(), fleet.as_str().to_owned().into());
        let mut registry = Registry::with_prefix_and_labels("muster", [fleet].into_iter());
        register_build(&mut registry);
        let counted = Counted::default();
        registry.register_collector(Box::new(counted.clone()));
        let to = &mut registry;
        Self {
            up: metric(
                to,
                "loop_turning",
                "1 while the loop of the service runs, as /healthz has it",
            ),
            ready: metric(to, "ready", "1 while the service is ready, as /readyz has it"),
            term: metric(to, "term", "Term of the last output: counts the leaders of the service"),
            epoch: metric(
                to,
                "epoch",
                "Epoch of the last output: counts the outputs of one leader",
            ),
            standing: metric(to, "standing", "1 for where the instance stands towards its role"),
            link: metric(to, "link_up", "1 while a router is linked"),
            reconnects: metric(to, "reconnects", "Times that a lost link came back"),
            data_age: seconds(
                to,
                stage,
                "data_age",
                "Age of the oldest pose behind an output, when that was published",
            ),
            stage: seconds(
                to,
                stage,
                "stage",
                "From when a service had received what it needed until it published",
            ),
            events: metric(to, "events", "Events that the service handled, by kind"),
            handling: seconds(
                to,
                handling,
                "event_handling",
                "Time in which one event was handled, with what it led to",
            ),
            jobs_running: metric(to, "jobs_running", "Computations that run"),
            job: seconds(to, stage, "job", "Time that computations took"),
            jobs_failed: metric(to, "jobs_failed", "Computations that failed or panicked"),
            inbox: metric(to, "inbox_messages", "Messages that wait for the service"),
            inbox_bytes: bytes(to, "inbox", "Bytes of the messages that wait for the service"),
            inbox_superseded: metric(
                to,
                "inbox_superseded",
                "Messages that a newer one of their key replaced before they were handled",
            ),
            inbox_dropped: metric(
                to,
                "inbox_dropped",
                "Messages that were dropped because too many waited",
            ),
            outbox: metric(to, "outbox_messages", "Messages that wait to be sent"),
            outbox_bytes: bytes(to, "outbox", "Bytes of the messages that wait to be sent"),
            outbox_sent: metric(to, "outbox_sent", "Messages that were sent"),
            outbox_dropped: metric(
                to,
                "outbox_dropped",
                "Messages that were dropped because too many waited to be sent",
            ),
            received_bytes: bytes(
                to,
                "received",
                "Bytes of messages that arrived, with their keys",
            ),
            published_bytes: bytes(to, "published", "Bytes of messages that were published"),
            answered: metric(to, "gets_answered", "Gets that were answered"),
            refused: metric(to, "messages_refused", "Messages that were refused"),
            state_lost: metric(
                to,
                "state_lost",
                "1 if the service began without the state that it had stored",
            ),
            state_unwritable: metric(
                to,
                "state_unwritable",
                "1 while the service cannot store its state",
            ),
            results: Results::new(to),
            counted,
            process: process(),
            registry,
        }
    }

    /// All metrics as text.
    ///
    /// # Errors
    /// If a metric cannot be written, which none of ours is.
    pub(super) fn text(&self) -> Result<String, std::fmt::Error> {
        let mut text = String::new();
        encode_registry(&mut text, &self.process)?;
        encode_registry(&mut text, &self.registry)?;
        encode_eof(&mut text)?;
        Ok(text)
    }

    /// The metrics of the fleet alone, as a part of a text.
    ///
    /// # Errors
    /// If a metric cannot be written, which none of ours is.
    pub(super) fn of_fleet(&self) -> Result<String, std::fmt::Error> {
        let mut text = String::new();
        encode_registry(&mut text, &self.registry)?;
        Ok(text)
    }
}

/// What every process has.
fn process() -> Registry {
    let mut process = Registry::with_prefix("process");
    process.register_collector(Box::new(ProcessCollector::new()));
    process
}

fn register_build(to: &mut Registry) {
    let build = Info::new([("version", env!("CARGO_PKG_VERSION"))]);
    to.register("build", "The version of the program", build);
}

/// What a process of many fleets counts by itself, without a fleet as a label, and what every process has.
pub(super) fn of_process() -> (Registry, Registry) {
    (Registry::with_prefix("muster"), process())
}

/// The labels of a service.
pub(super) fn of(service: ServiceName) -> Of {
    [("service", service.as_str())]
}

/// A count as a gauge has it.
pub(super) fn count(number: usize) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

/// A count of something older than the metric: what was counted so far.
pub(super) fn set_counter(counter: &Counter, total: u64) {
    counter.inner().store(total, std::sync::atomic::Ordering::Relaxed);
}

/// A duration as a histogram has it.
pub(super) fn observe(histogram: &Histogram, duration: Duration) {
    histogram.observe(duration.as_secs_f64());
}
