//! What is wrong with the way to the bus.

use std::time::Duration;

use muster_runtime::bus::handshake::Reach;
use muster_wire::message::quoted;

use super::ros::ROS_LEASE;
use super::{Finding, error, warning};
use crate::doctor::Endpoint;

/// Longest lease of a router with which lost robots are noticed within the documented time.
const MAX_LEASE: Duration = Duration::from_secs(4);

/// What is wrong with an endpoint, where there are programs of ROS or not.
pub(in crate::doctor) fn of_endpoint(endpoint: &Endpoint, has_ros: bool) -> Option<Finding> {
    let name = &endpoint.name;
    let found = match &endpoint.reach {
        Reach::Listens | Reach::Unseen => return None,
        Reach::Zenoh { lease, router: true } if *lease <= MAX_LEASE => return None,
        Reach::Zenoh { lease, router: true } if has_ros && *lease >= ROS_LEASE => warning(
            "router_lease",
            format!(
                "the router at {name} announces a lease of {:.0} s, as that of ROS does, so that many programs of ROS can \
                 start at once",
                lease.as_secs_f64()
            ),
            "robots of ROS need no change: muster-ros2 goes by the age of their data. Services and other robots that lose their \
             link silently are noticed only after that time: run `muster router --ros` in its place, or set \
             transport.link.tx.lease to 2000 in the router's configuration",
        ),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lease_of_ros_is_explained_where_there_is_ros() {
        let remedy = |lease, has_ros| {
            let reach = Reach::Zenoh { lease: Duration::from_secs(lease), router: true };
            let endpoint = Endpoint { name: "tcp/a:1".to_owned(), reach };
            of_endpoint(&endpoint, has_ros).map(|finding| (finding.id, finding.remedy))
        };
        assert_eq!(remedy(2, true), None);
        for (lease, has_ros, explains) in [(60, true, true), (60, false, false), (10, true, false)]
        {
            let (id, remedy) = remedy(lease, has_ros).unwrap();
            assert_eq!((id, remedy.contains("muster-ros2")), ("router_lease", explains), "{lease}");
        }
    }
}
