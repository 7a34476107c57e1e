//! `muster router`: an embedded Zenoh router.

use std::io::Write as _;
use std::time::Duration;

use muster_runtime::bus::{Bus, BusConfig, ConnectTimeout};
use muster_runtime::config::ProcessConfig;
use muster_runtime::exit::ExitError;
use muster_runtime::notify;
use muster_runtime::observe::Observatory;
use muster_runtime::stop::Stop;

/// How often the router shows that its loop runs: several times in the five seconds after which `/healthz`
/// takes it for hung.
const TURN_INTERVAL: Duration = Duration::from_secs(1);

/// Arguments of `muster router`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Robots and services connect to a router of their host or site, and routers \
connect to each other.\n\nExamples:\n  muster router                                    for this host only\n  \
muster router --listen tcp/0.0.0.0:7447          for the network\n  \
muster router --listen tcp/0.0.0.0:7447 --connect tcp/base:7447\n  \
muster router --listen tcp/0.0.0.0:7447 --ros    where robots of ROS 2 meet"
)]
pub(crate) struct RouterArgs {
    /// Announce programs of ROS 2 to each other, as rmw_zenohd does: they link directly, and reach each other only so
    #[arg(long)]
    ros: bool,
}

/// Runs a router until it is time to stop.
///
/// # Errors
/// If it cannot listen where it should.
pub(crate) async fn run(
    args: &RouterArgs,
    config: &ProcessConfig,
    mut stop: Stop,
) -> anyhow::Result<()> {
    if config.mode.value != muster_runtime::config::Mode::Router {
        return Err(ExitError::usage("mode: a router runs in mode router; leave --mode out").into());
    }
    let observatory = Observatory::open(config, &[])?;
    let bus = BusConfig { gossip: args.ros, ..BusConfig::from(config) };
    let bus = tokio::select! {
        bus = Bus::open(bus, ConnectTimeout::Never) => bus?,
        () = stop.stopped() => return Ok(()),
    };
    let listening = format!("router listens at {}", bus.locators().await.join(", "));
    writeln!(std::io::stdout(), "{listening}")?;
    notify::ready(&listening);
    let mut watched = notify::watch();
    let mut turn = tokio::time::interval(TURN_INTERVAL);
    loop {
        tokio::select! {
            () = stop.stopped() => break,
            // Who answers this is not stuck.
            () = watched.due() => {
                bus.locators().await;
                watched.report();
            }
            _ = turn.tick() => {
                bus.locators().await;
                observatory.router_turned();
            }
        }
    }
    notify::stopping().await;
    bus.close().await;
    Ok(())
}
