//! Some rows of the Katz similarity, as far as short walks determine them.

use crate::fuse::WeightedGraph;
use crate::linalg::matrix::{DenseMatrix, MatrixError};

/// Rows that are computed in one pass over the graphs: a register of eight numbers on most processors.
const BLOCK: usize = 8;

/// Rows `sources` of Σ_{l = 1 … steps} αˡ Aˡ with A = Σ w_m A_m over graphs of `nodes` nodes, one row of
/// `nodes` entries per source, in the order of `sources`.
///
/// They fall short of the rows of S by the walks of more steps, which weigh (α‖A‖)ˢᵗᵉᵖˢ in relation to the
/// first ones at most. The graphs are not added up. O(sources × edges × steps).
///
/// # Errors
/// [`MatrixError::OutOfBounds`] for a source beyond `nodes`; [`MatrixError::Vector`] for a graph of another
/// size; [`MatrixError::Entry`] for a result out of range; [`MatrixError::TooLarge`] where the result has
/// too many entries.
pub fn short_katz_rows<'a>(
    nodes: usize,
    graphs: &[impl Into<WeightedGraph<'a>> + Copy],
    alpha: f64,
    sources: &[usize],
    steps: usize,
) -> Result<DenseMatrix, MatrixError> {
    let graphs: Vec<WeightedGraph<'a>> = graphs.iter().map(|graph| (*graph).into()).collect();
    if let Some(other) = graphs.iter().find(|graph| graph.graph.nodes() != nodes) {
        return Err(MatrixError::Vector { cols: nodes, len: other.graph.nodes() });
    }
    if let Some(&row) = sources.iter().find(|source| **source >= nodes) {
        return Err(MatrixError::OutOfBounds { row, col: row, nodes });
    }
    let mut rows = DenseMatrix::zeros(sources.len(), nodes)?;
    // One line of `BLOCK` numbers per node: the walks that end there, by source.
    let mut walks = vec![[0.0; BLOCK]; nodes];
    let mut longer = vec![[0.0; BLOCK]; nodes];
    for (block, sources) in sources.chunks(BLOCK).enumerate() {
        walks.fill([0.0; BLOCK]);
        for (place, &source) in sources.iter().enumerate() {
            walks[source][place] = 1.0;
        }
        for _ in 0..steps {
            longer.fill([0.0; BLOCK]);
            for (node, ending) in walks.iter().enumerate() {
                if ending.iter().all(|weight| *weight == 0.0) {
                    continue;
                }
                for WeightedGraph { graph, weight } in &graphs {
                    for (next, share) in graph.row(node) {
                        let step = alpha * weight * share;
                        for (sum, ending) in longer[next].iter_mut().zip(ending) {
                            *sum += step * ending;
                        }
                    }
                }
            }
            std::mem::swap(&mut walks, &mut longer);
            for place in 0..sources.len() {
                let row = rows.row_mut(block * BLOCK + place);
                for (sum, ending) in row.iter_mut().zip(&walks) {
                    *sum += ending[place];
                }
            }
        }
    }
    let finite = |value: &&f64| !value.is_finite();
    match rows.data().iter().find(finite) {
        Some(&value) => Err(MatrixError::Entry { row: 0, col: 0, value }),
        None => Ok(rows),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuse::fuse_scaled;
    use crate::katz::katz_similarity;
    use crate::linalg::matrix::SparseMatrix;
    use crate::radius::exact::spectral_radius;

    #[test]
    fn rows_approach_those_of_the_similarity() {
        let ring = (0..50).map(|i| (i, (i + 1) % 50, 0.4));
        let chords = (0..50).map(|i| (i, (i + 7) % 50, 1.2));
        let ring = SparseMatrix::from_triplets(50, ring).unwrap();
        let chords = SparseMatrix::from_triplets(50, chords).unwrap();
        let graph = fuse_scaled(&[(&ring, 1.0, 1.0), (&chords, 0.5, 1.0)]).unwrap();
        let graphs = [(&ring, 1.0), (&chords, 0.5)];
        let radius = spectral_radius(&graph, None);
        let whole = katz_similarity(&graph, 0.5, &radius).unwrap();
        // More sources than fit a block, not in order.
        let sources: Vec<usize> = (0..40).map(|place| (place * 11) % 50).collect();
        let rows = short_katz_rows(50, &graphs, 0.5, &sources, 60).unwrap();
        for (row, &source) in sources.iter().enumerate() {
            for node in 0..50 {
                assert!((rows.at(row, node) - whole.at(source, node)).abs() < 1e-12);
            }
        }
        let short = short_katz_rows(50, &graphs, 0.5, &[3], 1).unwrap();
        assert_eq!((short.at(0, 4), short.at(0, 10), short.at(0, 5)), (0.2, 0.3, 0.0));
    }

    #[test]
    fn unknown_sources_are_refused() {
        let graph = SparseMatrix::from_triplets(3, [(0, 1, 1.0)]).unwrap();
        let found = short_katz_rows(3, &[(&graph, 1.0)], 0.5, &[3], 2);
        assert!(matches!(found, Err(MatrixError::OutOfBounds { .. })));
        let found = short_katz_rows(2, &[(&graph, 1.0)], 0.5, &[1], 2);
        assert!(matches!(found, Err(MatrixError::Vector { .. })));
        assert_eq!(short_katz_rows(3, &[(&graph, 1.0)], 0.5, &[], 2).unwrap().rows(), 0);
    }
}
