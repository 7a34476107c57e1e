//! How many teams the relations of the robots show.
//!
//! The score of k teams is the modularity of the division into k teams over all relations (multiplex: Mucha
//! et al. 2010), each relation with its weight, plus a share of the eigengap behind the k-th value of A*
//! (von Luxburg 2007). Modularity says how much of the relations is within the teams, beyond what is so by
//! chance; the gap says that there are k groups and not a continuum. The divisions are made by
//! `candidates`; here are the gaps and the choice.
//!
//! Fleets have levels: squads within platoons within companies. The level with the best score is found, which
//! is the one that is plainest to see and not always the one that an operator has in mind.

use std::ops::RangeInclusive;

/// γ of the modularity: how much of what is within a team by chance is taken off. Below 1, small teams beside
/// large ones and teams of teams count less as parts of something larger.
pub const RESOLUTION: f64 = 0.85;

/// What an eigengap of 1 adds to the score. Gaps are up to a half between teams that are plain to see, and as
/// large between squads that are; so they only break ties of the modularity.
pub const GAP_WEIGHT: f64 = 0.05;

/// The score of a fleet that is one team, before [`SINGLE_GAP_WEIGHT`]. Of the true teams of the kinds of fleets
/// that defaults are chosen on, each taken alone, nine in ten have no division that reaches it.
pub const SINGLE_SCORE: f64 = 0.48;

/// What an eigengap of 1 takes off [`SINGLE_SCORE`].
pub const SINGLE_GAP_WEIGHT: f64 = 0.1;

/// Up to so many robots, [`FEW_GAP_WEIGHT`] counts instead: each robot is so large a part of the fleet that much
/// is within the teams by chance. The gap is as large as in a large fleet.
pub const FEW_ROBOTS: usize = 6;

/// What an eigengap of 1 takes off [`SINGLE_SCORE`] in fleets of [`FEW_ROBOTS`].
pub const FEW_GAP_WEIGHT: f64 = 0.75;

/// The number before has so much more score than it would have: noise in the weights moves scores by less.
pub const KEPT_SCORE: f64 = 0.003;

/// How many teams the relations show, and why.
#[derive(Debug, Clone, PartialEq)]
pub struct TeamEvidence {
    /// How many teams.
    pub teams: u32,
    /// The [`scores`] of each number of teams from 1; empty for a fixed number.
    pub scores: Vec<f64>,
}

/// The eigengap behind each value of A*, from the first: (λ_k − λ_{k+1}) / λ_1 stands at k − 1, from 0 to 1.
///
/// `singular_values` are the leading ones of S = αA*(I − αA*)⁻¹, falling, and `alpha` is its decay:
/// λ = σ / (α (1 + σ)), exact for the positive values of a symmetric A*. n values give n − 1 gaps. The list
/// ends before the first value that is no finite number. It is empty where λ_1 is 0.
#[must_use]
pub fn gaps(singular_values: &[f64], alpha: f64) -> Vec<f64> {
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

/// The score of each number of teams from 1, by the modularity of the divisions of so many robots into 2, 3, …
/// teams and the [`gaps`]. That of one team is what a division must reach to be one.
#[must_use]
pub fn scores(robots: usize, modularity: &[f64], gaps: &[f64]) -> Vec<f64> {
    if modularity.is_empty() {
        return Vec::new();
    }
    let gap = |teams: usize| gaps.get(teams - 1).copied().unwrap_or(0.0);
    let several = (2..).zip(modularity).map(|(teams, found)| found + GAP_WEIGHT * gap(teams));
    let mut scores: Vec<f64> = std::iter::once(SINGLE_SCORE).chain(several).collect();
    let best = choose(&scores, 2..=u32::MAX, None);
    let weight = if robots <= FEW_ROBOTS { FEW_GAP_WEIGHT } else { SINGLE_GAP_WEIGHT };
    scores[0] -= weight * gap(best as usize);
    scores
}

/// The number of teams within the range: the one with the best score, the least of equal ones, or 1 where that
/// score is less than one team has.
///
/// `previous` has some advantage ([`KEPT_SCORE`]). Without scores it is the least number.
#[must_use]
pub fn choose(scores: &[f64], range: RangeInclusive<u32>, previous: Option<u32>) -> u32 {
    let (least, most) = (*range.start(), *range.end());
    let known = u32::try_from(scores.len()).unwrap_or(u32::MAX);
    let score = |teams: u32| {
        let place = usize::try_from(teams).ok()?.checked_sub(1)?;
        let found = scores.get(place).copied().filter(|score| score.is_finite())?;
        Some(found + if previous == Some(teams) { KEPT_SCORE } else { 0.0 })
    };
    let mut best: Option<(u32, f64)> = None;
    for teams in least.max(2)..=most.min(known) {
        if let Some(score) = score(teams)
            && best.is_none_or(|(_, largest)| score > largest)
        {
            best = Some((teams, score));
        }
    }
    match (best, score(1).filter(|_| least <= 1)) {
        (Some((_, several)), Some(single)) if several < single => 1,
        (Some((teams, _)), _) => teams,
        (None, _) => least,
    }
}

#[cfg(test)]
mod tests {
    use muster_numeric::katz::katz_similarity;
    use muster_numeric::matrix::SparseMatrix;
    use muster_numeric::spectral_radius::spectral_radius;
    use muster_numeric::svd::full_svd;

    use super::*;

    #[test]
    fn the_values_of_a_symmetric_graph_are_its_eigenvalues() {
        // Eigenvalues 1.5 and 0.5 of two nodes with self-loops.
        let edges = [(0, 0, 1.0), (1, 1, 1.0), (0, 1, 0.5), (1, 0, 0.5)];
        let graph = SparseMatrix::from_triplets(2, edges).unwrap();
        let radius = spectral_radius(&graph, None);
        let alpha = 0.5 / radius.value;
        let all = full_svd(&katz_similarity(&graph, alpha, &radius).unwrap()).unwrap();
        let found = gaps(all.singular_values(), alpha);
        assert_eq!(found.len(), 1);
        assert!((found[0] - 2.0 / 3.0).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn values_that_are_none_have_no_gaps() {
        for values in [&[][..], &[1.0], &[0.0, 0.0], &[f64::NAN, 1.0], &[f64::INFINITY]] {
            assert!(gaps(values, 0.5).is_empty(), "{values:?}");
        }
        assert!(gaps(&[1.0, 0.5], 0.0).is_empty());
        assert!(gaps(&[1.0, 0.5], f64::NAN).is_empty());
    }

    #[test]
    fn the_best_number_is_chosen_and_the_one_before_where_it_is_almost_as_good() {
        let found = [0.48, 0.5, 0.7, 0.699, 0.6];
        let chosen = |range, previous| choose(&found, range, previous);
        assert_eq!(chosen(1..=16, None), 3);
        assert_eq!(chosen(1..=16, Some(4)), 4);
        assert_eq!(chosen(1..=16, Some(5)), 3);
        assert_eq!(chosen(1..=2, Some(3)), 2);
        assert_eq!(chosen(4..=9, Some(0)), 4);
        assert_eq!(chosen(6..=9, None), 6, "nothing is known of so many");
    }

    #[test]
    fn a_fleet_without_a_good_division_is_one_team() {
        let found = |several: f64| scores(20, &[several, several - 0.1], &[0.1, 0.2, 0.0]);
        assert_eq!(choose(&found(0.44), 1..=16, None), 1);
        let few = scores(4, &[0.34, 0.0, -0.2], &[0.1, 0.2, 0.0]);
        assert_eq!(choose(&few, 1..=16, None), 2, "the gap counts more among few robots");
        assert_eq!(choose(&found(0.46), 1..=16, None), 2);
        assert_eq!(choose(&found(0.44), 2..=16, None), 2);
        // Whichever it was before needs a little less.
        let [single, several, _] = found(0.45)[..] else { panic!("three scores") };
        let even = [single, single + 0.001, several - 0.1];
        assert_eq!([Some(1), Some(2), None].map(|before| choose(&even, 1..=16, before)), [1, 2, 2]);
    }

    #[test]
    fn nothing_to_go_by_is_the_least_number() {
        assert!(scores(9, &[], &[0.5]).is_empty());
        assert_eq!(choose(&[], 1..=16, None), 1);
        assert_eq!(choose(&[], 3..=5, Some(4)), 3);
        assert_eq!(choose(&[f64::NAN, 0.6, f64::NAN], 1..=16, Some(1)), 2);
        assert_eq!(choose(&[0.5], 0..=u32::MAX, None), 0);
    }
}
