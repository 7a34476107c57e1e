//! What a core holds stays within what settings and limits allow.

use muster_machine::Footprint;
use muster_model::id::ServiceName;
use muster_model::limits::{MAX_DECLARED_MODALITIES, MAX_LINKS, MAX_RELATION_EDGES, MAX_ROBOTS};

use super::super::clock::{Micros, SECOND};
use super::{Verdict, breach};

/// Most senders of refused messages that a service watches.
const OFFENDERS: usize = 256;

/// Most whole messages of each kind that the auditor keeps for divisions that name them.
const HISTORY: usize = 32;

/// How long a robot may be remembered after it was last heard of: the clusterer's minute since it left,
/// the longest time until it is taken for gone, and some more for what was under way.
pub(crate) const MEMORY: Micros = 90 * SECOND;

/// What a fleet may be at most.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    /// The largest `max_robots` that was in force.
    pub(crate) max_robots: usize,
    /// How many names of robots were on the bus within [`MEMORY`], good and forged.
    pub(crate) names: usize,
}

/// What a service may hold.
fn most(service: ServiceName, bounds: Bounds) -> Footprint {
    let robots = bounds.max_robots;
    let graphs = MAX_DECLARED_MODALITIES + 3;
    match service {
        ServiceName::Ingest => Footprint {
            // Robots that are known, and those that left with their token still there.
            robots: 2 * robots,
            edges: robots * (MAX_LINKS + MAX_DECLARED_MODALITIES * MAX_RELATION_EDGES)
                + graphs * robots * robots,
            messages: 1,
            offenders: OFFENDERS,
        },
        ServiceName::Embedder => Footprint {
            // The newest roster and graphs, and those of the newest frame.
            robots: 2 * robots,
            edges: 2 * graphs * robots * robots,
            messages: 3,
            offenders: OFFENDERS,
        },
        ServiceName::Clusterer => Footprint {
            // The last team of a robot that left, and the robots of teams that ended. A robot is in
            // as many of those as it was moved within the minute of memory. Each of the two has the
            // limit of a fleet, whatever happens.
            robots: bounds.names.min(MAX_ROBOTS) + bounds.names.pow(2).min(MAX_ROBOTS),
            edges: 0,
            messages: 7,
            offenders: OFFENDERS,
        },
        ServiceName::Auditor => Footprint {
            robots: HISTORY * robots,
            edges: 0,
            messages: 2 * HISTORY + 3,
            offenders: OFFENDERS,
        },
    }
}

/// Compares what a core holds with what it may hold.
pub(crate) fn check_footprint(service: ServiceName, held: Footprint, bounds: Bounds) -> Verdict {
    let most = most(service, bounds);
    if held.robots > most.robots
        || held.edges > most.edges
        || held.messages > most.messages
        || held.offenders > most.offenders
    {
        return breach(
            "what a service holds is bounded",
            format!("{service} holds {held:?}, which may be at most {most:?}"),
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_too_many_of_anything_is_seen() {
        let bounds = Bounds { max_robots: 5, names: 9 };
        for service in ServiceName::ALL {
            let full = most(service, bounds);
            assert_eq!(check_footprint(service, full, bounds), Ok(()));
            for more in [
                Footprint { robots: full.robots + 1, ..full },
                Footprint { edges: full.edges + 1, ..full },
                Footprint { messages: full.messages + 1, ..full },
                Footprint { offenders: full.offenders + 1, ..full },
            ] {
                assert!(check_footprint(service, more, bounds).is_err(), "{service}");
            }
        }
    }
}
