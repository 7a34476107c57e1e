//! Choice of the number K of singular triplets that make up the representation.
//!
//! The paper takes K as given (half of the dimension D). It is the most sensitive number of the
//! method, so this module offers a rule: cut where the singular values drop the most, in ratio,
//! among the first few values that a division into that many teams can need.

use crate::svd::null_threshold;

/// Ratios within this relative distance count as equal; the smaller K wins.
pub const RATIO_TIE: f64 = 1e-9;

/// K = argmax of σ_K / σ_{K+1} over K from 2 to max(`teams`, 2).
///
/// `sigma` holds all n singular values of the n × n similarity, descending; `teams` is the number
/// of teams wanted. Two nodes or fewer give K = n. K = n is never a candidate otherwise, as there
/// is no ratio behind the last value. When the numeric rank r (values above n ε σ₁) ends within
/// the range, the drop behind it is infinite and K = max(r, 2).
#[must_use]
pub fn choose_dimension(sigma: &[f64], teams: usize) -> usize {
    let n = sigma.len();
    if n <= 2 {
        return n;
    }
    let limit = teams.clamp(2, n - 1);
    let noise = null_threshold(sigma);
    let rank = sigma.iter().filter(|s| **s > noise).count();
    if rank <= limit {
        return rank.max(2);
    }
    // sigma[k − 1] is σ_k, and positive up to the rank.
    let ratio = |k: usize| sigma[k - 1] / sigma[k];
    let better = |best: usize, k: usize| {
        if ratio(k) > ratio(best) * (1.0 + RATIO_TIE) { k } else { best }
    };
    (2..=limit).fold(2, better)
}

#[cfg(test)]
mod tests {
    use super::choose_dimension;

    #[test]
    fn largest_drop_within_the_range() {
        assert_eq!(choose_dimension(&[9.0, 8.0, 7.0, 1.0, 0.9], 4), 3);
        assert_eq!(choose_dimension(&[9.0, 8.0, 7.0, 1.0, 0.9], 2), 2);
        // The drop behind the first value is outside of the range.
        assert_eq!(choose_dimension(&[9.0, 1.0, 0.9, 0.3, 0.2], 3), 3);
    }

    #[test]
    fn ties_prefer_the_smaller() {
        assert_eq!(choose_dimension(&[8.0, 4.0, 2.0, 1.0, 0.5], 4), 2);
        assert_eq!(choose_dimension(&[8.0, 4.0, 2.0, 1.0 - 1e-13, 0.5], 4), 2);
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
