//! `muster demo`: a router, all services and a simulated fleet in one process.
//!
//! Nothing is simulated but the robots: every service has a session of its own, and every message
//! crosses a real socket.

use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::path::PathBuf;
use std::process::Stdio;

use muster_client::Client;
use muster_console::shell::LocalPage;
use muster_model::id::{FleetId, OperatorId, ServiceName};
use muster_runtime::bus::{Bus, ConnectTimeout};
use muster_runtime::config::{
    DEFAULT_ENDPOINT, Origin, ProcessConfig, Sourced, process_environment,
};
use muster_runtime::exit::ExitError;
use muster_runtime::observe::Observatory;
use muster_runtime::recording::RecordTo;
use muster_runtime::stop::Stop;
use muster_scenario::{FleetOptions, ScenarioKind};

use crate::console::{client_config, exit_error};
use crate::fleet::SimulatedRobots;
use crate::{show, up};

/// Poses per second of each robot.
const RATE_HZ: f64 = 10.0;

/// The fleet of a demo, unless a flag names another.
const FLEET: &str = "demo";

/// Who commands from the page of a demo.
const OPERATOR: &str = "operator";

/// The variables that a demo reads: how it logs. All others may be those of a live fleet, whose operators the
/// simulated robots must not mislead.
const VARIABLES: [&str; 2] = ["MUSTER_LOG", "MUSTER_LOG_JSON"];

/// The variables by which other commands in the same environment look for a router.
const ROUTER_VARIABLES: [&str; 3] = ["MUSTER_CONNECT", "MUSTER_ZENOH_CONFIG", "MUSTER_CONFIG"];

/// Most robots of a demo: their simulation shares the processors with everything else.
const MAX_ROBOTS: usize = 2000;

/// Arguments of `muster demo`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Two platoons march, split at a crossing, where one squad is handed over for a \
while, and rejoin. The table is redrawn as the division changes. While it runs, look at it from \
another terminal with `muster teams --watch --fleet demo`, and likewise `audit`, `graph` and `status`, and at the page for \
operators, whose address it says and which --open opens. It has \
a router and a fleet of its own: of the environment it reads MUSTER_LOG and MUSTER_LOG_JSON only.\n\n\
Examples:\n  muster demo\n  muster demo --robots 60 --teams 3 --seconds 60\n  muster demo --json | jq .teams"
)]
pub(crate) struct DemoArgs {
    /// How many robots
    #[arg(long, default_value_t = 18)]
    robots: usize,
    /// How many teams to divide them into
    #[arg(long, default_value_t = 2)]
    teams: u32,
    /// End after so many seconds; without it, run until Ctrl-C
    #[arg(long)]
    seconds: Option<f64>,
    /// Seed of the simulated fleet
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print one line of JSON per change, in the form of json/teams
    #[arg(long)]
    json: bool,
    /// Open the page for operators in a browser
    #[arg(long)]
    open: bool,
    /// Record everything that happens to each service, to FILE.SERVICE, for `muster replay-core`
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
}

/// The environment as a demo reads it.
pub(crate) fn environment(name: &str) -> Option<String> {
    process_environment(name).filter(|_| VARIABLES.contains(&name))
}

/// Separates the demo from every other fleet: it has a name and a router of its own.
///
/// # Errors
/// If a flag connects it to another router.
fn isolate(config: &mut ProcessConfig) -> anyhow::Result<()> {
    if config.connect.origin == Origin::Flag {
        let problem = "--connect: the demo has a router of its own and connects to no other; leave it \
                       out, or put a simulated fleet on another router with `muster robot`";
        return Err(ExitError::usage(problem).into());
    }
    // Chosen, so that no configuration of Zenoh names other routers either.
    config.connect = Sourced { value: Vec::new(), origin: Origin::Flag };
    if config.fleet.origin != Origin::Flag {
        config.fleet = Sourced { value: FleetId::new(FLEET)?, origin: Origin::Default };
    }
    // Every demo starts without the settings of an earlier one.
    config.state_directory = Sourced { value: None, origin: Origin::Flag };
    Ok(())
}

/// Runs the demo until it is time to stop.
///
/// # Errors
/// If the numbers make no fleet, a flag names another router, the router cannot listen, or a service fails.
pub(crate) async fn run(
    args: &DemoArgs,
    mut config: ProcessConfig,
    stop: Stop,
) -> anyhow::Result<()> {
    if args.robots > MAX_ROBOTS {
        return Err(ExitError::usage(format!(
            "--robots: at most {MAX_ROBOTS} in one process; `muster robot` spreads more over several"
        ))
        .into());
    }
    let fleet = crate::robot::simulate(ScenarioKind::Crossing, &options(args))?;
    let seconds = crate::robot::check_seconds(args.seconds)?;
    config.set(ServiceName::Clusterer, &[format!("teams={}", args.teams)])?;
    isolate(&mut config)?;
    let listen = if config.listen.value.is_empty() {
        vec![free_endpoint()?]
    } else {
        config.listen.value.clone()
    };
    config.record = args.record.clone().map(|path| RecordTo { path, several: true });
    let observatory = Observatory::open(&config, &ServiceName::ALL)?;
    let router = Bus::open(&config.as_router(listen), ConnectTimeout::Never).await?;
    let endpoints = router.locators().await;
    let config = config.as_client(endpoints.clone());
    let mut services = up::start(&ServiceName::ALL, &config, &stop, &observatory);

    let page = local_page().await?;
    let url = page.url();
    let operator = OperatorId::new(OPERATOR)?;
    let serving = tokio::spawn(page.serve(config.clone(), operator, stop.clone()));

    let client = client_config(&config)?;
    let speaking = Client::open(&client).await.map_err(exit_error)?;
    let console = Client::open(&client).await.map_err(exit_error)?;
    let teams = console.teams().await.map_err(exit_error)?;
    let all = (0..fleet.robots().len()).collect();
    let robots = SimulatedRobots::join(&speaking, fleet, all).await.map_err(exit_error)?;
    let mut marching = tokio::spawn(robots.run(RATE_HZ, 0.0, seconds, stop.clone()));
    eprintln!(
        "{} robots and {} services on a router at {}; Ctrl-C ends it",
        args.robots,
        ServiceName::ALL.len(),
        endpoints.join(", ")
    );
    eprintln!("in a browser: {url}");
    if args.open {
        open_browser(&url);
    }
    let connect = endpoints.first().map_or("", String::as_str);
    let elsewhere = ROUTER_VARIABLES.iter().any(|name| process_environment(name).is_some());
    let flag = if connect == DEFAULT_ENDPOINT && !elsewhere {
        String::new()
    } else {
        format!(" --connect {connect}")
    };
    eprintln!("from another terminal: muster teams --watch --fleet {}{flag}", config.fleet.value);

    let ended = tokio::select! {
        ended = show::watch::follow(&console, teams, args.json) => ended,
        ended = &mut marching => ended?.map_err(|error| exit_error(error).into()),
        Some(ended) = services.join_next() => match ended? {
            Ok(()) if stop.is_stopped() => Ok(()),
            Ok(()) => Err(anyhow::anyhow!("a service ended by itself")),
            Err(error) => Err(error),
        },
    };
    services.shutdown().await;
    serving.abort();
    speaking.close().await;
    console.close().await;
    router.close().await;
    ended
}

/// The port of the page: the usual one if it is free, else any.
async fn local_page() -> anyhow::Result<LocalPage> {
    match LocalPage::listen(LocalPage::parse(None)?).await {
        Ok(page) => Ok(page),
        Err(_) => Ok(LocalPage::listen(SocketAddr::from((Ipv4Addr::LOCALHOST, 0))).await?),
    }
}

/// Opens a page in the browser of whoever runs the demo. Without one, the address was said.
fn open_browser(url: &str) {
    let (program, arguments): (_, &[&str]) = if cfg!(target_os = "windows") {
        ("cmd", &["/c", "start", ""])
    } else if cfg!(target_os = "macos") {
        ("open", &[])
    } else {
        ("xdg-open", &[])
    };
    let opened = std::process::Command::new(program)
        .args(arguments)
        .arg(url)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    if let Err(error) = opened {
        eprintln!("--open: {program} cannot be run ({error}); open {url} yourself");
    }
}

/// As many platoons as teams are asked for, where there are robots enough; two otherwise.
fn options(args: &DemoArgs) -> FleetOptions {
    let asked = args.teams as usize;
    let teams = if (2..=args.robots / 2).contains(&asked) { asked } else { 2 };
    FleetOptions { robots: args.robots, seed: args.seed, teams, ..FleetOptions::default() }
}

/// The usual endpoint if it is free, so that other terminals need no flag; else one with a free port.
fn free_endpoint() -> anyhow::Result<String> {
    let address = DEFAULT_ENDPOINT.trim_start_matches("tcp/");
    if TcpListener::bind(address).is_ok() {
        return Ok(DEFAULT_ENDPOINT.to_owned());
    }
    let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
    eprintln!("{address} is taken, perhaps by another router; the demo listens elsewhere");
    Ok(format!("tcp/127.0.0.1:{port}"))
}
