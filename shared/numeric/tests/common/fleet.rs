//! A fleet whose graph changes robot by robot.

use std::collections::BTreeMap;

use muster_numeric::matrix::SparseMatrix;

use super::{graph, numbers};

/// A fleet of robots with names, of which some move, join or leave.
pub(crate) struct Fleet {
    random: Box<dyn FnMut() -> f64>,
    robots: Vec<u32>,
    next: u32,
    edges: BTreeMap<(u32, u32), f64>,
}

impl Fleet {
    const DEGREE: usize = 4;

    pub(crate) fn new(n: u32, seed: u64) -> Self {
        let robots = (0..n).collect();
        let random = Box::new(numbers(seed));
        let mut fleet = Self { random, robots, next: n, edges: BTreeMap::new() };
        for at in 0..n as usize {
            fleet.link(at);
        }
        fleet
    }

    fn below(&mut self, n: usize) -> usize {
        ((self.random)() * n as f64) as usize
    }

    /// New edges of the robot at a place, most of them both ways.
    fn link(&mut self, at: usize) {
        let own = self.robots[at];
        self.edges.retain(|edge, _| edge.0 != own && edge.1 != own);
        for _ in 0..Self::DEGREE {
            let other = self.robots[self.robots.len() - 1 - (at / 2).min(self.robots.len() - 1)];
            let near = self.below(self.robots.len());
            let other = if (self.random)() < 0.1 { other } else { self.robots[near] };
            let weight = 0.5 + (self.random)();
            if (self.random)() < 0.9 {
                self.edges.insert((own, other), weight);
            }
            if (self.random)() < 0.9 {
                self.edges.insert((other, own), weight);
            }
        }
    }

    /// Makes one change and returns the new index of each robot.
    pub(crate) fn change(&mut self) -> Vec<Option<usize>> {
        let before = self.robots.clone();
        let n = before.len();
        match (self.random)() {
            x if x < 0.05 && n < 110 => {
                let at = self.below(n + 1);
                self.robots.insert(at, self.next);
                self.next += 1;
                self.link(at);
            }
            x if x < 0.1 && n > 70 => {
                let gone = self.below(n);
                let gone = self.robots.swap_remove(gone);
                self.edges.retain(|edge, _| edge.0 != gone && edge.1 != gone);
            }
            x if x < 0.2 => {
                let mut weight = (self.random)();
                let edge = self.below(self.edges.len());
                if let Some(place) = self.edges.values_mut().nth(edge) {
                    std::mem::swap(place, &mut weight);
                }
            }
            _ => {
                let at = self.below(n);
                self.link(at);
            }
        }
        let place = |robot| self.robots.iter().position(|r| r == robot);
        before.iter().map(place).collect()
    }

    pub(crate) fn graph(&self) -> SparseMatrix {
        let places: BTreeMap<u32, usize> = self.robots.iter().copied().zip(0..).collect();
        let edges: Vec<_> =
            self.edges.iter().map(|(e, w)| (places[&e.0], places[&e.1], *w)).collect();
        graph(self.robots.len(), &edges)
    }
}
