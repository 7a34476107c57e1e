//! Deltas of one graph that wait for what comes before them.
//!
//! A delta that was lost is replaced by a fetched snapshot. While the snapshot is under way further deltas
//! arrive, and on a busy host or link always some: without them the graph would have a gap again as soon as the
//! snapshot is there, and again after the next one, for as long as the fleet moves.

use std::collections::VecDeque;
use std::sync::Arc;

use muster_model::graph::GraphDelta;
use muster_model::header::Revision;

/// Most deltas that wait: more than six seconds of frames, in which a snapshot is asked for several times.
const MAX_DELTAS: usize = 64;

/// Most edges of the deltas that wait, for deltas that hold a whole large fleet: some 64 MiB.
const MAX_EDGES: usize = 4_000_000;

/// Deltas that start from another revision than the graph has, as they came.
#[derive(Debug, Default)]
pub(crate) struct WaitingDeltas {
    deltas: VecDeque<Arc<GraphDelta>>,
    edges: usize,
}

impl WaitingDeltas {
    /// A delta waits from now on. Where too many wait, those that came first are dropped: the newest follow a
    /// snapshot that is still to be made.
    pub(crate) fn add(&mut self, delta: &Arc<GraphDelta>) {
        let revision = delta.header.revision;
        if self.deltas.iter().any(|other| other.header.revision == revision) {
            return;
        }
        self.edges += edges(delta);
        self.deltas.push_back(Arc::clone(delta));
        while self.deltas.len() > MAX_DELTAS || (self.edges > MAX_EDGES && self.deltas.len() > 1) {
            self.edges -= self.deltas.pop_front().map_or(0, |first| edges(&first));
        }
    }

    /// The delta that starts from the revision of the graph; those that do not lead beyond it are dropped.
    pub(crate) fn next(&mut self, at: Revision) -> Option<Arc<GraphDelta>> {
        self.deltas.retain(|delta| delta.header.revision > at);
        let place = self.deltas.iter().position(|delta| delta.base == Some(at));
        let next = place.and_then(|place| self.deltas.remove(place));
        self.edges = self.deltas.iter().map(|delta| edges(delta)).sum();
        next
    }

    /// Whether none waits.
    pub(crate) fn is_empty(&self) -> bool {
        self.deltas.is_empty()
    }

    /// How many edges they hold.
    pub(crate) fn edge_count(&self) -> usize {
        self.edges
    }
}

fn edges(delta: &GraphDelta) -> usize {
    delta.rows.iter().map(|row| row.edges.len()).sum()
}

#[cfg(test)]
mod tests {
    use muster_model::graph::GraphRow;
    use muster_model::header::Header;
    use muster_model::id::{FleetId, Modality};

    use super::*;

    fn at(epoch: u64) -> Revision {
        Revision { term: 1, epoch }
    }

    fn delta(epoch: u64, edges: u32) -> Arc<GraphDelta> {
        Arc::new(GraphDelta {
            header: Header {
                fleet: FleetId::new("f").unwrap(),
                revision: at(epoch),
                oldest: None,
                newest: None,
                stages: Vec::new(),
            },
            modality: Modality::spatial(),
            base: Some(at(epoch - 1)),
            nodes_added: Vec::new(),
            nodes_removed: Vec::new(),
            rows: vec![GraphRow { source: 0, edges: (0..edges).map(|to| (to, 1.0)).collect() }],
        })
    }

    #[test]
    fn deltas_follow_a_snapshot_whatever_their_order_and_older_ones_are_dropped() {
        let mut waiting = WaitingDeltas::default();
        for epoch in [7, 5, 6, 9, 6] {
            waiting.add(&delta(epoch, 2));
        }
        assert_eq!(waiting.edge_count(), 8);
        assert!(waiting.next(at(3)).is_none(), "there is still a gap");
        let next = |waiting: &mut WaitingDeltas, epoch| {
            waiting.next(at(epoch)).map(|delta| delta.header.revision.epoch)
        };
        assert_eq!(next(&mut waiting, 5), Some(6));
        assert_eq!(next(&mut waiting, 6), Some(7));
        assert_eq!(next(&mut waiting, 7), None);
        assert_eq!((waiting.is_empty(), waiting.edge_count()), (false, 2));
        assert_eq!(next(&mut waiting, 8), Some(9));
        assert!(waiting.is_empty());
    }

    #[test]
    fn they_are_bounded_and_the_newest_stay() {
        let mut waiting = WaitingDeltas::default();
        let last = MAX_DELTAS as u64 + 10;
        for epoch in 1..=last {
            waiting.add(&delta(epoch, 1));
        }
        assert_eq!((waiting.deltas.len(), waiting.edge_count()), (MAX_DELTAS, MAX_DELTAS));
        assert_eq!(waiting.deltas.back().unwrap().header.revision, at(last));
        let large = u32::try_from(MAX_EDGES).unwrap();
        waiting.add(&delta(last + 1, large));
        assert_eq!((waiting.deltas.len(), waiting.edge_count()), (1, MAX_EDGES));
    }
}
