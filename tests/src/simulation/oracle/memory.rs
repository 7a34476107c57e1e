//! The memory use of a service stays within what settings and limits allow.

use muster_model::id::ServiceName;
use muster_model::limits::{
    MAX_DECLARED_MODALITIES, MAX_DEPARTED_ROBOTS, MAX_LINKS, MAX_RELATION_EDGES, MAX_ROBOTS,
};
use muster_model::proposal::MAX_OPEN_PROPOSALS;
use muster_service::MemoryUse;

use super::super::clock::{Micros, SECOND};
use super::{Verified, breach};

/// Most senders of refused messages that a service watches.
const OFFENDERS: usize = 256;

/// Most whole messages of each kind that the auditor keeps for divisions that name them.
const MAX_AUDITOR_MESSAGES: usize = 32;

/// Most deltas of each graph that wait in the embedder for a snapshot.
const MAX_WAITING_DELTAS: usize = 64;

/// How long a robot may be remembered after its last report: the clusterer's minute since it left,
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
fn most(service: ServiceName, bounds: Bounds) -> MemoryUse {
    let robots = bounds.max_robots;
    let graphs = MAX_DECLARED_MODALITIES + 3;
    match service {
        ServiceName::Ingest => MemoryUse {
            // Robots that are known, those that left with their token still there, and the last that left.
            robots: 2 * robots + MAX_DEPARTED_ROBOTS,
            edges: robots * (MAX_LINKS + MAX_DECLARED_MODALITIES * MAX_RELATION_EDGES)
                + graphs * robots * robots,
            messages: 1,
            offenders: OFFENDERS,
        },
        ServiceName::Embedder => MemoryUse {
            // The newest roster and graphs, those of the newest frame, and deltas that wait.
            robots: 2 * robots,
            edges: (2 + MAX_WAITING_DELTAS) * graphs * robots * robots,
            messages: 3,
            offenders: OFFENDERS,
        },
        ServiceName::Clusterer => MemoryUse {
            // The last team of a robot that left, and the robots of teams that ended. A robot is in
            // as many of those as it was moved within the minute of memory. Each of the two has the
            // limit of a fleet, whatever happens. And the robots that are kept in their team for now.
            robots: bounds.names.min(MAX_ROBOTS) + bounds.names.pow(2).min(MAX_ROBOTS) + robots,
            edges: 0,
            // The division as it was found is the ninth, two are on disk or on their way, and one has all wishes.
            messages: 12,
            offenders: OFFENDERS,
        },
        ServiceName::Auditor => MemoryUse {
            // The rosters, the robots that have changed their team, and the rosters that graphs are followed by.
            robots: (MAX_AUDITOR_MESSAGES + 3) * robots,
            // As in the embedder.
            edges: (2 + MAX_WAITING_DELTAS) * graphs * robots * robots,
            // And what historians say of themselves.
            messages: 2 * MAX_AUDITOR_MESSAGES + 6 + 16,
            offenders: OFFENDERS,
        },
        ServiceName::Historian => MemoryUse {
            // The newest roster and division, the tokens, and positions as they were recorded.
            robots: 5 * robots,
            edges: 0,
            // The settings of the services, and gets that wait.
            messages: 4 + 64,
            offenders: OFFENDERS,
        },
        ServiceName::Planner => MemoryUse {
            // The rosters that graphs are followed by, and as in the clusterer the robots that left a team.
            robots: 2 * robots + bounds.names.min(MAX_ROBOTS) + bounds.names.pow(2).min(MAX_ROBOTS),
            // As in the embedder.
            edges: (2 + MAX_WAITING_DELTAS) * graphs * robots * robots,
            // The newest vectors, division and rosters, the proposals, and gets that wait.
            messages: 4 + MAX_OPEN_PROPOSALS + 64,
            offenders: OFFENDERS,
        },
    }
}

/// Compares the memory use of a service with its limit.
pub(crate) fn check_memory_use(service: ServiceName, held: MemoryUse, bounds: Bounds) -> Verified {
    let most = most(service, bounds);
    if held.robots > most.robots
        || held.edges > most.edges
        || held.messages > most.messages
        || held.offenders > most.offenders
    {
        return breach(
            "the memory use of a service is bounded",
            format!("{service} uses {held:?}, and may use at most {most:?}"),
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
        for service in ServiceName::PIPELINE {
            let full = most(service, bounds);
            assert_eq!(check_memory_use(service, full, bounds), Ok(()));
            for more in [
                MemoryUse { robots: full.robots + 1, ..full },
                MemoryUse { edges: full.edges + 1, ..full },
                MemoryUse { messages: full.messages + 1, ..full },
                MemoryUse { offenders: full.offenders + 1, ..full },
            ] {
                let broken = check_memory_use(service, more, bounds).unwrap_err();
                assert_eq!(broken.promise, "the memory use of a service is bounded", "{service}");
            }
        }
    }
}
