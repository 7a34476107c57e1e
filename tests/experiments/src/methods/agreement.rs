//! Robust fusion: graphs that contradict all others do not count.
//!
//! Two graphs agree as far as their entries are correlated over all pairs of robots (the quadratic assignment
//! procedure: Krackhardt, Social Networks 10, 1988). Where one of them belongs to other robots than it names, its
//! correlation is that of chance.
//!
//! The live system does not do so. In planted fleets whose positions belong to other robots it finds 96 instead of 81 %
//! (`grid/RESULTS.md`), and nothing is worse; but reports of a whole modality are hardly ever those of other
//! robots, fleets of fewer than about twenty robots are too small to decide, and a fleet with new orders looks, until
//! robots move, just like one whose orders are wrong.

use muster_numeric::matrix::{MatrixError, SparseMatrix};

/// So many deviations of chance from none is agreement: less than one in a thousand of wrong graphs goes so far.
const AGREEMENT_DEVIATIONS: f64 = 4.0;

/// Deviation of the correlation of a graph with one that belongs to robots in any other order, times the
/// number of robots: what shuffled formations, planted fleets and campuses of 20 to 50 robots show at most.
const CHANCE_DEVIATION: f64 = 1.5;

/// The weights of graphs over the same robots, where those have none that agree with no other although others
/// agree with each other and outweigh them. A graph that relates all pairs alike, or none, agrees and disagrees
/// with none; it keeps its weight.
///
/// # Errors
/// [`MatrixError`] for graphs that are none.
pub fn trusted(graphs: &[SparseMatrix], weights: &[f64]) -> Result<Vec<f64>, MatrixError> {
    let ways: Vec<SparseMatrix> =
        graphs.iter().map(|graph| graph.with_reverse(1.0)).collect::<Result<_, _>>()?;
    let all: Vec<usize> = (0..graphs.len()).collect();
    let agree = |i: usize, j: usize| correlated(&ways[i], &ways[j]);
    let contradicted = |i: &usize| {
        let others: Vec<usize> = all.iter().copied().filter(|j| j != i).collect();
        let compared: Vec<usize> =
            others.iter().copied().filter(|j| agree(*i, *j).is_some()).collect();
        let lonely = !compared.is_empty() && compared.iter().all(|j| agree(*i, *j) == Some(false));
        let pairs = compared.iter().flat_map(|j| compared.iter().map(move |k| (*j, *k)));
        let outweighed = |(j, k): (usize, usize)| {
            j < k && agree(j, k) == Some(true) && weights[j] + weights[k] > weights[*i]
        };
        lonely && pairs.into_iter().any(outweighed)
    };
    Ok(all.iter().map(|i| if contradicted(i) { 0.0 } else { weights[*i] }).collect())
}

/// Whether two graphs agree more than chance would have it; none where one of them relates all pairs alike.
#[expect(clippy::cast_precision_loss, reason = "there are a few dozen robots")]
fn correlated(one: &SparseMatrix, other: &SparseMatrix) -> Option<bool> {
    let pairs = (one.nodes() * one.nodes().saturating_sub(1)) as f64;
    let sums = |graph: &SparseMatrix| {
        graph
            .triplets()
            .filter(|(i, j, _)| i != j)
            .fold((0.0, 0.0), |(sum, squares), (.., w)| (sum + w, squares + w * w))
    };
    let ((one_sum, one_squares), (other_sum, other_squares)) = (sums(one), sums(other));
    let product: f64 = one.triplets().map(|(i, j, w)| w * other.weight(i, j)).sum();
    let spread = |sum: f64, squares: f64| (squares - sum * sum / pairs).max(0.0);
    let varies = |sum: f64, squares: f64| spread(sum, squares) > 1e-9 * squares;
    if !varies(one_sum, one_squares) || !varies(other_sum, other_squares) {
        return None;
    }
    let both = spread(one_sum, one_squares) * spread(other_sum, other_squares);
    let found = (product - one_sum * other_sum / pairs) / both.sqrt();
    Some(found * one.nodes() as f64 >= AGREEMENT_DEVIATIONS * CHANCE_DEVIATION)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::Recipe;
    use crate::moving::faults::Sense;
    use crate::random_systems::planted;
    use crate::system::System;

    const WEIGHTS: [f64; 3] = [0.35, 0.1, 0.55];

    #[test]
    fn reports_of_others_are_not_believed_unless_they_outweigh_the_rest() {
        let nearness = Recipe::live().nearness;
        let weights =
            |system: &System| trusted(&system.graphs(&nearness).unwrap(), &WEIGHTS).unwrap();
        let mut found = [0; 2];
        for seed in 0..20 {
            let system = planted(5, seed).0;
            assert_eq!(weights(&system), WEIGHTS);
            let mistaken = |sense| weights(&system.mistaken(sense, seed));
            found[0] += usize::from(mistaken(Sense::Spatial) == [0.0, 0.1, 0.55]);
            found[1] += usize::from(mistaken(Sense::Connectivity) == [0.35, 0.0, 0.55]);
            // Positions and links together are less than orders.
            assert_eq!(mistaken(Sense::Hierarchy), WEIGHTS);
        }
        // In a fleet of few robots, others may agree no more than chance would have it.
        assert!(found.iter().all(|found| *found >= 15), "{found:?}");
    }

    #[test]
    fn graphs_that_say_nothing_are_neither_right_nor_wrong() {
        let none = SparseMatrix::from_triplets(4, []).unwrap();
        let pairs = (0..4).flat_map(|i| (0..4).filter(move |j| *j != i).map(move |j| (i, j, 1.0)));
        let complete = SparseMatrix::from_triplets(4, pairs).unwrap();
        let path = SparseMatrix::from_triplets(4, [(0, 1, 1.0), (1, 2, 1.0)]).unwrap();
        assert_eq!(trusted(&[none, complete, path], &WEIGHTS).unwrap(), WEIGHTS);
        assert_eq!(trusted(&[], &[]).unwrap(), Vec::<f64>::new());
    }
}
