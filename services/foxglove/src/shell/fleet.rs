//! The fleet: what the client brings becomes inputs, and orders of the core become gets and commands.

use std::sync::Arc;
use std::time::Duration;

use muster_client::{Client, Config, Error, Latest, Mode, Publication, Staleness, Watch};
use muster_model::id::{OperatorId, ServiceName};
use muster_runtime::config::{self, Origin, ProcessConfig};
use serde_json::Value;
use tokio::sync::mpsc;
use tokio::task::JoinSet;

use crate::{Fetch, Input, Stale, Ticket};

/// How often the newest message is looked at although nothing says that it changed.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// How long opening a session waits before it says why there is none, and tries again.
const OPEN_WITHIN: Duration = Duration::from_secs(5);

/// Least time between two attempts that failed at once.
const OPEN_AGAIN: Duration = Duration::from_secs(1);

/// What the core orders.
#[derive(Debug)]
pub(crate) enum Order {
    /// Change settings of a service.
    Command(Ticket, OperatorId, ServiceName, Value),
    /// Ask for something.
    Fetch(Fetch),
}

/// The process options as a client takes them.
pub(crate) fn client_config(config: &ProcessConfig) -> Config {
    Config {
        fleet: config.fleet.value.to_string(),
        // An address that the user gave overrides Zenoh's configuration, also if it is the default.
        routers: (config.connect.origin != Origin::Default).then(|| config.connect.value.clone()),
        zenoh_config: config.zenoh_config.value.clone(),
        mode: if config.mode.value == config::Mode::Peer { Mode::Peer } else { Mode::Client },
        listen: config.listen.value.clone(),
        connect_timeout: Some(OPEN_WITHIN),
        ..Config::default()
    }
}

type Inputs = mpsc::Sender<Input>;

/// Follows a fleet until the loop ends.
pub(crate) async fn follow(config: Config, inputs: Inputs, mut orders: mpsc::Receiver<Order>) {
    let client = loop {
        match Client::open(&config).await {
            Ok(client) => break client,
            Err(error) => {
                tracing::warn!("{error}");
                if inputs.is_closed() {
                    return;
                }
                tokio::time::sleep(OPEN_AGAIN).await;
            }
        }
    };
    // What an attempt that failed has begun ends before the next one.
    let mut following = JoinSet::new();
    while let Err(error) = subscribe(&client, &inputs, &mut following).await {
        tracing::warn!("the fleet cannot be followed: {error}");
        following.shutdown().await;
        if inputs.is_closed() {
            return;
        }
        tokio::time::sleep(OPEN_AGAIN).await;
    }
    while let Some(order) = orders.recv().await {
        let (client, inputs) = (client.clone(), inputs.clone());
        // How many run at once is bounded by the core: what it asks for once each, and a few commands.
        tokio::spawn(async move {
            let input = carry_out(&client, order).await;
            // It fails as the process ends.
            let _ = inputs.send(input).await;
        });
    }
    client.close().await;
}

async fn subscribe(
    client: &Client,
    inputs: &Inputs,
    following: &mut JoinSet<()>,
) -> Result<(), Error> {
    // Events come first: they come once, and all else comes again.
    let (mut events, to) = (client.events().await?, inputs.clone());
    following.spawn(async move {
        while let Ok(event) = events.next().await {
            if to.send(Input::Event(Box::new(event))).await.is_err() {
                return;
            }
        }
    });
    following.spawn(pass_on(client.rosters().await?, inputs.clone(), Input::Roster));
    following.spawn(pass_on(client.teams().await?, inputs.clone(), Input::Teams));
    following.spawn(pass_on(client.audits().await?, inputs.clone(), Input::Audit));
    let (mut link, to) = (client.link(), inputs.clone());
    following.spawn(async move {
        loop {
            let linked = *link.borrow_and_update();
            if to.send(Input::Link(linked)).await.is_err() || link.changed().await.is_err() {
                return;
            }
        }
    });
    Ok(())
}

fn stale(staleness: Option<Staleness>) -> Stale {
    staleness.map(|staleness| match staleness {
        Staleness::LinkLost => "link_lost",
        Staleness::Silent => "silent",
        Staleness::Restarted => "restarted",
    })
}

/// Passes on the newest message whenever it changes, and from time to time.
async fn pass_on<T: Publication>(
    mut watch: Watch<T>,
    to: Inputs,
    input: fn(Arc<T>, Stale) -> Input,
) {
    loop {
        let changed = tokio::time::timeout(LOOK_EVERY, watch.changed()).await;
        let latest: Option<Latest<T>> = match changed {
            Ok(Ok(latest)) => Some(latest),
            Ok(Err(_)) => return,
            Err(_) => watch.latest(),
        };
        if let Some(latest) = latest {
            // While the core is busy, newer messages take the place of this one in the watch.
            if to.send(input(latest.value, stale(latest.stale))).await.is_err() {
                return;
            }
        }
    }
}

async fn carry_out(client: &Client, order: Order) -> Input {
    match order {
        Order::Command(ticket, operator, service, patch) => {
            let settings = client.change_settings(&operator, service, &patch).await;
            Input::Answer(ticket, settings.map_err(|error| error.to_string()))
        }
        Order::Fetch(fetch) => fetched(client, &fetch).await.unwrap_or_else(|error| {
            tracing::debug!("{fetch:?}: {error}");
            Input::Unfetched(fetch)
        }),
    }
}

async fn fetched(client: &Client, fetch: &Fetch) -> Result<Input, Error> {
    Ok(match fetch {
        Fetch::Settings(service) => Input::Settings(*service, client.get_settings(*service).await?),
        Fetch::Graph(modality) => {
            let graphs = client.get_graphs(Some(modality)).await?;
            graphs.into_iter().next().map_or_else(|| Input::Unfetched(fetch.clone()), Input::Graph)
        }
    })
}
