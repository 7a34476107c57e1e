//! Subgraphs of some of the nodes.

use crate::linalg::matrix::SparseMatrix;

/// Rows and columns `nodes` of `a`, renumbered. `place` is scratch space of one entry per node of
/// `a`, all `usize::MAX` before and after.
pub(crate) fn induced_subgraph(
    a: &SparseMatrix,
    nodes: &[usize],
    place: &mut [usize],
) -> SparseMatrix {
    for (k, &node) in nodes.iter().enumerate() {
        place[node] = k;
    }
    let edges = nodes.iter().enumerate().flat_map(|(k, &node)| {
        let place = &*place;
        let inner = a.row(node).map(move |(j, w)| (k, place[j], w));
        inner.filter(|e| e.1 != usize::MAX)
    });
    let block = SparseMatrix::from_checked(nodes.len(), edges.collect());
    for &node in nodes {
        place[node] = usize::MAX;
    }
    block
}
