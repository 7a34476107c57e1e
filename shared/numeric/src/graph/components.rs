//! Strongly connected components of a directed graph.

use crate::linalg::matrix::SparseMatrix;

/// Strongly connected components, each a sorted list of nodes, in reverse topological order:
/// edges between components lead from later to earlier ones.
///
/// Tarjan's algorithm (SIAM J. Comput. 1, 1972) with an explicit stack: a command chain of
/// thousands of nodes would overflow the call stack of a recursive one.
pub(crate) fn strongly_connected(a: &SparseMatrix) -> Vec<Vec<usize>> {
    const UNVISITED: usize = usize::MAX;
    let n = a.nodes();
    let mut index = vec![UNVISITED; n];
    let mut low = vec![0; n];
    let mut on_stack = vec![false; n];
    let mut stack = Vec::new();
    let mut components = Vec::new();
    let mut next_index = 0;

    for root in 0..n {
        if index[root] != UNVISITED {
            continue;
        }
        let mut calls = vec![(root, a.row(root))];
        index[root] = next_index;
        low[root] = next_index;
        next_index += 1;
        stack.push(root);
        on_stack[root] = true;

        while let Some((node, edges)) = calls.last_mut() {
            let node = *node;
            if let Some((to, _)) = edges.next() {
                if index[to] == UNVISITED {
                    index[to] = next_index;
                    low[to] = next_index;
                    next_index += 1;
                    stack.push(to);
                    on_stack[to] = true;
                    calls.push((to, a.row(to)));
                } else if on_stack[to] {
                    low[node] = low[node].min(index[to]);
                }
                continue;
            }
            calls.pop();
            if let Some(&(parent, _)) = calls.last() {
                low[parent] = low[parent].min(low[node]);
            }
            if low[node] == index[node] {
                let mut component = Vec::new();
                while let Some(member) = stack.pop() {
                    on_stack[member] = false;
                    component.push(member);
                    if member == node {
                        break;
                    }
                }
                component.sort_unstable();
                components.push(component);
            }
        }
    }
    components
}

/// True when the graph has no cycle: removes nodes that no edge enters until none is left (Kahn,
/// Commun. ACM 5, 1962). O(nodes + edges), a fraction of [`strongly_connected`].
pub(crate) fn is_acyclic(a: &SparseMatrix) -> bool {
    let n = a.nodes();
    let mut entering = vec![0_u32; n];
    for (_, j, _) in a.triplets() {
        entering[j] += 1;
    }
    let mut free: Vec<usize> = (0..n).filter(|&i| entering[i] == 0).collect();
    let mut taken = 0;
    while let Some(node) = free.pop() {
        taken += 1;
        for (j, _) in a.row(node) {
            entering[j] -= 1;
            if entering[j] == 0 {
                free.push(j);
            }
        }
    }
    taken == n
}

#[cfg(test)]
mod tests {
    use super::{is_acyclic, strongly_connected};
    use crate::linalg::matrix::SparseMatrix;

    #[test]
    fn two_cycles_joined_by_one_edge() {
        let edges = [(0, 1), (1, 0), (1, 2), (2, 3), (3, 2), (4, 4)];
        let a = SparseMatrix::from_triplets(6, edges.map(|(i, j)| (i, j, 1.0))).unwrap();
        let mut found = strongly_connected(&a);
        assert!(found.iter().position(|c| c == &[2, 3]) < found.iter().position(|c| c == &[0, 1]));
        found.sort();
        assert_eq!(found, [vec![0, 1], vec![2, 3], vec![4], vec![5]]);
    }

    #[test]
    fn a_cycle_at_the_end_of_a_chain_is_found() {
        let chain = (1..50).map(|i| (i - 1, i, 1.0));
        let a = SparseMatrix::from_triplets(50, chain.clone()).unwrap();
        assert!(is_acyclic(&a));
        for back in [(49, 49), (49, 45), (20, 0)] {
            let edges = chain.clone().chain([(back.0, back.1, 1.0)]);
            assert!(!is_acyclic(&SparseMatrix::from_triplets(50, edges).unwrap()));
        }
    }

    #[test]
    fn long_chain_does_not_overflow_the_stack() {
        let n = 200_000;
        let a = SparseMatrix::from_triplets(n, (1..n).map(|i| (i - 1, i, 1.0))).unwrap();
        assert_eq!(strongly_connected(&a).len(), n);
    }
}
