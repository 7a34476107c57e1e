//! The robot that moves from one column to another at the least cost.
//!
//! For every group and pair of columns the best mover is kept. A row of the table is filled when a
//! path first leaves its column, by one scan of the members. A robot that arrives is compared with
//! the best; when the best one leaves, the members are scanned again, and from the
//! [`SCANS_BEFORE_HEAP`]-th time on a heap takes the place of the scan, from which robots that have
//! left are dropped only when they come to its top, and to which robots that have arrived are added
//! only when it is asked. So a call that moves few robots builds no heap,
//! and one that moves thousands scans little. Equal costs go to the robot of the lower index.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::costs::CostMatrix;
use super::network::Network;
use super::restrictions::Restrictions;

/// No robot.
pub(super) const NOBODY: u32 = u32::MAX;

/// Scans for one pair of columns before it gets a heap: building one takes about as long as this many scans.
const SCANS_BEFORE_HEAP: u8 = 4;

/// Cost of a move, and the robot.
type Entry = Reverse<(i64, u32)>;

/// Best movers out of one column.
struct Row {
    /// Least cost of a move to each column.
    deltas: Vec<i64>,
    /// The robot that moves at this cost, or [`NOBODY`].
    robots: Vec<u32>,
    scans: Vec<u8>,
    heaps: Vec<Option<BinaryHeap<Entry>>>,
    /// Robots that have arrived, in order, and how many of them each heap has seen.
    arrivals: Vec<u32>,
    seen: Vec<usize>,
}

/// Members of each column, and the best movers between them.
pub(super) struct Movers<'a> {
    network: &'a Network,
    costs: &'a CostMatrix,
    restrictions: &'a Restrictions,
    /// Column of every robot.
    pub(super) labels: Vec<u32>,
    /// Place of every robot among the members of its column.
    places: Vec<u32>,
    /// Robots of every group in every column.
    members: Vec<Vec<u32>>,
    rows: Vec<Option<Row>>,
}

impl<'a> Movers<'a> {
    /// Members by `labels`, and no row.
    pub(super) fn new(
        network: &'a Network,
        costs: &'a CostMatrix,
        restrictions: &'a Restrictions,
        labels: Vec<u32>,
    ) -> Self {
        let cells = network.groups * network.columns;
        let mut members = vec![Vec::new(); cells];
        let mut places = vec![0; labels.len()];
        for (robot, &label) in labels.iter().enumerate() {
            let list = &mut members[network.group_of(robot) * network.columns + label as usize];
            places[robot] = list.len() as u32;
            list.push(robot as u32);
        }
        let rows = (0..cells).map(|_| None).collect();
        Self { network, costs, restrictions, labels, places, members, rows }
    }

    /// Costs of the best moves of robots of `group` out of `column`, one for each column, and the robots.
    pub(super) fn row(&mut self, group: usize, column: usize) -> (&[i64], &[u32]) {
        let at = group * self.network.columns + column;
        if self.rows[at].is_none() {
            self.rows[at] = Some(self.filled(at, column));
        }
        match &self.rows[at] {
            Some(row) => (&row.deltas, &row.robots),
            None => (&[], &[]),
        }
    }

    fn filled(&self, at: usize, column: usize) -> Row {
        let columns = self.network.columns;
        let mut row = Row {
            deltas: vec![i64::MAX; columns],
            robots: vec![NOBODY; columns],
            scans: vec![0; columns],
            heaps: (0..columns).map(|_| None).collect(),
            arrivals: Vec::new(),
            seen: vec![0; columns],
        };
        for &robot in &self.members[at] {
            let costs = self.costs.row(robot as usize);
            let own = costs[column];
            let free = self.restrictions.is_free(robot as usize);
            for (to, cost) in costs.iter().enumerate() {
                let delta = cost - own;
                if delta > row.deltas[to] || (delta == row.deltas[to] && robot > row.robots[to]) {
                    continue;
                }
                if free || self.restrictions.allows(robot as usize, to) {
                    row.deltas[to] = delta;
                    row.robots[to] = robot;
                }
            }
        }
        // Nobody moves to where he is.
        row.robots[column] = NOBODY;
        row
    }

    /// Moves a robot to another column.
    pub(super) fn transfer(&mut self, robot: u32, to: usize) {
        let columns = self.network.columns;
        let group = self.network.group_of(robot as usize);
        let from = std::mem::replace(&mut self.labels[robot as usize], to as u32) as usize;
        let list = &mut self.members[group * columns + from];
        let place = self.places[robot as usize] as usize;
        list.swap_remove(place);
        if let Some(moved) = list.get(place) {
            self.places[*moved as usize] = place as u32;
        }
        let list = &mut self.members[group * columns + to];
        self.places[robot as usize] = list.len() as u32;
        list.push(robot);
        self.leave(robot, group, from);
        self.arrive(robot, group, to);
    }

    /// Finds other best movers where `robot`, which has left, was the best.
    fn leave(&mut self, robot: u32, group: usize, from: usize) {
        let at = group * self.network.columns + from;
        let Some(mut row) = self.rows[at].take() else { return };
        for to in 0..self.network.columns {
            if row.robots[to] == robot {
                let (delta, next) = self.next_best(&mut row, at, from, to);
                row.deltas[to] = delta;
                row.robots[to] = next;
            }
        }
        self.rows[at] = Some(row);
    }

    /// The best mover `from` → `to`, and the cost of its move.
    fn next_best(&self, row: &mut Row, at: usize, from: usize, to: usize) -> (i64, u32) {
        let entries = || {
            self.members[at].iter().filter_map(|&robot| {
                let allowed = self.restrictions.allows(robot as usize, to);
                let costs = self.costs.row(robot as usize);
                allowed.then(|| (costs[to] - costs[from], robot))
            })
        };
        if row.heaps[to].is_none() {
            if row.scans[to] < SCANS_BEFORE_HEAP {
                row.scans[to] += 1;
                return entries().min().unwrap_or((i64::MAX, NOBODY));
            }
            row.heaps[to] = Some(entries().map(Reverse).collect());
            row.seen[to] = row.arrivals.len();
        }
        let Some(heap) = &mut row.heaps[to] else { return (i64::MAX, NOBODY) };
        let seen = std::mem::replace(&mut row.seen[to], row.arrivals.len());
        for &robot in &row.arrivals[seen..] {
            let here = self.labels[robot as usize] as usize == from;
            if here && self.restrictions.allows(robot as usize, to) {
                let costs = self.costs.row(robot as usize);
                heap.push(Reverse((costs[to] - costs[from], robot)));
            }
        }
        while let Some(&Reverse(best)) = heap.peek() {
            if self.labels[best.1 as usize] as usize == from {
                return best;
            }
            heap.pop();
        }
        (i64::MAX, NOBODY)
    }

    /// Compares `robot`, which has arrived, with the best movers.
    fn arrive(&mut self, robot: u32, group: usize, column: usize) {
        let Some(row) = &mut self.rows[group * self.network.columns + column] else { return };
        row.arrivals.push(robot);
        let costs = self.costs.row(robot as usize);
        for (to, cost) in costs.iter().enumerate() {
            if to == column || !self.restrictions.allows(robot as usize, to) {
                continue;
            }
            let entry = (cost - costs[column], robot);
            if entry < (row.deltas[to], row.robots[to]) {
                (row.deltas[to], row.robots[to]) = entry;
            }
        }
    }
}
