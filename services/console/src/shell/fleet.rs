//! The fleet: what the client brings becomes inputs, and orders of the core become gets and commands.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use muster_client::{
    AppliedPart, Client, Config, Error, Latest, Mode, Publication, Staleness, Watch,
};
use muster_model::id::ServiceName;
use muster_runtime::config::{self, Origin, ProcessConfig};
use serde_json::Value;
use tokio::sync::mpsc;
use tokio::task::JoinSet;

use super::run::Happening;
use crate::{
    Command, Fetch, Input, Problem, ProblemKind, ProposalOrder, ProposalStep, Question, Stale,
    Ticket, proposal,
};

/// How often the newest message is shown although its content has not changed, so that its age is right.
const SHOW_EVERY: Duration = Duration::from_secs(1);

/// How long opening a session waits before it says why there is none, and tries again.
const OPEN_WITHIN: Duration = Duration::from_secs(5);

/// Least time between two attempts that failed at once.
const OPEN_AGAIN: Duration = Duration::from_secs(1);

/// What the core orders.
#[derive(Debug)]
pub(super) enum Order {
    /// Command a service.
    Command(Ticket, Box<Command>),
    /// Ask something for one browser.
    Ask(Ticket, Question),
    /// Ask for a proposal, or decide on one.
    Propose(Ticket, Box<ProposalOrder>),
    /// Ask for what all browsers are shown.
    Fetch(Fetch),
}

/// The process options as a client takes them.
pub(super) fn client_config(config: &ProcessConfig) -> Config {
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

type Happenings = mpsc::Sender<Happening>;

/// Follows a fleet until the loop ends.
pub(super) async fn follow(
    config: Config,
    happenings: Happenings,
    mut orders: mpsc::Receiver<Order>,
) {
    let client = loop {
        match Client::open(&config).await {
            Ok(client) => break client,
            Err(error) => tracing::warn!("{error}"),
        }
        if !waits_to_try_again(&mut orders, &happenings).await {
            return;
        }
    };
    // What an attempt that failed has begun ends before the next one.
    let mut following = JoinSet::new();
    while let Err(error) = subscribe(&client, &happenings, &mut following).await {
        tracing::warn!("the fleet cannot be followed: {error}");
        following.shutdown().await;
        if !waits_to_try_again(&mut orders, &happenings).await {
            return;
        }
    }
    while let Some(order) = orders.recv().await {
        let (client, happenings) = (client.clone(), happenings.clone());
        // How many run at once is bounded by the core: what it asks for itself once each, and a few for each browser.
        tokio::spawn(async move {
            let input = carry_out(&client, order).await;
            // It fails as the process ends.
            let _ = happenings.send(Happening::Core(input)).await;
        });
    }
    client.close().await;
}

/// Answers what was ordered meanwhile, and waits. False if the loop of the console has ended.
async fn waits_to_try_again(orders: &mut mpsc::Receiver<Order>, happenings: &Happenings) -> bool {
    while let Ok(order) = orders.try_recv() {
        unlinked(order, happenings).await;
    }
    if happenings.is_closed() {
        return false;
    }
    tokio::time::sleep(OPEN_AGAIN).await;
    true
}

async fn unlinked(order: Order, happenings: &Happenings) {
    let problem = || Err(Problem::refused("the link to the router is lost; nothing was sent"));
    let input = match order {
        Order::Command(ticket, _) | Order::Ask(ticket, _) | Order::Propose(ticket, _) => {
            Input::Answer(ticket, problem())
        }
        Order::Fetch(fetch) => Input::Unfetched(fetch),
    };
    let _ = happenings.send(Happening::Core(input)).await;
}

async fn subscribe(
    client: &Client,
    happenings: &Happenings,
    following: &mut JoinSet<()>,
) -> Result<(), Error> {
    following.spawn(pass_on(client.rosters().await?, happenings.clone(), Input::Roster));
    following.spawn(pass_on(client.teams().await?, happenings.clone(), Input::Teams));
    following.spawn(pass_on(client.audits().await?, happenings.clone(), Input::Audit));
    following.spawn(pass_on(client.alerts().await?, happenings.clone(), Input::Alerts));
    let (mut events, to) = (client.events().await?, happenings.clone());
    following.spawn(async move {
        while let Ok(event) = events.next().await {
            if to.send(Happening::Core(Input::Event(Box::new(event)))).await.is_err() {
                return;
            }
        }
    });
    let (mut link, to) = (client.link(), happenings.clone());
    following.spawn(async move {
        loop {
            let linked = *link.borrow_and_update();
            let sent = to.send(Happening::Core(Input::Link(linked))).await;
            if sent.is_err() || link.changed().await.is_err() {
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
    to: Happenings,
    input: fn(Arc<T>, Stale) -> Input,
) {
    loop {
        let changed = tokio::time::timeout(SHOW_EVERY, watch.changed()).await;
        let latest: Option<Latest<T>> = match changed {
            Ok(Ok(latest)) => Some(latest),
            Ok(Err(_)) => return,
            Err(_) => watch.latest(),
        };
        if let Some(latest) = latest {
            let input = input(latest.value, stale(latest.stale));
            // While the core is busy, newer messages take the place of this one in the watch.
            if to.send(Happening::Core(input)).await.is_err() {
                return;
            }
        }
    }
}

/// What may have come of what failed with this error.
fn kind_of(error: &Error) -> ProblemKind {
    match error {
        // What had been applied of a proposal was taken back.
        Error::NotApplied { left, .. } if left.is_empty() => ProblemKind::Refused,
        Error::Unavailable { .. } => ProblemKind::Unavailable,
        Error::Unstored { .. } => ProblemKind::Unstored,
        Error::Input { .. }
        | Error::Runtime
        | Error::Unreachable { .. }
        | Error::Taken { .. }
        | Error::Denied { .. }
        | Error::Refused { .. }
        | Error::Closed => ProblemKind::Refused,
        // It was sent, and only its answer is missing: who takes it for refused may do it twice.
        _ => ProblemKind::Unknown,
    }
}

fn problem(error: &Error) -> Problem {
    Problem { kind: kind_of(error), reason: error.to_string() }
}

async fn carry_out(client: &Client, order: Order) -> Input {
    match order {
        Order::Command(ticket, command) => {
            let Command { operator, service, action, based_on } = *command;
            let outcome = client.command(&operator, service, action, based_on).await;
            Input::Answer(ticket, outcome.map_err(|error| problem(&error)))
        }
        Order::Ask(ticket, question) => {
            let answer = match question {
                Question::Why(robot) => client.get_reason(&robot).await.and_then(|why| {
                    serde_json::to_value(&why.reason)
                        .map_err(|error| Error::Bus { reason: error.to_string() })
                }),
                Question::History(query) => client.get_history(&query).await.and_then(|answer| {
                    serde_json::to_value(&answer)
                        .map_err(|error| Error::Bus { reason: error.to_string() })
                }),
            };
            Input::Answer(ticket, answer.map_err(|error| problem(&error)))
        }
        Order::Propose(ticket, order) => {
            let answer = propose(client, *order).await;
            Input::Answer(ticket, answer.map_err(|error| problem(&error)))
        }
        Order::Fetch(fetch) => {
            let fetched = fetched(client, &fetch).await;
            fetched.unwrap_or_else(|error| {
                tracing::debug!("{fetch:?}: {error}");
                Input::Unfetched(fetch)
            })
        }
    }
}

/// A proposal that is not computed yet is answered with how far it is; the page asks again.
async fn propose(client: &Client, order: ProposalOrder) -> Result<Value, Error> {
    let ProposalOrder { operator, id, step } = order;
    let found = match step {
        ProposalStep::Ask(asked) => client.propose(&operator, &id, &asked, Duration::ZERO).await?,
        ProposalStep::Show => client.get_proposal(&operator, &id).await?,
        ProposalStep::Drop => client.drop_proposal(&operator, &id).await?,
        ProposalStep::Accept => {
            let applied = client.accept_proposal(&operator, &id).await?;
            return Ok(applied.iter().map(AppliedPart::to_json).collect());
        }
    };
    Ok(proposal::brief(&found))
}

async fn fetched(client: &Client, fetch: &Fetch) -> Result<Input, Error> {
    Ok(match fetch {
        Fetch::Statuses => Input::Statuses(client.get_statuses(None).await?),
        Fetch::Wishes => Input::Wishes(client.get_wishes().await?),
        Fetch::Embedding | Fetch::Weights => Input::Embedding(client.get_embedding().await?),
        Fetch::Graph(modality) => {
            let graphs = client.get_graphs(Some(modality)).await?;
            graphs.into_iter().next().map_or_else(|| Input::Unfetched(fetch.clone()), Input::Graph)
        }
        Fetch::Settings => {
            let mut all: BTreeMap<ServiceName, Value> = BTreeMap::new();
            let gets = ServiceName::ALL.map(|service| {
                let client = client.clone();
                tokio::spawn(async move { (service, client.get_settings(service).await) })
            });
            for get in gets {
                // One that does not answer is left out.
                if let Ok((service, Ok(settings))) = get.await {
                    all.insert(service, settings);
                }
            }
            Input::Settings(all)
        }
    })
}

#[cfg(test)]
mod tests {
    use muster_model::id::FleetId;
    use serde_json::json;

    use super::*;

    #[test]
    fn only_what_was_not_done_counts_as_refused() {
        let service = ServiceName::Clusterer;
        let reason = || "because".to_owned();
        let unanswered = || Error::Unanswered {
            key: "command/clusterer/kim/1".to_owned(),
            fleet: FleetId::new("alpha").unwrap(),
        };
        let not_applied = |left| Error::NotApplied { reason: Box::new(unanswered()), left };
        let Value::Object(changed) = json!({"teams": 3}) else { panic!("it is an object") };
        for (error, kind) in [
            (Error::Refused { service, reason: reason() }, ProblemKind::Refused),
            (Error::Closed, ProblemKind::Refused),
            (not_applied(Vec::new()), ProblemKind::Refused),
            (Error::Unavailable { service, reason: reason() }, ProblemKind::Unavailable),
            (Error::Unstored { service, reason: reason() }, ProblemKind::Unstored),
            (unanswered(), ProblemKind::Unknown),
            (Error::Bus { reason: reason() }, ProblemKind::Unknown),
            (not_applied(vec![AppliedPart::Settings { service, changed }]), ProblemKind::Unknown),
        ] {
            assert_eq!(problem(&error), Problem { kind, reason: error.to_string() });
        }
    }
}
