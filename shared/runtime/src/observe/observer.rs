//! What the shell of one service reports of its messages, and what is known of it at any moment.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use muster_model::alert::AlertKind;
use muster_model::embedding::EmbeddingGraph;
use muster_model::event::{Event as FleetEvent, Severity};
use muster_model::id::{Modality, ServiceName};
use muster_model::role::ReplicaState;
use muster_model::roster::{Presence, Roster};
use muster_model::status::{ServiceStatus, StatusGauge};
use muster_model::time::Tick;
use muster_service::JobsFailing;
use muster_service::inbox::InboxCounts;
use muster_wire::Message;
use muster_wire::message::plain_reason;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;

use super::counted::Counted;
use super::health::{self, Look};
use super::metrics::{Metrics, OfWith, Results, count, observe, of, set_counter};
use crate::bus::send_queue::SendCounts;
use crate::send_queue::Backlog;

/// Counters of a status that are metrics of their own from the start, at zero, since alerts watch how they grow.
const MESSAGES_REFUSED: &str = "messages_refused";
const JOBS_FAILED: &str = "jobs_failed";

/// What waits for a service and what it wants sent, and what has become of what waited.
#[derive(Debug, Clone, Copy, Default)]
pub struct Queues {
    /// The way in.
    pub inbox: InboxCounts,
    /// What waits to be sent.
    pub send_queue: Backlog,
    /// What was sent.
    pub sending: SendCounts,
}

/// What the shell of one service reports of its messages. Nothing here waits, and nothing is kept that
/// grows.
#[derive(Debug, Clone)]
pub struct Observer(Arc<Watched>);

/// What the port and the observers share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) metrics: Metrics,
    pub(super) watched: Vec<Arc<Watched>>,
    /// When the loop of the router of this process last turned; none where no router runs.
    router_turned: Mutex<Option<Instant>>,
}

impl Shared {
    pub(super) fn new(metrics: Metrics, watched: Vec<Arc<Watched>>) -> Self {
        Self { metrics, watched, router_turned: Mutex::default() }
    }

    /// The loop of the router runs.
    pub(super) fn router_turned(&self) {
        let mut turned = self.router_turned.lock().unwrap_or_else(PoisonError::into_inner);
        *turned = Some(Instant::now());
    }

    /// Since when the loop of the router has not turned; none where no router runs.
    pub(super) fn since_router_turned(&self) -> Option<Duration> {
        let turned = *self.router_turned.lock().unwrap_or_else(PoisonError::into_inner);
        turned.map(|turned| turned.elapsed())
    }
}

/// One service under observation.
#[derive(Debug)]
pub(super) struct Watched {
    pub(super) service: ServiceName,
    state: Mutex<State>,
    metrics: Own,
}

/// What readiness rests on.
#[derive(Debug, Default)]
struct State {
    turned: Option<Instant>,
    link: Option<bool>,
    linked: Option<Instant>,
    standing: ReplicaState,
    roster: Option<Instant>,
    embedding: Option<Instant>,
    teams: Option<Instant>,
    peopled: Option<Instant>,
    /// The modalities of the last embedding that was published.
    modalities: Vec<Modality>,
    /// How long all jobs have failed, and why the last one did.
    failing: Option<(Duration, String)>,
}

/// The metrics of one service. They are handles: an update takes no lock that others hold for long.
#[derive(Debug)]
struct Own {
    labels: (&'static str, &'static str),
    up: Gauge,
    ready: Gauge,
    term: Gauge,
    epoch: Gauge,
    standing: Family<OfWith, Gauge>,
    link: Gauge,
    reconnects: Counter,
    data_age: Histogram,
    stage: Histogram,
    events: Family<OfWith, Counter>,
    handling: Histogram,
    jobs_running: Gauge,
    job: Histogram,
    jobs_failed: Counter,
    inbox: (Gauge, Gauge),
    superseded: Counter,
    inbox_dropped: Counter,
    outbox: (Gauge, Gauge),
    sent: Counter,
    outbox_dropped: Counter,
    received_bytes: Counter,
    published_bytes: Counter,
    answered: Counter,
    refused: Counter,
    state: (Gauge, Gauge),
    counted: Counted,
    results: Results,
}

impl Own {
    fn new(service: ServiceName, all: &Metrics) -> Self {
        let of = of(service);
        Self {
            labels: of[0],
            up: all.up.get_or_create_owned(&of),
            ready: all.ready.get_or_create_owned(&of),
            term: all.term.get_or_create_owned(&of),
            epoch: all.epoch.get_or_create_owned(&of),
            standing: all.standing.clone(),
            link: all.link.get_or_create_owned(&of),
            reconnects: all.reconnects.get_or_create_owned(&of),
            data_age: all.data_age.get_or_create_owned(&of),
            stage: all.stage.get_or_create_owned(&of),
            events: all.events.clone(),
            handling: all.handling.get_or_create_owned(&of),
            jobs_running: all.jobs_running.get_or_create_owned(&of),
            job: all.job.get_or_create_owned(&of),
            jobs_failed: all.jobs_failed.get_or_create_owned(&of),
            inbox: (all.inbox.get_or_create_owned(&of), all.inbox_bytes.get_or_create_owned(&of)),
            superseded: all.inbox_superseded.get_or_create_owned(&of),
            inbox_dropped: all.inbox_dropped.get_or_create_owned(&of),
            outbox: (
                all.outbox.get_or_create_owned(&of),
                all.outbox_bytes.get_or_create_owned(&of),
            ),
            sent: all.outbox_sent.get_or_create_owned(&of),
            outbox_dropped: all.outbox_dropped.get_or_create_owned(&of),
            received_bytes: all.received_bytes.get_or_create_owned(&of),
            published_bytes: all.published_bytes.get_or_create_owned(&of),
            answered: all.answered.get_or_create_owned(&of),
            refused: all.refused.get_or_create_owned(&of),
            state: (
                all.state_lost.get_or_create_owned(&of),
                all.state_unwritable.get_or_create_owned(&of),
            ),
            counted: all.counted.clone(),
            results: all.results.clone(),
        }
    }
}

impl Watched {
    pub(super) fn new(service: ServiceName, metrics: &Metrics) -> Self {
        let watched =
            Self { service, state: Mutex::default(), metrics: Own::new(service, metrics) };
        watched.show_standing(ReplicaState::Starting);
        watched
    }

    /// No critical section can panic half-way, so that a poisoned lock still guards a whole state.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What is known now.
    pub(super) fn look(&self) -> Look {
        let now = Instant::now();
        let state = self.state();
        let since = |at: Option<Instant>| at.map(|at| now.saturating_duration_since(at));
        Look {
            since_turn: since(state.turned),
            link: state.link,
            standing: state.standing,
            linked_for: since(state.linked).unwrap_or_default(),
            since_roster: since(state.roster),
            since_embedding: since(state.embedding),
            since_teams: since(state.teams),
            peopled_for: since(state.peopled),
            jobs_failing: state.failing.clone(),
        }
    }

    /// Brings those metrics up to now that change by themselves.
    pub(super) fn refresh(&self) {
        let look = self.look();
        self.metrics.up.set(i64::from(health::is_alive(&look)));
        self.metrics.ready.set(i64::from(health::reasons(self.service, &look).is_empty()));
    }

    fn show_standing(&self, standing: ReplicaState) {
        for (other, name) in [
            (ReplicaState::Starting, "starting"),
            (ReplicaState::Standby, "standby"),
            (ReplicaState::Suspect, "doubtful"),
            (ReplicaState::Leading, "holding"),
        ] {
            let labels = [self.metrics.labels, ("standing", name)];
            self.metrics.standing.get_or_create(&labels).set(i64::from(other == standing));
        }
    }
}

impl Observer {
    pub(super) fn new(watched: Arc<Watched>) -> Self {
        Self(watched)
    }

    /// The loop runs, and the service has this status. `failing` says since when all its jobs have failed.
    pub fn turned(&self, status: &ServiceStatus, queues: &Queues, failing: Option<&JobsFailing>) {
        let (own, mut state) = (&self.0.metrics, self.0.state());
        state.turned = Some(Instant::now());
        state.failing =
            failing.map(|failing| (status.now.since(failing.since), failing.reason.clone()));
        let before = std::mem::replace(&mut state.standing, status.standing);
        drop(state);
        if before != status.standing {
            self.0.show_standing(status.standing);
        }
        own.term.set(i64::try_from(status.revision.term).unwrap_or(i64::MAX));
        own.epoch.set(i64::try_from(status.revision.epoch).unwrap_or(i64::MAX));
        let total = |name: &str| status.counters.get(name).copied().unwrap_or_default();
        set_counter(&own.refused, total(MESSAGES_REFUSED));
        set_counter(&own.jobs_failed, total(JOBS_FAILED));
        let has_no_metric = |name: &str| ![MESSAGES_REFUSED, JOBS_FAILED].contains(&name);
        let others = status.counted().filter(|(name, _)| has_no_metric(name));
        own.counted.set(self.0.service, others);
        self.gauges(status);
        own.inbox.0.set(count(queues.inbox.waiting_items));
        own.inbox.1.set(count(queues.inbox.waiting_bytes));
        own.outbox.0.set(count(queues.send_queue.messages));
        own.outbox.1.set(count(queues.send_queue.bytes));
        set_counter(&own.superseded, queues.inbox.superseded);
        set_counter(&own.inbox_dropped, queues.inbox.dropped);
        set_counter(&own.sent, queues.sending.sent);
        set_counter(&own.outbox_dropped, queues.sending.dropped);
    }

    /// What the status says of how things are.
    fn gauges(&self, status: &ServiceStatus) {
        let own = &self.0.metrics;
        let gauge = |gauge| i64::try_from(status.gauge(gauge)).unwrap_or(i64::MAX);
        own.state.0.set(gauge(StatusGauge::StateLost));
        own.state.1.set(gauge(StatusGauge::StateUnwritable));
        if self.0.service != ServiceName::Historian {
            return;
        }
        let (results, of) = (&own.results, [own.labels]);
        results.history_degraded.get_or_create(&of).set(gauge(StatusGauge::HistoryDegraded));
        results.history_bytes.get_or_create(&of).set(gauge(StatusGauge::HistoryBytes));
        // A history without any record reaches up to no moment.
        let through = Tick(status.gauge(StatusGauge::RecordedThrough));
        if through != Tick(0) {
            let seconds = through.since(Tick(0)).as_secs_f64();
            results.history_through.get_or_create(&of).set(seconds);
        }
    }

    /// The loop has ended, as it should.
    pub fn ended(&self) {
        self.0.state().turned = None;
    }

    /// The link to the router is up or lost.
    pub fn link(&self, up: bool) {
        let mut state = self.0.state();
        if up && state.link == Some(false) {
            self.0.metrics.reconnects.inc();
        }
        if up && state.link != Some(true) {
            state.linked = Some(Instant::now());
        }
        state.link = Some(up);
        self.0.metrics.link.set(i64::from(up));
    }

    /// One event of a kind was handled, with everything that it led to.
    pub fn handled(&self, kind: &'static str, took: Duration) {
        let own = &self.0.metrics;
        own.events.get_or_create(&[own.labels, ("kind", kind)]).inc();
        observe(&own.handling, took);
    }

    /// Bytes arrived. May be called on any thread.
    pub fn arrived(&self, bytes: usize) {
        self.0.metrics.received_bytes.inc_by(bytes as u64);
    }

    /// A message is handed to the core.
    pub fn received(&self, message: &Message) {
        let now = Instant::now();
        let mut state = self.0.state();
        match message {
            Message::Roster(roster) => {
                state.roster = Some(now);
                if roster.robots.is_empty() {
                    state.peopled = None;
                } else {
                    state.peopled.get_or_insert(now);
                }
            }
            Message::Embedding(_) => state.embedding = Some(now),
            Message::Teams { .. } => state.teams = Some(now),
            _ => {}
        }
    }

    /// A message was published, in so many bytes.
    pub fn published(&self, message: &Message, bytes: usize, now: Tick) {
        let own = &self.0.metrics;
        own.published_bytes.inc_by(bytes as u64);
        let results = &own.results;
        let of = [own.labels];
        match message {
            Message::Roster(roster) => self.roster(roster),
            Message::Embedding(embedding) => {
                let quality = &embedding.quality;
                results.katz_residual.get_or_create(&of).set(quality.katz_residual);
                results.residual.get_or_create(&of).set(quality.residual);
                results.spectral_radius.get_or_create(&of).set(quality.spectral_radius.1);
                results.alpha.get_or_create(&of).set(quality.alpha);
                self.trust(&embedding.graphs);
                let mode = match quality.mode {
                    muster_model::embedding::EmbeddingMode::Dense => "dense",
                    muster_model::embedding::EmbeddingMode::Updated => "updated",
                    muster_model::embedding::EmbeddingMode::Cached => "cached",
                    muster_model::embedding::EmbeddingMode::InverseFree => "inverse-free",
                };
                results.embeddings.get_or_create(&[own.labels, ("mode", mode)]).inc();
                let stages = ["fusion", "similarity", "decomposition"];
                for (stage, took) in stages.iter().zip(quality.stage_us).filter(|pair| pair.1 > 0) {
                    let labels = [own.labels, ("stage", *stage)];
                    let histogram = results.embedding_stage.get_or_create(&labels);
                    observe(&histogram, Duration::from_micros(took));
                }
            }
            Message::Teams { teams, .. } => {
                results.teams.get_or_create(&of).set(count(teams.teams.len()));
                results.teams_requested.get_or_create(&of).set(i64::from(teams.requested));
                results.unassigned.get_or_create(&of).set(count(teams.unassigned.len()));
            }
            Message::Audit(audit) => {
                let rate = audit.flapping.returns_per_robot_minute;
                results.returns.get_or_create(&of).set(rate);
                for (space, report) in
                    [("embedding", &audit.in_embedding), ("physical", &audit.in_physical)]
                {
                    let labels = [own.labels, ("space", space)];
                    match report.mean {
                        Some(mean) => {
                            results.silhouette.get_or_create(&labels).set(mean);
                        }
                        // A mean that is not defined is not zero.
                        None => {
                            results.silhouette.remove(&labels);
                        }
                    }
                }
            }
            Message::Alerts(alerts) => {
                for kind in AlertKind::ALL {
                    let open = alerts.open.iter().filter(|alert| alert.kind == kind).count();
                    let labels = [own.labels, ("kind", kind.as_str())];
                    results.alerts.get_or_create(&labels).set(count(open));
                }
                return;
            }
            Message::Event(event) => return log_event(event),
            _ => return,
        }
        let Some(header) = message.header() else { return };
        if let Some(age) = header.data_age_s(now) {
            own.data_age.observe(age);
        }
        if let Some(stage) = header.stages.iter().rfind(|stage| stage.stage == self.0.service) {
            observe(&own.stage, stage.published.since(stage.received));
        }
    }

    fn trust(&self, graphs: &[EmbeddingGraph]) {
        let own = &self.0.metrics;
        let labels = |modality: &Modality| {
            [(own.labels.0, own.labels.1.to_owned()), ("modality", modality.to_string())]
        };
        let now: Vec<Modality> = graphs.iter().map(|graph| graph.modality.clone()).collect();
        let before = std::mem::replace(&mut self.0.state().modalities, now.clone());
        for graph in graphs {
            own.results.trust.get_or_create(&labels(&graph.modality)).set(graph.trust);
        }
        // A modality that is no longer declared has no trust. The others stay: a scrape may come at any moment.
        for gone in before.iter().filter(|modality| !now.contains(modality)) {
            own.results.trust.remove(&labels(gone));
        }
    }

    fn roster(&self, roster: &Roster) {
        let own = &self.0.metrics;
        let mut counts = BTreeMap::from([("active", 0), ("stale", 0)]);
        for entry in &roster.robots {
            let name = match entry.presence {
                Presence::Active => "active",
                Presence::Stale => "stale",
            };
            *counts.entry(name).or_default() += 1;
        }
        for (presence, number) in counts {
            let labels = [own.labels, ("presence", presence)];
            own.results.robots.get_or_create(&labels).set(number);
        }
    }

    /// A get was answered.
    pub fn answered(&self) {
        self.0.metrics.answered.inc();
    }

    /// A computation starts.
    pub fn job_started(&self) {
        self.0.metrics.jobs_running.inc();
    }

    /// A computation has ended. May be called on any thread.
    pub fn job_ended(&self, took: Duration) {
        self.0.metrics.jobs_running.dec();
        observe(&self.0.metrics.job, took);
    }
}

/// Events for consoles go to the log as well, by their severity for the operator of the process:
/// what robots do wrong is not wrong with the process.
fn log_event(event: &FleetEvent) {
    let text = || plain_reason(&serde_json::to_string(&event.kind).unwrap_or_default());
    match event.severity {
        Severity::Error => tracing::error!("event {}", text()),
        Severity::Warning => tracing::info!("event {}", text()),
        Severity::Info => tracing::debug!("event {}", text()),
    }
}
