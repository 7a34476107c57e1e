//! One weighted directed graph per modality, as deltas and as the replica that follows them.
//!
//! `ingest` gives every robot a node number that stays its own for a whole term. A delta names the
//! nodes that came and went, and holds each row (the edges that leave one node) that changed, whole.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::header::{Header, Revision};
use crate::id::{Modality, RobotId};
use crate::limits::MAX_WEIGHT;

/// Number of a robot within the graphs of one term of `ingest`.
pub type Node = u32;

/// All edges that leave one node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GraphRow {
    /// Where the edges start.
    pub source: Node,
    /// Target and weight of each edge, ordered by target; empty if no edge is left.
    pub edges: Vec<(Node, f64)>,
}

/// How a graph came from its previous revision to this one; or the whole of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GraphDelta {
    /// The head of the message; its revision is the one after the delta.
    pub header: Header,
    /// Which relation this is.
    pub modality: Modality,
    /// The revision that the delta starts from; none for a snapshot, which starts from nothing.
    pub base: Option<Revision>,
    /// Robots that came, with their nodes.
    pub nodes_added: Vec<(Node, RobotId)>,
    /// Nodes that went; every edge to or from them goes as well.
    pub nodes_removed: Vec<Node>,
    /// The rows that changed.
    pub rows: Vec<GraphRow>,
}

/// Why a delta cannot be applied.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum GraphError {
    /// The delta starts from a revision that is not the replica's: fetch a snapshot.
    #[error("the delta starts from {base:?}, but the graph is at {have:?}")]
    Gap {
        /// Where the delta starts.
        base: Revision,
        /// Where the replica is.
        have: Revision,
    },
    /// The delta is not newer than the replica.
    #[error("the graph is already at {0:?}")]
    Old(Revision),
    /// The delta contradicts itself or the replica.
    #[error("the delta is not consistent: {0}")]
    Inconsistent(&'static str),
}

/// A graph that follows the deltas of one modality.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GraphReplica {
    revision: Revision,
    nodes: BTreeMap<Node, RobotId>,
    rows: BTreeMap<Node, Vec<(Node, f64)>>,
}

impl GraphReplica {
    /// The revision that the replica is at; zero before the first delta.
    #[must_use]
    pub fn revision(&self) -> Revision {
        self.revision
    }

    /// The robots, by node.
    #[must_use]
    pub fn nodes(&self) -> &BTreeMap<Node, RobotId> {
        &self.nodes
    }

    /// The rows that have edges, by source.
    #[must_use]
    pub fn rows(&self) -> &BTreeMap<Node, Vec<(Node, f64)>> {
        &self.rows
    }

    /// How many edges there are.
    #[must_use]
    pub fn edge_count(&self) -> usize {
        self.rows.values().map(Vec::len).sum()
    }

    /// Goes on to the delta's revision, or stays as it was.
    ///
    /// # Errors
    /// [`GraphError::Gap`] if a snapshot must be fetched first, [`GraphError::Old`] if there is
    /// nothing to do, [`GraphError::Inconsistent`] if the delta is to be refused.
    pub fn apply(&mut self, delta: &GraphDelta) -> Result<(), GraphError> {
        let target = delta.header.revision;
        if target <= self.revision {
            return Err(GraphError::Old(self.revision));
        }
        match delta.base {
            Some(base) if base != self.revision => {
                return Err(GraphError::Gap { base, have: self.revision });
            }
            Some(_) => self.check(delta, false)?,
            None => {
                self.check(delta, true)?;
                self.nodes.clear();
                self.rows.clear();
            }
        }
        for node in &delta.nodes_removed {
            self.nodes.remove(node);
            self.rows.remove(node);
        }
        if !delta.nodes_removed.is_empty() {
            let nodes = &self.nodes;
            self.rows.retain(|_, edges| {
                edges.retain(|(target, _)| nodes.contains_key(target));
                !edges.is_empty()
            });
        }
        self.nodes.extend(delta.nodes_added.iter().cloned());
        for row in &delta.rows {
            if row.edges.is_empty() {
                self.rows.remove(&row.source);
            } else {
                self.rows.insert(row.source, row.edges.clone());
            }
        }
        self.revision = target;
        Ok(())
    }

    /// The whole graph as a delta from nothing. `header` must carry the replica's revision.
    #[must_use]
    pub fn snapshot(&self, header: Header, modality: Modality) -> GraphDelta {
        GraphDelta {
            header: Header { revision: self.revision, ..header },
            modality,
            base: None,
            nodes_added: self.nodes.iter().map(|(node, robot)| (*node, robot.clone())).collect(),
            nodes_removed: Vec::new(),
            rows: self
                .rows
                .iter()
                .map(|(source, edges)| GraphRow { source: *source, edges: edges.clone() })
                .collect(),
        }
    }

    /// Everything is checked before anything is changed, so that a bad delta loses nothing.
    fn check(&self, delta: &GraphDelta, from_nothing: bool) -> Result<(), GraphError> {
        const fn wrong(what: &'static str) -> Result<(), GraphError> {
            Err(GraphError::Inconsistent(what))
        }
        let mut added = BTreeMap::new();
        for (node, robot) in &delta.nodes_added {
            let known = !from_nothing && self.nodes.contains_key(node);
            if known || added.insert(*node, robot).is_some() {
                return wrong("a node is added that is there already");
            }
        }
        let mut removed = std::collections::BTreeSet::new();
        for node in &delta.nodes_removed {
            if from_nothing || !self.nodes.contains_key(node) || !removed.insert(*node) {
                return wrong("a node is removed that is not there");
            }
        }
        if !added.is_empty() {
            let staying =
                self.nodes.iter().filter(|(node, _)| !from_nothing && !removed.contains(*node));
            let mut robots = std::collections::BTreeSet::new();
            if !staying
                .map(|(_, robot)| robot)
                .chain(added.values().copied())
                .all(|r| robots.insert(r))
            {
                return wrong("a robot has two nodes");
            }
        }
        // Every edge of a large graph asks for its target many times a second: one array that is searched
        // by halves is several times faster than trees.
        let staying = self.nodes.keys().filter(|node| !from_nothing && !removed.contains(*node));
        let mut nodes: Vec<Node> = staying.chain(added.keys()).copied().collect();
        nodes.sort_unstable();
        let exists = |node: &Node| nodes.binary_search(node).is_ok();
        let mut sources: Vec<Node> = delta.rows.iter().map(|row| row.source).collect();
        sources.sort_unstable();
        if !sources.is_sorted_by(|left, right| left < right) {
            return wrong("a row stands twice");
        }
        for row in &delta.rows {
            if !exists(&row.source) {
                return wrong("a row starts at an unknown node");
            }
            if !row.edges.is_sorted_by(|left, right| left.0 < right.0) {
                return wrong("a row is not ordered by target");
            }
            if !row.edges.iter().all(|(target, _)| exists(target)) {
                return wrong("an edge ends at an unknown node");
            }
            if !row.edges.iter().all(|(_, weight)| *weight > 0.0 && *weight <= MAX_WEIGHT) {
                return wrong("a weight is not a positive number within its limit");
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::FleetId;

    fn revision(term: u64, epoch: u64) -> Revision {
        Revision { term, epoch }
    }

    fn delta(base: Option<Revision>, to: Revision) -> GraphDelta {
        GraphDelta {
            header: Header {
                fleet: FleetId::new("f").unwrap(),
                revision: to,
                oldest: None,
                newest: None,
                stages: Vec::new(),
            },
            modality: Modality::spatial(),
            base,
            nodes_added: Vec::new(),
            nodes_removed: Vec::new(),
            rows: Vec::new(),
        }
    }

    fn three_robots() -> GraphReplica {
        let mut graph = GraphReplica::default();
        let mut first = delta(None, revision(1, 1));
        first.nodes_added =
            (0..3).map(|node| (node, RobotId::new(format!("r{node}")).unwrap())).collect();
        first.rows = vec![
            GraphRow { source: 0, edges: vec![(1, 0.5), (2, 0.25)] },
            GraphRow { source: 1, edges: vec![(0, 1.0)] },
        ];
        graph.apply(&first).unwrap();
        graph
    }

    #[test]
    fn deltas_lead_from_revision_to_revision() {
        let mut graph = three_robots();
        let mut second = delta(Some(revision(1, 1)), revision(1, 2));
        second.rows = vec![GraphRow { source: 0, edges: Vec::new() }];
        graph.apply(&second).unwrap();
        assert_eq!(graph.edge_count(), 1);
        assert_eq!(graph.apply(&second), Err(GraphError::Old(revision(1, 2))));
        let late = delta(Some(revision(1, 4)), revision(1, 5));
        assert!(matches!(graph.apply(&late), Err(GraphError::Gap { .. })));
    }

    #[test]
    fn a_node_that_goes_takes_its_edges_along() {
        let mut graph = three_robots();
        let mut second = delta(Some(revision(1, 1)), revision(1, 2));
        second.nodes_removed = vec![0];
        graph.apply(&second).unwrap();
        assert_eq!((graph.nodes().len(), graph.edge_count()), (2, 0));
    }

    #[test]
    fn a_snapshot_leads_a_new_replica_to_the_same_graph() {
        let graph = three_robots();
        let header = delta(None, graph.revision()).header;
        let mut copy = GraphReplica::default();
        copy.apply(&graph.snapshot(header, Modality::spatial())).unwrap();
        assert_eq!(copy, graph);
    }

    #[test]
    fn a_contradictory_delta_changes_nothing() {
        let spoil: [fn(&mut GraphDelta); 8] = [
            |d| d.nodes_added = vec![(8, RobotId::new("r1").unwrap())],
            |d| d.nodes_added = vec![(1, RobotId::new("again").unwrap())],
            |d| d.nodes_removed = vec![9],
            |d| d.rows = vec![GraphRow { source: 9, edges: vec![] }],
            |d| d.rows = vec![GraphRow { source: 0, edges: vec![(9, 1.0)] }],
            |d| d.rows = vec![GraphRow { source: 0, edges: vec![(2, 1.0), (1, 1.0)] }],
            |d| d.rows = vec![GraphRow { source: 0, edges: vec![(1, f64::NAN)] }],
            |d| d.rows = vec![GraphRow { source: 0, edges: vec![(1, -1.0)] }],
        ];
        for change in spoil {
            let mut graph = three_robots();
            let mut bad = delta(Some(revision(1, 1)), revision(1, 2));
            change(&mut bad);
            assert!(matches!(graph.apply(&bad), Err(GraphError::Inconsistent(_))), "{bad:?}");
            assert_eq!(graph, three_robots());
        }
    }
}
