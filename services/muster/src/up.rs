//! `muster up`: services in one process, each with a session of its own; those of many fleets share one ([`fleets`]).

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::PathBuf;
use std::time::Duration;

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_console::shell::LocalPage;
use muster_embedder::Embedder;
use muster_historian::Historian;
use muster_ingest::Ingest;
use muster_model::id::ServiceName;
use muster_planner::Planner;
use muster_runtime::bus::{Bus, BusConfig, ConnectTimeout};
use muster_runtime::config::{DEFAULT_ENDPOINT, Origin, ProcessConfig};
use muster_runtime::exit::{Exit, ExitError};
use muster_runtime::observe::{FleetsObservatory, Observatory};
use muster_runtime::recording::RecordTo;
use muster_runtime::service;
use muster_runtime::stop::Stop;
use muster_wire::FleetPattern;
use tokio::task::JoinSet;

use crate::companions::{Companion, Companions};
use crate::fleets::{self, Limits};
use crate::operator::OperatorArgs;

/// Arguments of `muster up`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  muster up --router                  all services and a router: enough for one host\n  \
muster up embedder clusterer        two of them; the others run on other hosts\n  \
muster up --router --with foxglove  and the live fleet for Foxglove, at ws://127.0.0.1:8765\n  \
muster up --router --with ros2      and robots that run ROS 2\n  \
muster up --router --set clusterer.teams=3"
)]
pub(crate) struct UpArgs {
    /// Services to run: ingest, embedder, clusterer, auditor, historian, planner; all if none is named
    #[arg(value_name = "SERVICE")]
    services: Vec<ServiceName>,
    /// Run a router in this process as well, at --listen
    #[arg(long)]
    router: bool,
    /// Change a setting, such as clusterer.teams=3
    #[arg(long, value_name = "SERVICE.FIELD=VALUE")]
    set: Vec<String>,
    /// Record everything that happens to each service, to FILE.SERVICE, for `muster replay-core`; in a
    /// folder every run gets a file of its own
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Serve the page for operators at this address of this host, also where services are named
    /// [default: 127.0.0.1:7480 if all services run]
    #[arg(long, value_name = "ADDRESS:PORT", conflicts_with = "no_console")]
    console: Option<String>,
    /// Do not serve the page for operators
    #[arg(long)]
    no_console: bool,
    /// Run these programs beside the services, several with commas; they are built on their own
    #[arg(long, value_name = "PROGRAM", value_delimiter = ',')]
    with: Vec<Companion>,
    /// Serve these fleets, several with commas, in place of --fleet: names, or patterns with *, whose fleets are served once
    /// they have robots. Runs ingest, embedder, clusterer and auditor if no service is named
    #[arg(long, value_name = "NAME", value_delimiter = ',', conflicts_with_all = ["record", "console", "with"])]
    fleets: Vec<FleetPattern>,
    /// Serve so many fleets at most
    #[arg(long, value_name = "COUNT", default_value_t = fleets::DEFAULT_MAX_FLEETS, requires = "fleets",
          value_parser = at_most_fleets)]
    max_fleets: usize,
    /// Let go of a fleet of a pattern after so many seconds without robots
    #[arg(long, value_name = "SECONDS", default_value_t = fleets::DEFAULT_IDLE_AFTER_S, requires = "fleets",
          value_parser = idle_seconds)]
    idle_after: u64,
}

fn at_most_fleets(text: &str) -> Result<usize, String> {
    let count = text.parse().ok().filter(|count| (1..=fleets::MOST_FLEETS).contains(count));
    count.ok_or_else(|| format!("must be 1 to {}", fleets::MOST_FLEETS))
}

fn idle_seconds(text: &str) -> Result<u64, String> {
    let seconds = text.parse().ok().filter(|seconds| fleets::IDLE_AFTER_S.contains(seconds));
    let (least, most) = (fleets::IDLE_AFTER_S.start(), fleets::IDLE_AFTER_S.end());
    seconds.ok_or_else(|| format!("must be {least} to {most}"))
}

impl UpArgs {
    /// Whether several fleets are asked for.
    pub(crate) fn is_for_many(&self) -> bool {
        !self.fleets.is_empty()
    }

    /// The port of the page, if it is wanted. One that no one asked for is left out where its port is taken.
    ///
    /// # Errors
    /// If an address makes no sense, or cannot be listened at.
    async fn page(&self) -> anyhow::Result<Option<LocalPage>> {
        if self.no_console || (self.console.is_none() && !self.services.is_empty()) {
            return Ok(None);
        }
        let address = LocalPage::parse(self.console.as_deref())?;
        match LocalPage::listen(address).await {
            Ok(page) => Ok(Some(page)),
            Err(error) if self.console.is_none() => {
                tracing::info!(
                    "the page for operators is not served at {address}: {error}; see --console"
                );
                Ok(None)
            }
            Err(error) => Err(ExitError {
                exit: Exit::Failure,
                message: format!(
                    "console: cannot listen at {address}: {error}; choose another address"
                ),
            }
            .into()),
        }
    }
}

/// Changes settings by the `SERVICE.FIELD=VALUE` of `--set`.
///
/// # Errors
/// Names the assignment that is wrong.
pub(crate) fn apply_settings(args: &UpArgs, config: &mut ProcessConfig) -> anyhow::Result<()> {
    // All fields of a service at once: some fit only together.
    let mut by_service: BTreeMap<ServiceName, Vec<String>> = BTreeMap::new();
    for assignment in &args.set {
        let (service, rest) = assignment.split_once('.').ok_or_else(|| {
            ExitError::usage(format!("--set {assignment}: must be SERVICE.FIELD=VALUE"))
        })?;
        let service: ServiceName = service
            .parse()
            .map_err(|problem| ExitError::usage(format!("--set {assignment}: {problem}")))?;
        by_service.entry(service).or_default().push(rest.to_owned());
    }
    for (service, assignments) in by_service {
        config.set(service, &assignments)?;
    }
    Ok(())
}

/// Starts services as tasks; each ends when it is time to stop.
pub(crate) fn start(
    services: &[ServiceName],
    config: &ProcessConfig,
    stop: &Stop,
    observatory: &Observatory,
) -> JoinSet<anyhow::Result<()>> {
    let mut tasks = JoinSet::new();
    for name in services {
        let (config, stop) = (config.clone(), stop.clone());
        let observer = observatory.observer(*name);
        match name {
            ServiceName::Ingest => tasks.spawn(service::run::<Ingest>(config, stop, observer)),
            ServiceName::Embedder => tasks.spawn(service::run::<Embedder>(config, stop, observer)),
            ServiceName::Clusterer => {
                tasks.spawn(service::run::<Clusterer>(config, stop, observer))
            }
            ServiceName::Auditor => tasks.spawn(service::run::<Auditor>(config, stop, observer)),
            ServiceName::Historian => {
                let open = muster_historian::open;
                tasks.spawn(service::run_recording::<Historian>(config, stop, observer, open))
            }
            ServiceName::Planner => tasks.spawn(service::run::<Planner>(config, stop, observer)),
        };
    }
    tasks
}

/// Waits until all services have ended, or one has failed.
///
/// # Errors
/// The first failure; a service that panics is one.
pub(crate) async fn wait(mut tasks: JoinSet<anyhow::Result<()>>) -> anyhow::Result<()> {
    while let Some(ended) = tasks.join_next().await {
        ended.map_err(|error| anyhow::anyhow!("a service failed: {error}"))??;
    }
    Ok(())
}

/// Starts the router of this process, if one is asked for; the services connect to it.
///
/// # Errors
/// If it cannot listen where it should.
async fn start_router(args: &UpArgs, config: &mut ProcessConfig) -> anyhow::Result<Option<Bus>> {
    if !args.router {
        return Ok(None);
    }
    let listen = match config.listen.value.as_slice() {
        [] => vec![DEFAULT_ENDPOINT.to_owned()],
        listen => listen.to_vec(),
    };
    let has_ros = args.with.contains(&Companion::Ros2);
    let bus = BusConfig { gossip: has_ros, ..BusConfig::from(&config.as_router(listen)) };
    let bus = Bus::open(bus, ConnectTimeout::Never).await?;
    let endpoints = bus.locators().await;
    writeln!(std::io::stdout(), "router listens at {}", endpoints.join(", "))?;
    *config = config.as_client(endpoints);
    Ok(Some(bus))
}

/// Serves many fleets until it is time to stop.
///
/// # Errors
/// If what is asked for does not fit together, or the bus does not open.
pub(crate) async fn run_fleets(
    args: &UpArgs,
    mut config: ProcessConfig,
    stop: Stop,
) -> anyhow::Result<()> {
    let limits =
        Limits { max_fleets: args.max_fleets, idle_after: Duration::from_secs(args.idle_after) };
    fleets::check(&args.fleets, limits)?;
    if config.fleet.origin == Origin::Flag {
        let problem = "--fleet: name one fleet with it, or several with --fleets, and not both";
        return Err(ExitError::usage(problem).into());
    }
    let observatory = FleetsObservatory::open(&config)?;
    let router = start_router(args, &mut config).await?;
    fleets::run(&args.fleets, limits, &args.services, config, observatory, stop).await?;
    if let Some(router) = router {
        router.close().await;
    }
    Ok(())
}

/// Runs services until it is time to stop.
///
/// # Errors
/// If a service fails.
pub(crate) async fn run(
    args: &UpArgs,
    mut config: ProcessConfig,
    stop: Stop,
) -> anyhow::Result<()> {
    // What is missing is named before anything runs.
    let companions = Companions::find(&args.with)?;
    let services =
        if args.services.is_empty() { ServiceName::ALL.to_vec() } else { args.services.clone() };
    config.record = args.record.clone().map(|path| RecordTo { path, several: true });
    let observatory = Observatory::open(&config, &services)?;
    let router = start_router(args, &mut config).await?;
    let page = args.page().await?;
    let serving = match page {
        Some(page) => {
            let operator = OperatorArgs::default().name(&config)?;
            writeln!(std::io::stdout(), "console at {}", page.url())?;
            Some(tokio::spawn(page.serve(config.clone(), operator, stop.clone())))
        }
        None => None,
    };
    let mut tasks = start(&services, &config, &stop, &observatory);
    if !args.with.is_empty() {
        tasks.spawn(companions.run(config.clone(), stop.clone()));
    }
    let ended = wait(tasks).await;
    if let Some(serving) = serving {
        serving.abort();
    }
    ended?;
    if let Some(router) = router {
        router.close().await;
    }
    Ok(())
}
