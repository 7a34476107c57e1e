//! The metrics of a process, by the conventions of Prometheus, as OpenMetrics text.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use muster_model::id::{FleetId, ServiceName};
use prometheus_client::encoding::text::{encode_eof, encode_registry};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Registry, Unit};

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

/// All metrics of a process.
#[derive(Debug)]
pub(super) struct Metrics {
    /// What Muster counts, all under `muster_` and with the fleet as a label.
    registry: Registry,
    /// What every process has, under the names that Prometheus gives it.
    process: Registry,
    memory: Gauge,
    threads: Gauge,
    files: Gauge,
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
    pub(super) counted: Family<OfNamed, Counter>,
    pub(super) robots: Family<OfWith, Gauge>,
    pub(super) teams: Family<Of, Gauge>,
    pub(super) teams_requested: Family<Of, Gauge>,
    pub(super) unassigned: Family<Of, Gauge>,
    pub(super) silhouette: Family<OfWith, Number>,
    pub(super) katz_residual: Family<Of, Number>,
    pub(super) residual: Family<Of, Number>,
    pub(super) spectral_radius: Family<Of, Number>,
    pub(super) alpha: Family<Of, Number>,
    pub(super) embeddings: Family<OfWith, Counter>,
    pub(super) embedding_stage: HistogramsWith,
}

impl Metrics {
    /// The metrics of a process of a fleet, all at zero.
    pub(super) fn new(fleet: &FleetId) -> Self {
        let fleet = ("fleet".into(), fleet.as_str().to_owned().into());
        let mut registry = Registry::with_prefix_and_labels("muster", [fleet].into_iter());
        let build = Info::new([("version", env!("CARGO_PKG_VERSION"))]);
        registry.register("build", "The version of the program", build);
        let mut process = Registry::with_prefix("process");
        let started = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let start = Number::default();
        start.set(started.as_secs_f64());
        let (memory, threads, files) = Default::default();
        process.register_with_unit(
            "start_time",
            "When the process started, since 1970",
            Unit::Seconds,
            start,
        );
        process.register_with_unit(
            "resident_memory",
            "Resident memory of the process",
            Unit::Bytes,
            Gauge::clone(&memory),
        );
        process.register("threads", "Threads of the process", Gauge::clone(&threads));
        process.register("open_fds", "Open file descriptors of the process", Gauge::clone(&files));
        let mut metrics = Self {
            registry: Registry::default(),
            process,
            memory,
            threads,
            files,
            up: Family::default(),
            ready: Family::default(),
            term: Family::default(),
            epoch: Family::default(),
            standing: Family::default(),
            link: Family::default(),
            reconnects: Family::default(),
            data_age: Family::new_with_constructor(stage),
            stage: Family::new_with_constructor(stage),
            events: Family::default(),
            handling: Family::new_with_constructor(handling),
            jobs_running: Family::default(),
            job: Family::new_with_constructor(stage),
            jobs_failed: Family::default(),
            inbox: Family::default(),
            inbox_bytes: Family::default(),
            inbox_superseded: Family::default(),
            inbox_dropped: Family::default(),
            outbox: Family::default(),
            outbox_bytes: Family::default(),
            outbox_sent: Family::default(),
            outbox_dropped: Family::default(),
            received_bytes: Family::default(),
            published_bytes: Family::default(),
            answered: Family::default(),
            refused: Family::default(),
            counted: Family::default(),
            robots: Family::default(),
            teams: Family::default(),
            teams_requested: Family::default(),
            unassigned: Family::default(),
            silhouette: Family::default(),
            katz_residual: Family::default(),
            residual: Family::default(),
            spectral_radius: Family::default(),
            alpha: Family::default(),
            embeddings: Family::default(),
            embedding_stage: Family::new_with_constructor(handling),
        };
        metrics.register_shell(&mut registry);
        metrics.register_results(&mut registry);
        metrics.registry = registry;
        metrics
    }

    fn register_shell(&self, to: &mut Registry) {
        let mut gauge = |name: &str, help: &str, metric: &Family<Of, Gauge>| {
            to.register(name, help, metric.clone());
        };
        gauge("loop_turning", "1 while the loop of the service runs, as /healthz has it", &self.up);
        gauge("ready", "1 while the service is ready, as /readyz has it", &self.ready);
        gauge("term", "Term of the last output: counts the leaders of the service", &self.term);
        gauge("epoch", "Epoch of the last output: counts the outputs of one leader", &self.epoch);
        gauge("link_up", "1 while a router is linked", &self.link);
        gauge("jobs_running", "Computations that run", &self.jobs_running);
        gauge("inbox_messages", "Messages that wait for the service", &self.inbox);
        gauge("outbox_messages", "Messages that wait to be sent", &self.outbox);
        to.register(
            "standing",
            "1 for where the instance stands towards its role",
            self.standing.clone(),
        );
        for (name, help, metric) in [
            ("inbox", "Bytes of the messages that wait for the service", &self.inbox_bytes),
            ("outbox", "Bytes of the messages that wait to be sent", &self.outbox_bytes),
        ] {
            to.register_with_unit(name, help, Unit::Bytes, metric.clone());
        }
        for (name, help, metric) in [
            ("received", "Bytes of messages that arrived, with their keys", &self.received_bytes),
            ("published", "Bytes of messages that were published", &self.published_bytes),
        ] {
            to.register_with_unit(name, help, Unit::Bytes, metric.clone());
        }
        for (name, help, metric) in [
            (
                "data_age",
                "Age of the oldest pose behind an output, when that was published",
                &self.data_age,
            ),
            (
                "stage",
                "From when a service had received what it needed until it published",
                &self.stage,
            ),
            (
                "event_handling",
                "Time in which one event was handled, with what it led to",
                &self.handling,
            ),
            ("job", "Time that computations took", &self.job),
        ] {
            to.register_with_unit(name, help, Unit::Seconds, metric.clone());
        }
        for (name, help, metric) in [
            ("reconnects", "Times that a lost link came back", &self.reconnects),
            ("jobs_failed", "Computations that failed or panicked", &self.jobs_failed),
            (
                "inbox_superseded",
                "Messages that a newer one of their key replaced before they were handled",
                &self.inbox_superseded,
            ),
            (
                "inbox_dropped",
                "Messages that were dropped because too many waited",
                &self.inbox_dropped,
            ),
            ("outbox_sent", "Messages that were sent", &self.outbox_sent),
            (
                "outbox_dropped",
                "Messages that were dropped because too many waited to be sent",
                &self.outbox_dropped,
            ),
            ("gets_answered", "Gets that were answered", &self.answered),
            ("messages_refused", "Messages that were refused", &self.refused),
        ] {
            to.register(name, help, metric.clone());
        }
        to.register("events", "Events that the service handled, by kind", self.events.clone());
        to.register(
            "counted",
            "Everything else that the service counts, by name",
            self.counted.clone(),
        );
    }

    fn register_results(&self, to: &mut Registry) {
        to.register("robots", "Robots of the roster, by presence", self.robots.clone());
        to.register(
            "silhouette_mean",
            "Mean silhouette of the division, by the space that it is taken in",
            self.silhouette.clone(),
        );
        to.register(
            "embeddings",
            "Embeddings that were published, by how they were computed",
            self.embeddings.clone(),
        );
        to.register_with_unit(
            "embedding_stage",
            "Time that each stage of an embedding took",
            Unit::Seconds,
            self.embedding_stage.clone(),
        );
        for (name, help, metric) in [
            ("teams", "Teams of the division", &self.teams),
            ("teams_requested", "Teams that were asked for", &self.teams_requested),
            ("robots_unassigned", "Robots that no relation ties to a team", &self.unassigned),
        ] {
            to.register(name, help, metric.clone());
        }
        for (name, help, metric) in [
            ("katz_residual", "Relative residual of the Katz similarity", &self.katz_residual),
            (
                "embedding_residual",
                "Largest relative residual of the singular triplets",
                &self.residual,
            ),
            (
                "spectral_radius",
                "Upper bound of the spectral radius (rho) of the fused graph",
                &self.spectral_radius,
            ),
            ("katz_alpha", "Decay (alpha) of the Katz similarity", &self.alpha),
        ] {
            to.register(name, help, metric.clone());
        }
    }

    /// All metrics as text.
    ///
    /// # Errors
    /// If a metric cannot be written, which none of ours is.
    pub(super) fn text(&self) -> Result<String, std::fmt::Error> {
        self.look_at_process();
        let mut text = String::new();
        encode_registry(&mut text, &self.process)?;
        encode_registry(&mut text, &self.registry)?;
        encode_eof(&mut text)?;
        Ok(text)
    }

    /// Where the system reports nothing of a process, the last values stay.
    fn look_at_process(&self) {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let number = |name: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(name))?;
            line.split_whitespace().next()?.parse::<i64>().ok()
        };
        if let Some(kibibytes) = number("VmRSS:") {
            self.memory.set(kibibytes.saturating_mul(1024));
        }
        if let Some(threads) = number("Threads:") {
            self.threads.set(threads);
        }
        if let Ok(files) = std::fs::read_dir("/proc/self/fd") {
            self.files.set(i64::try_from(files.count()).unwrap_or(i64::MAX));
        }
    }
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
