//! How many teams the relations of the robots show.
//!
//! The evidence is the eigengap of the fused graph A* (von Luxburg 2007): k groups that are loosely connected
//! give k values of A* of about the same size, and a gap behind them. The values come from the singular values
//! of S = αA*(I − αA*)⁻¹, which the embedding has: λ = σ / (α (1 + σ)), exact for the positive values of a
//! symmetric A*.

use std::ops::RangeInclusive;

/// The number before is kept while its score is at most this share below the best one: noise of a few percent
/// in the weights moves a score by about as much, and must not change the number of teams.
pub const KEPT_SHARE: f64 = 0.1;

/// The fleet is one group where the first gap is at least this one: λ_2 falls short of λ_1 by as much where no
/// part is loosely connected. Of the true teams of the kinds of fleets that defaults are chosen on, each taken
/// alone, five in six have it; of the fleets, which are several teams, one in twelve.
pub const SINGLE_GAP: f64 = 0.14;

/// It is several groups all the same where another gap is more than so many times the first one.
pub const SINGLE_RATIO: f64 = 2.0;

/// Scores up to this one are no gap: the values are equal except for the residual of the singular values,
/// which is at most 1e-6 by default.
pub const FLAT_SCORE: f64 = 1e-5;

/// The score of each number of teams from 1: (λ_k − λ_{k+1}) / λ_1 stands at k − 1, from 0 to 1.
///
/// `singular_values` are the leading ones of S, falling, and `alpha` is its decay; n values give n − 1 scores.
/// The list ends before the first value that is no finite number. It is empty where λ_1 is 0.
#[must_use]
pub fn scores(singular_values: &[f64], alpha: f64) -> Vec<f64> {
    let values: Vec<f64> = singular_values
        .iter()
        .map(|sigma| sigma / (alpha * (1.0 + sigma)))
        .take_while(|value| value.is_finite())
        .collect();
    match values.first() {
        Some(first) if *first > 0.0 => {
            values.windows(2).map(|pair| ((pair[0] - pair[1]) / first).clamp(0.0, 1.0)).collect()
        }
        _ => Vec::new(),
    }
}

/// The number of teams within the range.
///
/// It is 1 where the first gap is wide ([`SINGLE_GAP`], [`SINGLE_RATIO`]), and otherwise the number from 2 with
/// the largest score, the least of several. Where no score is a gap though there are values for the whole
/// range, the fleet has more groups than that, and the number is the end of the range; without values, the
/// least one. `previous` is kept while it is almost as good ([`KEPT_SHARE`]).
#[must_use]
pub fn choose(scores: &[f64], range: RangeInclusive<u32>, previous: Option<u32>) -> u32 {
    let (least, most) = (*range.start(), *range.end());
    let score = |teams: u32| {
        let place = usize::try_from(teams).ok()?.checked_sub(1)?;
        scores.get(place).copied().filter(|score| *score > FLAT_SCORE)
    };
    let known = u32::try_from(scores.len()).unwrap_or(u32::MAX);
    let mut best: Option<(u32, f64)> = None;
    for teams in least.max(2)..=most.min(known) {
        if let Some(score) = score(teams)
            && best.is_none_or(|(_, largest)| score > largest)
        {
            best = Some((teams, score));
        }
    }
    let first = score(1).unwrap_or(0.0);
    if least <= 1 {
        let largest = best.map_or(0.0, |(_, score)| score);
        // Whichever it was before needs a little less evidence.
        let ease = match previous {
            Some(1) => 1.0 - KEPT_SHARE,
            Some(_) => 1.0 + KEPT_SHARE,
            None => 1.0,
        };
        let is_single = first >= SINGLE_GAP * ease && largest * ease <= SINGLE_RATIO * first;
        if is_single || best.is_none() && first > 0.0 {
            return 1;
        }
    }
    let Some((best, largest)) = best else {
        return if most <= known && scores.iter().all(|score| score.is_finite()) {
            most
        } else {
            least
        };
    };
    let is_kept = |teams: &u32| score(*teams).is_some_and(|s| s >= (1.0 - KEPT_SHARE) * largest);
    let previous = previous.filter(|teams| range.contains(teams) && *teams > 1);
    previous.filter(is_kept).unwrap_or(best)
}

#[cfg(test)]
mod tests {
    use muster_numeric::katz::katz_similarity;
    use muster_numeric::matrix::SparseMatrix;
    use muster_numeric::spectral_radius::spectral_radius;
    use muster_numeric::svd::full_svd;

    use super::*;

    /// The scores of a graph with decay 1/(2ρ).
    fn of_graph(nodes: usize, edges: Vec<(usize, usize, f64)>) -> Vec<f64> {
        let graph = SparseMatrix::from_triplets(nodes, edges).unwrap();
        let radius = spectral_radius(&graph, None);
        let alpha = 0.5 / radius.value;
        let all = full_svd(&katz_similarity(&graph, alpha, &radius).unwrap()).unwrap();
        scores(all.singular_values(), alpha)
    }

    /// Cliques of so many nodes, each with self-loops, one linked to the next by a weight.
    fn cliques(sizes: &[usize], link: f64) -> (usize, Vec<(usize, usize, f64)>) {
        let (mut edges, mut first) = (Vec::new(), 0);
        for size in sizes {
            let weight = 1.0 / *size as f64;
            let members = first..first + size;
            edges
                .extend(members.clone().flat_map(|i| members.clone().map(move |j| (i, j, weight))));
            if first > 0 && link > 0.0 {
                edges.extend([(first - 1, first, link), (first, first - 1, link)]);
            }
            first += size;
        }
        (first, edges)
    }

    fn chosen(sizes: &[usize], link: f64) -> u32 {
        let (nodes, edges) = cliques(sizes, link);
        choose(&of_graph(nodes, edges), 1..=16, None)
    }

    #[test]
    fn groups_are_counted() {
        assert_eq!(chosen(&[8], 0.0), 1);
        assert_eq!(chosen(&[2], 0.0), 1);
        assert_eq!(chosen(&[2, 2, 2], 0.0), 3);
        assert_eq!(chosen(&[5, 6, 7], 0.05), 3);
        assert_eq!(chosen(&[9, 4], 0.02), 2);
        assert_eq!(chosen(&[4; 12], 0.02), 12);
    }

    #[test]
    fn the_values_of_a_symmetric_graph_are_its_eigenvalues() {
        // Eigenvalues 1.5 and 0.5 of two nodes with self-loops.
        let found = of_graph(2, vec![(0, 0, 1.0), (1, 1, 1.0), (0, 1, 0.5), (1, 0, 0.5)]);
        assert_eq!(found.len(), 1);
        assert!((found[0] - 2.0 / 3.0).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn the_number_before_is_kept_where_it_is_almost_as_good() {
        let found = [0.1, 0.5, 0.46, 0.2];
        assert_eq!(choose(&found, 1..=16, None), 2);
        assert_eq!(choose(&found, 1..=16, Some(3)), 3);
        assert_eq!(choose(&found, 1..=16, Some(4)), 2);
        assert_eq!(choose(&found, 1..=2, Some(3)), 2);
        assert_eq!(choose(&found, 3..=4, None), 3);
        assert_eq!(choose(&found, 4..=9, Some(0)), 4);
        assert_eq!(choose(&found, 6..=9, None), 6);
    }

    #[test]
    fn a_wide_first_gap_is_one_team_and_stays_so() {
        let found = |first: f64, second: f64| [first, second, 0.01];
        let chosen = |scores: [f64; 3], previous| choose(&scores, 1..=16, previous);
        assert_eq!(chosen(found(0.2, 0.3), None), 1);
        assert_eq!(chosen(found(0.2, 0.5), None), 2);
        assert_eq!(chosen(found(0.13, 0.1), None), 2);
        assert_eq!(chosen(found(0.13, 0.1), Some(1)), 1);
        assert_eq!(chosen(found(0.15, 0.1), Some(2)), 2);
        assert_eq!(chosen(found(0.2, 0.42), Some(1)), 1);
        assert_eq!(choose(&found(0.5, 0.1), 2..=16, None), 2);
    }

    #[test]
    fn more_groups_than_the_range_are_its_end() {
        assert_eq!(choose(&scores(&[1.0; 20], 0.5), 1..=16, None), 16);
        assert_eq!(choose(&scores(&[1.0; 9], 0.5), 2..=5, None), 5);
    }

    #[test]
    fn nothing_to_go_by_is_one_team() {
        for values in [&[][..], &[1.0], &[0.0, 0.0], &[f64::NAN, 1.0], &[f64::INFINITY]] {
            let found = scores(values, 0.5);
            assert!(found.iter().all(|score| score.is_finite()), "{found:?}");
            assert_eq!(choose(&found, 1..=16, None), 1, "{values:?}");
        }
        assert!(scores(&[1.0, 0.5], 0.0).is_empty());
        assert!(scores(&[1.0, 0.5], f64::NAN).is_empty());
        assert_eq!(choose(&[f64::NAN, 0.3, f64::NAN], 1..=16, Some(1)), 2);
        assert_eq!(choose(&[0.5], 0..=u32::MAX, None), 1);
    }
}
