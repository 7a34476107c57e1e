//! `muster up --fleets`: the services of many fleets in one process, on one bus and on shared threads.
//!
//! Named fleets are served from the start, those of a pattern from when their robots appear until none has been there
//! for long. A fleet whose services fail is started again; the others do not notice.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_historian::Historian;
use muster_ingest::Ingest;
use muster_model::id::{FleetId, ServiceName};
use muster_planner::Planner;
use muster_runtime::bus::{ConnectTimeout, SharedBus};
use muster_runtime::config::ProcessConfig;
use muster_runtime::exit::ExitError;
use muster_runtime::notify;
use muster_runtime::observe::{FleetsObservatory, Observer};
use muster_runtime::pool::Pool;
use muster_runtime::service::{Shared, run_shared};
use muster_runtime::stop::{self, Stop, Stopper};
use muster_wire::FleetPattern;
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior};

/// What is run for each fleet where no service is named. A history costs each fleet a thread and a file, and the planner
/// is asked by people: who wants them names them.
const DEFAULT_SERVICES: [ServiceName; 4] =
    [ServiceName::Ingest, ServiceName::Embedder, ServiceName::Clusterer, ServiceName::Auditor];

/// Most fleets where no number is given: as many as were measured, with twenty robots each.
pub(crate) const DEFAULT_MAX_FLEETS: usize = 300;

/// Most fleets that may be asked for: each holds about a mebibyte.
pub(crate) const MOST_FLEETS: usize = 5000;

/// For how many seconds a fleet of a pattern is served without robots where no time is given: longer than a lunch break,
/// shorter than a night.
pub(crate) const DEFAULT_IDLE_AFTER_S: u64 = 3600;

/// For how long it may be asked for: at least as long as a robot takes to start again, at most a week, after which no one waits
/// for it any more.
pub(crate) const IDLE_AFTER_S: std::ops::RangeInclusive<u64> = 2..=604_800;

/// How often is looked which fleets are idle, and which are to be started again.
const LOOK_INTERVAL: Duration = Duration::from_secs(1);

/// How long after its end a fleet is started again the first time. Each further pause is twice as long.
const FIRST_PAUSE: Duration = Duration::from_secs(1);

/// The longest pause, and how long a fleet must have run to begin with the first pause again.
const LONGEST_PAUSE: Duration = Duration::from_secs(60);

/// How long a fleet counts as refused that is not reported any more: it has no robots, or is served elsewhere. Those that have
/// some are reported every ten seconds.
const REFUSED_FOR: Duration = Duration::from_secs(60);

/// Most fleets that are counted as refused.
const MAX_REFUSED: usize = 10_000;

/// When a process that waits for its router counts as started.
const READY_AFTER: Duration = Duration::from_secs(1);

/// How many fleets are served, and for how long.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// How many at most.
    pub(crate) max_fleets: usize,
    /// How long one of a pattern is served without robots.
    pub(crate) idle_after: Duration,
}

/// One fleet that is served.
struct Served {
    /// Ends its services; none between their end and their next start.
    stopper: Option<Stopper>,
    /// Whether it is let go of without robots.
    may_idle: bool,
    /// Whether it is let go of once its services have ended.
    leaves: bool,
    start: Instant,
    /// How long it is waited after its next end.
    pause: Duration,
}

/// All fleets of this process.
struct Fleets {
    patterns: Vec<FleetPattern>,
    limits: Limits,
    services: Vec<ServiceName>,
    config: ProcessConfig,
    shared: Shared,
    observatory: FleetsObservatory,
    served: BTreeMap<FleetId, Served>,
    /// When each was last reported.
    refused: BTreeMap<FleetId, Instant>,
    tasks: JoinSet<(FleetId, anyhow::Result<()>)>,
}

/// Checks what is asked for.
///
/// # Errors
/// If more fleets are named than are served.
pub(crate) fn check(patterns: &[FleetPattern], limits: Limits) -> anyhow::Result<()> {
    let Limits { max_fleets, .. } = limits;
    let named = patterns.iter().filter(|pattern| pattern.single().is_some()).count();
    if named > max_fleets {
        let problem = format!("--fleets: {named} are named and --max-fleets is {max_fleets}");
        return Err(ExitError::usage(problem).into());
    }
    Ok(())
}

/// Serves fleets until it is time to stop.
///
/// # Errors
/// If the bus does not open.
pub(crate) async fn run(
    patterns: &[FleetPattern],
    limits: Limits,
    services: &[ServiceName],
    config: ProcessConfig,
    observatory: FleetsObservatory,
    mut stop: Stop,
) -> anyhow::Result<()> {
    let services = if services.is_empty() { DEFAULT_SERVICES.to_vec() } else { services.to_vec() };
    let mut watched = notify::watch();
    let opening = open(&config, patterns);
    let (bus, mut appearing) = tokio::select! {
        opened = watched.during(opening) => opened?,
        () = stop.stopped() => return Ok(()),
    };
    observatory.linked();
    let shared = Shared { bus: bus.clone(), pool: Pool::start()? };
    let mut fleets = Fleets {
        patterns: patterns.to_vec(),
        limits,
        services,
        config,
        shared,
        observatory,
        served: BTreeMap::new(),
        refused: BTreeMap::new(),
        tasks: JoinSet::new(),
    };
    for fleet in patterns.iter().filter_map(FleetPattern::single) {
        fleets.start(&fleet);
    }
    let names: Vec<String> = patterns.iter().map(ToString::to_string).collect();
    notify::ready(&format!("serves fleets {}", names.join(",")));
    let mut look = tokio::time::interval(LOOK_INTERVAL);
    look.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            () = stop.stopped() => break,
            () = watched.due() => watched.report(),
            Some(fleet) = appearing.recv() => fleets.appeared(&fleet),
            Some(ended) = fleets.tasks.join_next() => fleets.ended(ended),
            _ = look.tick() => fleets.look(),
        }
    }
    fleets.stop().await;
    bus.close().await;
    Ok(())
}

/// Opens the bus, and notes for the service manager if it waits for a router.
async fn open(
    config: &ProcessConfig,
    patterns: &[FleetPattern],
) -> anyhow::Result<(SharedBus, tokio::sync::mpsc::Receiver<FleetId>)> {
    let mut opening = std::pin::pin!(SharedBus::open(config, ConnectTimeout::Never, patterns));
    if let Ok(opened) = tokio::time::timeout(READY_AFTER, &mut opening).await {
        return Ok(opened?);
    }
    notify::ready("waiting for a router");
    Ok(opening.await?)
}

impl Fleets {
    /// A fleet has robots, and this process does not serve it.
    fn appeared(&mut self, fleet: &FleetId) {
        let is_meant = self.patterns.iter().any(|pattern| pattern.matches(fleet.as_str()));
        if !is_meant || self.served.contains_key(fleet) {
            return;
        }
        if self.served.len() < self.limits.max_fleets {
            self.refused.remove(fleet);
            self.observatory.refused(self.refused.len());
            return self.start(fleet);
        }
        let is_new = !self.refused.contains_key(fleet);
        if is_new && self.refused.len() >= MAX_REFUSED {
            return;
        }
        self.refused.insert(fleet.clone(), Instant::now());
        if is_new {
            tracing::warn!(
                "fleet {fleet} is not served: {} are, and not more may be; see --max-fleets",
                self.limits.max_fleets
            );
        }
        self.observatory.refused(self.refused.len());
    }

    /// Starts the services of a fleet.
    fn start(&mut self, fleet: &FleetId) {
        let observers = self.observatory.watch(fleet, &self.services);
        let is_named = self.patterns.iter().any(|pattern| pattern.single().as_ref() == Some(fleet));
        let served = self.served.entry(fleet.clone()).or_insert_with(|| Served {
            stopper: None,
            may_idle: !is_named,
            leaves: false,
            start: Instant::now(),
            pause: FIRST_PAUSE,
        });
        let (stopper, stop) = stop::channel();
        (served.stopper, served.start) = (Some(stopper.clone()), Instant::now());
        let config = self.config.of_fleet(fleet.clone());
        let (services, shared, fleet) = (self.services.clone(), self.shared.clone(), fleet.clone());
        self.tasks.spawn(async move {
            let running = run_fleet(services, &config, &stopper, &stop, observers, &shared);
            (fleet, running.await)
        });
    }

    /// The services of a fleet have ended.
    fn ended(&mut self, ended: Result<(FleetId, anyhow::Result<()>), tokio::task::JoinError>) {
        let (fleet, result) = match ended {
            Ok(ended) => ended,
            // Nothing in it panics; if it does, no one knows whose task it was.
            Err(error) => return tracing::error!("a fleet has ended: {error}"),
        };
        self.shared.bus.forget(&fleet);
        let Some(served) = self.served.get_mut(&fleet) else { return };
        served.stopper = None;
        if served.leaves {
            tracing::info!("fleet {fleet} has had no robots for long and is not served any more");
            self.served.remove(&fleet);
            self.observatory.forget(&fleet);
            return;
        }
        let problem = match result {
            Ok(()) => "its services have ended".to_owned(),
            Err(error) => format!("{error:#}"),
        };
        if served.start.elapsed() >= LONGEST_PAUSE {
            served.pause = FIRST_PAUSE;
        }
        let pause = served.pause;
        tracing::error!("fleet {fleet}: {problem}; it is started again in {} s", pause.as_secs());
        served.start = Instant::now() + pause;
        served.pause = (2 * pause).min(LONGEST_PAUSE);
        self.observatory.failed(&fleet, problem);
    }

    /// Starts fleets again that have failed, lets go of those without robots, and shows what each has lost.
    fn look(&mut self) {
        let now = Instant::now();
        let due = |served: &Served| served.stopper.is_none() && now >= served.start;
        let again: Vec<FleetId> = self
            .served
            .iter()
            .filter(|(_, served)| due(served))
            .map(|(fleet, _)| fleet.clone())
            .collect();
        for fleet in again {
            self.start(&fleet);
        }
        self.refused.retain(|_, reported| reported.elapsed() < REFUSED_FOR);
        self.observatory.refused(self.refused.len());
        for (fleet, served) in &mut self.served {
            self.observatory.dropped(fleet, self.shared.bus.dropped(fleet));
            if served.may_idle
                && !served.leaves
                && self.shared.bus.without_robots_for(fleet) >= self.limits.idle_after
                && let Some(stopper) = &served.stopper
            {
                served.leaves = true;
                stopper.stop();
            }
        }
    }

    /// Ends the services of all fleets.
    async fn stop(mut self) {
        notify::stopping().await;
        for stopper in self.served.values().filter_map(|served| served.stopper.as_ref()) {
            stopper.stop();
        }
        while let Some(ended) = self.tasks.join_next().await {
            if let Ok((fleet, Err(error))) = ended {
                tracing::error!("fleet {fleet}: {error:#}");
            }
        }
        self.shared.pool.end();
    }
}

/// Runs the services of a fleet until all have ended. When one ends by itself, so do the others.
async fn run_fleet(
    services: Vec<ServiceName>,
    config: &ProcessConfig,
    stopper: &Stopper,
    stop: &Stop,
    observers: Vec<Observer>,
    shared: &Shared,
) -> anyhow::Result<()> {
    let mut tasks = JoinSet::new();
    for (service, observer) in services.into_iter().zip(observers) {
        let (config, stop, shared) = (config.clone(), stop.clone(), shared.clone());
        let open = muster_historian::open;
        match service {
            ServiceName::Ingest => {
                tasks.spawn(run_shared::<Ingest>(config, stop, observer, shared, None))
            }
            ServiceName::Embedder => {
                tasks.spawn(run_shared::<Embedder>(config, stop, observer, shared, None))
            }
            ServiceName::Clusterer => {
                tasks.spawn(run_shared::<Clusterer>(config, stop, observer, shared, None))
            }
            ServiceName::Auditor => {
                tasks.spawn(run_shared::<Auditor>(config, stop, observer, shared, None))
            }
            ServiceName::Historian => {
                tasks.spawn(run_shared::<Historian>(config, stop, observer, shared, Some(open)))
            }
            ServiceName::Planner => {
                tasks.spawn(run_shared::<Planner>(config, stop, observer, shared, None))
            }
        };
    }
    let mut result = Ok(());
    while let Some(ended) = tasks.join_next().await {
        let ended = ended.map_err(|error| anyhow::anyhow!("a service failed: {error}"));
        if let (Err(error), true) = (ended.and_then(|ended| ended), result.is_ok()) {
            result = Err(error);
        }
        stopper.stop();
    }
    result
}

#[cfg(test)]
mod tests {
    use muster_runtime::bus::Bus;
    use muster_runtime::config::{Mode, ProcessArgs};

    use super::*;

    /// A configuration that keeps nothing.
    fn config(args: ProcessArgs) -> ProcessConfig {
        let mode = args.mode.unwrap_or(Mode::Client);
        let state_directory = Some("none".into());
        let args = ProcessArgs { state_directory, ..args };
        ProcessConfig::resolve(&args, mode, &|_| None).unwrap()
    }

    fn limits(max_fleets: usize) -> Limits {
        Limits { max_fleets, idle_after: Duration::from_secs(DEFAULT_IDLE_AFTER_S) }
    }

    /// A router, and fleets on it.
    async fn fleets(patterns: &[&str], max_fleets: usize) -> (Bus, Fleets) {
        let listen = Some(vec!["tcp/127.0.0.1:0".to_owned()]);
        let router = ProcessArgs { mode: Some(Mode::Router), listen, ..ProcessArgs::default() };
        let router = Bus::open(&config(router), ConnectTimeout::Never).await.unwrap();
        let connect = Some(router.locators().await);
        let config = config(ProcessArgs { connect, ..ProcessArgs::default() });
        let patterns: Vec<FleetPattern> =
            patterns.iter().map(|text| text.parse().unwrap()).collect();
        let (bus, _) = open(&config, &patterns).await.unwrap();
        let observatory = FleetsObservatory::open(&config).unwrap();
        let fleets = Fleets {
            patterns,
            limits: limits(max_fleets),
            services: DEFAULT_SERVICES.to_vec(),
            config,
            shared: Shared { bus, pool: Pool::start().unwrap() },
            observatory,
            served: BTreeMap::new(),
            refused: BTreeMap::new(),
            tasks: JoinSet::new(),
        };
        (router, fleets)
    }

    fn running(fleets: &Fleets) -> Vec<(&str, bool)> {
        let served = fleets.served.iter();
        served.map(|(fleet, served)| (fleet.as_str(), served.stopper.is_some())).collect()
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_fleet_that_fails_is_started_again_and_the_others_go_on() {
        let (_router, mut fleets) = fleets(&["site-*"], 2).await;
        let named = ["site-1", "other", "site-2", "site-3"].map(|name| FleetId::new(name).unwrap());
        for fleet in &named {
            fleets.appeared(fleet);
        }
        assert_eq!(running(&fleets), [("site-1", true), ("site-2", true)]);
        assert_eq!(fleets.refused.keys().map(FleetId::as_str).collect::<Vec<_>>(), ["site-3"]);
        fleets.ended(Ok((named[0].clone(), Err(anyhow::anyhow!("a service failed")))));
        fleets.look();
        assert_eq!(running(&fleets), [("site-1", false), ("site-2", true)], "it waits a second");
        tokio::time::sleep(FIRST_PAUSE).await;
        fleets.look();
        assert_eq!(running(&fleets), [("site-1", true), ("site-2", true)]);
        assert_eq!(fleets.served[&named[0]].pause, 2 * FIRST_PAUSE);
        // One that is let go of leaves room for another.
        fleets.served.get_mut(&named[2]).unwrap().leaves = true;
        fleets.ended(Ok((named[2].clone(), Ok(()))));
        fleets.appeared(&named[3]);
        assert_eq!(running(&fleets), [("site-1", true), ("site-3", true)]);
        // The services that were only said to have ended still run.
        fleets.tasks.abort_all();
    }

    #[test]
    fn more_named_fleets_than_are_served_are_refused() {
        let patterns: Vec<FleetPattern> =
            ["a", "b", "site-*"].map(|text| text.parse().unwrap()).to_vec();
        assert!(check(&patterns, limits(2)).is_ok());
        let error = check(&patterns, limits(1)).unwrap_err().to_string();
        assert!(error.contains("--max-fleets is 1"), "{error}");
    }
}
