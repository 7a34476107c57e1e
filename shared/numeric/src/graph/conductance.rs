//! Conductance of groups of a graph's nodes.

/// The conductance of each of `groups` groups: the weight of the edges that leave the group or enter it, as a
/// share of the weight of all ends of edges within it, or outside of it if that is less (Kannan, Vempala and
/// Vetta, *On clusterings: good, bad and spectral*, Journal of the ACM 51, 2004). 0 is a group without an edge
/// to others, 1 one without an edge within. It is not defined, and none, where the group or the rest has no
/// edge.
///
/// Edges are `(from, to, weight)`; a directed graph counts as the undirected one with the sum of both
/// directions. `labels` has the group of each node; a node without one is outside of all, and so is a node
/// beyond the end of the list. O(edges + groups).
#[must_use]
pub fn conductances(
    edges: impl IntoIterator<Item = (usize, usize, f64)>,
    labels: &[Option<usize>],
    groups: usize,
) -> Vec<Option<f64>> {
    let label = |node: usize| labels.get(node).copied().flatten().filter(|&label| label < groups);
    let (mut leaving, mut volume) = (vec![0.0; groups], vec![0.0; groups]);
    let mut total = 0.0;
    for (from, to, weight) in edges {
        total += 2.0 * weight;
        let ends = [label(from), label(to)];
        for end in ends.into_iter().flatten() {
            volume[end] += weight;
            if ends[0] != ends[1] {
                leaving[end] += weight;
            }
        }
    }
    let share = |(leaving, volume): (f64, f64)| {
        let smaller: f64 = volume.min(total - volume);
        // Sums of the same weights in another order may leave a rest where there is nothing.
        let is_defined = smaller > total * f64::EPSILON;
        is_defined.then(|| (leaving / smaller).min(1.0))
    };
    leaving.into_iter().zip(volume).map(share).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn two_triangles_with_a_bridge() {
        // Networkx by hand: one edge of weight 1 leaves, and each side has seven ends.
        let edges = [(0, 1), (0, 2), (1, 2), (3, 4), (3, 5), (4, 5), (2, 3)];
        let labels = [0, 0, 0, 1, 1, 1].map(Some);
        let found = conductances(edges.map(|(from, to)| (from, to, 1.0)), &labels, 3);
        assert_eq!(found, [Some(1.0 / 7.0), Some(1.0 / 7.0), None]);
    }

    #[test]
    fn groups_without_an_edge_or_with_all_of_them_have_none() {
        let edges = [(0, 1, 0.1), (1, 0, 0.2), (1, 1, 0.3)];
        assert_eq!(conductances(edges, &[Some(0), Some(0), Some(1)], 2), [None, None]);
        assert_eq!(conductances(edges, &[Some(0), None], 1), [Some(1.0)]);
        assert_eq!(conductances([(0, 1, 1.0)], &[Some(0), Some(1)], 2), [Some(1.0), Some(1.0)]);
        assert_eq!(conductances([(0, 9, 1.0)], &[Some(7)], 1), [None]);
    }

    proptest! {
        #[test]
        fn it_is_that_of_the_definition(
            edges in prop::collection::vec((0_usize..8, 0_usize..8, 1_u8..9), 0..30),
            labels in prop::collection::vec(prop::option::of(0_usize..3), 8),
        ) {
            let edges = || edges.iter().map(|&(from, to, weight)| (from, to, f64::from(weight)));
            for (group, found) in conductances(edges(), &labels, 3).into_iter().enumerate() {
                let is_in = |node: usize| labels[node] == Some(group);
                let sum = |right: &dyn Fn(bool, bool) -> f64| -> f64 {
                    edges().map(|(from, to, weight)| weight * right(is_in(from), is_in(to))).sum()
                };
                let cut = sum(&|from, to| f64::from(u8::from(from != to)));
                let inside = sum(&|from, to| f64::from(u8::from(from) + u8::from(to)));
                let outside = sum(&|from, to| f64::from(u8::from(!from) + u8::from(!to)));
                let expected = (inside.min(outside) > 0.0).then(|| cut / inside.min(outside));
                prop_assert_eq!(found, expected);
            }
        }
    }
}
