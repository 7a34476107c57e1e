//! Observations to the rows of graphs, and which rows changed.

use std::collections::{BTreeMap, HashMap};

use muster_model::graph::{GraphRow, Node};
use muster_model::id::RobotId;
use muster_model::limits::MAX_WEIGHT;
use muster_model::observation::Stream;
use muster_model::settings::{ConnectivitySettings, IngestSettings};
use muster_relation::edge::{Edge, EdgeError};
use muster_relation::{connectivity_edges, hierarchy_edges, relation_edges, spatial_edges};

use crate::admission::{Direction, Strength, direction};
use crate::roster::Fleet;

/// The place of each robot in the order of names, which is the index that relations are made with:
/// a graph depends on who is there, not on who came first.
pub(crate) struct Places<'a> {
    by_name: HashMap<&'a RobotId, u32>,
    nodes: Vec<Node>,
}

impl<'a> Places<'a> {
    /// The places of all robots that are known.
    pub(crate) fn new(fleet: &'a Fleet) -> Self {
        Self { by_name: fleet.robots().keys().zip(0..).collect(), nodes: nodes_of(fleet) }
    }

    /// The other ends of edges that are known, with the weights of the edges.
    fn known(
        &self,
        edges: &[(RobotId, Strength)],
        settings: &ConnectivitySettings,
    ) -> Vec<(u32, f64)> {
        let place = |(robot, strength): &(RobotId, Strength)| {
            Some((*self.by_name.get(robot)?, strength.weight(settings)))
        };
        edges.iter().filter_map(place).collect()
    }

    /// The rows of every graph but the spatial one.
    pub(crate) fn rows(
        &self,
        fleet: &Fleet,
        stream: &Stream,
        settings: &IngestSettings,
    ) -> Result<Vec<GraphRow>, EdgeError> {
        let robots = || (0..).zip(fleet.robots().values());
        let reports = || {
            robots().map(|(place, robot)| {
                (place, self.known(robot.edges(stream), &settings.connectivity))
            })
        };
        let edges = match (stream, direction(stream)) {
            (_, Some(Direction::Incoming)) => {
                let reports: Vec<_> = reports().collect();
                connectivity_edges(reports.iter().map(|(place, edges)| (*place, edges.as_slice())))
            }
            (_, Some(Direction::Outgoing)) => {
                relation_edges(reports().flat_map(|(place, edges)| {
                    edges.into_iter().map(move |(to, weight)| (place, to, weight))
                }))
            }
            (Stream::Rank, None) => hierarchy_edges(robots().map(|(place, robot)| {
                let superior = robot.tie.superior.as_ref();
                let known = superior.and_then(|superior| self.by_name.get(superior).copied());
                (place, known, Some(robot.tie.weight))
            })),
            (_, None) => Ok(Vec::new()),
        };
        Ok(rows_of(&edges?, &self.nodes))
    }
}

/// The nodes in the order of names.
fn nodes_of(fleet: &Fleet) -> Vec<Node> {
    fleet.robots().values().map(|robot| robot.node).collect()
}

/// Positions of different frames cannot be compared, and robots of different frames not be related.
pub(crate) fn spatial_rows(fleet: &Fleet, settings: &IngestSettings) -> Vec<GraphRow> {
    let mut frames: BTreeMap<&str, (Vec<Node>, Vec<[f64; 3]>)> = BTreeMap::new();
    for robot in fleet.robots().values() {
        if let Some(pose) = &robot.pose {
            let (nodes, positions) = frames.entry(&pose.frame).or_default();
            nodes.push(robot.node);
            positions.push(pose.position);
        }
    }
    let rows = frames.values().flat_map(|(nodes, positions)| {
        rows_of(&spatial_edges(positions, &settings.spatial), nodes)
    });
    let mut rows: Vec<_> = rows.collect();
    rows.sort_unstable_by_key(|row| row.source);
    rows
}

/// Rows ordered by source, each ordered by target, out of edges between indices, which are ordered
/// by source.
fn rows_of(edges: &[Edge], nodes: &[Node]) -> Vec<GraphRow> {
    let node = |index: u32| nodes.get(index as usize).copied();
    let row = |edges: &[Edge]| {
        let source = node(edges.first()?.0)?;
        let named = edges.iter().filter_map(|(_, target, weight)| {
            (*weight > 0.0).then_some((node(*target)?, weight.min(MAX_WEIGHT)))
        });
        let mut edges: Vec<_> = named.collect();
        edges.sort_unstable_by_key(|(target, _)| *target);
        Some(GraphRow { source, edges })
    };
    let mut rows: Vec<_> =
        edges.chunk_by(|left, right| left.0 == right.0).filter_map(row).collect();
    rows.retain(|row| !row.edges.is_empty());
    rows.sort_unstable_by_key(|row| row.source);
    rows
}

/// The rows that a delta must hold to lead a replica from one graph to another. The replica drops the edges
/// of removed nodes by itself.
pub(crate) fn changed_rows(old: &[GraphRow], new: &[GraphRow], removed: &[Node]) -> Vec<GraphRow> {
    let stays = |node: &Node| removed.binary_search(node).is_err();
    let rest = |row: &GraphRow| -> Vec<(Node, f64)> {
        row.edges.iter().filter(|(target, _)| stays(target)).copied().collect()
    };
    let same = |old: &GraphRow, new: &GraphRow| {
        if removed.is_empty() { old.edges == new.edges } else { rest(old) == new.edges }
    };
    let emptied = |row: &GraphRow| {
        let had_edges = !rest(row).is_empty();
        had_edges.then(|| GraphRow { source: row.source, edges: Vec::new() })
    };
    let mut changed = Vec::new();
    let mut before = old.iter().filter(|row| stays(&row.source)).peekable();
    for row in new {
        while let Some(lost) = before.next_if(|old| old.source < row.source) {
            changed.extend(emptied(lost));
        }
        let old = before.next_if(|old| old.source == row.source);
        if !old.is_some_and(|old| same(old, row)) {
            changed.push(row.clone());
        }
    }
    changed.extend(before.filter_map(emptied));
    changed
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(source: Node, edges: &[(Node, f64)]) -> GraphRow {
        GraphRow { source, edges: edges.to_vec() }
    }

    #[test]
    fn rows_are_ordered_by_node_whatever_the_order_of_names() {
        let edges = [(0, 1, 0.5), (0, 2, 2.0 * MAX_WEIGHT), (2, 0, 0.0), (2, 1, 1.0)];
        let rows = rows_of(&edges, &[9, 7, 3]);
        assert_eq!(rows, [row(3, &[(7, 1.0)]), row(9, &[(3, MAX_WEIGHT), (7, 0.5)])]);
        assert!(rows_of(&[(0, 1, 0.0)], &[9, 7]).is_empty());
    }

    #[test]
    fn only_rows_that_changed_are_published() {
        let old = [row(1, &[(2, 1.0)]), row(2, &[(1, 1.0), (3, 1.0)]), row(4, &[(1, 1.0)])];
        let new = [row(0, &[(1, 1.0)]), row(2, &[(1, 1.0), (3, 1.0)]), row(4, &[(1, 0.5)])];
        let expected = [row(0, &[(1, 1.0)]), row(1, &[]), row(4, &[(1, 0.5)])];
        assert_eq!(changed_rows(&old, &new, &[]), expected);
        assert!(changed_rows(&old, &old, &[]).is_empty());
        assert_eq!(changed_rows(&old[2..], &[], &[]), [row(4, &[])]);
        assert_eq!(changed_rows(&[], &old, &[]), old);
    }

    #[test]
    fn what_goes_with_a_removed_node_is_not_published() {
        let old =
            [row(1, &[(2, 1.0)]), row(2, &[(1, 1.0), (3, 1.0)]), row(3, &[(1, 1.0), (2, 1.0)])];
        // Row 1 goes with node 1; rows 2 and 3 lose their edge to it.
        let rest = [row(2, &[(3, 1.0)]), row(3, &[(2, 1.0)])];
        assert!(changed_rows(&old, &rest, &[1]).is_empty());
        assert_eq!(changed_rows(&old, &rest[..1], &[1]), [row(3, &[])]);
        assert!(changed_rows(&old[..1], &[], &[2]).is_empty());
    }
}
