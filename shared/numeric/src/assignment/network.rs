//! The flow graph of the columns.
//!
//! A node stands for each column, for each column and class with a limit (a *cell*), and for the sink. A
//! robot flows into the cell of its class in its column, or into the column itself where its class has
//! no limit; from there arcs with bounds lead on to the column and to the sink.

use std::collections::BTreeMap;

use super::rules::{Bounds, ClassLimit, Rules, Wanted};

/// An arc with bounds on its flow.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arc {
    pub(super) from: u32,
    pub(super) to: u32,
    pub(super) lower: i64,
    /// At most the number of robots.
    pub(super) upper: i64,
    /// Cost of each unit.
    pub(super) cost: i64,
}

/// Robots of one group that are in one column.
#[derive(Debug, Clone, Copy)]
pub(super) struct Members {
    pub(super) group: u32,
    pub(super) column: u32,
}

/// Columns, cells and the sink with the arcs between them.
#[derive(Debug, Clone)]
pub(super) struct Network {
    pub(super) columns: usize,
    pub(super) groups: usize,
    /// Group of every robot: 0 for those without a limited class. Empty if all are in group 0.
    group_of: Vec<u32>,
    /// Limited classes in order; the class at place i is group i + 1.
    classes: Vec<usize>,
    /// Node that robots of a group flow into in a column, groups × columns.
    node_at: Vec<u32>,
    /// Arcs, those of cells first: flow can be set in their order.
    pub(super) arcs: Vec<Arc>,
    /// Arcs at every node.
    pub(super) arcs_at: Vec<Vec<u32>>,
    /// Robots that flow into each node.
    pub(super) members_at: Vec<Vec<Members>>,
    /// Added to the cost of the flow: what it would cost if all robots that are wanted were missing.
    pub(super) constant: i128,
}

impl Network {
    /// The graph of checked `rules`.
    pub(super) fn new(rules: &Rules) -> Self {
        let columns = rules.columns();
        let mut limits: BTreeMap<usize, Vec<&ClassLimit>> = BTreeMap::new();
        for limit in &rules.class_limits {
            limits.entry(limit.class).or_default().push(limit);
        }
        let classes: Vec<usize> = limits.keys().copied().collect();
        let groups = classes.len() + 1;
        let mut network = Self {
            columns,
            groups,
            group_of: Vec::new(),
            node_at: (0..groups).flat_map(|_| 0..columns as u32).collect(),
            arcs: Vec::new(),
            arcs_at: Vec::new(),
            members_at: Vec::new(),
            constant: 0,
            classes,
        };
        if groups > 1 {
            network.group_of = (0..rules.robots)
                .map(|robot| rules.class_of(robot).map_or(0, |class| network.group(class)))
                .collect();
        }
        let cells: usize = limits.values().map(Vec::len).sum();
        let sink = (columns + cells) as u32;
        let mut cell = columns as u32;
        for (group, limits) in limits.values().enumerate() {
            let mut placed: Vec<(usize, &ClassLimit)> = limits
                .iter()
                .filter_map(|limit| Some((rules.index_of(limit.column).ok()?, *limit)))
                .collect();
            placed.sort_unstable_by_key(|(column, _)| *column);
            for (column, limit) in placed {
                network.node_at[(group + 1) * columns + column] = cell;
                network.add_cell(cell, column as u32, limit, rules.robots);
                cell += 1;
            }
        }
        for column in 0..columns {
            let Bounds { lower, upper } = rules.bounds_at(column);
            let (lower, upper) = (lower as i64, upper.min(rules.robots.max(lower)) as i64);
            network.arcs.push(Arc { from: column as u32, to: sink, lower, upper, cost: 0 });
        }
        network.link(sink as usize + 1);
        network
    }

    /// Adds the arcs of a cell; what is wanted is a first arc of the negative price.
    fn add_cell(&mut self, cell: u32, column: u32, limit: &ClassLimit, robots: usize) {
        let Bounds { lower, upper } = limit.bounds;
        let (lower, upper) = (lower as i64, upper.min(robots.max(lower)) as i64);
        let Wanted { count, price } = limit.wanted.unwrap_or(Wanted { count: 0, price: 0 });
        self.constant += price as i128 * count as i128;
        let paid = (count.min(robots) as i64).min(upper);
        let arc = Arc { from: cell, to: column, lower, upper, cost: 0 };
        if paid == 0 || price == 0 {
            self.arcs.push(arc);
            return;
        }
        let first = lower.min(paid);
        self.arcs.push(Arc { lower: first, upper: paid, cost: -price, ..arc });
        self.arcs.push(Arc { lower: lower - first, upper: upper - paid, ..arc });
    }

    /// The same graph for some of all `robots`, with bounds in proportion, rounded outwards.
    pub(super) fn sampled(&self, picked: &[usize], robots: usize) -> Self {
        let mut sample = self.clone();
        if !self.is_uniform() {
            sample.group_of = picked.iter().map(|robot| self.group_of[*robot]).collect();
        }
        let (part, all) = (picked.len() as i128, robots.max(1) as i128);
        for arc in &mut sample.arcs {
            arc.lower = (i128::from(arc.lower) * part / all) as i64;
            arc.upper = ((i128::from(arc.upper) * part + all - 1) / all) as i64;
        }
        sample
    }

    /// Lists arcs and robots at the nodes.
    fn link(&mut self, nodes: usize) {
        self.arcs_at = vec![Vec::new(); nodes];
        for (number, arc) in self.arcs.iter().enumerate() {
            self.arcs_at[arc.from as usize].push(number as u32);
            self.arcs_at[arc.to as usize].push(number as u32);
        }
        self.members_at = vec![Vec::new(); nodes];
        for (at, &node) in self.node_at.iter().enumerate() {
            let (group, column) = ((at / self.columns) as u32, (at % self.columns) as u32);
            self.members_at[node as usize].push(Members { group, column });
        }
    }

    /// Group of a class.
    fn group(&self, class: usize) -> u32 {
        self.classes.binary_search(&class).map_or(0, |place| place as u32 + 1)
    }

    /// Group of a robot.
    #[inline]
    pub(super) fn group_of(&self, robot: usize) -> usize {
        self.group_of.get(robot).map_or(0, |group| *group as usize)
    }

    /// True if all robots are in one group.
    pub(super) fn is_uniform(&self) -> bool {
        self.group_of.is_empty()
    }

    /// Nodes of a group, one for each column.
    #[inline]
    pub(super) fn nodes_of(&self, group: usize) -> &[u32] {
        &self.node_at[group * self.columns..(group + 1) * self.columns]
    }

    /// Number of nodes.
    pub(super) fn nodes(&self) -> usize {
        self.arcs_at.len()
    }

    /// The sink.
    pub(super) fn sink(&self) -> usize {
        self.nodes() - 1
    }

    /// Limited class of a group above 0.
    pub(super) fn class_of_group(&self, group: usize) -> Option<usize> {
        self.classes.get(group.checked_sub(1)?).copied()
    }
}
