//! Which seeds choose, and which judge.
//!
//! Defaults are chosen on training seeds alone; every number that is reported of them rests on held-out ones.

use std::ops::Range;

/// Seeds on which defaults are chosen.
pub const TRAINING: Range<u64> = 0..100;

/// Seeds on which they are judged, and which nothing was chosen on. Whoever has seen their numbers and chooses
/// anew takes others: those from 10,000 and
/// 20,000 on have been looked at.
pub const HELD_OUT: Range<u64> = 30_000..30_100;

/// So many held-out seeds, all of them at most.
pub fn judging(count: usize) -> impl Iterator<Item = u64> + Clone {
    HELD_OUT.take(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_seed_both_chooses_and_judges() {
        assert!(TRAINING.clone().all(|seed| !HELD_OUT.contains(&seed)));
        assert!(HELD_OUT.count() >= 100 && TRAINING.count() >= 100);
        assert!(judging(usize::MAX).all(|seed| !TRAINING.contains(&seed)));
    }
}
