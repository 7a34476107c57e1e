//! How far two divisions of the same nodes agree.

use std::collections::BTreeMap;

/// The Rand index adjusted for chance (Hubert and Arabie, *Comparing partitions*, Journal of Classification 2,
/// 1985) of two divisions, given as the labels of each node in both: 1 for the same division, about 0 for two
/// that have nothing to do with each other, below 0 for less than that. Labels are any numbers. It is 1 where
/// both divisions have one group, or only groups of one.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "counts are far below 2⁵³")]
pub fn adjusted_rand_index(labels: impl IntoIterator<Item = (usize, usize)>) -> f64 {
    let (mut both, mut left, mut right) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
    let mut nodes = 0_u64;
    for (one, other) in labels {
        *both.entry((one, other)).or_insert(0_u64) += 1;
        *left.entry(one).or_insert(0_u64) += 1;
        *right.entry(other).or_insert(0_u64) += 1;
        nodes += 1;
    }
    let pairs = |count: u64| (count * count.saturating_sub(1)) as f64 / 2.0;
    let sum = |counts: &BTreeMap<usize, u64>| -> f64 { counts.values().map(|n| pairs(*n)).sum() };
    let (left, right) = (sum(&left), sum(&right));
    let both: f64 = both.values().map(|count| pairs(*count)).sum();
    let all = pairs(nodes);
    let by_chance = if all > 0.0 { left * right / all } else { 0.0 };
    let most = f64::midpoint(left, right);
    if most == by_chance { 1.0 } else { (both - by_chance) / (most - by_chance) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn index(left: &[usize], right: &[usize]) -> f64 {
        adjusted_rand_index(left.iter().copied().zip(right.iter().copied()))
    }

    #[test]
    fn it_is_one_for_the_same_division_whatever_its_labels() {
        assert_eq!(index(&[0, 0, 1, 1, 2], &[7, 7, 3, 3, 9]), 1.0);
        assert_eq!(index(&[0; 4], &[5; 4]), 1.0);
        assert_eq!(index(&[0, 1, 2], &[2, 0, 1]), 1.0);
        assert_eq!(index(&[], &[]), 1.0);
    }

    #[test]
    fn it_is_that_of_the_literature() {
        // By hand: 2 of 15 pairs are together in both, 6 and 3 in each; 6 · 3 / 15 of them by chance.
        let found = index(&[0, 0, 0, 1, 1, 1], &[0, 0, 1, 1, 2, 2]);
        assert!((found - (2.0 - 1.2) / (4.5 - 1.2)).abs() < 1e-12, "{found}");
        assert!(index(&[0, 0, 1, 1], &[0, 1, 0, 1]) < 0.0);
    }
}
