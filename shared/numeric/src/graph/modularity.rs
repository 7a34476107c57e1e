//! Modularity of a division of a graph's nodes.

use crate::linalg::matrix::SparseMatrix;

/// The degrees that a graph's nodes have by chance, against which divisions are measured.
#[derive(Debug, Clone)]
pub struct Modularity<'a> {
    graph: &'a SparseMatrix,
    outgoing: Vec<f64>,
    incoming: Vec<f64>,
    total: f64,
}

impl<'a> Modularity<'a> {
    /// Of a graph; none where it has no edge.
    ///
    /// A graph need not relate all nodes, and says nothing of those without an edge. Where it relates the share
    /// c of them, the degrees that are expected by chance are c times their own, and 1 − c times the mean for
    /// every node. So a group that has all edges of such a graph is more than chance; by the degrees alone all
    /// edges had to be there.
    #[must_use]
    pub fn new(graph: &'a SparseMatrix) -> Option<Self> {
        let (mut outgoing, mut incoming) = graph.degrees();
        let total: f64 = outgoing.iter().sum();
        let ends = outgoing.iter().zip(&incoming);
        let related = ends.filter(|(leaving, entering)| **leaving + **entering > 0.0).count();
        #[expect(clippy::cast_precision_loss, reason = "there are fewer nodes than 2⁵³")]
        let (related, nodes) = (related as f64, outgoing.len() as f64);
        let (share, mean) = (related / nodes, total / nodes);
        if related < nodes {
            for degree in outgoing.iter_mut().chain(&mut incoming) {
                *degree = share * *degree + (1.0 - share) * mean;
            }
        }
        (total > 0.0).then_some(Self { graph, outgoing, incoming, total })
    }

    /// The share of the weight of all edges that is within groups, less `resolution` times the share that
    /// would be if each edge kept its ends' degrees and nothing else:
    /// Q = Σ_c (w_c / w − γ s_c t_c / w²), for the weight w_c within group c and the sums s_c and t_c of the
    /// weights that leave and enter its nodes (Newman and Girvan 2004; directed: Leicht and Newman 2008;
    /// resolution γ: Reichardt and Bornholdt 2006). It is at most 1.
    ///
    /// `labels` has the group of each node; a node without one is in no group, and so is a node beyond the
    /// end of the list.
    #[must_use]
    pub fn of(&self, labels: &[Option<usize>], resolution: f64) -> f64 {
        let groups = labels.iter().flatten().max().map_or(0, |most| most + 1);
        let label = |node: usize| labels.get(node).copied().flatten();
        let within: f64 = self
            .graph
            .triplets()
            .filter(|(from, to, _)| label(*from).is_some_and(|of| label(*to) == Some(of)))
            .map(|(.., weight)| weight)
            .sum();
        let mut sums = vec![(0.0, 0.0); groups];
        for ((outgoing, incoming), label) in self.outgoing.iter().zip(&self.incoming).zip(labels) {
            if let Some((left, entered)) = label.and_then(|label| sums.get_mut(label)) {
                *left += outgoing;
                *entered += incoming;
            }
        }
        let expected: f64 =
            sums.iter().map(|(left, entered)| (left / self.total) * (entered / self.total)).sum();
        within / self.total - resolution * expected
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn graph(nodes: usize, edges: &[(usize, usize, f64)]) -> SparseMatrix {
        SparseMatrix::from_triplets(nodes, edges.iter().copied()).unwrap()
    }

    #[test]
    fn two_triangles_with_a_bridge_are_two_groups() {
        // Newman and Girvan by hand: 12 of 14 directed edges within, and each group has half of the ends.
        let pairs = [(0, 1), (0, 2), (1, 2), (3, 4), (3, 5), (4, 5), (2, 3)];
        let edges: Vec<_> = pairs.iter().flat_map(|&(i, j)| [(i, j, 1.0), (j, i, 1.0)]).collect();
        let graph = graph(6, &edges);
        let modularity = Modularity::new(&graph).unwrap();
        let halves = [0, 0, 0, 1, 1, 1].map(Some);
        assert!((modularity.of(&halves, 1.0) - (12.0 / 14.0 - 0.5)).abs() < 1e-12);
        assert!((modularity.of(&halves, 0.5) - (12.0 / 14.0 - 0.25)).abs() < 1e-12);
        assert!(modularity.of(&[Some(0); 6], 1.0).abs() < 1e-12, "one group is no division");
        let alone: Vec<_> = (0..6).map(Some).collect();
        assert!(modularity.of(&alone, 1.0) < 0.0);
    }

    #[test]
    fn edges_within_one_group_of_a_graph_that_says_nothing_of_the_others_are_more_than_chance() {
        // A triangle among nine nodes: c is a third, each of its nodes has 1/3 · 1/3 + 2/3 · 1/9 of the ends,
        // the others 2/3 · 1/9 each.
        let edges = [(0, 1, 1.0), (1, 0, 1.0), (0, 2, 1.0), (2, 0, 1.0), (1, 2, 1.0), (2, 1, 1.0)];
        let graph = graph(9, &edges);
        let modularity = Modularity::new(&graph).unwrap();
        let thirds = [0, 0, 0, 1, 1, 1, 2, 2, 2].map(Some);
        let (inside, outside) = (5.0_f64 / 9.0, 2.0_f64 / 9.0);
        let wanted = 1.0 - inside.powi(2) - 2.0 * outside.powi(2);
        assert!((modularity.of(&thirds, 1.0) - wanted).abs() < 1e-12);
        assert!(modularity.of(&[Some(0); 9], 1.0).abs() < 1e-12, "one group is no division");
    }

    #[test]
    fn directed_edges_count_by_what_leaves_and_what_enters() {
        // Node 0 commands 1 and 2: nothing enters it, and nothing leaves them.
        let graph = graph(3, &[(0, 1, 1.0), (0, 2, 3.0)]);
        let modularity = Modularity::new(&graph).unwrap();
        let found = modularity.of(&[Some(0), Some(1), Some(0)], 1.0);
        assert!((found - (0.75 - 0.75)).abs() < 1e-12, "{found}");
    }

    #[test]
    fn nodes_without_a_group_are_within_none() {
        let graph = graph(3, &[(0, 1, 1.0), (1, 2, 1.0)]);
        let modularity = Modularity::new(&graph).unwrap();
        assert!((modularity.of(&[Some(0), Some(0), None], 0.0) - 0.5).abs() < 1e-12);
        assert!((modularity.of(&[Some(0), Some(0)], 0.0) - 0.5).abs() < 1e-12);
        assert_eq!(modularity.of(&[], 1.0), 0.0);
        assert!(Modularity::new(&self::graph(3, &[])).is_none());
    }
}
