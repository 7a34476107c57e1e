//! Largest flow in a graph with capacities (Dinic, Soviet Mathematics Doklady 11, 1970).

use std::collections::VecDeque;

/// An arc and what it can still carry; the arc back has the number with the last bit flipped.
struct Arc {
    to: usize,
    left: i64,
}

/// A graph with a flow in it.
pub(super) struct MaxFlow {
    arcs: Vec<Arc>,
    at: Vec<Vec<usize>>,
    levels: Vec<u32>,
    next: Vec<usize>,
}

impl MaxFlow {
    /// `nodes` nodes without arcs.
    pub(super) fn new(nodes: usize) -> Self {
        let at = vec![Vec::new(); nodes];
        Self { arcs: Vec::new(), at, levels: vec![u32::MAX; nodes], next: vec![0; nodes] }
    }

    /// Adds an arc of some capacity; nothing for none.
    pub(super) fn add(&mut self, from: usize, to: usize, capacity: i64) {
        if capacity > 0 {
            self.at[from].push(self.arcs.len());
            self.arcs.push(Arc { to, left: capacity });
            self.at[to].push(self.arcs.len());
            self.arcs.push(Arc { to: from, left: 0 });
        }
    }

    /// Sends as much as possible, and returns how much that is.
    pub(super) fn run(&mut self, source: usize, sink: usize) -> i64 {
        let mut total = 0;
        while self.reach(source)[sink] {
            self.next.fill(0);
            loop {
                let sent = self.send(source, sink);
                if sent == 0 {
                    break;
                }
                total += sent;
            }
        }
        total
    }

    /// The nodes that could get more from `source`; after [`MaxFlow::run`] they are its side of a least cut.
    pub(super) fn reach(&mut self, source: usize) -> Vec<bool> {
        self.levels.fill(u32::MAX);
        self.levels[source] = 0;
        let mut queue = VecDeque::from([source]);
        while let Some(node) = queue.pop_front() {
            for &number in &self.at[node] {
                let arc = &self.arcs[number];
                if arc.left > 0 && self.levels[arc.to] == u32::MAX {
                    self.levels[arc.to] = self.levels[node] + 1;
                    queue.push_back(arc.to);
                }
            }
        }
        self.levels.iter().map(|level| *level != u32::MAX).collect()
    }

    /// Sends along one path of rising levels; 0 if there is none left.
    fn send(&mut self, source: usize, sink: usize) -> i64 {
        let mut path: Vec<usize> = Vec::new();
        loop {
            let node = path.last().map_or(source, |number| self.arcs[*number].to);
            if node == sink {
                let least = path.iter().map(|number| self.arcs[*number].left).min().unwrap_or(0);
                for &number in &path {
                    self.arcs[number].left -= least;
                    self.arcs[number ^ 1].left += least;
                }
                return least;
            }
            let mut found = None;
            while let Some(&number) = self.at[node].get(self.next[node]) {
                let arc = &self.arcs[number];
                if arc.left > 0 && self.levels[arc.to] == self.levels[node] + 1 {
                    found = Some(number);
                    break;
                }
                self.next[node] += 1;
            }
            match (found, path.pop()) {
                (Some(number), last) => path.extend(last.into_iter().chain([number])),
                (None, Some(last)) => self.next[self.arcs[last ^ 1].to] += 1,
                (None, None) => return 0,
            }
        }
    }
}
