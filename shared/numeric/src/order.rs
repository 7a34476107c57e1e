//! An order of the nodes in which neighbours come close together.

use crate::matrix::SparseMatrix;

/// Nodes that are close together: a block of 24 vectors for so many fits the second-nearest cache
/// beside what else a product reads.
const CLOSE: usize = 2048;

/// One edge in so many may lead farther away without the order being worth changing.
const FAR_SHARE: usize = 8;

/// Order of the undirected pattern of `a` by breadth from nodes of low degree (Cuthill and McKee
/// 1969, reversed as by George): element k is the node at place k. O(edges log degree). `None` when
/// most neighbours are close together already.
pub(crate) fn proximity_order(a: &SparseMatrix) -> Option<Vec<u32>> {
    let n = a.nodes();
    let far = a.triplets().filter(|&(i, j, _)| i.abs_diff(j) > CLOSE).count();
    if far * FAR_SHARE <= a.edges() {
        return None;
    }
    // The undirected pattern in compressed rows, with doubled entries where both directions exist.
    let mut starts = vec![0_u32; n + 1];
    for (i, j, _) in a.triplets() {
        starts[i + 1] += 1;
        starts[j + 1] += 1;
    }
    for i in 0..n {
        starts[i + 1] += starts[i];
    }
    let mut neighbours = vec![0_u32; starts[n] as usize];
    let mut filled = starts.clone();
    for (i, j, _) in a.triplets() {
        neighbours[filled[i] as usize] = j as u32;
        filled[i] += 1;
        neighbours[filled[j] as usize] = i as u32;
        filled[j] += 1;
    }
    let degree = |i: u32| starts[i as usize + 1] - starts[i as usize];
    let mut roots: Vec<u32> = (0..n as u32).collect();
    roots.sort_by_key(|&i| degree(i));
    let mut seen = vec![false; n];
    let mut order: Vec<u32> = Vec::with_capacity(n);
    let mut next = 0;
    for root in roots {
        if !seen[root as usize] {
            seen[root as usize] = true;
            order.push(root);
        }
        while next < order.len() {
            let node = order[next] as usize;
            next += 1;
            let found = order.len();
            for &j in &neighbours[starts[node] as usize..starts[node + 1] as usize] {
                if !seen[j as usize] {
                    seen[j as usize] = true;
                    order.push(j);
                }
            }
            order[found..].sort_by_key(|&j| degree(j));
        }
    }
    order.reverse();
    Some(order)
}
