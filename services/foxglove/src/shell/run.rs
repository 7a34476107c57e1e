//! The loop: inputs into the core, outputs to where they belong.

use std::net::SocketAddr;
use std::time::Duration;

use muster_model::time::Tick;
use muster_runtime::clock::Clock;
use muster_runtime::config::ProcessConfig;
use muster_runtime::exit::{Exit, ExitError};
use muster_runtime::notify;
use muster_runtime::observe::Observatory;
use muster_runtime::stop::Stop;
use tokio::sync::mpsc;

use super::fleet::{self, Order};
use super::options::FoxgloveOptions;
use super::server::Server;
use crate::{Bridge, Input, Output};

/// How often the core learns that time passes: twice in the shortest time between two scenes, so that none is missed.
const TURN: Duration = Duration::from_millis(50);

/// Most inputs that wait for the core. Whoever has one more waits.
const MAX_WAITING_INPUTS: usize = 256;

/// Most orders that wait for the bus: more than the core has open at once.
const MAX_WAITING_ORDERS: usize = 256;

/// How long viewers that end may take.
const STOP_WITHIN: Duration = Duration::from_secs(2);

/// Serves viewers until it is time to stop.
///
/// # Errors
/// If the address cannot be listened at; the text names the flag.
pub(super) async fn run(
    config: ProcessConfig,
    options: FoxgloveOptions,
    mut stop: Stop,
) -> anyhow::Result<()> {
    let observatory = Observatory::open(&config, &[])?;
    let clock = Clock::start();
    let (inputs, mut inbox) = mpsc::channel(MAX_WAITING_INPUTS);
    let fleet = config.fleet.value.clone();
    let server = Server::start(&fleet, options.address, inputs.clone()).await;
    let mut server = server.map_err(|error| ExitError {
        exit: Exit::Failure,
        message: format!(
            "serve: cannot listen at {}: {error}; choose another address with --serve",
            options.address
        ),
    })?;
    let address = SocketAddr::new(options.address.ip(), server.port());
    notify::ready(&format!("serves viewers at ws://{address}"));
    tracing::info!("serves viewers at ws://{address}");
    if !address.ip().is_loopback() {
        tracing::warn!(
            "everyone who reaches {address} sees the fleet: the protocol asks for no password"
        );
    }
    let (orders, to_fleet) = mpsc::channel(MAX_WAITING_ORDERS);
    tokio::spawn(fleet::follow(fleet::client_config(&config), inputs, to_fleet));
    let mut watched = notify::watch();
    let mut bridge = Bridge::new(fleet, options.access);
    let mut ticks = tokio::time::interval(TURN);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    loop {
        let input = tokio::select! {
            () = stop.stopped() => break,
            () = watched.due() => {
                watched.report();
                continue;
            }
            _ = ticks.tick() => {
                observatory.router_turned();
                let now = clock.now();
                perform_all(bridge.handle(now, Input::Watched(server.watched())), now, &mut server, &orders);
                Input::Tick
            }
            Some(input) = inbox.recv() => input,
        };
        let now = clock.now();
        perform_all(bridge.handle(now, input), now, &mut server, &orders);
    }
    notify::stopping().await;
    let _ = tokio::time::timeout(STOP_WITHIN, server.stop()).await;
    Ok(())
}

fn perform_all(outputs: Vec<Output>, now: Tick, server: &mut Server, orders: &mpsc::Sender<Order>) {
    for output in outputs {
        let order = match output {
            Output::Offer(topic) => {
                server.offer(topic);
                continue;
            }
            Output::Send(topic, message) => {
                server.send(now, &topic, message);
                continue;
            }
            Output::Say(name, level, text) => {
                server.say(name, level, text);
                continue;
            }
            Output::Unsay(name) => {
                server.unsay(name);
                continue;
            }
            Output::Publish(parameters) => {
                server.publish(parameters);
                continue;
            }
            Output::Respond(id, parameters) => {
                server.respond(id, parameters);
                continue;
            }
            Output::Refuse(id, problem) => {
                server.refuse(id, problem);
                continue;
            }
            Output::Command(ticket, operator, service, patch) => {
                Order::Command(ticket, operator, service, patch)
            }
            Output::Fetch(fetch) => Order::Fetch(fetch),
        };
        if let Err(error) = orders.try_send(order) {
            tracing::warn!("an order is not carried out: {error}");
        }
    }
}
