//! The largest content of services fits a message.

use crate::samples;
use std::sync::Arc;

use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::graph::{GraphDelta, GraphRow};
use muster_model::id::{Modality, RobotId, TeamId};
use muster_model::limits::{MAX_GRAPH_EDGES, MAX_ID_LENGTH, MAX_ROBOTS};
use muster_model::settings::MAX_DIMENSION;
use muster_model::teams::{Member, TeamChange, Teams};
use muster_wire::envelope::MAX_SERVICE_PAYLOAD;
use muster_wire::{Format, Message};

/// So much smaller than the largest are the messages that are made here.
const SCALE: usize = 1000;

fn fits(message: &Message) {
    let out = message.encode(message.keys().0, Format::Binary, samples::NOW).unwrap();
    let size = out.payload.len() * SCALE;
    assert!(size <= MAX_SERVICE_PAYLOAD, "{} has {size} bytes", out.key);
}

/// Robots with the longest names.
fn robots(count: usize) -> Vec<RobotId> {
    let name = |robot| RobotId::new(format!("{robot:0width$}", width = MAX_ID_LENGTH)).unwrap();
    (0..count / SCALE).map(name).collect()
}

#[test]
fn the_largest_graph_fits_a_message() {
    let nodes = || (0..u32::MAX).rev();
    let robots = robots(MAX_ROBOTS);
    let edges = usize::try_from(MAX_GRAPH_EDGES).unwrap() / SCALE / robots.len();
    let row = |source| GraphRow { source, edges: nodes().zip(vec![0.1; edges]).collect() };
    fits(&Message::Graph(Arc::new(GraphDelta {
        header: samples::header(1),
        modality: Modality::connectivity(),
        base: None,
        rows: nodes().take(robots.len()).map(row).collect(),
        nodes_added: nodes().zip(robots).collect(),
        nodes_removed: Vec::new(),
    })));
}

fn embedding() -> Embedding {
    let sample = samples::all().into_iter().find_map(|(_, message)| match message {
        Message::Embedding(embedding) => Some(embedding),
        _ => None,
    });
    (*sample.unwrap()).clone()
}

/// Readers allocate by the dimension.
#[test]
fn an_embedding_without_robots_has_no_dimension_of_any_size() {
    let mut none = embedding();
    none.robots.clear();
    none.values.clear();
    none.without_embedding.clear();
    none.provisional.clear();
    none.centrality.clear();
    for (dimension, is_right) in [(MAX_DIMENSION, true), (MAX_DIMENSION + 1, false)] {
        none.dimension = dimension;
        let checked = Checked::new(none.clone());
        assert_eq!(checked.is_ok(), is_right, "{dimension}: {checked:?}");
    }
}

#[test]
fn an_embedding_of_thirty_thousand_robots_fits_a_message() {
    let mut embedding = embedding();
    embedding.robots = robots(30_000);
    embedding.without_embedding = vec![false; embedding.robots.len()];
    embedding.dimension = MAX_DIMENSION;
    embedding.values = vec![0.1; embedding.robots.len() * MAX_DIMENSION as usize];
    embedding.graphs = Vec::new();
    embedding.quality.singular_values = Vec::new();
    fits(&Message::Embedding(Checked::new_unchecked(embedding)));
}

/// Each robot is in a team, is stale and has just moved, and as many have left. One that has moved waits for no
/// move.
#[test]
fn the_largest_division_fits_a_message() {
    let sample = samples::all().into_iter().find_map(|(_, message)| match message {
        Message::Teams { teams, .. } => Some(teams),
        _ => None,
    });
    let mut teams = Teams::clone(&sample.unwrap());
    let robots = robots(MAX_ROBOTS);
    let team = || TeamId::new("t".repeat(MAX_ID_LENGTH)).unwrap();
    let with_team = || robots.iter().map(|robot| (robot.clone(), team()));
    teams.teams.truncate(1);
    let member = |robot: &RobotId| Member { robot: robot.clone(), margin: 0.5 };
    teams.teams[0].members = robots.iter().map(member).collect();
    teams.unassigned = Vec::new();
    teams.stale.clone_from(&robots);
    teams.provisional.clone_from(&robots);
    let moved = |(robot, to)| TeamChange::Moved { robot, from: Some(team()), to: Some(to) };
    teams.changes = with_team().map(moved).collect();
    teams.held = Vec::new();
    teams.remembered.last = with_team().collect();
    teams.remembered.ended = vec![(team(), robots.clone())];
    // What there is once does not grow with the fleet.
    teams.considered = Vec::new();
    teams.limited = None;
    teams.needs = Vec::new();
    teams.teams[0].centroid = Vec::new();
    fits(&Message::Teams { teams: Checked::new_unchecked(teams), mirror: false });
}
