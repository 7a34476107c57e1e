//! Training seeds and held-out seeds.
//!
//! Defaults are chosen on training seeds alone; every reported number comes from held-out ones.

use std::ops::Range;

/// Seeds on which defaults are chosen.
pub const TRAINING: Range<u64> = 0..100;

/// Seeds of the reported numbers, on which nothing was chosen. A new choice of defaults needs new ones: those from
/// 10,000 and 20,000 on are used up.
pub const HELD_OUT: Range<u64> = 30_000..30_100;

/// Seeds of the kinds of situations that are looked at once ([`crate::situations`]). Kinds that defaults may be
/// chosen on have those of [`TRAINING`].
pub const LOOKED_AT_ONCE: Range<u64> = 50_000..50_100;

/// So many held-out seeds, all of them at most.
pub fn held_out(count: usize) -> impl Iterator<Item = u64> + Clone {
    HELD_OUT.take(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_seed_both_chooses_and_judges() {
        let held_out_twice = |seed| HELD_OUT.contains(&seed) || LOOKED_AT_ONCE.contains(&seed);
        assert!(!TRAINING.clone().any(held_out_twice));
        assert!(!HELD_OUT.clone().any(|seed| LOOKED_AT_ONCE.contains(&seed)));
        assert!(HELD_OUT.count() >= 100 && TRAINING.count() >= 100);
        assert!(held_out(usize::MAX).all(|seed| !TRAINING.contains(&seed)));
    }
}
