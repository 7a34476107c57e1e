//! `muster`: the operator's command.
//!
//! It starts processes ([`demo`], [`up`], [`router`], [`robot`]), shows a live fleet ([`show`], [`doctor`]) and what
//! one was ([`past`]), changes its settings ([`set`]) and wishes ([`wish`]), prepares hosts ([`deploy`]), tells
//! container managers whether a process is
//! alive ([`probe`]), prints the form of messages ([`schema`]),
//! runs the method once on a file ([`solve`]), searches for better settings ([`tune`]), records and replays fleets by another program ([`companions`]), replays the recording of a service ([`replay`]), and
//! describes itself to shells and manuals ([`describe`]). It is the one program that knows all services:
//! it composes them and adds nothing to them. It talks to a fleet through `muster-client` ([`console`]);
//! only what runs services or a router, and the doctor's probe of a router, know the bus.

mod alerts;
mod companions;
mod console;
mod demo;
mod deploy;
mod describe;
mod doctor;
mod fleet;
mod fleets;
mod operator;
mod past;
mod probe;
mod propose;
mod replay;
mod robot;
mod router;
mod schema;
mod set;
mod show;
mod tune;
mod up;
mod wish;

use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use muster_model::id::ServiceName;
use muster_runtime::config::{Environment, Mode, ProcessArgs, ProcessConfig, process_environment};
use muster_runtime::exit::{self, ExitError};
use muster_runtime::pool::MAX_BLOCKING_THREADS;
use muster_runtime::service::{block_on, block_on_threads, report};
use muster_solve as solve;

/// Divides a fleet of robots into teams, live, from how the robots relate.
#[derive(Debug, Parser)]
#[command(
    version,
    propagate_version = true,
    after_help = format!(
        "Examples:\n  muster demo                 everything on this machine, with a simulated fleet\n  \
         muster teams --watch        the teams of a live fleet, as they change\n  \
         muster set clusterer teams=3\n\n{}", exit::HELP)
)]
struct Arguments {
    #[command(flatten)]
    process: ProcessArgs,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run a router, all services and a simulated fleet in this process, and print the teams
    Demo(demo::DemoArgs),
    /// Run services in this process
    Up(up::UpArgs),
    /// Run a Zenoh router
    Router(router::RouterArgs),
    /// Run one or many simulated robots
    Robot(robot::RobotArgs),
    /// Show the teams of the live fleet
    Teams(show::ShowArgs),
    /// Show the silhouettes of the live division
    Audit(show::ShowArgs),
    /// Show open alerts, or say that they have been seen
    Alerts(alerts::AlertsArgs),
    /// Show the graphs of the live fleet
    Graph(show::graph::GraphArgs),
    /// Show why a robot is in its team
    Why(show::why::WhyArgs),
    /// Show services and robots of the live fleet
    Status(show::ShowArgs),
    /// Show what a fleet was: its teams at a moment, or how they changed
    History(past::HistoryArgs),
    /// Show what happened in a fleet
    Events(past::EventsArgs),
    /// Show which robots joined a fleet and left it, when and why
    Robots(past::RobotsArgs),
    /// Find what is wrong with a fleet, and say what to do
    Doctor(doctor::DoctorArgs),
    /// Ask the process at --http whether it is alive, as a container's health check does
    Probe(probe::ProbeArgs),
    /// Show or change the settings of a running service
    Set(set::SetArgs),
    /// Put, withdraw or list wishes about robots and teams
    Wish(wish::WishArgs),
    /// Show what the teams would be with other settings, and accept that
    Propose(propose::ProposeArgs),
    /// Print the JSON Schema of the messages
    Schema(schema::SchemaArgs),
    /// Print configurations, make certificates and the rules of routers
    Deploy(deploy::DeployArgs),
    /// Divide a fleet that is described in a file, once, without a bus
    Solve(solve::SolveArgs),
    /// Find weights, decay and dimension that divide the fleet better
    Tune(tune::TuneArgs),
    /// Record a live fleet in MCAP, for Foxglove, PlotJuggler and replay
    Record(companions::PassedArgs),
    /// Play a recording of a fleet into a fleet of its own
    Replay(companions::PassedArgs),
    /// Feed a recording of a service to its core again, and compare what comes out
    ReplayCore(replay::ReplayArgs),
    /// Print completions for a shell
    Completions(describe::CompletionsArgs),
    /// Print the manual page
    Manual(describe::ManualArgs),
}

fn main() -> ExitCode {
    exit::finish(run(&Arguments::parse()))
}

fn run(arguments: &Arguments) -> anyhow::Result<()> {
    // What describes the program works with any configuration.
    match &arguments.command {
        Some(Command::Completions(args)) => {
            return describe::completions(args, Arguments::command());
        }
        Some(Command::Manual(args)) => return describe::manual(args, Arguments::command()),
        // Another program reads its own options.
        Some(Command::Record(args)) => {
            return companions::run_mcap("record", args, &arguments.process);
        }
        Some(Command::Replay(args)) => {
            return companions::run_mcap("replay", args, &arguments.process);
        }
        _ => {}
    }
    let default_mode = match &arguments.command {
        Some(Command::Router(_)) => Mode::Router,
        _ => Mode::Client,
    };
    let environment: Environment<'_> = match &arguments.command {
        Some(Command::Demo(_)) => &demo::environment,
        _ => &process_environment,
    };
    let mut config = ProcessConfig::resolve(&arguments.process, default_mode, environment)?;
    if matches!(arguments.command, Some(Command::Demo(_))) {
        // People look at the table; the services log what is wrong.
        config.log.value.get_or_insert_with(|| "warn".to_owned());
    }
    if let Some(Command::Up(args)) = &arguments.command {
        up::apply_settings(args, &mut config)?;
    }
    if report(&arguments.process, &config, &ServiceName::ALL)? {
        return Ok(());
    }
    let Some(command) = &arguments.command else {
        let help = Arguments::command().render_help();
        return Err(ExitError::usage(format!("a command is missing\n\n{help}")).into());
    };
    match command {
        Command::Demo(args) => {
            block_on(&config, async |config, stop| demo::run(args, config, stop).await)
        }
        Command::Up(args) if args.is_for_many() => {
            let threads = MAX_BLOCKING_THREADS;
            block_on_threads(&config, threads, async |config, stop| {
                up::run_fleets(args, config, stop).await
            })
        }
        Command::Up(args) => {
            block_on(&config, async |config, stop| up::run(args, config, stop).await)
        }
        Command::Router(args) => {
            block_on(&config, async |config, stop| router::run(args, &config, stop).await)
        }
        Command::Robot(args) => {
            block_on(&config, async |config, stop| robot::run(args, &config, stop).await)
        }
        Command::Teams(args) => {
            console(&config, async |config| show::teams::run(args, &config).await)
        }
        Command::Audit(args) => {
            console(&config, async |config| show::audit::run(args, &config).await)
        }
        Command::Alerts(args) => {
            commanding(&config, args.shown_by(), async |config| alerts::run(args, &config).await)
        }
        Command::Graph(args) => {
            console(&config, async |config| show::graph::run(args, &config).await)
        }
        Command::Why(args) => console(&config, async |config| show::why::run(args, &config).await),
        Command::Status(args) => {
            console(&config, async |config| show::status::run(args, &config).await)
        }
        Command::History(args) => {
            console(&config, async |config| past::history(args, &config).await)
        }
        Command::Events(args) => console(&config, async |config| past::events(args, &config).await),
        Command::Robots(args) => console(&config, async |config| past::robots(args, &config).await),
        Command::Doctor(args) => console(&config, async |config| doctor::run(args, &config).await),
        Command::Set(args) => {
            commanding(&config, args.shown_by(), async |config| set::run(args, &config).await)
        }
        Command::Tune(args) if args.has_file() => tune::of_file(args),
        Command::Tune(args) => {
            commanding(&config, args.shown_by(), async |config| tune::of_fleet(args, &config).await)
        }
        Command::Wish(args) => {
            commanding(&config, args.shown_by(), async |config| wish::run(args, &config).await)
        }
        Command::Propose(args) => {
            commanding(&config, args.shown_by(), async |config| propose::run(args, &config).await)
        }
        Command::Probe(args) => probe::run(args, &config),
        Command::Record(args) => companions::run_mcap("record", args, &arguments.process),
        Command::Replay(args) => companions::run_mcap("replay", args, &arguments.process),
        Command::ReplayCore(args) => replay::run(args),
        Command::Schema(args) => schema::run(args),
        Command::Completions(args) => describe::completions(args, Arguments::command()),
        Command::Manual(args) => describe::manual(args, Arguments::command()),
        Command::Deploy(args) => deploy::run(args),
        Command::Solve(args) => solve::run(args).map_err(|error| {
            let message = format!("{error:#}");
            match error.downcast_ref::<solve::SolveError>() {
                Some(solve::SolveError::Conflict(_)) => {
                    ExitError { exit: exit::Exit::Conflict, message }.into()
                }
                Some(_) => ExitError::usage(message).into(),
                None => error,
            }
        }),
    }
}

/// Runs a command that only reads: a signal ends it wherever it is, and that is no failure.
fn console<F>(config: &ProcessConfig, job: F) -> anyhow::Result<()>
where
    F: AsyncFnOnce(ProcessConfig) -> anyhow::Result<()>,
{
    commanding(config, None, job)
}

/// The same for one that may change something, which `shown_by` shows. Where a signal ends it, it is not known whether it has.
fn commanding<F>(config: &ProcessConfig, shown_by: Option<&str>, job: F) -> anyhow::Result<()>
where
    F: AsyncFnOnce(ProcessConfig) -> anyhow::Result<()>,
{
    block_on(config, async |config, mut stop| {
        tokio::select! {
            result = job(config) => result,
            () = stop.stopped() => shown_by.map_or(Ok(()), |shown_by| {
                let problem = "stopped before the answer came: it may be done or not";
                let message = format!("{problem}; see {shown_by}");
                Err(ExitError { exit: exit::Exit::Failure, message }.into())
            }),
        }
    })
}
