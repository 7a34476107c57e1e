//! What is wrong with the way to the bus.

use std::time::Duration;

use muster_runtime::bus::handshake::Reach;
use muster_wire::message::quoted;

use super::{Finding, error, warning};
use crate::doctor::Endpoint;

/// Longest lease of a router with which lost robots are noticed within the documented time.
const MAX_LEASE: Duration = Duration::from_secs(4);

/// What is wrong with an endpoint.
pub(in crate::doctor) fn of_endpoint(endpoint: &Endpoint) -> Option<Finding> {
    let name = &endpoint.name;
    let found = match &endpoint.reach {
        Reach::Listens | Reach::Unseen => return None,
        Reach::Zenoh { lease, router: true } if *lease <= MAX_LEASE => return None,
        Reach::Zenoh { lease, router: true } => warning(
            "router_lease",
            format!("the router at {name} announces a lease of {:.0} s", lease.as_secs_f64()),
            "robots and services that lose their link silently are noticed only after that time; run \
             `muster router`, or set transport.link.tx.lease to 2000 in the router's configuration",
        ),
        Reach::Zenoh { router: false, .. } => error(
            "no_router",
            format!("a node of Zenoh answers at {name} that is no router"),
            "peers do not relay for each other: start `muster router` and name it with --connect",
        ),
        Reach::Unknown(problem) => error(
            "no_router",
            format!("the host of {name} is not known: {}", quoted(problem)),
            "check the name in --connect, or write the address as a number",
        ),
        Reach::Refused => error(
            "no_router",
            format!("nothing listens at {name}: the host refuses the connection"),
            "start a router there with `muster router --listen`, or name another with --connect",
        ),
        Reach::Silent => error(
            "no_router",
            format!("the host of {name} does not answer"),
            "check the address, the network and the firewall in between; is the host running?",
        ),
        Reach::Foreign(sent) => {
            let sent = match sent {
                Some(sent) => format!("it sends {sent:?}"),
                None => "it sends nothing that Zenoh would".to_owned(),
            };
            error(
                "no_router",
                format!("something takes connections at {name}, and it is not Zenoh: {sent}"),
                "check the port in --connect: the router listens at another one, usually 7447. If the \
                 router wants certificates, write quic/ or tls/ instead of tcp/",
            )
        }
        Reach::Closed(reason) => error(
            "no_router",
            format!("a node of Zenoh at {name} does not let us in: {}", quoted(reason)),
            "it may want a certificate or a password (--zenoh-config), or be of another version",
        ),
    };
    Some(found.about([name]))
}

/// The session does not open, although something answers.
pub(in crate::doctor) fn session(problem: &anyhow::Error) -> Finding {
    error(
        "no_router",
        format!(
            "a router answers, and the session does not open: {}",
            quoted(&format!("{problem:#}"))
        ),
        "it may want a certificate or a password (--zenoh-config); its log has the reason",
    )
}
