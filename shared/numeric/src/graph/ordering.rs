//! Orders of the nodes in which neighbours come close together.

use crate::linalg::matrix::SparseMatrix;

/// Nodes whose indices differ by at most this are close: a block of 24 vectors for as many rows
/// fits the second-level cache next to the other operands of a product.
const CLOSE_NODES: usize = 2048;

/// One edge in this many may join distant nodes without the order being worth a change.
const DISTANT_EDGE_SHARE: usize = 8;

/// Reverse Cuthill–McKee order of the undirected pattern of `a`, for products: element k is the
/// node at place k. O(edges log degree). `None` when most neighbours are close already.
pub(crate) fn proximity_order(a: &SparseMatrix) -> Option<Vec<u32>> {
    let n = a.nodes();
    let distant = a.triplets().filter(|&(i, j, _)| i.abs_diff(j) > CLOSE_NODES).count();
    if distant * DISTANT_EDGE_SHARE <= a.edges() {
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
    Some(reverse_cuthill_mckee(n, |i| &neighbours[starts[i] as usize..starts[i + 1] as usize]))
}

/// Breadth-first order from nodes of low degree, neighbours by degree, reversed (Cuthill and McKee
/// 1969; George 1971). The degree of a node is the length of its list of `neighbours`.
fn reverse_cuthill_mckee<'a>(nodes: usize, neighbours: impl Fn(usize) -> &'a [u32]) -> Vec<u32> {
    let degree = |i: &u32| neighbours(*i as usize).len();
    let mut roots: Vec<u32> = (0..nodes as u32).collect();
    roots.sort_by_key(degree);
    let mut visited = vec![false; nodes];
    let mut order: Vec<u32> = Vec::with_capacity(nodes);
    let mut next = 0;
    for root in roots {
        if !std::mem::replace(&mut visited[root as usize], true) {
            order.push(root);
        }
        while next < order.len() {
            let found = order.len();
            for &j in neighbours(order[next] as usize) {
                if !std::mem::replace(&mut visited[j as usize], true) {
                    order.push(j);
                }
            }
            order[found..].sort_by_key(degree);
            next += 1;
        }
    }
    order.reverse();
    order
}
