//! Deltas of a graph, one after the other, against a plain model of what they mean.

use std::collections::BTreeMap;

use muster_model::graph::{GraphDelta, GraphReplica};
use muster_model::id::{Modality, RobotId};
use muster_model::limits::MAX_WEIGHT;

use crate::draw::{Author, Draw};
use crate::packets::{NOW, may_hold};
use crate::{Outcome, allocation};

/// Bytes that choose deltas.
pub(crate) fn replica(data: &[u8]) -> Outcome {
    allocation::at_most(may_hold(data.len()), "a graph", || follow(data))
}

/// What a graph is: nodes with their robots, and edges with their weights.
#[derive(Debug, Default, PartialEq)]
struct Model {
    nodes: BTreeMap<u32, RobotId>,
    edges: BTreeMap<(u32, u32), f64>,
}

impl Model {
    fn apply(&mut self, delta: &GraphDelta) {
        if delta.base.is_none() {
            *self = Self::default();
        }
        self.nodes.retain(|node, _| !delta.nodes_removed.contains(node));
        self.nodes.extend(delta.nodes_added.iter().cloned());
        let gone = |node: &u32| delta.nodes_removed.contains(node);
        self.edges.retain(|(from, to), _| {
            !gone(from) && !gone(to) && delta.rows.iter().all(|row| row.source != *from)
        });
        for row in &delta.rows {
            self.edges.extend(row.edges.iter().map(|(to, weight)| ((row.source, *to), *weight)));
        }
    }

    fn of(replica: &GraphReplica) -> Self {
        let edges = replica.rows().iter().flat_map(|(from, row)| {
            assert!(!row.is_empty(), "a row without edges is kept");
            row.iter().map(move |(to, weight)| ((*from, *to), *weight))
        });
        Self { nodes: replica.nodes().clone(), edges: edges.collect() }
    }
}

fn follow(data: &[u8]) -> Outcome {
    let mut draw = Draw(data);
    let mut author = Author::default();
    let mut replica = GraphReplica::default();
    let mut model = Model::default();
    let mut outcome = Outcome::Refused;
    while !draw.is_empty() {
        let delta = author.graph(NOW, &mut draw);
        let before = replica.clone();
        match replica.apply(&delta) {
            Ok(()) => {
                outcome = Outcome::Accepted;
                model.apply(&delta);
                assert!(before.revision() < replica.revision());
            }
            Err(_) => assert_eq!(replica, before, "a refused delta has changed something"),
        }
        let known = Model::of(&replica);
        assert_eq!(known, model);
        assert_eq!(known.edges.len(), replica.edge_count());
        for ((from, to), weight) in &known.edges {
            assert!(known.nodes.contains_key(from) && known.nodes.contains_key(to));
            assert!(*weight > 0.0 && *weight <= MAX_WEIGHT, "an edge weighs {weight}");
        }
        let mut robots: Vec<_> = known.nodes.values().collect();
        robots.sort_unstable();
        robots.dedup();
        assert_eq!(robots.len(), known.nodes.len(), "a robot has two nodes");
        let snapshot = replica.snapshot(delta.header, Modality::spatial());
        let mut copy = GraphReplica::default();
        if copy.apply(&snapshot).is_ok() {
            assert_eq!(copy, replica, "a snapshot leads to another graph");
        } else {
            assert_eq!(replica, GraphReplica::default(), "a snapshot is refused");
        }
    }
    outcome
}
