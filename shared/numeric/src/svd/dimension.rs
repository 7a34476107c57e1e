//! Choice of the number K of singular triplets of the representation.
//!
//! The paper takes K as given (half of the dimension D). It is the most sensitive number of the
//! method, so this module offers a rule: cut at the last of the large drops of the singular values,
//! in ratio, among the first few values that a division into that many teams can need. The drop
//! after the groups of a fleet is large. The drop after a group that is about to leave its team
//! comes later and is smaller, but counts as soon as the group has a direction of its own.
//!
//! The rule alone, [`choose_dimension`], is for single problems. It uses the values and not the
//! nodes: a graph of more separated groups than teams has groups with a zero embedding in all
//! leading vectors, and which ones may change with every change of a weight.
//! [`choose_covering_dimension`] is for successive frames: it adds vectors until every related node
//! has a non-zero embedding, and keeps K where the choice is close.

use super::embedding::WEAK_ROW_RATIO;
pub use super::spectrum::Spectrum;
use super::spectrum::null_threshold;

/// A drop is large from this share of the largest one, in logarithms. Over the kinds of fleets that defaults are
/// chosen on and the formations, 0.6 and 0.75 are alike; below, noise and lone leaders look like a group.
pub const LARGE_DROP_SHARE: f64 = 0.75;

/// Ratios up to this one are no drop: the values are equal except for rounding.
pub const FLAT_RATIO: f64 = 1.0 + 1e-9;

/// Largest K of [`choose_covering_dimension`]. Each further group adds two columns, and k-means
/// drowns in noise beyond a few hundred of them.
pub const MAX_COVERING_DIMENSION: usize = 128;

/// The previous K is kept while its drop is large except for this share of the largest one: noise
/// of a few percent in the weights must not change the dimension.
pub const KEPT_DROP_SHARE: f64 = 0.1;

/// A previous K above the rule is kept while its last value is within this fraction of the one that
/// is needed.
const SWAP_RATIO: f64 = 0.02;

/// The largest K from 2 to max(`teams`, 2) for which ln(σ_K / σ_{K+1}) is at least [`LARGE_DROP_SHARE`]
/// times the largest such value in that range; K = 2 where no value drops.
///
/// `sigma` holds all n singular values of the n × n similarity, descending; `teams` is the number
/// of teams wanted. Two nodes or fewer give K = n. Otherwise K = n is never a candidate, as no
/// ratio follows the last value. When the numeric rank r (values above n ε σ₁) ends within the
/// range, the drop after it is infinite and K = max(r, 2).
#[must_use]
pub fn choose_dimension(sigma: &[f64], teams: usize) -> usize {
    let n = sigma.len();
    ruled(sigma, n, null_threshold(sigma, n), teams)
}

/// The rule for the values of a similarity of `n` nodes; those up to `noise` do not count.
fn ruled(sigma: &[f64], n: usize, noise: f64, teams: usize) -> usize {
    if n <= 2 {
        return n;
    }
    let limit = limit(n, teams);
    let rank = rank(sigma, noise);
    if rank <= limit {
        return rank.max(2);
    }
    // sigma[k − 1] is σ_k, and positive up to the rank.
    let ratio = |k: usize| sigma[k - 1] / sigma[k];
    let most = (2..=limit).map(ratio).fold(FLAT_RATIO, f64::max).ln();
    let is_large = |k: &usize| ratio(*k) > FLAT_RATIO && ratio(*k).ln() >= LARGE_DROP_SHARE * most;
    (2..=limit).rev().find(is_large).unwrap_or(2)
}

/// The chosen K.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Choice {
    /// K, from 1 to the number of known values.
    pub dimension: usize,
    /// True when more triplets than are known could give more nodes a non-zero embedding, so that
    /// the choice must be repeated with them.
    pub short: bool,
}

/// Number of leading triplets that [`choose_covering_dimension`] must
/// know for `teams` teams of `n` nodes: one more than the range of the rule.
#[must_use]
pub fn least_rank(n: usize, teams: usize) -> usize {
    if n <= 2 { n } else { limit(n, teams) + 1 }
}

/// K of [`choose_dimension`], raised until every node that is `related` (has an edge; one entry per
/// node) has a non-zero embedding in the K leading triplets, or as many of them as is possible
/// within the numeric rank and [`MAX_COVERING_DIMENSION`].
///
/// `svd` must know [`least_rank`] triplets or all. For `previous` see [`Coverage::choose`].
#[must_use]
pub fn choose_covering_dimension(
    svd: &impl Spectrum,
    related: &[bool],
    teams: usize,
    previous: Option<usize>,
) -> Choice {
    Coverage::new(svd, related, teams).choose(teams, previous)
}

/// How many nodes the leading triplets of an SVD cover: from it K follows for several numbers of teams.
#[derive(Debug)]
pub struct Coverage<'a, S> {
    svd: &'a S,
    /// How many nodes are related.
    related: usize,
    /// Values above the noise.
    rank: usize,
    /// Related nodes with a non-zero embedding in the k leading triplets, for k from 1 on.
    embedded: Vec<usize>,
}

impl<'a, S: Spectrum> Coverage<'a, S> {
    /// That of an SVD, for up to `most_teams` teams. `related` has one entry per node: whether it has an edge.
    #[must_use]
    pub fn new(svd: &'a S, related: &[bool], most_teams: usize) -> Self {
        let n = svd.nodes();
        let rank = rank(svd.singular_values(), svd.noise());
        let limit = if n <= 2 { 0 } else { limit(n, most_teams) };
        let embedded = embedded_counts(svd, related, rank.min(MAX_COVERING_DIMENSION.max(limit)));
        let related = related.iter().filter(|related| **related).count();
        Self { svd, related, rank, embedded }
    }

    /// K for so many teams, as [`choose_covering_dimension`] has it.
    ///
    /// `previous` is the K of the previous frame. It is
    /// kept if as many nodes have a non-zero embedding with it, and one of two conditions holds. Either
    /// it is within the range of the rule, not below its K, with a drop that is large except for
    /// [`KEPT_DROP_SHARE`]. Or it is above the raised K, with a value σ within 2 % of the one there, so that the
    /// last groups may change places.
    #[must_use]
    pub fn choose(&self, teams: usize, previous: Option<usize>) -> Choice {
        let Self { svd, related, rank, embedded } = self;
        let rank = *rank;
        let sigma = svd.singular_values();
        let n = svd.nodes();
        let ruled = ruled(sigma, n, svd.noise(), teams).min(sigma.len());
        let found = |dimension| Choice { dimension, short: false };
        if n <= 2 || rank == 0 {
            return found(ruled);
        }
        let limit = limit(n, teams);
        let embedded = &embedded[..embedded.len().min(MAX_COVERING_DIMENSION.max(limit))];
        let count = |k: usize| embedded[k.clamp(1, embedded.len()) - 1];
        let most =
            (ruled..=rank.min(MAX_COVERING_DIMENSION)).map(count).fold(count(ruled), usize::max);
        // The last known value has no successor to compare it with.
        let all = rank == sigma.len() && sigma.len() < n.min(MAX_COVERING_DIMENSION + 1);
        let short = all && most < *related;
        let raised = (ruled..=rank).find(|k| count(*k) >= most).unwrap_or(ruled);
        let Some(previous) =
            previous.filter(|k| (2..=embedded.len()).contains(k) && count(*k) >= most)
        else {
            return Choice { dimension: raised, short };
        };
        // Positive up to the rank, and infinite after it.
        let ratio = |k: usize| match sigma.get(k) {
            Some(next) if k < rank => sigma[k - 1] / next,
            _ if k >= rank && rank < sigma.len() => f64::INFINITY,
            _ if sigma.len() == n => f64::INFINITY,
            _ => 1.0,
        };
        let largest = (2..=limit).map(ratio).fold(1.0, f64::max).ln();
        let as_good = (ruled..=limit).contains(&previous)
            && ratio(previous).ln() >= (LARGE_DROP_SHARE - KEPT_DROP_SHARE) * largest;
        let swapped = previous > raised
            && raised > ruled
            && sigma[previous - 1] >= (1.0 - SWAP_RATIO) * sigma[raised - 1];
        Choice { dimension: if as_good || swapped { previous } else { raised }, short }
    }
}

/// Largest K of the rule.
fn limit(n: usize, teams: usize) -> usize {
    teams.clamp(2, n - 1)
}

/// Number of values above the noise.
fn rank(sigma: &[f64], noise: f64) -> usize {
    sigma.iter().filter(|s| **s > noise).count()
}

/// Number of related nodes with a non-zero embedding in the k leading triplets, for k from 1 to
/// `bound`.
fn embedded_counts(svd: &impl Spectrum, related: &[bool], bound: usize) -> Vec<usize> {
    let mut squares = vec![0.0; svd.nodes()];
    let add = |j: usize| {
        for (i, square) in squares.iter_mut().enumerate() {
            *square += svd.squared_share(i, j);
        }
        let longest = squares.iter().fold(0.0_f64, |m, s| m.max(*s)).sqrt();
        let is_embedded =
            |(square, related): (&f64, &bool)| *related && square.sqrt() > WEAK_ROW_RATIO * longest;
        squares.iter().zip(related).filter(|pair| is_embedded(*pair)).count()
    };
    (0..bound).map(add).collect()
}

#[cfg(test)]
mod tests {
    use super::{MAX_COVERING_DIMENSION, choose_covering_dimension, choose_dimension};
    use crate::linalg::matrix::DenseMatrix;
    use crate::svd::full_svd;

    /// K for a similarity in which triplet j embeds node j alone; the first `related` nodes are
    /// related.
    fn chosen(sigma: &[f64], related: usize, teams: usize, previous: Option<usize>) -> usize {
        let n = sigma.len();
        let s = DenseMatrix::from_fn(n, n, |i, j| if i == j { sigma[i] } else { 0.0 });
        let related: Vec<bool> = (0..n).map(|i| i < related).collect();
        choose_covering_dimension(&full_svd(&s).unwrap(), &related, teams, previous).dimension
    }

    #[test]
    fn raised_until_every_related_node_has_a_non_zero_embedding() {
        let sigma = [9.0, 8.0, 3.0, 2.9, 1.0];
        for related in 0..=5 {
            assert_eq!(chosen(&sigma, related, 2, None), related.max(2));
        }
        assert_eq!(chosen(&[3.0, 2.0, 1e-20, 0.0], 4, 2, None), 2, "the rank is exhausted");
        assert_eq!(chosen(&[0.0; 4], 4, 2, Some(3)), 2);
        assert_eq!(chosen(&[], 0, 2, Some(2)), 0);
        let many: Vec<f64> = (0..MAX_COVERING_DIMENSION + 9).map(|j| 200.0 - j as f64).collect();
        assert_eq!(chosen(&many, many.len(), 2, None), MAX_COVERING_DIMENSION);
        assert_eq!(
            chosen(&many, many.len(), 2, Some(MAX_COVERING_DIMENSION + 1)),
            MAX_COVERING_DIMENSION
        );
    }

    #[test]
    fn the_previous_dimension_is_kept_where_the_choice_is_close() {
        // Drops in logarithms: 1, 0.7, 0.2 times that of the first two.
        let close = [4.0, 4.0, 2.0, 0.5_f64.powf(0.7) * 2.0, 0.5_f64.powf(0.9) * 2.0];
        assert_eq!(chosen(&close, 2, 4, None), 2);
        for (previous, kept) in [(1, 2), (2, 2), (3, 3), (4, 2), (5, 2), (6, 2)] {
            assert_eq!(chosen(&close, 2, 4, Some(previous)), kept);
        }
        assert_eq!(chosen(&close, 3, 4, Some(2)), 3, "not every node has a non-zero embedding");
        assert_eq!(chosen(&close, 2, 2, Some(3)), 2, "it is outside of the range");
        // A new group with a direction of its own is followed at once.
        let more = [4.0, 4.0, 2.0, 0.5_f64.powf(0.8) * 2.0, 0.5_f64.powf(0.9) * 2.0];
        assert_eq!(chosen(&more, 2, 4, Some(2)), 3);
    }

    #[test]
    fn a_raised_dimension_is_kept_while_groups_may_have_changed_places() {
        let sigma = [9.0, 8.0, 5.0, 4.9, 1.0];
        assert_eq!(chosen(&sigma, 3, 2, None), 3);
        assert_eq!(chosen(&sigma, 3, 2, Some(4)), 4);
        assert_eq!(chosen(&sigma, 3, 2, Some(5)), 3);
    }

    #[test]
    fn last_large_drop_within_the_range() {
        // The logarithms are 0.96 and 0.76 of the largest.
        assert_eq!(choose_dimension(&[9.0, 8.0, 4.0, 2.08, 1.25, 1.2], 5), 3);
        assert_eq!(choose_dimension(&[9.0, 8.0, 4.0, 2.08, 1.22, 1.2], 5), 4);
        assert_eq!(choose_dimension(&[9.0, 8.0, 7.0, 1.0, 0.9], 4), 3);
        assert_eq!(choose_dimension(&[9.0, 8.0, 7.0, 1.0, 0.9], 2), 2);
        // The drop after the first value is outside of the range.
        assert_eq!(choose_dimension(&[9.0, 1.0, 0.9, 0.3, 0.2], 3), 3);
    }

    #[test]
    fn equal_drops_are_all_large_and_equal_values_have_none() {
        assert_eq!(choose_dimension(&[8.0, 4.0, 2.0, 1.0, 0.5], 4), 4);
        assert_eq!(choose_dimension(&[8.0, 4.0, 2.0, 1.0 - 1e-13, 0.5], 4), 4);
        assert_eq!(choose_dimension(&[1.0, 1.0, 1.0 - 1e-13, 1.0 - 1e-12, 1.0 - 1e-12], 4), 2);
    }

    #[test]
    fn exhausted_rank_and_small_sizes() {
        assert_eq!(choose_dimension(&[3.0, 2.0, 1.0, 1e-17, 0.0], 4), 3);
        assert_eq!(choose_dimension(&[3.0, 1e-17, 0.0], 4), 2);
        assert_eq!(choose_dimension(&[0.0; 5], 4), 2);
        assert_eq!(choose_dimension(&[1.0; 5], 0), 2);
        assert_eq!(choose_dimension(&[1.0, 0.5], 9), 2);
        assert_eq!(choose_dimension(&[1.0], 3), 1);
        assert_eq!(choose_dimension(&[], 3), 0);
    }
}
