//! Division by edge betweenness (Girvan and Newman, PNAS 99, 2002; Newman and Girvan, Phys. Rev. E 69,
//! 2004): the edge that most shortest paths run along is taken away, again and again, until there are as
//! many components as there are to be teams.
//!
//! Many edges of regular formations tie, and which of them goes first decides the result. Ties, and sums of
//! numbers that differ by rounding alone, are broken as networkx 3 breaks them: nodes in their order, edges
//! in the order of their ends, breadth first, and the first of the greatest.

/// An undirected graph without weights: each node's neighbours, in the order in which edges were added.
#[derive(Debug, Clone, Default)]
struct Undirected {
    neighbours: Vec<Vec<usize>>,
}

impl Undirected {
    fn new(nodes: usize, edges: &[(usize, usize)]) -> Self {
        let mut graph = Self { neighbours: vec![Vec::new(); nodes] };
        for &(i, j) in edges {
            if i != j && !graph.neighbours[i].contains(&j) {
                graph.neighbours[i].push(j);
                graph.neighbours[j].push(i);
            }
        }
        graph
    }

    fn remove(&mut self, (i, j): (usize, usize)) {
        self.neighbours[i].retain(|k| *k != j);
        self.neighbours[j].retain(|k| *k != i);
    }

    /// Edges, each once, by their first end.
    fn edges(&self) -> impl Iterator<Item = (usize, usize)> {
        // An edge belongs to the end that comes first among the nodes.
        let rows = self.neighbours.iter().enumerate();
        rows.flat_map(|(i, row)| row.iter().filter(move |j| **j > i).map(move |j| (i, *j)))
    }

    /// The component of each node, numbered by first appearance, and how many there are.
    fn components(&self) -> (Vec<usize>, usize) {
        let mut component = vec![usize::MAX; self.neighbours.len()];
        let mut count = 0;
        for start in 0..component.len() {
            if component[start] != usize::MAX {
                continue;
            }
            let mut open = vec![start];
            component[start] = count;
            while let Some(node) = open.pop() {
                for &next in &self.neighbours[node] {
                    if component[next] == usize::MAX {
                        component[next] = count;
                        open.push(next);
                    }
                }
            }
            count += 1;
        }
        (component, count)
    }

    /// Betweenness of every edge (Brandes, Social Networks 30, 2008, algorithm 7), as a table by both ends.
    fn betweenness(&self) -> Vec<f64> {
        let n = self.neighbours.len();
        let mut between = vec![0.0; n * n];
        for start in 0..n {
            let mut predecessors: Vec<Vec<usize>> = vec![Vec::new(); n];
            let (mut paths, mut distance) = (vec![0.0_f64; n], vec![None; n]);
            let mut order = Vec::with_capacity(n);
            (paths[start], distance[start]) = (1.0, Some(0));
            let mut queue = std::collections::VecDeque::from([start]);
            while let Some(node) = queue.pop_front() {
                order.push(node);
                for &next in &self.neighbours[node] {
                    let farther = distance[node].map(|distance| distance + 1);
                    if distance[next].is_none() {
                        queue.push_back(next);
                        distance[next] = farther;
                    }
                    if distance[next] == farther {
                        paths[next] += paths[node];
                        predecessors[next].push(node);
                    }
                }
            }
            let mut carried = vec![0.0; n];
            while let Some(node) = order.pop() {
                let share = (1.0 + carried[node]) / paths[node];
                for &before in &predecessors[node] {
                    let through = paths[before] * share;
                    between[before.min(node) * n + before.max(node)] += through;
                    carried[before] += through;
                }
            }
        }
        // As networkx normalises, since the product is what it compares.
        if n > 1 {
            #[expect(clippy::cast_precision_loss, reason = "there are a few dozen nodes")]
            let scale = 1.0 / (n as f64 * (n as f64 - 1.0));
            between.iter_mut().for_each(|value| *value *= scale);
        }
        between
    }
}

/// The component of each of `nodes` nodes after edges have been taken away until there are `teams`
/// components, or more where the graph has more from the beginning. Edges count in either direction, and
/// each once.
#[must_use]
pub fn girvan_newman(nodes: usize, edges: &[(usize, usize)], teams: usize) -> Vec<usize> {
    let mut graph = Undirected::new(nodes, edges);
    loop {
        let (component, count) = graph.components();
        if count >= teams.min(nodes) {
            return component;
        }
        let between = graph.betweenness();
        let value = |(i, j): (usize, usize)| between[i * nodes + j];
        let greatest =
            graph.edges().reduce(|best, edge| if value(edge) > value(best) { edge } else { best });
        match greatest {
            Some(edge) => graph.remove(edge),
            None => return component,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bridge_between_two_cliques_goes_first() {
        let clique = |from: usize| {
            (from..from + 4).flat_map(move |i| (i + 1..from + 4).map(move |j| (i, j)))
        };
        let edges: Vec<_> = clique(0).chain(clique(4)).chain([(3, 4)]).collect();
        assert_eq!(girvan_newman(8, &edges, 2), [0, 0, 0, 0, 1, 1, 1, 1]);
    }

    #[test]
    fn a_complete_graph_loses_one_node_at_a_time() {
        let edges: Vec<_> = (0..6).flat_map(|i| (i + 1..6).map(move |j| (i, j))).collect();
        assert_eq!(girvan_newman(6, &edges, 3), [0, 1, 2, 2, 2, 2]);
    }

    #[test]
    fn what_is_apart_already_stays_apart() {
        assert_eq!(girvan_newman(4, &[(0, 1)], 2), [0, 0, 1, 2]);
        assert_eq!(girvan_newman(0, &[], 3), Vec::<usize>::new());
        assert_eq!(girvan_newman(2, &[], 5), [0, 1]);
    }
}
