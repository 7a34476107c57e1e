//! Choice of the number K of singular triplets that make up the representation.
//!
//! The paper takes K as given (half of the dimension D). It is the most sensitive number of the
//! method, so this module offers a rule: cut at the last of the large drops of the singular values, in
//! ratio, among the first few values that a division into that many teams can need. The drop behind
//! the groups of a fleet is large; that behind a group which is about to leave its team comes after it
//! and is smaller, and what is behind it counts as soon as it is seen.
//!
//! The rule alone, [`choose_dimension`], looks at the values and not at the nodes: a graph of more
//! separated groups than teams has groups that no leading vector sees, and which ones may change with
//! every change of a weight. [`choose_seeing_dimension`] is the rule of the method: it adds vectors until
//! every related node is seen, and in frames that follow one another it does not move where the choice is
//! close.

use crate::embedding::WEAK_ROW;
use crate::svd::null_threshold;

/// What the choice looks at: the leading singular triplets of the similarity, all of them or some.
pub trait Spectrum {
    /// Number of nodes n.
    fn nodes(&self) -> usize;

    /// Those singular values that are known, descending: all n, or the largest.
    fn singular_values(&self) -> &[f64];

    /// Values up to this one are noise.
    fn noise(&self) -> f64;

    /// Squared length that triplet `j` adds to the row of node `i` in \[U√Σ, V√Σ\].
    fn squared_share(&self, i: usize, j: usize) -> f64;
}

/// A drop is large from this share of the largest one, in logarithms. On training seeds of formations and
/// planted fleets 0.65 to 1 are worth the same to 0.03 %; with 1, fleets of 500 robots take 2 s to follow
/// a split instead of 1 (`muster-experiments moving`), and below 0.65 noise looks like a group.
pub const LARGE_DROP: f64 = 0.75;

/// Ratios up to this one are none: values that are equal but for rounding.
pub const FLAT: f64 = 1.0 + 1e-9;

/// Largest K to which [`choose_seeing_dimension`] goes in order to see every node. Each further
/// group adds two columns, and k-means drowns in noise beyond a few hundred of them.
pub const MAX_SEEING: usize = 128;

/// The K of the frame before is kept while its drop is large but for this share of the largest one:
/// noise of a few percent in the weights must not change the dimension.
pub const KEEP: f64 = 0.1;

/// The K of the frame before that was raised is kept while the last value there is within this fraction of
/// the one that is needed.
const SWAP: f64 = 0.02;

/// The largest K from 2 to max(`teams`, 2) of which ln(σ_K / σ_{K+1}) is at least [`LARGE_DROP`] times
/// the largest there is in that range; K = 2 where no value drops.
///
/// `sigma` holds all n singular values of the n × n similarity, descending; `teams` is the number
/// of teams wanted. Two nodes or fewer give K = n. K = n is never a candidate otherwise, as there
/// is no ratio behind the last value. When the numeric rank r (values above n ε σ₁) ends within
/// the range, the drop behind it is infinite and K = max(r, 2).
#[must_use]
pub fn choose_dimension(sigma: &[f64], teams: usize) -> usize {
    let n = sigma.len();
    ruled(sigma, n, null_threshold(sigma, n), teams)
}

/// The rule for values of which those up to `noise` do not count, of a similarity of `n` nodes.
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
    let most = (2..=limit).map(ratio).fold(FLAT, f64::max).ln();
    let is_large = |k: &usize| ratio(*k) > FLAT && ratio(*k).ln() >= LARGE_DROP * most;
    (2..=limit).rev().find(is_large).unwrap_or(2)
}

/// The K that was chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Choice {
    /// K, from 1 to the number of values that are known.
    pub dimension: usize,
    /// Whether more triplets than are known could make more nodes seen, so that the choice is to be made
    /// again with them.
    pub short: bool,
}

/// The number of leading triplets, of `n` nodes, that [`choose_seeing_dimension`] must know at least for so
/// many teams: one more than the rule looks at.
#[must_use]
pub fn least_rank(n: usize, teams: usize) -> usize {
    if n <= 2 { n } else { limit(n, teams) + 1 }
}

/// K of [`choose_dimension`], raised until the K leading triplets see every node that is `related`
/// (has an edge, one entry per node), or as many of them as K can make seen within the numeric rank
/// and [`MAX_SEEING`].
///
/// `svd` must know [`least_rank`] triplets or all. `previous` is the K of the frame before. It is kept
/// if it sees as many, and either is within the range of the rule, not below its K, with a drop that is
/// large but for [`KEEP`], or is above the K that was raised with a value σ within 2 % of the one there,
/// so that the last groups may change places.
#[must_use]
pub fn choose_seeing_dimension(
    svd: &impl Spectrum,
    related: &[bool],
    teams: usize,
    previous: Option<usize>,
) -> Choice {
    let sigma = svd.singular_values();
    let (n, noise) = (svd.nodes(), svd.noise());
    let rank = rank(sigma, noise);
    let ruled = ruled(sigma, n, noise, teams).min(sigma.len());
    let found = |dimension| Choice { dimension, short: false };
    if n <= 2 || rank == 0 {
        return found(ruled);
    }
    let limit = limit(n, teams);
    let seen = seen_counts(svd, related, rank.min(MAX_SEEING.max(limit)));
    let count = |k: usize| seen[k.clamp(1, seen.len()) - 1];
    let most = (ruled..=rank.min(MAX_SEEING)).map(count).fold(count(ruled), usize::max);
    // The last value that is known has none behind it to be compared with.
    let all = rank == sigma.len() && sigma.len() < n.min(MAX_SEEING + 1);
    let short = all && most < related.iter().filter(|related| **related).count();
    let raised = (ruled..=rank).find(|k| count(*k) >= most).unwrap_or(ruled);
    let Some(previous) = previous.filter(|k| (2..=seen.len()).contains(k) && count(*k) >= most)
    else {
        return Choice { dimension: raised, short };
    };
    // Positive up to the rank, and infinite behind it.
    let ratio = |k: usize| match sigma.get(k) {
        Some(next) if k < rank => sigma[k - 1] / next,
        _ if k >= rank && rank < sigma.len() => f64::INFINITY,
        _ if sigma.len() == n => f64::INFINITY,
        _ => 1.0,
    };
    let largest = (2..=limit).map(ratio).fold(1.0, f64::max).ln();
    let as_good = (ruled..=limit).contains(&previous)
        && ratio(previous).ln() >= (LARGE_DROP - KEEP) * largest;
    let swapped = previous > raised
        && raised > ruled
        && sigma[previous - 1] >= (1.0 - SWAP) * sigma[raised - 1];
    Choice { dimension: if as_good || swapped { previous } else { raised }, short }
}

/// Largest K of the rule.
fn limit(n: usize, teams: usize) -> usize {
    teams.clamp(2, n - 1)
}

/// Values above the noise.
fn rank(sigma: &[f64], noise: f64) -> usize {
    sigma.iter().filter(|s| **s > noise).count()
}

/// How many related nodes the k leading triplets see, for k from 1 to `bound`.
fn seen_counts(svd: &impl Spectrum, related: &[bool], bound: usize) -> Vec<usize> {
    let mut squares = vec![0.0; svd.nodes()];
    let add = |j: usize| {
        for (i, square) in squares.iter_mut().enumerate() {
            *square += svd.squared_share(i, j);
        }
        let longest = squares.iter().fold(0.0_f64, |m, s| m.max(*s)).sqrt();
        let is_seen =
            |(square, related): (&f64, &bool)| *related && square.sqrt() > WEAK_ROW * longest;
        squares.iter().zip(related).filter(|pair| is_seen(*pair)).count()
    };
    (0..bound).map(add).collect()
}

#[cfg(test)]
mod tests {
    use super::{MAX_SEEING, choose_dimension, choose_seeing_dimension};
    use crate::matrix::DenseMatrix;
    use crate::svd::full_svd;

    /// K for a similarity in which triplet j sees node j alone; the first so many are related.
    fn seeing(sigma: &[f64], related: usize, teams: usize, previous: Option<usize>) -> usize {
        let n = sigma.len();
        let s = DenseMatrix::from_fn(n, n, |i, j| if i == j { sigma[i] } else { 0.0 });
        let related: Vec<bool> = (0..n).map(|i| i < related).collect();
        choose_seeing_dimension(&full_svd(&s).unwrap(), &related, teams, previous).dimension
    }

    #[test]
    fn raised_until_every_related_node_is_seen() {
        let sigma = [9.0, 8.0, 3.0, 2.9, 1.0];
        for related in 0..=5 {
            assert_eq!(seeing(&sigma, related, 2, None), related.max(2));
        }
        assert_eq!(seeing(&[3.0, 2.0, 1e-20, 0.0], 4, 2, None), 2, "the rank is exhausted");
        assert_eq!(seeing(&[0.0; 4], 4, 2, Some(3)), 2);
        assert_eq!(seeing(&[], 0, 2, Some(2)), 0);
        let many: Vec<f64> = (0..MAX_SEEING + 9).map(|j| 200.0 - j as f64).collect();
        assert_eq!(seeing(&many, many.len(), 2, None), MAX_SEEING);
        assert_eq!(seeing(&many, many.len(), 2, Some(MAX_SEEING + 1)), MAX_SEEING);
    }

    #[test]
    fn the_dimension_before_is_kept_where_the_choice_is_close() {
        // Drops in logarithms: 1, 0.7, 0.2 times that of the first two.
        let close = [4.0, 4.0, 2.0, 0.5_f64.powf(0.7) * 2.0, 0.5_f64.powf(0.9) * 2.0];
        assert_eq!(seeing(&close, 2, 4, None), 2);
        for (previous, kept) in [(1, 2), (2, 2), (3, 3), (4, 2), (5, 2), (6, 2)] {
            assert_eq!(seeing(&close, 2, 4, Some(previous)), kept);
        }
        assert_eq!(seeing(&close, 3, 4, Some(2)), 3, "it does not see everybody");
        assert_eq!(seeing(&close, 2, 2, Some(3)), 2, "it is outside of the range");
        // A group that is about to be told apart is followed at once.
        let more = [4.0, 4.0, 2.0, 0.5_f64.powf(0.8) * 2.0, 0.5_f64.powf(0.9) * 2.0];
        assert_eq!(seeing(&more, 2, 4, Some(2)), 3);
    }

    #[test]
    fn a_raised_dimension_is_kept_while_groups_may_have_changed_places() {
        let sigma = [9.0, 8.0, 5.0, 4.9, 1.0];
        assert_eq!(seeing(&sigma, 3, 2, None), 3);
        assert_eq!(seeing(&sigma, 3, 2, Some(4)), 4);
        assert_eq!(seeing(&sigma, 3, 2, Some(5)), 3);
    }

    #[test]
    fn last_large_drop_within_the_range() {
        // The logarithms are 0.96 and 0.76 of the largest.
        assert_eq!(choose_dimension(&[9.0, 8.0, 4.0, 2.08, 1.25, 1.2], 5), 3);
        assert_eq!(choose_dimension(&[9.0, 8.0, 4.0, 2.08, 1.22, 1.2], 5), 4);
        assert_eq!(choose_dimension(&[9.0, 8.0, 7.0, 1.0, 0.9], 4), 3);
        assert_eq!(choose_dimension(&[9.0, 8.0, 7.0, 1.0, 0.9], 2), 2);
        // The drop behind the first value is outside of the range.
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
