//! Repairs of a flow along cheapest paths.
//!
//! The price of a node is what a robot that flows into it has to pay on top of its cost. A flow
//! that is best at the prices may leave nodes with too much or too little; each repair sends one
//! unit from a node with too much to the nearest one with too little along the cheapest path, and
//! lowers prices so that the flow stays best at them (Ahuja, Magnanti and Orlin, section 9.7). The
//! search is that of Dijkstra from all nodes with too much at once, and ends at the first with too
//! little.

use super::movers::{Movers, NOBODY};
use super::network::Network;

/// Distance of a node that no path has reached.
const FAR: i64 = i64::MAX;

/// How a path enters a node.
#[derive(Debug, Clone, Copy)]
enum Step {
    Start,
    /// Along an arc, which carries one unit more.
    Forward(u32),
    /// Against an arc, which carries one unit less.
    Backward(u32),
    /// By a robot that moves to a column.
    Move {
        from: u32,
        robot: u32,
        to: u32,
    },
}

/// No unit that is too much reaches a node that needs one: the rules contradict each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Blocked;

/// A flow with its prices, and what it lacks.
pub(super) struct Flow<'a> {
    network: &'a Network,
    pub(super) prices: Vec<i64>,
    /// Flow of every arc.
    flows: Vec<i64>,
    /// Inflow less outflow of every node.
    excess: Vec<i64>,
    distances: Vec<i64>,
    done: Vec<bool>,
    steps: Vec<Step>,
}

impl<'a> Flow<'a> {
    /// The flow that is best at `prices` when `inflow` robots flow into each node, of `robots` in all.
    pub(super) fn new(
        network: &'a Network,
        prices: Vec<i64>,
        mut inflow: Vec<i64>,
        robots: usize,
    ) -> Self {
        let nodes = network.nodes();
        let mut flows = vec![0; network.arcs.len()];
        let mut outflow = vec![0; nodes];
        // Cells have higher numbers than columns, and flow into them.
        for node in (network.columns..network.sink()).chain(0..network.columns) {
            let from_here = |&&number: &&u32| network.arcs[number as usize].from as usize == node;
            let mut left = inflow[node];
            for &number in network.arcs_at[node].iter().filter(from_here) {
                let arc = &network.arcs[number as usize];
                let reduced = arc.cost + prices[arc.to as usize] - prices[node];
                flows[number as usize] = if reduced < 0 { arc.upper } else { arc.lower };
                left -= flows[number as usize];
            }
            for &number in network.arcs_at[node].iter().filter(from_here) {
                let arc = &network.arcs[number as usize];
                if arc.cost + prices[arc.to as usize] == prices[node] && left > 0 {
                    let more = left.min(arc.upper - arc.lower);
                    flows[number as usize] += more;
                    left -= more;
                }
                inflow[arc.to as usize] += flows[number as usize];
                outflow[node] += flows[number as usize];
            }
        }
        outflow[network.sink()] += robots as i64;
        let excess =
            inflow.iter().zip(&outflow).map(|(inward, outward)| inward - outward).collect();
        Self {
            network,
            prices,
            flows,
            excess,
            distances: vec![FAR; nodes],
            done: vec![false; nodes],
            steps: vec![Step::Start; nodes],
        }
    }

    /// True when every node passes on what it gets.
    pub(super) fn is_balanced(&self) -> bool {
        self.excess.iter().all(|excess| *excess == 0)
    }

    /// Repairs the flow; returns the number of paths.
    pub(super) fn repair(&mut self, movers: &mut Movers<'_>) -> Result<usize, Blocked> {
        let mut paths = 0;
        while !self.is_balanced() {
            let end = self.search(movers)?;
            self.lower_prices(end);
            self.send(end, movers);
            paths += 1;
        }
        Ok(paths)
    }

    /// Finds cheapest paths up to the first node that needs something.
    fn search(&mut self, movers: &mut Movers<'_>) -> Result<usize, Blocked> {
        for (node, excess) in self.excess.iter().enumerate() {
            self.distances[node] = if *excess > 0 { 0 } else { FAR };
            self.done[node] = false;
            self.steps[node] = Step::Start;
        }
        loop {
            let mut next = None;
            let mut least = FAR;
            for (node, distance) in self.distances.iter().enumerate() {
                if *distance < least && !self.done[node] {
                    (next, least) = (Some(node), *distance);
                }
            }
            let node = next.ok_or(Blocked)?;
            self.done[node] = true;
            if self.excess[node] < 0 {
                return Ok(node);
            }
            self.relax_arcs(node);
            self.relax_moves(node, movers);
        }
    }

    fn relax_arcs(&mut self, node: usize) {
        let network = self.network;
        for &number in &network.arcs_at[node] {
            let arc = &network.arcs[number as usize];
            let flow = self.flows[number as usize];
            let (to, cost, step) = if arc.from as usize == node {
                if flow >= arc.upper {
                    continue;
                }
                (arc.to as usize, arc.cost, Step::Forward(number))
            } else {
                if flow <= arc.lower {
                    continue;
                }
                (arc.from as usize, -arc.cost, Step::Backward(number))
            };
            let distance = self.distances[node] - self.prices[node] + cost + self.prices[to];
            if distance < self.distances[to] && !self.done[to] {
                self.distances[to] = distance;
                self.steps[to] = step;
            }
        }
    }

    fn relax_moves(&mut self, node: usize, movers: &mut Movers<'_>) {
        let network = self.network;
        let base = self.distances[node] - self.prices[node];
        for members in &network.members_at[node] {
            let group = members.group as usize;
            let nodes = network.nodes_of(group);
            let (deltas, robots) = movers.row(group, members.column as usize);
            for (to, (&delta, &robot)) in deltas.iter().zip(robots).enumerate() {
                if robot == NOBODY {
                    continue;
                }
                let target = nodes[to] as usize;
                let distance = base + delta + self.prices[target];
                if distance < self.distances[target] && !self.done[target] {
                    self.distances[target] = distance;
                    self.steps[target] = Step::Move { from: node as u32, robot, to: to as u32 };
                }
            }
        }
    }

    /// Makes the paths to all nodes up to `end` free of charge.
    fn lower_prices(&mut self, end: usize) {
        let top = self.distances[end];
        for (price, distance) in self.prices.iter_mut().zip(&self.distances) {
            *price -= top.min(*distance);
        }
    }

    /// Sends what the path to `end` carries: one unit where a robot moves.
    fn send(&mut self, end: usize, movers: &mut Movers<'_>) {
        let mut amount = -self.excess[end];
        let mut node = end;
        loop {
            let arcs = &self.network.arcs;
            match self.steps[node] {
                Step::Start => break,
                Step::Forward(number) => {
                    let arc = &arcs[number as usize];
                    amount = amount.min(arc.upper - self.flows[number as usize]);
                    node = arc.from as usize;
                }
                Step::Backward(number) => {
                    let arc = &arcs[number as usize];
                    amount = amount.min(self.flows[number as usize] - arc.lower);
                    node = arc.to as usize;
                }
                Step::Move { from, .. } => {
                    amount = 1;
                    node = from as usize;
                }
            }
        }
        amount = amount.min(self.excess[node]);
        self.excess[node] -= amount;
        self.excess[end] += amount;
        let mut node = end;
        loop {
            let arcs = &self.network.arcs;
            match self.steps[node] {
                Step::Start => return,
                Step::Forward(number) => {
                    self.flows[number as usize] += amount;
                    node = arcs[number as usize].from as usize;
                }
                Step::Backward(number) => {
                    self.flows[number as usize] -= amount;
                    node = arcs[number as usize].to as usize;
                }
                Step::Move { from, robot, to } => {
                    movers.transfer(robot, to as usize);
                    node = from as usize;
                }
            }
        }
    }
}
