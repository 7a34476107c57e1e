//! The whole `main` of a service binary: build, start, run until it is stopped, end.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::{CommandFactory, FromArgMatches, Parser};
use muster_model::id::{InstanceId, ServiceName};
use muster_service::Core;
use tracing::Instrument as _;

use crate::bus::{self, Bus, ConnectTimeout, SharedBus};
use crate::config::{Mode, ProcessArgs, ProcessConfig, process_environment};
use crate::exit::{self, ExitError};
use crate::instance::instance_name;
use crate::kept::KeptStore;
use crate::notify;
use crate::observe::{Observatory, Observer};
use crate::pool::Pool;
use crate::recording::RecordTo;
use crate::records::{OpenRecords, RecordOptions, RecordPlace};
use crate::shell::{self, ServiceOptions};
use crate::stop::{self, Stop};
use crate::store::Store;

/// How long computations that still run at the end are waited for.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_millis(500);

/// Most threads for work that blocks, such as gets on a busy link: tokio's own default.
const MAX_BLOCKING_THREADS: usize = 512;

/// When a process that waits for its router counts as started.
const READY_AFTER: Duration = Duration::from_secs(1);

/// The flags of a service binary.
#[derive(Debug, Parser)]
#[command(version)]
struct ServiceArgs {
    #[command(flatten)]
    process: ProcessArgs,
    /// Change a setting, such as teams=3 or spatial.width=1.5
    #[arg(long, value_name = "FIELD=VALUE")]
    set: Vec<String>,
    /// Record everything that happens to this run, for `muster replay-core`. FILE must be new; in a
    /// folder every run gets a file of its own. It ends at 4 GiB
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
}

/// Runs the service of a core as a process. `about` is the first line of `--help`.
#[must_use]
pub fn main<C: Core>(about: &'static str) -> ExitCode {
    main_of::<C>(about, None)
}

/// The same for a service that keeps records. `open` opens their store.
#[must_use]
pub fn main_recording<C: Core>(about: &'static str, open: OpenRecords) -> ExitCode {
    main_of::<C>(about, Some(open))
}

fn main_of<C: Core>(about: &'static str, open: Option<OpenRecords>) -> ExitCode {
    let name = C::SERVICE;
    let examples = format!(
        "Examples:\n  muster-{name}\n  muster-{name} --fleet alpha --connect tcp/192.168.1.10:7447\n  \
         muster-{name} --config /etc/muster/muster.toml --check-config\n\n\
         Settings can be changed while it runs: muster set {name} --help\n\n{}",
        exit::HELP
    );
    let command =
        ServiceArgs::command().name(format!("muster-{name}")).about(about).after_help(examples);
    let args =
        match command.try_get_matches().and_then(|matches| ServiceArgs::from_arg_matches(&matches))
        {
            Ok(args) => args,
            Err(error) => error.exit(),
        };
    exit::finish(start::<C>(&args, open))
}

fn start<C: Core>(args: &ServiceArgs, open: Option<OpenRecords>) -> anyhow::Result<()> {
    let mut config = ProcessConfig::resolve(&args.process, Mode::Client, &process_environment)?;
    config.set(C::SERVICE, &args.set)?;
    config.record = args.record.clone().map(|path| RecordTo { path, several: false });
    if report(&args.process, &config, &[C::SERVICE])? {
        return Ok(());
    }
    block_on(&config, async |config, stop| {
        let observatory = Observatory::open(&config, &[C::SERVICE])?;
        run_of::<C>(config, stop, observatory.observer(C::SERVICE), open).await
    })
}

/// Does what `--check-config` and `--print-config` ask for; true if the process is to end then.
///
/// # Errors
/// If settings do not hold together.
pub fn report(
    args: &ProcessArgs,
    config: &ProcessConfig,
    services: &[ServiceName],
) -> anyhow::Result<bool> {
    use std::io::Write as _;
    if args.print_config {
        write!(std::io::stdout(), "{}", config.print(services)?)?;
    } else if args.check_config {
        writeln!(std::io::stdout(), "the configuration is valid")?;
    }
    Ok(args.print_config || args.check_config)
}

/// Starts logging and the runtime, runs a main job, and ends within a bounded time after a signal.
///
/// # Errors
/// What the job returns; or what keeps the runtime from starting.
pub fn block_on<T, F>(config: &ProcessConfig, job: F) -> anyhow::Result<T>
where
    F: AsyncFnOnce(ProcessConfig, Stop) -> anyhow::Result<T>,
{
    block_on_threads(config, MAX_BLOCKING_THREADS, job)
}

/// The same with another number of threads for work that blocks, at most.
///
/// # Errors
/// What the job returns; or what keeps the runtime from starting.
pub fn block_on_threads<T, F>(
    config: &ProcessConfig,
    max_blocking_threads: usize,
    job: F,
) -> anyhow::Result<T>
where
    F: AsyncFnOnce(ProcessConfig, Stop) -> anyhow::Result<T>,
{
    crate::logging::start(config.log.value.as_deref(), config.log_json.value)
        .map_err(ExitError::usage)?;
    // Zenoh does not work on a single-threaded runtime.
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .max_blocking_threads(max_blocking_threads)
        .build()?;
    let result = runtime.block_on(async {
        let (stopper, stop) = stop::channel();
        stop::on_signals(stopper.clone())?;
        stop::at_end_of_input(stopper.clone());
        job(config.clone(), stop).await
    });
    runtime.shutdown_timeout(SHUTDOWN_TIMEOUT);
    result
}

/// Opens a bus of its own for one service and runs it until it is time to stop.
///
/// # Errors
/// If the bus does not open, or refuses what the service declares.
pub async fn run<C: Core>(
    config: ProcessConfig,
    stop: Stop,
    observer: Observer,
) -> anyhow::Result<()> {
    run_of::<C>(config, stop, observer, None).await
}

/// What services of many fleets in one process share.
#[derive(Debug, Clone)]
pub struct Shared {
    /// The bus.
    pub bus: SharedBus,
    /// Threads.
    pub pool: Pool,
}

/// Runs one service of the fleet of the configuration on a bus and on threads that many share, until it is time to stop.
/// `open_records` opens the store of a service that keeps records.
///
/// # Errors
/// If the settings are wrong, or the bus refuses what the service declares.
pub async fn run_shared<C: Core>(
    config: ProcessConfig,
    stop: Stop,
    observer: Observer,
    shared: Shared,
    open_records: Option<OpenRecords>,
) -> anyhow::Result<()> {
    let instance = instance_name();
    let fleet = config.fleet.value.clone();
    let span = tracing::error_span!("service", service = %C::SERVICE, %instance, %fleet);
    let options = options::<C>(&config, observer, instance, open_records, Some(shared.pool))?;
    shell::run::<C>(shared.bus.join(&fleet), options, stop).instrument(span).await
}

/// The same for a service that keeps records. `open_records` opens their store.
///
/// # Errors
/// If the bus does not open, or refuses what the service declares.
pub async fn run_recording<C: Core>(
    config: ProcessConfig,
    stop: Stop,
    observer: Observer,
    open_records: OpenRecords,
) -> anyhow::Result<()> {
    run_of::<C>(config, stop, observer, Some(open_records)).await
}

async fn run_of<C: Core>(
    config: ProcessConfig,
    stop: Stop,
    observer: Observer,
    open_records: Option<OpenRecords>,
) -> anyhow::Result<()> {
    let instance = instance_name();
    // An error's level: the span must not vanish with the filter that lets only errors through.
    let span = tracing::error_span!(
        "service", service = %C::SERVICE, %instance, fleet = %config.fleet.value
    );
    let running = run_instance::<C>(config, stop, observer, instance, open_records);
    running.instrument(span).await
}

async fn run_instance<C: Core>(
    config: ProcessConfig,
    mut stop: Stop,
    observer: Observer,
    instance: InstanceId,
    open_records: Option<OpenRecords>,
) -> anyhow::Result<()> {
    let options = options::<C>(&config, observer, instance, open_records, None)?;
    let mut watched = notify::watch();
    let bus = tokio::select! {
        bus = watched.during(open(&config)) => bus?,
        () = stop.stopped() => {
            notify::stopping().await;
            return Ok(());
        }
    };
    drop(watched);
    shell::run::<C>(bus, options, stop).await
}

/// What a service is run with, by the configuration of its process.
fn options<C: Core>(
    config: &ProcessConfig,
    observer: Observer,
    instance: InstanceId,
    open_records: Option<OpenRecords>,
    pool: Option<Pool>,
) -> anyhow::Result<ServiceOptions<C::Settings>> {
    // Made before the bus opens, so that a wrong name is an error at once.
    let record = config.record.as_ref().map(|to| to.create(C::SERVICE, &instance)).transpose()?;
    let directory = config.state_directory.value.as_deref();
    let fleet = config.fleet.value.clone();
    let folder = directory.map(|directory| directory.join(fleet.as_str()));
    let place = RecordPlace { folder, fleet, instance: instance.clone() };
    Ok(ServiceOptions {
        instance,
        record,
        settings: config.settings(C::SERVICE)?,
        store: Store::new(directory, &config.fleet.value, C::SERVICE),
        kept: KeptStore::new(directory, &config.fleet.value, C::SERVICE, C::WITHOUT_KEPT),
        records: open_records.map(|open| RecordOptions { place, open }),
        observer,
        pool,
    })
}

/// Opens the bus, and notes for the service manager if it waits for a router: that may take long, and is
/// no failure of this process.
async fn open(config: &ProcessConfig) -> anyhow::Result<Bus> {
    let mut opening = std::pin::pin!(Bus::open(config, ConnectTimeout::Never));
    if let Ok(bus) = tokio::time::timeout(READY_AFTER, &mut opening).await {
        return Ok(bus?);
    }
    let routers = bus::routers(&config.into())?.join(", ");
    notify::ready(&format!("waiting for a router at {routers}"));
    Ok(opening.await?)
}
