//! Which nodes and edges hold an undirected graph together.

/// A node without which its component falls apart.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CutNode {
    /// The node.
    pub node: usize,
    /// How many nodes each part of its component has without it, the largest first; two or more.
    pub parts: Vec<usize>,
}

/// An edge without which its component falls apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bridge {
    /// Its ends, the smaller first.
    pub ends: [usize; 2],
    /// How many nodes each of the two parts has without it, the larger first.
    pub parts: [usize; 2],
}

/// The components of an undirected graph, and what holds each of them together.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Cuts {
    /// The component of each node; components are numbered in the order of their smallest nodes.
    pub component: Vec<usize>,
    /// How many nodes each component has.
    pub sizes: Vec<usize>,
    /// The articulation points, in order.
    pub nodes: Vec<CutNode>,
    /// The bridges, in the order of their ends.
    pub bridges: Vec<Bridge>,
}

/// The components, articulation points and bridges of an undirected graph of `nodes` nodes, with the parts
/// that each leaves (Hopcroft and Tarjan, Algorithm 447, Communications of the ACM 16, 1973). An edge may stand
/// several times and in either direction; loops, and edges to nodes that there are not, count for nothing.
///
/// O(nodes + edges log degree). The stack is explicit: a chain of thousands of robots would overflow the call
/// stack. No crate gives the parts, without which each articulation point would need a search of its own.
#[must_use]
pub fn cuts(nodes: usize, edges: impl IntoIterator<Item = (usize, usize)>) -> Cuts {
    let neighbours = neighbours(nodes, edges);
    let mut search = Search::new(nodes);
    for root in 0..nodes {
        if search.entered[root].is_none() {
            search.run(root, &neighbours);
        }
    }
    search.found.nodes.sort_unstable_by_key(|cut| cut.node);
    search.found.bridges.sort_unstable_by_key(|bridge| bridge.ends);
    search.found
}

/// The neighbours of each node, ordered, each once.
fn neighbours(nodes: usize, edges: impl IntoIterator<Item = (usize, usize)>) -> Vec<Vec<usize>> {
    let mut neighbours = vec![Vec::new(); nodes];
    for (from, to) in edges {
        if from != to && from < nodes && to < nodes {
            neighbours[from].push(to);
            neighbours[to].push(from);
        }
    }
    for list in &mut neighbours {
        list.sort_unstable();
        list.dedup();
    }
    neighbours
}

/// A depth-first search.
struct Search {
    clock: usize,
    /// When each node was entered; none before.
    entered: Vec<Option<usize>>,
    /// The earliest entry that the subtree of each node reaches by one edge that is not of the tree.
    low: Vec<usize>,
    parent: Vec<usize>,
    /// How many nodes the subtree of each node has.
    subtree: Vec<usize>,
    /// How many neighbours of each node have been looked at.
    looked: Vec<usize>,
    /// The sizes of the subtrees that hang by each node alone.
    hanging: Vec<Vec<usize>>,
    found: Cuts,
}

impl Search {
    fn new(nodes: usize) -> Self {
        Self {
            clock: 0,
            entered: vec![None; nodes],
            low: vec![0; nodes],
            parent: vec![usize::MAX; nodes],
            subtree: vec![1; nodes],
            looked: vec![0; nodes],
            hanging: vec![Vec::new(); nodes],
            found: Cuts { component: vec![0; nodes], ..Cuts::default() },
        }
    }

    fn enter(&mut self, node: usize) {
        self.entered[node] = Some(self.clock);
        self.low[node] = self.clock;
        self.clock += 1;
        self.found.component[node] = self.found.sizes.len();
    }

    /// Searches the component of a root.
    fn run(&mut self, root: usize, neighbours: &[Vec<usize>]) {
        let mut component = Vec::new();
        let mut bridges = Vec::new();
        let mut path = vec![root];
        self.enter(root);
        while let Some(&node) = path.last() {
            if let Some(&to) = neighbours[node].get(self.looked[node]) {
                self.looked[node] += 1;
                match self.entered[to] {
                    None => {
                        self.parent[to] = node;
                        self.enter(to);
                        path.push(to);
                    }
                    Some(at) if to != self.parent[node] => {
                        self.low[node] = self.low[node].min(at);
                    }
                    Some(_) => {}
                }
                continue;
            }
            path.pop();
            component.push(node);
            let Some(&above) = path.last() else { break };
            self.low[above] = self.low[above].min(self.low[node]);
            self.subtree[above] += self.subtree[node];
            let reached = Some(self.low[node]);
            if reached >= self.entered[above] {
                self.hanging[above].push(self.subtree[node]);
            }
            if reached > self.entered[above] {
                bridges.push((above.min(node), above.max(node), self.subtree[node]));
            }
        }
        let size = component.len();
        self.found.sizes.push(size);
        for node in component {
            let mut parts = std::mem::take(&mut self.hanging[node]);
            let rest = size - 1 - parts.iter().sum::<usize>();
            parts.extend((rest > 0).then_some(rest));
            if parts.len() > 1 {
                parts.sort_unstable_by(|left, right| right.cmp(left));
                self.found.nodes.push(CutNode { node, parts });
            }
        }
        self.found.bridges.extend(bridges.into_iter().map(|(smaller, larger, below)| Bridge {
            ends: [smaller, larger],
            parts: [below.max(size - below), below.min(size - below)],
        }));
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The sizes of the components without a node and an edge, by flooding.
    fn parts(
        nodes: usize,
        edges: &[(usize, usize)],
        without: Option<usize>,
        cut: Option<[usize; 2]>,
    ) -> Vec<Vec<usize>> {
        let mut unseen: Vec<usize> = (0..nodes).filter(|node| Some(*node) != without).collect();
        let mut parts = Vec::new();
        while let Some(first) = unseen.first().copied() {
            let mut part = vec![first];
            unseen.retain(|node| *node != first);
            let mut next = 0;
            while let Some(node) = part.get(next).copied() {
                next += 1;
                for &(from, to) in edges {
                    if Some([from.min(to), from.max(to)]) == cut {
                        continue;
                    }
                    for (near, far) in [(from, to), (to, from)] {
                        if near == node && unseen.contains(&far) {
                            unseen.retain(|node| *node != far);
                            part.push(far);
                        }
                    }
                }
            }
            part.sort_unstable();
            parts.push(part);
        }
        parts
    }

    fn sizes_within(parts: &[Vec<usize>], component: &[usize]) -> Vec<usize> {
        let within = parts.iter().filter(|part| component.contains(&part[0]));
        let mut sizes: Vec<usize> = within.map(Vec::len).collect();
        sizes.sort_unstable_by(|left, right| right.cmp(left));
        sizes
    }

    proptest! {
        #[test]
        fn cuts_are_those_of_taking_each_node_and_edge_away(
            nodes in 0_usize..12,
            edges in prop::collection::vec((0_usize..13, 0_usize..13), 0..24),
        ) {
            let found = cuts(nodes, edges.iter().copied());
            let real: Vec<_> =
                edges.iter().copied().filter(|(a, b)| a != b && *a < nodes && *b < nodes).collect();
            let whole = parts(nodes, &real, None, None);
            prop_assert_eq!(&found.sizes, &whole.iter().map(Vec::len).collect::<Vec<_>>());
            let mut cut_nodes = Vec::new();
            let mut bridges = Vec::new();
            for (number, component) in whole.iter().enumerate() {
                for &node in component {
                    prop_assert_eq!(found.component[node], number);
                    let sizes = sizes_within(&parts(nodes, &real, Some(node), None), component);
                    if sizes.len() > 1 {
                        cut_nodes.push(CutNode { node, parts: sizes });
                    }
                }
            }
            let mut pairs: Vec<_> = real.iter().map(|(a, b)| [*a.min(b), *a.max(b)]).collect();
            pairs.sort_unstable();
            pairs.dedup();
            for ends in pairs {
                let component = &whole[found.component[ends[0]]];
                let sizes = sizes_within(&parts(nodes, &real, None, Some(ends)), component);
                if let [larger, smaller] = sizes[..] {
                    bridges.push(Bridge { ends, parts: [larger, smaller] });
                }
            }
            cut_nodes.sort_unstable_by_key(|cut| cut.node);
            prop_assert_eq!(found.nodes, cut_nodes);
            prop_assert_eq!(found.bridges, bridges);
        }
    }

    #[test]
    fn two_triangles_that_share_a_node_hang_by_it_and_have_no_bridge() {
        let found = cuts(6, [(0, 1), (1, 2), (2, 0), (2, 3), (3, 4), (4, 2), (2, 2), (0, 9)]);
        assert_eq!((found.sizes, found.component), (vec![5, 1], vec![0, 0, 0, 0, 0, 1]));
        assert_eq!(found.nodes, [CutNode { node: 2, parts: vec![2, 2] }]);
        assert_eq!(found.bridges, []);
    }

    #[test]
    fn a_long_chain_does_not_overflow_the_stack() {
        let nodes = 200_000;
        let found = cuts(nodes, (1..nodes).map(|node| (node, node - 1)));
        assert_eq!((found.nodes.len(), found.bridges.len()), (nodes - 2, nodes - 1));
        assert_eq!(found.nodes[0], CutNode { node: 1, parts: vec![nodes - 2, 1] });
        assert_eq!(found.bridges[1], Bridge { ends: [1, 2], parts: [nodes - 2, 2] });
    }
}
