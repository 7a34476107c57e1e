//! What a service declares on the bus: subscriptions, keys that it serves, and liveliness tokens.

use std::collections::HashMap;
use std::sync::Arc;

use muster_service::inbox::Parcel;
use muster_service::{Authority, Core, ServedKey, Wiring};
use muster_wire::Key;
use tokio::sync::{mpsc, watch};
use tracing::Instrument as _;

use crate::bus::{Bus, IncomingQuery, Token};
use crate::inbox::SharedInbox;
use crate::observe::Observer;

/// Most tokens that wait to be declared or withdrawn.
const MAX_WAITING_TOKENS: usize = 64;

/// Declares what comes in and what is served. The returned sender is for whether this instance leads.
pub(crate) async fn declare<C: Core>(
    bus: &Bus,
    inbox: &Arc<SharedInbox>,
    gets: mpsc::Sender<IncomingQuery>,
    observer: &Observer,
) -> anyhow::Result<watch::Sender<bool>> {
    let wiring = Wiring::of::<C>();
    let leads = serve(bus.clone(), wiring.served, gets).await?;
    let push = |observer: &Observer| {
        let (inbox, observer) = (Arc::clone(inbox), observer.clone());
        move |parcel: Parcel| {
            observer.arrived(parcel.size());
            inbox.push(parcel);
        }
    };
    for subscription in wiring.subscriptions {
        let (push, space) = (push(observer), bus.space().clone());
        let pattern = subscription.pattern.clone();
        let receive = move |packet| {
            if let Some(parcel) = Parcel::new(&space, packet, &pattern, subscription.delivery) {
                push(parcel);
            }
        };
        bus.subscribe(&subscription.pattern, receive).await?;
    }
    for pattern in &wiring.tokens {
        let (push, space) = (push(observer), bus.space().clone());
        bus.subscribe_tokens(pattern, move |packet| push(Parcel::token(&space, packet))).await?;
    }
    Ok(leads)
}

/// Serves keys until the returned sender is gone. The leader's answer suffices for the service's own
/// output, but a get must not end at a standby, so that the keys are declared again whenever
/// leadership comes or goes.
async fn serve(
    bus: Bus,
    keys: Vec<ServedKey>,
    gets: mpsc::Sender<IncomingQuery>,
) -> anyhow::Result<watch::Sender<bool>> {
    let (leads, mut changed) = watch::channel(false);
    let mut served = Vec::new();
    for key in &keys {
        served.push(bus.serve(&key.pattern, false, gets.clone()).await?);
    }
    let following = async move {
        while changed.changed().await.is_ok() {
            let leads = *changed.borrow_and_update();
            let own =
                keys.iter().zip(&mut served).filter(|(key, _)| key.authority == Authority::Own);
            for (key, served) in own {
                // The new one first, so that the key is never unserved.
                match bus.serve(&key.pattern, leads, gets.clone()).await {
                    Ok(new) => drop(std::mem::replace(served, new)),
                    Err(error) => tracing::error!("{error:#}"),
                }
            }
        }
    };
    tokio::spawn(following.in_current_span());
    Ok(leads)
}

/// What becomes of a liveliness token.
pub(crate) enum TokenChange {
    Declare(Key),
    Withdraw(Key),
}

/// Declares and withdraws the tokens that a core asks for, in order, until the returned sender is
/// gone.
pub(crate) fn declare_tokens(bus: Bus) -> mpsc::Sender<TokenChange> {
    let (sender, mut changes) = mpsc::channel(MAX_WAITING_TOKENS);
    let declaring = async move {
        let mut tokens: HashMap<Key, Token> = HashMap::new();
        while let Some(change) = changes.recv().await {
            match change {
                TokenChange::Declare(key) => match bus.declare_token(&key).await {
                    Ok(token) => drop(tokens.insert(key, token)),
                    Err(error) => tracing::error!("{error:#}"),
                },
                TokenChange::Withdraw(key) => {
                    if let Some(token) = tokens.remove(&key)
                        && let Err(error) = token.withdraw().await
                    {
                        tracing::debug!("cannot withdraw {key}: {error:#}");
                    }
                }
            }
        }
    };
    tokio::spawn(declaring.in_current_span());
    sender
}
