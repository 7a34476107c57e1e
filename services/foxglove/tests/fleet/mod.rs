//! Fleets for tests and benchmarks: a grid of robots, divided by their numbers.

use std::sync::Arc;

use muster_model::graph::{GraphDelta, GraphRow};
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, Modality, RobotId, TeamId};
use muster_model::remembered::RememberedTeams;
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::teams::{Member, Team, Teams};
use muster_model::time::Tick;

/// Metres between neighbours of the grid.
const APART_M: f64 = 3.0;

/// Links of each robot.
const LINKS: u32 = 6;

pub(crate) fn header(term: u64, epoch: u64) -> Header {
    Header {
        fleet: FleetId::new("grid").unwrap(),
        revision: Revision { term, epoch },
        oldest: None,
        newest: None,
        stages: Vec::new(),
    }
}

pub(crate) fn robot(node: u32) -> RobotId {
    RobotId::new(format!("r{node:05}")).unwrap()
}

/// A robot of the grid.
pub(crate) fn entry(node: u32, moved: f64) -> RosterEntry {
    RosterEntry {
        node,
        robot: robot(node),
        presence: Presence::Active,
        position: Some([
            APART_M * f64::from(node / 100) + moved,
            APART_M * f64::from(node % 100),
            0.5,
        ]),
        heading: Some(0.5),
        frame: Some("map".to_owned()),
        superior: None,
        role: None,
        skills: Vec::new(),
        last_seen: Tick(0),
    }
}

/// A roster whose robots have moved with its epoch.
pub(crate) fn roster(robots: u32, epoch: u64) -> Roster {
    Roster {
        header: header(1, epoch),
        robots: (0..robots).map(|node| entry(node, epoch as f64 * 0.1)).collect(),
        graphs: vec![(Modality::spatial(), Revision { term: 1, epoch: 1 })],
    }
}

/// Teams of neighbours, of the same size.
pub(crate) fn teams(robots: u32, count: u32) -> Arc<Teams> {
    let team = |number: u32| {
        let each = robots / count;
        let member = |node| Member { robot: robot(node), margin: 0.5 };
        Team {
            id: TeamId::new(format!("t{}", number + 1)).unwrap(),
            members: (number * each..(number + 1) * each).map(member).collect(),
            leader: robot(number * each),
            centroid: Vec::new(),
        }
    };
    Arc::new(Teams {
        header: header(1, 1),
        embedding: Revision { term: 1, epoch: 1 },
        requested: count,
        considered: Vec::new(),
        teams: (0..count).map(team).collect(),
        unassigned: Vec::new(),
        stale: Vec::new(),
        inertia: 0.0,
        changes: Vec::new(),
        next_team: u64::from(count) + 1,
        limited: None,
        needs: Vec::new(),
        provisional: Vec::new(),
        held: Vec::new(),
        remembered: RememberedTeams::default(),
    })
}

/// Links of each robot with the next ones, of many weights.
pub(crate) fn graph(robots: u32, term: u64) -> Arc<GraphDelta> {
    let row = |source: u32| {
        let near = (1..=LINKS).map(|step| (source + step) % robots);
        let weight = |to: u32| 0.1 + f64::from((source * 7 + to) % 97) / 100.0;
        let mut edges: Vec<(u32, f64)> = near.map(|to| (to, weight(to))).collect();
        edges.sort_unstable_by_key(|(to, _)| *to);
        GraphRow { source, edges }
    };
    Arc::new(GraphDelta {
        header: header(term, 1),
        modality: Modality::spatial(),
        base: None,
        nodes_added: (0..robots).map(|node| (node, robot(node))).collect(),
        nodes_removed: Vec::new(),
        rows: (0..robots).map(row).collect(),
    })
}
